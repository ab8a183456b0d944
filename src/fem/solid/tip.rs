//! What holds the tip of a tube, or pulls at it.

use crate::fem::ends::{End, Ends};

/// What holds the tip, or pulls at it. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// Stretch and twist: mean over the length where held, force and moment where loaded.
    pub ends: Ends,
    /// In x and y: a force fixed in space, N, or a displacement, m.
    pub lateral: [End; 2],
    /// About x and y: a moment, N m, conjugate to the cap's rotation vector, or a tilt, rad.
    pub tilt: [End; 2],
}

impl Tip {
    /// Held straight, and by `ends` along and about z.
    pub fn straight(ends: Ends) -> Tip {
        Tip { ends, lateral: [End::Held(0.0); 2], tilt: [End::Held(0.0); 2] }
    }

    /// All six directions free.
    pub const FREE: Tip = Tip { ends: Ends::FREE, lateral: [End::Loaded(0.0); 2], tilt: [End::Loaded(0.0); 2] };
}

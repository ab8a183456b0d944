//! Where the fibre kinematics end.

use thiserror::Error;

/// The motion has left the domain of the fibre kinematics; angles in rad, lengths in m.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum DomainError {
    /// The fibres have no winding left.
    #[error(
        "fibres straightened: extension {:.3} mm has reached the limit of {:.3} mm at which the fibres are parallel \
         to the axis", .extension * 1e3, .limit * 1e3
    )]
    Straightened {
        /// Extension asked for.
        extension: f64,
        /// Extension at which |(1 + s/L) cos gamma| = 1.
        limit: f64,
    },
    /// The FREE has no length left.
    #[error("length vanished: extension {:.3} mm has consumed the whole length of {:.3} mm", .extension * 1e3, .length * 1e3)]
    Flattened {
        /// Extension asked for.
        extension: f64,
        /// Length at rest.
        length: f64,
    },
    /// The rotation has undone the fibres' winding: the radius has grown without bound.
    #[error(
        "fibres unwound: rotation {:.1} deg is beyond 99 % of the {:.1} deg at which the winding is undone and the \
         radius grows without bound", .rotation.to_degrees(), .limit.to_degrees()
    )]
    Unwound {
        /// Rotation asked for.
        rotation: f64,
        /// Rotation at which L tan(gamma)/R + phi = 0; the domain ends when 1 % of the winding is left.
        limit: f64,
    },
    /// A state that is infinite or not a number.
    #[error("the state is not finite: extension {extension} m, rotation {rotation} rad")]
    NotFinite {
        /// Extension.
        extension: f64,
        /// Rotation.
        rotation: f64,
    },
}

//! What holds the ends of a long tube, and the answer in global quantities.

use nalgebra::Matrix3;

/// One global degree of freedom of a long tube: loaded, or held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    /// Free to move under this external load (N or N m), 0 for free.
    Loaded(f64),
    /// Held at this value (stretch, or twist in rad/m).
    Held(f64),
}

/// How a long tube's ends are held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ends {
    /// Axial: external force in N (pulling positive), or the axial stretch.
    pub axial: End,
    /// Torsional: external moment in N m (right-handed about z), or the twist in rad per reference metre.
    pub torsion: End,
}

impl Ends {
    /// Closed and free.
    pub const FREE: Ends = Ends { axial: End::Loaded(0.0), torsion: End::Loaded(0.0) };
    /// Closed and blocked: stretch 1, twist 0.
    pub const BLOCKED: Ends = Ends { axial: End::Held(1.0), torsion: End::Held(0.0) };
}

/// The equilibrium of a long closed tube. SI units, lengths and twist per reference length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equilibrium {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// Axial stretch, 1 at rest.
    pub stretch: f64,
    /// Twist, rad per reference metre.
    pub twist: f64,
    /// Force on the distal support, N, F > 0 outwards: `-dPi/dlam`, which contains the cap thrust.
    pub force: f64,
    /// Moment on the distal support, N m, M > 0 in +theta: `-dPi/dtau`.
    pub moment: f64,
    /// Cavity volume per reference length, m2.
    pub volume: f64,
    /// Outer radius averaged over the reference circumference, m.
    pub outer_radius_mean: f64,
    /// Outer radius in the middle of a fibre, m.
    pub outer_radius_at_fiber: f64,
    /// Symmetric derivative of (dPi/dlam, dPi/dtau, -V) by (stretch, twist, pressure) along equilibria: the section
    /// stiffness in the first two, `d(-force, -moment)/dP` in the last column.
    pub tangent: Matrix3<f64>,
}

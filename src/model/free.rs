//! The lumped parameters of one FREE.

/// A FREE as the lumped model (Eqs 1-4 of the paper) sees it. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Free {
    /// Winding angle from the tube's axis, rad, signed (R positive), 0 < |gamma| < pi/2.
    pub gamma: f64,
    /// Length at rest, m.
    pub length: f64,
    /// Radius of the fibres at rest, m (the fibre radius: with the inner one the actuation is 27 to 37 % too small).
    pub radius: f64,
    /// Mass of the end cap and what hangs on it, kg.
    pub mass: f64,
    /// Rotational inertia of the end, kg m2.
    pub inertia: f64,
    /// Axial stiffness ke, N/m.
    pub axial_stiffness: f64,
    /// Torsional stiffness kt, N m/rad.
    pub torsional_stiffness: f64,
    /// Axial damping ce, N s/m.
    pub axial_damping: f64,
    /// Torsional damping ct, N m s/rad.
    pub torsional_damping: f64,
}

impl Free {
    /// +1 if the end turns positive under pressure (an L FREE), -1 if negative (R).
    pub fn direction(&self) -> f64 {
        -self.gamma.signum()
    }
}

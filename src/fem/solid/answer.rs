//! What a solid answers, in SI units.

/// One cross-section along the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Station {
    /// Where it was at rest, m from the base.
    pub reference: f64,
    /// Where it is on average, m along z.
    pub position: f64,
    /// Its turn about z, rad, right-handed and counted on beyond a whole turn.
    pub turn: f64,
    /// Outer radius averaged over the reference circumference, m; in x and y, about the section's middle.
    pub outer_radius_mean: f64,
    /// Outer radius in the middle of a fibre, m; in x and y, about the section's middle.
    pub outer_radius_at_fiber: f64,
}

/// An equilibrium of a finite tube with a rigid cap.
#[derive(Clone, Debug, PartialEq)]
pub struct SolidEquilibrium {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// Rotation of the tip about z, rad, right-handed.
    pub rotation: f64,
    /// Length over length at rest.
    pub stretch: f64,
    /// Twist at mid-length, rad per reference metre.
    pub middle_twist: f64,
    /// Axial stretch at mid-length.
    pub middle_stretch: f64,
    /// Outer radius at mid-length, averaged over the reference circumference, m.
    pub middle_radius: f64,
    /// Outer radius in the middle of a fibre at mid-length, m.
    pub middle_radius_at_fiber: f64,
    /// Displacement of the cap's centre in x and y, m.
    pub lateral: [f64; 2],
    /// Tilt of the cap (rotation vector's x and y, in space), rad.
    pub tilt: [f64; 2],
    /// Force on the distal support along z, N, outwards positive: it contains the thrust on the cap.
    pub force: f64,
    /// Moment on the distal support about z, N m, positive in +theta.
    pub moment: f64,
    /// Force on the distal support in x and y, N.
    pub lateral_force: [f64; 2],
    /// Moment on the distal support conjugate to the tilt, N m.
    pub bending_moment: [f64; 2],
    /// Volume of the cavity, m3.
    pub volume: f64,
    /// dV/dP along equilibria, m3/Pa: negative beyond a pressure maximum.
    pub compliance: f64,
    /// Negative pivots of the saddle-point matrix.
    pub negative_pivots: usize,
    /// Those that a stable state has: one for each pressure unknown of the rubber.
    pub expected_negative_pivots: usize,
    /// The sections along the tube, from base to tip.
    pub profile: Vec<Station>,
}

impl SolidEquilibrium {
    /// Whether the energy is at a minimum at this pressure, among the motions that the mesh can make.
    pub fn stable(&self) -> bool {
        self.negative_pivots == self.expected_negative_pivots
    }
}

/// Where a path has ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathEnd {
    /// At the last pressure asked for.
    Reached,
    /// At a pressure maximum, Pa: beyond it there is no equilibrium on this branch at a higher pressure.
    Limit(f64),
    /// Steps have become too small at this pressure, Pa, without a pressure maximum.
    Stuck(f64),
}

/// Equilibria at the pressures asked for, as far as they exist.
#[derive(Clone, Debug, PartialEq)]
pub struct SolidPath {
    /// One for each pressure reached, in the order asked for.
    pub states: Vec<SolidEquilibrium>,
    /// How it ended.
    pub end: PathEnd,
    /// Newton iterations in all.
    pub iterations: usize,
}

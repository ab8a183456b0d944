//! Geometrically exact rods that bend, shear, twist and stretch without bounds.
//!
//! A rod is its strains along the reference length (curvature, twist, shear, stretch in the section's own frame); its
//! shape follows by integrating them as a rigid motion, `g' = g xi`. The strains are Legendre polynomials over the
//! rod, the motion is integrated by Magnus' fourth-order steps of exact screws, and the rod's one potential ([`Law`])
//! by the same Gauss points. A helix is exact at any size, rigid motions cost nothing, nothing locks.
//!
//! The rod is loaded at its ends only. Its unknowns are condensed to the tip: a 6 x 6 stiffness, with the inertia of
//! what was eliminated kept by count.

mod assembly;
mod basis;
mod condensed;
mod density;
mod dual;
mod grid;
mod law;
mod profile;
mod table;

use nalgebra::Vector2;
use thiserror::Error;

pub(crate) use assembly::{Assembly, STRAINS};
pub(crate) use basis::Basis;
pub use basis::Resolution;
pub(crate) use condensed::{Condensed, blocks, half_bracket, moment_force, twist, vector6, wrench};
pub(crate) use dual::{DualMatrix, DualVector, Exponential, skew, small_twist};
pub use grid::{Axis, Grid};
pub use law::{Jet, Law, LawError, Straight};
pub use profile::Profile;
pub use table::{Table, TableDeviation, TableError};

/// A rod of one law. SI units.
#[derive(Clone, Debug)]
pub struct Rod {
    /// Reference length, m.
    pub length: f64,
    /// Its law.
    pub law: Law,
    /// Curvature at rest about the section's x and y, rad/m: an imperfect FREE is not straight.
    pub rest_curvature: Vector2<f64>,
    /// Outer radius at rest for the clearance to other rods, m; 0 ignores contact.
    pub outer_radius: f64,
}

impl Rod {
    /// A straight rod of `length` m and `law` that touches nothing.
    pub fn straight(length: f64, law: Law) -> Rod {
        Rod { length, law, rest_curvature: Vector2::zeros(), outer_radius: 0.0 }
    }
}

/// Why a rod's state cannot be computed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum RodError {
    /// The law refuses.
    #[error(transparent)]
    Law(#[from] LawError),
    /// A Magnus step turns by more than half a turn.
    #[error("one of {steps} steps turns by {angle:.2} rad: use more steps along the rod")]
    TooCoarse {
        /// rad.
        angle: f64,
        /// Magnus steps.
        steps: usize,
    },
    /// The rod's equations are singular.
    #[error("the rod's equations are singular: it sits exactly on a critical point")]
    Singular,
}

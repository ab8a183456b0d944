//! Why no tier answers.

use thiserror::Error;

use crate::fem::section::SectionError;
use crate::fem::solid::SolidError;
use crate::fem::tube::TubeError;
use crate::model::FreeError;

/// Why a scene has no answer.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FidelityError {
    /// No tube.
    #[error(transparent)]
    Tube(#[from] TubeError),
    /// Length too short for a tube.
    #[error("length {length} m: must be at least two outer radii, {least} m, and finite")]
    Length {
        /// m.
        length: f64,
        /// m.
        least: f64,
    },
    /// No pressures.
    #[error("pressure {0} Pa: must be finite")]
    Pressure(f64),
    /// The solid of a single FREE ends before.
    #[error("the solid of one of the FREEs, held from turning, has no equilibrium at {0} Pa: ask for a lower pressure")]
    Single(f64),
    /// The lumped model.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// The section.
    #[error(transparent)]
    Section(#[from] SectionError),
    /// The solid.
    #[error(transparent)]
    Solid(#[from] SolidError),
    /// What the solid of a module does not have.
    #[error("the solid of a module does not take {0}; rods do")]
    Module(&'static str),
    /// Tolerance out of range.
    #[error("tolerance {0}: must be between 0.0005 and 0.5 (0.05 % to 50 %)")]
    Tolerance(f64),
    /// A fibre without width has no converged section.
    #[error("a line fibre has no answer that converges with the mesh: only the solid takes it, on a stated mesh")]
    Line,
    /// Not even the solid is within the tolerance.
    #[error(
        "the solid's estimated error, {:.2} %, is above the tolerance of {:.2} %: no tier is within it",
        100.0 * .estimate, 100.0 * .tolerance
    )]
    NotReached {
        /// Of the solid.
        estimate: f64,
        /// Asked for.
        tolerance: f64,
    },
}

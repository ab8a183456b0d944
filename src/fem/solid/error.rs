//! What a solid refuses, or cannot do.

use thiserror::Error;

use super::mesh::MeshError;
use super::system::SystemError;
use crate::fem::tube::TubeError;

/// What a solid refuses, or cannot do.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SolidError {
    /// The tube.
    #[error(transparent)]
    Tube(#[from] TubeError),
    /// The mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The system.
    #[error(transparent)]
    System(#[from] SystemError),
    /// Bulk modulus out of range.
    #[error("bulk over shear modulus {0}: must be between 10 and 1e9 (leave it out for an incompressible rubber)")]
    Bulk(f64),
    /// Bending asked of a sector.
    #[error("lateral loads on a sector with cyclic symmetry, which cannot bend: mesh the whole circumference")]
    Lateral,
    /// Tubes of a module that overlap at rest.
    #[error("spacing {spacing} m of the tubes' centres: must be at least their outer diameter, {least} m, and finite")]
    Spacing {
        /// Centre to centre, m.
        spacing: f64,
        /// Outer diameter, m.
        least: f64,
    },
    /// A number that is not finite.
    #[error("{what} {value}: must be finite")]
    NotFinite {
        /// What it is.
        what: &'static str,
        /// Its value.
        value: f64,
    },
}

//! The solid: a finite tube with its ends, by three-dimensional mixed finite elements.
//!
//! Total Lagrangian, displacements and pressures: 27-node hexahedra with four discontinuous pressures each
//! ([`element`]), swept along the fibres ([`mesh`]), whose fields are interpolated in a frame that turns with the
//! tip, so that turns of several hundred degrees cost no more steps than small ones. The base is bonded to a rigid
//! plane, the tip to a rigid cap ([`cap`]); the gas enters through the volume that it encloses ([`surface`]);
//! fibres are trusses or strips ([`fiber`]). [`system`] has the equations and their inertia, [`path`] the steps,
//! [`module`] four tubes under one plate.
//!
//! A line fibre's answers depend on the mesh (the rubber's field under a line load has a logarithmic singularity);
//! a strip's do not.

#![allow(clippy::needless_range_loop, reason = "components of tensors are named by their indices")]

pub mod answer;
pub mod body;
pub mod cap;
pub mod element;
pub mod error;
pub mod fiber;
pub mod mesh;
pub mod module;
pub mod path;
pub mod shapes;
pub mod surface;
pub mod system;
pub mod tip;

pub use answer::{PathEnd, SolidEquilibrium, SolidPath, Station};
pub use error::SolidError;
pub use mesh::{Mesh, MeshError, Part};
pub use module::{ModuleEnd, ModulePath, PlateEquilibrium, SolidModule};
pub use path::Solid;
pub use tip::Tip;

//! The simulated rig: a plant that differs from the controller's model, and chips at register and byte level
//! that answer the real drivers.

mod bench;
pub mod chips;

pub use bench::{BenchConfig, ImuSim, PlantSim, RegulatorSim};

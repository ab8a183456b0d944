//! The simulated rig: a plant that differs from the controller's model, and chips at register and byte level
//! that answer the real drivers.

mod bench;
pub mod chips;
mod hysteresis;
mod plant;
mod regulator;
mod tip;
mod valve;

pub use bench::{BenchConfig, ImuSim, PlantSim, RegulatorSim};
pub use hysteresis::MaxwellSlip;
pub use plant::{Motion, Plant, PlantFault, STEP};
pub use regulator::{Regulator, Valve};
pub use tip::{HardStop, Tip};
pub use valve::DumpValve;

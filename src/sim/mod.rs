//! The simulated rig: a plant that differs from the controller's model, and chips at register and byte level
//! that answer the real drivers.

mod assessment;
mod bench;
pub mod chips;
mod closed_loop;
pub mod controlled;
mod hand;
mod hysteresis;
pub mod identification;
mod knob;
mod module;
mod person;
mod plant;
mod plate;
mod regulator;
mod rig;
pub mod ringdown;
mod tip;
mod valve;

pub use assessment::{Assessment, Move, SETTLING_BAND, assess};
pub use bench::{AnalogueSim, BenchConfig, ImuSim, PlantSim, RegulatorSim};
pub use closed_loop::{ClosedLoop, ClosedLoopError, Controller, Sample};
pub use hand::Hand;
pub use hysteresis::MaxwellSlip;
pub use knob::KnobSim;
pub use module::ModuleSim;
pub use person::{GAUGE, Person, RULER};
pub use plant::{Plant, PlantFault, STEP};
pub use plate::{Plate, Swing};
pub use regulator::{Regulator, Valve};
pub use rig::{Button, SimInput, SimOutput, SimRig};
pub use tip::{HardStop, Tip};
pub use valve::DumpValve;

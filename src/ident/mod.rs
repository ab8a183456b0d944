//! Fits: from recorded samples to parameters and their uncertainty. Pure functions; nothing here reads a clock or a
//! file, and a fit that its data do not carry is refused by name.

pub mod dump;
pub mod imu;
mod least_squares;
pub mod loads;
pub mod material;
mod measured;
mod noise;
pub mod pluck;
pub mod regulator;
pub mod ringdown;
pub mod sweep;

pub use dump::{Dump, DumpError, DumpFit, fit_dump};
pub use loads::{LoadError, LoadFit, LoadPoint, fit_loads};
pub use measured::Measured;
pub use ringdown::{Channel, Decay, RingDown, RingDownError, fit_ring_down};
pub use sweep::{MomentPoint, RestPoint, SweepError, SweepFit, fit_shape, fit_sweep};

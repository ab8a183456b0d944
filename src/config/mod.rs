//! Configuration: rig.toml, calibration and experiment files, checked and built into the run-time values of the
//! floors below. Every problem is named, all of them at once.

mod problem;

pub use problem::{ConfigError, Problem};

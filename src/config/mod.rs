//! Configuration: rig.toml, calibration and experiment files, checked and built into the run-time values of the
//! floors below.
//!
//! # How a file is read
//!
//! `reader` walks the TOML document key by key and *notes* what is wrong instead of stopping at it: syntax,
//! unknown keys, wrong types, values out of range, contradictions between keys and between files. Each
//! [`Problem`] says where it is, what is written, which rule it breaks and what to do; [`ConfigError`] holds all
//! of them. Only from files without a problem is anything built ([`Rig::load`]).
//!
//! Units are in the key names (`max_pressure_psi`, `length_mm`); everything built is SI.
//!
//! # Who writes what
//!
//! rig.toml and experiment files belong to a person, and the program never writes them. Calibration files belong to
//! the program, which replaces them atomically ([`atomic`]).

pub mod atomic;
mod axis;
mod build;
mod cache;
pub mod calibration;
mod columns;
mod conditions;
pub mod experiment;
mod free;
pub mod gains;
mod key;
mod knob;
mod limits;
mod load;
mod loads;
pub mod material;
mod module;
mod problem;
mod reader;
mod rig;
mod salvage;
mod schema;
mod script;
mod sections;
mod tables;
mod tube;
mod whisk;

pub use cache::Cache;
pub use calibration::Calibration;
pub use conditions::{Conditions, FittedGeometry};
pub use experiment::{Course, Experiment, Kind};
pub(crate) use key::distance;
pub use knob::{Knob, Temperatures};
pub use load::SourceFile;
pub use loads::KnownLoad;
pub use material::Material;
pub use module::{FREES as MODULE_FREES, ModuleConfig};
pub use problem::{ConfigError, Problem};
pub use reader::is_plain;
pub use rig::{Backend, LoopConfig, RecordConfig, Rig, SocketConfig};
pub use salvage::Salvage;
pub use script::Script;
pub use tables::{Waypoints, pressure_rows, waypoints};
pub use whisk::Whisk;

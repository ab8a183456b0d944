//! freerig drives a soft-robotics bench: FREEs (fiber-reinforced elastomeric enclosures), their pressure
//! regulators and their IMUs, from a real-time thread; identifies and models them; records everything.
//!
//! # The house
//!
//! Floors, from the top; imports go downwards only:
//!
//! | floor | what it holds |
//! | --- | --- |
//! | [`cli`] | one file per command; no physics, no device code |
//! | [`daemon`] | supervisor, control socket, procedures, the live and the stepped rig |
//! | [`record`] | run folder, rerun sink, plots and report |
//! | [`config`] | rig.toml, calibration and experiment files, checked and built |
//! | [`rt`] | the periodic thread and its accounting |
//! | [`sim`] | simulated plant and chips |
//! | [`plan`] | what to command |
//! | [`control`] | controller, estimator, interlocks, life cycle: pure functions |
//! | [`ident`] | fits from recorded samples |
//! | [`hardware`] | device traits, drivers, bus owners |
//! | [`fem`] | finite elements |
//! | [`trajectory`] | time-parameterised references |
//! | [`model`] | what a FREE is |
//! | [`clock`], [`signal`], [`units`] | time, what flows, quantities |
#![forbid(unsafe_code)]

pub mod cli;
pub mod clock;
pub mod config;
pub mod control;
pub mod daemon;
pub mod fem;
pub mod hardware;
pub mod ident;
pub mod model;
pub mod plan;
pub mod record;
pub mod rt;
pub mod signal;
pub mod sim;
pub mod trajectory;
pub mod units;

//! freerig drives a soft-robotics bench: FREEs (fiber-reinforced elastomeric enclosures), their pressure
//! regulators and their IMUs, from a real-time thread; identifies and models them; records everything.
//!
//! The README is the manual of the program. This page is the map of the code.
//!
//! # The house
//!
//! Floors, from the top. Imports go downwards only, and the floors marked `o` are pure: they read no clock, file,
//! socket or environment (tests/house.rs holds both).
//!
//! ```text
//!     cli           the commands
//!     daemon        the rig as a whole, live or stepped
//!     record        runs/ID, the live view, reports
//!     config        files of the user, checked and built
//!     rt            the thread that ticks
//!     sim           the rig that there is without hardware
//!   o plan          what to command
//!   o control       what happens in a tick
//!   o ident         from records to parameters
//!     hardware      chips, units and their buses
//!   o fem           what geometry and material alone say
//!   o trajectory    references over time
//!   o model         what a FREE is
//!     clock, signal, units
//! ```
//!
//! | floor | what it holds |
//! | --- | --- |
//! | [`cli`] | one file per command; no physics, no device code |
//! | [`daemon`] | supervisor, control socket, procedures, calibrations, `doctor`; joins tick and owners |
//! | [`record`] | run folder, samples, rerun's file and live view, plots, pages, export; alone knows rerun |
//! | [`config`] | rig.toml, calibration, experiment and plan files: every problem named; atomic writes |
//! | [`rt`] | the periodic thread: scheduling, sleep policy, rights, accounting; knows no device and no model |
//! | [`sim`] | simulated plant, module, person and chips, which answer the real drivers; the closed lumped loop |
//! | [`plan`] | workspace, inverse, paths, whisk and designs; what a module in motion shows of itself |
//! | [`control`] | life cycle, estimator, controllers, interlocks and fault matrix; margins, root locus, replay |
//! | [`ident`] | fits, each with its uncertainty: sweep, loads, ring-down, regulator, IMU, material |
//! | [`hardware`] | traits, drivers (BNO055, Alicat, MCP4728, ADS1115, PWM outputs, GPIO), one owner thread per bus |
//! | [`fem`] | closed form, section, rod, module, solid; the cheapest that is good enough |
//! | [`trajectory`] | step, linear, cubic, quintic, sinusoid, and their sequences |
//! | [`model`] | geometry, fibre kinematics, lumped dynamics, hysteresis, equilibria |
//! | [`clock`], [`signal`], [`units`] | live and stepped time; what flows, `Copy` and of fixed size; quantities |
//!
//! # What flows
//!
//! ```text
//!   a thread per bus (hardware)     zero and commands first, then readings
//!        |  ^
//!        v  |     latest-value slots: an old set-point is never replayed
//!   the tick (rt, control)          samples and their age -> estimator -> reference(t)
//!        |  ^                       -> controller -> interlocks, in every state;
//!        |  |                       neither allocates, locks, logs nor waits
//!        |  +---- trims of the model thread (plan), while a plate is led along a path
//!        v
//!        a bounded ring of records: an overflow is counted and told
//!        |
//!        v
//!   pump, recorder (daemon, record) samples.arrows, run.rrd, the live view
//!   supervisor (daemon)             life cycle, procedures, control socket;
//!                                   the emergency stop has a socket of its own
//! ```
//!
//! A [`signal::TickRecord`] holds everything that a tick saw, decided and commanded, so that
//! [`replay`](control::replay) gives the same commands bit for bit. Time comes from a [`clock::Clock`], which is
//! `CLOCK_MONOTONIC` or is stepped by a scheduler: on the stepped clock the same drivers, chips and controller give the
//! same bits for the same seed.
//!
//! # Where to start reading
//!
//! - **What a FREE does**: [`model`] with its signs, then [`model::Lumped`]; [`fem`] for its tiers.
//! - **What keeps the rig safe**: the diagram in [`control::lifecycle`], [`control::MATRIX`], [`control::interlocks`].
//! - **How a tick is made**: [`control::Controller`], then src/daemon/tick.rs, which joins it to the slots.
//! - **How an experiment runs**: src/cli/experiment.rs, [`daemon::procedure`] and [`daemon::experiment`], written once
//!   against [`daemon::Bench`] for the live and the stepped rig.
//! - **How a device is spoken to**: src/hardware/pwm.rs; docs/adding-a-regulator.md goes through all the files that
//!   a new driver touches.
//! - **How a command is added**: [`cli`]. **How a file is read**: [`config`].
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

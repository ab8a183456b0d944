//! Controller, estimator, interlocks and life cycle: pure functions of (state, input). No clock, no I/O, no
//! allocation after construction, no async. The same code runs live, on the stepped clock and in replay.

mod channel;
mod check;
pub mod controller;
pub mod design;
pub mod estimator;
pub mod fault;
pub mod feedforward;
pub mod forward;
pub mod interlocks;
pub mod lifecycle;
pub mod margin;
pub mod model_following;
pub mod pid;
pub mod refusal;
pub mod replay;
pub mod root_locus;
pub mod shaper;
pub mod static_map;
pub mod swing_twist;
pub mod tare;
pub mod trim;
pub mod tune;

pub use check::ControlError;
pub use controller::Controller;
pub use design::default_gains;
pub use fault::{MATRIX, Reaction};

use std::sync::Arc;
use std::time::Duration;

use crate::clock::Time;
use crate::model::{Free, Hysteresis};
use crate::signal::{ImuSample, MAX_FREES, PressureSample, Trim};
use crate::trajectory::Program;

/// PID gains, positive in the FREE's own direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gains {
    /// Pa/rad.
    pub proportional: f64,
    /// Pa/(rad s).
    pub integral: f64,
    /// Pa s/rad.
    pub derivative: f64,
    /// Corner of the derivative's first-order filter, Hz; 0 switches the filter off.
    pub derivative_filter: f64,
}

/// What the derivative term looks at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DerivativeOn {
    /// -Kd d(angle)/dt (Eq. 5): a step of the reference does not kick.
    #[default]
    Measurement,
    /// Kd d(reference - angle)/dt: follows a moving reference more closely.
    Error,
}

/// Limits of one FREE.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest pressure ever commanded, Pa.
    pub pressure_max: f64,
    /// Ramp down above it, Pa; p_max < p_warn < p_hard.
    pub pressure_warn: f64,
    /// Vent above it, Pa.
    pub pressure_hard: f64,
    /// Below it the FREE counts as vented, Pa.
    pub pressure_zero: f64,
    /// Highest rate of the command, Pa/s.
    pub slew: f64,
    /// Soft envelope of the angle: ramp down outside (lowest, highest), rad.
    pub angle_soft: (f64, f64),
    /// Hard envelope of the angle: vent outside (lowest, highest), rad.
    pub angle_hard: (f64, f64),
    /// Largest |reference - angle|, rad, and for how long, s; infinite switches the check off.
    pub tracking_error: (f64, f64),
}

/// What controls the angle.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ControllerKind {
    /// The PID of Eq. 5, with the linear feedforward where it is switched on.
    #[default]
    Pid,
    /// The inverse model with preview, shaped steps and hysteresis; the PID is its feedback
    /// ([`model_following`]).
    Model(ModelSpec),
    /// Nothing: the FREE follows pressures, and its end turns with its module's plate.
    Nothing,
}

/// What the inverse model knows beyond the FREE, its regulator and its IMU.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelSpec {
    /// Torsional hysteresis.
    pub hysteresis: Hysteresis,
    /// The static map; without it the table of the FREE's own equilibria.
    pub statics: Option<static_map::StaticMap>,
}

/// How the FREE's IMU is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuChannel {
    /// Rotation axis of the FREE (towards its tip) in the sensor's frame, unit vector.
    pub axis: [f64; 3],
    /// The device's own period.
    pub period: Duration,
    /// From the motion to its reading, beyond the reading's time stamp.
    pub delay: Duration,
}

/// How the FREE's regulator behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegulatorChannel {
    /// The device's own period: every unit on its line included.
    pub period: Duration,
    /// First-order lag.
    pub lag: Duration,
    /// Dead time, the command's way over the line included.
    pub dead_time: Duration,
    /// Fastest rise the regulator can make, Pa/s.
    pub fastest_fill: f64,
    /// Highest reading of its sensor, Pa.
    pub full_scale: f64,
    /// Whether it measures pressure.
    pub measures: bool,
}

/// One FREE under control.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeControl {
    /// Name in rig.toml.
    pub name: String,
    /// Its lumped model.
    pub free: Free,
    /// What controls its angle.
    pub controller: ControllerKind,
    /// Gains at start: of the PID, or of the feedback around the model.
    pub gains: Gains,
    /// What the derivative term looks at; around the model always the error.
    pub derivative_on: DerivativeOn,
    /// Share of the inverse linear model (with the regulator's lag) fed forward by the PID: 0 none, 1 all of it.
    pub feedforward: f64,
    /// Its limits.
    pub limits: Limits,
    /// Its IMU, where it has one.
    pub imu: Option<ImuChannel>,
    /// Its regulator.
    pub regulator: RegulatorChannel,
}

impl FreeControl {
    /// Whether its angle can be controlled: it is measured, and the end is its own.
    pub fn controls_angle(&self) -> bool {
        self.imu.is_some() && self.controller != ControllerKind::Nothing
    }
}

/// Everything the controller of a rig is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlConfig {
    /// Period of the tick.
    pub period: Duration,
    /// Longest time from a vent command to p < p_zero.
    pub vent_time: Duration,
    /// Duration of a ramp-down.
    pub ramp_time: Duration,
    /// A bus owner that hears nothing from the tick for so long commands zero by itself.
    pub command_timeout: Duration,
    /// Refuse to arm without real-time rights.
    pub require_realtime: bool,
    /// Whether a dump valve vents the rig where a regulator cannot be reached any more.
    pub dump_valve: bool,
    /// The FREEs, at most [`MAX_FREES`].
    pub frees: Vec<FreeControl>,
}

/// What the supervisor asks of the tick. Margins and everything else that is heavy have been computed before.
#[derive(Clone, Debug)]
pub enum Request {
    /// Self-test, vent check, tare, then Hold.
    Arm,
    /// Ramp down, then Disarmed.
    Disarm,
    /// Re-check the causes of the latched faults and, if they are gone, Disarmed.
    Clear,
    /// Run a program; from Hold only.
    Start {
        /// What to do.
        program: Arc<Program>,
        /// Loss of the client's heartbeat stops the program (not with `--detach`).
        attended: bool,
        /// Excite for identification: the state is Identify.
        identify: bool,
    },
    /// End the program; the pressures hold.
    Stop,
    /// Other gains for one FREE, without a bump.
    Gains {
        /// Index of the FREE.
        free: usize,
        /// The gains.
        gains: Gains,
    },
}

/// Everything that one tick sees.
#[derive(Clone, Debug)]
pub struct TickInput {
    /// Counts the periods since the loop's start; skipped ones are counted in.
    pub tick: u64,
    /// Nominal time of the tick.
    pub time: Time,
    /// From the deadline to the wake-up, ns.
    pub latency_ns: u32,
    /// Execution time of the previous tick, ns.
    pub execution_ns: u32,
    /// Periods skipped so far.
    pub skipped: u64,
    /// Latest readings of the IMUs.
    pub imu: [ImuSample; MAX_FREES],
    /// Latest readings of the regulators.
    pub pressure: [PressureSample; MAX_FREES],
    /// At most one request a tick.
    pub request: Option<Request>,
    /// The emergency stop.
    pub estop: bool,
    /// Whether the thread has its real-time rights.
    pub realtime: bool,
    /// Whether a configuration file differs from what was loaded.
    pub config_changed: bool,
    /// Whether the supply's pressure switch says low.
    pub supply_low: bool,
    /// Latest heartbeat of the client that runs the program.
    pub heartbeat: Time,
    /// What the model thread last added to a module's plan.
    pub trim: Trim,
}

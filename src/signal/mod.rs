//! What flows between the floors: samples up, commands down, records out. Everything here is `Copy` and of
//! fixed size, so that it crosses threads through wait-free slots and rings.
//!
//! SI units throughout: Pa (gauge), rad, rad/s, s. Signs as in [`crate::model`].

mod code;
mod mounting;
mod sample;

pub use code::{FaultCode, FaultSet, LimitSet, Refusal, RefusalCode, RequestKind, State};
pub use mounting::mounting;
pub use sample::{ImuHealth, ImuSample, PressureSample, RegulatorHealth, RegulatorStatus};
use serde::{Deserialize, Serialize};

use crate::clock::Time;

/// Most FREEs one rig can hold: a module of four and two singles.
pub const MAX_FREES: usize = 6;

/// What the tick tells every bus owner: latest value only, a stale one is never replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// When the tick gave it; an owner that sees it age beyond its limit commands zero by itself.
    pub time: Time,
    /// Set-points by FREE, Pa, within 0..=p_max.
    pub pressure: [f64; MAX_FREES],
    /// Open the dump valve (where there is one) and exhaust: a vent.
    pub vent: bool,
}

/// What the model thread adds to the pressures of a module's plan: latest value only, and the older it is the less of
/// it counts (`control::trim`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    /// When it was made.
    pub time: Time,
    /// By FREE, Pa.
    pub pressure: [f64; MAX_FREES],
}

/// What a reference is about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Quantity {
    /// Nothing is asked of this FREE.
    #[default]
    None = 0,
    /// The end's rotation, rad, closed loop.
    Angle = 1,
    /// The pressure, Pa, open loop.
    Pressure = 2,
}

/// Reference of one FREE at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// What the numbers are: rad or Pa.
    pub quantity: Quantity,
    /// Value.
    pub position: f64,
    /// First time derivative.
    pub rate: f64,
    /// Second time derivative.
    pub acceleration: f64,
}

/// What the estimator believes, and its whole state: enough to resume it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// Orientation at which the angle is zero, unit quaternion (w, x, y, z), sensor to world.
    pub tare: [f64; 4],
    /// Angle now, rad, tared, unwrapped (FREEs turn beyond a full turn).
    pub angle: f64,
    /// Rate now, rad/s.
    pub rate: f64,
    /// Angle of the latest accepted reading, at that reading's own time of validity, rad, unwrapped.
    pub measured_angle: f64,
    /// Rate of the latest accepted reading, rad/s.
    pub measured_rate: f64,
    /// Tilt of the axis against the tare, rad.
    pub tilt: f64,
    /// Age of the information in `measured_angle`, s.
    pub age: f64,
    /// Sequence number of the latest reading, accepted or not.
    pub sequence: u32,
    /// Whether there is anything to go by.
    pub valid: bool,
}

/// The controller's terms and its whole state, Pa: their sum is the unlimited command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Proportional term.
    pub proportional: f64,
    /// Integral term, stored pre-multiplied by its gain.
    pub integral: f64,
    /// Derivative term.
    pub derivative: f64,
    /// Feedforward.
    pub feedforward: f64,
    /// Filtered rate (or rate of the error) behind the derivative term, rad/s.
    pub filtered_rate: f64,
}

/// One FREE in one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FreeTick {
    /// The reading that the tick saw (input).
    pub imu: ImuSample,
    /// The reading that the tick saw (input).
    pub pressure: PressureSample,
    /// What was asked.
    pub reference: Reference,
    /// What the estimator makes of the readings.
    pub estimate: Estimate,
    /// The controller's terms.
    pub terms: Terms,
    /// The command before any limit, Pa.
    pub wanted: f64,
    /// The command that went out, Pa, within 0..=p_max.
    pub command: f64,
    /// Limits in force.
    pub limits: LimitSet,
    /// Faults whose condition holds now, after debounce.
    pub faults: FaultSet,
}

/// Everything one tick saw, decided and commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickRecord {
    /// Counts the periods since the loop's start; skipped ones are counted in.
    pub tick: u64,
    /// The tick's nominal time (its deadline), on which everything is computed.
    pub time: Time,
    /// Time from the deadline to the wake-up, ns.
    pub latency_ns: u32,
    /// Execution time of the *previous* tick, ns.
    pub execution_ns: u32,
    /// Periods skipped so far because of overruns.
    pub skipped: u64,
    /// Where the life cycle stands after the tick.
    pub state: State,
    /// Request taken up in this tick (input).
    pub request: RequestKind,
    /// Whether the emergency stop was seen (input).
    pub estop: bool,
    /// Whether the thread has its real-time rights (input).
    pub realtime: bool,
    /// Whether a configuration file differs from what was loaded (input).
    pub config_changed: bool,
    /// Whether the supply's pressure switch says low (input).
    pub supply_low: bool,
    /// Latest heartbeat of the client that runs the program (input).
    pub heartbeat: Time,
    /// Latest trim of a module's plan (input).
    pub trim: Trim,
    /// What this tick refused: the request it took up, or the arming it had to give up.
    pub refusal: Refusal,
    /// Time since the program's start, s; not a number outside a program.
    pub program_time: f64,
    /// Faults latched.
    pub latched: FaultSet,
    /// Rig-wide faults whose condition holds now.
    pub faults: FaultSet,
    /// Whether the dump valve is commanded open.
    pub vent: bool,
    /// FREEs in use: the first `free_count` entries of `frees`.
    pub free_count: u8,
    /// By FREE, in the order of rig.toml.
    pub frees: [FreeTick; MAX_FREES],
}

impl TickRecord {
    /// The FREEs in use.
    pub fn frees(&self) -> &[FreeTick] {
        &self.frees[..usize::from(self.free_count).min(MAX_FREES)]
    }
}

impl Default for TickRecord {
    fn default() -> Self {
        Self {
            tick: 0,
            time: Time::ZERO,
            latency_ns: 0,
            execution_ns: 0,
            skipped: 0,
            state: State::Boot,
            request: RequestKind::None,
            estop: false,
            realtime: false,
            config_changed: false,
            supply_low: false,
            heartbeat: Time::ZERO,
            trim: Trim::default(),
            refusal: Refusal::NONE,
            program_time: f64::NAN,
            latched: FaultSet::NONE,
            faults: FaultSet::NONE,
            vent: false,
            free_count: 0,
            frees: [FreeTick::default(); MAX_FREES],
        }
    }
}

/// What the simulated rig really did, for comparison; hardware has no such thing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// End rotation, rad.
    pub angle: f64,
    /// Extension, m.
    pub extension: f64,
    /// Pressure inside the FREE, Pa.
    pub pressure: f64,
    /// Centre of its end, m, from the middle of its base (of a module: of its plate, from the middle of the bases).
    pub position: [f64; 3],
}

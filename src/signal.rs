//! What flows between the floors: samples up, commands down, records out. Everything here is `Copy` and of
//! fixed size, so that it crosses threads through wait-free slots and rings.
//!
//! SI units throughout: Pa (gauge), rad, rad/s, s. Signs as in [`crate::model`].

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::clock::Time;

/// Most FREEs one rig can hold: a module of four and two singles.
pub const MAX_FREES: usize = 6;

/// What the bus owner says about an IMU's latest reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ImuHealth {
    /// No reading has arrived yet.
    #[default]
    Absent = 0,
    /// A plausible reading.
    Good = 1,
    /// The chip answered, but with values that cannot be (norm, jump).
    Implausible = 2,
    /// The chip was found reset or in the wrong mode, and is being set up again.
    Restarting = 3,
    /// The chip or its bus no longer answers, and the recovery ladder has been climbed to its end.
    Lost = 4,
}

/// One reading of an IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuSample {
    /// When the reading was taken from the chip.
    pub time: Time,
    /// Counts the readings of this IMU; the same number means the same reading.
    pub sequence: u32,
    /// Orientation, unit quaternion (w, x, y, z), sensor to world.
    pub quaternion: [f64; 4],
    /// Angular rate in the sensor's frame, rad/s.
    pub rate: [f64; 3],
    /// Linear acceleration in the sensor's frame without gravity, m/s2.
    pub acceleration: [f64; 3],
    /// CALIB_STAT as the chip gives it: two bits each for system, gyro, accelerometer, magnetometer.
    pub calibration: u8,
    /// Whether the reading may be used.
    pub health: ImuHealth,
}

/// What the bus owner says about a regulator's latest reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum RegulatorHealth {
    /// No reading has arrived yet.
    #[default]
    Absent = 0,
    /// A well-formed reply with a pressure.
    Good = 1,
    /// The unit commands a pressure but measures none (a DAC); `pressure` is not a number.
    Unmeasured = 2,
    /// The unit or its line no longer answers, and the recovery ladder has been climbed to its end.
    Lost = 3,
}

/// Conditions that a regulator reports or that its reply reveals; a set of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RegulatorStatus(pub u16);

impl RegulatorStatus {
    /// The pressure reading is over the sensor's range (POV).
    pub const PRESSURE_OVER_RANGE: Self = Self(1);
    /// The analogue-to-digital converter failed (ADC).
    pub const CONVERTER_FAILED: Self = Self(1 << 1);
    /// The over-pressure limit closed the valve (OPL).
    pub const OVERPRESSURE_LIMIT: Self = Self(1 << 2);
    /// The valve is held in place (HLD).
    pub const HELD: Self = Self(1 << 3);
    /// The unit is exhausting (EXH).
    pub const EXHAUSTING: Self = Self(1 << 4);
    /// The accepted set-point is not the one that was sent.
    pub const ECHO_MISMATCH: Self = Self(1 << 5);
    /// The unit rejected the command (`?`).
    pub const REJECTED: Self = Self(1 << 6);
    /// The unit takes its set-point from its analogue input, not from the line.
    pub const ANALOG_SOURCE: Self = Self(1 << 7);
    /// A token that this program does not know; carried verbatim by the driver, a warning.
    pub const UNKNOWN_TOKEN: Self = Self(1 << 8);
    /// The front panel is locked (LCK); information.
    pub const LOCKED: Self = Self(1 << 9);

    /// Whether all of `other` is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether any of `other` is set.
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Both sets together.
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// One reading of a pressure regulator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PressureSample {
    /// When the reply was complete.
    pub time: Time,
    /// Counts the readings of this regulator; the same number means the same reading.
    pub sequence: u32,
    /// Measured gauge pressure, Pa; not a number where the unit measures none.
    pub pressure: f64,
    /// Set-point that the unit says it has accepted, Pa.
    pub setpoint: f64,
    /// Conditions reported with the reading.
    pub status: RegulatorStatus,
    /// Whether the reading may be used.
    pub health: RegulatorHealth,
}

impl PressureSample {
    /// What is known of a FREE whose regulator (`self`) measures nothing and whose pressure `sensor` measures: the
    /// sensor's reading, with the regulator's set-point and what either reports. It is lost where either is, and once the
    /// regulator has been silent for `patience` it is as old as that silence: what presses must be heard of.
    pub fn measured_by(self, sensor: Self, patience: Duration) -> Self {
        use RegulatorHealth::{Absent, Lost};
        let health = match (self.health, sensor.health) {
            (Lost, _) | (_, Lost) => Lost,
            (Absent, _) => Absent,
            (_, health) => health,
        };
        let time = if sensor.time.since(self.time) > patience { self.time } else { sensor.time };
        Self { time, setpoint: self.setpoint, status: self.status.with(sensor.status), health, ..sensor }
    }
}

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

/// What the model thread adds to the pressures of a module's plan: latest value only, and the older it is the less of it
/// counts (`control::trim`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trim {
    /// When it was made.
    pub time: Time,
    /// By FREE, Pa.
    pub pressure: [f64; MAX_FREES],
}

/// Faults of the matrix; the numbers are stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum FaultCode {
    /// Measured pressure above p_hard.
    OverpressureHard = 1,
    /// Measured pressure above p_warn.
    OverpressureSoft = 2,
    /// Pressure reading outside its electrical range, not a number, or POV.
    PressureSensorRange = 3,
    /// No fresh pressure reading.
    PressureStale = 4,
    /// Pressure does not go where it is commanded.
    PressureNotFollowing = 5,
    /// Supply pressure too low.
    SupplyLow = 6,
    /// No fresh IMU reading.
    ImuStale = 7,
    /// IMU readings that cannot be.
    ImuImplausible = 8,
    /// Angle outside its envelope.
    AngleLimit = 9,
    /// Angle too far from its reference.
    TrackingError = 10,
    /// Too many late ticks.
    Deadline = 11,
    /// The client that runs the experiment is gone.
    ClientLost = 12,
    /// The regulator reports a fault, or accepted another set-point.
    RegulatorStatus = 13,
    /// A bus or a device on it does not answer any more.
    BusLost = 14,
    /// A configuration file changed while armed.
    ConfigChanged = 15,
    /// No real-time scheduling or no locked memory, where it is required.
    RealtimeLost = 16,
    /// The pressure did not fall after a vent.
    VentFailed = 17,
    /// The emergency stop.
    EmergencyStop = 18,
}

impl FaultCode {
    /// Every fault, in the order of the numbers.
    pub const ALL: [FaultCode; 18] = [
        FaultCode::OverpressureHard,
        FaultCode::OverpressureSoft,
        FaultCode::PressureSensorRange,
        FaultCode::PressureStale,
        FaultCode::PressureNotFollowing,
        FaultCode::SupplyLow,
        FaultCode::ImuStale,
        FaultCode::ImuImplausible,
        FaultCode::AngleLimit,
        FaultCode::TrackingError,
        FaultCode::Deadline,
        FaultCode::ClientLost,
        FaultCode::RegulatorStatus,
        FaultCode::BusLost,
        FaultCode::ConfigChanged,
        FaultCode::RealtimeLost,
        FaultCode::VentFailed,
        FaultCode::EmergencyStop,
    ];

    /// Stable name, as in the fault table and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            FaultCode::OverpressureHard => "overpressure_hard",
            FaultCode::OverpressureSoft => "overpressure_soft",
            FaultCode::PressureSensorRange => "pressure_sensor_range",
            FaultCode::PressureStale => "pressure_stale",
            FaultCode::PressureNotFollowing => "pressure_not_following",
            FaultCode::SupplyLow => "supply_low",
            FaultCode::ImuStale => "imu_stale",
            FaultCode::ImuImplausible => "imu_implausible",
            FaultCode::AngleLimit => "angle_limit",
            FaultCode::TrackingError => "tracking_error",
            FaultCode::Deadline => "deadline",
            FaultCode::ClientLost => "client_lost",
            FaultCode::RegulatorStatus => "regulator_status",
            FaultCode::BusLost => "bus_lost",
            FaultCode::ConfigChanged => "config_changed",
            FaultCode::RealtimeLost => "realtime_lost",
            FaultCode::VentFailed => "vent_failed",
            FaultCode::EmergencyStop => "emergency_stop",
        }
    }
}

/// A set of faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultSet(pub u32);

impl FaultSet {
    /// No fault.
    pub const NONE: FaultSet = FaultSet(0);

    /// One fault.
    pub const fn only(code: FaultCode) -> FaultSet {
        FaultSet(1 << code as u8)
    }

    /// Adds `code`.
    pub fn insert(&mut self, code: FaultCode) {
        self.0 |= 1 << code as u8;
    }

    /// Whether `code` is in the set.
    pub const fn contains(self, code: FaultCode) -> bool {
        self.0 & (1 << code as u8) != 0
    }

    /// Both sets together.
    pub const fn union(self, other: FaultSet) -> FaultSet {
        FaultSet(self.0 | other.0)
    }

    /// Whether there is no fault in the set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The faults of the set, in the order of their numbers.
    pub fn iter(self) -> impl Iterator<Item = FaultCode> {
        FaultCode::ALL.into_iter().filter(move |&c| self.contains(c))
    }
}

/// Limits in force: they explain what the command does, and never latch. A set of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitSet(pub u8);

impl LimitSet {
    /// The command was clipped at p_max.
    pub const PRESSURE_MAX: LimitSet = LimitSet(1);
    /// The command was clipped at zero: a FREE cannot be driven by suction.
    pub const PRESSURE_ZERO: LimitSet = LimitSet(2);
    /// The command's rate was limited.
    pub const SLEW: LimitSet = LimitSet(4);
    /// The integrator is held against windup, or frozen by a hold.
    pub const INTEGRATOR_HELD: LimitSet = LimitSet(8);
    /// Every limit with its stable name.
    pub const NAMES: [(LimitSet, &'static str); 4] = [
        (LimitSet::PRESSURE_MAX, "pressure_max"),
        (LimitSet::PRESSURE_ZERO, "pressure_zero"),
        (LimitSet::SLEW, "slew"),
        (LimitSet::INTEGRATOR_HELD, "integrator_held"),
    ];

    /// Adds `other`.
    pub fn insert(&mut self, other: LimitSet) {
        self.0 |= other.0;
    }

    /// Whether all of `other` is set.
    pub const fn contains(self, other: LimitSet) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Where the life cycle stands (see `control::lifecycle`); the numbers are stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum State {
    /// Before the first complete set of readings.
    #[default]
    Boot = 0,
    /// Connected, vented, not armed.
    Disarmed = 1,
    /// Self-test, vent check, tare.
    Arming = 2,
    /// Armed, the pressures stand still.
    Hold = 3,
    /// Armed, a program runs.
    Track = 4,
    /// Armed, an excitation runs for identification.
    Identify = 5,
    /// The pressures are taken down on the way to Disarmed.
    RampDown = 6,
    /// A fault has been seen and its reaction (hold, ramp or vent) is under way.
    Faulting = 7,
    /// Latched and vented, until cleared.
    Faulted = 8,
}

impl State {
    /// Stable name, as in status and JSON.
    pub const fn name(self) -> &'static str {
        match self {
            State::Boot => "boot",
            State::Disarmed => "disarmed",
            State::Arming => "arming",
            State::Hold => "hold",
            State::Track => "track",
            State::Identify => "identify",
            State::RampDown => "ramp_down",
            State::Faulting => "faulting",
            State::Faulted => "faulted",
        }
    }

    /// Whether the pressures may be anything but zero on purpose.
    pub const fn is_armed(self) -> bool {
        matches!(self, State::Hold | State::Track | State::Identify)
    }
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

/// Request that a tick took up, by its stable number; what it carried is in the run's start document.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum RequestKind {
    /// None.
    #[default]
    None = 0,
    /// Arm.
    Arm = 1,
    /// Disarm.
    Disarm = 2,
    /// Clear latched faults.
    Clear = 3,
    /// Start a program.
    Start = 4,
    /// Stop the program and hold.
    Stop = 5,
    /// Other gains, taken over without a bump.
    Gains = 6,
}

/// Why the tick did not do what was asked (texts and remedies in `control::refusal`); the numbers are stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum RefusalCode {
    /// Nothing was refused.
    #[default]
    None = 0,
    /// The life cycle does not allow it in this state.
    WrongState = 1,
    /// The emergency stop is pressed.
    EmergencyStop = 2,
    /// The condition of a fault holds.
    FaultPresent = 3,
    /// A configuration file differs from what was loaded.
    ConfigChanged = 4,
    /// No real-time rights, where they are required.
    NotRealtime = 5,
    /// The pressure is not below p_zero.
    NotVented = 6,
    /// No fresh pressure reading.
    NoPressure = 7,
    /// No fresh IMU reading.
    NoImu = 8,
    /// The IMU's gyro is not calibrated.
    NotCalibrated = 9,
    /// The FREE moves, where it must stand still for the tare.
    NotStill = 10,
    /// The program asks for what this rig cannot do (an angle without an IMU, a FREE that is not there, no duration).
    BadProgram = 11,
    /// Gains that are negative or not finite, or of a FREE that is not there.
    BadGains = 12,
    /// The program before has not been taken back yet.
    Busy = 13,
}

/// What was refused, and on whose account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub code: RefusalCode,
    /// Index of the FREE that it is about; [`Refusal::RIG`] where it is about no single one.
    pub free: u8,
    /// The fault behind [`RefusalCode::FaultPresent`].
    pub fault: Option<FaultCode>,
}

impl Refusal {
    /// `free` of a refusal that is about the whole rig.
    pub const RIG: u8 = u8::MAX;
    /// Nothing was refused.
    pub const NONE: Refusal = Refusal { code: RefusalCode::None, free: Self::RIG, fault: None };
}

impl Default for Refusal {
    fn default() -> Self {
        Self::NONE
    }
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

//! What has a stable number and a stable name: faults, limits, states, requests, refusals.

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

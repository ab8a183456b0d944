//! Readings of sensors and regulators.

use std::time::Duration;

use crate::clock::Time;

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
    /// sensor's reading, with the regulator's set-point and what either reports. It is lost where either is, and once,
    /// at `now`, the regulator has been silent for `patience`, it is as old as that silence: what presses must be heard
    /// of.
    pub fn measured_by(self, sensor: Self, patience: Duration, now: Time) -> Self {
        use RegulatorHealth::{Absent, Lost};
        let health = match (self.health, sensor.health) {
            (Lost, _) | (_, Lost) => Lost,
            (Absent, _) => Absent,
            (_, health) => health,
        };
        let time = if now.since(self.time) > patience { self.time.min(sensor.time) } else { sensor.time };
        Self { time, setpoint: self.setpoint, status: self.status.with(sensor.status), health, ..sensor }
    }
}

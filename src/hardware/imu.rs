//! What every IMU driver offers to its bus owner.

use std::fmt;

use super::HardwareError;
use crate::signal::ImuSample;

/// Which device answers: for the run's start document, `status` and `doctor`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Model, bus and address.
    pub device: String,
    /// The unit's own unique number, in hexadecimal; empty where it has none.
    pub serial: String,
    /// Firmware, as the maker writes it; empty where there is none.
    pub firmware: String,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.device)?;
        if !self.firmware.is_empty() {
            write!(f, ", firmware {}", self.firmware)?;
        }
        if !self.serial.is_empty() {
            write!(f, ", serial {}", self.serial)?;
        }
        Ok(())
    }
}

/// Why a reading cannot be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Implausible {
    /// The quaternion's norm is not one.
    Norm {
        /// What it is.
        norm: f64,
    },
    /// The orientation moved farther than the gyro accounts for.
    Jump {
        /// How far, rad.
        angle: f64,
        /// How far it may have moved, rad.
        allowed: f64,
    },
}

/// What one look at the IMU brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// A new, plausible reading.
    Fresh(ImuSample),
    /// The same fusion frame as before, bit for bit: nothing new.
    Repeated,
    /// The chip answered, but with values that cannot be; the sample carries them, marked.
    Implausible(ImuSample, Implausible),
    /// The chip has been reset or has left its mode: it must be connected again.
    Reset,
}

/// An orientation sensor.
pub trait Imu {
    /// Sets the device up from nothing, blocking until it runs.
    fn connect(&mut self) -> Result<Identity, HardwareError>;

    /// Takes one reading; blocks for one transfer.
    fn read(&mut self) -> Result<Reading, HardwareError>;
}

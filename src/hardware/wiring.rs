//! Which device hangs on which bus, and which FREE it serves.

use std::path::PathBuf;
use std::time::Duration;

/// Every bus of the rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wiring {
    /// I2C buses.
    pub i2c: Vec<I2cWiring>,
    /// Serial lines.
    pub serial: Vec<SerialWiring>,
    /// Digital lines.
    pub gpio: Option<GpioWiring>,
    /// A bus owner that sees the tick's command grow older than this commands zero by itself.
    pub command_timeout: Duration,
}

/// Lines of a GPIO chip; each may be missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpioWiring {
    /// Device file, `/dev/gpiochipN`.
    pub chip: PathBuf,
    /// Coil of the dump valve: high keeps it closed.
    pub dump_valve: Option<u32>,
    /// Heartbeat for the one-shot in series with that coil.
    pub heartbeat: Option<u32>,
    /// The emergency stop's contact: low is pressed.
    pub estop: Option<u32>,
    /// The supply's pressure switch: low is too low.
    pub supply: Option<u32>,
}

/// One I2C bus.
#[derive(Clone, Debug, PartialEq)]
pub struct I2cWiring {
    /// Name in rig.toml.
    pub name: String,
    /// Device file, `/dev/i2c-N`.
    pub device: PathBuf,
    /// IMUs on it.
    pub imus: Vec<ImuWiring>,
    /// DACs on it.
    pub dacs: Vec<DacWiring>,
    /// ADCs on it.
    pub adcs: Vec<AdcWiring>,
}

/// One BNO055.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuWiring {
    /// FREEs whose orientation it measures: one, or the four of a module's plate.
    pub frees: Vec<usize>,
    /// 0x28 or 0x29.
    pub address: u8,
    /// Reading period; the fusion output comes at 100 Hz.
    pub period: Duration,
    /// Digital line of its reset pin, where it is wired.
    pub reset: Option<u32>,
    /// Saved calibration profile, restored when connecting.
    pub profile: Option<ImuProfile>,
}

/// Calibration profile of one BNO055, as read from it: it fits no other one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuProfile {
    /// The sensor's own unique number (page 1, registers 0x50..=0x5F).
    pub unique_id: [u8; 16],
    /// Offsets and radii (page 0, registers 0x55..=0x6A).
    pub registers: [u8; 22],
}

/// One MCP4728 (four channels).
#[derive(Clone, Debug, PartialEq)]
pub struct DacWiring {
    /// 0x60..=0x67.
    pub address: u8,
    /// What hangs on the channels A to D.
    pub channels: [Option<DacChannel>; 4],
}

/// An analogue pressure regulator behind a DAC's channel or a PWM output of 12 bits, by its measured map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DacChannel {
    /// FREE that it feeds.
    pub free: usize,
    /// Code at which the regulator begins to open (its measured zero).
    pub zero_code: f64,
    /// Pressure per code above it, Pa (its measured span).
    pub pascals_per_code: f64,
}

/// One ADS1115 (four channels).
#[derive(Clone, Debug, PartialEq)]
pub struct AdcWiring {
    /// 0x48..=0x4B.
    pub address: u8,
    /// What hangs on the channels 0 to 3.
    pub channels: [Option<AdcChannel>; 4],
}

/// A pressure sensor behind one ADC channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdcChannel {
    /// FREE whose pressure it measures.
    pub free: usize,
    /// Its voltage without pressure, V.
    pub zero_volts: f64,
    /// Pressure per volt above it, Pa/V.
    pub pascals_per_volt: f64,
}

/// One serial line.
#[derive(Clone, Debug, PartialEq)]
pub struct SerialWiring {
    /// Name in rig.toml.
    pub name: String,
    /// Device file, best from `/dev/serial/by-id`.
    pub device: PathBuf,
    /// 8N1 at this rate, Bd.
    pub baud: u32,
    /// Alicat units on it.
    pub units: Vec<UnitWiring>,
    /// PWM outputs of microcontrollers on it.
    pub pwms: Vec<PwmWiring>,
}

/// One Alicat pressure controller, or gauge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitWiring {
    /// FREE that it feeds, or whose pressure it measures.
    pub free: usize,
    /// It measures and is told nothing: no set-point ever goes to it.
    pub gauge: bool,
    /// Unit id, `b'A'..=b'Z'`.
    pub id: u8,
    /// Full scale, Pa.
    pub full_scale: f64,
    /// Pascals in the unit that the device's front panel and frames use (psi from the factory).
    pub pascals_per_unit: f64,
}

/// One PWM output of a microcontroller ([`super::pwm`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PwmWiring {
    /// Id of the output, `b'A'..=b'Z'`; no other output and no Alicat unit on the line has it.
    pub id: u8,
    /// What hangs on it.
    pub channel: DacChannel,
}

//! Devices: traits, drivers and the owners of their buses.
//!
//! One thread owns one bus. It reads the tick's latest [`Command`](crate::signal::Command) from a latest-value
//! slot, talks to its devices, commands and vents first, and publishes readings into latest-value slots. A
//! command that grows too old counts as zero: an owner never needs the tick to be safe. Drivers know one chip,
//! take their time from a [`Clock`](crate::clock::Clock) and their bus as a trait, so that simulated chips at
//! register and byte level drive the very same code.

pub mod ads1115;
pub mod alicat;
pub mod alicat_frame;
pub mod bno055;
mod error;
pub mod gpio;
pub mod i2c;
pub mod i2c_owner;
mod imu;
pub mod mcp4728;
mod profile;
pub mod pwm;
mod regulator;
pub mod serial;
pub mod serial_line;
pub mod serial_owner;
mod serial_unit;
mod statistics;
mod valve_owner;
pub mod wiring;

pub use error::HardwareError;
pub use i2c_owner::{I2cOwner, I2cPorts};
pub use imu::{Identity, Implausible, Imu, Reading};
pub use profile::ProfileDesk;
pub use regulator::PressureRegulator;
pub use serial_owner::SerialOwner;
pub use statistics::{Counter, DeviceStatistics};
pub use valve_owner::{DumpValve, ValveOwner};

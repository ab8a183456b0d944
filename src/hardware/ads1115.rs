//! The ADS1115 four-channel 16-bit converter (Texas Instruments SBAS444) behind analogue pressure sensors.
//!
//! One conversion at a time: [`Ads1115::start`] begins it, [`Ads1115::finish`] fetches it a little later, and nobody
//! waits in between. Inputs are read against ground within 6.144 V, 187.5 uV a count; the supply bounds them at 5.3 V.
//!
//! A reading counts only if the chip says that it is ready *and* still has the configuration that it was given: random
//! bytes, a reset and another program's channel do not pass.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::i2c::transfer_error;
use super::{HardwareError, Identity};

const CONVERSION: u8 = 0;
const CONFIG: u8 = 1;
/// First of the two thresholds, which nobody writes: as after power-on they tell an ADS1115 from another chip.
const THRESHOLDS: [(u8, u16); 2] = [(2, 0x8000), (3, 0x7FFF)];
/// Bit 15 of the configuration: written, start; read, ready.
const READY: u16 = 0x8000;
/// Channel A against ground, 6.144 V, one conversion at a time, 860 a second, comparator off.
const SETTINGS: u16 = 0x41E3;
/// Bits of the configuration that choose the channel.
const CHANNEL_SHIFT: u32 = 12;
/// V per count.
pub const VOLTS_PER_COUNT: f64 = 6.144 / 32768.0;
/// Longest conversion: 1/860 s, by an oscillator that is off by up to 10 %.
pub const CONVERSION_TIME: Duration = Duration::from_micros(1300);

/// Driver of one ADS1115.
pub struct Ads1115<I> {
    bus: I,
    address: u8,
    device: Arc<str>,
}

impl<I: I2c> Ads1115<I> {
    /// A driver for the chip at `address` (0x48..=0x4B) of the bus called `name`; touches nothing yet.
    pub fn new(bus: I, name: &str, address: u8) -> Self {
        Self { bus, address, device: format!("ADS1115 at {address:#04x} on {name}").into() }
    }

    /// Goes on with another handle on the same bus.
    pub fn replace_bus(&mut self, bus: I) {
        self.bus = bus;
    }

    /// Makes sure that an ADS1115 answers.
    ///
    /// # Errors
    /// Where nothing answers, or something else does.
    pub fn connect(&mut self) -> Result<Identity, HardwareError> {
        for (register, expected) in THRESHOLDS {
            let found = self.register(register)?;
            if found != expected {
                return Err(HardwareError::WrongIdentity {
                    device: self.device.clone(),
                    expected: format!("an ADS1115, register {register} at {expected:#06x}"),
                    found: format!("{found:#06x}"),
                });
            }
        }
        Ok(Identity { device: self.device.to_string(), ..Identity::default() })
    }

    /// Begins a conversion of `channel` (0 to 3).
    ///
    /// # Errors
    /// Where the transfer fails.
    pub fn start(&mut self, channel: usize) -> Result<(), HardwareError> {
        let [high, low] = (settings(channel) | READY).to_be_bytes();
        self.bus.write(self.address, &[CONFIG, high, low]).map_err(|error| transfer_error(&self.device, &error))
    }

    /// The conversion of `channel` begun last, V against ground.
    ///
    /// # Errors
    /// Where it is not ready, or not the one that was begun.
    pub fn finish(&mut self, channel: usize) -> Result<f64, HardwareError> {
        let found = self.register(CONFIG)?;
        if found & !READY != settings(channel) {
            let detail = format!("its configuration is {found:#06x}, not {:#06x}", settings(channel));
            return Err(HardwareError::Malformed { device: self.device.clone(), detail });
        }
        if found & READY == 0 {
            let detail = "its conversion is not ready in time".into();
            return Err(HardwareError::NoAnswer { device: self.device.clone(), detail });
        }
        Ok(f64::from(self.register(CONVERSION)?.cast_signed()) * VOLTS_PER_COUNT)
    }

    fn register(&mut self, register: u8) -> Result<u16, HardwareError> {
        let mut bytes = [0; 2];
        self.bus
            .write_read(self.address, &[register], &mut bytes)
            .map_err(|error| transfer_error(&self.device, &error))?;
        Ok(u16::from_be_bytes(bytes))
    }
}

/// The configuration of a conversion of `channel`, without the bit that starts it.
fn settings(channel: usize) -> u16 {
    SETTINGS | (channel as u16 & 3) << CHANNEL_SHIFT
}

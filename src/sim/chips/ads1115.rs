//! A simulated ADS1115: four registers behind a pointer, one conversion at a time (Texas Instruments SBAS444).

use std::time::Duration;

use super::i2c::{I2cChip, Nak};
use crate::clock::Time;

/// Duration of a conversion at 860 a second.
const CONVERSION: Duration = Duration::from_micros(1163);
/// Configuration and thresholds after power-on (table 8-3 and those after it).
const POWER_ON: [u16; 4] = [0, 0x0583, 0x8000, 0x7FFF];
/// Bit that starts a conversion, and says that none is under way.
const START: u16 = 0x8000;
/// Inputs are clamped at the rails, 0.3 V beyond ground and a supply of 5 V.
const RAILS: (f64, f64) = (-0.3, 5.3);
/// Full scales by the amplifier's setting, V.
const RANGES: [f64; 8] = [6.144, 4.096, 2.048, 1.024, 0.512, 0.256, 0.256, 0.256];

/// Where an input's voltage comes from: asked with the channel (0 to 3) and the time at which a conversion begins.
pub type VoltageSource = Box<dyn FnMut(usize, Time) -> f64 + Send>;

/// The chip.
pub struct Ads1115Chip {
    source: VoltageSource,
    /// Conversion, configuration, low and high threshold.
    registers: [u16; 4],
    pointer: usize,
    ready: Time,
    frozen: Option<[u16; 4]>,
}

impl Ads1115Chip {
    /// A chip that measures `source`.
    pub fn new(source: VoltageSource) -> Self {
        Self { source, registers: POWER_ON, pointer: 0, ready: Time::ZERO, frozen: None }
    }

    /// A single conversion begins; against ground only: nothing here measures differences.
    fn convert(&mut self, config: u16, now: Time) {
        let mux = usize::from(config >> 12 & 7);
        let range = RANGES[usize::from(config >> 9 & 7)];
        let volts = if mux >= 4 { (self.source)(mux - 4, now) } else { 0.0 };
        let counts = (volts.clamp(RAILS.0, RAILS.1) / range * 32768.0).round();
        self.registers[0] = (counts.clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16).cast_unsigned();
        self.ready = now + CONVERSION;
    }

    fn show(&self, now: Time) -> [u16; 4] {
        let mut registers = self.registers;
        registers[1] = registers[1] & !START | if now >= self.ready { START } else { 0 };
        registers
    }
}

impl I2cChip for Ads1115Chip {
    fn write(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak> {
        let Some((&pointer, value)) = bytes.split_first() else { return Ok(()) };
        self.pointer = usize::from(pointer & 3);
        if let (&[high, low], false) = (value, self.pointer == 0) {
            let value = u16::from_be_bytes([high, low]);
            self.registers[self.pointer] = value;
            if self.pointer == 1 && value & START != 0 {
                self.convert(value, now);
            }
        }
        Ok(())
    }

    fn read(&mut self, now: Time, bytes: &mut [u8]) -> Result<(), Nak> {
        let registers = self.frozen.unwrap_or_else(|| self.show(now));
        for (byte, value) in bytes.iter_mut().zip(registers[self.pointer].to_be_bytes().into_iter().cycle()) {
            *byte = value;
        }
        Ok(())
    }

    fn power_on(&mut self, _: Time) {
        (self.registers, self.pointer, self.ready) = (POWER_ON, 0, Time::ZERO);
    }

    fn freeze(&mut self, now: Time, frozen: bool) {
        self.frozen = frozen.then(|| self.frozen.unwrap_or_else(|| self.show(now)));
    }
}

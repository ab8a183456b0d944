//! A simulated MCP4728: four 12-bit channels with input registers, output registers and an EEPROM
//! (Microchip DS22187E, sections 4 and 5).

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::i2c::{I2cChip, Nak};
use crate::clock::Time;

/// Duration of an EEPROM write (DS22187E, electrical characteristics: 25 ms typical).
const EEPROM_WRITE: Duration = Duration::from_millis(25);
/// The code with which the chip leaves the factory: mid-scale (DS22187E, table 4-2).
const FACTORY_CODE: u16 = 0x800;

/// One channel's register: reference, power-down, gain and code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DacRegister {
    /// Internal 2.048 V reference instead of the supply.
    pub internal: bool,
    /// Power-down: 0 is normal, 1 to 3 pull the output to ground.
    pub power_down: u8,
    /// Gain two (with the internal reference).
    pub gain_two: bool,
    /// Code, 0..=4095.
    pub code: u16,
}

impl DacRegister {
    fn from_bytes(high: u8, low: u8) -> Self {
        Self {
            internal: high & 0x80 != 0,
            power_down: (high >> 5) & 3,
            gain_two: high & 0x10 != 0,
            code: u16::from(high & 0x0F) << 8 | u16::from(low),
        }
    }

    fn to_bytes(self) -> [u8; 2] {
        let [high, low] = (self.code & 0x0FFF).to_be_bytes();
        [u8::from(self.internal) << 7 | (self.power_down & 3) << 5 | u8::from(self.gain_two) << 4 | high, low]
    }

    /// Output voltage at a supply of `supply` V.
    fn volts(self, supply: f64) -> f64 {
        if self.power_down != 0 {
            return 0.0;
        }
        let (reference, gain) =
            if self.internal { (2.048, if self.gain_two { 2.0 } else { 1.0 }) } else { (supply, 1.0) };
        (reference * gain * f64::from(self.code) / 4096.0).min(supply)
    }
}

/// Where the output voltages go: called with the time and the four voltages, V, whenever they change.
pub type VoltageSink = Box<dyn FnMut(Time, [f64; 4]) + Send>;

/// The chip.
pub struct Mcp4728Chip {
    address: u8,
    supply: f64,
    input: [DacRegister; 4],
    output: [DacRegister; 4],
    eeprom: [DacRegister; 4],
    wear: Arc<AtomicU32>,
    busy_until: Time,
    frozen: Option<[u8; 24]>,
    sink: VoltageSink,
}

impl Mcp4728Chip {
    /// A chip at `address` (0x60..=0x67), on 5 V, with its LDAC pin high, as it comes from the factory: mid-scale
    /// in the EEPROM on every channel.
    pub fn new(address: u8, sink: VoltageSink) -> Self {
        let factory = DacRegister { internal: true, power_down: 0, gain_two: false, code: FACTORY_CODE };
        Self {
            address,
            supply: 5.0,
            input: [factory; 4],
            output: [factory; 4],
            eeprom: [factory; 4],
            wear: Arc::default(),
            busy_until: Time::ZERO,
            frozen: None,
            sink,
        }
    }

    /// The same with `eeprom` as its content.
    pub fn with_eeprom(mut self, eeprom: [DacRegister; 4]) -> Self {
        self.eeprom = eeprom;
        self
    }

    /// A chip that has been programmed to start at zero.
    pub fn programmed(address: u8, sink: VoltageSink) -> Self {
        let zero = DacRegister { internal: true, power_down: 0, gain_two: true, code: 0 };
        Self::new(address, sink).with_eeprom([zero; 4])
    }

    /// Counts the EEPROM's write cycles; keep it before the chip goes onto its bus.
    pub fn wear(&self) -> Arc<AtomicU32> {
        self.wear.clone()
    }

    fn drive(&mut self, now: Time) {
        let volts = self.output.map(|r| r.volts(self.supply));
        (self.sink)(now, volts);
    }

    /// Takes the register of `channel`, and drives its output if `update`.
    fn load(&mut self, now: Time, channel: usize, register: DacRegister, update: bool) {
        self.input[channel] = register;
        if update {
            self.output[channel] = register;
            self.drive(now);
        }
    }

    /// One internal write cycle: it wears the EEPROM and takes its time.
    fn program(&mut self, now: Time) {
        self.wear.fetch_add(1, Ordering::Relaxed);
        self.busy_until = now + EEPROM_WRITE;
    }

    fn status(&self, now: Time) -> [u8; 24] {
        let mut bytes = [0; 24];
        let ready = u8::from(now >= self.busy_until) << 7;
        for channel in 0..4u8 {
            let at = usize::from(channel);
            // Ready, power on, channel, 0, address bits: once for the input register, once for the EEPROM.
            let head = ready | 0x40 | channel << 4 | (self.address & 7);
            for (i, register) in [self.input[at], self.eeprom[at]].into_iter().enumerate() {
                let [high, low] = register.to_bytes();
                bytes[6 * at + 3 * i..][..3].copy_from_slice(&[head, high, low]);
            }
        }
        bytes
    }
}

impl I2cChip for Mcp4728Chip {
    fn write(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak> {
        let Some(&first) = bytes.first() else { return Ok(()) };
        // While the EEPROM is being written, new write commands are ignored (section 5.6.3).
        if now < self.busy_until {
            return Ok(());
        }
        match first >> 3 {
            // Multi-Write: any channels, input registers only.
            0b01000 => {
                for group in bytes.chunks_exact(3) {
                    let channel = usize::from(group[0] >> 1 & 3);
                    self.load(now, channel, DacRegister::from_bytes(group[1], group[2]), group[0] & 1 == 0);
                }
            }
            // Sequential Write from a channel to D, and Single Write: EEPROM as well.
            0b01010 | 0b01011 => {
                let start = usize::from(first >> 1 & 3);
                let end = if first >> 3 == 0b01010 { 4 } else { start + 1 };
                let mut written = false;
                for (channel, pair) in (start..end).zip(bytes[1..].chunks_exact(2)) {
                    let register = DacRegister::from_bytes(pair[0], pair[1]);
                    self.load(now, channel, register, first & 1 == 0);
                    self.eeprom[channel] = register;
                    written = true;
                }
                if written {
                    self.program(now);
                }
            }
            // Fast Write from channel A on: codes and power-down only.
            command if command >> 3 == 0 => {
                for (channel, pair) in bytes.chunks_exact(2).take(4).enumerate() {
                    let register = DacRegister {
                        power_down: pair[0] >> 4 & 3,
                        code: u16::from(pair[0] & 0x0F) << 8 | u16::from(pair[1]),
                        ..self.input[channel]
                    };
                    self.load(now, channel, register, true);
                }
            }
            // Write reference, power-down and gain select bits: the driver has no use for them.
            _ => return Err(Nak),
        }
        Ok(())
    }

    fn read(&mut self, now: Time, bytes: &mut [u8]) -> Result<(), Nak> {
        let status = self.frozen.unwrap_or_else(|| self.status(now));
        for (byte, value) in bytes.iter_mut().zip(status.into_iter().cycle()) {
            *byte = value;
        }
        Ok(())
    }

    fn general_call(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak> {
        match bytes.first() {
            Some(0x06) => self.power_on(now),
            Some(0x08) => {
                self.output = self.input;
                self.drive(now);
            }
            Some(0x09) => {
                self.output.iter_mut().chain(&mut self.input).for_each(|r| r.power_down = 0);
                self.drive(now);
            }
            _ => return Err(Nak),
        }
        Ok(())
    }

    fn power_on(&mut self, now: Time) {
        self.input = self.eeprom;
        self.output = self.eeprom;
        self.drive(now);
    }

    fn freeze(&mut self, now: Time, frozen: bool) {
        self.frozen = match (frozen, self.frozen) {
            (true, None) => Some(self.status(now)),
            (true, held) => held,
            (false, _) => None,
        };
    }
}

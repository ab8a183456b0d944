//! The MCP4728 quad 12-bit DAC (Microchip DS22187E) in front of analogue pressure regulators.
//!
//! The steady state knows one command, Multi-Write: it writes input registers and never the EEPROM, which
//! Sequential and Single Write wear out. Internal 2.048 V reference at gain two: 1.000 mV a code.
//!
//! The EEPROM decides what the outputs do when power comes, before any program runs: from the factory half the
//! range, which is half pressure. [`Mcp4728::connect`] therefore refuses a chip whose EEPROM does not say zero (or
//! powered down) on every channel; [`Mcp4728::program_safe_eeprom`] is the remedy.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::i2c::transfer_error;
use super::wiring::{DacChannel, DacWiring};
use super::{HardwareError, Identity, PressureRegulator};
use crate::clock::Clock;
use crate::signal::{PressureSample, RegulatorHealth, RegulatorStatus};

/// Highest code.
pub const CODE_MAX: u16 = 4095;
/// Internal reference, not powered down, gain two; the code's upper four bits go below.
const NORMAL: u8 = 0x90;
/// Longest EEPROM write cycle is 50 ms; after this it has failed.
const EEPROM_LIMIT: Duration = Duration::from_millis(100);
const EEPROM_POLL: Duration = Duration::from_millis(5);

/// One register pair of the status: what the output does, and what it will do when power comes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChannelStatus {
    /// Configuration and code in the input register, as two raw bytes.
    pub register: [u8; 2],
    /// The same in the EEPROM.
    pub eeprom: [u8; 2],
}

impl ChannelStatus {
    /// Whether the output is at zero when power comes: code zero, or powered down.
    pub const fn starts_safe(self) -> bool {
        self.eeprom[0] & 0x60 != 0 || (self.eeprom[0] & 0x0F == 0 && self.eeprom[1] == 0)
    }
}

/// Driver of one MCP4728.
pub struct Mcp4728<I> {
    bus: I,
    clock: Clock,
    address: u8,
    device: Arc<str>,
    /// What the input registers have been told.
    codes: [u16; 4],
    sequence: u32,
}

impl<I: I2c> Mcp4728<I> {
    /// A driver for the chip at `address` (0x60..=0x67) of the bus called `name`; touches nothing yet.
    pub fn new(bus: I, clock: Clock, name: &str, address: u8) -> Self {
        let device = format!("MCP4728 at {address:#04x} on {name}").into();
        Self { bus, clock, address, device, codes: [0; 4], sequence: 0 }
    }

    /// Model, address and bus, as in every message.
    pub fn device(&self) -> &Arc<str> {
        &self.device
    }

    /// Goes on with another handle on the same bus.
    pub fn replace_bus(&mut self, bus: I) {
        self.bus = bus;
    }

    /// Makes sure that an MCP4728 answers, commands zero on every channel as the first frame, and checks that it took
    /// it over and that it also starts at zero when power comes.
    pub fn connect(&mut self) -> Result<Identity, HardwareError> {
        // Reading comes before writing: an MCP4725 would take the zero frame for 56 % of its range.
        self.status()?;
        self.zero()?;
        let status = self.status()?;
        let unsafe_channels: Vec<_> = ('A'..='D').zip(status).filter(|(_, s)| !s.starts_safe()).collect();
        if !unsafe_channels.is_empty() {
            let list: Vec<_> = unsafe_channels
                .iter()
                .map(|(name, s)| format!("{name} at code {}", u16::from_be_bytes([s.eeprom[0] & 0x0F, s.eeprom[1]])))
                .collect();
            return Err(HardwareError::Unsafe {
                device: self.device.clone(),
                reason: format!("when power comes its EEPROM starts channel {}", list.join(", ")),
                remedy: "Cut the supply air, then let `freerig doctor` program the EEPROM to zero".into(),
            });
        }
        self.verify_against(&status)?;
        Ok(Identity { device: self.device.to_string(), ..Identity::default() })
    }

    /// Zero on all four channels, at once.
    pub fn zero(&mut self) -> Result<(), HardwareError> {
        self.write([0; 4])
    }

    /// The general call's reset: every MCP4728 on the bus takes its EEPROM's codes, which [`Mcp4728::connect`] has
    /// found to be zero. For a chip that does not answer to its own address any more; other chips may hear it as well.
    pub fn reset_all(&mut self) -> Result<(), HardwareError> {
        self.bus.write(0x00, &[0x06]).map_err(|error| transfer_error(&self.device, &error))?;
        self.codes = [0; 4];
        Ok(())
    }

    /// Multi-Write of all four channels; each output changes as soon as its bytes have arrived. Codes above
    /// [`CODE_MAX`] are cut to it.
    pub fn write(&mut self, codes: [u16; 4]) -> Result<(), HardwareError> {
        self.multi_write(codes, 0)
    }

    /// The same with all outputs changing at one instant: input registers first, then a general call.
    pub fn write_together(&mut self, codes: [u16; 4]) -> Result<(), HardwareError> {
        self.multi_write(codes, 1)?;
        self.bus.write(0x00, &[0x08]).map_err(|error| transfer_error(&self.device, &error))
    }

    fn multi_write(&mut self, codes: [u16; 4], udac: u8) -> Result<(), HardwareError> {
        let codes = codes.map(|code| code.min(CODE_MAX));
        let mut bytes = [0; 12];
        for (channel, (group, code)) in (0u8..).zip(bytes.chunks_exact_mut(3).zip(codes)) {
            let [high, low] = code.to_be_bytes();
            group.copy_from_slice(&[0x40 | channel << 1 | udac, NORMAL | high, low]);
        }
        self.bus.write(self.address, &bytes).map_err(|error| transfer_error(&self.device, &error))?;
        self.codes = codes;
        Ok(())
    }

    /// The 24 bytes of status, checked: channel by channel, register and EEPROM. An MCP4725, which shares the
    /// address, does not pass.
    pub fn status(&mut self) -> Result<[ChannelStatus; 4], HardwareError> {
        let bytes = self.raw_status()?;
        let mut status = [ChannelStatus::default(); 4];
        for (channel, (slot, pair)) in (0u8..).zip(status.iter_mut().zip(bytes.chunks_exact(6))) {
            // Ready and power-on bits aside: channel, a zero, the address bits.
            let expected = channel << 4 | (self.address & 7);
            if pair[0] & 0x3F != expected || pair[3] & 0x3F != expected {
                return Err(HardwareError::WrongIdentity {
                    device: self.device.clone(),
                    expected: format!("the status of an MCP4728, channel {} marked {expected:#04x}", channel + 1),
                    found: format!("{bytes:02x?} (an MCP4725 shares the address)"),
                });
            }
            *slot = ChannelStatus { register: [pair[1], pair[2]], eeprom: [pair[4], pair[5]] };
        }
        Ok(status)
    }

    /// Reads back what the outputs are told; an error if that is not what was written (a reset, a spoilt transfer).
    pub fn verify(&mut self) -> Result<(), HardwareError> {
        let status = self.status()?;
        self.verify_against(&status)
    }

    fn verify_against(&self, status: &[ChannelStatus; 4]) -> Result<(), HardwareError> {
        let written = self.codes.map(|code| {
            let [high, low] = code.to_be_bytes();
            [NORMAL | high, low]
        });
        let read = status.map(|s| s.register);
        if read == written {
            return Ok(());
        }
        Err(HardwareError::NotTaken {
            device: self.device.clone(),
            what: "its codes",
            written: format!("{written:02x?}"),
            read: format!("{read:02x?}"),
        })
    }

    /// Programs the EEPROM to zero on every channel (one write cycle of its limited number), waits for it and reads
    /// it back. The outputs go to zero as well.
    pub fn program_safe_eeprom(&mut self) -> Result<(), HardwareError> {
        let zero = NORMAL;
        self.bus
            .write(self.address, &[0x50, zero, 0, zero, 0, zero, 0, zero, 0])
            .map_err(|error| transfer_error(&self.device, &error))?;
        self.codes = [0; 4];
        let limit = self.clock.now() + EEPROM_LIMIT;
        // Bit 7 of the first byte: ready.
        while self.raw_status()?[0] & 0x80 == 0 {
            if self.clock.now() >= limit {
                let detail = format!("its EEPROM is still busy {} ms after a write", EEPROM_LIMIT.as_millis());
                return Err(HardwareError::DeviceFault { device: self.device.clone(), detail });
            }
            self.clock.block_until(self.clock.now() + EEPROM_POLL);
        }
        let status = self.status()?;
        if status.iter().all(|s| s.eeprom == [zero, 0]) {
            return Ok(());
        }
        Err(HardwareError::NotTaken {
            device: self.device.clone(),
            what: "its EEPROM",
            written: format!("{:02x?}", [zero, 0]),
            read: format!("{:02x?}", status.map(|s| s.eeprom)),
        })
    }

    /// The regulator behind channel `index` (0 is A), as its measured map `map` has it; the other channels keep
    /// what they were told.
    pub fn regulator(&mut self, index: usize, map: DacChannel) -> AnalogRegulator<'_, I> {
        AnalogRegulator { dac: self, index, map }
    }

    fn raw_status(&mut self) -> Result<[u8; 24], HardwareError> {
        let mut bytes = [0; 24];
        self.bus.read(self.address, &mut bytes).map_err(|error| transfer_error(&self.device, &error))?;
        Ok(bytes)
    }

    /// What is known of the regulator behind `channel` after `code` has been acknowledged.
    pub(super) fn sample(&mut self, map: DacChannel, code: u16) -> PressureSample {
        self.sequence = self.sequence.wrapping_add(1);
        PressureSample {
            time: self.clock.now(),
            sequence: self.sequence,
            pressure: f64::NAN,
            setpoint: pressure_of(map, code),
            status: RegulatorStatus::default(),
            health: RegulatorHealth::Unmeasured,
        }
    }
}

/// The code that makes `pressure`, Pa gauge, by the measured map. Zero, less, or no number at all is code zero:
/// below the regulator's own zero, for certain.
pub fn code_of(map: DacChannel, pressure: f64) -> u16 {
    if pressure > 0.0 && map.pascals_per_code > 0.0 {
        let code = (map.zero_code + pressure / map.pascals_per_code).round();
        code.clamp(0.0, f64::from(CODE_MAX)) as u16
    } else {
        0
    }
}

/// The pressure that `code` stands for, Pa gauge.
pub fn pressure_of(map: DacChannel, code: u16) -> f64 {
    ((f64::from(code) - map.zero_code) * map.pascals_per_code).max(0.0)
}

/// The codes of the channels wired by `wiring` for set-points by FREE, Pa; unwired channels get zero.
pub(super) fn codes_of(wiring: &DacWiring, pressure: &[f64]) -> [u16; 4] {
    wiring.channels.map(|channel| channel.map_or(0, |map| code_of(map, pressure.get(map.free).copied().unwrap_or(0.0))))
}

/// An analogue regulator behind one channel: it takes a set-point and measures nothing.
pub struct AnalogRegulator<'a, I> {
    dac: &'a mut Mcp4728<I>,
    index: usize,
    map: DacChannel,
}

impl<I: I2c> PressureRegulator for AnalogRegulator<'_, I> {
    /// Takes *every* channel of the chip to zero.
    async fn connect(&mut self) -> Result<Identity, HardwareError> {
        self.dac.connect()
    }

    async fn exchange(&mut self, setpoint: f64) -> Result<PressureSample, HardwareError> {
        let mut codes = self.dac.codes;
        let code = code_of(self.map, setpoint);
        if let Some(slot) = codes.get_mut(self.index) {
            *slot = code;
        }
        self.dac.write(codes)?;
        Ok(self.dac.sample(self.map, code))
    }
}

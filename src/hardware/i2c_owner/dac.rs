//! One DAC under its bus owner: set-points out, verified now and then, zero whenever in doubt.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::handle::{Handle, Open};
use super::link::{Link, Standing};
use super::recovery::{DAC_LOST_AFTER, with_retries};
use crate::clock::{Clock, Time};
use crate::hardware::HardwareError;
use crate::hardware::mcp4728::{Mcp4728, codes_of};
use crate::hardware::statistics::DeviceStatistics;
use crate::hardware::wiring::DacWiring;
use crate::signal::{MAX_FREES, PressureSample, RegulatorHealth, RegulatorStatus};

/// How often every DAC is written, changed or not: 0.3 ms of a 400 kHz bus.
pub const DAC_PERIOD: Duration = Duration::from_millis(5);
/// How often the registers are read back (0.6 ms at 400 kHz).
const VERIFY_PERIOD: Duration = Duration::from_millis(500);

pub(super) struct DacSeat<I> {
    pub wiring: DacWiring,
    pub statistics: Arc<DeviceStatistics>,
    /// When it wants its next turn.
    pub due: Time,
    /// Samples of this turn by channel, until they are published.
    pub staged: [Option<PressureSample>; 4],
    name: String,
    link: Link<Mcp4728<Handle<I>>>,
    verified: Time,
    codes: [u16; 4],
    sequence: u32,
}

impl<I: I2c> DacSeat<I> {
    pub fn new(wiring: DacWiring, bus: &str, now: Time) -> Self {
        let device = format!("MCP4728 at {:#04x} on {bus}", wiring.address);
        Self {
            statistics: Arc::new(DeviceStatistics::new(device.into())),
            name: bus.into(),
            wiring,
            due: now,
            staged: [None; 4],
            link: Link::new(DAC_LOST_AFTER, now),
            verified: now,
            codes: [0; 4],
            sequence: 0,
        }
    }

    /// Whether any output is away from zero, as far as is known.
    pub fn is_pressing(&self) -> bool {
        self.codes != [0; 4]
    }

    /// One turn: set-points by FREE, Pa, in one transfer.
    pub fn turn(&mut self, clock: &Clock, open: Open<'_, I>, pressure: &[f64; MAX_FREES]) {
        if self.link.running().is_some() {
            self.write(clock, open, codes_of(&self.wiring, pressure));
        } else {
            self.connect(clock, open);
        }
        self.due = self.due + DAC_PERIOD;
        if self.due <= clock.now() {
            self.due = clock.now() + DAC_PERIOD;
        }
    }

    /// Zero now, and read back: for the end, when nobody commands any more.
    pub fn shut_down(&mut self) -> Result<(), HardwareError> {
        let Some(driver) = self.link.driver() else { return Ok(()) };
        if driver.zero().is_err() {
            // Its own address is not acknowledged: the last that can be tried.
            driver.reset_all()?;
        }
        self.codes = [0; 4];
        driver.verify()
    }

    fn write(&mut self, clock: &Clock, open: Open<'_, I>, codes: [u16; 4]) {
        let Some(driver) = self.link.running() else { return };
        let verify = clock.now().since(self.verified) >= VERIFY_PERIOD;
        let outcome = with_retries(clock, &self.statistics, || {
            // Before the write: it shows what the outputs did since the last one.
            let mismatch = if verify { driver.verify().err() } else { None };
            driver.write(codes)?;
            mismatch.map_or(Ok(()), Err)
        });
        let status = match outcome {
            Ok(()) => RegulatorStatus::default(),
            // It answers, and has just been told again; that it had lost its codes must not go unseen.
            Err(HardwareError::NotTaken { .. }) => {
                self.statistics.resets.increment();
                RegulatorStatus::ECHO_MISMATCH
            }
            Err(_) => {
                let standing = self.link.climb(clock, open, &self.statistics);
                self.say_if_lost(standing, clock);
                return;
            }
        };
        if verify && status == RegulatorStatus::default() {
            self.verified = clock.now();
        }
        self.statistics.reads.increment();
        self.link.succeeded();
        self.codes = codes;
        self.stage(clock.now(), RegulatorHealth::Unmeasured, status);
    }

    fn connect(&mut self, clock: &Clock, open: Open<'_, I>) {
        let (name, address) = (&self.name, self.wiring.address);
        let make = |bus| Mcp4728::new(bus, clock.clone(), name, address);
        match self.link.set_up(clock, open, &self.statistics, make) {
            Standing::Up => {
                self.codes = [0; 4];
                self.verified = clock.now();
                self.stage(clock.now(), RegulatorHealth::Unmeasured, RegulatorStatus::default());
            }
            standing => self.say_if_lost(standing, clock),
        }
    }

    fn say_if_lost(&mut self, standing: Standing, clock: &Clock) {
        if standing == Standing::Lost {
            self.stage(clock.now(), RegulatorHealth::Lost, RegulatorStatus::default());
        }
    }

    /// A sample for every wired channel.
    fn stage(&mut self, time: Time, health: RegulatorHealth, status: RegulatorStatus) {
        self.sequence = self.sequence.wrapping_add(1);
        for (index, slot) in self.staged.iter_mut().enumerate() {
            *slot = self.wiring.channels[index].map(|map| PressureSample {
                time,
                sequence: self.sequence,
                pressure: f64::NAN,
                setpoint: crate::hardware::mcp4728::pressure_of(map, self.codes[index]),
                status,
                health,
            });
        }
    }
}

//! One DAC under its bus owner: set-points out, verified now and then, zero whenever in doubt.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::handle::{Handle, Open};
use super::recovery::{DAC_LOST_AFTER, Recovery, Rung, with_retries};
use crate::clock::{Clock, Time};
use crate::hardware::mcp4728::{Mcp4728, codes_of};
use crate::hardware::statistics::DeviceStatistics;
use crate::hardware::wiring::DacWiring;
use crate::hardware::{HardwareError, Identity};
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
    driver: Option<Mcp4728<Handle<I>>>,
    /// Whether the driver's bus is open.
    open: bool,
    running: bool,
    resume: Time,
    verified: Time,
    recovery: Recovery,
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
            driver: None,
            open: false,
            running: false,
            resume: now,
            verified: now,
            recovery: Recovery::new(DAC_LOST_AFTER),
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
        if self.running {
            self.write(clock, open, codes_of(&self.wiring, pressure));
        } else if clock.now() >= self.resume {
            self.connect(clock, open);
        }
        self.due = self.due + DAC_PERIOD;
        if self.due <= clock.now() {
            self.due = clock.now() + DAC_PERIOD;
        }
    }

    /// Zero now, and read back: for the end, when nobody commands any more.
    pub fn shut_down(&mut self) -> Result<(), HardwareError> {
        let Some(driver) = &mut self.driver else { return Ok(()) };
        if driver.zero().is_err() {
            // Its own address is not acknowledged: the last that can be tried.
            driver.reset_all()?;
        }
        self.codes = [0; 4];
        driver.verify()
    }

    fn write(&mut self, clock: &Clock, open: Open<'_, I>, codes: [u16; 4]) {
        let Some(driver) = &mut self.driver else {
            self.running = false;
            return;
        };
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
                self.climb(clock, open);
                return;
            }
        };
        if verify && status == RegulatorStatus::default() {
            self.verified = clock.now();
        }
        self.statistics.reads.increment();
        self.recovery.succeeded();
        self.codes = codes;
        self.stage(clock.now(), RegulatorHealth::Unmeasured, status);
    }

    fn connect(&mut self, clock: &Clock, open: Open<'_, I>) {
        match self.try_connect(clock, open) {
            Ok(identity) => {
                self.statistics.note_connected(identity);
                self.running = true;
                self.codes = [0; 4];
                self.verified = clock.now();
                self.recovery.succeeded();
                self.stage(clock.now(), RegulatorHealth::Unmeasured, RegulatorStatus::default());
            }
            Err(error) => {
                self.statistics.note_error(&error);
                self.climb(clock, open);
                self.resume = clock.now() + self.recovery.pace(clock.now());
            }
        }
    }

    fn try_connect(&mut self, clock: &Clock, open: Open<'_, I>) -> Result<Identity, HardwareError> {
        let driver = match &mut self.driver {
            Some(driver) => driver,
            none => {
                let bus = Handle::on(open()?);
                self.open = true;
                none.insert(Mcp4728::new(bus, clock.clone(), &self.name, self.wiring.address))
            }
        };
        driver.connect()
    }

    fn climb(&mut self, clock: &Clock, open: Open<'_, I>) {
        let was_lost = self.recovery.is_lost();
        let rung = self.recovery.failed(clock.now(), clock.now());
        if (matches!(rung, Rung::Reopen | Rung::Lost) || !self.open)
            && let Some(driver) = &mut self.driver
        {
            self.open = Handle::renew(open, &self.statistics, |bus| driver.replace_bus(bus));
        }
        if matches!(rung, Rung::Restart | Rung::Lost) {
            // From here the way back leads through `connect`: its first frame is zero.
            self.running = false;
            self.resume = clock.now() + self.recovery.pace(clock.now());
        }
        if rung == Rung::Lost {
            if !was_lost {
                self.statistics.losses.increment();
            }
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

//! One IMU under its bus owner: set-up without blocking, reading, recovery, and what is published meanwhile.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::handle::{Handle, Open};
use super::recovery::{IMU_LOST_AFTER, Recovery, Rung, with_retries};
use crate::clock::{Clock, Time};
use crate::hardware::bno055::{Bno055, Progress};
use crate::hardware::gpio::ResetLine;
use crate::hardware::profile::ProfileDesk;
use crate::hardware::statistics::DeviceStatistics;
use crate::hardware::wiring::ImuWiring;
use crate::hardware::{HardwareError, Imu, Reading};
use crate::signal::{ImuHealth, ImuSample};

/// A sensor whose frame has not changed in any bit for this long is stuck: the noise of its own accelerometer
/// moves the last bits of nearly every frame.
const STUCK_AFTER: Duration = Duration::from_millis(500);

/// Period of the chip's fusion frames, by its own oscillator.
const FRAME: Duration = Duration::from_millis(10);
/// How long the reset line is pulled (20 ns would do), and how long the chip takes from there, typically, until it
/// answers.
const PULL: Duration = Duration::from_millis(5);
const START: Duration = Duration::from_millis(650);

pub(super) struct ImuSeat<I> {
    pub wiring: ImuWiring,
    pub statistics: Arc<DeviceStatistics>,
    /// Where its calibration profile is asked for.
    pub profile: Arc<ProfileDesk>,
    /// When it wants its next turn.
    pub due: Time,
    /// Reading of this turn, until it is published.
    pub staged: Option<ImuSample>,
    /// Its reset line, where it is wired.
    pub reset: Option<ResetLine>,
    /// Whether that is being pulled.
    pulled: bool,
    name: String,
    driver: Option<Bno055<Handle<I>>>,
    /// Whether the driver's bus is open.
    open: bool,
    running: bool,
    /// The set-up goes on at this time.
    resume: Time,
    recovery: Recovery,
    /// Latest reading that was good, and when a frame last differed from its predecessor.
    last: ImuSample,
    changed: Time,
    /// Whether it answers, but gives no readings: found reset or stuck, or just back, and being set up.
    answering: bool,
    /// Whether the latest turn brought the same frame again.
    repeated: bool,
    sequence: u32,
}

impl<I: I2c> ImuSeat<I> {
    pub fn new(wiring: ImuWiring, bus: &str, now: Time) -> Self {
        let device = format!("BNO055 at {:#04x} on {bus}", wiring.address);
        Self {
            statistics: Arc::new(DeviceStatistics::new(device.into())),
            profile: Arc::default(),
            name: bus.into(),
            wiring,
            due: now,
            staged: None,
            reset: None,
            pulled: false,
            driver: None,
            open: false,
            running: false,
            resume: now,
            recovery: Recovery::new(IMU_LOST_AFTER),
            last: ImuSample::default(),
            changed: now,
            answering: false,
            repeated: false,
            sequence: 0,
        }
    }

    /// One turn: at most one burst, or one step of the set-up.
    pub fn turn(&mut self, clock: &Clock, open: Open<'_, I>) {
        let begun = clock.now();
        if self.running && self.profile.is_asked() {
            self.save_profile(clock);
        } else if self.running {
            self.read(clock, open);
        } else if begun >= self.resume {
            self.set_up(clock, open);
        }
        if !self.running {
            self.report_absence();
        }
        self.due = self.next_due(clock.now());
    }

    /// A sensor read at its own frame rate is followed like a clock: a little too early each time, and when the
    /// frame has not changed yet, once more soon after. So a reading is 1.5 ms old at most, instead of a frame.
    /// At other periods the phase is kept; turns that have been missed are skipped, not made up for.
    fn next_due(&self, now: Time) -> Time {
        let period = self.wiring.period;
        if self.running && period == FRAME {
            if self.repeated {
                return now + period / 10;
            }
            return (self.due + period - period / 32).max(now + period / 10);
        }
        let due = self.due + period;
        let due = if due > now { due } else { now + period };
        // A step of the set-up, or the end of the ladder, does not wait for the next turn.
        if !self.running && self.resume > now { due.min(self.resume) } else { due }
    }

    fn read(&mut self, clock: &Clock, open: Open<'_, I>) {
        let Some(driver) = &mut self.driver else {
            self.restart(clock.now());
            return;
        };
        let reading = with_retries(clock, &self.statistics, || driver.read());
        self.repeated = reading == Ok(Reading::Repeated);
        match reading {
            Ok(Reading::Fresh(sample)) => {
                self.statistics.reads.increment();
                self.recovery.succeeded();
                self.changed = sample.time;
                self.last = sample;
                self.stage(sample);
            }
            Ok(Reading::Repeated) => {
                self.statistics.repeats.increment();
                let silence = clock.now().since(self.changed);
                if silence > STUCK_AFTER {
                    self.statistics.note_error(&HardwareError::Malformed {
                        device: self.statistics.device.clone(),
                        detail: format!("its readings have not changed for {} ms", STUCK_AFTER.as_millis()),
                    });
                    self.answering = true;
                    self.restart(clock.now());
                }
            }
            Ok(Reading::Implausible(sample, _)) => {
                self.statistics.implausible.increment();
                self.recovery.succeeded();
                self.changed = sample.time;
                self.stage(sample);
            }
            Ok(Reading::Reset) => {
                self.statistics.resets.increment();
                self.answering = true;
                // The driver knows how much of the set-up it takes.
                (self.running, self.resume) = (false, clock.now());
            }
            Err(_) => self.climb(clock, open),
        }
    }

    /// Reads the profile that the sensor has found; the next reading is one of a new frame.
    fn save_profile(&mut self, clock: &Clock) {
        let Some(driver) = &mut self.driver else { return };
        self.profile.answer(driver.save_profile());
        self.changed = clock.now();
    }

    /// The next step of the set-up.
    fn set_up(&mut self, clock: &Clock, open: Open<'_, I>) {
        if std::mem::take(&mut self.pulled) {
            self.drive_reset(false);
            if let Some(driver) = &mut self.driver {
                driver.was_reset();
            }
            self.resume = clock.now() + START;
            return;
        }
        let Some(driver) = &mut self.driver else {
            match open() {
                Ok(bus) => {
                    let (address, profile) = (self.wiring.address, self.wiring.profile);
                    self.open = true;
                    self.driver = Some(Bno055::new(Handle::on(bus), clock.clone(), &self.name, address, profile));
                }
                Err(error) => {
                    self.statistics.note_error(&error);
                    self.fail(clock.now());
                    self.resume = clock.now() + self.recovery.pace(clock.now());
                }
            }
            return;
        };
        match driver.advance() {
            Ok(Progress::Wait(until)) => {
                self.answering = true;
                self.resume = until;
            }
            Ok(Progress::Silent(until)) => self.resume = until,
            Ok(Progress::Running(identity)) => {
                self.statistics.note_connected(identity);
                self.running = true;
                self.answering = false;
                self.changed = clock.now();
            }
            Err(error) => {
                self.statistics.note_error(&error);
                self.resume = clock.now() + self.recovery.pace(clock.now());
                self.climb(clock, open);
            }
        }
    }

    fn climb(&mut self, clock: &Clock, open: Open<'_, I>) {
        self.answering = false;
        let rung = self.fail(clock.now());
        if (matches!(rung, Rung::Reopen | Rung::Lost) || !self.open)
            && let Some(driver) = &mut self.driver
        {
            self.open = Handle::renew(open, &self.statistics, |bus| driver.replace_bus(bus));
        }
        if matches!(rung, Rung::Restart | Rung::Lost) {
            let paced = self.resume.max(clock.now());
            self.restart(clock.now());
            if rung == Rung::Lost {
                self.resume = paced.max(clock.now() + self.recovery.pace(clock.now()));
            }
            if self.reset.is_some() {
                self.drive_reset(true);
                self.pulled = true;
                self.statistics.pulls.increment();
                self.resume = clock.now() + PULL;
            }
        }
    }

    /// Pulls the reset line, or lets go of it; what fails is told with the statistics.
    fn drive_reset(&mut self, pull: bool) {
        if let Some(Err(error)) = self.reset.as_mut().map(|line| line(pull)) {
            self.statistics.note_error(&error);
        }
    }

    /// Counts a loss once, when the end of the ladder is reached.
    fn fail(&mut self, now: Time) -> Rung {
        let was_lost = self.recovery.is_lost();
        let good = if self.running { self.changed } else { now };
        let rung = self.recovery.failed(good, now);
        if rung == Rung::Lost && !was_lost {
            self.statistics.losses.increment();
        }
        rung
    }

    fn restart(&mut self, now: Time) {
        self.running = false;
        self.resume = now;
        if let Some(driver) = &mut self.driver {
            driver.restart();
        }
    }

    /// Without readings the slot says why, every period: the latest good values under their own time, marked. Of
    /// a chip that does not answer it says nothing until that is lost: its silence speaks for itself.
    fn report_absence(&mut self) {
        let health = match self.recovery.is_lost() {
            true => ImuHealth::Lost,
            // Before the first reading there is nothing that could be missed.
            false if !self.answering || self.last.health == ImuHealth::Absent => return,
            false => ImuHealth::Restarting,
        };
        self.stage(ImuSample { health, ..self.last });
    }

    fn stage(&mut self, mut sample: ImuSample) {
        self.sequence = self.sequence.wrapping_add(1);
        sample.sequence = self.sequence;
        self.staged = Some(sample);
    }
}

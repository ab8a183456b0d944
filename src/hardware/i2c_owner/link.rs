//! A DAC or an ADC as its bus owner reaches it: whether its bus is open, whether it is set up, and where it stands on
//! the recovery ladder.

use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::handle::{Handle, Open};
use super::recovery::{Recovery, Rung};
use crate::clock::{Clock, Time};
use crate::hardware::ads1115::Ads1115;
use crate::hardware::mcp4728::Mcp4728;
use crate::hardware::statistics::DeviceStatistics;
use crate::hardware::{HardwareError, Identity};

/// A driver that the ladder can set up anew, on its old bus or on another.
pub(super) trait Device<I> {
    /// Finds the device and sets it up.
    fn connect(&mut self) -> Result<Identity, HardwareError>;
    /// Goes on with `bus`.
    fn replace_bus(&mut self, bus: Handle<I>);
}

impl<I: I2c> Device<I> for Mcp4728<Handle<I>> {
    fn connect(&mut self) -> Result<Identity, HardwareError> {
        Mcp4728::connect(self)
    }

    fn replace_bus(&mut self, bus: Handle<I>) {
        Mcp4728::replace_bus(self, bus);
    }
}

impl<I: I2c> Device<I> for Ads1115<Handle<I>> {
    fn connect(&mut self) -> Result<Identity, HardwareError> {
        Ads1115::connect(self)
    }

    fn replace_bus(&mut self, bus: Handle<I>) {
        Ads1115::replace_bus(self, bus);
    }
}

/// How a device stands after an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    /// Set up.
    Up,
    /// Not yet, or not for now.
    Down,
    /// At the end of the ladder.
    Lost,
}

/// The way to one device.
#[derive(Debug)]
pub(super) struct Link<D> {
    /// None before its bus has been opened for the first time.
    driver: Option<D>,
    /// Whether the driver's bus is open.
    open: bool,
    running: bool,
    resume: Time,
    recovery: Recovery,
}

impl<D> Link<D> {
    /// To a device that is lost once it has failed for `lost_after`; to be set up from `now` on.
    pub fn new(lost_after: Duration, now: Time) -> Self {
        Self { driver: None, open: false, running: false, resume: now, recovery: Recovery::new(lost_after) }
    }

    /// The driver of a device that is set up.
    pub fn running(&mut self) -> Option<&mut D> {
        self.driver.as_mut().filter(|_| self.running)
    }

    /// The driver, however the device stands.
    pub fn driver(&mut self) -> Option<&mut D> {
        self.driver.as_mut()
    }

    /// The device works.
    pub fn succeeded(&mut self) {
        self.recovery.succeeded();
    }

    /// Sets the device up where that is due; `make` gives it its driver when its bus is opened for the first time.
    pub fn set_up<I: I2c>(
        &mut self,
        clock: &Clock,
        open: Open<'_, I>,
        statistics: &DeviceStatistics,
        make: impl FnOnce(Handle<I>) -> D,
    ) -> Standing
    where
        D: Device<I>,
    {
        if clock.now() < self.resume {
            return Standing::Down;
        }
        let connected = match &mut self.driver {
            Some(driver) => driver.connect(),
            none => open().and_then(|bus| {
                self.open = true;
                none.insert(make(Handle::on(bus))).connect()
            }),
        };
        match connected {
            Ok(identity) => {
                statistics.note_connected(identity);
                self.running = true;
                self.recovery.succeeded();
                Standing::Up
            }
            Err(error) => {
                statistics.note_error(&error);
                let standing = self.climb(clock, open, statistics);
                self.resume = clock.now() + self.recovery.pace(clock.now());
                standing
            }
        }
    }

    /// The device has failed: does what is due.
    pub fn climb<I: I2c>(&mut self, clock: &Clock, open: Open<'_, I>, statistics: &DeviceStatistics) -> Standing
    where
        D: Device<I>,
    {
        let was_lost = self.recovery.is_lost();
        let rung = self.recovery.failed(clock.now(), clock.now());
        if (matches!(rung, Rung::Reopen | Rung::Lost) || !self.open)
            && let Some(driver) = &mut self.driver
        {
            self.open = Handle::renew(open, statistics, |bus| driver.replace_bus(bus));
        }
        if matches!(rung, Rung::Restart | Rung::Lost) {
            // From here the way back leads through `set_up`.
            self.running = false;
            self.resume = clock.now() + self.recovery.pace(clock.now());
        }
        if rung != Rung::Lost {
            return Standing::Down;
        }
        if !was_lost {
            statistics.losses.increment();
        }
        Standing::Lost
    }
}

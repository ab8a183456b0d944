//! One ADC under its bus owner: a channel a turn, begun in one turn and fetched in the next.

use std::sync::Arc;
use std::time::Duration;

use embedded_hal::i2c::I2c;

use super::handle::{Handle, Open};
use super::link::{Link, Standing};
use super::recovery::{ADC_LOST_AFTER, with_retries};
use crate::clock::{Clock, Time};
use crate::hardware::ads1115::{Ads1115, CONVERSION_TIME};
use crate::hardware::statistics::DeviceStatistics;
use crate::hardware::wiring::AdcWiring;
use crate::signal::{PressureSample, RegulatorHealth, RegulatorStatus};

/// One channel is read every so often: with n sensors a chip, each comes in n times this.
pub const ADC_TURN: Duration = Duration::from_millis(5);

pub(super) struct AdcSeat<I> {
    pub wiring: AdcWiring,
    pub statistics: Arc<DeviceStatistics>,
    /// When it wants its next turn.
    pub due: Time,
    /// Samples of this turn by channel, until they are published.
    pub staged: [Option<PressureSample>; 4],
    name: String,
    link: Link<Ads1115<Handle<I>>>,
    /// The channel under conversion, and since when.
    channel: usize,
    begun: Time,
    sequence: u32,
}

impl<I: I2c> AdcSeat<I> {
    pub fn new(wiring: AdcWiring, bus: &str, now: Time) -> Self {
        let device = format!("ADS1115 at {:#04x} on {bus}", wiring.address);
        Self {
            statistics: Arc::new(DeviceStatistics::new(device.into())),
            name: bus.into(),
            wiring,
            due: now,
            staged: [None; 4],
            link: Link::new(ADC_LOST_AFTER, now),
            channel: 0,
            begun: now,
            sequence: 0,
        }
    }

    /// One turn: fetches a conversion and begins the next.
    pub fn turn(&mut self, clock: &Clock, open: Open<'_, I>) {
        if self.link.running().is_some() {
            self.read(clock, open);
        } else {
            self.connect(clock, open);
        }
        self.due = self.due + ADC_TURN;
        if self.due <= clock.now() {
            self.due = clock.now() + ADC_TURN;
        }
    }

    fn read(&mut self, clock: &Clock, open: Open<'_, I>) {
        let Some(driver) = self.link.running() else { return };
        let channel = self.channel;
        match with_retries(clock, &self.statistics, || driver.finish(channel)) {
            Ok(volts) => {
                self.statistics.reads.increment();
                self.link.succeeded();
                if let Some(map) = self.wiring.channels[channel] {
                    let pressure = map.pascals_per_volt * (volts - map.zero_volts);
                    self.stage(channel, self.begun + CONVERSION_TIME, pressure, RegulatorHealth::Good);
                }
                self.begin(self.next(channel), clock);
            }
            Err(_) => {
                // It may have been reset: the same channel anew, whatever else is tried.
                self.begin(channel, clock);
                let standing = self.link.climb(clock, open, &self.statistics);
                self.say_if_lost(standing, clock);
            }
        }
    }

    /// The wired channel after `channel`.
    fn next(&self, channel: usize) -> usize {
        (1..=4).map(|i| (channel + i) % 4).find(|&i| self.wiring.channels[i].is_some()).unwrap_or(channel)
    }

    /// A failure to begin shows when the conversion is fetched.
    fn begin(&mut self, channel: usize, clock: &Clock) {
        if let Some(driver) = self.link.driver() {
            let _ = driver.start(channel);
        }
        (self.channel, self.begun) = (channel, clock.now());
    }

    fn connect(&mut self, clock: &Clock, open: Open<'_, I>) {
        let (name, address) = (&self.name, self.wiring.address);
        match self.link.set_up(clock, open, &self.statistics, |bus| Ads1115::new(bus, name, address)) {
            Standing::Up => self.begin(self.next(3), clock),
            standing => self.say_if_lost(standing, clock),
        }
    }

    fn say_if_lost(&mut self, standing: Standing, clock: &Clock) {
        if standing == Standing::Lost {
            for channel in 0..4 {
                self.stage(channel, clock.now(), f64::NAN, RegulatorHealth::Lost);
            }
        }
    }

    fn stage(&mut self, channel: usize, time: Time, pressure: f64, health: RegulatorHealth) {
        self.sequence = self.sequence.wrapping_add(1);
        self.staged[channel] = self.wiring.channels[channel].map(|_| PressureSample {
            time,
            sequence: self.sequence,
            pressure,
            setpoint: f64::NAN,
            status: RegulatorStatus::default(),
            health,
        });
    }
}

//! The owner of one I2C bus: set-points to its DACs first, then the ADCs and one burst from each IMU that is due.
//!
//! Live it is a thread ([`I2cOwner::run`]). On the stepped clock a scheduler calls [`I2cOwner::cycle`] at
//! [`I2cOwner::next_due`]: the transfers run the owner's clock ahead to [`I2cOwner::busy_until`], and when
//! everybody else has arrived there, [`I2cOwner::publish`] hands out what was read.
//!
//! A command older than the rig's `command_timeout` counts as zero, and so does a vent; both are looked for again
//! between any two transfers. A set-up, which takes most of a second, never holds the bus: a step of it takes
//! a few transfers, and the waiting in between is everybody's.

mod adc;
mod dac;
mod handle;
mod imu;
mod link;
mod recovery;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use embedded_hal::i2c::I2c;
use triple_buffer::{Input, Output};

pub use self::adc::ADC_TURN;
use self::adc::AdcSeat;
pub use self::dac::DAC_PERIOD;
use self::dac::DacSeat;
use self::imu::ImuSeat;
pub use self::recovery::IMU_LOST_AFTER;
use super::HardwareError;
use super::gpio::ResetLine;
use super::profile::ProfileDesk;
use super::statistics::DeviceStatistics;
use super::wiring::I2cWiring;
use crate::clock::{Clock, Time};
use crate::signal::{Command, ImuSample, MAX_FREES, PressureSample};

/// The latest-value slots of one owner.
pub struct I2cPorts {
    /// Where the tick's command arrives.
    pub command: Output<Command>,
    /// Where readings go, by FREE.
    pub imu: Vec<(usize, Input<ImuSample>)>,
    /// Where the samples of DAC channels go, by FREE.
    pub pressure: Vec<(usize, Input<PressureSample>)>,
    /// Where the readings of pressure sensors go, by FREE.
    pub sensor: Vec<(usize, Input<PressureSample>)>,
}

/// Opens the bus; called once for every device, and again when a device is to be recovered.
pub type OpenBus<I> = Box<dyn FnMut() -> Result<I, HardwareError> + Send>;

/// The owner of one bus.
pub struct I2cOwner<I: I2c> {
    clock: Clock,
    command_timeout: Duration,
    open: OpenBus<I>,
    ports: I2cPorts,
    dacs: Vec<DacSeat<I>>,
    adcs: Vec<AdcSeat<I>>,
    imus: Vec<ImuSeat<I>>,
}

impl<I: I2c> I2cOwner<I> {
    /// An owner that has not touched its bus yet: devices are set up, one step a turn, from the first cycle on.
    /// On a stepped clock `clock` is a fork of its own, and the simulated bus has a clone of it.
    pub fn new(
        wiring: &I2cWiring,
        command_timeout: Duration,
        clock: Clock,
        open: impl FnMut() -> Result<I, HardwareError> + Send + 'static,
        ports: I2cPorts,
    ) -> Self {
        let now = clock.now();
        let name = wiring.device.display().to_string();
        Self {
            command_timeout,
            open: Box::new(open),
            ports,
            dacs: wiring.dacs.iter().map(|w| DacSeat::new(w.clone(), &name, now)).collect(),
            adcs: wiring.adcs.iter().map(|w| AdcSeat::new(w.clone(), &name, now)).collect(),
            imus: wiring.imus.iter().map(|w| ImuSeat::new(w.clone(), &name, now)).collect(),
            clock,
        }
    }

    /// Has the IMU at `address` reset by `line` where nothing else brings it back.
    pub fn attach_reset(&mut self, address: u8, line: ResetLine) {
        if let Some(seat) = self.imus.iter_mut().find(|seat| seat.wiring.address == address) {
            seat.reset = Some(line);
        }
    }

    /// What happens to each device, for `status`: DACs first, then ADCs, then IMUs, in the order of rig.toml.
    pub fn statistics(&self) -> Vec<Arc<DeviceStatistics>> {
        let adcs = self.adcs.iter().map(|a| a.statistics.clone());
        self.dacs
            .iter()
            .map(|d| d.statistics.clone())
            .chain(adcs)
            .chain(self.imus.iter().map(|i| i.statistics.clone()))
            .collect()
    }

    /// Where the profile of each IMU is asked for, by the FREEs that it serves.
    pub fn profiles(&self) -> impl Iterator<Item = (&[usize], &Arc<ProfileDesk>)> {
        self.imus.iter().map(|seat| (seat.wiring.frees.as_slice(), &seat.profile))
    }

    /// When the next device wants its turn.
    pub fn next_due(&self) -> Time {
        self.dacs
            .iter()
            .map(|d| d.due)
            .chain(self.adcs.iter().map(|a| a.due))
            .chain(self.imus.iter().map(|i| i.due))
            .min()
            .unwrap_or(Time::from_nanos(u64::MAX))
    }

    /// Until when the latest cycle keeps the bus: the owner's own time.
    pub fn busy_until(&self) -> Time {
        self.clock.now()
    }

    /// Gives every device that is due its turn.
    pub fn cycle(&mut self) {
        let now = self.clock.now();
        self.serve_dacs();
        for index in 0..self.adcs.len() {
            if self.adcs[index].due <= now {
                self.adcs[index].turn(&self.clock, &mut self.open);
                self.pre_empt();
            }
        }
        for index in 0..self.imus.len() {
            if self.imus[index].due <= now {
                self.imus[index].turn(&self.clock, &mut self.open);
                self.pre_empt();
            }
        }
    }

    /// Hands out what the latest cycle has read.
    pub fn publish(&mut self) {
        for seat in &mut self.imus {
            let Some(sample) = seat.staged.take() else { continue };
            for (free, slot) in &mut self.ports.imu {
                if seat.wiring.frees.contains(free) {
                    slot.write(sample);
                }
            }
        }
        for seat in &mut self.dacs {
            let frees = seat.wiring.channels.map(|channel| channel.map(|channel| channel.free));
            hand_out(frees, &mut seat.staged, &mut self.ports.pressure);
        }
        for seat in &mut self.adcs {
            let frees = seat.wiring.channels.map(|channel| channel.map(|channel| channel.free));
            hand_out(frees, &mut seat.staged, &mut self.ports.sensor);
        }
    }

    /// The owner's thread: cycles until `stop`, then takes every output to zero and reads that back.
    pub fn run(mut self, stop: &AtomicBool) -> Result<(), HardwareError> {
        while !stop.load(Ordering::Relaxed) {
            self.cycle();
            self.publish();
            // A bus without devices still has to notice the stop.
            self.clock.block_until(self.next_due().min(self.clock.now() + Duration::from_millis(100)));
        }
        self.shut_down()
    }

    /// Takes every output to zero and reads that back; every DAC is tried, the first failure is returned.
    pub fn shut_down(&mut self) -> Result<(), HardwareError> {
        self.dacs.iter_mut().map(DacSeat::shut_down).fold(Ok(()), Result::and)
    }

    fn serve_dacs(&mut self) {
        let now = self.clock.now();
        for index in 0..self.dacs.len() {
            if self.dacs[index].due <= now {
                let pressure = self.setpoints();
                self.dacs[index].turn(&self.clock, &mut self.open, &pressure);
            }
        }
    }

    /// A vent, or a command grown too old, does not wait for its turn.
    fn pre_empt(&mut self) {
        if self.dacs.iter().any(DacSeat::is_pressing) && self.setpoints() == [0.0; MAX_FREES] {
            for seat in self.dacs.iter_mut().filter(|seat| seat.is_pressing()) {
                seat.turn(&self.clock, &mut self.open, &[0.0; MAX_FREES]);
            }
        }
    }

    /// Set-points by FREE, Pa: the tick's, or zero.
    fn setpoints(&mut self) -> [f64; MAX_FREES] {
        let command = *self.ports.command.read();
        if command.vent || self.clock.now().since(command.time) > self.command_timeout {
            return [0.0; MAX_FREES];
        }
        command.pressure
    }
}

/// Hands the samples `staged` by channel to the slots of their FREEs.
fn hand_out(
    frees: [Option<usize>; 4],
    staged: &mut [Option<PressureSample>; 4],
    slots: &mut [(usize, Input<PressureSample>)],
) {
    for (free, staged) in frees.into_iter().zip(staged) {
        let (Some(free), Some(sample)) = (free, staged.take()) else { continue };
        slots.iter_mut().filter(|(of, _)| *of == free).for_each(|(_, slot)| slot.write(sample));
    }
}

/// An owner that ends, even by a panic, leaves zero behind.
impl<I: I2c> Drop for I2cOwner<I> {
    fn drop(&mut self) {
        for seat in &mut self.dacs {
            // Nobody is left to be told; the unit's ExecStopPost vents again and verifies.
            let _ = seat.shut_down();
        }
    }
}

//! The rig on the stepped clock: one scheduler, one thread, fixed order, as fast as the machine can.
//!
//! At each event, in this order: I2C owners (they publish what they have read once everybody has caught up with
//! their transfers, then take their next turn), the valve's owner, the contacts, the serial owners (polled until they
//! wait), the tick. Plant and chips advance when they are asked. The same seed gives the same bits.

use std::collections::BTreeMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Waker};
use std::time::Duration;

use rtrb::Producer;
use triple_buffer::Input;

use super::join::{Joints, join, simulated};
use super::tick::{Switches, Tick};
use super::{Bench, DaemonError, Pump};
use crate::clock::{Clock, Stepper, Time};
use crate::config::Rig;
use crate::control::Request;
use crate::hardware::gpio::{self, Contact, ContactWatch, GpioValve};
use crate::hardware::wiring::I2cWiring;
use crate::hardware::{DeviceStatistics, I2cOwner, ProfileDesk, SerialOwner, ValveOwner};
use crate::record::Recorder;
use crate::rt::{Schedule, Timing};
use crate::signal::{TickRecord, Trim};
use crate::sim::chips::SimI2c;
use crate::sim::{Hand, SimInput, SimOutput, SimRig};

type SerialTask = Pin<Box<dyn Future<Output = ()>>>;

/// An I2C owner, and whether its latest readings still wait to be handed out.
struct I2cTurn {
    owner: I2cOwner<SimI2c>,
    staged: bool,
}

impl I2cTurn {
    /// When it wants to be looked at again.
    fn next(&self) -> Time {
        if self.staged { self.owner.busy_until() } else { self.owner.next_due() }
    }

    fn turn(&mut self, now: Time) {
        if self.staged && self.owner.busy_until() <= now {
            self.owner.publish();
            self.staged = false;
        }
        if !self.staged && self.owner.next_due() <= now {
            self.owner.cycle();
            self.staged = true;
        }
    }
}

/// A simulated rig on the stepped clock.
pub struct Stepped {
    stepper: Stepper,
    sim: SimRig,
    i2c: Vec<I2cTurn>,
    valve: Option<ValveOwner<GpioValve<SimOutput>>>,
    contacts: Vec<ContactWatch<SimInput>>,
    serial: Vec<SerialTask>,
    stop: Arc<AtomicBool>,
    tick: Tick,
    schedule: Schedule,
    /// How much later than its deadline the next tick wakes up.
    late: Duration,
    pump: Pump,
    requests: Producer<Request>,
    trim: Input<Trim>,
    switches: Arc<Switches>,
    profiles: Profiles,
    devices: Vec<Arc<DeviceStatistics>>,
}

/// By FREE: where its IMU's calibration profile is asked for.
pub(super) type Profiles = BTreeMap<usize, Arc<ProfileDesk>>;

impl Stepped {
    /// The simulated rig of `rig`, at time zero, vented; `rig.bench.seed` is its seed.
    ///
    /// # Errors
    /// If the controller or an owner cannot be built.
    pub fn new(rig: &Rig) -> Result<Self, DaemonError> {
        let stepper = Stepper::new();
        let sim = simulated(rig, &stepper.clock())?;
        let Joints { tick, pump, requests, trim, switches, i2c, serial, valve } =
            join(rig, Some(sim.plant()), Switches::default())?;
        let timeout = rig.wiring.command_timeout;
        let stop = Arc::new(AtomicBool::new(false));
        let mut turns = Vec::new();
        let mut profiles = Profiles::new();
        let mut devices = Vec::new();
        for ((index, wiring), ports) in rig.wiring.i2c.iter().enumerate().zip(i2c) {
            let Some((bus, clock)) = sim.i2c(index) else { continue };
            let mut owner = I2cOwner::new(wiring, timeout, clock, move || Ok(bus.clone()), ports);
            simulate_resets(&mut owner, &sim, index, wiring, &stepper.clock());
            note_profiles(&mut profiles, &owner);
            devices.extend(owner.statistics());
            turns.push(I2cTurn { owner, staged: false });
        }
        let mut tasks: Vec<SerialTask> = Vec::new();
        for ((index, wiring), (command, samples)) in rig.wiring.serial.iter().enumerate().zip(serial) {
            let Some(line) = sim.line(index).cloned() else { continue };
            let clock = stepper.clock();
            let open = {
                let clock = clock.clone();
                move || std::future::ready(SimRig::open_line(&line, &clock))
            };
            let owner = SerialOwner::new(wiring, clock, timeout, open, command, samples, Arc::clone(&stop))?;
            devices.extend(owner.statistics().units.iter().cloned());
            tasks.push(Box::pin(owner.run()));
        }
        let valve =
            valve.map(|command| ValveOwner::new(sim.dump_valve(stepper.clock()), command, stepper.clock(), timeout));
        let contacts = contacts(rig, &switches).map(|(contact, _, flag)| {
            ContactWatch::new(contact, sim.contact(contact, stepper.clock()), flag, stepper.clock())
        });
        let contacts = contacts.collect();
        switches.realtime.store(true, Ordering::Relaxed);
        let period = rig.control.period;
        Ok(Self {
            schedule: Schedule::new(stepper.now() + period, period),
            late: Duration::ZERO,
            stepper,
            sim,
            i2c: turns,
            valve,
            contacts,
            serial: tasks,
            stop,
            tick,
            pump,
            requests,
            trim,
            switches,
            profiles,
            devices,
        })
    }

    /// The simulated devices: to make them misbehave, and to ask for the truth.
    pub fn sim(&self) -> &SimRig {
        &self.sim
    }

    /// The switches that the tick reads.
    pub fn switches(&self) -> &Switches {
        &self.switches
    }

    /// Lets the loop's next wake-up come late by `by`, as on a machine that stalls: everybody else goes on, and the
    /// periods in between are skipped.
    pub fn wake_late(&mut self, by: Duration) {
        self.late = by;
    }

    /// When the loop wakes up next.
    fn due(&self) -> Time {
        self.schedule.deadline() + self.late
    }

    fn next_event(&self) -> Time {
        let owners = self.i2c.iter().map(I2cTurn::next).chain(self.valve.iter().map(ValveOwner::next_due));
        let owners = owners.chain(self.contacts.iter().map(ContactWatch::next_due));
        owners.chain(self.stepper.next_timer()).fold(self.due(), Time::min)
    }

    fn step(&mut self, now: Time) {
        for turn in &mut self.i2c {
            turn.turn(now);
        }
        if let Some(valve) = self.valve.as_mut().filter(|v| v.next_due() <= now) {
            valve.cycle();
        }
        self.contacts.iter_mut().filter(|c| c.next_due() <= now).for_each(ContactWatch::cycle);
        let mut context = Context::from_waker(Waker::noop());
        self.serial.retain_mut(|task| task.as_mut().poll(&mut context).is_pending());
        if self.due() <= now {
            let wake = self.schedule.wake(now);
            self.tick.run(&Timing {
                tick: wake.tick,
                deadline: wake.deadline,
                woke: now,
                latency_ns: u32::try_from(wake.latency.as_nanos()).unwrap_or(u32::MAX),
                execution_ns: 0,
                skipped: wake.skipped,
            });
            self.schedule.finish(now);
            self.late = Duration::ZERO;
            self.pump.turn();
        }
    }
}

impl Drop for Stepped {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
    }
}

impl Bench for Stepped {
    fn now(&self) -> Time {
        self.stepper.now()
    }

    fn request(&mut self, request: Request) -> Result<(), DaemonError> {
        self.requests.push(request).map_err(|_| DaemonError::Busy)
    }

    fn trim(&mut self, trim: Trim) {
        self.trim.write(trim);
    }

    fn pass(&mut self, duration: Duration) -> Result<(), DaemonError> {
        let end = self.stepper.now() + duration;
        loop {
            let next = self.next_event();
            if next > end {
                self.stepper.advance_to(end);
                return Ok(());
            }
            self.stepper.advance_to(next);
            self.step(self.stepper.now());
        }
    }

    fn heartbeat(&mut self) {
        self.switches.heartbeat.set(self.stepper.now());
    }

    fn with_pump<R>(&mut self, look: impl FnOnce(&mut Pump) -> R) -> R {
        look(&mut self.pump)
    }

    fn profile(&self, free: usize) -> Option<Arc<ProfileDesk>> {
        self.profiles.get(&free).cloned()
    }

    fn devices(&self) -> Vec<Arc<DeviceStatistics>> {
        self.devices.clone()
    }

    fn pluck(&mut self, free: usize, hand: &Hand, duration: Duration) {
        let now = self.stepper.now();
        lock(&self.sim.plant()).pluck(free, hand, now, now + duration);
    }

    fn latest(&mut self) -> TickRecord {
        *self.pump.latest()
    }

    fn attach(&mut self, recorder: Recorder) {
        self.pump.attach(recorder);
    }

    fn detach(&mut self) -> Result<Option<Recorder>, DaemonError> {
        detached(self.pump.detach())
    }
}

/// Gives the IMUs of the bus `index` their simulated reset lines, where they are wired.
pub(super) fn simulate_resets(
    owner: &mut I2cOwner<SimI2c>,
    sim: &SimRig,
    index: usize,
    wiring: &I2cWiring,
    clock: &Clock,
) {
    for imu in wiring.imus.iter().filter(|imu| imu.reset.is_some()) {
        if let Some(line) = sim.reset_line(index, imu.address) {
            owner.attach_reset(imu.address, gpio::reset_line(line, clock));
        }
    }
}

/// Notes where the profiles of `owner`'s IMUs are asked for.
pub(super) fn note_profiles<I: embedded_hal::i2c::I2c>(profiles: &mut Profiles, owner: &I2cOwner<I>) {
    for (frees, desk) in owner.profiles() {
        profiles.extend(frees.iter().map(|&free| (free, Arc::clone(desk))));
    }
}

/// The contacts that are wired: which, on what line, and whom they tell.
pub(super) fn contacts(rig: &Rig, switches: &Switches) -> impl Iterator<Item = (Contact, u32, Arc<AtomicBool>)> {
    let gpio = rig.wiring.gpio.as_ref();
    let stop = gpio.and_then(|gpio| gpio.estop).map(|line| (Contact::Stop, line, Arc::clone(&switches.estop_input)));
    let supply =
        gpio.and_then(|gpio| gpio.supply).map(|line| (Contact::Supply, line, Arc::clone(&switches.supply_low)));
    stop.into_iter().chain(supply)
}

/// The recorder, or the error that ended the recording.
pub(super) fn detached(
    (recorder, failure): (Option<Recorder>, Option<crate::record::RecordError>),
) -> Result<Option<Recorder>, DaemonError> {
    match failure {
        Some(error) => Err(error.into()),
        None => Ok(recorder),
    }
}

/// Locks, also after a panic elsewhere: the state behind these locks is valid between any two statements.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

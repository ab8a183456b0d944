//! The rig in real time: one thread for each bus, the real-time thread, and the pump's.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use rtrb::Producer;
use triple_buffer::Input;

use super::join::{Joints, join, simulated};
use super::stepped::{Profiles, contacts, detached, lock, note_profiles, simulate_resets};
use super::tick::Switches;
use super::{Bench, DaemonError, Pump};
use crate::clock::{Clock, Time};
use crate::config::Rig;
use crate::control::{FreeControl, Request};
use crate::hardware::gpio::{self, ContactWatch, GpioValve, OpenPin};
use crate::hardware::serial_line::LineStatistics;
use crate::hardware::wiring::GpioWiring;
use crate::hardware::{DeviceStatistics, DumpValve, I2cOwner, ProfileDesk, SerialOwner, ValveOwner, i2c, serial};
use crate::record::Recorder;
use crate::rt;
use crate::signal::{FreeTick, RegulatorHealth, TickRecord, Trim};
use crate::sim::chips::Pty;
use crate::sim::{Hand, Plant, SimRig};

/// How often the pump takes what waits in the rings.
const PUMP_PERIOD: Duration = Duration::from_millis(20);
/// A reading older than this verifies no vent; six units on the slowest line take a third of it.
const FRESH: Duration = Duration::from_secs(1);
/// A loop that has not ticked for so long has ended.
const LONGEST_STALL: Duration = Duration::from_secs(2);
/// How often a loop that stalls is looked at.
const STALL_LOOK: Duration = Duration::from_millis(2);
/// Bus owners stand this far below the tick on the FIFO scale.
const BELOW_THE_TICK: u8 = 10;

/// What a device of one FREE has counted.
#[derive(Clone, Debug, Default)]
pub struct FreeDevices {
    /// Its IMU.
    pub imu: Option<Arc<DeviceStatistics>>,
    /// Its regulator.
    pub regulator: Option<Arc<DeviceStatistics>>,
    /// The sensor of its pressure, where its regulator has none.
    pub sensor: Option<Arc<DeviceStatistics>>,
    /// The regulator's serial line.
    pub line: Option<Arc<LineStatistics>>,
}

impl FreeDevices {
    fn all(&self) -> impl Iterator<Item = Arc<DeviceStatistics>> {
        [&self.imu, &self.regulator, &self.sensor].into_iter().flatten().cloned()
    }
}

/// A running rig. Dropping it without [`Live::stop`] ends the tick first; the bus owners then command zero and
/// open the dump valve.
pub struct Live {
    bench: LiveBench,
    tick: Option<rt::Handle>,
    /// Owners of the buses and of the valve.
    owners: Vec<JoinHandle<()>>,
    pump: Option<JoinHandle<()>>,
    stop_owners: Arc<AtomicBool>,
    stop_pump: Arc<AtomicBool>,
    devices: Vec<FreeDevices>,
    sim: Option<SimRig>,
    /// The simulated serial lines' plugs.
    ptys: Vec<Mutex<Pty>>,
}

/// A handle on a running rig for one procedure or supervisor.
#[derive(Clone)]
pub struct LiveBench {
    pump: Arc<Mutex<Pump>>,
    requests: Arc<Mutex<Producer<Request>>>,
    trim: Arc<Mutex<Input<Trim>>>,
    switches: Arc<Switches>,
    statistics: Arc<rt::Statistics>,
    clock: Clock,
    profiles: Arc<Profiles>,
    devices: Vec<Arc<DeviceStatistics>>,
    /// The simulated one.
    plant: Option<Arc<Mutex<Plant>>>,
}

impl Live {
    /// Starts the rig of `rig` with `switches`' emergency stop and heartbeat.
    ///
    /// # Errors
    /// If a bus owner, the controller or a thread cannot be made. A device that does not answer is none: it is
    /// the owner's business, and the rig does not leave Boot.
    pub fn start(rig: &Rig, switches: Switches) -> Result<Self, DaemonError> {
        let clock = Clock::Live;
        let sim = rig.is_simulated().then(|| simulated(rig, &clock)).transpose()?;
        let joints = join(rig, sim.as_ref().map(SimRig::plant), switches)?;
        let Joints { mut tick, pump, requests, trim, switches, i2c, serial, valve } = joints;
        let timeout = rig.wiring.command_timeout;
        let stop_owners = Arc::new(AtomicBool::new(false));
        let promote = promotion(rig.realtime.priority);
        let mut owners = Vec::new();
        let mut ptys = Vec::new();
        let mut profiles = Profiles::new();
        let mut devices = vec![FreeDevices::default(); rig.control.frees.len()];

        for ((index, wiring), ports) in rig.wiring.i2c.iter().enumerate().zip(i2c) {
            let stop = Arc::clone(&stop_owners);
            let promote = promote.clone();
            let (thread, statistics) = match sim.as_ref().and_then(|s| Some((s, s.i2c(index)?))) {
                Some((sim, (bus, here))) => {
                    let mut owner = I2cOwner::new(wiring, timeout, here, move || Ok(bus.clone()), ports);
                    simulate_resets(&mut owner, sim, index, wiring, &clock);
                    let statistics = owner.statistics();
                    note_profiles(&mut profiles, &owner);
                    (named(&wiring.name, move || serve_i2c(owner, &stop, promote))?, statistics)
                }
                None => {
                    let device = wiring.device.clone();
                    let mut owner = I2cOwner::new(wiring, timeout, clock.fork(), move || i2c::open(&device), ports);
                    for (imu, line) in wiring.imus.iter().filter_map(|imu| Some((imu, imu.reset?))) {
                        if let Some(gpio) = &rig.wiring.gpio {
                            owner.attach_reset(imu.address, gpio::reset_line(output(gpio, line), &clock));
                        }
                    }
                    let statistics = owner.statistics();
                    note_profiles(&mut profiles, &owner);
                    (named(&wiring.name, move || serve_i2c(owner, &stop, promote))?, statistics)
                }
            };
            owners.push(thread);
            // Statistics come in the order of the wiring: DACs, ADCs, then IMUs.
            let (dacs, rest) = statistics.split_at(wiring.dacs.len());
            let (adcs, imus) = rest.split_at(wiring.adcs.len());
            for (wiring, statistics) in wiring.dacs.iter().zip(dacs) {
                for channel in wiring.channels.iter().flatten() {
                    note(&mut devices, channel.free, |d| d.regulator = Some(Arc::clone(statistics)));
                }
            }
            for (wiring, statistics) in wiring.adcs.iter().zip(adcs) {
                for channel in wiring.channels.iter().flatten() {
                    note(&mut devices, channel.free, |d| d.sensor = Some(Arc::clone(statistics)));
                }
            }
            for (wiring, statistics) in wiring.imus.iter().zip(imus) {
                for &free in &wiring.frees {
                    note(&mut devices, free, |d| d.imu = Some(Arc::clone(statistics)));
                }
            }
        }

        for ((index, wiring), (command, samples)) in rig.wiring.serial.iter().enumerate().zip(serial) {
            let mut wiring = wiring.clone();
            if let Some(sim) = &sim {
                let link = rig.record.directory.join(format!(".sim-{}-{}", std::process::id(), wiring.name));
                let pty = std::fs::create_dir_all(&rig.record.directory)
                    .and_then(|()| sim.pty(index, &link, Arc::new(promote.clone())))
                    .map_err(|error| DaemonError::Io {
                        what: format!("the simulated serial line {} cannot be put at {}", wiring.name, link.display()),
                        error,
                    })?;
                wiring.device = pty.path().to_owned();
                ptys.push(pty);
            }
            let opened = wiring.clone();
            let open = move || std::future::ready(serial::open(&opened));
            let stop = Arc::clone(&stop_owners);
            let owner = SerialOwner::new(&wiring, clock.fork(), timeout, open, command, samples, stop)?;
            // Alicat units, then PWM outputs: FREE, and whether it is a gauge.
            let units = wiring.units.iter().map(|unit| (unit.free, unit.gauge));
            let units = units.chain(wiring.pwms.iter().map(|pwm| (pwm.channel.free, false)));
            for ((free, gauge), statistics) in units.zip(&owner.statistics().units) {
                let line = Arc::clone(&owner.statistics().line);
                let statistics = Some(Arc::clone(statistics));
                note(&mut devices, free, |d| {
                    d.line = Some(line);
                    if gauge { d.sensor = statistics } else { d.regulator = statistics }
                });
            }
            let thread = serial::spawn(&wiring.name, owner, promote.clone()).map_err(thread_failed)?;
            owners.push(thread);
        }

        let wired = rig.wiring.gpio.as_ref();
        if let Some(command) = valve {
            let (stop, promote, here) = (Arc::clone(&stop_owners), promote.clone(), clock.fork());
            let thread = match (&sim, wired.and_then(|gpio| Some((gpio, gpio.dump_valve?)))) {
                (Some(sim), _) => {
                    let owner = ValveOwner::new(sim.dump_valve(clock.fork()), command, here, timeout);
                    Some(named("dump-valve", move || serve_valve(owner, &stop, promote))?)
                }
                (None, Some((gpio, line))) => {
                    let heartbeat = gpio.heartbeat.map(|line| output(gpio, line));
                    let valve = GpioValve::new(output(gpio, line), heartbeat, &clock);
                    let owner = ValveOwner::new(valve, command, here, timeout);
                    Some(named("dump-valve", move || serve_valve(owner, &stop, promote))?)
                }
                (None, None) => None,
            };
            owners.extend(thread);
        }
        for (contact, line, flag) in contacts(rig, &switches) {
            let (stop, here) = (Arc::clone(&stop_owners), clock.fork());
            owners.push(match (&sim, wired) {
                (Some(sim), _) => {
                    let watch = ContactWatch::new(contact, sim.contact(contact, clock.fork()), flag, here);
                    named("contact", move || watch.run(&stop))?
                }
                (None, gpio) => {
                    let chip = gpio.map(|gpio| gpio.chip.clone()).unwrap_or_default();
                    let open: OpenPin<_> = Box::new(move || gpio::input(&chip, line));
                    let watch = ContactWatch::new(contact, open, flag, here);
                    named("contact", move || watch.run(&stop))?
                }
            });
        }

        let realtime = rt::Realtime {
            period: rig.control.period,
            priority: Some(rig.realtime.priority),
            cpu: rig.realtime.cpu,
            lock_memory: true,
        };
        let tick = rt::spawn(realtime, move |timing| tick.run(timing))?;
        switches.realtime.store(tick.rights().realtime(), Ordering::Relaxed);
        for refusal in tick.rights().refusals() {
            tracing::warn!("no real-time rights: {refusal}");
        }
        let statistics = tick.statistics();
        let pump = Arc::new(Mutex::new(pump));
        let stop_pump = Arc::new(AtomicBool::new(false));
        let pump_thread = named("pump", {
            let (pump, stop, clock) = (Arc::clone(&pump), Arc::clone(&stop_pump), clock.fork());
            move || {
                while !stop.load(Ordering::Acquire) {
                    lock(&pump).turn();
                    clock.block_until(clock.now() + PUMP_PERIOD);
                }
                lock(&pump).turn();
            }
        })?;
        let bench = LiveBench {
            pump,
            requests: Arc::new(Mutex::new(requests)),
            trim: Arc::new(Mutex::new(trim)),
            switches,
            statistics,
            clock,
            profiles: Arc::new(profiles),
            devices: devices.iter().flat_map(FreeDevices::all).collect(),
            plant: sim.as_ref().map(SimRig::plant),
        };
        Ok(Self {
            bench,
            tick: Some(tick),
            owners,
            pump: Some(pump_thread),
            stop_owners,
            stop_pump,
            devices,
            sim,
            ptys: ptys.into_iter().map(Mutex::new).collect(),
        })
    }

    /// A handle for a procedure.
    pub fn bench(&self) -> LiveBench {
        self.bench.clone()
    }

    /// The loop's books.
    pub fn statistics(&self) -> Arc<rt::Statistics> {
        Arc::clone(&self.bench.statistics)
    }

    /// The switches that the tick reads.
    pub fn switches(&self) -> Arc<Switches> {
        Arc::clone(&self.bench.switches)
    }

    /// The loop's rights; none once it has ended.
    pub fn rights(&self) -> Option<&rt::Rights> {
        self.tick.as_ref().map(rt::Handle::rights)
    }

    /// Whether the loop runs.
    pub fn is_running(&self) -> bool {
        self.tick.as_ref().is_some_and(rt::Handle::is_running)
    }

    /// By FREE: what its devices have counted.
    pub fn devices(&self) -> &[FreeDevices] {
        &self.devices
    }

    /// The simulated devices, on the sim backend.
    pub fn sim(&self) -> Option<&SimRig> {
        self.sim.as_ref()
    }

    /// The simulated serial lines' plugs, in the order of the wiring.
    pub fn ptys(&self) -> &[Mutex<Pty>] {
        &self.ptys
    }

    /// Ends the rig: command zero first, verify p < p_zero within the vent time, then release. Returns whether
    /// every FREE that measures its pressure was seen vented.
    ///
    /// # Errors
    /// If the loop had panicked.
    pub fn stop(mut self, rig: &Rig) -> Result<bool, DaemonError> {
        self.bench.switches.estop.store(true, Ordering::Release);
        let end = self.bench.now() + rig.control.vent_time + Duration::from_millis(500);
        let mut vented = false;
        while self.is_running() && self.bench.now() < end {
            self.bench.pass(PUMP_PERIOD)?;
            vented = is_vented(&self.bench.latest(), rig);
            if vented {
                break;
            }
        }
        let ended = self.tick.take().map_or(Ok(()), rt::Handle::join);
        self.release();
        ended?;
        Ok(vented)
    }

    fn release(&mut self) {
        self.stop_owners.store(true, Ordering::Release);
        for owner in self.owners.drain(..) {
            if owner.join().is_err() {
                tracing::error!("a bus owner panicked");
            }
        }
        self.stop_pump.store(true, Ordering::Release);
        if self.pump.take().is_some_and(|p| p.join().is_err()) {
            tracing::error!("the pump panicked");
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        drop(self.tick.take());
        self.release();
    }
}

/// Whether every FREE is vented, as far as it is measured.
pub fn is_vented(record: &TickRecord, rig: &Rig) -> bool {
    let mut frees = record.frees().iter().zip(&rig.control.frees);
    record.free_count > 0 && frees.all(|(tick, free)| is_free_vented(record.time, tick, free))
}

/// Whether the command is zero at the time `now` and, where the pressure is measured, a reading below p_zero that is
/// no older than a second says so.
pub fn is_free_vented(now: Time, tick: &FreeTick, free: &FreeControl) -> bool {
    let reading = &tick.pressure;
    let fresh = reading.health == RegulatorHealth::Good && now.since(reading.time) <= FRESH;
    tick.command == 0.0 && (!free.regulator.measures || (fresh && reading.pressure < free.limits.pressure_zero))
}

fn note(devices: &mut [FreeDevices], free: usize, set: impl FnOnce(&mut FreeDevices)) {
    if let Some(devices) = devices.get_mut(free) {
        set(devices);
    }
}

/// Promotes the calling thread below the tick; a refusal is the tick's refusal, and told there.
fn promotion(tick: u8) -> impl Fn() + Clone + Send + Sync + 'static {
    let priority = tick.saturating_sub(BELOW_THE_TICK).max(1);
    move || {
        if let Err(refusal) = rt::fifo(Some(priority)) {
            tracing::debug!("bus owner: {refusal}");
        }
    }
}

fn serve_i2c<I: embedded_hal::i2c::I2c>(owner: I2cOwner<I>, stop: &AtomicBool, promote: impl Fn()) {
    promote();
    if let Err(error) = owner.run(stop) {
        tracing::error!(%error, "an I2C bus was left in an unknown state");
    }
}

fn serve_valve<V: DumpValve>(owner: ValveOwner<V>, stop: &AtomicBool, promote: impl Fn()) {
    promote();
    owner.run(stop);
}

/// Opens the output `line`.
fn output(gpio: &GpioWiring, line: u32) -> OpenPin<linux_embedded_hal::CdevPin> {
    let chip = gpio.chip.clone();
    Box::new(move || gpio::output(&chip, line))
}

fn named(name: &str, body: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, DaemonError> {
    std::thread::Builder::new().name(format!("freerig-{name}")).spawn(body).map_err(thread_failed)
}

fn thread_failed(error: std::io::Error) -> DaemonError {
    DaemonError::Io { what: "a thread could not be started".into(), error }
}

impl Bench for LiveBench {
    fn now(&self) -> Time {
        self.clock.now()
    }

    fn request(&mut self, request: Request) -> Result<(), DaemonError> {
        lock(&self.requests).push(request).map_err(|_| DaemonError::Busy)
    }

    fn trim(&mut self, trim: Trim) {
        lock(&self.trim).write(trim);
    }

    fn pass(&mut self, duration: Duration) -> Result<(), DaemonError> {
        let ticks = self.statistics.ticks();
        self.clock.block_until(self.clock.now() + duration);
        // A machine may stall for a while, and then the heartbeat must not wait; a loop that has ended never ticks
        // again.
        let end = self.clock.now() + LONGEST_STALL;
        while self.statistics.ticks() == ticks {
            if self.clock.now() >= end {
                return Err(DaemonError::LoopEnded(format!("no tick for {} s", LONGEST_STALL.as_secs())));
            }
            self.clock.block_until(self.clock.now() + STALL_LOOK);
        }
        lock(&self.pump).turn();
        Ok(())
    }

    fn heartbeat(&mut self) {
        self.switches.heartbeat.set(self.clock.now());
    }

    fn with_pump<R>(&mut self, look: impl FnOnce(&mut Pump) -> R) -> R {
        look(&mut lock(&self.pump))
    }

    fn profile(&self, free: usize) -> Option<Arc<ProfileDesk>> {
        self.profiles.get(&free).cloned()
    }

    fn devices(&self) -> Vec<Arc<DeviceStatistics>> {
        self.devices.clone()
    }

    fn pluck(&mut self, free: usize, hand: &Hand, duration: Duration) {
        if let Some(plant) = &self.plant {
            let now = self.clock.now();
            lock(plant).pluck(free, hand, now, now + duration);
        }
    }

    fn latest(&mut self) -> TickRecord {
        *lock(&self.pump).latest()
    }

    fn attach(&mut self, recorder: Recorder) {
        lock(&self.pump).attach(recorder);
    }

    fn detach(&mut self) -> Result<Option<Recorder>, DaemonError> {
        let mut pump = lock(&self.pump);
        pump.turn();
        detached(pump.detach())
    }
}

//! The owner of an I2C bus, with its drivers and simulated chips, on the stepped clock.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, Operation};
use freerig::clock::{Clock, Stepper, Time};
use freerig::hardware::i2c_owner::{DAC_PERIOD, I2cOwner, I2cPorts};
use freerig::hardware::wiring::{DacChannel, DacWiring, I2cWiring, ImuWiring};
use freerig::hardware::{DeviceStatistics, HardwareError};
use freerig::signal::{Command, ImuHealth, ImuSample, PressureSample, RegulatorHealth, RegulatorStatus};
use freerig::sim::ImuSim;
use freerig::sim::chips::{
    Bno055Chip, Bno055Sim, DacRegister, Mcp4728Chip, Misbehaviour, Mischief, Orientation, SimI2c,
};
use triple_buffer::{Input, Output, triple_buffer};

const TIMEOUT: Duration = Duration::from_millis(50);
const MAP: DacChannel = DacChannel { free: 1, zero_code: 0.0, pascals_per_code: 20.0 };

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

fn swinging(time: Time) -> Orientation {
    let t = time.seconds_since(Time::ZERO);
    let (angle, rate) = ((2.0 * t).sin(), 2.0 * (2.0 * t).cos());
    Orientation {
        quaternion: [(angle / 2.0).cos(), (angle / 2.0).sin(), 0.0, 0.0],
        rate: [rate, 0.0, 0.0],
        acceleration: [0.0; 3],
    }
}

/// One bus: a DAC that feeds FREE 1, an IMU for the FREEs 0 and 1; and what the scheduler and the tick would do.
struct Rig {
    stepper: Stepper,
    bus: SimI2c,
    owner: I2cOwner<SimI2c>,
    command: Input<Command>,
    imu: [Output<ImuSample>; 2],
    pressure: Output<PressureSample>,
    volts: Arc<Mutex<Vec<(Time, f64)>>>,
    opens: Arc<Mutex<u32>>,
    imu_chip: Mischief,
    dac_chip: Mischief,
    setpoint: f64,
    vent: bool,
    silent: bool,
}

impl Rig {
    fn new() -> Self {
        Self::with_dac(|sink| Mcp4728Chip::programmed(0x60, sink))
    }

    fn with_dac(dac: impl FnOnce(freerig::sim::chips::VoltageSink) -> Mcp4728Chip) -> Self {
        let stepper = Stepper::new();
        let clock = stepper.clock();
        let bus = SimI2c::new(clock.clone(), 400_000);
        let volts: Arc<Mutex<Vec<(Time, f64)>>> = Arc::default();
        let sink = volts.clone();
        let dac = dac(Box::new(move |time, v| sink.lock().expect("not poisoned").push((time, v[0]))));
        let dac_chip = bus.attach(0x60, dac);
        let sim = Bno055Sim::new(ImuSim { delay: ms(5), noise: 1e-3, rate_noise: 1e-2 }, 3);
        let imu_chip = bus.attach(0x28, Bno055Chip::new(sim, Box::new(swinging)));
        let wiring = I2cWiring {
            name: "bench".into(),
            device: "/dev/i2c-1".into(),
            imus: vec![ImuWiring { frees: vec![0, 1], address: 0x28, period: ms(10), reset: None, profile: None }],
            dacs: vec![DacWiring { address: 0x60, channels: [Some(MAP), None, None, None] }],
            adcs: vec![],
        };
        let (command, command_out) = triple_buffer(&Command::default());
        let (imu_a, imu_a_out) = triple_buffer(&ImuSample::default());
        let (imu_b, imu_b_out) = triple_buffer(&ImuSample::default());
        let (pressure, pressure_out) = triple_buffer(&PressureSample::default());
        let ports = I2cPorts {
            command: command_out,
            imu: vec![(0, imu_a), (1, imu_b)],
            pressure: vec![(1, pressure)],
            sensor: vec![],
        };
        let opens: Arc<Mutex<u32>> = Arc::default();
        let (count, wires) = (opens.clone(), bus.clone());
        let open = move || {
            *count.lock().expect("not poisoned") += 1;
            Ok::<_, HardwareError>(bus.clone())
        };
        Self {
            owner: I2cOwner::new(&wiring, TIMEOUT, clock, open, ports),
            bus: wires,
            stepper,
            command,
            imu: [imu_a_out, imu_b_out],
            pressure: pressure_out,
            volts,
            opens,
            imu_chip,
            dac_chip,
            setpoint: 0.0,
            vent: false,
            silent: false,
        }
    }

    /// Runs for `duration`: a tick every 2 ms that gives its command, the owner whenever it is due.
    fn run(&mut self, duration: Duration, mut see: impl FnMut(Time, ImuSample, PressureSample)) {
        let end = self.stepper.now() + duration;
        let mut tick = self.stepper.now();
        while tick < end {
            let due = self.owner.next_due();
            if due < tick {
                self.stepper.advance_to(due);
                self.owner.cycle();
                self.stepper.advance_to(self.owner.busy_until().min(tick));
                self.owner.publish();
                continue;
            }
            self.stepper.advance_to(tick);
            if !self.silent {
                let mut command = Command { time: tick, vent: self.vent, ..Command::default() };
                command.pressure[1] = self.setpoint;
                self.command.write(command);
            }
            see(tick, *self.imu[1].read(), *self.pressure.read());
            tick = tick + ms(2);
        }
    }

    /// Runs until both devices work.
    fn start() -> Self {
        let mut rig = Self::new();
        rig.run(ms(900), |_, _, _| {});
        assert_eq!(rig.imu[0].read().health, ImuHealth::Good);
        assert_eq!(rig.pressure.read().health, RegulatorHealth::Unmeasured);
        rig
    }

    fn statistics(&self) -> [Arc<DeviceStatistics>; 2] {
        self.owner.statistics().try_into().expect("one DAC, one IMU")
    }

    fn volts(&self) -> f64 {
        self.volts.lock().expect("not poisoned").last().map_or(f64::NAN, |v| v.1)
    }
}

#[test]
fn one_imu_serves_its_frees_with_fresh_readings_at_its_own_rate() {
    let mut rig = Rig::start();
    let mut count = 0;
    let mut last = 0;
    rig.run(ms(2000), |now, imu, _| {
        assert_eq!(imu.health, ImuHealth::Good);
        // One frame of 10 ms +-0.5 %, a look that came 1 ms too early, two transfers, one tick.
        assert!(now.since(imu.time) <= ms(14), "{:?}", now.since(imu.time));
        if imu.sequence != last {
            count += 1;
            // What the reading says was true 5 ms (the sensor's delay) and at most one look before it was taken;
            // with three standard deviations of noise and the change of rate within that time.
            let half = imu.quaternion[1].atan2(imu.quaternion[0]);
            let truth = |delay: f64| (2.0 * (imu.time.seconds_since(Time::ZERO) - delay)).sin();
            let (newest, oldest) = (truth(0.005), truth(0.0067));
            let (low, high) = (newest.min(oldest) - 4e-3, newest.max(oldest) + 4e-3);
            assert!((low..high).contains(&(2.0 * half)), "{} is not in {low}..{high}", 2.0 * half);
        }
        last = imu.sequence;
    });
    assert!((198..=202).contains(&count), "{count} readings in 2 s");
    let [a, b] = &mut rig.imu;
    assert_eq!(a.read(), b.read());
    let [_, imu] = rig.statistics();
    assert_eq!([imu.errors.get(), imu.implausible.get(), imu.resets.get(), imu.connects.get()], [0, 0, 0, 1]);
    assert!(imu.identity().expect("connected").to_string().contains("firmware 3.11"));
}

#[test]
fn setpoints_arrive_within_one_dac_period_and_only_on_wired_channels() {
    let mut rig = Rig::start();
    assert_eq!(rig.volts(), 0.0);
    rig.setpoint = 30_000.0;
    let before = rig.stepper.now();
    rig.run(ms(20), |_, _, _| {});
    let sample = *rig.pressure.read();
    assert_eq!((sample.setpoint, sample.health), (30_000.0, RegulatorHealth::Unmeasured));
    assert!(sample.pressure.is_nan());
    let changed = rig.volts.lock().expect("not poisoned").iter().find(|v| v.1 > 0.0).expect("written").0;
    // One period, one IMU burst that may be on the bus, the transfer itself.
    assert!(changed.since(before) <= DAC_PERIOD + ms(2), "{:?}", changed.since(before));
    assert!((rig.volts() - 1.5).abs() < 1e-12);
}

#[test]
fn a_vent_and_a_command_that_grows_old_are_zero() {
    let mut rig = Rig::start();
    rig.setpoint = 30_000.0;
    rig.run(ms(20), |_, _, _| {});
    rig.vent = true;
    rig.run(ms(8), |_, _, _| {});
    assert_eq!(rig.volts(), 0.0);
    rig.vent = false;
    rig.run(ms(8), |_, _, _| {});
    assert!(rig.volts() > 1.0);
    // The tick is dead.
    rig.silent = true;
    rig.run(TIMEOUT - ms(8), |_, _, _| {});
    assert!(rig.volts() > 1.0);
    rig.run(ms(20), |_, _, _| {});
    assert_eq!(rig.volts(), 0.0);
    assert_eq!(rig.pressure.read().setpoint, 0.0, "and the sample says so");
}

#[test]
fn an_owner_that_ends_leaves_zero_behind() {
    let mut rig = Rig::start();
    rig.setpoint = 30_000.0;
    rig.run(ms(20), |_, _, _| {});
    let Rig { owner, volts, .. } = rig;
    let last = || volts.lock().expect("not poisoned").last().expect("written").1;
    assert!(last() > 1.0);
    drop(owner);
    assert_eq!(last(), 0.0);
}

#[test]
fn an_owner_that_cannot_reach_its_dac_at_the_end_tells_every_dac_by_the_general_call() {
    let mut rig = Rig::start();
    rig.setpoint = 30_000.0;
    rig.run(ms(20), |_, _, _| {});
    rig.dac_chip.always(Misbehaviour::Nak);
    let Rig { owner, volts, .. } = rig;
    let last = || volts.lock().expect("not poisoned").last().expect("written").1;
    assert!(last() > 1.0);
    drop(owner);
    assert_eq!(last(), 0.0);
}

#[test]
fn a_short_interruption_of_the_imu_costs_readings_and_nothing_else() {
    let mut rig = Rig::start();
    rig.imu_chip.always(Misbehaviour::Nak);
    rig.run(ms(120), |_, imu, _| assert_eq!(imu.health, ImuHealth::Good, "stale, and its age says so"));
    rig.imu_chip.stop();
    rig.run(ms(40), |_, _, _| {});
    let now = rig.stepper.now();
    assert!(now.since(rig.imu[0].read().time) <= ms(23));
    let [_, imu] = rig.statistics();
    assert_eq!([imu.resets.get(), imu.losses.get(), imu.connects.get(), imu.reopens.get()], [0, 0, 1, 1]);
    assert!(imu.retries.get() >= 20);
    assert_eq!(*rig.opens.lock().expect("not poisoned"), 3, "one handle a device, one reopened");
}

#[test]
fn an_imu_that_fails_for_longer_is_set_up_anew_before_it_is_lost() {
    let mut rig = Rig::start();
    rig.imu_chip.always(Misbehaviour::Nak);
    rig.run(ms(300), |_, _, _| {});
    rig.imu_chip.stop();
    rig.run(ms(1000), |_, imu, _| assert_ne!(imu.health, ImuHealth::Lost));
    assert_eq!(rig.imu[0].read().health, ImuHealth::Good);
    let [_, imu] = rig.statistics();
    assert_eq!([imu.resets.get(), imu.losses.get(), imu.connects.get()], [0, 0, 2], "set up by the ladder");
}

#[test]
fn a_reset_of_the_imu_is_cured_while_the_dac_keeps_its_pace() {
    let mut rig = Rig::start();
    rig.setpoint = 10_000.0;
    rig.imu_chip.next(1, Misbehaviour::Reset);
    let (mut restarting, mut gap, mut last) = (0, Duration::ZERO, None);
    rig.run(ms(2500), |_, imu, pressure| {
        restarting += u32::from(imu.health == ImuHealth::Restarting);
        if let Some(last) = last {
            gap = gap.max(pressure.time.since(last));
        }
        last = Some(pressure.time);
    });
    assert!(restarting > 100, "at least 200 ms of Restarting are seen: {restarting} ticks");
    assert_eq!(rig.imu[0].read().health, ImuHealth::Good);
    // A period, a read-back of the registers, and the longest step of the set-up.
    assert!(gap <= DAC_PERIOD + ms(4), "{gap:?} without a set-point");
    let [_, imu] = rig.statistics();
    assert_eq!([imu.connects.get(), imu.losses.get()], [2, 0]);
}

#[test]
fn an_unplugged_imu_is_lost_after_the_ladder_and_comes_back() {
    let mut rig = Rig::start();
    rig.imu_chip.always(Misbehaviour::Silent);
    let gone = rig.stepper.now();
    let mut lost = None;
    rig.run(ms(3000), |now, imu, _| {
        if imu.health == ImuHealth::Lost {
            lost.get_or_insert(now);
        } else {
            assert_eq!(lost, None, "lost is lost until it is back");
        }
    });
    let after = lost.expect("lost").since(gone);
    // From the last good reading on, up to one period before.
    assert!((ms(990)..=ms(1004)).contains(&after), "{after:?}");
    let [dac, imu] = rig.statistics();
    assert_eq!([imu.losses.get(), dac.losses.get(), dac.errors.get()], [1, 0, 0]);
    let text = imu.last_error().expect("noted").to_string();
    assert!(text.contains("BNO055 at 0x28 on /dev/i2c-1 does not answer") && text.contains("cable"), "{text}");
    rig.imu_chip.stop();
    let back = rig.stepper.now();
    let mut good = None;
    rig.run(ms(3000), |now, imu, _| {
        if imu.health == ImuHealth::Good {
            good.get_or_insert(now);
        }
    });
    let after = good.expect("back").since(back);
    // Pace of the attempts twice, power-on and reset of 650 ms each, mode change.
    assert!(after <= ms(2400), "{after:?}");
    assert_eq!(imu.last_error(), None);
}

#[test]
fn a_stuck_imu_is_noticed() {
    let mut rig = Rig::start();
    rig.imu_chip.always(Misbehaviour::Stuck);
    let mut worst = ImuHealth::Good;
    rig.run(ms(1000), |_, imu, _| {
        if imu.health != ImuHealth::Good {
            worst = imu.health;
        }
    });
    assert_eq!(worst, ImuHealth::Restarting, "half a second later");
    rig.run(ms(3000), |_, _, _| {});
    assert_eq!(rig.imu[0].read().health, ImuHealth::Lost);
}

#[test]
fn an_unplugged_dac_is_lost_and_its_first_frame_afterwards_is_zero() {
    let mut rig = Rig::start();
    rig.setpoint = 30_000.0;
    rig.run(ms(20), |_, _, _| {});
    rig.dac_chip.always(Misbehaviour::Silent);
    rig.run(ms(1000), |_, _, _| {});
    assert_eq!(rig.pressure.read().health, RegulatorHealth::Lost);
    assert_eq!(rig.imu[0].read().health, ImuHealth::Good, "its neighbour does not care");
    rig.volts.lock().expect("not poisoned").clear();
    rig.dac_chip.stop();
    rig.run(ms(1500), |_, _, _| {});
    let frames = rig.volts.lock().expect("not poisoned").clone();
    // Power-on, four channels of the zero frame, then what the tick still asks for.
    assert!(frames[..5].iter().all(|f| f.1 == 0.0), "{:?}", &frames[..5]);
    assert_eq!(rig.pressure.read().health, RegulatorHealth::Unmeasured);
    assert!(frames.last().expect("written").1 > 1.0);
}

#[test]
fn a_dac_that_lost_its_codes_is_told_again_and_says_so() {
    let mut rig = Rig::start();
    rig.setpoint = 30_000.0;
    rig.run(ms(20), |_, _, _| {});
    // It starts anew before every exchange: each write heals it, each look at the registers finds it out.
    rig.dac_chip.always(Misbehaviour::Reset);
    let mut mismatches = 0;
    rig.run(ms(1100), |_, _, pressure| {
        assert_eq!(pressure.health, RegulatorHealth::Unmeasured);
        mismatches += u32::from(pressure.status.contains(RegulatorStatus::ECHO_MISMATCH));
    });
    assert!(rig.volts() > 1.0, "written again with every frame");
    // Every 5 ms, as the look stays due while it fails: at least from 500 ms on.
    assert!(mismatches > 200, "{mismatches} ticks");
    rig.dac_chip.stop();
    rig.run(ms(20), |_, _, _| {});
    assert_eq!(rig.pressure.read().status, RegulatorStatus::default());
}

#[test]
fn an_unsafe_dac_never_presses_and_says_why() {
    let mid = DacRegister { internal: true, power_down: 0, gain_two: true, code: 0x800 };
    let mut rig = Rig::with_dac(|sink| Mcp4728Chip::new(0x60, sink).with_eeprom([mid; 4]));
    rig.setpoint = 30_000.0;
    rig.run(ms(3000), |_, _, pressure| assert_ne!(pressure.health, RegulatorHealth::Unmeasured));
    assert_eq!(rig.volts(), 0.0);
    let [dac, _] = rig.statistics();
    let text = dac.last_error().expect("noted").to_string();
    assert!(text.contains("A at code 2048") && text.contains("program the EEPROM"), "{text}");
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let run = || {
        let mut rig = Rig::new();
        let mut seen = Vec::new();
        rig.setpoint = 12_345.0;
        rig.imu_chip.next(40, Misbehaviour::BitFlip);
        rig.run(ms(3000), |now, imu, pressure| {
            seen.push((now, imu, pressure.time, pressure.sequence, pressure.setpoint.to_bits()));
        });
        seen
    };
    assert_eq!(run(), run());
}

#[test]
fn live_the_owner_is_a_thread_that_stops_with_zero() {
    let clock = Clock::Live;
    let bus = SimI2c::new(clock.clone(), 400_000);
    let volts: Arc<Mutex<f64>> = Arc::default();
    let sink = volts.clone();
    let dac = Mcp4728Chip::programmed(0x60, Box::new(move |_, v| *sink.lock().expect("not poisoned") = v[0]));
    bus.attach(0x60, dac);
    let wiring = I2cWiring {
        name: "bench".into(),
        device: "/dev/i2c-1".into(),
        imus: vec![],
        dacs: vec![DacWiring { address: 0x60, channels: [Some(MAP), None, None, None] }],
        adcs: vec![],
    };
    let (mut command, command_out) = triple_buffer(&Command::default());
    let ports = I2cPorts { command: command_out, imu: vec![], pressure: vec![], sensor: vec![] };
    let owner = I2cOwner::new(&wiring, Duration::from_secs(60), clock.clone(), move || Ok(bus.clone()), ports);
    let stop = Arc::new(AtomicBool::new(false));
    let thread = std::thread::spawn({
        let stop = stop.clone();
        move || owner.run(&stop)
    });
    let mut pressure = [0.0; 6];
    pressure[1] = 30_000.0;
    command.write(Command { time: clock.now(), pressure, vent: false });
    let pressed = || *volts.lock().expect("not poisoned") > 1.0;
    // However slow the machine: it must get there.
    while !pressed() {
        clock.block_until(clock.now() + ms(5));
    }
    stop.store(true, Ordering::Relaxed);
    thread.join().expect("no panic").expect("zero, and read back");
    assert!(!pressed());
}

/// An adapter that may be unplugged; it does not come back as long as somebody holds its old file open.
#[derive(Clone)]
struct Adapter {
    bus: SimI2c,
    plugged: Arc<AtomicBool>,
    handles: Arc<AtomicU32>,
}

impl Adapter {
    fn open(&self) -> Result<AdapterHandle, HardwareError> {
        if !self.plugged.load(Ordering::Relaxed) {
            let (device, reason, remedy) = ("the adapter".into(), "No such file".into(), "Plug it in".into());
            return Err(HardwareError::Open { device, reason, remedy });
        }
        self.handles.fetch_add(1, Ordering::Relaxed);
        Ok(AdapterHandle(self.clone(), true))
    }

    /// Plugs it in; what has been open until now is dead.
    fn plug(&self) {
        assert_eq!(
            self.handles.load(Ordering::Relaxed),
            0,
            "the old file is still open: the adapter gets another name"
        );
        self.plugged.store(true, Ordering::Relaxed);
    }
}

struct AdapterHandle(Adapter, bool);

impl Drop for AdapterHandle {
    fn drop(&mut self) {
        self.0.handles.fetch_sub(1, Ordering::Relaxed);
    }
}

/// `Other` where the adapter itself has gone.
#[derive(Debug)]
struct AdapterError(ErrorKind);

impl Error for AdapterError {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

impl ErrorType for AdapterHandle {
    type Error = AdapterError;
}

impl I2c for AdapterHandle {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), AdapterError> {
        self.1 &= self.0.plugged.load(Ordering::Relaxed);
        if !self.1 {
            return Err(AdapterError(ErrorKind::Other));
        }
        self.0.bus.transaction(address, operations).map_err(|error| AdapterError(error.kind()))
    }
}

#[test]
fn an_adapter_that_is_unplugged_is_let_go_of_and_taken_up_again() {
    for away in [ms(250), ms(3000)] {
        let rig = Rig::start();
        let clock = rig.stepper.clock();
        let bus = SimI2c::new(clock.clone(), 400_000);
        bus.attach(0x60, Mcp4728Chip::programmed(0x60, Box::new(|_, _| ())));
        let sim = Bno055Sim::new(ImuSim { delay: ms(5), noise: 1e-3, rate_noise: 1e-2 }, 3);
        bus.attach(0x28, Bno055Chip::new(sim, Box::new(swinging)));
        let adapter = Adapter { bus, plugged: Arc::new(true.into()), handles: Arc::default() };
        let (_command, command_out) = triple_buffer(&Command::default());
        let (imu, mut imu_out) = triple_buffer(&ImuSample::default());
        let (pressure, mut pressure_out) = triple_buffer(&PressureSample::default());
        let ports =
            I2cPorts { command: command_out, imu: vec![(0, imu)], pressure: vec![(1, pressure)], sensor: vec![] };
        let wiring = I2cWiring {
            name: "bench".into(),
            device: "/dev/i2c-7".into(),
            imus: vec![ImuWiring { frees: vec![0], address: 0x28, period: ms(10), reset: None, profile: None }],
            dacs: vec![DacWiring { address: 0x60, channels: [Some(MAP), None, None, None] }],
            adcs: vec![],
        };
        let opener = adapter.clone();
        let mut owner = I2cOwner::new(&wiring, TIMEOUT, clock, move || opener.open(), ports);
        let run = |owner: &mut I2cOwner<AdapterHandle>, duration: Duration| {
            let end = rig.stepper.now() + duration;
            while owner.next_due() < end {
                rig.stepper.advance_to(owner.next_due());
                owner.cycle();
                let busy = owner.busy_until();
                rig.stepper.advance_to(busy.max(rig.stepper.now()));
                owner.publish();
            }
        };
        run(&mut owner, ms(1000));
        assert_eq!(adapter.handles.load(Ordering::Relaxed), 2, "one for each chip");
        adapter.plugged.store(false, Ordering::Relaxed);
        run(&mut owner, away);
        adapter.plug();
        run(&mut owner, ms(2500));
        assert_eq!(imu_out.read().health, ImuHealth::Good, "{away:?}");
        assert_eq!(pressure_out.read().health, RegulatorHealth::Unmeasured, "{away:?}");
        assert_eq!(adapter.handles.load(Ordering::Relaxed), 2, "{away:?}");
        for device in owner.statistics() {
            assert!(device.reopens.get() > 0 && device.last_error().is_none(), "{device:?}");
        }
    }
}

#[test]
fn an_imu_that_only_left_its_mode_is_back_within_a_hold() {
    let mut rig = Rig::start();
    let mut bus = rig.bus.clone();
    bus.write(0x28, &[0x3D, 0x00]).expect("acknowledged");
    let gone = rig.stepper.now();
    let mut back = None;
    rig.run(ms(1000), |now, imu, _| {
        if imu.health == ImuHealth::Good && imu.time > gone + ms(20) {
            back.get_or_insert(now);
        }
    });
    // One reading to notice, 19 ms to CONFIG, 7 ms to IMU mode and 30 ms to the first frame, each rounded up to a turn.
    let took = back.expect("back").since(gone);
    assert!(took <= ms(100), "{took:?}");
    let [_, imu] = rig.statistics();
    assert_eq!([imu.resets.get(), imu.connects.get(), imu.losses.get()], [1, 2, 0]);
}

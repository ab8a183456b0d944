//! One tick of the rig: slots in, controller, slots out. The real-time thread and the stepped scheduler run
//! this same code. Nothing here allocates, locks, logs or waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use rtrb::{Consumer, Producer};
use triple_buffer::{Input, Output};

use super::handle::LastHeard;
use crate::control::{Controller, Request, TickInput};
use crate::rt::Timing;
use crate::signal::{Command, ImuSample, MAX_FREES, PressureSample, TickRecord, Trim};
use crate::trajectory::Program;

/// Switches that other threads throw and the tick reads.
#[derive(Debug, Default)]
pub struct Switches {
    /// The emergency stop; stays set until faults are cleared.
    pub estop: Arc<AtomicBool>,
    /// The emergency stop's own input is pressed, or cannot be read.
    pub estop_input: Arc<AtomicBool>,
    /// The supply's pressure switch says low, or cannot be read.
    pub supply_low: Arc<AtomicBool>,
    /// A configuration file differs from what was loaded.
    pub config_changed: AtomicBool,
    /// Whether the real-time thread got its rights.
    pub realtime: AtomicBool,
    /// Latest heartbeat of the client that runs the program.
    pub heartbeat: Arc<LastHeard>,
    /// Records that found the ring full.
    pub lost_records: AtomicU64,
}

/// The tick with its ends of all slots and rings.
pub struct Tick {
    pub(super) controller: Controller,
    pub(super) imu: [Option<Output<ImuSample>>; MAX_FREES],
    pub(super) pressure: [Option<Output<PressureSample>>; MAX_FREES],
    /// Sensors of their own, of FREEs whose regulators measure nothing.
    pub(super) sensor: [Option<Output<PressureSample>>; MAX_FREES],
    /// By FREE: a regulator that has not been heard of for so long is silent, whatever the sensor behind it says.
    pub(super) patience: [Duration; MAX_FREES],
    pub(super) commands: Vec<Input<Command>>,
    pub(super) trim: Output<Trim>,
    pub(super) requests: Consumer<Request>,
    pub(super) records: Producer<TickRecord>,
    pub(super) retired: Producer<Arc<Program>>,
    pub(super) switches: Arc<Switches>,
}

impl Tick {
    /// Runs one tick.
    pub fn run(&mut self, timing: &Timing) {
        let mut input = self.input(timing);
        let record = self.controller.tick(&input);
        let command = Controller::command(&record);
        for slot in &mut self.commands {
            slot.write(command);
        }
        // A program that is over, and the one that came with a request, refused or not: another thread frees them.
        // The ring holds more than can be under way; were it full all the same, they would be freed here.
        if let Some(program) = self.controller.take_retired() {
            let _ = self.retired.push(program);
        }
        if let Some(Request::Start { program, .. }) = input.request.take() {
            let _ = self.retired.push(program);
        }
        if self.records.push(record).is_err() {
            self.switches.lost_records.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn input(&mut self, timing: &Timing) -> TickInput {
        let mut input = TickInput {
            tick: timing.tick,
            time: timing.deadline,
            latency_ns: timing.latency_ns,
            execution_ns: timing.execution_ns,
            skipped: timing.skipped,
            imu: [ImuSample::default(); MAX_FREES],
            pressure: [PressureSample::default(); MAX_FREES],
            request: self.requests.pop().ok(),
            estop: self.switches.estop.load(Ordering::Acquire) || self.switches.estop_input.load(Ordering::Acquire),
            realtime: self.switches.realtime.load(Ordering::Relaxed),
            config_changed: self.switches.config_changed.load(Ordering::Relaxed),
            supply_low: self.switches.supply_low.load(Ordering::Acquire),
            heartbeat: self.switches.heartbeat.get(),
            trim: *self.trim.read(),
        };
        for (sample, slot) in input.imu.iter_mut().zip(&mut self.imu) {
            if let Some(slot) = slot {
                *sample = *slot.read();
            }
        }
        for (sample, slot) in input.pressure.iter_mut().zip(&mut self.pressure) {
            if let Some(slot) = slot {
                *sample = *slot.read();
            }
        }
        for ((sample, slot), patience) in input.pressure.iter_mut().zip(&mut self.sensor).zip(self.patience) {
            if let Some(slot) = slot {
                *sample = sample.measured_by(*slot.read(), patience, timing.deadline);
            }
        }
        input
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use assert_no_alloc::{AllocDisabler, assert_no_alloc};
    use rtrb::Producer;

    use super::super::join::{Joints, join};
    use super::*;
    use crate::clock::Time;
    use crate::config::Rig;
    use crate::hardware::I2cPorts;
    use crate::signal::{ImuHealth, RegulatorHealth, State};
    use crate::trajectory::Sequence;

    /// Allocates as usual but inside `assert_no_alloc`, where the first allocation or release ends the tests.
    #[global_allocator]
    static GUARD: AllocDisabler = AllocDisabler;

    /// The tick of the example rig, with the test in the bus owners' and the supervisor's place.
    struct Bench {
        tick: Tick,
        i2c: Vec<I2cPorts>,
        serial: Vec<(Output<Command>, Vec<Input<PressureSample>>)>,
        valve: Option<Output<Command>>,
        requests: Producer<Request>,
        trim: Input<Trim>,
        pump: super::super::Pump,
        switches: Arc<Switches>,
        ticks: u32,
        pressure: f64,
    }

    impl Bench {
        fn new() -> Self {
            let rig =
                Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean");
            let Joints { tick, pump, requests, trim, switches, i2c, serial, valve } =
                join(&rig, None, Switches::default()).unwrap();
            Self { tick, i2c, serial, valve, requests, trim, pump, switches, ticks: 0, pressure: 0.0 }
        }

        /// New readings in every slot, one tick under guard, and what the owners find in their slots.
        fn turn(&mut self) -> Command {
            self.ticks += 1;
            let time = Time::ZERO + Duration::from_millis(2) * self.ticks;
            let imu = ImuSample {
                time,
                sequence: self.ticks,
                quaternion: [1.0, 0.0, 0.0, 0.0],
                calibration: 0xff,
                health: ImuHealth::Good,
                ..ImuSample::default()
            };
            let pressure = PressureSample {
                time,
                sequence: self.ticks,
                pressure: self.pressure,
                health: RegulatorHealth::Good,
                ..PressureSample::default()
            };
            self.i2c.iter_mut().flat_map(|bus| &mut bus.imu).for_each(|(_, slot)| slot.write(imu));
            self.serial.iter_mut().flat_map(|(_, units)| units).for_each(|slot| slot.write(pressure));
            let timing = Timing {
                tick: u64::from(self.ticks),
                deadline: time,
                woke: time,
                latency_ns: 20_000,
                execution_ns: 5_000,
                skipped: 0,
            };
            assert_no_alloc(|| self.tick.run(&timing));
            let command = *self.serial[0].0.read();
            for other in self.i2c.iter_mut().map(|bus| &mut bus.command).chain(&mut self.valve) {
                assert_eq!(*other.read(), command, "every owner gets the same command");
            }
            self.pressure = command.pressure[0];
            command
        }

        fn run_until(&mut self, state: State) {
            for _ in 0..5000 {
                self.turn();
                self.pump.turn();
                if self.pump.latest().state == state {
                    return;
                }
            }
            panic!("no {state:?}: {:?}", self.pump.latest());
        }

        fn start(&mut self, pascals: f64) {
            let program = Program::pressure(0, Sequence::constant(pascals, 60.0).unwrap()).unwrap();
            // The requester keeps nothing of it.
            let request = Request::Start { program: program.into(), attended: false, identify: false };
            self.requests.push(request).unwrap();
        }
    }

    #[test]
    fn the_tick_with_its_slots_and_rings_allocates_and_frees_nothing() {
        let mut bench = Bench::new();
        bench.run_until(State::Disarmed);
        // Refused: what came with the request goes where it can be freed.
        bench.start(1e4);
        bench.turn();
        bench.requests.push(Request::Arm).unwrap();
        bench.run_until(State::Hold);
        for _ in 0..3 {
            bench.start(2e4);
            bench.run_until(State::Track);
            for _ in 0..500 {
                bench.turn();
            }
            assert_eq!(bench.turn().pressure[0], 2e4);
            // A trim comes, is no number, and grows old.
            let mut with = |pressure: f64| {
                let time = Time::ZERO + Duration::from_millis(2) * bench.ticks;
                bench.trim.write(Trim { time, pressure: [pressure; MAX_FREES] });
                (0..200).map(|_| bench.turn().pressure[0]).collect::<Vec<_>>()
            };
            let commands = with(-1e3);
            assert!(commands[10] == 1.9e4 && commands[100] > 1.9e4 && commands[100] < 2e4 && commands[199] == 2e4);
            assert!(with(f64::NAN).iter().all(|command| *command == 2e4));
            bench.requests.push(Request::Stop).unwrap();
            bench.run_until(State::Hold);
        }
        bench.requests.push(Request::Disarm).unwrap();
        bench.run_until(State::Disarmed);
        bench.switches.estop.store(true, Ordering::Release);
        assert!(bench.turn().vent);
        bench.switches.estop.store(false, Ordering::Release);
        bench.requests.push(Request::Clear).unwrap();
        bench.run_until(State::Disarmed);
        // Nobody drains the ring of records: it overflows, and says so.
        assert_eq!(bench.switches.lost_records.load(Ordering::Relaxed), 0);
        for _ in 0..5000 {
            bench.turn();
        }
        let lost = bench.switches.lost_records.load(Ordering::Relaxed);
        bench.pump.turn();
        assert!(lost > 0 && bench.pump.lost_records() == lost);
    }
}

//! Execution time of one tick while tracking, at one and at four FREEs: what the loop spends of its period.
//!
//! criterion says the mean; p50, p99 and largest of single ticks are printed from the loop's own histogram. A tick
//! should stay below 10 us at p99 on an ordinary core: an idle one, and not the hypervisor's.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use freerig::clock::Time;
use freerig::config::Rig;
use freerig::control::{Controller, Request, TickInput};
use freerig::rt::Histogram;
use freerig::signal::{
    ImuHealth, ImuSample, MAX_FREES, PressureSample, Quantity, RegulatorHealth, State, TickRecord, Trim,
};
use freerig::trajectory::{Axis, Program, Sequence};

/// Single ticks that are timed for the percentiles.
const TICKS: u32 = 200_000;

/// The example rig's controller for `count` of its FREEs, fed with readings of FREEs that follow perfectly.
struct Bench {
    controller: Controller,
    input: TickInput,
    period: Duration,
    imu_ticks: u64,
    regulator_ticks: u64,
    last: TickRecord,
}

impl Bench {
    /// Tracking a swing that does not end.
    fn tracking(count: usize) -> Self {
        let rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean");
        let mut config = rig.control;
        config.frees = vec![config.frees[0].clone(); count];
        let ticks = |device: Duration| (device.as_secs_f64() / config.period.as_secs_f64()).round() as u64;
        let free = &config.frees[0];
        let mut this = Self {
            controller: Controller::new(&config).expect("the example is in range"),
            input: TickInput {
                tick: 0,
                time: Time::ZERO,
                latency_ns: 20_000,
                execution_ns: 5_000,
                skipped: 0,
                imu: [ImuSample::default(); MAX_FREES],
                pressure: [PressureSample::default(); MAX_FREES],
                trim: Trim::default(),
                request: None,
                estop: false,
                realtime: true,
                config_changed: false,
                supply_low: false,
                heartbeat: Time::ZERO,
            },
            period: config.period,
            imu_ticks: ticks(free.imu.expect("the example has an IMU").period),
            regulator_ticks: ticks(free.regulator.period),
            last: TickRecord::default(),
        };
        this.run_until(State::Disarmed);
        this.input.request = Some(Request::Arm);
        this.run_until(State::Hold);
        let swing = Sequence::starting_at(0.0).sinusoid(0.3, 0.5, 0.0, 1e9).build().expect("a swing");
        let axes = (0..count).map(|free| (free, Axis { quantity: Quantity::Angle, sequence: swing.clone() }));
        let program = Arc::new(Program::new(axes).expect("axes of the rig"));
        this.input.request = Some(Request::Start { program, attended: false, identify: false });
        this.run_until(State::Track);
        this
    }

    fn run_until(&mut self, state: State) {
        for _ in 0..10_000 {
            self.prepare();
            self.tick();
            if self.last.state == state {
                return;
            }
        }
        panic!("no {state:?}: {:?}", self.last);
    }

    /// The next tick's time and, where a device is due, its reading.
    fn prepare(&mut self) {
        self.input.tick += 1;
        self.input.time = self.input.time + self.period;
        let (tick, time) = (self.input.tick, self.input.time);
        for (index, free) in self.last.frees.iter().enumerate() {
            if tick.is_multiple_of(self.imu_ticks) {
                let (sin, cos) = (0.5 * free.reference.position).sin_cos();
                self.input.imu[index] = ImuSample {
                    time,
                    sequence: tick as u32,
                    quaternion: [cos, 0.0, 0.0, sin],
                    rate: [0.0, 0.0, free.reference.rate],
                    calibration: 0xff,
                    health: ImuHealth::Good,
                    ..ImuSample::default()
                };
            }
            if tick.is_multiple_of(self.regulator_ticks) {
                self.input.pressure[index] = PressureSample {
                    time,
                    sequence: tick as u32,
                    pressure: free.command,
                    health: RegulatorHealth::Good,
                    ..PressureSample::default()
                };
            }
        }
    }

    fn tick(&mut self) {
        self.last = self.controller.tick(black_box(&self.input));
        self.input.request = None;
    }
}

fn tick(c: &mut Criterion) {
    let mut group = c.benchmark_group("tick");
    for count in [1, 4] {
        let mut bench = Bench::tracking(count);
        let single = Histogram::new();
        for _ in 0..TICKS {
            bench.prepare();
            let begun = Instant::now();
            bench.tick();
            single.record(begun.elapsed().as_nanos() as u64);
        }
        assert_eq!(bench.last.state, State::Track, "{:?}", bench.last.latched);
        let us = |percent| single.percentile(percent).unwrap_or(0) as f64 / 1e3;
        println!(
            "tick/{count} FREE{}: p50 {:.2} us, p99 {:.2} us, largest {:.1} us of {TICKS} single ticks",
            if count == 1 { "" } else { "s" },
            us(50.0),
            us(99.0),
            us(100.0)
        );
        group.bench_function(BenchmarkId::from_parameter(count), |b| {
            b.iter(|| {
                bench.prepare();
                bench.tick();
            });
        });
    }
    group.finish();
}

criterion_group!(benches, tick);
criterion_main!(benches);

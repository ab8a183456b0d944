//! Execution time of one tick, armed and tracking an angle, with 1 and 5 FREEs. Prints p50, p99 and the worst, too:
//! criterion's mean hides the tail that a deadline cares about.

use std::f64::consts::PI;
use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use freerig::clock::Time;
use freerig::control::{
    ControlConfig, Controller, DerivativeOn, FreeControl, ImuChannel, Limits, RegulatorChannel, Request, TickInput,
    default_gains,
};
use freerig::model::Free;
use freerig::signal::{
    ImuHealth, ImuSample, MAX_FREES, PressureSample, Quantity, RegulatorHealth, RegulatorStatus, State,
};
use freerig::trajectory::{Axis, Program, Sequence};

const PSI: f64 = 6894.757293168;
const TICK: Duration = Duration::from_millis(2);

fn config(count: usize) -> ControlConfig {
    let free = Free {
        gamma: (-40f64).to_radians(),
        length: 0.11,
        radius: 0.007,
        mass: 0.028,
        inertia: 0.028 * 0.007 * 0.007,
        axial_stiffness: 10110.0,
        torsional_stiffness: 0.086,
        axial_damping: 5.0,
        torsional_damping: 0.005,
    };
    let imu = ImuChannel { axis: [0.0, 0.0, 1.0], period: Duration::from_millis(10), delay: Duration::from_millis(15) };
    let regulator = RegulatorChannel {
        period: Duration::from_millis(16),
        lag: Duration::from_millis(60),
        dead_time: Duration::from_millis(15),
        fastest_fill: 30.0 * PSI,
        full_scale: 15.0 * PSI,
        measures: true,
    };
    let free = FreeControl {
        name: "paper".into(),
        free,
        gains: default_gains(&free, &regulator, &imu, TICK),
        derivative_on: DerivativeOn::Error,
        feedforward: 1.0,
        limits: Limits {
            pressure_max: 10.0 * PSI,
            pressure_warn: 10.5 * PSI,
            pressure_hard: 11.0 * PSI,
            pressure_zero: 0.2 * PSI,
            slew: 30.0 * PSI,
            angle_soft: (-PI, PI),
            angle_hard: (-2.0 * PI, 2.0 * PI),
            tracking_error: (10.0, 1.0),
        },
        imu: Some(imu),
        regulator,
    };
    ControlConfig {
        period: TICK,
        vent_time: Duration::from_millis(1500),
        ramp_time: Duration::from_secs(3),
        require_realtime: false,
        dump_valve: false,
        frees: vec![free; count],
    }
}

/// A controller with readings of a first-order FREE behind a first-order regulator.
struct Rig {
    controller: Controller,
    input: TickInput,
    pressure: [f64; MAX_FREES],
    angle: [f64; MAX_FREES],
    state: State,
}

impl Rig {
    fn read(&mut self) {
        self.input.tick += 1;
        self.input.time = self.input.time + TICK;
        for free in 0..MAX_FREES {
            if self.input.tick.is_multiple_of(5) {
                let half = 0.5 * self.angle[free];
                self.input.imu[free] = ImuSample {
                    time: self.input.time,
                    sequence: self.input.imu[free].sequence + 1,
                    quaternion: [half.cos(), 0.0, 0.0, half.sin()],
                    calibration: 0xff,
                    health: ImuHealth::Good,
                    ..ImuSample::default()
                };
            }
            if self.input.tick.is_multiple_of(8) {
                self.input.pressure[free] = PressureSample {
                    time: self.input.time,
                    sequence: self.input.pressure[free].sequence + 1,
                    pressure: self.pressure[free],
                    setpoint: self.pressure[free],
                    status: RegulatorStatus::default(),
                    health: RegulatorHealth::Good,
                };
            }
        }
    }

    /// One tick; the time it took.
    fn tick(&mut self, request: Option<Request>) -> Duration {
        self.read();
        self.input.request = request;
        let begin = Instant::now();
        let record = black_box(self.controller.tick(black_box(&self.input)));
        let command = black_box(Controller::command(&record));
        let spent = begin.elapsed();
        self.state = record.state;
        for free in 0..MAX_FREES {
            self.pressure[free] += (command.pressure[free] - self.pressure[free]) * 0.002 / 0.06;
            self.angle[free] += (self.pressure[free] / 33_490.0 - self.angle[free]) * 0.002 / 0.058;
        }
        spent
    }

    fn tracking(count: usize) -> Self {
        let controller = Controller::new(&config(count)).unwrap_or_else(|e| panic!("{e}"));
        let mut rig = Self {
            controller,
            input: TickInput {
                tick: 0,
                time: Time::ZERO,
                latency_ns: 0,
                execution_ns: 0,
                skipped: 0,
                imu: [ImuSample::default(); MAX_FREES],
                pressure: [PressureSample::default(); MAX_FREES],
                request: None,
                estop: false,
                realtime: true,
                config_changed: false,
                heartbeat: Time::ZERO,
            },
            pressure: [0.0; MAX_FREES],
            angle: [0.0; MAX_FREES],
            state: State::Boot,
        };
        for _ in 0..20 {
            rig.tick(None);
        }
        rig.tick(Some(Request::Arm));
        for _ in 0..200 {
            rig.tick(None);
        }
        let axis = || Axis {
            quantity: Quantity::Angle,
            sequence: Sequence::starting_at(0.0)
                .sinusoid(0.4, 0.2, -0.5 * PI, 1e9)
                .build()
                .unwrap_or_else(|e| panic!("{e}")),
        };
        let program = Program::new((0..count).map(|free| (free, axis()))).unwrap_or_else(|e| panic!("{e}"));
        rig.tick(Some(Request::Start { program: program.into(), attended: false, identify: false }));
        rig
    }
}

fn tick(c: &mut Criterion) {
    for count in [1, 5] {
        let mut rig = Rig::tracking(count);
        let mut times: Vec<Duration> = (0..20_000).map(|_| rig.tick(None)).collect();
        assert_eq!(rig.state, State::Track);
        times.sort_unstable();
        println!(
            "tick/{count} FREEs: p50 {:?}, p99 {:?}, worst {:?} of {}",
            times[times.len() / 2],
            times[times.len() * 99 / 100],
            times[times.len() - 1],
            times.len()
        );
        c.bench_function(&format!("tick/{count} FREEs"), |b| {
            b.iter_custom(|iterations| (0..iterations).map(|_| rig.tick(None)).sum());
        });
        assert_eq!(rig.state, State::Track);
    }
}

criterion_group!(benches, tick);
criterion_main!(benches);

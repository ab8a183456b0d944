//! The controller around the simulated plant, with what the devices do to time and numbers: the IMU's rate, delay,
//! noise and quantisation, and the regulator's own period.

use std::sync::Arc;
use std::time::Duration;

use freerig::clock::Time;
use freerig::control::static_map::StaticMap;
use freerig::control::{ControlConfig, Controller, ControllerKind, FreeControl, ModelSpec, Request, TickInput};
use freerig::model::{ELEMENTS, Free, Hysteresis, HysteresisState, Kinematics, Law, Lumped};
use freerig::signal::*;
use freerig::sim::{BenchConfig, ImuSim, Plant, PlantSim, RegulatorSim};
use freerig::trajectory::{Program, Sequence};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::harness::{IMU_TICKS, PSI, REGULATOR_TICKS, TICK, angle_program, config, free_control};

/// The rig of the acceptance: 60 ms, 15 ms, 30 psi/s; hysteresis of 5 %; the nominal FREE with `scatter`.
pub fn plant(nominal: Free, scatter: f64, seed: u64) -> BenchConfig {
    BenchConfig {
        seed,
        plants: vec![PlantSim {
            nominal,
            scatter,
            hysteresis: 0.05,
            load_moment: 0.0,
            regulator: RegulatorSim {
                lag: Duration::from_millis(60),
                dead_time: Duration::from_millis(15),
                slew: 30.0 * PSI,
                noise: 0.01 * PSI,
                full_scale: 15.0 * PSI,
            },
            analogue: None,
        }],
        imu: ImuSim { delay: Duration::from_millis(15), noise: 0.05f64.to_radians(), rate_noise: 0.1f64.to_radians() },
        dump_valve: false,
    }
}

/// What a run came to, rad and s.
#[derive(Clone, Debug, Default)]
pub struct Course {
    /// Every tick of the program: time since its start, reference, true angle.
    pub samples: Vec<(f64, f64, f64)>,
    /// The tick's records.
    pub records: Vec<TickRecord>,
    /// Where it stood at the end.
    pub state: State,
}

impl Course {
    /// RMS and largest magnitude of reference - true angle, deg.
    pub fn errors(&self) -> (f64, f64) {
        let errors = self.samples.iter().map(|s| s.1 - s.2);
        let (sum, peak) = errors.fold((0.0, 0f64), |(sum, peak), e| (sum + e * e, peak.max(e.abs())));
        ((sum / self.samples.len() as f64).sqrt().to_degrees(), peak.to_degrees())
    }

    /// Overshoot of the move from `from` to `to` (rad) between `start` and `end` (s), as a share of the move, and the
    /// time until it stays within 2 %.
    pub fn step(&self, start: f64, end: f64, from: f64, to: f64) -> (f64, f64) {
        let (mut over, mut settled) = (0f64, 0f64);
        for &(t, _, angle) in self.samples.iter().filter(|s| s.0 >= start && s.0 < end) {
            let x = (angle - from) / (to - from);
            over = over.max(x - 1.0);
            if (x - 1.0).abs() > 0.02 {
                settled = t - start + TICK.as_secs_f64();
            }
        }
        (over, settled)
    }
}

pub struct Bench {
    pub controller: Controller,
    pub plant: Plant,
    imu: ImuSim,
    rng: Pcg64,
    input: TickInput,
    command: f64,
    last: State,
    /// True angle at the tare, rad: where this session's zero is.
    zero: f64,
}

impl Bench {
    pub fn new(control: &ControlConfig, plant: &BenchConfig) -> Self {
        let at = Time::from_nanos(1_000_000_000);
        Self {
            controller: Controller::new(control).unwrap(),
            plant: Plant::new(plant).starting_at(at),
            imu: plant.imu,
            rng: Pcg64::seed_from_u64(plant.seed ^ 0x5eed),
            input: TickInput {
                tick: 0,
                time: at,
                latency_ns: 0,
                execution_ns: 0,
                skipped: 0,
                imu: [ImuSample::default(); MAX_FREES],
                pressure: [PressureSample::default(); MAX_FREES],
                request: None,
                estop: false,
                realtime: true,
                config_changed: false,
                heartbeat: at,
            },
            command: 0.0,
            last: State::Boot,
            zero: 0.0,
        }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    pub fn tick(&mut self, request: Option<Request>) -> TickRecord {
        self.input.tick += 1;
        self.input.time = self.input.time + TICK;
        self.input.request = request;
        let (tick, time) = (self.input.tick, self.input.time);
        self.plant.advance_to(time);
        if tick.is_multiple_of(IMU_TICKS) {
            let motion = self.plant.orientation(0, time - self.imu.delay);
            let half = 0.5 * self.imu.noise * self.normal();
            let (sin, cos) = half.sin_cos();
            let [w, x, y, z] = motion.quaternion;
            let turned = [w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin];
            let unit = 1f64.to_radians() / 16.0;
            let rate = motion.rate[2] + self.imu.rate_noise * self.normal();
            self.input.imu[0] = ImuSample {
                time,
                sequence: self.input.imu[0].sequence + 1,
                quaternion: turned.map(|x| (x * 16384.0).round() / 16384.0),
                rate: [0.0, 0.0, (rate / unit).round() * unit],
                acceleration: [0.0; 3],
                calibration: 0xff,
                health: ImuHealth::Good,
            };
        }
        if tick.is_multiple_of(REGULATOR_TICKS) {
            self.input.pressure[0] = PressureSample {
                time,
                sequence: self.input.pressure[0].sequence + 1,
                pressure: self.plant.reading(0, time),
                setpoint: self.command,
                status: RegulatorStatus::default(),
                health: RegulatorHealth::Good,
            };
        }
        let record = self.controller.tick(&self.input);
        self.controller.take_retired();
        if tick.is_multiple_of(REGULATOR_TICKS) {
            self.command = record.frees[0].command;
            self.plant.set_setpoint(0, self.command, time);
        }
        self.last = record.state;
        record
    }

    pub fn arm(&mut self) {
        for _ in 0..25 {
            self.tick(None);
        }
        assert_eq!(self.tick(Some(Request::Arm)).refusal, Refusal::NONE);
        for _ in 0..500 {
            if self.tick(None).state == State::Hold {
                self.zero = self.plant.truth(0, self.input.time).angle;
                return;
            }
        }
        panic!("not armed: {:?}", self.last);
    }

    /// Runs `program` for its duration and returns what came of it.
    pub fn run(&mut self, sequence: &Sequence) -> Course {
        let program: Arc<Program> = angle_program(sequence.clone());
        let mut course = Course::default();
        let ticks = (sequence.duration() / TICK.as_secs_f64()) as u32;
        let mut request = Some(Request::Start { program, attended: false, identify: false });
        for _ in 0..ticks {
            let record = self.tick(request.take());
            let truth = self.plant.truth(0, self.input.time).angle - self.zero;
            course.samples.push((record.program_time, record.frees[0].reference.position, truth));
            course.records.push(record);
        }
        course.state = self.last;
        course
    }
}

/// A controller configuration for `free` with a model of it.
pub fn with_model(free: Free, spec: ModelSpec) -> ControlConfig {
    config(vec![FreeControl { free, controller: ControllerKind::Model(spec), ..free_control(-40.0) }])
}

/// What a calibration brings: every parameter off by as much as an identification errs, and hysteresis weights fitted to a slow staircase of the
/// very plant (0 to 80 deg and nested loops), by non-negative least squares over a grid of thresholds that is not the plant's.
pub fn calibrated(bench: &BenchConfig, seed: u64) -> (Free, Hysteresis) {
    let mut plant = Plant::new(bench);
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut off = |x: f64, share: f64| x * (1.0 + share * (rng.random::<f64>() * 2.0 - 1.0));
    let exact = *plant.true_free(0).unwrap();
    let free = Free {
        torsional_stiffness: off(exact.torsional_stiffness, 0.003),
        torsional_damping: off(exact.torsional_damping, 0.02),
        inertia: off(exact.inertia, 0.02),
        ..exact
    };
    let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
    // As far up as the experiments go: 80 deg.
    let top = StaticMap::of_model(&exact, 1.4).unwrap().pressure(1.4) / PSI;
    let direction = exact.direction();
    let course = [0.0, top, 0.0, top, 0.5 * top, 0.8 * top, 0.3 * top, top, 0.0];
    let (mut time, mut points) = (Time::ZERO, Vec::new());
    for leg in course.windows(2) {
        for i in 1..=40 {
            let psi = leg[0] + (leg[1] - leg[0]) * f64::from(i) / 40.0;
            plant.set_setpoint(0, psi * PSI, time);
            time = time + Duration::from_millis(1000);
            let truth = plant.truth(0, time);
            let noise: f64 = StandardNormal.sample(&mut rng);
            // A second of readings at 100 Hz.
            let angle = truth.angle + noise * 0.05f64.to_radians() / 8.0;
            let act = model.actuation(truth.extension, angle).unwrap();
            let moment = act.moment * psi * PSI - free.torsional_stiffness * angle;
            points.push((direction * angle, direction * moment));
        }
    }
    let highest = points.iter().fold(0.0, |a: f64, p| a.max(p.0));
    let thresholds = Hysteresis::grid(0.004 * highest, 0.25 * highest);
    let unit = Hysteresis::new(thresholds, [1.0; ELEMENTS]).unwrap();
    let mut state = HysteresisState::rested(&unit);
    let rows: Vec<_> = points
        .iter()
        .map(|&(angle, moment)| {
            unit.advance(&mut state, angle);
            let strains = unit.strains(&state, angle);
            (std::array::from_fn::<f64, ELEMENTS, _>(|i| strains[i] + thresholds[i]), moment)
        })
        .collect();
    let mut weights = [0.0; ELEMENTS];
    for _ in 0..400 {
        for i in 0..ELEMENTS {
            let (mut up, mut down) = (0.0, 0.0);
            for (row, moment) in &rows {
                let others: f64 = (0..ELEMENTS).filter(|&j| j != i).map(|j| row[j] * weights[j]).sum();
                up += row[i] * (moment - others);
                down += row[i] * row[i];
            }
            weights[i] = f64::max(up / down, 0.0);
        }
    }
    (free, Hysteresis::new(thresholds, weights).unwrap())
}

/// A plant of which every parameter is off by up to 20 %, evenly distributed: FREE, hysteresis, regulator, IMU delay.
pub fn off_by_a_fifth(seed: u64) -> BenchConfig {
    let mut rng = Pcg64::seed_from_u64(1000 + seed);
    let mut off = |x: f64| x * rng.random_range(0.8..1.2);
    let p = Free::paper();
    let free = Free {
        gamma: off(p.gamma),
        length: off(p.length),
        radius: off(p.radius),
        mass: off(p.mass),
        inertia: off(p.inertia),
        axial_stiffness: off(p.axial_stiffness),
        torsional_stiffness: off(p.torsional_stiffness),
        axial_damping: off(p.axial_damping),
        torsional_damping: off(p.torsional_damping),
    };
    let mut bench = plant(free, 0.0, seed);
    let sim = &mut bench.plants[0];
    sim.hysteresis = off(sim.hysteresis);
    sim.regulator.lag = sim.regulator.lag.mul_f64(off(1.0));
    sim.regulator.dead_time = sim.regulator.dead_time.mul_f64(off(1.0));
    sim.regulator.slew = off(sim.regulator.slew);
    bench.imu.delay = bench.imu.delay.mul_f64(off(1.0));
    bench
}

impl Bench {
    /// Down, and back to Disarmed.
    pub fn disarm(&mut self) {
        self.tick(Some(Request::Disarm));
        for _ in 0..5000 {
            if self.tick(None).state == State::Disarmed {
                return;
            }
        }
        panic!("not disarmed: {:?}", self.last);
    }
}

//! The controller around one simulated FREE, with what the devices do to time and numbers: the IMU's rate, delay, noise
//! and quantisation, and the regulator's own period. No driver, no bus and no thread: thousands of times faster than
//! the clock. What `freerig bench --control` runs, and the tests of the controllers.

use std::sync::Arc;
use std::time::Duration;

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use thiserror::Error;

use super::{BenchConfig, ImuSim, Plant, PlantSim, RegulatorSim};
use crate::clock::Time;
use crate::control::static_map::{StaticMap, StaticMapError};
use crate::control::tune::{Target, TuneError, tune};
use crate::control::{
    ControlConfig, ControlError, Controller, ControllerKind, DerivativeOn, FreeControl, Gains, ImuChannel, Limits,
    ModelSpec, RegulatorChannel, Request, TickInput,
};
use crate::model::{
    DomainError, ELEMENTS, Free, FreeError, Hysteresis, HysteresisError, HysteresisState, Kinematics, Law, Lumped,
};
use crate::signal::*;
use crate::trajectory::{Axis, Program, ProgramError, Sequence};
use crate::units::PASCAL_PER_PSI as PSI;

/// The tick.
pub const TICK: Duration = Duration::from_millis(2);
/// Coordinate descent of the hysteresis weights: rounds.
const ROUNDS: usize = 400;
/// Stable: over the last half second the angle moves by less, rad.
const SWING_MAX: f64 = 0.0175;
/// That half second.
const TAIL: Duration = Duration::from_millis(500);

/// Why a loop did not run.
#[derive(Debug, Error)]
pub enum ControlledError {
    /// The controller refuses its configuration.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// No static map.
    #[error(transparent)]
    StaticMap(#[from] StaticMapError),
    /// No gains.
    #[error(transparent)]
    Tune(#[from] TuneError),
    /// The model has no such FREE.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// An angle beyond the kinematics.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// No hysteresis.
    #[error(transparent)]
    Hysteresis(#[from] HysteresisError),
    /// No program.
    #[error(transparent)]
    Program(#[from] ProgramError),
    /// It does not reach the state that was asked for.
    #[error("the controller stays in {0:?} ({1:?})")]
    Stays(State, RefusalCode),
}

/// The rig of the acceptance: 60 ms, 15 ms, 30 psi/s; hysteresis of 5 %; the nominal FREE with `scatter`.
pub fn plant(nominal: Free, scatter: f64, seed: u64) -> BenchConfig {
    BenchConfig {
        seed,
        plants: vec![PlantSim {
            nominal,
            scatter,
            hysteresis: 0.05,
            load_moment: 0.0,
            knob: None,
            regulator: RegulatorSim {
                lag: Duration::from_millis(60),
                dead_time: Duration::from_millis(15),
                slew: 30.0 * PSI,
                noise: 0.01 * PSI,
                full_scale: 15.0 * PSI,
            },
            analogue: None,
        }],
        module: None,
        imu: ImuSim { delay: Duration::from_millis(15), noise: 0.05f64.to_radians(), rate_noise: 0.1f64.to_radians() },
        dump_valve: false,
        one_shot: false,
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

/// The controller and the plant, tick by tick.
pub struct Controlled {
    /// The controller.
    pub controller: Controller,
    /// The plant.
    pub plant: Plant,
    imu: ImuSim,
    tick: Duration,
    rng: Pcg64,
    input: TickInput,
    command: f64,
    last: State,
    /// True angle at the tare, rad: where this session's zero is.
    zero: f64,
}

impl Controlled {
    /// `control` of the first FREE of `plant`, both at rest; it ticks as fast as `control` says.
    pub fn new(control: &ControlConfig, plant: &BenchConfig) -> Result<Self, ControlledError> {
        let at = Time::from_nanos(1_000_000_000);
        Ok(Self {
            controller: Controller::new(control)?,
            plant: Plant::new(plant).starting_at(at),
            imu: plant.imu,
            tick: control.period,
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
                supply_low: false,
                heartbeat: at,
                trim: Trim::default(),
            },
            command: 0.0,
            last: State::Boot,
            zero: 0.0,
        })
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// Ticks in `seconds`.
    fn ticks(&self, seconds: f64) -> u32 {
        (seconds / self.tick.as_secs_f64()) as u32
    }

    /// Whether this tick is the first one in a period of a device.
    fn due(&self, period: Duration) -> bool {
        let now = u128::from(self.input.tick) * self.tick.as_nanos();
        now % period.as_nanos() < self.tick.as_nanos()
    }

    /// One tick: samples, controller, command.
    pub fn tick(&mut self, request: Option<Request>) -> TickRecord {
        self.input.tick += 1;
        self.input.time = self.input.time + self.tick;
        self.input.request = request;
        let time = self.input.time;
        self.plant.advance_to(time);
        if self.due(IMU.period) {
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
        if self.due(REGULATOR.period) {
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
        if self.due(REGULATOR.period) {
            self.command = record.frees[0].command;
            self.plant.set_setpoint(0, self.command, time);
        }
        self.last = record.state;
        record
    }

    /// Arms; where it then stands is the zero of this session.
    pub fn arm(&mut self) -> Result<(), ControlledError> {
        for _ in 0..25 {
            self.tick(None);
        }
        let refusal = self.tick(Some(Request::Arm)).refusal;
        let armed = refusal == Refusal::NONE && (0..self.ticks(1.0)).any(|_| self.tick(None).state == State::Hold);
        if !armed {
            return Err(ControlledError::Stays(self.last, refusal.code));
        }
        self.zero = self.plant.truth(0, self.input.time).angle;
        Ok(())
    }

    /// `sequence` of the angle (rad) as a program.
    pub fn program(sequence: &Sequence) -> Result<Arc<Program>, ControlledError> {
        let axis = Axis { quantity: Quantity::Angle, sequence: sequence.clone() };
        Ok(Arc::new(Program::new([(0, axis)])?))
    }

    /// Runs `sequence` of the angle (rad) for its duration and returns what came of it.
    pub fn run(&mut self, sequence: &Sequence) -> Result<Course, ControlledError> {
        let program = Self::program(sequence)?;
        let mut course = Course::default();
        let ticks = self.ticks(sequence.duration());
        let mut request = Some(Request::Start { program, attended: false, identify: false });
        for _ in 0..ticks {
            let record = self.tick(request.take());
            let truth = self.plant.truth(0, self.input.time).angle - self.zero;
            course.samples.push((record.program_time, record.frees[0].reference.position, truth));
            course.records.push(record);
        }
        course.state = self.last;
        Ok(course)
    }

    /// Down, and back to Disarmed.
    pub fn disarm(&mut self) -> Result<(), ControlledError> {
        let refusal = self.tick(Some(Request::Disarm)).refusal;
        if (0..self.ticks(10.0)).any(|_| self.tick(None).state == State::Disarmed) {
            return Ok(());
        }
        Err(ControlledError::Stays(self.last, refusal.code))
    }
}

/// A controller of `free` that takes it for `free`, with the acceptance's devices; without gains.
pub fn control_of(free: Free, controller: ControllerKind) -> ControlConfig {
    let free = FreeControl {
        name: "paper".into(),
        free,
        controller,
        gains: Gains::default(),
        derivative_on: DerivativeOn::Measurement,
        feedforward: 0.0,
        limits: Limits {
            pressure_max: 10.0 * PSI,
            pressure_warn: 10.5 * PSI,
            pressure_hard: 11.0 * PSI,
            pressure_zero: 0.2 * PSI,
            slew: 30.0 * PSI,
            angle_soft: (-1.6, 1.6),
            angle_hard: (-2.0, 2.0),
            tracking_error: (f64::INFINITY, 0.0),
        },
        imu: Some(IMU),
        regulator: REGULATOR,
    };
    ControlConfig {
        period: TICK,
        vent_time: Duration::from_millis(1500),
        ramp_time: Duration::from_secs(3),
        command_timeout: Duration::from_millis(100),
        require_realtime: false,
        dump_valve: false,
        frees: vec![free],
    }
}

const IMU: ImuChannel =
    ImuChannel { axis: [0.0, 0.0, 1.0], period: Duration::from_millis(10), delay: Duration::from_millis(15) };
const REGULATOR: RegulatorChannel = RegulatorChannel {
    period: Duration::from_millis(16),
    lag: Duration::from_millis(60),
    dead_time: Duration::from_millis(15),
    fastest_fill: 30.0 * PSI,
    full_scale: 15.0 * PSI,
    measures: true,
};

/// Gains for `free` behind these devices that meet `target`.
pub fn tuned(free: &Free, target: &Target) -> Result<Gains, ControlledError> {
    Ok(tune(free, &REGULATOR, &IMU, TICK, target)?.gains)
}

/// The controller that is led by the model of `free` and of its `hysteresis`.
pub fn led_by_model(free: Free, hysteresis: Hysteresis) -> Result<ControlConfig, ControlledError> {
    let spec = ModelSpec { hysteresis, statics: None };
    let mut control = control_of(free, ControllerKind::Model(spec));
    control.frees[0].gains = tuned(&free, &Target::MODEL)?;
    Ok(control)
}

/// Eq. 5 alone, with `gains`.
pub fn pid(free: Free, gains: Gains) -> ControlConfig {
    let mut control = control_of(free, ControllerKind::Pid);
    control.frees[0].gains = gains;
    control
}

/// How one plant was followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Followed {
    /// Root mean square of reference - true angle, rad.
    pub rms: f64,
    /// Its largest magnitude, rad.
    pub peak: f64,
    /// Whether it was followed to the end and then rests.
    pub stable: bool,
}

/// Follows `sequence` (rad) on the plant of `bench`, armed first.
pub fn follow(control: &ControlConfig, bench: &BenchConfig, sequence: &Sequence) -> Result<Followed, ControlledError> {
    let mut controlled = Controlled::new(control, bench)?;
    controlled.arm()?;
    let course = controlled.run(sequence)?;
    let (rms, peak) = course.errors();
    let tail = (TAIL.as_secs_f64() / control.period.as_secs_f64()) as usize;
    let tail = &course.samples[course.samples.len().saturating_sub(tail)..];
    let (low, high) = tail.iter().fold((f64::MAX, f64::MIN), |(a, b), s| (a.min(s.2), b.max(s.2)));
    let stable = course.state == State::Track && high - low < SWING_MAX;
    Ok(Followed { rms: rms.to_radians(), peak: peak.to_radians(), stable })
}

/// What a calibration brings: every parameter off by as much as an identification errs, and hysteresis weights fitted
/// to a slow staircase of the very plant (0 to 80 deg and nested loops), by non-negative least squares over a grid of
/// thresholds that is not the plant's.
pub fn calibrated(bench: &BenchConfig, seed: u64) -> Result<(Free, Hysteresis), ControlledError> {
    let mut plant = Plant::new(bench);
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut off = |x: f64, share: f64| x * (1.0 + share * (rng.random::<f64>() * 2.0 - 1.0));
    let exact = plant.true_free(0).copied().unwrap_or(bench.plants[0].nominal);
    let free = Free {
        torsional_stiffness: off(exact.torsional_stiffness, 0.003),
        torsional_damping: off(exact.torsional_damping, 0.02),
        inertia: off(exact.inertia, 0.02),
        ..exact
    };
    let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact))?;
    // As far up as the experiments go: 80 deg.
    let top = StaticMap::of_model(&exact, 1.4)?.pressure(1.4) / PSI;
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
            let act = model.actuation(truth.extension, angle)?;
            let moment = act.moment * psi * PSI - free.torsional_stiffness * angle;
            points.push((direction * angle, direction * moment));
        }
    }
    let highest = points.iter().fold(0.0, |a: f64, p| a.max(p.0));
    let thresholds = Hysteresis::grid(0.004 * highest, 0.25 * highest);
    let unit = Hysteresis::new(thresholds, [1.0; ELEMENTS])?;
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
    for _ in 0..ROUNDS {
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
    Ok((free, Hysteresis::new(thresholds, weights)?))
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

//! The whole controller on the ideal plant that the literature's gains were made for: no lag, no noise, sample and
//! command in the same tick. It follows the independent reference solution; a tick of delay or a slower tick and the
//! same gains diverge, and arming refuses them.

use std::time::Duration;

use freerig::clock::Time;
use freerig::config::gains::preset;
use freerig::control::margin::margin;
use freerig::control::{ControlConfig, Controller, FreeControl, Request, TickInput};
use freerig::model::{Free, Kinematics, Law, Lumped, LumpedState};
use freerig::signal::*;
use freerig::trajectory::paper_trajectory;

use crate::harness::{angle_program, config, free_control};

const TWO_KILOHERTZ: Duration = Duration::from_micros(500);
const FIVE_HUNDRED_HERTZ: Duration = Duration::from_millis(2);

/// The published FREE with the published gains, every device as fast as the tick and, but for `delay`, without delay.
fn ideal(period: Duration, delay: Duration) -> ControlConfig {
    let mut free = free_control(-40.0);
    free.free = Free::published_code();
    free.gains = preset("published-trajectory").unwrap();
    free.limits.slew = f64::INFINITY;
    let imu = free.imu.as_mut().unwrap();
    (imu.period, imu.delay) = (period, Duration::ZERO);
    let regulator = &mut free.regulator;
    (regulator.period, regulator.lag, regulator.dead_time) = (period, Duration::ZERO, delay);
    regulator.fastest_fill = 1e9;
    ControlConfig { period, ..config(vec![free]) }
}

/// Angle, rad, at every 10 ms of the reference solution.
fn reference() -> Vec<f64> {
    let text = include_str!("../reference/lumped/published_trajectory_nonlinear.csv");
    text.lines().skip(1).map(|line| line.split(',').nth(2).unwrap().parse().unwrap()).collect()
}

struct Ideal {
    controller: Controller,
    model: Lumped,
    state: LumpedState,
    period: Duration,
    tick: u64,
    /// What acts on the plant, Pa, and what the next ticks will bring.
    pressure: f64,
    line: Vec<f64>,
}

impl Ideal {
    /// Armed, at rest.
    fn new(config: &ControlConfig, delay_ticks: usize) -> Self {
        let model = Lumped::new(Free::published_code(), Law::Nonlinear(Kinematics::Published)).unwrap();
        let mut this = Self {
            controller: Controller::new(config).unwrap(),
            model,
            state: LumpedState::default(),
            period: config.period,
            tick: 0,
            pressure: 0.0,
            line: vec![0.0; delay_ticks],
        };
        this.tick(None);
        assert_eq!(this.tick(None).state, State::Disarmed);
        this.tick(Some(Request::Arm));
        assert!((0..1000).any(|_| this.tick(None).state == State::Hold));
        this
    }

    /// Sample and command of one tick.
    fn tick(&mut self, request: Option<Request>) -> TickRecord {
        self.tick += 1;
        let time = Time::ZERO + self.period * self.tick as u32;
        let (sin, cos) = (0.5 * self.state.rotation).sin_cos();
        let mut input = TickInput {
            tick: self.tick,
            time,
            latency_ns: 0,
            execution_ns: 0,
            skipped: 0,
            imu: [ImuSample::default(); MAX_FREES],
            pressure: [PressureSample::default(); MAX_FREES],
            request,
            estop: false,
            realtime: true,
            config_changed: false,
            supply_low: false,
            heartbeat: time,
            trim: Trim::default(),
        };
        let sequence = self.tick as u32;
        input.imu[0] = ImuSample {
            time,
            sequence,
            quaternion: [cos, 0.0, 0.0, sin],
            rate: [0.0, 0.0, self.state.rotation_rate],
            acceleration: [0.0; 3],
            calibration: 0xff,
            health: ImuHealth::Good,
        };
        input.pressure[0] = PressureSample {
            time,
            sequence,
            pressure: self.pressure,
            health: RegulatorHealth::Good,
            ..PressureSample::default()
        };
        let record = self.controller.tick(&input);
        self.line.push(record.frees[0].command);
        record
    }

    /// The plant, up to the next tick; false where it has left the model's domain.
    fn advance(&mut self) -> bool {
        self.pressure = self.line.remove(0);
        // The FREE rings at 122 Hz: 50 us are 1/164 of its period.
        let pieces = (self.period.as_secs_f64() / 50e-6).round();
        let h = self.period.as_secs_f64() / pieces;
        (0..pieces as u32).all(|_| self.model.step(&mut self.state, self.pressure, 0.0, 0.0, h).is_ok())
    }
}

/// RMS of the angle against the reference solution over the whole trajectory, deg; infinite where a fault or the end
/// of the model's domain came before.
fn strays(period: Duration, delay_ticks: usize) -> f64 {
    let config = ideal(period, period * delay_ticks as u32);
    let mut rig = Ideal::new(&config, delay_ticks);
    rig.line = vec![0.0; delay_ticks];
    let program = angle_program(paper_trajectory().unwrap());
    let mut request = Some(Request::Start { program, attended: false, identify: false });
    let every = (0.01 / period.as_secs_f64()).round() as usize;
    let reference = reference();
    let mut sum = 0.0;
    for k in 0..(reference.len() - 1) * every {
        if k % every == 0 {
            sum += (rig.state.rotation - reference[k / every]).powi(2);
        }
        let record = rig.tick(request.take());
        if record.state != State::Track || !rig.advance() {
            println!("ended at {:.2} s: {:?}", k as f64 * period.as_secs_f64(), record.latched);
            return f64::INFINITY;
        }
    }
    (sum / reference.len() as f64).sqrt().to_degrees()
}

#[test]
fn the_published_gains_follow_the_reference_solution_at_two_kilohertz() {
    let rms = strays(TWO_KILOHERTZ, 0);
    println!("{rms:.5} deg RMS");
    assert!(rms < 0.005, "{rms}");
}

#[test]
fn with_a_tick_of_delay_or_at_500_hertz_they_diverge() {
    for (period, delay) in [(TWO_KILOHERTZ, 1), (FIVE_HUNDRED_HERTZ, 0)] {
        let rms = strays(period, delay);
        // A limit cycle between the pressure's limits, or beyond what the rig or the model allows.
        assert!(rms > 5.0, "{period:?} {delay}: {rms}");
    }
}

#[test]
fn the_margin_that_arming_asks_for_knows_where_they_diverge() {
    let margin = |period, delay| {
        let config = ideal(period, delay);
        let free: &FreeControl = &config.frees[0];
        margin(free, config.period).unwrap()
    };
    assert!(margin(TWO_KILOHERTZ, Duration::ZERO).stable);
    for (period, delay) in [(TWO_KILOHERTZ, TWO_KILOHERTZ), (FIVE_HUNDRED_HERTZ, Duration::ZERO)] {
        let margin = margin(period, delay);
        assert!(!margin.stable && margin.problem().is_some(), "{margin:?}");
    }
}

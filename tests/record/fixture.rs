//! Runs as they come from a rig, without one: a PI loop round the lumped model behind a lagging regulator.

use std::path::Path;

use freerig::clock::Time;
use freerig::model::{Feedback, Free, Kinematics, Law, Load, Lumped, LumpedState};
use freerig::record::{
    FreeDocument, GainsDocument, LimitsDocument, LiveFeed, RecordOptions, Recorder, RunKind, StartDocument,
};
use freerig::signal::{
    FaultCode, ImuHealth, LimitSet, PressureSample, Quantity, RegulatorHealth, State, TickRecord, Truth,
};
use freerig::trajectory::Program;

pub const PERIOD_NS: u64 = 2_000_000;

/// Numbers that look like anything at all, the same every time (SplitMix64).
pub struct Scramble(pub u64);

impl Scramble {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }
    /// Uniform in -1..1.
    pub fn unit(&mut self) -> f64 {
        self.bits() as f64 / u64::MAX as f64 * 2.0 - 1.0
    }
}

/// A start document for the FREEs `names`, all of them the paper's.
pub fn start(kind: RunKind, names: &[&str]) -> StartDocument {
    StartDocument {
        kind,
        subject: names[0].into(),
        tick_period_s: PERIOD_NS as f64 * 1e-9,
        stepped: true,
        seed: Some(1),
        frees: names
            .iter()
            .map(|name| FreeDocument {
                name: (*name).into(),
                preset: "bench".into(),
                model: Free::paper().into(),
                gains: GainsDocument {
                    proportional_pa_per_rad: 12000.0,
                    integral_pa_per_rad_s: 120000.0,
                    ..GainsDocument::default()
                },
                limits: LimitsDocument { pressure_max_pa: 68_948.0, ..LimitsDocument::default() },
                ..FreeDocument::default()
            })
            .collect(),
        ..StartDocument::default()
    }
}

/// Runs `program` and records it, 0.7 s before it and 0.2 s after it, shown by a live view where there is one. The FREE
/// is 3 % softer than its model.
pub fn run(runs: &Path, mut start: StartDocument, program: &Program, seed: u64, live: Option<LiveFeed>) -> Recorder {
    let gains = start.frees[0].gains;
    start.program = Some(program.clone());
    let options = RecordOptions { truth: true, live, ..RecordOptions::default() };
    let mut recorder = Recorder::create(runs, start, options).unwrap();
    let real = Free { torsional_stiffness: 0.97 * Free::paper().torsional_stiffness, ..Free::paper() };
    let plant = Lumped::new(real, Law::Nonlinear(Kinematics::Exact)).unwrap();
    let mut state = LumpedState::default();
    let (mut pressure, mut integral, mut noise) = (0.0, 0.0, Scramble(seed));
    let dt = PERIOD_NS as f64 * 1e-9;
    let (before, after) = (350, 100);
    let ticks = (program.duration / dt).round() as u64;
    for tick in 0..before + ticks + after {
        let running = (before..before + ticks).contains(&tick);
        let t = (tick as f64 - before as f64) * dt;
        let mut record = TickRecord {
            tick,
            time: Time::from_nanos(1_000_000_000 + tick * PERIOD_NS),
            latency_ns: (18_000.0 + 9_000.0 * noise.unit() + if tick % 977 == 0 { 150_000.0 } else { 0.0 }) as u32,
            execution_ns: (4_000.0 + 800.0 * noise.unit()) as u32,
            skipped: u64::from(tick > 2000) * 2,
            state: match tick {
                0..100 => State::Disarmed,
                100..250 => State::Arming,
                _ if running => State::Track,
                _ => State::Hold,
            },
            free_count: 1,
            realtime: true,
            ..TickRecord::default()
        };
        let free = &mut record.frees[0];
        let angle = state.rotation + 8e-4 * noise.unit();
        if running {
            record.program_time = t;
            free.reference = program.reference(0, t);
        } else if tick >= before {
            free.reference = program.reference(0, program.duration);
        }
        match free.reference.quantity {
            Quantity::Angle => {
                let error = free.reference.position - angle;
                free.terms.proportional = gains.proportional_pa_per_rad * error;
                free.wanted = free.terms.proportional + integral;
                free.command = free.wanted.clamp(0.0, 68_948.0);
                if free.wanted == free.command {
                    integral += gains.integral_pa_per_rad_s * error * dt;
                } else {
                    free.limits.insert(LimitSet::INTEGRATOR_HELD);
                    free.limits.insert(if free.wanted < 0.0 {
                        LimitSet::PRESSURE_ZERO
                    } else {
                        LimitSet::PRESSURE_MAX
                    });
                }
                free.terms.integral = integral;
            }
            Quantity::Pressure => {
                free.wanted = free.reference.position;
                free.command = free.wanted;
            }
            Quantity::None => {}
        }
        if (2100..2200).contains(&tick) {
            free.faults.insert(FaultCode::PressureSensorRange);
        }
        free.estimate.angle = angle;
        free.estimate.valid = true;
        free.imu.health = ImuHealth::Good;
        free.pressure = PressureSample {
            time: record.time,
            sequence: tick as u32,
            pressure: pressure + 30.0 * noise.unit(),
            setpoint: free.command,
            health: RegulatorHealth::Good,
            ..PressureSample::default()
        };
        let command = free.command;
        let truth = Truth { angle: state.rotation, extension: state.extension, pressure, ..Truth::default() };
        recorder.push(&record, Some(&[truth])).unwrap();
        // First-order lag of 40 ms, then the plant over one period.
        pressure += (command - pressure) * (1.0 - (-dt / 0.04).exp());
        let step = plant.suggested_step(0.0);
        let pieces = (dt / step).ceil().max(1.0);
        for _ in 0..pieces as usize {
            plant.advance(&mut state, &mut 0.0, &Feedback::open(), Load::default(), |_| pressure, dt / pieces).unwrap();
        }
    }
    recorder
}

//! Cost of a step of the lumped model, and its speed against its error.
//!
//! `step`: one step of 0.25 ms in three situations. `five_psi`: 50 ms of the published FREE under 5 psi, which ring at
//! 122 Hz; the benchmark's name says the largest error of the rotation against steps of 1 us.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use freerig::model::{Feedback, Free, Kinematics, Law, Load, Lumped, LumpedState};

const FIVE_PSI: f64 = 34_473.786;
const SPAN: f64 = 0.05;
const INTERVALS: u32 = 50;

fn model(free: Free) -> Lumped {
    Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).expect("a preset is valid")
}

fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("step");
    let start = LumpedState { rotation: 0.5, extension: -4e-4, ..LumpedState::default() };
    for (name, free, feedback) in [
        ("open loop", Free::published_code(), Feedback::open()),
        ("closed loop", Free::published_code(), Feedback::pid(17236.9, 603291.5, 0.0, 0.0, 68947.57)),
        ("stiff loop, 2e6 per second", Free::paper(), Feedback::pid(32000.0, 0.0, 1.2e6, 0.0, 68947.57)),
    ] {
        let model = model(free);
        let signal = if feedback == Feedback::open() { FIVE_PSI } else { 0.6 };
        group.bench_function(name, |b| {
            b.iter(|| {
                let (mut state, mut integral) = (black_box(start), 0.02);
                let effort = model.advance(&mut state, &mut integral, &feedback, Load::default(), |_| signal, 2.5e-4);
                black_box((state, effort))
            });
        });
    }
    group.finish();
}

/// Rotations at every millisecond, in `per_interval` steps each.
fn ring(model: &Lumped, per_interval: u32) -> Vec<f64> {
    let mut state = LumpedState::default();
    let h = SPAN / f64::from(INTERVALS * per_interval);
    (0..INTERVALS)
        .map(|_| {
            for _ in 0..per_interval {
                model.step(&mut state, FIVE_PSI, 0.0, 0.0, h).expect("5 psi is within the domain");
            }
            state.rotation
        })
        .collect()
}

fn five_psi(c: &mut Criterion) {
    let model = model(Free::published_code());
    let exact = ring(&model, 1000);
    let mut group = c.benchmark_group("five_psi");
    for per_interval in [1, 2, 4, 8, 16] {
        let error = ring(&model, per_interval).iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let name = format!("{} us, error {error:.1e} rad", 1000 / per_interval);
        group.bench_function(BenchmarkId::from_parameter(name), |b| b.iter(|| ring(&model, black_box(per_interval))));
    }
    group.finish();
}

criterion_group!(benches, step, five_psi);
criterion_main!(benches);

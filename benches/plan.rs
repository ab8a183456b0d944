//! What plans cost: an inverse, a second of a path, a whisk, the workspace. With the closed-form section law; the
//! section's own makes an equilibrium about a fifth dearer.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use freerig::fem::module::{Loads, Module};
use freerig::plan::whisk::{Eight, Pattern, eight, pattern};
use freerig::plan::{Limits, Rest, Target, inverse, workspace};
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector3;

#[path = "../tests/plan/harness.rs"]
mod plan;

fn rest(module: &Module) -> Rest<'_> {
    Rest::new(module, &Loads::pressures([0.0; 4])).expect("a module stable at rest")
}

fn inverses(c: &mut Criterion) {
    let module = plan::module(60.0);
    let rest = rest(&module);
    let limits = Limits::up_to(7.0 * PSI);
    let tip = |pressures: [f64; 4]| {
        let state = rest.ramp(rest.state(), &pressures.map(|p| p * PSI)).expect("stable");
        Target::point(state.position())
    };
    let target = tip([3.0, 1.0, 0.5, 2.0]);
    // A tenth of a millimetre away, as between the samples of a path.
    let beside = Target { position: target.position + Vector3::new(1e-4, 1e-4, 0.0), ..target };
    let near = inverse::cold(&rest, &beside, &limits).expect("an inverse").state;
    let mut group = c.benchmark_group("inverse");
    group.bench_function("warm, 0.14 mm away", |b| {
        b.iter(|| inverse::warm(&rest, black_box(&target), &limits, &near, f64::INFINITY).expect("an inverse"));
    });
    group.bench_function("warm, from rest", |b| {
        b.iter(|| inverse::warm(&rest, black_box(&target), &limits, rest.state(), f64::INFINITY).expect("an inverse"));
    });
    group.sample_size(20);
    group.bench_function("cold", |b| {
        b.iter(|| inverse::cold(&rest, black_box(&target), &limits).expect("an inverse"));
    });
    let far = Target::point(Vector3::new(0.08, 0.0, 0.1));
    group.bench_function("cold, out of reach", |b| {
        b.iter(|| inverse::cold(&rest, black_box(&far), &limits).expect("an inverse"));
    });
    group.finish();
}

fn whisks(c: &mut Criterion) {
    let module = plan::module(60.0);
    let rest = rest(&module);
    let mut group = c.benchmark_group("whisk of 4 s at 100 Hz");
    group.sample_size(10);
    let gentle = Pattern { highest: 6.0 * PSI, middle: 4.0 * PSI, ..Pattern::paper() };
    let limits = Limits::up_to(10.0 * PSI);
    group.bench_function("pattern", |b| b.iter(|| pattern(&rest, black_box(&gentle), &limits, 100.0).expect("a plan")));
    let asked = Eight::level(Vector3::new(0.0, 0.0, 0.131), 0.010, 0.004, 0.25);
    group.bench_function("eight", |b| b.iter(|| eight(&rest, black_box(&asked), &limits, 100.0).expect("a plan")));
    group.finish();
}

fn workspaces(c: &mut Criterion) {
    let module = plan::module(30.0);
    let rest = rest(&module);
    let mut group = c.benchmark_group("workspace");
    group.sample_size(10);
    group.bench_function("15 paths of 50", |b| b.iter(|| workspace::cases(&rest, 7.0 * PSI, 50).expect("paths")));
    let limits = Limits::up_to(7.0 * PSI);
    let paths = workspace::cases(&rest, 7.0 * PSI, 50).expect("paths");
    group.bench_function("reach", |b| b.iter(|| workspace::reach(&rest, &limits, &paths).expect("a hull")));
    group.finish();
}

criterion_group!(benches, inverses, whisks, workspaces);
criterion_main!(benches);

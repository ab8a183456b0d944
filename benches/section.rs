//! Cost of the section: one warm point, a curve of 11 pressures, bending stiffness; and speed against error.
//!
//! `curve`: 0 to 10 psi or to the limit, from rest, free and blocked, on the meshes' levels; the name says the
//! error against level 4, up to 5 psi. `within`: the same on a mesh chosen for 0.5 %, with its estimate, at every
//! angle.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use freerig::fem::ends::Ends;
use freerig::fem::measure::{Outcome, difference};
use freerig::fem::section::{Mesh, Section, curve_within};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;

fn pressures() -> Vec<f64> {
    (0..=10).map(|k| f64::from(k) * PSI).collect()
}

fn reference() -> Tube {
    Tube::reference(40f64.to_radians())
}

fn section(mesh: Mesh) -> Section {
    Section::new(&reference(), mesh).expect("the reference tube is valid")
}

/// Relative difference from level 4 up to 5 psi.
fn error(mesh: Mesh, ends: Ends) -> f64 {
    let [found, fine] = [mesh, Mesh::level(4)].map(|mesh| {
        let points = section(mesh).curve(&pressures()[..6], ends).expect("the section rests");
        points.into_iter().map(|point| Outcome::from(&point.expect("5 psi is below the limits"))).collect::<Vec<_>>()
    });
    difference(&reference(), ends, &found.into_iter().zip(fine).collect::<Vec<_>>())
}

fn point(c: &mut Criterion) {
    let section = section(Mesh::default());
    let mut start = section.rest().expect("the section rests");
    section.advance(&mut start, 4.0 * PSI, Ends::FREE).expect("4 psi is below the limit");
    c.bench_function("point/warm, 4 to 5 psi", |b| {
        b.iter_batched(
            || start.clone(),
            |mut state| black_box(section.advance(&mut state, black_box(5.0 * PSI), Ends::FREE)),
            criterion::BatchSize::SmallInput,
        );
    });
    c.bench_function("point/bending stiffness", |b| b.iter(|| black_box(section.bending(black_box(&start)))));
}

fn curve(c: &mut Criterion) {
    let mut group = c.benchmark_group("curve");
    group.sample_size(10);
    for (name, ends) in [("free", Ends::FREE), ("blocked", Ends::BLOCKED)] {
        for level in 1..=2 {
            let section = section(Mesh::level(level));
            let error = error(Mesh::level(level), ends);
            group.bench_function(format!("{name}, level {level}, error {error:.1e}"), |b| {
                b.iter(|| black_box(section.curve(black_box(&pressures()), ends)));
            });
        }
    }
    group.finish();
}

fn within(c: &mut Criterion) {
    let mut group = c.benchmark_group("within 0.5 %");
    group.sample_size(10);
    for degrees in [20.0_f64, 40.0, 60.0, 80.0] {
        let tube = Tube::reference(degrees.to_radians());
        for (name, ends) in [("free", Ends::FREE), ("blocked", Ends::BLOCKED)] {
            let solve = || curve_within(&tube, black_box(&pressures()), ends, 5e-3);
            let estimate = solve().expect("the section rests").error.expect("the first pressures are below every fold");
            group.bench_function(format!("{degrees} deg, {name}, estimated {estimate:.1e}"), |b| b.iter(solve));
        }
    }
    group.finish();
}

criterion_group!(benches, point, curve, within);
criterion_main!(benches);

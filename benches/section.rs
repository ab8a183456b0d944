//! Cost of the section: one warm point, a curve of 11 pressures, bending stiffness; and speed against error.
//!
//! `curve`: 0 to 10 psi or to the limit, from rest, free and blocked, on the meshes' levels; the name says the largest
//! error of the motion (free) or the load (blocked) against level 4, as a vector, at the pressures up to 5 psi.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use freerig::fem::ends::{Ends, Equilibrium};
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

/// Largest relative difference up to 5 psi.
fn error(mesh: Mesh, ends: Ends) -> f64 {
    let [found, fine] = [mesh, Mesh::level(4)].map(|mesh| {
        let points = section(mesh).curve(&pressures()[..6], ends).expect("the section rests");
        points.into_iter().skip(1).map(|point| point.expect("5 psi is below the limits")).collect::<Vec<_>>()
    });
    let ro = reference().outer_radius();
    let of = |e: &Equilibrium| {
        if ends == Ends::FREE { [e.stretch - 1.0, e.twist * ro] } else { [e.force, e.moment / ro] }
    };
    let relative = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) / b[0].hypot(b[1]);
    found.iter().zip(&fine).map(|(a, b)| relative(of(a), of(b))).fold(0.0, f64::max)
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
        group.bench_function(format!("{name}, estimated within 0.5 %"), |b| {
            b.iter(|| black_box(curve_within(&reference(), black_box(&pressures()), ends, 5e-3)));
        });
    }
    group.finish();
}

criterion_group!(benches, point, curve);
criterion_main!(benches);

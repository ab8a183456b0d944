//! Cost of the solid: 0 to 7 psi free at 40 deg, on the usual meshes and on coarser ones; a module of four tubes.
//!
//! The name says the unknowns and the corrections of the whole path.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use freerig::fem::ends::Ends;
use freerig::fem::solid::{Mesh, Solid, SolidModule, SolidPath, Tip};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector3;

fn follow(solid: &mut Solid) -> SolidPath {
    let pressures: Vec<f64> = (1..=7).map(|k| f64::from(k) * PSI).collect();
    solid.follow(&Tip::straight(Ends::FREE), black_box(&pressures), &mut |_| {}).expect("7 psi is below the limit")
}

fn single(c: &mut Criterion) {
    let mut group = c.benchmark_group("0 to 7 psi free");
    group.sample_size(10);
    let strip = Tube::reference(40f64.to_radians());
    let line = Tube { fiber_width: 0.0, ..strip };
    let usual = Mesh::sector(&strip);
    let coarse = Mesh { wall: 1, around: 1, around_growth: 4.84, along_growth: 4.0, largest: 20e-3, ..usual };
    for (name, tube, mesh) in
        [("strip", strip, usual), ("strip, coarse", strip, coarse), ("line", line, Mesh::sector(&line))]
    {
        let mut solid = Solid::new(&tube, 0.13, &mesh, None).expect("the reference tube is valid");
        let corrections = follow(&mut solid).iterations;
        let unknowns = solid.unknowns();
        group.bench_function(format!("{name}, {unknowns} unknowns, {corrections} corrections"), |b| {
            b.iter(|| black_box(follow(&mut solid)));
        });
    }
    group.finish();
}

fn module(c: &mut Criterion) {
    let mut group = c.benchmark_group("module, A and B to 3.5 psi");
    group.sample_size(10);
    let gamma = 30f64.to_radians();
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(gamma) };
    let mesh = Mesh { around: 1, first: 2e-3, most_turn: 1.0, ..Mesh::whole(&tube) };
    let mut module = SolidModule::new(&tube, 0.13, [gamma, -gamma, gamma, -gamma], &mesh, 0.02).expect("it is valid");
    let pressures = [[3.5 * PSI, 3.5 * PSI, 0.0, 0.0]];
    group.bench_function(format!("30 deg, {} unknowns", module.unknowns()), |b| {
        b.iter(|| black_box(module.follow(&Vector3::zeros(), black_box(&pressures), &mut |_| {})));
    });
    group.finish();
}

criterion_group!(benches, single, module);
criterion_main!(benches);

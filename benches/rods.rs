//! Rods' speed against their error: a bent cantilever (R1) and four rods under a plate (R2), whose answers are known.
//!
//! A benchmark's name says the resolution (degree, steps) and the distance from the known tip, in lengths. `cold` is
//! from rest, `warm` from the equilibrium at a load half a per cent away. Everything that a state says is included:
//! stability, stiffness, sensitivities.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use freerig::fem::module::{Loads, Module, Mount};
use freerig::fem::rod::{Law, Profile, Resolution, Rod, Straight};
use nalgebra::Vector3;

const MM: f64 = 1e-3;
const LENGTH: f64 = 130.0 * MM;
const RESOLUTIONS: [(usize, usize); 5] = [(1, 2), (2, 3), (3, 4), (4, 4), (5, 8)];

fn mount(x: f64, y: f64, extension: f64, twist_per_mm: f64) -> Mount {
    let law = Law {
        straight: Straight::spontaneous(30.606, 273.264e-6, extension, twist_per_mm / MM),
        bending: Profile::constant(409.895e-6),
        shear: Profile::constant(5.4070),
        coupling: Profile::constant(0.0),
        mirrored: false,
    };
    Mount { base: Vector3::new(x, y, 0.0) * MM, rod: Rod::straight(LENGTH, law) }
}

fn name((degree, steps): (usize, usize), got: Vector3<f64>, want: [f64; 3]) -> String {
    let error = (got - Vector3::from(want) * MM).norm() / LENGTH;
    format!("degree {degree}, {steps} steps, error {:.4} %", 100.0 * error)
}

fn r1(c: &mut Criterion) {
    let mut group = c.benchmark_group("R1 cold");
    let force = Vector3::new(0.015, 0.008, -0.010);
    let loads = Loads { force, moment: Vector3::new(-0.6, 2.2, 0.4) * MM, ..Loads::pressures([0.0]) };
    for at in RESOLUTIONS {
        let resolution = Resolution { degree: at.0, steps: at.1 };
        let module = Module::new(vec![mount(0.0, 0.0, 0.0, 0.0)], 0.0, resolution).expect("a valid module");
        let solve = || module.equilibrium(black_box(&loads)).expect("R1 has an equilibrium");
        let name = name(at, solve().position(), [65.88336991, 28.14646053, 100.65456905]);
        group.bench_function(BenchmarkId::from_parameter(name), |b| b.iter(solve));
    }
    group.finish();
}

fn r2(c: &mut Criterion) {
    let loads = |fz: f64| Loads { force: Vector3::new(0.0, 0.0, fz), ..Loads::pressures([1.0; 4]) };
    for kind in ["cold", "warm"] {
        let mut group = c.benchmark_group(format!("R2 {kind}"));
        for at in RESOLUTIONS {
            let mounts = vec![
                mount(-10.0, 10.0, 0.06, 0.008),
                mount(-10.0, -10.0, 0.03, -0.004),
                mount(10.0, -10.0, 0.0, 0.0),
                mount(10.0, 10.0, 0.015, -0.002),
            ];
            let resolution = Resolution { degree: at.0, steps: at.1 };
            let module = Module::new(mounts, 0.0, resolution).expect("a valid module");
            let near = module.equilibrium(&loads(-0.199)).expect("R2 has an equilibrium");
            let solve = || {
                let loads = black_box(loads(-0.2));
                let state =
                    if kind == "cold" { module.equilibrium(&loads) } else { module.equilibrium_from(&near, &loads) };
                state.expect("R2 has an equilibrium")
            };
            let name = name(at, solve().position(), [19.68336597, -11.19964926, 130.75976188]);
            group.bench_function(BenchmarkId::from_parameter(name), |b| b.iter(solve));
        }
        group.finish();
    }
}

criterion_group!(benches, r1, r2);
criterion_main!(benches);

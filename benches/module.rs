//! The reference module's speed against its error, with the law of the section.
//!
//! A benchmark's name says the resolution (degree, steps) and the distance of the plate from where a far finer one puts
//! it, over its travel. `cold` is from rest, `warm` from the equilibrium at pressures 2 % away; both end with
//! stability, clearance and the sensitivities to each pressure. `workspace` is 15 actuation paths in 50 steps up to 7
//! psi, those that end earlier cut there; `law` the table of one FREE and one look into it.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use freerig::fem::module::{Loads, Module, ModuleScene, State};
use freerig::fem::rod::Resolution;
use freerig::fem::section::Mesh;
use freerig::fem::section_law::{Request, SectionLaw};
use freerig::units::PASCAL_PER_PSI as PSI;

const RESOLUTIONS: [(usize, usize); 6] = [(2, 2), (3, 3), (3, 4), (4, 4), (4, 6), (5, 8)];
/// Steps of a path of the workspace.
const STEPS: usize = 50;

fn scene(degrees: f64) -> ModuleScene {
    ModuleScene::reference(degrees.to_radians())
}

fn request(degrees: f64) -> Request {
    scene(degrees).request(0, Mesh::default(), 10.0 * PSI)
}

fn module(degrees: f64, law: &SectionLaw, (degree, steps): (usize, usize)) -> Module {
    let laws = |_: &Request| Ok(law.clone());
    scene(degrees).module(Mesh::default(), 10.0 * PSI, Resolution { degree, steps }, laws).expect("a valid scene")
}

fn name((degree, steps): (usize, usize), module: &Module, state: &State) -> String {
    let fine = module.with_resolution(Resolution { degree: 8, steps: 16 }).expect("a valid resolution");
    let fine = fine.equilibrium(state.loads()).expect("the finer rods rest, too");
    let error = (fine.position() - state.position()).norm() / (fine.position() - module.rest()).norm();
    format!("degree {degree}, {steps} steps, error {:.4} %", 100.0 * error)
}

fn law(c: &mut Criterion) {
    let mut group = c.benchmark_group("law");
    group.sample_size(10);
    for degrees in [30.0, 60.0] {
        let request = request(degrees);
        group.bench_function(format!("table of {degrees} deg"), |b| {
            b.iter(|| SectionLaw::build(black_box(&request)).expect("a valid tube"));
        });
    }
    group.finish();
    let law = SectionLaw::build(&request(60.0)).expect("a valid tube").law(1.0);
    c.bench_function("law/look into it", |b| {
        b.iter(|| law.jet(black_box(1.001), black_box(1.0), black_box(2.0 * PSI)));
    });
}

fn equilibrium(c: &mut Criterion) {
    for degrees in [30.0, 60.0] {
        let law = SectionLaw::build(&request(degrees)).expect("a valid tube");
        for (case, on) in [("case 3", [1.0, 0.0, 0.0, 0.0]), ("case 4", [1.0, 1.0, 0.0, 0.0])] {
            let loads = |psi: f64| Loads::pressures(on.map(|x| x * psi * PSI));
            for kind in ["cold", "warm"] {
                let mut group = c.benchmark_group(format!("{degrees} deg, {case} at 3.5 psi, {kind}"));
                for at in RESOLUTIONS {
                    let module = module(degrees, &law, at);
                    let near = module.equilibrium(&loads(3.43)).expect("3.5 psi is below every limit");
                    let solve = || {
                        let loads = black_box(loads(3.5));
                        let state = match kind {
                            "cold" => module.equilibrium(&loads),
                            _ => module.equilibrium_from(&near, &loads),
                        };
                        let state = state.expect("3.5 psi is below every limit");
                        black_box(state.by_pressure());
                        state
                    };
                    let name = name(at, &module, &solve());
                    group.bench_function(BenchmarkId::from_parameter(name), |b| b.iter(solve));
                }
                group.finish();
            }
        }
    }
}

fn workspace(c: &mut Criterion) {
    let mut group = c.benchmark_group("workspace");
    group.sample_size(10);
    for degrees in [30.0, 60.0] {
        let law = SectionLaw::build(&request(degrees)).expect("a valid tube");
        let module = module(degrees, &law, (3, 4));
        let rest = module.equilibrium(&Loads::pressures([0.0; 4])).expect("the module rests");
        let follow = |which: u32| {
            let mut state = rest.clone();
            for step in 1..=STEPS {
                let psi = 7.0 * step as f64 / STEPS as f64;
                let on = |i: u32| if which >> i & 1 == 1 { psi * PSI } else { 0.0 };
                match module.equilibrium_from(&state, &Loads::pressures([0, 1, 2, 3].map(on))) {
                    Ok(next) => state = next,
                    Err(_) => break,
                }
            }
            state
        };
        group.bench_function(format!("{degrees} deg, degree 3, 4 steps"), |b| {
            b.iter(|| (1..16).map(follow).collect::<Vec<_>>());
        });
    }
    group.finish();
}

criterion_group!(benches, law, equilibrium, workspace);
criterion_main!(benches);

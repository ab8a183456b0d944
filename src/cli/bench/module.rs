//! The reference module with the section's own law: error against time over the rods' resolution, of equilibria,
//! Jacobians, inverses and plans.
//!
//! Errors are against the finest resolution with the same law: the rods' discretisation alone; those of an equilibrium
//! are relative to the plate's travel, all others to the FREEs' length. What the law itself is off by is told apart,
//! and what rods leave out (ends, cross-sections that deform) is the model's error, which only the solid tells. One
//! thread; the table of a law is made on all cores.

use std::time::Instant;

use anyhow::Context as _;
use nalgebra::Vector3;

use super::{Size, row, stopwatch};
use crate::cli::{Failure, Progress};
use crate::fem::module::{Loads, Module, ModuleScene, State};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::fem::section_law::{Request, SectionLaw};
use crate::plan::whisk::{Eight, eight};
use crate::plan::workspace::cases;
use crate::plan::{Limits, Rest, Target, inverse, path};
use crate::record::{BenchRow, BenchSuite, Curve};
use crate::units::PASCAL_PER_PSI as PSI;

const SUITE: &str = "module";
/// Winding angles, deg.
const ANGLES: [f64; 2] = [30.0, 60.0];
/// Degrees of the strains' polynomials and Magnus steps; what errors are measured by.
const RESOLUTIONS: [(usize, usize); 6] = [(2, 2), (3, 3), (3, 4), (4, 4), (4, 6), (5, 8)];
const FINEST: (usize, usize) = (8, 16);
/// The resolutions of plans.
const PLANS: [(usize, usize); 2] = [(3, 4), (4, 4)];
/// Highest pressure of the laws, of the equilibria, and of the workspace, Pa.
const LAW: f64 = 10.0 * PSI;
const AT: f64 = 3.5 * PSI;
const TOP: f64 = 7.0 * PSI;
/// A warm start's pressures, relative.
const NEAR: f64 = 0.98;
/// The paper's cases of the equilibria: which FREEs have the pressure.
const CASES: [(&str, [f64; 4]); 2] = [("case 3", [1.0, 0.0, 0.0, 0.0]), ("case 4", [1.0, 1.0, 0.0, 0.0])];
/// Pressures whose plate is the inverse's target, psi, and how far from it a warm search begins, m.
const TARGET: [f64; 4] = [3.0, 1.0, 0.5, 2.0];
const BESIDE: Vector3<f64> = Vector3::new(1e-4, 1e-4, 0.0);
/// Pressures of a path of the workspace; samples of a whisk, Hz, and each how many of them is looked at with the finest
/// rods.
const POINTS: usize = 50;
const RATE: f64 = 100.0;
const EACH: usize = 8;
/// The error at which times are told.
const LEVEL: f64 = 1e-3;

/// Where everything is put.
#[derive(Default)]
struct Found {
    rows: Vec<BenchRow>,
    curves: Vec<Curve>,
    facts: Vec<(String, String)>,
}

/// Laws, then everything that is done with them.
pub(super) fn run(_: &Size<'_>) -> Result<BenchSuite, Failure> {
    let mut found = Found::default();
    let mut progress = Progress::new("module", 6.0, "parts");
    let mut laws = Vec::new();
    for degrees in ANGLES {
        laws.push(found.law(degrees)?);
    }
    progress.set(1.0, "equilibria");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("a pool of one thread")?;
    pool.install(|| -> Result<(), Failure> {
        for (degrees, law) in ANGLES.into_iter().zip(&laws) {
            let finest = module(degrees, law, FINEST)?;
            found.equilibria(degrees, law, &finest)?;
        }
        progress.set(3.0, "inverse");
        let finest = module(ANGLES[1], &laws[1], FINEST)?;
        found.inverses(ANGLES[1], &laws[1], &finest)?;
        progress.set(4.0, "whisk");
        found.whisks(ANGLES[1], &laws[1], &finest)?;
        progress.set(5.0, "workspace");
        found.workspaces(ANGLES[0], &laws[0])
    })?;
    found.headlines();
    Ok(BenchSuite {
        name: SUITE,
        title: "The module of four FREEs",
        facts: found.facts,
        rows: found.rows,
        caption: "Error against time of an equilibrium at 3.5 psi, over the rods' resolution",
        x_label: "log10 of the time in ms",
        y_label: "log10 of the distance over the travel",
        curves: found.curves,
        ..BenchSuite::default()
    })
}

fn module(degrees: f64, law: &SectionLaw, (degree, steps): (usize, usize)) -> Result<Module, Failure> {
    let laws = |_: &Request| Ok(law.clone());
    let scene = ModuleScene::reference(degrees.to_radians());
    Ok(scene.module(Mesh::default(), LAW, Resolution { degree, steps }, laws)?)
}

fn how((degree, steps): (usize, usize)) -> String {
    format!("degree {degree}, {steps} steps")
}

impl Found {
    fn push(&mut self, method: &str, case: String, error: Option<f64>, time: f64) {
        self.rows.push(row(SUITE, method, case, error, Some(time)));
    }

    /// The law of one FREE, with what it is off by.
    fn law(&mut self, degrees: f64) -> Result<SectionLaw, Failure> {
        let request = ModuleScene::reference(degrees.to_radians()).request(0, Mesh::default(), LAW);
        let begun = Instant::now();
        let law = SectionLaw::build(&request)?;
        let time = begun.elapsed().as_secs_f64();
        let errors = law.errors();
        let mesh = Some(errors.mesh).filter(|error| error.is_finite());
        let case = |what: &str| format!("{degrees} deg, to 10 psi, all cores: {what}");
        self.push("law's table", case("the section's mesh"), mesh, time);
        self.push("law's table", case("EI between its points, in nine of ten"), Some(errors.mostly), time);
        self.facts.push((
            format!("the law's own error, {degrees} deg"),
            format!(
                "between its points stretch {:.1e}, twist {:.3} rad/m, EI {:.2} % in nine of ten and {:.2} % in the worst; the section's mesh {:.2} %",
                errors.stretch,
                errors.twist,
                100.0 * errors.mostly,
                100.0 * errors.bending,
                100.0 * errors.mesh
            ),
        ));
        Ok(law)
    }

    /// Cold from rest, warm from pressures 2 % lower; both with stability, clearance and the Jacobian.
    fn equilibria(&mut self, degrees: f64, law: &SectionLaw, finest: &Module) -> Result<(), Failure> {
        for (case, on) in CASES {
            let loads = |pressure: f64| Loads::pressures(on.map(|x| x * pressure));
            let known = finest.equilibrium(&loads(AT))?;
            let travel = (known.position() - finest.rest()).norm();
            let slopes = slopes(&known)?;
            let case = format!("{degrees} deg, {case}, 3.5 psi");
            for start in ["cold", "warm"] {
                let (mut x, mut y) = (Vec::new(), Vec::new());
                for at in RESOLUTIONS {
                    let module = module(degrees, law, at)?;
                    let near = module.equilibrium(&loads(NEAR * AT))?;
                    let solve = || -> Result<_, Failure> {
                        let (warm, loads) = (start == "warm", loads(AT));
                        let state =
                            if warm { module.equilibrium_from(&near, &loads)? } else { module.equilibrium(&loads)? };
                        let found = self::slopes(&state)?;
                        Ok((state, found))
                    };
                    let ((state, found), time) = stopwatch::best(solve)?;
                    let error = (state.position() - known.position()).norm() / travel;
                    let named = format!("{case}, {}", how(at));
                    self.push(&format!("equilibrium, {start}"), named.clone(), Some(error), time);
                    x.push((1e3 * time).log10());
                    y.push(error.max(f64::MIN_POSITIVE).log10());
                    if start == "warm" {
                        let (_, time) = stopwatch::best(|| self::slopes(&state))?;
                        let size = slopes.iter().map(|slope| slope.norm()).fold(0.0, f64::max);
                        let off = found.iter().zip(&slopes).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
                        self.push("Jacobian, from the factorisation", named, Some(off / size), time);
                    }
                }
                self.curves.push((format!("{case}, {start}"), x, y));
            }
        }
        Ok(())
    }

    /// To a point whose pressures are known to the finest rods; the error is where those then put the plate.
    fn inverses(&mut self, degrees: f64, law: &SectionLaw, finest: &Module) -> Result<(), Failure> {
        let limits = Limits::up_to(TOP);
        let place = finest.equilibrium(&Loads::pressures(TARGET.map(|psi| psi * PSI)))?.position();
        let target = Target::point(place);
        let beside = Target { position: place + BESIDE, ..target };
        for at in RESOLUTIONS {
            let module = module(degrees, law, at)?;
            let rest = Rest::new(&module, &Loads::pressures([0.0; 4]))?;
            let near = inverse::cold(&rest, &beside, &limits)?.state;
            let warm = || -> Result<_, Failure> { Ok(inverse::warm(&rest, &target, &limits, &near, f64::INFINITY)?) };
            let cold = || -> Result<_, Failure> { Ok(inverse::cold(&rest, &target, &limits)?) };
            for (method, (found, time)) in
                [("inverse, warm", stopwatch::best(warm)?), ("inverse, cold", stopwatch::best(cold)?)]
            {
                let there = finest.equilibrium(&Loads::pressures(found.pressures))?.position();
                let error = found.shortfall.is_none().then(|| (there - place).norm() / module.length());
                self.push(method, format!("{degrees} deg, a point, {}", how(at)), error, time);
            }
        }
        Ok(())
    }

    /// A figure eight of 10 x 4 mm in four seconds; the error is the largest distance of its predicted path from the
    /// finest rods' one.
    fn whisks(&mut self, degrees: f64, law: &SectionLaw, finest: &Module) -> Result<(), Failure> {
        let limits = Limits::up_to(LAW);
        let asked = Eight::level(Vector3::new(0.0, 0.0, 0.131), 0.010, 0.004, 0.25);
        let fine = Rest::new(finest, &Loads::pressures([0.0; 4]))?;
        for at in PLANS {
            let module = module(degrees, law, at)?;
            let rest = Rest::new(&module, &Loads::pressures([0.0; 4]))?;
            let (plan, time) = stopwatch::best(|| Ok(eight(&rest, &asked, &limits, RATE)?))?;
            let plan = plan.plan;
            let each = |k: &usize| k.is_multiple_of(EACH);
            let some: Vec<usize> = (0..plan.times.len()).filter(each).collect();
            let times: Vec<f64> = some.iter().map(|&k| plan.times[k]).collect();
            let pressures: Vec<[f64; 4]> = some.iter().map(|&k| plan.pressures[k]).collect();
            let there = path::forecast(&fine, &times, &pressures)?;
            let off = some
                .iter()
                .zip(&there.predicted)
                .map(|(&k, pose)| (Vector3::from(pose.position) - Vector3::from(plan.predicted[k].position)).norm());
            let error = (there.predicted.len() == some.len()).then(|| off.fold(0.0, f64::max) / module.length());
            let case = format!("{degrees} deg, eight of 10 x 4 mm, {} samples, {}", plan.times.len(), how(at));
            self.push("whisk plan", case, error, time);
        }
        Ok(())
    }

    /// The fifteen paths; the error is the largest distance at their ends from the finest rods' ones.
    fn workspaces(&mut self, degrees: f64, law: &SectionLaw) -> Result<(), Failure> {
        let paths = |at| -> Result<_, Failure> {
            let module = module(degrees, law, at)?;
            let rest = Rest::new(&module, &Loads::pressures([0.0; 4]))?;
            let (paths, time) = stopwatch::best(|| Ok(cases(&rest, TOP, POINTS)?))?;
            // Where a path ends early, at contact, resolutions may differ by one of its pressures.
            let ends: Vec<_> = paths
                .into_iter()
                .map(|p| p.poses.iter().map(|q| Vector3::from(q.position)).collect::<Vec<_>>())
                .collect();
            Ok((ends, time, module.length()))
        };
        let (known, ..) = paths(FINEST)?;
        for at in PLANS {
            let (found, time, length) = paths(at)?;
            let apart = found.iter().zip(&known).flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| (a - b).norm());
            let error = apart.fold(0.0, f64::max) / length;
            let case = format!("{degrees} deg, 15 paths of {POINTS} to 7 psi, {}", how(at));
            self.push("workspace", case, Some(error), time);
        }
        Ok(())
    }

    /// The least time of each method at which every one of its cases is within a per mille.
    fn headlines(&mut self) {
        for method in
            ["equilibrium, cold", "equilibrium, warm", "inverse, cold", "inverse, warm", "whisk plan", "workspace"]
        {
            let of = |at: &(usize, usize)| {
                let rows = self.rows.iter().filter(|r| r.method == method && r.case.ends_with(&how(*at)));
                let (mut time, mut error, mut any) = (0.0f64, 0.0f64, false);
                for row in rows {
                    time = time.max(row.time_s.unwrap_or(f64::INFINITY));
                    error = error.max(row.relative_error.unwrap_or(f64::INFINITY));
                    any = true;
                }
                (any && error <= LEVEL).then_some((time, error, *at))
            };
            let good = RESOLUTIONS.iter().filter_map(of).min_by(|a, b| a.0.total_cmp(&b.0));
            let text = good.map_or("no resolution is".into(), |(time, error, at)| {
                format!("{:.3} ms at {:.3} %, {}", 1e3 * time, 100.0 * error, how(at))
            });
            self.facts.push((format!("{method}, every case within 0.1 %"), text));
        }
    }
}

/// The plate's travel by each pressure, m/Pa.
fn slopes(state: &State) -> Result<Vec<Vector3<f64>>, Failure> {
    let twists = state.by_pressure().context("an equilibrium that is not critical")?;
    Ok(twists.iter().map(|twist| twist.fixed_rows::<3>(3).into_owned()).collect())
}

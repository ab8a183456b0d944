//! Tiers of the finite elements against the finest section: error against time over the mesh.
//!
//! Errors are those of [`crate::fem::measure`], over all pressures of a case. What the reference leaves itself, the
//! section on level 4, is about a sixteenth of level 1's discretisation error. The section lacks the ends, which the
//! solid has: at mid-length the two solve the same problem, over the whole length they differ by the ends, and only a
//! finer solid tells the solid's own discretisation error of that. [`calculix`] is the peer that is compared with it.

use std::time::Instant;

use super::{Size, calculix, in_parallel, quantile, row};
use crate::cli::{Failure, Progress};
use crate::fem::fidelity::{Fidelity, Hold, Scene, ask};
use crate::fem::measure::{Outcome, difference};
use crate::fem::section::{Mesh, Section, SectionError, curve_within};
use crate::fem::solid::{self, Solid, SolidEquilibrium, Tip};
use crate::fem::tube::Tube;
use crate::record::{BenchRow, BenchSuite, Curve};
use crate::units::PASCAL_PER_PSI as PSI;

const SUITE: &str = "fem";
/// Winding angle, deg, and ends of the named cases.
const CASES: [(f64, Hold); 3] = [(40.0, Hold::Free), (60.0, Hold::Free), (40.0, Hold::Blocked)];
/// Length of the named cases' FREEs, m.
const LENGTH: f64 = 0.13;
/// Their pressures, psi: below every limit, folds of the reference's mesh included.
const PRESSURES: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
/// Levels of the section's mesh, and the reference's.
const LEVELS: [usize; 3] = [1, 2, 3];
const REFERENCE: usize = 4;
/// Elements through the wall of the smeared section.
const SMEARED: usize = 2;
/// What the automatic mesh is asked for.
const TOLERANCE: f64 = 5e-3;
/// Widths of the fibres that are compared, mm.
const WIDTHS: [f64; 3] = [0.2, 0.4, 0.97];
/// Below this, a solve is repeated until its time can be told, s.
const SHORT: f64 = 1e-4;

/// What a tier says at some pressures, in their order; none where one of them is beyond a limit.
type Answer = Option<Vec<Outcome>>;

/// How a tier answers.
type Ask = dyn Fn(&Scene) -> Result<Answer, Failure> + Sync;
/// Error and time of every tier, in their order.
type Told = Vec<(Option<f64>, f64)>;

/// A tier: what the table calls it, and how it answers.
struct Tier {
    name: String,
    answer: Box<Ask>,
}

/// Runs the named cases, then the geometries.
pub(super) fn run(size: &Size) -> Result<BenchSuite, Failure> {
    let start = Instant::now();
    let (mut rows, mut curves, mut facts) = (Vec::new(), Vec::new(), Vec::new());
    named(&mut rows, &mut curves)?;
    let count = size.count;
    seeded(count, &mut rows, &mut curves, &mut facts)?;
    let claims = calculix::beside(&mut rows, &mut curves, &mut facts)?;
    facts.push(("width of the fibres, 40 deg".into(), widths()?));
    facts.push(("wall time".into(), format!("{:.1} s", start.elapsed().as_secs_f64())));
    Ok(BenchSuite {
        name: SUITE,
        title: "Finite elements: every tier against the finest section",
        facts,
        rows,
        claims,
        caption: "Error against time of a curve of pressures, over the mesh",
        x_label: "log10 of the time in ms",
        y_label: "log10 of the relative error",
        curves,
        ..BenchSuite::default()
    })
}

/// Every tier but the solid, from cheap to dear.
fn tiers() -> Vec<Tier> {
    let closed = |fidelity: Fidelity| Tier {
        name: fidelity.name().into(),
        answer: Box::new(move |scene| {
            let points = ask(scene, fidelity, &mut |_| {})?.points;
            Ok(points.into_iter().map(|p| p.rest.map(Outcome::from)).collect())
        }),
    };
    let smeared = Tier {
        name: "smeared".into(),
        answer: Box::new(|scene| on_section(scene, &Section::smeared(&scene.tube, SMEARED)?)),
    };
    let section = |level: usize| Tier {
        name: format!("section, level {level}"),
        answer: Box::new(move |scene| on_section(scene, &Section::new(&scene.tube, Mesh::level(level))?)),
    };
    let within = Tier { name: format!("section, within {} %", 100.0 * TOLERANCE), answer: Box::new(within) };
    let first = [closed(Fidelity::Linear), closed(Fidelity::Nonlinear), smeared];
    first.into_iter().chain(LEVELS.map(section)).chain([within]).collect()
}

fn on_section(scene: &Scene, section: &Section) -> Result<Answer, Failure> {
    outcomes(section.curve(&scene.pressures, scene.hold.ends())?)
}

fn within(scene: &Scene) -> Result<Answer, Failure> {
    outcomes(curve_within(&scene.tube, &scene.pressures, scene.hold.ends(), TOLERANCE)?.points)
}

/// A limit is no answer; any other failure is one of the suite.
fn outcomes(points: Vec<Result<crate::fem::ends::Equilibrium, SectionError>>) -> Result<Answer, Failure> {
    let outcome = |point: Result<_, SectionError>| match point {
        Ok(found) => Ok(Some(Outcome::from(&found))),
        Err(SectionError::BeyondLimit { .. }) => Ok(None),
        Err(error) => Err(error),
    };
    Ok(points.into_iter().map(outcome).collect::<Result<Option<_>, _>>()?)
}

/// What `solve` answers, and its time on this thread, s.
fn timed<T>(solve: impl Fn() -> Result<T, Failure>) -> Result<(T, f64), Failure> {
    let begun = Instant::now();
    let answer = solve()?;
    let once = begun.elapsed().as_secs_f64();
    let times = (SHORT / once.max(1e-9)) as u32;
    if times == 0 {
        return Ok((answer, once));
    }
    let begun = Instant::now();
    for _ in 0..times {
        std::hint::black_box(solve()?);
    }
    Ok((answer, begun.elapsed().as_secs_f64() / f64::from(times)))
}

/// Error of `answer` over all pressures; none where either has a limit below the last one.
fn error(scene: &Scene, answer: &Answer, reference: &Answer) -> Option<f64> {
    let pairs: Vec<_> = answer.iter().flatten().copied().zip(reference.iter().flatten().copied()).collect();
    (!pairs.is_empty()).then(|| difference(&scene.tube, scene.hold.ends(), &pairs))
}

fn log(x: f64) -> f64 {
    x.max(f64::MIN_POSITIVE).log10()
}

fn named(rows: &mut Vec<BenchRow>, curves: &mut Vec<Curve>) -> Result<(), Failure> {
    let tiers = tiers();
    let mut progress = Progress::new("named cases", CASES.len() as f64, "cases");
    for (n, (degrees, hold)) in CASES.into_iter().enumerate() {
        let ends = if hold == Hold::Free { "free" } else { "blocked" };
        let case = format!("{ends}, {degrees} deg, 1 to 4 psi");
        let tube = Tube::reference(degrees.to_radians());
        let scene = Scene { tube, length: LENGTH, hold, pressures: PRESSURES.map(|p| p * PSI).to_vec() };
        let reference = on_section(&scene, &Section::new(&tube, Mesh::level(REFERENCE))?)?;
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for tier in &tiers {
            let (answer, time) = timed(|| (tier.answer)(&scene))?;
            let error = error(&scene, &answer, &reference);
            if let Some(error) = error.filter(|_| tier.name.starts_with("section, level")) {
                x.push(log(1e3 * time));
                y.push(log(error));
            }
            rows.push(row(SUITE, &tier.name, case.clone(), error, Some(time)));
        }
        curves.push((format!("section, {ends}, {degrees} deg"), x, y));
        solids(&scene, &case, &reference, rows, curves)?;
        progress.set(n as f64 + 1.0, &case);
    }
    Ok(())
}

/// The solid on two meshes: its discretisation error against the finer of them, and its difference from the section.
fn solids(
    scene: &Scene,
    case: &str,
    section: &Answer,
    rows: &mut Vec<BenchRow>,
    curves: &mut Vec<Curve>,
) -> Result<(), Failure> {
    let usual = solid::Mesh::sector(&scene.tube);
    let halved = solid::Mesh {
        wall: usual.wall.div_ceil(2),
        wall_growth: usual.wall_growth * usual.wall_growth,
        around: usual.around.div_ceil(2),
        around_growth: usual.around_growth * usual.around_growth,
        ..usual
    };
    let whole = |s: &SolidEquilibrium| Outcome {
        stretch: s.stretch,
        twist: s.rotation / scene.length,
        force: s.force,
        moment: s.moment,
    };
    let middle = |s: &SolidEquilibrium| Outcome { stretch: s.middle_stretch, twist: s.middle_twist, ..whole(s) };
    let (mut x, mut y) = (Vec::new(), Vec::new());
    let mut coarse: Answer = None;
    for (name, mesh) in [("solid, coarse", &halved), ("solid", &usual)] {
        let (states, time) = timed(|| {
            let mut solid = Solid::new(&scene.tube, scene.length, mesh, None)?;
            Ok(solid.follow(&Tip::straight(scene.hold.ends()), &scene.pressures, &mut |_| {})?.states)
        })?;
        let reached = states.len() == scene.pressures.len();
        let answer = |of: &dyn Fn(&SolidEquilibrium) -> Outcome| reached.then(|| states.iter().map(of).collect());
        let (over, at) = (answer(&whole), answer(&middle));
        let from_section = error(scene, &over, section);
        rows.push(row(SUITE, name, format!("{case}, from the section: ends included"), from_section, Some(time)));
        if scene.hold == Hold::Free {
            let from_section = error(scene, &at, section);
            rows.push(row(SUITE, name, format!("{case}, from the section: at mid-length"), from_section, Some(time)));
            if let Some(error) = from_section {
                x.push(log(1e3 * time));
                y.push(log(error));
            }
        }
        match coarse.take() {
            None => coarse = over,
            Some(coarse) => {
                let own = error(scene, &Some(coarse), &over);
                rows.push(row(SUITE, "solid, coarse", format!("{case}, from the finer solid"), own, None));
            }
        }
    }
    if !x.is_empty() {
        curves.push((format!("solid at mid-length, {case}"), x, y));
    }
    Ok(())
}

/// Median and worst of every tier over `count` geometries at two pressures each, free and blocked.
fn seeded(
    count: u64,
    rows: &mut Vec<BenchRow>,
    curves: &mut Vec<Curve>,
    facts: &mut Vec<(String, String)>,
) -> Result<(), Failure> {
    let tiers = tiers();
    for hold in [Hold::Free, Hold::Blocked] {
        let ends = if hold == Hold::Free { "free" } else { "blocked" };
        // None where the reference has a limit.
        let one = |seed| -> Result<Option<Told>, Failure> {
            let tube = Tube::seeded(seed);
            let top = tube.moderate_pressure();
            let scene = Scene { tube, length: LENGTH, hold, pressures: vec![0.5 * top, top] };
            let reference = on_section(&scene, &Section::new(&tube, Mesh::level(REFERENCE))?)?;
            if reference.is_none() {
                return Ok(None);
            }
            let of = |tier: &Tier| -> Result<_, Failure> {
                let (answer, time) = timed(|| (tier.answer)(&scene))?;
                Ok((error(&scene, &answer, &reference), time))
            };
            tiers.iter().map(of).collect::<Result<_, _>>().map(Some)
        };
        let all: Vec<_> = in_parallel(&format!("geometries, {ends}"), "tubes", count, one)
            .into_iter()
            .collect::<Result<Vec<_>, Failure>>()?;
        let known: Vec<_> = all.into_iter().flatten().collect();
        let mut refusals = vec![format!("the reference {}", count as usize - known.len())];
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for (k, tier) in tiers.iter().enumerate() {
            let errors: Vec<f64> = known.iter().filter_map(|tiers| tiers[k].0).collect();
            let times: Vec<f64> = known.iter().map(|tiers| tiers[k].1).collect();
            refusals.push(format!("{} {}", tier.name, known.len() - errors.len()));
            let time = quantile(&times, 0.5);
            for (name, share) in [("median", 0.5), ("worst", 1.0)] {
                let case = format!("{count} geometries, {ends}, {name}");
                rows.push(row(SUITE, &tier.name, case, quantile(&errors, share), time));
            }
            if let (Some(time), Some(error)) = (time, quantile(&errors, 0.5).filter(|_| tier.name.contains("level"))) {
                x.push(log(1e3 * time));
                y.push(log(error));
            }
        }
        facts.push((format!("refused of {count} geometries, {ends}"), refusals.join(", ")));
        curves.push((format!("section, median of {count} geometries, {ends}"), x, y));
    }
    Ok(())
}

/// Bending stiffness at rest and blocked force at 3 psi of the reference FREE for every width.
fn widths() -> Result<String, Failure> {
    let of = |width: &f64| -> Result<String, Failure> {
        let tube = Tube { fiber_width: width * 1e-3, ..Tube::reference(40_f64.to_radians()) };
        let section = Section::new(&tube, Mesh::level(2))?;
        let mut state = section.rest()?;
        let bending = section.bending(&state)?.pure_bending();
        let blocked = match section.advance(&mut state, 3.0 * PSI, Hold::Blocked.ends()) {
            Ok(found) => format!("blocked {:.3} N at 3 psi", found.force),
            Err(limit) => limit.to_string(),
        };
        Ok(format!("{width} mm: EI {:.1} N mm2 at rest, {blocked}", 1e6 * bending))
    };
    Ok(WIDTHS.iter().map(of).collect::<Result<Vec<_>, _>>()?.join("; "))
}

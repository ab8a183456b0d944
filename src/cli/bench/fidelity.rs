//! How honest `auto` is and what it costs, on seeded scenes whose truth is known; and the table of its certified range.
//!
//! Scenes and truth are those of [`crate::fem::fidelity::suite`]. The table is made of other scenes than those on which
//! the choice is judged. `certified.csv` in the runs' folder is the one to be stored as src/fem/fidelity/certified.csv;
//! `fidelity-scenes.csv` has every scene that judges.

use std::fmt::Write as _;
use std::time::Instant;

use super::{Size, in_parallel, quantile, row};
use crate::cli::Failure;
use crate::fem::fidelity::certified::{BUCKETS, ESTIMATES, Factor, Row, table};
use crate::fem::fidelity::{Fidelity, FidelityError, Scene, ask, choose, difference, suite};
use crate::record::{BenchRow, BenchSuite, Curve};

const SUITE: &str = "fidelity";
/// Tiers, from cheap to dear.
const TIERS: [Fidelity; 4] = [Fidelity::Linear, Fidelity::Nonlinear, Fidelity::Section, Fidelity::Solid];
/// First seed of the scenes that judge; those of the table begin at 0.
const JUDGES: u64 = 1_000_000;
/// Scenes of the table for each one that judges: of 300 they are thirty in a bucket, and the next one of it has a
/// larger error than all of them with a probability of 3 %.
const PER_JUDGE: u64 = 3;
/// Share of the scenes whose error may be above the estimate.
const MISSES: f64 = 0.05;
/// Half the length of a point's dash in the drawing, decades.
const DASH: f64 = 0.012;

/// What one scene says.
struct Told {
    seed: u64,
    tolerance: f64,
    /// True error and time, s, of every tier.
    tiers: Vec<(f64, f64)>,
    /// Tier, estimated and true error of the choice; none where not even the solid's estimate is within the tolerance.
    choice: Option<(Fidelity, f64, f64)>,
    /// Time of the choice, s.
    time: f64,
}

/// Judges the choice on `size.count` scenes, and makes the table of three times as many others.
pub(super) fn run(size: &Size) -> Result<BenchSuite, Failure> {
    let start = Instant::now();
    let count = size.count;
    let all = in_parallel("scenes", "scenes", count, |k| told(JUDGES + k));
    let told: Vec<Told> = all.into_iter().collect::<Result<Vec<_>, Failure>>()?.into_iter().flatten().collect();
    let mut facts = vec![("scenes".into(), format!("{} of {count}; the others end below their pressure", told.len()))];
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    judge(&told, &mut rows, &mut facts);
    draw(&told, &mut curves);
    let folder = &size.rig.record.directory;
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("fidelity-scenes.csv"), list(&told))?;
    let made = certify(count)?;
    let path = folder.join("certified.csv");
    std::fs::write(&path, made)?;
    facts.push(("table of the certified range".into(), path.display().to_string()));
    facts.push(("wall time".into(), format!("{:.1} s", start.elapsed().as_secs_f64())));
    Ok(BenchSuite {
        name: SUITE,
        title: "Choice of the model: estimated against true error, and cost",
        facts,
        rows,
        caption: "Estimated over true error of what `auto` chose; below the line the estimate is too small",
        x_label: "log10 of the true relative error",
        y_label: "log10 of the estimated one",
        curves,
        ..BenchSuite::default()
    })
}

/// None where the scene has no truth.
fn told(seed: u64) -> Result<Option<Told>, Failure> {
    let (scene, tolerance) = Scene::seeded(seed);
    let Some(truth) = suite::truth(&scene)? else { return Ok(None) };
    let timed = |tier: Fidelity| -> Result<(f64, f64), Failure> {
        let begun = Instant::now();
        let answer = ask(&scene, tier, &mut |_| {})?;
        let time = begun.elapsed().as_secs_f64();
        Ok((difference(&answer.points, &truth, &scene), time))
    };
    let tiers = TIERS.into_iter().map(timed).collect::<Result<_, _>>()?;
    let begun = Instant::now();
    let chosen = choose(&scene, tolerance, &mut |_| {});
    let time = begun.elapsed().as_secs_f64();
    let choice = match chosen {
        Ok(choice) => {
            let estimate = choice.considered.last().map_or(f64::INFINITY, |last| last.estimate);
            Some((choice.answer.fidelity, estimate, difference(&choice.answer.points, &truth, &scene)))
        }
        Err(FidelityError::NotReached { .. }) => None,
        Err(error) => return Err(error.into()),
    };
    Ok(Some(Told { seed, tolerance, tiers, choice, time }))
}

/// A line for every scene: error and time of every tier, the choice with its estimate, true error and time.
fn list(told: &[Told]) -> String {
    let tiers = TIERS.map(|tier| format!("{0}_error,{0}_time_s", tier.name())).join(",");
    let mut text = format!("seed,tolerance,{tiers},chosen,estimate,error,time_s\n");
    for Told { seed, tolerance, tiers, choice, time } in told {
        let _ = write!(text, "{seed},{tolerance:.4e}");
        for (error, time) in tiers {
            let _ = write!(text, ",{error:.4e},{time:.4e}");
        }
        let _ = match choice {
            Some((tier, estimate, error)) => writeln!(text, ",{},{estimate:.4e},{error:.4e},{time:.4e}", tier.name()),
            None => writeln!(text, ",,,,{time:.4e}"),
        };
    }
    text
}

fn judge(told: &[Told], rows: &mut Vec<BenchRow>, facts: &mut Vec<(String, String)>) {
    let count = told.len();
    let chosen: Vec<_> = told.iter().filter_map(|t| t.choice.map(|choice| (t, choice))).collect();
    let above = chosen.iter().filter(|(_, (_, estimate, error))| error > estimate).count();
    let outside = chosen.iter().filter(|(t, (_, _, error))| *error > t.tolerance).count();
    // Of a few scenes one may miss: there are no parts of a scene.
    let allowed = (MISSES * chosen.len() as f64).ceil() as usize;
    for (what, misses) in [("the estimate", above), ("the tolerance", outside)] {
        let case = format!("{} choices, share of true errors above {what}", chosen.len());
        let share = misses as f64 / chosen.len().max(1) as f64;
        rows.push(BenchRow { failed: misses > allowed, ..row(SUITE, "auto", case, Some(share), None) });
    }
    let mut quantiles = |method: &str, errors: &[f64], times: &[f64]| {
        for (name, part) in [("median", 0.5), ("worst", 1.0)] {
            let case = format!("{count} scenes, true error, {name}");
            rows.push(row(
                SUITE,
                method,
                case,
                quantile(errors, part).filter(|e| e.is_finite()),
                quantile(times, part),
            ));
        }
    };
    let errors: Vec<f64> = chosen.iter().map(|(_, (_, _, error))| *error).collect();
    quantiles("auto", &errors, &told.iter().map(|t| t.time).collect::<Vec<_>>());
    for (k, tier) in TIERS.into_iter().enumerate() {
        let of = |part: fn((f64, f64)) -> f64| told.iter().map(|t| part(t.tiers[k])).collect::<Vec<_>>();
        quantiles(tier.name(), &of(|t| t.0), &of(|t| t.1));
    }
    let picked = TIERS
        .map(|tier| format!("{} {}", tier.name(), chosen.iter().filter(|(_, (chosen, ..))| *chosen == tier).count()));
    facts.push(("chosen".into(), format!("{}, none {}", picked.join(", "), count - chosen.len())));
    let of = |values: &[f64]| {
        let at = |part| quantile(values, part).map_or("-".into(), |x| format!("{x:.2}"));
        format!("5 % {}, median {}, 95 % {}", at(0.05), at(0.5), at(0.95))
    };
    let effectivities: Vec<f64> = chosen.iter().map(|(_, (_, estimate, error))| estimate / error).collect();
    facts.push(("estimated over true error".into(), of(&effectivities)));
    let needed = |t: &Told| t.tiers.iter().find(|(error, _)| *error <= t.tolerance).map(|(_, time)| *time);
    let over: Vec<f64> = told.iter().filter_map(|t| Some(t.time / needed(t)?)).collect();
    facts.push(("time over that of the cheapest tier that meets the tolerance".into(), of(&over)));
    let under: Vec<f64> = told.iter().map(|t| t.tiers[TIERS.len() - 1].1 / t.time).collect();
    facts.push(("time of always taking the solid over it".into(), of(&under)));
}

/// A dash for every choice, by its tier, and the line on which estimate and truth agree.
fn draw(told: &[Told], curves: &mut Vec<Curve>) {
    let (low, high) = (-4.0, 0.0);
    curves.push(("estimated = true".into(), vec![low, high], vec![low, high]));
    for tier in TIERS {
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for (_, estimate, error) in told.iter().filter_map(|t| t.choice).filter(|choice| choice.0 == tier) {
            let (error, estimate) = (error.log10().clamp(low, high), estimate.log10().clamp(low, high));
            x.extend([error - DASH, error + DASH, error + DASH]);
            y.extend([estimate, estimate, f64::NAN]);
        }
        if !x.is_empty() {
            curves.push((tier.name().into(), x, y));
        }
    }
}

/// The table: factors of `judges` scenes, errors of [`PER_JUDGE`] times as many. The largest errors are found on a
/// cheap mesh, and computed again on the truth's.
fn certify(judges: u64) -> Result<String, Failure> {
    let ratios = in_parallel("its estimates", "scenes", judges, |seed| suite::ratios(&Scene::seeded(seed).0));
    let ratios: Vec<Option<[f64; 2]>> = ratios.into_iter().collect::<Result<_, _>>()?;
    let of = |index: usize| (0..).zip(&ratios).filter_map(move |(seed, known)| Some(((*known)?[index], seed)));
    let factors: Vec<_> = (0..ESTIMATES.len()).map(|index| Factor::of(&of(index).collect::<Vec<_>>())).collect();
    let count = PER_JUDGE * judges;
    let cheap = |seed| suite::errors(&Scene::seeded(seed).0, false);
    let found = in_parallel("certified range", "scenes", count, cheap).into_iter().collect::<Result<Vec<_>, _>>()?;
    let row = |bucket: usize| {
        let seeds = (0..count).skip(bucket).step_by(BUCKETS);
        Row::of(&seeds.map(|seed| (found[seed as usize], seed)).collect::<Vec<_>>())
    };
    let again = |bucket: u64| {
        let Some(mut row) = row(bucket as usize) else { return Ok(None) };
        row.refine(|seed| suite::errors(&Scene::seeded(seed).0, true))?;
        Ok::<_, FidelityError>(Some(row))
    };
    let rows = in_parallel("its largest errors", "buckets", BUCKETS as u64, again);
    let rows: Vec<Option<Row>> = rows.into_iter().collect::<Result<_, _>>()?;
    let now = jiff::Zoned::now().date();
    let version = env!("CARGO_PKG_VERSION");
    Ok(table(
        &format!("`freerig bench --fidelity`, version {version}, {now}: seeds 0 to {}", count - 1),
        &factors,
        &rows,
    ))
}

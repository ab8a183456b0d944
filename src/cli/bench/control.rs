//! The controllers on plants that are not the model: how closely the paper's trajectory is followed.

use std::time::Instant;

use super::{Size, in_parallel, locus, quantile, row};
use crate::cli::Failure;
use crate::config::gains::preset;
use crate::control::tune::Target;
use crate::control::{ControlConfig, Gains};
use crate::model::Free;
use crate::record::{BenchRow, BenchSuite, Curve};
use crate::sim::BenchConfig;
use crate::sim::controlled::{
    ControlledError, Followed, calibrated, follow, led_by_model, off_by_a_fifth, pid, plant, tuned,
};
use crate::trajectory::paper_trajectory;

const SUITE: &str = "control";
/// Range of the paper's trajectory, rad: what an error is related to.
const RANGE: f64 = 70.0 * std::f64::consts::PI / 180.0;
/// Scatter of a calibrated FREE's parameters about the nominal ones.
const SCATTER: f64 = 0.03;
/// Of so many plants of the study the comparison takes one.
const SHARE: u64 = 20;
/// The published gains by their name.
const PUBLISHED: &str = "published-trajectory";

/// Runs the study of plants that are off by up to a fifth, then the comparison on calibrated FREEs.
pub(super) fn run(size: &Size<'_>) -> Result<BenchSuite, Failure> {
    let start = Instant::now();
    let (mut rows, mut facts, mut curves) = (Vec::new(), Vec::new(), Vec::new());
    let (free, hysteresis) = calibrated(&plant(Free::paper(), 0.0, 1), 1)?;
    let controllers = [
        ("model", led_by_model(free, hysteresis)?),
        ("published PI", pid(free, published())),
        ("tuned PID", pid(free, tuned(&free, &Target::PID)?)),
    ];
    for (method, control) in &controllers {
        let label = format!("{method}, up to 20 % off");
        let all = study(&label, size.count, |seed| Ok((control.clone(), off_by_a_fifth(seed))))?;
        let unstable = all.iter().filter(|f| !f.0.stable).count();
        facts.push((label.clone(), format!("{unstable} of {} plants unstable", size.count)));
        let cases = format!("{} plants, every parameter up to 20 % off", size.count);
        summarise(method, &cases, &all, &mut rows);
        curves.push(distribution(&label, &all));
    }
    let some = (size.count / SHARE).max(1);
    let led = |seed| -> Result<_, ControlledError> {
        let bench = plant(Free::paper(), SCATTER, seed + 1);
        let (free, hysteresis) = calibrated(&bench, seed + 1)?;
        Ok((led_by_model(free, hysteresis)?, bench))
    };
    let plain = |seed, gains: fn(&Free) -> Result<Gains, ControlledError>| -> Result<_, ControlledError> {
        let bench = plant(Free::paper(), SCATTER, seed + 1);
        let (free, _) = calibrated(&bench, seed + 1)?;
        Ok((pid(free, gains(&free)?), bench))
    };
    let comparison = [
        ("model", study("model, calibrated", some, led)?),
        ("published PI", study("published PI, calibrated", some, |seed| plain(seed, |_| Ok(published())))?),
        ("tuned PID", study("tuned PID, calibrated", some, |seed| plain(seed, |free| tuned(free, &Target::PID)))?),
    ];
    for (method, all) in &comparison {
        summarise(method, &format!("{some} calibrated FREEs"), all, &mut rows);
    }
    let degrees = |all: &[(Followed, f64)]| quantile(&rms(all), 0.5).map_or(f64::NAN, f64::to_degrees);
    let beside = comparison.iter().map(|(method, all)| format!("{method} {:.3} deg", degrees(all)));
    facts.push(("calibrated FREEs, median RMS error".into(), beside.collect::<Vec<_>>().join(", ")));
    facts.push(("wall time".into(), format!("{:.1} s", start.elapsed().as_secs_f64())));
    let claims = locus::beside(&mut rows)?.into_iter().collect();
    Ok(BenchSuite {
        name: SUITE,
        title: "Control of plants that are not the model",
        facts,
        rows,
        claims,
        caption: "RMS error of the paper's trajectory over plants of which every parameter is off by up to 20 %",
        x_label: "share of the plants (%)",
        y_label: "RMS error (deg)",
        curves,
        ..BenchSuite::default()
    })
}

fn published() -> Gains {
    preset(PUBLISHED).unwrap_or_default()
}

/// `count` plants followed, each with the time that it took, s.
fn study(
    label: &str,
    count: u64,
    setting: impl Fn(u64) -> Result<(ControlConfig, BenchConfig), ControlledError> + Sync,
) -> Result<Vec<(Followed, f64)>, Failure> {
    let course = paper_trajectory()?;
    let one = |seed| -> Result<_, ControlledError> {
        let (control, bench) = setting(seed)?;
        let begun = Instant::now();
        let followed = follow(&control, &bench, &course)?;
        Ok((followed, begun.elapsed().as_secs_f64()))
    };
    Ok(in_parallel(label, "plants", count, one).into_iter().collect::<Result<_, _>>()?)
}

fn rms(all: &[(Followed, f64)]) -> Vec<f64> {
    all.iter().map(|f| f.0.rms).collect()
}

/// Median, 95 % and worst, and whether all were stable.
fn summarise(method: &str, cases: &str, all: &[(Followed, f64)], rows: &mut Vec<BenchRow>) {
    let time = all.iter().map(|f| f.1).sum::<f64>() / all.len() as f64;
    let unstable = all.iter().any(|f| !f.0.stable);
    for (name, share) in [("median RMS", 0.5), ("95 % RMS", 0.95), ("worst RMS", 1.0)] {
        let error = quantile(&rms(all), share).map(|e| e / RANGE);
        let found = row(SUITE, method, format!("{cases}, {name}"), error, Some(time));
        rows.push(BenchRow { failed: found.failed || unstable, ..found });
    }
}

/// RMS error (deg) over the share of plants (%) that have none greater.
fn distribution(label: &str, all: &[(Followed, f64)]) -> Curve {
    let mut sorted = rms(all);
    sorted.sort_by(f64::total_cmp);
    let share = (1..=sorted.len()).map(|i| 100.0 * i as f64 / sorted.len() as f64).collect();
    (label.to_owned(), share, sorted.into_iter().map(f64::to_degrees).collect())
}

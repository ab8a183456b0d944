//! The fault drill: how soon every fault is seen and the pressure gone, the worst of all repetitions against the
//! matrix's limits.

use std::time::Instant;

use anyhow::anyhow;

use super::{Size, in_parallel};
use crate::cli::Failure;
use crate::cli::table::Table;
use crate::daemon::drill::{Case, Outcome, cases, trial};
use crate::record::{BenchRow, BenchSuite};

const SUITE: &str = "faults";

/// Drills every case, one after the other.
pub(super) fn run(size: &Size<'_>) -> Result<BenchSuite, Failure> {
    let start = Instant::now();
    let cases = cases(size.rig);
    if cases.is_empty() {
        let error = anyhow!("the fault drill needs a first FREE with an IMU and an Alicat unit");
        return Err(Failure::usage(error).remedy("name such a rig: `--rig FILE`"));
    }
    let mut outcomes = Vec::new();
    for case in &cases {
        let trials = in_parallel(case.code.name(), "repetitions", size.count, |seed| trial(size.rig, case, seed));
        let trials = trials.into_iter().collect::<Result<Vec<_>, _>>().map_err(Failure::rig)?;
        outcomes.push(Outcome::of(size.rig, case, &trials));
    }
    let all: Vec<_> = cases.iter().zip(&outcomes).collect();
    let failed = outcomes.iter().filter(|outcome| outcome.failed).count();
    let share = |limit: f64, worst: f64| 100.0 * worst / limit;
    let detection: Vec<_> = outcomes.iter().map(|o| share(o.detection_limit, o.detection)).collect();
    let fall: Vec<_> = outcomes.iter().map(|o| o.fall.map_or(0.0, |(worst, limit)| share(limit, worst))).collect();
    let x: Vec<_> = cases.iter().map(|case| f64::from(case.code as u8)).collect();
    Ok(BenchSuite {
        name: SUITE,
        title: "Faults: detection and fall of the pressure",
        facts: vec![
            ("repetitions of each".into(), format!("{}, at random phases, noise and plants", size.count)),
            ("outside their limits".into(), format!("{failed} of {} rows", outcomes.len())),
            ("wall time".into(), format!("{:.1} s", start.elapsed().as_secs_f64())),
        ],
        rows: all.iter().flat_map(|(case, outcome)| rows(case, outcome)).collect(),
        table: Some(table(&all, size.count)),
        caption: "Worst case as a share of its limit, by the fault's number",
        x_label: "code",
        y_label: "share of the limit (%)",
        curves: vec![("detection".into(), x.clone(), detection), ("vent or ramp".into(), x, fall)],
        ..BenchSuite::default()
    })
}

/// The worst times, and how much they use of their limits (beyond one it is too late).
fn rows(case: &Case, outcome: &Outcome) -> Vec<BenchRow> {
    let row = |what: &str, worst: f64, limit: f64| BenchRow {
        suite: SUITE,
        method: case.code.name().into(),
        case: format!("{}, {what}", case.how),
        relative_error: Some(worst / limit).filter(|share| share.is_finite()),
        time_s: Some(worst).filter(|worst| worst.is_finite()),
        failed: outcome.failed,
    };
    let detection = row("detection", outcome.detection, outcome.detection_limit);
    let fall = outcome.fall.map(|(worst, limit)| row(case.reaction.name(), worst, limit));
    std::iter::once(detection).chain(fall).collect()
}

fn table(all: &[(&Case, &Outcome)], count: u64) -> String {
    let fell = format!(">worst fall of {count} (limit), s");
    let seen = format!(">worst detection of {count} (limit), ms");
    let columns = ["|", "fault", "|", "provoked", "|", "reaction", "|", &seen, "|", &fell, "|", "", "|"];
    let mut table = Table::new(&columns);
    table.row(["|", "---", "|", "---", "|", "---", "|", "--:", "|", "--:", "|", "---", "|"]);
    for (case, outcome) in all {
        let seen = format!("{:.1} ({:.1})", 1e3 * outcome.detection, 1e3 * outcome.detection_limit);
        let fell = outcome.fall.map_or("-".into(), |(worst, limit)| format!("{worst:.2} ({limit:.1})"));
        let failed = if outcome.failed { "FAILED" } else { "" };
        let name = format!("`{}`", case.code.name());
        table.row(["|", &name, "|", case.how, "|", case.reaction.name(), "|", &seen, "|", &fell, "|", failed, "|"]);
    }
    table.to_string()
}

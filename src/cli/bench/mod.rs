//! `freerig bench`: speed against error of what freerig computes.
//!
//! A suite is one file with a function from [`Size`] to a [`BenchSuite`], and a line in [`SUITES`] and in [`Args`].

mod calculix;
mod claim;
mod control;
mod deck;
mod faults;
mod fem;
mod fidelity;
mod identification;
mod locus;
mod lumped;
mod machine;
mod module;
mod pace;
mod patience;
mod peer;
mod rods;
mod stopwatch;

use std::time::Instant;

use rayon::prelude::*;

use super::table::Table;
use super::{Context, Failure, Progress};
use crate::config::Rig;
use crate::record::{BenchReport, BenchRow, BenchSuite};

const EXAMPLES: &str = "\
Without a suite all of them run, and bench.html and bench.md put them together. The random numbers are always the same: but \
for the times, so are the answers. Table on stdout, bench-SUITE.csv, .svg and .html in the runs' folder. Peers \
(CalculiX, Exudyn, scipy, python-control, cyclictest) run beside freerig where they are installed.

Examples:
  freerig bench
  freerig bench --identification
  freerig bench --control --count 20 --json
  freerig bench --faults";

/// Records or plants that are computed between two looks at the progress.
const CHUNK: u64 = 8;

/// What `freerig bench` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Integrators of the lumped model against reference solutions
    #[arg(long)]
    lumped: bool,
    /// Every tier of the finite elements against the finest section
    #[arg(long)]
    fem: bool,
    /// What the automatic choice of the model says its error is, and what it really is; makes the certified range's
    /// table
    #[arg(long)]
    fidelity: bool,
    /// Rods with known answers, over the resolution
    #[arg(long)]
    rods: bool,
    /// Equilibria, Jacobians, inverses and plans of the module, over the rods' resolution
    #[arg(long)]
    module: bool,
    /// Ring-down fits of FREEs that are not known, against log decrement and curve fit
    #[arg(long)]
    identification: bool,
    /// The controllers on plants that are not the model, the loop's rate and wake-ups
    #[arg(long)]
    control: bool,
    /// Every fault of the matrix on the simulated rig of rig.toml: how soon it is seen, how soon the pressure is gone
    #[arg(long)]
    faults: bool,
    /// FREEs, plants, geometries and scenes of the studies (200 by default, of the finite elements 40, of the choice of
    /// the model 20; 300 for its table), repetitions of each fault (50 by default)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    count: Option<u64>,
}

/// How much a suite computes.
struct Size<'a> {
    count: u64,
    rig: &'a Rig,
}

type Suite = fn(&Size<'_>) -> Result<BenchSuite, Failure>;
/// Whether it is asked for.
type Asked = fn(&Args) -> bool;

/// Every suite and its count where none is given, in the order of a run without any flag.
const SUITES: [(Asked, Suite, u64); 9] = [
    (|args| args.lumped, lumped::run, 1),
    (|args| args.fem, fem::run, 40),
    (|args| args.fidelity, fidelity::run, 20),
    (|args| args.rods, rods::run, 1),
    (|args| args.module, module::run, 1),
    (|args| args.identification, identification::run, 200),
    (|args| args.control, control::run, 200),
    (|args| args.control, pace::run, 200),
    (|args| args.faults, faults::run, 50),
];

/// Runs what is asked for.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let (rig, begun, load) = (Rig::load(&context.rig)?, Instant::now(), machine::load());
    let every = !SUITES.iter().any(|(asked, ..)| asked(&args));
    let mut suites = Vec::new();
    for (_, suite, count) in SUITES.iter().filter(|(asked, ..)| every || asked(&args)) {
        let suite = suite(&Size { count: args.count.unwrap_or(*count), rig: &rig })?;
        let page = suite.write(&rig.record.directory)?;
        if !context.json {
            context.print(text(&suite, &page.display().to_string()))?;
        }
        suites.push(suite);
    }
    if every {
        let facts = machine::facts(&load, begun.elapsed().as_secs_f64());
        let page = BenchReport { facts: &facts, suites: &suites }.write(&rig.record.directory)?;
        if !context.json {
            context.print(format!("all of it: {}, and bench.md beside it", page.display()))?;
        }
    }
    let rows: Vec<_> = suites.into_iter().flat_map(|suite| suite.rows).collect();
    if context.json { context.print_json(&serde_json::json!({ "rows": rows })) } else { Ok(()) }
}

fn text(suite: &BenchSuite, page: &str) -> String {
    let table = suite.table.clone().unwrap_or_else(|| rows(suite));
    let facts: String = suite.said().iter().map(|(name, value)| format!("- {name}: {value}\n")).collect();
    format!("## {} (SIMULATED)\n\n{table}\n\n{facts}- page: {page}\n", suite.title)
}

fn rows(suite: &BenchSuite) -> String {
    let mut table = Table::new(&["|", "method", "|", "case", "|", ">relative error", "|", ">time, ms", "|", "", "|"]);
    table.row(["|", "---", "|", "---", "|", "--:", "|", "--:", "|", "---", "|"]);
    for row in &suite.rows {
        let error = row.relative_error.map_or("-".into(), |e| format!("{e:.2e}"));
        let time = row.time_s.map_or("-".into(), |t| format!("{:.3}", 1e3 * t));
        let failed = if row.failed { "FAILED" } else { "" };
        table.row(["|", &row.method, "|", &row.case, "|", &error, "|", &time, "|", failed, "|"]);
    }
    table.to_string()
}

/// `one` of every number below `count`, in their order, on all cores, with a bar.
fn in_parallel<T: Send>(label: &str, unit: &'static str, count: u64, one: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let mut progress = Progress::new(label, count as f64, unit);
    let mut all = Vec::with_capacity(count as usize);
    let mut from = 0;
    while from < count {
        let until = (from + CHUNK).min(count);
        all.par_extend((from..until).into_par_iter().map(&one));
        progress.set(until as f64, "");
        from = until;
    }
    all
}

/// The value below which `share` (0 to 1) of `values` lie; `None` of nothing.
fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(((sorted.len().max(1) - 1) as f64 * share).round() as usize).copied()
}

fn row(suite: &'static str, method: &str, case: String, relative_error: Option<f64>, time_s: Option<f64>) -> BenchRow {
    BenchRow { suite, method: method.into(), case, relative_error, time_s, failed: relative_error.is_none() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_in_parallel_keeps_its_order_and_quantiles_are_of_the_sorted() {
        assert_eq!(in_parallel("x", "", 20, |i| i * i), (0..20).map(|i| i * i).collect::<Vec<_>>());
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 1.0), Some(3.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}

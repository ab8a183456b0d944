//! `freerig compare`: two runs beside each other.

use std::fmt::Write as _;

use serde_json::json;

use super::table::Table;
use super::{Context, Failure, runs};
use crate::record::{Comparison, RecordError};

const EXAMPLES: &str = "\
Examples:
  freerig compare 20260314-151500 latest
  freerig compare runs/20260314-151500.123-step-paper /elsewhere/20260201-093000.456-step-paper --json";

/// What `freerig compare` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Id of a run, the beginning of one, its folder, or `latest`; the comparison is written into its folder
    run_a: String,
    /// Another run, of the same experiment or of another
    run_b: String,
}

/// Compares two runs: deviation of their angles, ratio of their tracking errors, and an overlay of their plots.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let (a, b) = (runs::find(context, &args.run_a)?, runs::find(context, &args.run_b)?);
    let comparison = Comparison::pair(&a, &b).map_err(|error| match error {
        RecordError::Incomparable(_) => Failure::from(error).remedy("compare runs that moved a FREE at the same times"),
        other => other.into(),
    })?;
    let page = comparison.write(&a.folder.join(format!("compare-{}.html", b.id())))?;
    if context.json {
        return context.print_json(&json!({
            "page": page,
            "simulated": comparison.rows.iter().any(|r| r.simulated),
            "runs": comparison.rows,
            "deviations": comparison.deviations().collect::<Vec<_>>(),
        }));
    }
    context.print(describe(&comparison))?;
    context.print(format_args!("overlay: {}", page.display()))
}

/// The figures of a comparison as text.
pub(super) fn describe(comparison: &Comparison) -> String {
    let mut text = table(comparison).to_string();
    for d in comparison.deviations() {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\nRMS deviation {:.3} deg ({:.2} % of the range), peak {:.3} deg, over {:.2} s: {} of {} against {} of {}",
            d.rms_rad.to_degrees(),
            d.percent_of_range,
            d.peak_rad.to_degrees(),
            d.overlap_s,
            d.free_b,
            d.run_b,
            d.free_a,
            d.run_a,
        );
    }
    for remark in &comparison.remarks {
        let _ = write!(text, "\nnote: {remark}");
    }
    text
}

/// Runs, their errors, and the ratio of these to the first of the same program.
pub(super) fn table(comparison: &Comparison) -> Table {
    let mut table = Table::new(&["run", "title", "FREE", "gains", "rig", "result", ">RMS error", ">peak", ">ratio"]);
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".into());
    let degrees = |rad: f64| format!("{:.3} deg", rad.to_degrees());
    for row in &comparison.rows {
        table.row([
            row.id.clone(),
            row.title.clone(),
            row.free.clone(),
            row.gains.clone(),
            if row.simulated { "SIMULATED" } else { "hardware" }.into(),
            row.result.into(),
            or_dash(row.error.map(|e| degrees(e.rms_rad))),
            or_dash(row.error.map(|e| degrees(e.peak_rad))),
            or_dash(row.rms_ratio.map(|r| format!("{r:.3}"))),
        ]);
    }
    table
}

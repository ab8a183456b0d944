//! `freerig report`: a run's report, made again, and its figures as text.

use std::fmt::Write as _;

use serde_json::json;

use super::table::Table;
use super::{Context, Failure, Progress, runs};
use crate::record::{FreeMetrics, Metrics, ON_THE_WAY, Run, write_report};
use crate::units::PASCAL_PER_PSI;

const EXAMPLES: &str = "\
Examples:
  freerig report latest
  freerig report 20260314-1515            the beginning of an id will do
  freerig report runs/20260314-151500.123-step-paper --json";

/// What `freerig report` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Id of a run, the beginning of one, its folder, or `latest`
    run: String,
}

/// Makes the report and prints its figures.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let run = runs::find(context, &args.run)?;
    let mut progress = Progress::new("report", 100.0, "%");
    let (report, metrics) = write_report(&run, &mut |share| progress.set(100.0 * share, ""))?;
    drop(progress);
    if context.json {
        return context.print_json(&json!({
            "report": report,
            "folder": run.folder,
            "title": run.start().title,
            "kind": run.start().kind,
            "result": run.result_name(),
            "message": run.stop().map(|s| s.message.as_str()).filter(|m| !m.is_empty()),
            "faults": run.stop().map(|s| s.faults.as_slice()).unwrap_or_default(),
            "figures": metrics,
        }));
    }
    context.print(describe(&run, &metrics))?;
    context.print(format_args!("report: {}", report.display()))
}

/// A run and its figures as text, as an experiment prints them when it has ended.
pub(super) fn describe(run: &Run, metrics: &Metrics) -> String {
    let start = run.start();
    let simulated = if metrics.simulated { ", SIMULATED" } else { "" };
    let clock = if start.stepped { ", stepped clock" } else { "" };
    // Writing to a String cannot fail.
    let mut text = format!("{}: {}, {}{simulated}{clock}", run.id(), start.name(), run.result_name());
    if let Some(stop) = run.stop() {
        if !stop.message.is_empty() {
            let _ = write!(text, "\n{}", stop.message);
        }
        for fault in &stop.faults {
            let free = fault.free.as_deref().unwrap_or("rig");
            let latched = if fault.latched { ", latched" } else { "" };
            let _ = write!(
                text,
                "\nfault {} ({free}) {:.3} s after the start{latched}: {}",
                fault.name, fault.t_s, fault.message
            );
        }
    } else {
        text.push_str("\nno stop document: the run is under way or was cut off; figures of what was recorded");
    }
    for free in &metrics.frees {
        let gains = start.gains_name(&free.free);
        let _ = write!(text, "\n\nFREE {}, gains: {gains}\n{}", free.free, figures(free));
        if !free.moves.is_empty() {
            let _ = write!(text, "\n\n{}", moves(free));
        }
    }
    let _ = write!(text, "\n\n{} records, {} deadline misses", metrics.records, metrics.deadline_misses);
    text
}

/// What rounds to zero has no sign.
fn degrees(rad: f64) -> String {
    format!("{:.3} deg", (rad.to_degrees() * 1e3).round() / 1e3 + 0.0)
}

fn figures(free: &FreeMetrics) -> Table {
    let mut table = Table::new(&["figure", ">value"]);
    if let Some(e) = free.error {
        table.row(["RMS error".into(), degrees(e.rms_rad)]);
        table.row(["peak error".into(), degrees(e.peak_rad)]);
        table.row(["final error".into(), degrees(e.final_rad)]);
    }
    if let Some(e) = free.true_error {
        table.row(["RMS error of the true angle (SIMULATED)".into(), degrees(e.rms_rad)]);
    }
    let share = |rad: f64, percent: Option<f64>| match percent {
        Some(percent) => format!("{} ({percent:.2} %)", degrees(rad)),
        None => degrees(rad),
    };
    if let Some(rad) = free.model_rmsd_rad {
        table.row(["RMSD to the model".into(), share(rad, free.model_rmsd_percent)]);
    }
    let moving = if free.on_the_way { format!(", {ON_THE_WAY}") } else { String::new() };
    if let Some(rad) = free.rest_rmsd_rad {
        table.row(["RMSD to the model at rest".into(), share(rad, free.rest_rmsd_percent) + &moving]);
    }
    if let Some(rad) = free.hysteresis_rad {
        table.row(["hysteresis".into(), share(rad, free.hysteresis_percent) + &moving]);
    }
    if let Some(pressure) = free.highest_pressure_pa {
        table.row(["highest pressure".into(), format!("{:.3} psi", pressure / PASCAL_PER_PSI)]);
    }
    table
}

fn moves(free: &FreeMetrics) -> Table {
    let mut table = Table::new(&[">at", ">from", ">to", ">overshoot", ">settling", ">steady error"]);
    for m in &free.moves {
        table.row([
            format!("{:.2} s", m.start_s),
            degrees(m.from_rad),
            degrees(m.to_rad),
            format!("{:.2} %", m.overshoot_percent),
            m.settling_s.map_or_else(|| "does not".into(), |s| format!("{s:.3} s")),
            degrees(m.steady_error_rad),
        ]);
    }
    table
}

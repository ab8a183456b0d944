//! `freerig export`: a run as CSV or Parquet.

use std::path::PathBuf;

use serde_json::json;

use super::{Context, Failure, runs};
use crate::record::{Format, TIME_BASE, export};

const EXAMPLES: &str = "\
Every record of the loop is a row. Units are in the columns' names; `t_s` counts from the run's first record, \
`program_time_s` from the start of the program (NaN while none runs), `time_ns` is the machine's monotonic clock. \
States, faults and limits are written in words.

Examples:
  freerig export latest --csv
  freerig export 20260314-1515 --parquet --output /tmp/step.parquet";

/// What `freerig export` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = clap::ArgGroup::new("format").required(true).args(["csv", "parquet"]))]
pub struct Args {
    /// Id of a run, the beginning of one, its folder, or `latest`
    run: String,
    /// Comma-separated values, for anything
    #[arg(long)]
    csv: bool,
    /// Apache Parquet, for pandas, polars, MATLAB, DuckDB ...
    #[arg(long)]
    parquet: bool,
    /// Where to [default: samples.csv or samples.parquet in the run's folder]
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Exports a run.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let run = runs::find(context, &args.run)?;
    let format = if args.parquet { Format::Parquet } else { Format::Csv };
    let path = args.output.unwrap_or_else(|| run.folder.join(format.file_name()));
    let exported = export(&run, format, &path)?;
    if context.json {
        return context.print_json(&json!({
            "file": path,
            "run": run.id(),
            "simulated": run.start().simulated(),
            "complete": run.is_complete(),
            "rows": exported.rows,
            "columns": exported.columns,
            "time_base": TIME_BASE,
        }));
    }
    let simulated = if run.start().simulated() { ", SIMULATED" } else { "" };
    let complete = if run.is_complete() { "" } else { ", incomplete: to the last whole batch" };
    context.note(format_args!("{TIME_BASE}"));
    context.print(format_args!(
        "{}: {} rows, {} columns{simulated}{complete}",
        path.display(),
        exported.rows,
        exported.columns.len()
    ))
}

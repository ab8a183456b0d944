//! `freerig runs`: what has been run.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde_json::{Value, json};

use super::table::Table;
use super::{Context, Failure};
use crate::config::Rig;
use crate::daemon::cycles::Counts;
use crate::record::{DOCUMENT_NAME, ErrorDocument, RecordError, Run};

const EXAMPLES: &str = "\
Examples:
  freerig runs                  every run, the latest last
  freerig runs --latest 5
  freerig runs --json | jq '.runs[-1].id'";

/// What `freerig runs` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Only the latest N
    #[arg(long, value_name = "N")]
    latest: Option<usize>,
}

/// Lists the runs of the rig.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let directory = directory(context)?;
    let mut all = Run::list(&directory)?;
    let skipped = args.latest.map_or(0, |latest| all.len().saturating_sub(latest));
    all.drain(..skipped);
    let (mut runs, mut unreadable) = (Vec::new(), Vec::new());
    for run in all {
        match run {
            Ok(run) => runs.push(run),
            Err(error) => unreadable.push(error.to_string()),
        }
    }
    if context.json {
        let runs: Vec<Value> = runs.iter().map(as_json).collect();
        let cycles = Counts::read(&directory).ok();
        return context.print_json(
            &json!({ "directory": directory, "runs": runs, "unreadable": unreadable, "pressure_cycles": cycles }),
        );
    }
    for problem in &unreadable {
        context.note(format_args!("a run cannot be read: {problem}"));
    }
    if runs.is_empty() {
        return context.print(format_args!("no runs in {}", directory.display()));
    }
    let mut table = Table::new(&["run", "kind", "title", "FREE", "gains", "rig", "result", ">RMS error", "note"]);
    for run in &runs {
        let start = run.start();
        let rms = subject_error(run).map_or_else(|| "-".into(), |e| format!("{:.3} deg", e.rms_rad.to_degrees()));
        let title = match &start.repetition {
            Some(r) => format!("{} ({} of {})", start.title, r.index, r.of),
            None => start.title.clone(),
        };
        let rig = if start.simulated() { "SIMULATED" } else { "hardware" };
        let gains = start.gains_name(&start.subject);
        let result = run.result_name();
        table.row([run.id(), start.kind.name(), &title, &start.subject, &gains, rig, result, &rms, &start.note]);
    }
    context.print(table)?;
    let counts = Counts::read(&directory).with_context(|| format!("the pressure cycles in {}", directory.display()))?;
    for (cycles, simulated) in [(&counts.hardware, ""), (&counts.simulated, "SIMULATED ")] {
        for (name, count) in cycles {
            context.note(format_args!("{simulated}{name}: {count} pressure cycles"));
        }
    }
    if runs.iter().any(|run| !run.is_complete()) {
        context.note("incomplete: under way, or cut off; what was recorded can be read (`freerig report RUN`)");
    }
    Ok(())
}

fn as_json(run: &Run) -> Value {
    let start = run.start();
    let error = subject_error(run);
    json!({
        "id": run.id(),
        "folder": run.folder,
        "kind": start.kind,
        "title": start.title,
        "free": start.subject,
        "gains": Some(start.gains_name(&start.subject)).filter(|g| !g.is_empty()),
        "simulated": start.simulated(),
        "stepped": start.stepped,
        "started": start.started,
        "duration_s": run.stop().map(|s| s.duration_s),
        "complete": run.is_complete(),
        "result": run.result_name(),
        "message": run.stop().map(|s| s.message.as_str()).filter(|m| !m.is_empty()),
        "repetition": start.repetition,
        "rms_error_rad": error.as_ref().map(|e| e.rms_rad),
        "peak_error_rad": error.as_ref().map(|e| e.peak_rad),
        "final_error_rad": error.as_ref().map(|e| e.final_rad),
        "note": start.note,
    })
}

/// Errors of the FREE that the run is about (of the first that was given an angle, where it is about all).
fn subject_error(run: &Run) -> Option<ErrorDocument> {
    let errors = run.errors();
    errors.iter().find(|e| e.free == run.start().subject).or(errors.first()).cloned()
}

/// The folder of the runs.
pub(super) fn directory(context: &Context) -> Result<PathBuf, Failure> {
    Ok(Rig::load(&context.rig)?.record.directory)
}

/// The run that the user means: a path, an id, the beginning of one, or `latest`. A path needs no rig.toml.
pub(super) fn find(context: &Context, wanted: &str) -> Result<Run, Failure> {
    if Path::new(wanted).join(DOCUMENT_NAME).is_file() {
        return Ok(Run::open(Path::new(wanted))?);
    }
    Run::find(&directory(context)?, wanted).map_err(|error| match error {
        RecordError::NoSuchRun { .. } | RecordError::Ambiguous { .. } => Failure::usage(error).remedy(
            "name a run by its id, the beginning of its id, its folder, or `latest`; `freerig runs` lists them",
        ),
        other => other.into(),
    })
}

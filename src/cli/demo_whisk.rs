//! The whisk of `freerig demo`: an eight, planned for the example module and run on the simulated one, whose FREEs are
//! not quite the plan's.

use std::path::Path;

use super::experiment::stepped;
use super::plan::example_whisk;
use super::{Context, Failure};
use crate::config::Rig;
use crate::config::experiment::Experiment;
use crate::daemon::api::RunResult;
use crate::daemon::experiment::{Attendance, Job};

/// The example module: its rig and the calibrations of its FREEs.
const FILES: [(&str, &str); 3] = [
    ("rig.toml", include_str!("../../experiments/module/rig.toml")),
    ("module-r.toml", include_str!("../../calibration/module-r.toml")),
    ("module-l.toml", include_str!("../../calibration/module-l.toml")),
];

/// Plans the eight and runs it; its run goes to `runs`.
pub fn run(runs: &Path, context: &Context) -> Result<RunResult, Failure> {
    let folder = tempfile::tempdir()?;
    for (name, text) in FILES {
        std::fs::write(folder.path().join(name), text.replace("\"../../calibration\"", "\".\""))?;
    }
    let mut rig = Rig::load(&folder.path().join("rig.toml"))?;
    rig.record.directory = runs.to_owned();
    let whisk = example_whisk(&rig, context)?;
    let experiment = Experiment::parse(Path::new("whisk.toml"), &whisk.to_toml(&[]), &rig, None)?;
    let job = Job { note: "freerig demo".into(), stepped: true, ..Job::new(experiment, Attendance::Here) };
    let outcome = stepped(&rig, &job)?;
    Ok(outcome.done()?.clone())
}

//! The scene of `freerig demo`: a module whisks an eight, planned for the nominal one, while a fifth FREE turns the knob
//! of the cooktop; on the simulated rig, whose FREEs are not quite the plan's.

use std::path::Path;

use super::experiment::stepped;
use super::plan::example_whisk;
use super::{Context, Failure};
use crate::config::Rig;
use crate::config::experiment::Experiment;
use crate::daemon::api::RunResult;
use crate::daemon::experiment::{Attendance, Job};

/// The example scene: its rig and the calibrations of its FREEs.
const FILES: [(&str, &str); 4] = [
    ("rig.toml", include_str!("../../experiments/cook/rig.toml")),
    ("knob.toml", include_str!("../../calibration/knob.toml")),
    ("module-r.toml", include_str!("../../calibration/module-r.toml")),
    ("module-l.toml", include_str!("../../calibration/module-l.toml")),
];

/// What the knob does meanwhile.
const HEAT: &str = include_str!("../../experiments/cook/heat.toml");

/// Plans the eight, and runs it with the knob; the run goes to `runs`.
pub fn run(runs: &Path, context: &Context) -> Result<RunResult, Failure> {
    let folder = tempfile::tempdir()?;
    for (name, text) in FILES {
        std::fs::write(folder.path().join(name), text.replace("\"../../calibration\"", "\".\""))?;
    }
    let mut rig = Rig::load(&folder.path().join("rig.toml"))?;
    rig.record.directory = runs.to_owned();
    let whisk = example_whisk(&rig, context)?;
    let experiment = Experiment::parse(Path::new("cook.toml"), &(whisk.to_toml(&[]) + HEAT), &rig, None)?;
    let job = Job { note: "freerig demo".into(), stepped: true, ..Job::new(experiment, Attendance::Here) };
    let outcome = stepped(&rig, &job)?;
    Ok(outcome.done()?.clone())
}

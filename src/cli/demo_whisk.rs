//! The scene of `freerig demo`: a module whisks an eight, planned for the nominal one, while a fifth FREE turns the
//! knob of the cooktop; on the simulated rig, whose FREEs are not quite the plan's: as it stands, and led along its
//! path.

use std::path::Path;

use serde::Serialize;

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

/// The same plan on the same scene.
#[derive(Debug, Serialize)]
pub struct Whisks {
    /// The pressures as they were planned.
    pub open_loop: RunResult,
    /// The plate led along its path by its orientation and the model.
    pub closed_loop: RunResult,
}

impl Whisks {
    /// Both, with their names.
    pub fn both(&self) -> [(&'static str, &RunResult); 2] {
        [("open loop", &self.open_loop), ("closed loop", &self.closed_loop)]
    }
}

/// Plans the eight, and runs it with the knob, both ways; the runs go to `runs`.
pub fn run(runs: &Path, context: &Context) -> Result<Whisks, Failure> {
    let folder = tempfile::tempdir()?;
    for (name, text) in FILES {
        std::fs::write(folder.path().join(name), text.replace("\"../../calibration\"", "\".\""))?;
    }
    let mut rig = Rig::load(&folder.path().join("rig.toml"))?;
    rig.record.directory = runs.to_owned();
    let whisk = example_whisk(&rig, context)?;
    let text = whisk.to_toml(&[]) + HEAT;
    let with = |open_loop: bool| -> Result<RunResult, Failure> {
        let experiment = Experiment::parse(Path::new("cook.toml"), &text, &rig, None)?;
        let note = "freerig demo".into();
        let job = Job { note, stepped: true, open_loop, ..Job::new(experiment, Attendance::Here) };
        Ok(stepped(&rig, &job)?.done()?.clone())
    };
    Ok(Whisks { open_loop: with(true)?, closed_loop: with(false)? })
}

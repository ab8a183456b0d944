//! `freerig calibrate stiffness`.

use jiff::Zoned;

use super::{How, confirm, failure, measure, prepare, tell};
use crate::cli::{Context, Failure};
use crate::config::Rig;
use crate::daemon::calibration::{Finding, stiffness};
use crate::record::Run;
use crate::units::Pressure;

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (rig, index) = prepare(how, context)?;
    let (finding, run) = find(how, &rig, index, context)?;
    tell(&finding, &rig, index, &run, context)
}

pub(super) fn find(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<(Finding, Run), Failure> {
    let highest = stiffness::highest_pressure(rig, index).map_err(failure)?;
    let instruction = format!(
        "The FREE hangs free, its IMU on its end and nothing else, and has rested without pressure. It will be taken up \
         to {:.2} and back for about two minutes; nobody is near it without eye protection.",
        Pressure::pascals(highest)
    );
    confirm(how, rig, "stiffness", &instruction, context)?;
    let text = stiffness::experiment(rig, index).map_err(failure)?;
    let run = measure(how, rig, index, &text, context)?;
    let today = Zoned::now().date().to_string();
    Ok((stiffness::evaluate(rig, index, &run, &today).map_err(failure)?, run))
}

//! `freerig calibrate regulator`.

use jiff::Zoned;

use super::{How, confirm, failure, measure, prepare, tell};
use crate::cli::{Context, Failure};
use crate::daemon::calibration::{regulator, stiffness};
use crate::units::Pressure;

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (rig, index) = prepare(how, context)?;
    let highest = stiffness::highest_pressure(&rig, index).map_err(failure)?;
    let instruction = format!(
        "The FREE is on its regulator and hangs free. Its pressure will jump up to {:.2} for half a minute; nobody is near \
         it without eye protection.",
        Pressure::pascals(highest)
    );
    confirm(how, &rig, "regulator", &instruction, context)?;
    let text = regulator::experiment(&rig, index).map_err(failure)?;
    let run = measure(how, &rig, index, &text, context)?;
    let today = Zoned::now().date().to_string();
    let finding = regulator::evaluate(&rig, index, &run, &today).map_err(failure)?;
    tell(&finding, &rig, index, &run, context)
}

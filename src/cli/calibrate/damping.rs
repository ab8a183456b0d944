//! `freerig calibrate damping`.

use std::io::{self, BufRead, IsTerminal, Write as _};

use jiff::Zoned;

use super::{How, by_hand, confirm, failure, prepare, tell};
use crate::cli::{Context, Failure};
use crate::config::{Rig, Script};
use crate::daemon::calibration::damping::{self, Look};
use crate::daemon::calibration::{CalibrationError, Finding};
use crate::record::Run;

/// Added inertias that a person is asked for, at most.
const ADDED_MAX: usize = 3;

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (rig, index) = prepare(how, context)?;
    let (finding, run) = find(how, &rig, index, context)?;
    tell(&finding, &rig, index, &run, context)
}

pub(super) fn find(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<(Finding, Run), Failure> {
    let mut looks: Vec<Look> = Vec::new();
    let mut too_fast = None;
    let mut added = Some(0.0);
    let mut count = 0;
    while let Some(inertia) = added {
        match look(how, rig, index, inertia, context)? {
            Ok(look) => looks.push(look),
            // With more inertia it may be slow enough.
            Err(error) if damping::is_too_fast(&error) => {
                context.note(&error);
                too_fast = Some(error);
            }
            Err(error) => return Err(failure(error)),
        }
        added = next_inertia(how, rig, count)?;
        count += 1;
    }
    let Some(last) = looks.last() else {
        // Without a look there is at least one that was too fast.
        return Err(too_fast.map_or_else(|| Failure::failed(anyhow::anyhow!("nothing was plucked")), failure));
    };
    let run = last.run.clone();
    let today = Zoned::now().date().to_string();
    let mut finding = damping::evaluate(rig, index, &looks, &today).map_err(failure)?;
    if let Some(error) = too_fast {
        finding.remarks.push(error.to_string());
        finding.sheet.remarks.push(error.to_string());
    }
    Ok((finding, run))
}

/// Plucks the FREE with `added` kg m2 on its end; the outer error ends the calibration whatever it is.
fn look(
    how: &How,
    rig: &Rig,
    index: usize,
    added: f64,
    context: &Context,
) -> Result<Result<Look, CalibrationError>, Failure> {
    let plan = match damping::plan(rig, index, added) {
        Ok(plan) => plan,
        Err(error) => return Ok(Err(error)),
    };
    confirm(how, rig, "damping", &plan.instruction(), context)?;
    let run = by_hand(how, rig, index, &plan.experiment, Some(&plan), context)?;
    Ok(damping::look(rig, index, &run, added))
}

/// The inertia that is added next, kg m2: the script's, or what a person at a real bench says.
fn next_inertia(how: &How, rig: &Rig, count: usize) -> Result<Option<f64>, Failure> {
    if let Some(path) = &how.script {
        return Ok(Script::read(path)?.added_inertia.get(count).copied());
    }
    if rig.is_simulated() || count >= ADDED_MAX || !io::stdin().is_terminal() {
        return Ok(None);
    }
    loop {
        let _ = write!(io::stderr().lock(), "Inertia to add to the end now, kg m2 (nothing: that was all): ");
        let _ = io::stderr().lock().flush();
        let mut answer = String::new();
        io::stdin().lock().read_line(&mut answer)?;
        match answer.trim() {
            "" => return Ok(None),
            text => match text.parse::<f64>() {
                Ok(inertia) if (1e-9..=1.0).contains(&inertia) => return Ok(Some(inertia)),
                _ => {
                    let _ = writeln!(io::stderr().lock(), "{text} is none: a number from 1e-9 to 1, as 3e-5");
                }
            },
        }
    }
}

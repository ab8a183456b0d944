//! `freerig calibrate all`: everything that can be measured of a FREE, each step on what the ones before it found.
//!
//! The calibration file is written once: at the end, or where a step fails, with what the steps before it found. Until
//! then all of it is in memory, for a daemon does not arm on files that have changed under it.

use anyhow::Context as _;
use serde::Serialize;

use super::{How, attend, damping, imu, prepare, regulator, significant, stiffness, value_table};
use crate::cli::{Context, Failure, tune};
use crate::config::Rig;
use crate::daemon::calibration::{Finding, FoundValue};
use crate::record::{Run, Sheet};

/// A step: its name, and how it finds its values.
type Step = (&'static str, fn(&How, &Rig, usize, &Context) -> Result<(Finding, Run), Failure>);

/// In an order in which each finds what the next ones take as known.
const STEPS: [Step; 4] =
    [("imu", imu::find), ("regulator", regulator::find), ("stiffness", stiffness::find), ("damping", damping::find)];

/// What one step found.
#[derive(Debug, Serialize)]
struct Done {
    step: &'static str,
    values: Vec<FoundValue>,
    remarks: Vec<String>,
    run: String,
    report: String,
}

#[derive(Debug, Serialize)]
struct Answer {
    simulated: bool,
    free: String,
    steps: Vec<Done>,
    /// The gains that suit them.
    gains: tune::Row,
    gains_report: String,
    report: String,
    calibration: String,
}

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (mut rig, index) = prepare(how, context)?;
    let mut done = Vec::new();
    let found = steps(how, &mut rig, index, &mut done, context).and_then(|()| {
        let found = tune::find(&rig, index, None, context)?;
        rig.calibrations[index].set_gains(&*found.name, found.tuned.gains);
        Ok(found)
    });
    let calibration = &rig.calibrations[index];
    let write = || {
        let directory = &rig.calibration_directory;
        let path = calibration.write(directory);
        path.with_context(|| format!("cannot write the calibration `{}` in {}", calibration.name, directory.display()))
    };
    let found = match found {
        Ok(found) => found,
        Err(failure) => {
            if !done.is_empty() {
                let steps: Vec<_> = done.iter().map(|d| d.step).collect();
                context.note(format!("{} written to {}", steps.join(", "), write()?.display()));
            }
            return Err(failure);
        }
    };
    if !how.stepped {
        attend::disarm(&rig.socket.path)?;
    }
    let path = write()?;
    let mut answer = Answer {
        simulated: rig.is_simulated(),
        free: rig.control.frees[index].name.clone(),
        steps: done,
        gains: found.row,
        gains_report: found.report,
        report: String::new(),
        calibration: path.display().to_string(),
    };
    let page = rig.record.directory.join(format!("calibrate-{}.html", answer.free));
    answer.report = answer.sheet(&rig).write(&page)?.display().to_string();
    if context.json { context.print_json(&answer) } else { context.print(answer.text()) }
}

/// Takes every step, and adopts what it found.
fn steps(how: &How, rig: &mut Rig, index: usize, done: &mut Vec<Done>, context: &Context) -> Result<(), Failure> {
    for (number, (step, find)) in STEPS.into_iter().enumerate() {
        context.note(format!("step {} of {}: {step}", number + 1, STEPS.len() + 1));
        // The sensor's profile is read from a disarmed rig.
        if number > 0 && !how.stepped {
            attend::arm(&rig.socket.path)?;
        }
        let (finding, run) = find(how, rig, index, context)?;
        let report = finding.sheet.write(&run.folder.join("calibration.html"))?.display().to_string();
        done.push(Done { step, values: finding.values, remarks: finding.remarks, run: run.id().to_owned(), report });
        rig.adopt(index, finding.calibration);
    }
    context.note(format!("step {0} of {0}: gains", STEPS.len() + 1));
    Ok(())
}

impl Answer {
    fn sheet(&self, rig: &Rig) -> Sheet {
        let value = |v: &FoundValue| {
            (v.key.to_owned(), format!("{} +- {}", significant(v.value), significant(v.standard_uncertainty)))
        };
        let mut facts: Vec<_> = self.steps.iter().flat_map(|step| step.values.iter().map(value)).collect();
        facts.push(("gains".into(), format!("{}: {}", self.gains.name, self.gains.text())));
        // The page lies beside the runs.
        let here = |path: &str| {
            let within = std::path::Path::new(path).strip_prefix(&rig.record.directory);
            within.map_or(path.to_owned(), |within| within.display().to_string())
        };
        let mut links: Vec<_> = self.steps.iter().map(|step| (step.step.to_owned(), here(&step.report))).collect();
        links.push(("gains: the root locus".into(), here(&self.gains_report)));
        Sheet {
            title: format!("Calibration of {}", self.free),
            simulated: self.simulated,
            remarks: self.steps.iter().flat_map(|step| step.remarks.iter().cloned()).collect(),
            facts,
            links,
            ..Sheet::default()
        }
    }

    fn text(&self) -> String {
        let table = value_table(self.steps.iter().flat_map(|step| &step.values));
        let simulated = if self.simulated { "SIMULATED: devices and FREE are simulated\n\n" } else { "" };
        let remarks = self.steps.iter().flat_map(|step| step.remarks.iter().map(move |r| (step.step, r)));
        let remarks: String = remarks.map(|(step, remark)| format!("\nnote: {step}: {remark}")).collect();
        format!(
            "{simulated}FREE {}\n\n{table}\n\ngains {}: {}{remarks}\n\npages: {}\nwritten to {}; a daemon that runs takes it \
             up at the next arming; `gains = \"{}\"` in rig.toml uses the gains",
            self.free,
            self.gains.name,
            self.gains.text(),
            self.report,
            self.calibration,
            self.gains.name
        )
    }
}

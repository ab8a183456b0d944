//! `freerig calibrate material`: from files, no rig.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use jiff::Zoned;
use serde::Serialize;

use super::{failure, significant};
use crate::cli::free::subject;
use crate::cli::table::Table;
use crate::cli::{Context, Failure};
use crate::config::{Calibration, Rig, Script};
use crate::daemon::calibration::FoundValue;
use crate::daemon::calibration::material::{self, LawRow};

/// What a material calibration takes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// FREE of the rig, or name of a calibration, that the values go to; not needed where the rig has one FREE
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
    /// Script whose [material] names the files
    #[arg(long, value_name = "FILE")]
    script: PathBuf,
}

#[derive(Debug, Serialize)]
struct Answer<'a> {
    /// Files come from no simulated device.
    simulated: bool,
    values: &'a [FoundValue],
    laws: &'a [LawRow],
    remarks: &'a [String],
    report: String,
    calibration: String,
}

pub(super) fn run(args: &Args, context: &Context) -> Result<(), Failure> {
    let script = Script::read(&args.script)?;
    let Some(tests) = &script.material else {
        let error = anyhow!("{} has no [material]", args.script.display());
        return Err(
            Failure::usage(error).remedy("add [material] with the files of the tests; the README has an example")
        );
    };
    let (directory, calibration) = target(args.free.as_deref(), &context.rig)?;
    let today = Zoned::now().date().to_string();
    let (finding, laws) = material::evaluate(tests, &calibration, &today).map_err(failure)?;
    let page = directory.join(format!("{}-material.html", calibration.name));
    let report = finding.sheet.write(&page)?.display().to_string();
    let path = finding
        .calibration
        .write(&directory)
        .with_context(|| format!("cannot write the calibration `{}` in {}", calibration.name, directory.display()))?;
    let answer = Answer {
        simulated: false,
        values: &finding.values,
        laws: &laws,
        remarks: &finding.remarks,
        report,
        calibration: path.display().to_string(),
    };
    if context.json { context.print_json(&answer) } else { context.print(answer.text()) }
}

/// The folder of the calibrations, and the one that is meant: that of a FREE of the rig, else the one of that name.
fn target(name: Option<&str>, rig: &Path) -> Result<(PathBuf, Calibration), Failure> {
    let (directory, wanted) = match Rig::load(rig) {
        Ok(rig) => match name.map_or_else(|| subject(&rig, None).map(Some), |name| Ok(rig.free(name)))? {
            Some(index) => return Ok((rig.calibration_directory.clone(), rig.calibrations[index].clone())),
            None => (rig.calibration_directory, name),
        },
        // Where there is no rig yet, the calibrations are looked for beside its description.
        Err(_) if name.is_some() => (rig.parent().unwrap_or(Path::new("")).join("calibration"), name),
        Err(error) => return Err(error.into()),
    };
    let path = directory.join(format!("{}.toml", wanted.unwrap_or_default()));
    Ok((directory, Calibration::read(&path)?))
}

impl Answer<'_> {
    fn text(&self) -> String {
        let mut values = Table::new(&["value", ">before", ">now", ">standard uncertainty"]);
        for v in self.values {
            let before = v.before.map_or("-".into(), significant);
            values.row([v.key.into(), before, significant(v.value), significant(v.standard_uncertainty)]);
        }
        let mut laws = Table::new(&["test", "law", ">mu (MPa)", ">alpha", ">RMSD (kPa)", ">of the range"]);
        for row in self.laws {
            let alpha = row.ogden_exponent.map_or("-".into(), |alpha| format!("{alpha:.3}"));
            let (mu, rmsd) = (significant(row.shear_modulus_mpa), significant(1e-3 * row.rmsd_pa));
            laws.row([row.test.into(), row.law.into(), mu, alpha, rmsd, format!("{:.2} %", row.rmsd_percent)]);
        }
        let laws = if self.laws.is_empty() { String::new() } else { format!("\n\n{laws}") };
        let remarks: String = self.remarks.iter().map(|remark| format!("\nnote: {remark}")).collect();
        format!("{values}{laws}{remarks}\n\nfit: {}\nwritten to {}", self.report, self.calibration)
    }
}

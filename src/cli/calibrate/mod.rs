//! `freerig calibrate`: measures what is not known of a FREE, and puts it into its calibration file.

mod all;
mod ask;
mod damping;
mod imu;
mod loads;
mod material;
mod regulator;
mod stiffness;

use std::io::{self, BufRead, IsTerminal, Write as _};
use std::path::PathBuf;

use anyhow::{Context as _, anyhow};
use serde::Serialize;

use super::experiment::stepped;
use super::free::subject;
use super::table::Table;
use super::{Context, Failure, attend};
use crate::config::experiment::Experiment;
use crate::config::{Rig, Script};
use crate::daemon::api::Start;
use crate::daemon::calibration::damping::Plan;
use crate::daemon::calibration::{CalibrationError, Finding, FoundValue};
use crate::daemon::experiment::{Attendance, Job};
use crate::daemon::validity;
use crate::record::Run;

const EXAMPLES: &str = "\
The rig must be armed (`freerig arm`); Ctrl-C takes the pressures down and leaves the old calibration as it was. With \
--stepped no daemon is needed: the simulated rig runs here. Of a real FREE every step asks whether all is mounted; a script \
answers in a person's place: a file with the line `ready = [\"imu\", \"regulator\", \"stiffness\", \"damping\"]`.

Examples:
  freerig calibrate stiffness --free paper
  freerig calibrate all --free paper
  freerig calibrate all --free paper --script answers.toml --stepped
  freerig calibrate material --free paper --script tests.toml";

/// What `freerig calibrate` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// E, mu, alpha and the fibres' EA, from files of tensile tests and of a bare tube's inflation
    Material(material::Args),
    /// Noise, drift and axis of the IMU; its own calibration profile is saved
    Imu(How),
    /// Lag, dead time and slew of the pressure regulator, its zero, span and hysteresis
    Regulator(How),
    /// Torsional stiffness kt and hysteresis, from a staircase of pressure; ke and kt from known weights and torques
    Stiffness(How),
    /// Torsional damping ct, by plucks; the inertia, too, where one is added
    Damping(How),
    /// All of these in their order, then the gains: each on what the ones before it found
    All(How),
}

/// How a calibration is carried out.
#[derive(Debug, clap::Args)]
struct How {
    /// FREE; not needed where the rig has one
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
    /// File with the answers, in place of a person at the terminal
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// On the simulated rig and the stepped clock, in this process
    #[arg(long)]
    stepped: bool,
    /// Seed of the simulated rig [default: rig.toml's]
    #[arg(long, value_name = "N", requires = "stepped")]
    seed: Option<u64>,
}

/// Carries out the calibration.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.what {
        What::Material(args) => material::run(&args, context),
        What::Regulator(how) => regulator::run(&how, context),
        What::Stiffness(how) => stiffness::run(&how, context),
        What::Imu(how) => imu::run(&how, context),
        What::Damping(how) => damping::run(&how, context),
        What::All(how) => all::run(&how, context),
    }
}

fn failure(error: CalibrationError) -> Failure {
    let remedy = error.remedy();
    Failure::failed(error).remedy(remedy)
}

/// The rig, and the index of the FREE that is to be measured.
fn prepare(how: &How, context: &Context) -> Result<(Rig, usize), Failure> {
    let mut rig = Rig::load(&context.rig)?;
    let index = subject(&rig, how.free.as_deref())?;
    if how.stepped && !rig.is_simulated() {
        let error = anyhow!("--stepped runs on simulated devices, and {} has real ones", context.rig.display());
        return Err(
            Failure::usage(error).remedy("set `backend = \"sim\"`, or start the daemon and leave --stepped out")
        );
    }
    if let Some(seed) = how.seed {
        rig.bench.seed = seed;
    }
    for warning in how.stepped.then(|| validity::of(&rig).warnings).into_iter().flatten() {
        context.note(format!("warning: {warning}"));
    }
    Ok((rig, index))
}

/// Has a person, or the script, say that `step` is prepared as `instruction` says. A simulated FREE is always so.
fn confirm(how: &How, rig: &Rig, step: &str, instruction: &str, context: &Context) -> Result<(), Failure> {
    if let Some(path) = &how.script {
        let script = Script::read(path)?;
        if script.is_ready(step) {
            return Ok(());
        }
        let error = anyhow!("{} does not say that `{step}` is ready", path.display());
        return Err(Failure::usage(error).remedy(format!("{instruction} Then add \"{step}\" to `ready`")));
    }
    if rig.is_simulated() {
        return Ok(());
    }
    if !io::stdin().is_terminal() {
        let error = anyhow!("a calibration of a real FREE asks a person, and there is no terminal");
        return Err(Failure::usage(error).remedy("run it in a terminal, or give the answers with `--script FILE`"));
    }
    context.note(instruction);
    // The prompt has no line end, so that the answer stands beside it.
    let _ = write!(io::stderr().lock(), "Is it so? [y/N] ");
    let _ = io::stderr().lock().flush();
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer)?;
    if matches!(answer.trim(), "y" | "Y" | "yes") {
        return Ok(());
    }
    Err(Failure::failed(anyhow!("not confirmed: nothing was done")).remedy(instruction))
}

/// Runs the experiment `text` and answers its run; anything but a whole run is a failure, and vented.
fn measure(how: &How, rig: &Rig, index: usize, text: &str, context: &Context) -> Result<Run, Failure> {
    by_hand(how, rig, index, text, None, context)
}

/// The same with what a person does meanwhile. The simulated bench has a hand of its own.
fn by_hand(
    how: &How,
    rig: &Rig,
    index: usize,
    text: &str,
    hand: Option<&Plan>,
    context: &Context,
) -> Result<Run, Failure> {
    let name = &rig.control.frees[index].name;
    let told = hand.map(|plan| plan.hand.clone());
    let outcome = if how.stepped {
        let experiment = Experiment::parse("calibration.toml".as_ref(), text, rig, Some(name))?;
        // A loop that is not closed has no margin.
        let job = Job { accept_margin: true, stepped: true, hand: told, ..Job::new(experiment, Attendance::Here) };
        stepped(rig, &job)?
    } else {
        let start = Start {
            open_loop: false,
            kind: "sweep".into(),
            experiment: text.into(),
            free: Some(name.clone()),
            repeat: Some(1),
            hand: told,
            ..Start::default()
        };
        let cues = hand.filter(|_| !rig.is_simulated()).map(Plan::cues).unwrap_or_default();
        let outcome = attend::cued(&rig.socket.path, &start, &cues, context)?;
        if outcome.runs.last().is_some_and(|run| run.outcome == "aborted") {
            attend::disarm(&rig.socket.path)?;
            context.note("the pressures are down and the rig is disarmed; the old calibration is untouched");
        }
        outcome
    };
    let last = outcome.done()?;
    Run::open(last.folder.as_ref())
        .with_context(|| format!("the run {} cannot be read", last.id))
        .map_err(Failure::from)
}

#[derive(Debug, Serialize)]
struct Answer<'a> {
    simulated: bool,
    free: &'a str,
    values: &'a [FoundValue],
    remarks: &'a [String],
    run: &'a str,
    report: String,
    calibration: String,
}

/// Writes the page and the calibration, and prints what was found.
fn tell(finding: &Finding, rig: &Rig, index: usize, run: &Run, context: &Context) -> Result<(), Failure> {
    let report = finding.sheet.write(&run.folder.join("calibration.html"))?.display().to_string();
    let directory = &rig.calibration_directory;
    let path = finding.calibration.write(directory).with_context(|| {
        format!("cannot write the calibration `{}` in {}", finding.calibration.name, directory.display())
    })?;
    let answer = Answer {
        simulated: run.start().simulated(),
        free: &rig.control.frees[index].name,
        values: &finding.values,
        remarks: &finding.remarks,
        run: run.id(),
        report,
        calibration: path.display().to_string(),
    };
    if context.json { context.print_json(&answer) } else { context.print(answer.text()) }
}

/// Four significant digits.
fn significant(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-4 {
        return format!("{value:.3e}");
    }
    let digits = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) };
    format!("{value:.0$}", digits as usize)
}

/// Values before and now.
fn value_table<'a>(values: impl IntoIterator<Item = &'a FoundValue>) -> Table {
    let mut table = Table::new(&["value", ">before", ">now", ">standard uncertainty", ">finite elements"]);
    let dash = |value: Option<f64>| value.map_or("-".into(), significant);
    for v in values {
        let percent = 100.0 * v.standard_uncertainty / v.value.abs();
        let mut uncertainty = significant(v.standard_uncertainty);
        // Of what may as well be zero a share says nothing.
        if percent < 100.0 {
            uncertainty += &format!(" ({percent:.2} %)");
        }
        table.row([v.key.into(), dash(v.before), significant(v.value), uncertainty, dash(v.prediction)]);
    }
    table
}

impl Answer<'_> {
    fn text(&self) -> String {
        let table = value_table(self.values);
        let simulated = if self.simulated { "SIMULATED: devices and FREE are simulated\n\n" } else { "" };
        let remarks: String = self.remarks.iter().map(|remark| format!("\nnote: {remark}")).collect();
        format!(
            "{simulated}FREE {}\n\n{table}{remarks}\n\nfit: {}\nwritten to {}; a daemon that runs takes it up at the next \
             arming",
            self.free, self.report, self.calibration
        )
    }
}

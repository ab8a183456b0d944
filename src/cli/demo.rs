//! `freerig demo`: the whole job on the simulated rig, in this process.
//!
//! Stiffness and hysteresis of the simulated FREE first; then one trajectory in real time, with the threads, drivers
//! and files of the daemon; then step and trajectory on the stepped clock, with the gains that the paper's authors
//! published and with freerig's own; a module's whisk with a knob that is turned at the end.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::anyhow;
use jiff::Zoned;
use serde::Serialize;
use tracing::level_filters::LevelFilter;

use super::demo_whisk::{self, Whisks};
use super::experiment::stepped;
use super::outcome::{Outcome, Watch, degrees};
use super::{Context, Failure, log};
use crate::config::experiment::{Experiment, Kind};
use crate::config::{Backend, Rig};
use crate::control::ControllerKind;
use crate::control::margin::{GAIN_MARGIN_MIN, margin};
use crate::control::tune::{Target, tune};
use crate::daemon::api::RunResult;
use crate::daemon::calibration::{FoundValue, stiffness};
use crate::daemon::experiment::{self, Attendance, Job};
use crate::daemon::{Bench, DaemonError, Live, Switches, names, procedure};
use crate::record::{self, Run};
use crate::signal::{FaultCode, FaultSet};

/// What is run on the stepped clock: the gains that the paper's authors published, then the rig's own.
const EXPERIMENTS: [(Kind, &str); 2] = [(Kind::Step, "published-step"), (Kind::Trajectory, "published-trajectory")];

/// Faults of a machine that does not keep time: its threads, or those of the simulated devices, came too late.
const LATE: [FaultCode; 4] = [FaultCode::Deadline, FaultCode::PressureStale, FaultCode::ImuStale, FaultCode::BusLost];
/// How often arming is tried on a machine that is busy.
const ATTEMPTS: u32 = 5;

const EXAMPLES: &str = "\
Measures the simulated FREE, runs the paper's trajectory in real time, compares the published gains with freerig's own, \
and lets a module whisk while a fifth FREE turns a knob. It writes into the folder of the runs and leaves the \
calibration as it is; open the report that it names last in a browser.

Examples:
  freerig demo
  freerig demo --json";

/// What `freerig demo` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {}

/// What came of it.
#[derive(Debug, Serialize)]
struct Demo {
    simulated: bool,
    /// What was measured of the FREE first.
    calibration: Calibrated,
    /// The trajectory in real time; `null` where the machine stalled before it began.
    real_time: Option<RunResult>,
    /// How the machine kept time.
    machine: Machine,
    /// On the stepped clock: published gains, then own.
    comparisons: Vec<Comparison>,
    /// The module's whisk and the knob, at once, on the stepped clock.
    whisk: Whisks,
    /// One page for all of it.
    report: String,
    elapsed_s: f64,
}

#[derive(Debug, Serialize)]
struct Calibrated {
    /// The stiffness.
    values: Vec<FoundValue>,
    /// The run that it was measured in.
    run: String,
    /// The page of the fit.
    report: String,
}

#[derive(Debug, Default, Serialize)]
struct Machine {
    realtime_rights: bool,
    ticks: u64,
    skipped: u64,
    wake_up_p99_s: Option<f64>,
    tick_p99_s: Option<f64>,
    /// What a stall did to the run.
    stall: Option<String>,
}

#[derive(Debug, Serialize)]
struct Comparison {
    experiment: &'static str,
    published: RunResult,
    own: RunResult,
    /// Gain margins of the two on this rig; `null` beyond 36 dB.
    published_gain_margin: Option<f64>,
    own_gain_margin: Option<f64>,
    /// RMS error with the published gains over RMS error with the rig's own.
    rms_ratio: Option<f64>,
}

/// Runs the demonstration.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    let begun = Instant::now();
    log::start(LevelFilter::ERROR);
    let mut rig = Rig::load(&context.rig)?;
    rig.backend = Backend::Sim;
    context.note("freerig demo: the paper's experiments on a SIMULATED bench\n");

    context.note("1. on the stepped clock: stiffness and hysteresis of the FREE, and gains for it");
    let calibration = calibrate(&mut rig, context)?;
    context.note("2. in real time: trajectory, with what was measured");
    let (real_time, machine) = real_time(&rig)?;
    context.note(machine.text());
    context.note("3. on the stepped clock: the same drivers and chips, as fast as this machine can");
    let comparisons =
        EXPERIMENTS.iter().map(|(kind, gains)| compare(&rig, *kind, gains, context)).collect::<Result<Vec<_>, _>>()?;

    context.note(
        "4. on the stepped clock: four FREEs under one plate draw a figure eight, as planned for their nominal module, and led \
         along it; a fifth turns the cooktop's knob",
    );
    let whisk = demo_whisk::run(&rig.record.directory, context)?;

    let report = overview(&rig, real_time.as_ref(), &comparisons, &whisk)?.display().to_string();
    let elapsed_s = begun.elapsed().as_secs_f64();
    let demo = Demo { simulated: true, calibration, real_time, machine, comparisons, whisk, report, elapsed_s };
    if context.json { context.print_json(&demo) } else { context.print(demo.text().trim_end()) }
}

/// Measures the first FREE on the simulated rig, and has `rig` control it by what was found. No file in the calibration
/// folder is touched.
fn calibrate(rig: &mut Rig, context: &Context) -> Result<Calibrated, Failure> {
    let begun = Instant::now();
    let text = stiffness::experiment(rig, 0)?;
    let free = rig.control.frees.first().map(|free| free.name.as_str());
    let experiment = Experiment::parse(Path::new("calibration.toml"), &text, rig, free)?;
    let job = Job {
        note: "freerig demo".into(),
        stepped: true,
        accept_margin: true,
        ..Job::new(experiment, Attendance::Here)
    };
    let outcome = stepped(rig, &job)?;
    let run = Run::open(Path::new(&outcome.done()?.folder))?;
    let finding = stiffness::evaluate(rig, 0, &run, &Zoned::now().date().to_string())?;
    let report = finding.sheet.write(&run.folder.join("calibration.html"))?.display().to_string();
    rig.adopt(0, finding.calibration);
    let period = rig.control.period;
    let free = rig.control.frees.first_mut().ok_or_else(|| anyhow!("the rig has no FREE"))?;
    if let (Some(imu), ControllerKind::Model(_)) = (&free.imu, &free.controller) {
        free.gains = tune(&free.free, &free.regulator, imu, period, &Target::MODEL)?.gains;
    }
    let seconds = begun.elapsed().as_secs_f64();
    for value in &finding.values {
        let before = value.before.map_or("the calibration does not say it".into(), |before| {
            format!("not {before:.4} as the calibration says")
        });
        context.note(format!(
            "   {} {:.4} +- {:.4}, {before}; in {seconds:.1} s",
            value.key, value.value, value.standard_uncertainty
        ));
    }
    Ok(Calibrated { values: finding.values, run: run.id().to_owned(), report })
}

/// All runs on one page, those of one FREE drawn over each other by experiment, with links to their own reports.
fn overview(
    rig: &Rig,
    real_time: Option<&RunResult>,
    comparisons: &[Comparison],
    whisk: &Whisks,
) -> Result<PathBuf, Failure> {
    let results = comparisons.iter().flat_map(|c| [&c.own, &c.published]).chain(real_time);
    let runs = results.map(|run| Run::open(Path::new(&run.folder))).collect::<Result<Vec<_>, _>>()?;
    let mut page = record::Comparison::of(&runs)?;
    page.title = "freerig demo".into();
    page.links = whisk.both().map(|(name, run)| (whisked(name, run), format!("{}/report.html", run.id))).into();
    Ok(page.write(&rig.record.directory.join("demo.html"))?)
}

/// The paper's trajectory with the rig's own gains and the daemon's own threads.
fn real_time(rig: &Rig) -> Result<(Option<RunResult>, Machine), Failure> {
    let live = Live::start(rig, Switches::default()).map_err(Failure::rig)?;
    let run = trajectory(rig, &live);
    let faults = live.bench().latest().latched.union(run.as_ref().err().map_or(FaultSet::default(), faults_of));
    let mut machine = Machine {
        realtime_rights: live.rights().is_some_and(|r| r.realtime()),
        ticks: live.statistics().ticks(),
        skipped: live.statistics().skipped(),
        wake_up_p99_s: seconds(live.statistics().latency.snapshot().percentile(99.0)),
        tick_p99_s: seconds(live.statistics().execution.snapshot().percentile(99.0)),
        stall: None,
    };
    let vented = live.stop(rig);
    // This is a demonstration on whatever machine there is: that it stalls is worth a word, not a failure.
    if LATE.iter().any(|&fault| faults.contains(fault)) {
        machine.stall = Some(names(faults));
        return Ok((run.ok(), machine));
    }
    let run = run.map_err(Failure::rig)?;
    if run.outcome != "done" {
        return Err(Failure::fault(anyhow!("{}: {}", run.id, run.reason.unwrap_or_default())));
    }
    if !vented.map_err(Failure::rig)? {
        return Err(Failure::fault(anyhow!("the simulated FREE was not seen vented at the end")));
    }
    Ok((Some(run), machine))
}

fn faults_of(error: &DaemonError) -> FaultSet {
    match error {
        DaemonError::Fault(faults) => *faults,
        DaemonError::Refused { refusal, .. } => refusal.fault.map_or(FaultSet::default(), FaultSet::only),
        // Whatever was waited for did not come in time.
        DaemonError::Timeout { .. } | DaemonError::LoopEnded(_) => FaultSet::only(FaultCode::Deadline),
        _ => FaultSet::default(),
    }
}

fn trajectory(rig: &Rig, live: &Live) -> Result<RunResult, DaemonError> {
    let mut bench = live.bench();
    let mut attempts = 0;
    while let Err(error) = procedure::arm(&mut bench, rig, false) {
        attempts += 1;
        if attempts == ATTEMPTS || !matches!(error, DaemonError::Refused { .. }) {
            return Err(error);
        }
    }
    let job = job(rig, Kind::Trajectory, None).map_err(|e| DaemonError::Unfit(e.to_string()))?;
    let mut watch = Watch::new(&job.title, job.subject);
    let runs = experiment::run(&mut bench, rig, &job, &mut |progress| watch.show(progress))?;
    let run = runs.first().ok_or_else(|| DaemonError::Unfit("nothing was run".into()))?;
    Ok(RunResult::of(run)?)
}

fn compare(rig: &Rig, kind: Kind, gains: &str, context: &Context) -> Result<Comparison, Failure> {
    let with = |gains: Option<&str>| -> Result<RunResult, Failure> {
        let mut rig = rig.clone();
        // The published gains are meant for Eq. 5 alone.
        if gains.is_some() {
            rig.control.frees.iter_mut().for_each(|free| {
                free.controller = ControllerKind::Pid;
                free.feedforward = 0.0;
            });
        }
        let job = Job { stepped: true, accept_margin: true, ..job(&rig, kind, gains)? };
        let begun = Instant::now();
        let Outcome { runs, .. } = stepped(&rig, &job)?;
        let seconds = begun.elapsed().as_secs_f64();
        context.note(format!(
            "   {:<10} {:<21} {:.1} s of bench time in {seconds:.1} s",
            kind.name(),
            gains.unwrap_or("freerig's own"),
            job.program.duration
        ));
        runs.into_iter().next().ok_or_else(|| Failure::failed(anyhow!("nothing was run")))
    };
    let (published, own) = (with(Some(gains))?, with(None)?);
    let rms = |run: &RunResult| run.frees.first().and_then(|free| free.rms_error_rad);
    let rms_ratio = rms(&published).zip(rms(&own)).map(|(published, own)| published / own);
    let (published_gain_margin, own_gain_margin) = (gain_margin(rig, Some(gains)), gain_margin(rig, None));
    Ok(Comparison { experiment: kind.name(), published, own, published_gain_margin, own_gain_margin, rms_ratio })
}

/// Gain margin of the first FREE's loop with the preset `gains`, or with its own.
fn gain_margin(rig: &Rig, gains: Option<&str>) -> Option<f64> {
    let mut free = rig.control.frees.first()?.clone();
    free.gains = gains.map_or(Some(free.gains), crate::config::gains::preset)?;
    margin(&free, rig.control.period).map(|m| m.gain_margin).filter(|m| m.is_finite())
}

/// The paper's experiment for the rig's first FREE, with other `gains` or its own.
fn job(rig: &Rig, kind: Kind, gains: Option<&str>) -> Result<Job, Failure> {
    let (name, text) =
        kind.default_file().ok_or_else(|| Failure::usage(anyhow!("a {} has no file of its own", kind.name())))?;
    let free = rig.control.frees.first().map(|free| free.name.as_str());
    let mut text = text.to_owned();
    if let Some(gains) = gains {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "gains = \"{gains}\"");
    }
    let experiment = Experiment::parse(Path::new(name), &text, rig, free)?;
    Ok(Job { note: "freerig demo".into(), ..Job::new(experiment, Attendance::Here) })
}

fn seconds(nanoseconds: Option<u64>) -> Option<f64> {
    nanoseconds.map(|ns| ns as f64 * 1e-9)
}

impl Machine {
    fn text(&self) -> String {
        let microseconds = |t: Option<f64>| t.map_or_else(|| "-".into(), |t| format!("{:.0} us", t * 1e6));
        let rights = if self.realtime_rights { "with" } else { "without" };
        let mut text = format!(
            "   {} ticks {rights} real-time rights, {} skipped; 99 % woke up within {} and ran within {}",
            self.ticks,
            self.skipped,
            microseconds(self.wake_up_p99_s),
            microseconds(self.tick_p99_s)
        );
        if let Some(faults) = &self.stall {
            // Writing to a String cannot fail.
            let _ = write!(
                text,
                "\n   this machine stalled, and the rig took its pressures down: {faults}\n   a real bench wants a \
                 quieter machine (`freerig latency`)"
            );
        }
        text
    }
}

impl Demo {
    fn text(&self) -> String {
        let mut text = String::from("\nSIMULATED: devices and FREE are simulated\n\n");
        // Writing to a String cannot fail.
        let mut line = |line: String| {
            let _ = writeln!(text, "{}", line.trim_end());
        };
        line(format!("{:<12} {:<22} {:>10} {:>10} {:>10}  result", "experiment", "gains", "RMS", "peak", "final"));
        if let Some(run) = &self.real_time {
            line(row("trajectory", "own, in real time", run));
        }
        for comparison in &self.comparisons {
            line(row(comparison.experiment, &format!("published-{}", comparison.experiment), &comparison.published));
            line(row("", "own", &comparison.own));
            if let Some(ratio) = comparison.rms_ratio {
                line(format!("{:<12} {:<22} {ratio:>10.2}", "", "published / own"));
            }
            let margins = [comparison.published_gain_margin, comparison.own_gain_margin]
                .map(|m| m.map_or_else(|| "-".into(), |m| format!("{m:.1}")));
            line(format!(
                "{:<12} gain margin {} published, {} own; arming asks for {GAIN_MARGIN_MIN}",
                "", margins[0], margins[1]
            ));
        }
        for (name, run) in self.whisk.both() {
            let Some(tip) = &run.tip else { continue };
            let (rms, peak) = (mm(Some(tip.rms_error_m)), mm(Some(tip.peak_error_m)));
            let what = format!("{name}, estimated");
            line(format!("{:<12} {what:<22} {rms:>10} {peak:>10} {:>10}  {}", "whisk", "-", run.outcome));
            let (rms, peak) = (mm(tip.true_rms_error_m), mm(tip.true_peak_error_m));
            line(format!("{:<12} {:<22} {rms:>10} {peak:>10} {:>10}", "", "true (SIMULATED)", "-"));
            for free in run.frees.iter().filter(|free| free.rms_error_rad.is_some()) {
                let [rms, peak, last] = [free.rms_error_rad, free.peak_error_rad, free.final_error_rad].map(degrees);
                line(format!("{:<12} {:<22} {rms:>10} {peak:>10} {last:>10}", "", free.name));
            }
            line(format!("{:<12} report: {}/report.html", "", run.folder));
        }
        line(format!(
            "\ndone in {:.0} s. Every run with its report, its samples and its run.rrd is in runs/",
            self.elapsed_s
        ));
        line(format!("report: {}", self.report));
        text
    }
}

/// A whisk in a line.
fn whisked(name: &str, run: &RunResult) -> String {
    let plate = run.tip.iter().map(|tip| {
        let [rms, peak, truth] = [Some(tip.rms_error_m), Some(tip.peak_error_m), tip.true_rms_error_m].map(mm);
        format!("plate from its plan RMS {rms}, peak {peak}, true RMS (SIMULATED) {truth}")
    });
    let frees = run.frees.iter().filter(|free| free.rms_error_rad.is_some()).map(|free| {
        let [rms, peak, last] = [free.rms_error_rad, free.peak_error_rad, free.final_error_rad].map(degrees);
        format!("{} RMS {rms}, peak {peak}, final {last}", free.name)
    });
    format!("whisk and knob, {name}: {}", plate.chain(frees).collect::<Vec<_>>().join("; "))
}

fn mm(metres: Option<f64>) -> String {
    metres.map_or_else(|| "-".into(), |m| format!("{:.2} mm", 1e3 * m))
}

fn row(experiment: &str, gains: &str, run: &RunResult) -> String {
    let free = run.frees.first().cloned().unwrap_or_default();
    let [rms, peak, last] = [free.rms_error_rad, free.peak_error_rad, free.final_error_rad].map(degrees);
    format!("{experiment:<12} {gains:<22} {rms:>10} {peak:>10} {last:>10}  {}", run.outcome)
}

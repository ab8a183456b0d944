//! What a person sees of an experiment: its progress while it runs, its figures when it has ended.

use std::fmt::Write as _;

use anyhow::anyhow;
use serde::Serialize;

use super::{Context, Failure, Progress};
use crate::daemon::api::{FreeResult, RunResult};
use crate::daemon::experiment;
use crate::record::mean_and_scatter;
use crate::signal::{FreeTick, Quantity};
use crate::units::{Angle, Pressure};

/// Shows the progress of a job that runs in this process.
pub struct Watch {
    title: String,
    subject: usize,
    shown: Option<(String, &'static str, Progress)>,
}

impl Watch {
    /// Of the job `title` about the FREE `subject`.
    pub fn new(title: &str, subject: usize) -> Self {
        Self { title: title.into(), subject, shown: None }
    }

    /// Shows where it is.
    pub fn show(&mut self, progress: &experiment::Progress<'_>) {
        let same = self.shown.as_ref().is_some_and(|(id, phase, _)| id == progress.run.0 && *phase == progress.phase);
        if !same {
            let times = if progress.repeat > 1 { format!(", no. {}", progress.repeat) } else { String::new() };
            let label = format!("{}{times}: {}", self.title, progress.phase);
            let bar = Progress::new(label, progress.duration, "s");
            self.shown = Some((progress.run.0.to_owned(), progress.phase, bar));
        }
        if let (Some((_, _, bar)), Some(free)) = (&mut self.shown, progress.record.frees().get(self.subject)) {
            bar.set(progress.elapsed, &state(free));
        }
    }
}

/// Angle, reference and pressure in a few words.
fn state(free: &FreeTick) -> String {
    let angle = format!("{:.1}", Angle::radians(free.estimate.angle));
    let reference = match free.reference.quantity {
        Quantity::Angle => format!(" (reference {:.1})", Angle::radians(free.reference.position)),
        _ => String::new(),
    };
    format!("angle {angle}{reference}, pressure {:.2}", Pressure::pascals(free.pressure.pressure))
}

/// The runs of an experiment.
#[derive(Debug, Serialize)]
pub struct Outcome {
    /// Whether the devices were simulated.
    pub simulated: bool,
    /// Its runs, in their order.
    pub runs: Vec<RunResult>,
    /// Over the runs that were done: mean and standard deviation of the RMS error of each FREE, in their order.
    pub repeats: Vec<Scatter>,
}

/// Mean and scatter of a figure over repetitions.
#[derive(Clone, Debug, Serialize)]
pub struct Scatter {
    /// Name of the FREE.
    pub free: String,
    /// How many runs.
    pub runs: usize,
    /// Mean of the RMS errors, rad.
    pub rms_error_mean_rad: f64,
    /// Their standard deviation, rad; `null` for one run.
    pub rms_error_scatter_rad: Option<f64>,
}

impl Outcome {
    /// Of these `runs`.
    pub fn new(runs: Vec<RunResult>) -> Self {
        let simulated = runs.iter().any(|run| run.simulated);
        let names =
            runs.first().map(|run| run.frees.iter().map(|free| free.name.clone()).collect()).unwrap_or_default();
        let repeats = scatter(names, &runs);
        Self { simulated, runs, repeats }
    }

    /// Prints it; a run that was not done is a failure all the same.
    pub fn tell(&self, context: &Context) -> Result<(), Failure> {
        if context.json {
            context.print_json(self)?;
        } else {
            context.print(self.text().trim_end())?;
        }
        self.done().map(|_| ())
    }

    /// The last run, where it was done; else why not.
    pub fn done(&self) -> Result<&RunResult, Failure> {
        match self.runs.last() {
            Some(run) if run.outcome == "done" => Ok(run),
            Some(run) => {
                let error = anyhow!("{}: {}", run.id, run.reason.as_deref().unwrap_or("it did not come to its end"));
                Err(if run.outcome == "fault" { Failure::fault(error) } else { Failure::failed(error) })
            }
            None => Err(Failure::failed(anyhow!("nothing was run"))),
        }
    }

    fn text(&self) -> String {
        let mut text = String::new();
        if self.simulated {
            text.push_str("SIMULATED: devices and FREE are simulated\n\n");
        }
        let width = self.runs.iter().map(|run| run.id.len()).max().unwrap_or(0);
        // Writing to a String cannot fail.
        let mut line = |line: String| {
            let _ = writeln!(text, "{}", line.trim_end());
        };
        if self.runs.iter().any(|run| run.frees.iter().any(|free| is_worth_a_line(free, run))) {
            line(format!("{:width$}  {:<12} {:>10} {:>10} {:>10}  result", "run", "FREE", "RMS", "peak", "final"));
        }
        for run in &self.runs {
            for free in run.frees.iter().filter(|free| is_worth_a_line(free, run)) {
                line(format!(
                    "{:width$}  {:<12} {:>10} {:>10} {:>10}  {}",
                    run.id,
                    free.name,
                    degrees(free.rms_error_rad),
                    degrees(free.peak_error_rad),
                    degrees(free.final_error_rad),
                    run.outcome
                ));
                if let Some(hysteresis) = free.hysteresis_rad {
                    let (model, loops) = (degrees(free.model_rmsd_rad), degrees(Some(hysteresis)));
                    line(format!("{:width$}  RMSD to the model {model}, hysteresis {loops}", ""));
                }
            }
        }
        for (run, tip) in self.runs.iter().filter_map(|run| Some((run, run.tip?))) {
            let mm = |m: f64| format!("{:.2} mm", 1e3 * m);
            line(format!(
                "{}: plate from its plan: RMS {}, peak {}",
                run.id,
                mm(tip.rms_error_m),
                mm(tip.peak_error_m)
            ));
            if let Some((rms, peak)) = tip.true_rms_error_m.zip(tip.true_peak_error_m) {
                line(format!("{:width$}  true (SIMULATED): RMS {}, peak {}", "", mm(rms), mm(peak)));
            }
        }
        for scatter in self.repeats.iter().filter(|scatter| scatter.runs > 1) {
            line(format!(
                "{:width$}  {:<12} {:>10} +- {} over {} runs",
                "mean",
                scatter.free,
                degrees(Some(scatter.rms_error_mean_rad)),
                degrees(scatter.rms_error_scatter_rad),
                scatter.runs
            ));
        }
        for run in &self.runs {
            line(format!("report: {}/report.html", run.folder));
        }
        text
    }
}

/// A FREE that only held its pressure has no figures, and those of a module have only their plate's.
fn is_worth_a_line(free: &FreeResult, run: &RunResult) -> bool {
    let swept = free.hysteresis_rad.is_some() && run.tip.is_none();
    run.frees.len() == 1 || free.rms_error_rad.is_some() || swept
}

fn scatter(names: Vec<String>, runs: &[RunResult]) -> Vec<Scatter> {
    let over = |(index, free): (usize, String)| {
        let done = runs.iter().filter(|run| run.outcome == "done");
        let errors: Vec<f64> = done.filter_map(|run| run.frees.get(index)?.rms_error_rad).collect();
        let (mean, scatter) = mean_and_scatter(&errors)?;
        let scatter = (errors.len() > 1).then_some(scatter);
        Some(Scatter { free, runs: errors.len(), rms_error_mean_rad: mean, rms_error_scatter_rad: scatter })
    };
    names.into_iter().enumerate().filter_map(over).collect()
}

/// An angle in degrees, or a dash.
pub fn degrees(angle: Option<f64>) -> String {
    angle.map_or_else(|| "-".into(), |angle| format!("{:.2}", Angle::radians(angle)))
}

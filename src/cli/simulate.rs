//! `freerig simulate`: the lumped model in a loop with its controller, and the linear model against the nonlinear.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow};
use clap::ValueEnum;
use serde_json::{Value, json};

use super::{Context, Failure};
use crate::config::{Calibration, gains};
use crate::control::Gains;
use crate::fem::lumped::LumpedStiffness;
use crate::model::{Free, Kinematics, Law};
use crate::signal::Quantity;
use crate::sim::{Assessment, ClosedLoop, ClosedLoopError, Controller, SETTLING_BAND, Sample, assess};
use crate::trajectory::{Axis, Sequence, paper_steps, paper_trajectory};
use crate::units::{Angle, Length, Pressure, Seconds};

/// Highest pressure of the controller: that of the paper's experiments.
const PRESSURE_MAX: Pressure = Pressure::psi(10.0);
/// Gains where none are named: those with which the paper's figures come out.
const DEFAULT_GAINS: &str = "paper-pi";
/// Length of an open-loop run, s.
const OPEN_LOOP: f64 = 1.0;

const EXAMPLES: &str = "\
Examples:
  freerig simulate trajectory --free paper --model nonlinear
  freerig simulate step --free published-code --model linear --gains published-step --csv step.csv
  freerig simulate openloop --free paper --model nonlinear --pressure 5psi --dt-out 1ms
  freerig simulate step --free paper --model nonlinear --controller sampled --tick 0.5ms --delay-ticks 1";

/// What `freerig simulate` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// What is asked: the paper's steps (50, 20, 80 deg), its trajectory (40, 10, 70 deg), or a constant pressure
    task: Task,
    /// calibration/NAME.toml, or a calibration file
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "paper")]
    free: String,
    /// Whether the pressure acts on the deformed fibres or on those at rest
    #[arg(long, default_value = "nonlinear")]
    model: Model,
    /// Radius of inextensible fibres, or the one that the paper's authors published
    #[arg(long, default_value = "exact")]
    kinematics: Radius,
    /// PID as part of the differential equations, or the tick's own at its rate
    #[arg(long, default_value = "continuous")]
    controller: Timing,
    /// Period of the sampled controller
    #[arg(long, default_value = "2ms")]
    tick: Seconds,
    /// Ticks from a sample to its command, sampled controller
    #[arg(long, value_name = "N", default_value_t = 0)]
    delay_ticks: u32,
    /// Where the stiffnesses come from: the calibration, or the section's finite elements
    #[arg(long, default_value = "calibration")]
    from: Source,
    /// Gains by name: the calibration's own or a preset [default: paper-pi]
    #[arg(long, value_name = "NAME", conflicts_with_all = ["kp", "ki", "kd"])]
    gains: Option<String>,
    /// Proportional gain, Pa/rad
    #[arg(long, value_name = "GAIN")]
    kp: Option<f64>,
    /// Integral gain, Pa/(rad s)
    #[arg(long, value_name = "GAIN")]
    ki: Option<f64>,
    /// Derivative gain on the measured rate, Pa s/rad
    #[arg(long, value_name = "GAIN")]
    kd: Option<f64>,
    /// Pressure of an open-loop run
    #[arg(long)]
    pressure: Option<Pressure>,
    /// Length of the run [default: 9 s, open loop 1 s]
    #[arg(long)]
    duration: Option<Seconds>,
    /// Interval of the samples
    #[arg(long, default_value = "10ms")]
    dt_out: Seconds,
    /// Write the samples to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Task {
    Step,
    Trajectory,
    Openloop,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Model {
    Linear,
    Nonlinear,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Radius {
    Exact,
    Published,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Timing {
    Continuous,
    Sampled,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Source {
    Calibration,
    Fem,
}

/// The word for a choice, as it is written on the command line.
fn word(choice: impl ValueEnum) -> String {
    choice.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default()
}

/// Runs the simulation, writes the samples and prints what came of it.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let calibration = calibration(&args.free, &context.rig)?;
    let (free, section) = stiffness(&args, &calibration, context)?;
    let plan = plan(&args, free, &calibration)?;
    let every = args.dt_out.si();
    let (samples, outcome) = assess(&plan, every);
    // A run that ends early is worth seeing up to there.
    if let Some(path) = &args.csv {
        write_csv(path, &samples).with_context(|| format!("cannot write {}", path.display()))?;
        context.note(format!("{} samples in {}", samples.len(), path.display()));
    }
    let assessment = outcome.map_err(|error| match error {
        ClosedLoopError::Ended { .. } => Failure::failed(error)
            .remedy("the model has a limit there, and so has the FREE: ask for less pressure or a smaller angle"),
        ClosedLoopError::Free(_) | ClosedLoopError::Time { .. } => Failure::usage(error),
    })?;
    let other = match plan.law {
        Law::Linear => Law::Nonlinear(args.kinematics()),
        Law::Nonlinear(_) => Law::Linear,
    };
    let (_, compared) = assess(&ClosedLoop { law: other, ..plan.clone() }, every);
    let report = Report { args: &args, plan: &plan, section, assessment: &assessment, compared: &compared };
    if context.json { context.print_json(&report.json()) } else { context.print(report.text()?) }
}

impl Args {
    fn kinematics(&self) -> Kinematics {
        match self.kinematics {
            Radius::Exact => Kinematics::Exact,
            Radius::Published => Kinematics::Published,
        }
    }
}

/// calibration/NAME.toml beside rig.toml, or the file itself.
fn calibration(free: &str, rig: &Path) -> Result<Calibration, Failure> {
    let path = if free.ends_with(".toml") {
        PathBuf::from(free)
    } else {
        rig.parent().unwrap_or(Path::new("")).join("calibration").join(format!("{free}.toml"))
    };
    Ok(Calibration::read(&path)?)
}

/// The FREE, with the stiffnesses of the section's finite elements if asked for.
fn stiffness(
    args: &Args,
    calibration: &Calibration,
    context: &Context,
) -> Result<(Free, Option<LumpedStiffness>), Failure> {
    let mut free = calibration.free();
    if args.from == Source::Calibration {
        return Ok((free, None));
    }
    let (tube, assumed) = calibration.tube();
    let stiffness = LumpedStiffness::by_section(&tube, free.length).map_err(Failure::usage)?;
    if !assumed.is_empty() {
        context.note(format!("not in the calibration, taken from the reference FREE: {}", assumed.join(", ")));
    }
    free.radius = tube.outer_radius();
    (free.axial_stiffness, free.torsional_stiffness) = (stiffness.axial, stiffness.torsional);
    Ok((free, Some(stiffness)))
}

fn plan(args: &Args, free: Free, calibration: &Calibration) -> Result<ClosedLoop, Failure> {
    let open = args.task == Task::Openloop;
    let given = args.gains.is_some() || args.kp.is_some() || args.ki.is_some() || args.kd.is_some();
    if open && given {
        return Err(Failure::usage(anyhow!("an open-loop run has no gains")));
    }
    if !open && args.pressure.is_some() {
        return Err(Failure::usage(anyhow!("--pressure belongs to openloop; {} is closed loop", word(args.task))));
    }
    let (quantity, sequence) = match args.task {
        Task::Step => (Quantity::Angle, paper_steps()?),
        Task::Trajectory => (Quantity::Angle, paper_trajectory()?),
        Task::Openloop => {
            let pressure = args.pressure.ok_or_else(|| {
                Failure::usage(anyhow!("openloop needs a pressure")).remedy("for example --pressure 5psi")
            })?;
            (Quantity::Pressure, Sequence::constant(pressure.si(), OPEN_LOOP)?)
        }
    };
    Ok(ClosedLoop {
        free,
        law: match args.model {
            Model::Linear => Law::Linear,
            Model::Nonlinear => Law::Nonlinear(args.kinematics()),
        },
        duration: args.duration.map_or(sequence.duration(), Seconds::si),
        axis: Axis { quantity, sequence },
        gains: chosen_gains(args, calibration)?,
        controller: match args.controller {
            Timing::Continuous => Controller::Continuous,
            Timing::Sampled => Controller::Sampled { period: args.tick.si(), delay: args.delay_ticks },
        },
        pressure_max: PRESSURE_MAX.si(),
    })
}

fn chosen_gains(args: &Args, calibration: &Calibration) -> Result<Gains, Failure> {
    if let (None, None, None) = (args.kp, args.ki, args.kd) {
        let name = args.gains.as_deref().unwrap_or(DEFAULT_GAINS);
        let found = calibration.gains(name).or_else(|| gains::preset(name));
        return found.ok_or_else(|| {
            let known: Vec<_> = calibration.gain_names().collect();
            Failure::usage(anyhow!("no gains `{name}`")).remedy(format!("one of: {}", known.join(", ")))
        });
    }
    let gain = |value: Option<f64>| value.unwrap_or(0.0);
    let gains = Gains {
        proportional: gain(args.kp),
        integral: gain(args.ki),
        derivative: gain(args.kd),
        derivative_filter: 0.0,
    };
    if [gains.proportional, gains.integral, gains.derivative].iter().all(|g| g.is_finite()) {
        Ok(gains)
    } else {
        Err(Failure::usage(anyhow!("gains must be finite numbers")))
    }
}

fn write_csv(path: &Path, samples: &[Sample]) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    writeln!(file, "t_s,s_m,phi_rad,sdot_m_s,phidot_rad_s,pressure_pa,reference_rad")?;
    for Sample { time, state, pressure, reference } in samples {
        // Multiples of the interval to a nanosecond; the rest with all its digits.
        let time = (time * 1e9).round() / 1e9;
        let reference = if reference.is_nan() { "nan".to_owned() } else { format!("{reference:e}") };
        writeln!(
            file,
            "{time},{:e},{:e},{:e},{:e},{pressure:e},{reference}",
            state.extension, state.rotation, state.extension_rate, state.rotation_rate
        )?;
    }
    file.flush()
}

/// What came of it.
struct Report<'a> {
    args: &'a Args,
    plan: &'a ClosedLoop,
    section: Option<LumpedStiffness>,
    assessment: &'a Assessment,
    /// The same with the other law.
    compared: &'a Result<Assessment, ClosedLoopError>,
}

impl Report<'_> {
    /// (linear, nonlinear), where the other law came to its end.
    fn pair(&self) -> Option<(&Assessment, &Assessment)> {
        let other = self.compared.as_ref().ok()?;
        Some(match self.plan.law {
            Law::Linear => (self.assessment, other),
            Law::Nonlinear(_) => (other, self.assessment),
        })
    }

    fn closed(&self) -> bool {
        self.plan.axis.quantity == Quantity::Angle
    }

    fn json(&self) -> Value {
        let (args, plan, free) = (self.args, self.plan, &self.plan.free);
        let gains = &plan.gains;
        let comparison = self.pair().map(|(linear, nonlinear)| {
            json!({
                "linear": summary(linear),
                "nonlinear": summary(nonlinear),
                "linear_pressure_excess": excess(linear, nonlinear),
                "radius_change": nonlinear.radius_change,
                "winding_change": nonlinear.winding_change,
            })
        });
        let mut object = json!({
            "task": word(args.task),
            "free": args.free,
            "model": word(args.model),
            "kinematics": word(args.kinematics),
            "controller": word(args.controller),
            "tick_s": (args.controller == Timing::Sampled).then_some(args.tick.si()),
            "delay_ticks": (args.controller == Timing::Sampled).then_some(args.delay_ticks),
            "duration_s": plan.duration,
            "stiffness": {
                "from": word(args.from),
                "axial_n_per_m": free.axial_stiffness,
                "torsional_nm_per_rad": free.torsional_stiffness,
                "lost_coupling": self.section.map(|s| s.lost_coupling),
            },
            "gains": self.closed().then(|| json!({
                "proportional_pa_per_rad": gains.proportional,
                "integral_pa_per_rad_s": gains.integral,
                "derivative_pa_s_per_rad": gains.derivative,
            })),
            "pressure_pa": args.pressure.map(Pressure::si),
            "steps": self.assessment.effort.steps,
            "steps_rejected": self.assessment.effort.rejected,
            "comparison": comparison,
            "comparison_error": self.compared.as_ref().err().map(ToString::to_string),
            "csv": args.csv,
        });
        if let (Value::Object(all), Value::Object(result)) = (&mut object, summary(self.assessment)) {
            all.extend(result);
        }
        object
    }

    fn text(&self) -> Result<String, std::fmt::Error> {
        let (args, a) = (self.args, self.assessment);
        let mut out = String::new();
        let kinematics =
            if args.model == Model::Linear { String::new() } else { format!(", {} kinematics", word(args.kinematics)) };
        writeln!(
            out,
            "SIMULATED {}: {}, {} lumped model{kinematics}, {} controller, {} s",
            word(args.task),
            args.free,
            word(args.model),
            word(args.controller),
            self.plan.duration
        )?;
        if let Some(section) = self.section {
            writeln!(
                out,
                "stiffness by the section's finite elements: ke {:.0} N/m, kt {:.4} N m/rad; coupling lost {:.2}",
                section.axial, section.torsional, section.lost_coupling
            )?;
        }
        if self.closed() {
            let (rms, peak, last) = (Angle::radians(a.rms_error), a.peak_error, a.final_error);
            let (peak, last) = (Angle::radians(peak), Angle::radians(last));
            writeln!(out, "error: RMS {rms:.3}, peak {peak:.3}, final {last:.4}")?;
        }
        writeln!(
            out,
            "end: {:.3}, {:.3}; highest pressure {:.3}",
            Angle::radians(a.final_rotation),
            Length::metres(a.final_extension),
            Pressure::pascals(a.highest_pressure)
        )?;
        match (self.pair(), self.compared) {
            (Some((linear, nonlinear)), _) => self.write_comparison(&mut out, linear, nonlinear)?,
            (None, Err(error)) => writeln!(out, "the other model does not come to the end: {error}")?,
            (None, Ok(_)) => {}
        }
        Ok(out.trim_end().to_owned())
    }

    fn write_comparison(&self, out: &mut String, linear: &Assessment, nonlinear: &Assessment) -> std::fmt::Result {
        writeln!(out, "\nlinear against nonlinear")?;
        if !self.closed() {
            let (l, n) = (Angle::radians(linear.final_rotation), Angle::radians(nonlinear.final_rotation));
            writeln!(out, "  end: {l:.3} against {n:.3}")?;
        }
        for ((l, n), excess) in linear.moves.iter().zip(&nonlinear.moves).zip(excess(linear, nonlinear)) {
            let settling = |t: Option<f64>| t.map_or("never".to_owned(), |t| format!("{t:.3} s"));
            writeln!(
                out,
                "  to {:.1}: {:.3} against {:.3} ({:+.1} %), settled ({} %): {} against {}",
                Angle::radians(n.to),
                Pressure::pascals(l.pressure),
                Pressure::pascals(n.pressure),
                100.0 * excess,
                100.0 * SETTLING_BAND,
                settling(l.settling_time),
                settling(n.settling_time)
            )?;
        }
        let (r, g) = (100.0 * nonlinear.radius_change, 100.0 * nonlinear.winding_change);
        writeln!(out, "  largest change of the fibres' radius {r:+.1} %, of their angle {g:+.2} %")
    }
}

/// Pressure that the linear model needs beyond the nonlinear one at the end of each move, as a fraction.
fn excess(linear: &Assessment, nonlinear: &Assessment) -> Vec<f64> {
    linear.moves.iter().zip(&nonlinear.moves).map(|(l, n)| l.pressure / n.pressure - 1.0).collect()
}

fn summary(a: &Assessment) -> Value {
    let moves: Vec<Value> = a
        .moves
        .iter()
        .map(|m| {
            json!({
                "start_s": m.start,
                "end_s": m.end,
                "from_rad": m.from,
                "to_rad": m.to,
                "reached_rad": m.reached,
                "pressure_pa": m.pressure,
                "settling_time_s": m.settling_time,
                "overshoot": m.overshoot,
            })
        })
        .collect();
    json!({
        "rms_error_rad": a.rms_error,
        "peak_error_rad": a.peak_error,
        "final_error_rad": a.final_error,
        "final_rotation_rad": a.final_rotation,
        "final_extension_m": a.final_extension,
        "highest_pressure_pa": a.highest_pressure,
        "radius_change": a.radius_change,
        "winding_change": a.winding_change,
        "moves": moves,
    })
}

//! `freerig tune`: root locus, and gains with the damping and the margins that were asked for.

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Context as _, anyhow};
use serde::Serialize;

use super::free::subject;
use super::{Context, Failure};
use crate::config::Rig;
use crate::control::margin::{Loop, Margin};
use crate::control::root_locus::LocusLoop;
use crate::control::tune::{LimitedBy, Target, TuneError, Tuned, tune};
use crate::control::{ControllerKind, FreeControl, Gains, ImuChannel};
use crate::record::{Sheet, locus_sheet};
use crate::units::Angle;

const EXAMPLES: &str = "\
The gains are for the controller that rig.toml gives the FREE: with `controller = \"model\"` the feedback around the \
model, else the PID alone.

Examples:
  freerig tune --free paper
  freerig tune --free paper --gain-margin 4 --write";

/// What `freerig tune` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// FREE; not needed where the rig has one
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
    /// Least damping ratio of the closed loop's slow poles [default: 0.7]
    #[arg(long, value_name = "RATIO")]
    damping: Option<f64>,
    /// Least gain margin, a factor [default: 3; around a model 6]
    #[arg(long, value_name = "FACTOR")]
    gain_margin: Option<f64>,
    /// Least phase margin [default: 60 deg]
    #[arg(long, value_name = "ANGLE")]
    phase_margin: Option<Angle>,
    /// Put the gains into the calibration
    #[arg(long)]
    write: bool,
}

/// Gains and what they come to.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Their name in the calibration.
    pub name: String,
    proportional_pa_per_rad: f64,
    integral_pa_per_rad_s: f64,
    derivative_pa_s_per_rad: f64,
    derivative_filter_hz: f64,
    stable: bool,
    /// `null` beyond 36 dB.
    gain_margin: Option<f64>,
    phase_margin_deg: Option<f64>,
    delay_margin_s: Option<f64>,
    /// Largest modulus of the sampled loop's eigenvalues, per tick.
    spectral_radius: f64,
}

#[derive(Debug, Serialize)]
struct Answer {
    simulated: bool,
    free: String,
    controller: &'static str,
    tuned: Row,
    /// Least damping ratio of the slow poles.
    damping_ratio: f64,
    limited_by: &'static str,
    /// Closed-loop poles with lag, delays and sampling: real and imaginary part, 1/s.
    poles_per_s: Vec<[f64; 2]>,
    /// The gains that rig.toml names, and the presets.
    beside: Vec<Row>,
    report: String,
    /// The calibration file that they were written into.
    written: Option<String>,
}

/// Gains that were found.
pub struct Found {
    /// Their name in the calibration.
    pub name: String,
    /// The gains, and what bounds them.
    pub tuned: Tuned,
    /// The same in a row.
    pub row: Row,
    /// The root locus' page.
    pub report: String,
}

/// Finds gains for the FREE `index` of `rig` that meet `target`, else the usual one.
pub fn find(rig: &Rig, index: usize, target: Option<&Target>, context: &Context) -> Result<Found, Failure> {
    let (free, period) = (&rig.control.frees[index], rig.control.period);
    let usual = usual(free);
    let target = target.unwrap_or(&usual);
    let imu = free.imu.ok_or_else(|| {
        let error = anyhow!("FREE `{}` has no IMU, and so no loop that could be tuned", free.name);
        Failure::usage(error).remedy(format!("describe its sensor in `[free.imu]` of {}", context.rig.display()))
    })?;
    let tuned = tune(&free.free, &free.regulator, &imu, period, target).map_err(|error| match error {
        TuneError::Target { .. } => Failure::usage(error).remedy("ask for a value within these bounds"),
        TuneError::Unreachable(_) => Failure::failed(error)
            .remedy("ask for less, shorten the tick, or use a faster regulator: its lag and dead time are the bound"),
    })?;
    let name = format!("tuned-{}", controller(free));
    let report = page(rig, free, &imu, &name, &tuned, target)?;
    Ok(Found { row: row(&name, tuned.gains, free, &imu, period), name, tuned, report })
}

/// Finds the gains and tells them.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let rig = Rig::load(&context.rig)?;
    let index = subject(&rig, args.free.as_deref())?;
    let (free, period) = (&rig.control.frees[index], rig.control.period);
    let Found { name, tuned, row: found, report } = find(&rig, index, Some(&args.target(free)), context)?;
    let written = args.write.then(|| write(&rig, index, &name, &tuned)).transpose()?;
    let known = &rig.calibrations[index];
    let others = known.gain_names().filter(|other| *other != name);
    let beside = others
        .filter_map(|name| known.gains(name).zip(free.imu).map(|(gains, imu)| row(name, gains, free, &imu, period)));
    let answer = Answer {
        simulated: rig.is_simulated(),
        free: free.name.clone(),
        controller: controller(free),
        tuned: found,
        damping_ratio: tuned.damping,
        limited_by: limit(tuned.limited_by),
        poles_per_s: tuned.poles.extended.iter().map(|z| [z.re, z.im]).collect(),
        beside: beside.collect(),
        report,
        written,
    };
    if context.json { context.print_json(&answer) } else { context.print(answer.text()) }
}

impl Args {
    fn target(&self, free: &FreeControl) -> Target {
        let usual = usual(free);
        Target {
            damping: self.damping.unwrap_or(usual.damping),
            gain_margin: self.gain_margin.unwrap_or(usual.gain_margin),
            phase_margin_deg: self.phase_margin.map_or(usual.phase_margin_deg, |a| a.si().to_degrees()),
        }
    }
}

fn usual(free: &FreeControl) -> Target {
    match free.controller {
        ControllerKind::Model(_) => Target::MODEL,
        ControllerKind::Pid | ControllerKind::Nothing => Target::PID,
    }
}

fn controller(free: &FreeControl) -> &'static str {
    match free.controller {
        ControllerKind::Model(_) => "model",
        ControllerKind::Pid | ControllerKind::Nothing => "pid",
    }
}

fn limit(by: LimitedBy) -> &'static str {
    match by {
        LimitedBy::Damping => "damping",
        LimitedBy::GainMargin => "gain margin",
        LimitedBy::PhaseMargin => "phase margin",
    }
}

/// Puts the gains into the FREE's calibration file; answers its path.
fn write(rig: &Rig, index: usize, name: &str, tuned: &Tuned) -> Result<String, Failure> {
    let mut calibration = rig.calibrations[index].clone();
    calibration.set_gains(name, tuned.gains);
    let path = calibration.write(&rig.calibration_directory).with_context(|| {
        format!("cannot write the calibration `{}` in {}", calibration.name, rig.calibration_directory.display())
    })?;
    Ok(path.display().to_string())
}

/// Draws the root locus; answers the page's path.
fn page(
    rig: &Rig,
    free: &FreeControl,
    imu: &ImuChannel,
    name: &str,
    tuned: &Tuned,
    target: &Target,
) -> Result<String, Failure> {
    let period = rig.control.period;
    let locus = LocusLoop::new(&free.free, &tuned.gains, &free.regulator, imu, period);
    let gains = tuned.gains;
    let facts = vec![
        ("controller".into(), controller(free).into()),
        ("gains".into(), format!("{name}: {}", gains_text(gains))),
        ("margins".into(), margin_text(&tuned.margin)),
        ("damping ratio".into(), format!("{:.2} (asked for: {:.2})", tuned.damping, target.damping)),
        ("bounded by".into(), limit(tuned.limited_by).into()),
        (
            "loop".into(),
            format!(
                "tick {:.1} ms, regulator's lag {:.0} ms and dead time {:.1} ms, sensor's delay {:.0} ms; \
                 delay in all {:.0} ms",
                ms(period),
                ms(free.regulator.lag),
                ms(free.regulator.dead_time),
                ms(imu.delay),
                1e3 * locus.delay()
            ),
        ),
        ("sampled loop".into(), format!("largest eigenvalue {:.5} per tick", tuned.margin.spectral_radius)),
    ];
    let sheet = locus_sheet(&format!("Root locus of {}", free.name), &locus, tuned, target, facts);
    let sheet = Sheet { simulated: rig.is_simulated(), ..sheet };
    std::fs::create_dir_all(&rig.record.directory)?;
    let path = sheet.write(&rig.record.directory.join(format!("tune-{}.html", free.name)))?;
    Ok(path.display().to_string())
}

fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

fn row(name: &str, gains: Gains, free: &FreeControl, imu: &ImuChannel, period: Duration) -> Row {
    let margin = Loop::new(&free.free, &gains, &free.regulator, imu, period).margin();
    let finite = |x: f64| x.is_finite().then_some(x);
    Row {
        name: name.into(),
        proportional_pa_per_rad: gains.proportional,
        integral_pa_per_rad_s: gains.integral,
        derivative_pa_s_per_rad: gains.derivative,
        derivative_filter_hz: gains.derivative_filter,
        stable: margin.stable,
        gain_margin: finite(margin.gain_margin),
        phase_margin_deg: finite(margin.phase_margin_deg),
        delay_margin_s: finite(margin.delay_margin_s),
        spectral_radius: margin.spectral_radius,
    }
}

fn gains_text(gains: Gains) -> String {
    format!(
        "Kp {:.0} Pa/rad, Ki {:.0} Pa/(rad s), Kd {:.0} Pa s/rad",
        gains.proportional, gains.integral, gains.derivative
    )
}

fn margin_text(margin: &Margin) -> String {
    let stable = if margin.stable { "" } else { "UNSTABLE, " };
    format!(
        "{stable}gain {:.2}, phase {:.0} deg, delay {:.0} ms",
        margin.gain_margin,
        margin.phase_margin_deg,
        1e3 * margin.delay_margin_s
    )
}

impl Row {
    /// Gains and margins in a few words.
    pub fn text(&self) -> String {
        let dash = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
        format!(
            "Kp {:.0} Pa/rad, Ki {:.0} Pa/(rad s), Kd {:.0} Pa s/rad; margins {} and {} deg",
            self.proportional_pa_per_rad,
            self.integral_pa_per_rad_s,
            self.derivative_pa_s_per_rad,
            dash(self.gain_margin, 2),
            dash(self.phase_margin_deg, 0)
        )
    }
}

impl Answer {
    fn text(&self) -> String {
        let mut table =
            super::table::Table::new(&["gains", ">Kp Pa/rad", ">Ki Pa/(rad s)", ">Kd Pa s/rad", ">gain", ">phase", ""]);
        let dash = |value: Option<f64>, digits: usize| value.map_or("-".into(), |v| format!("{v:.digits$}"));
        for row in std::iter::once(&self.tuned).chain(&self.beside) {
            table.row([
                row.name.clone(),
                format!("{:.0}", row.proportional_pa_per_rad),
                format!("{:.0}", row.integral_pa_per_rad_s),
                format!("{:.0}", row.derivative_pa_s_per_rad),
                dash(row.gain_margin, 2),
                dash(row.phase_margin_deg, 0),
                if row.stable { "" } else { "UNSTABLE" }.into(),
            ]);
        }
        let simulated = if self.simulated { "SIMULATED: devices and FREE are simulated\n\n" } else { "" };
        let mut text = format!(
            "{simulated}FREE {}, controller `{}`: gains and their margins on this rig\n\n",
            self.free, self.controller
        );
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "{table}\n\ndamping ratio {:.2}; bounded by the {}\nroot locus: {}",
            self.damping_ratio, self.limited_by, self.report
        );
        let _ = match &self.written {
            Some(path) => write!(text, "\nwritten to {path}; `gains = \"{}\"` in rig.toml uses them", self.tuned.name),
            None => write!(text, "\n`--write` puts them into the calibration"),
        };
        text
    }
}

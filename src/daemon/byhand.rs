//! One value set by hand: a small program like any other, recorded, and within the limits.

use std::sync::Arc;

use super::DaemonError;
use super::api::{Problem, ProblemKind, Set};
use super::experiment::{Attendance, Job, pressure_axis};
use crate::config::Rig;
use crate::control::FreeControl;
use crate::record::RunKind;
use crate::signal::{FreeTick, Quantity, TickRecord};
use crate::trajectory::{Axis, Program, Segment, Sequence, Shape};
use crate::units::{Angle, Pressure, Temperature};

/// How long a new value is given to settle, s.
const SETTLE: f64 = 2.0;
/// Shortest time for a way to a new value, s.
const SHORTEST: f64 = 0.2;
/// The mean rate of the way to a new angle, rad/s: a third of the paper's trajectory.
const ANGULAR_RATE: f64 = 0.15;

/// The job that brings one FREE from where `record` finds it to where `set` wants it; the others keep their
/// pressures.
///
/// # Errors
/// A FREE that is not there, an angle that is not measured, a value beyond the limits.
pub(super) fn job(set: &Set, rig: &Rig, record: &TickRecord) -> Result<Job, Problem> {
    let Some(subject) = rig.free(&set.free) else {
        let names: Vec<_> = rig.free_names().collect();
        let error = format!("there is no FREE called `{}`", set.free);
        return Err(Problem::new(ProblemKind::Usage, error, format!("this rig has: {}", names.join(", "))));
    };
    let (Some(free), Some(tick)) = (rig.control.frees.get(subject), record.frees().get(subject)) else {
        return Err(Problem::new(ProblemKind::Busy, "the rig has only just been started", "try again in a moment"));
    };
    let (title, axis) = match (set.pressure_pa, set.angle_rad, set.temperature_degc) {
        (Some(pressure), None, None) => to_pressure(free, tick, pressure)?,
        (None, Some(angle), None) => to_angle(free, tick, angle)?,
        (None, None, Some(temperature)) => {
            let (_, axis) = to_angle(free, tick, knob_angle(rig, subject, temperature)?)?;
            (format!("{:.1}", Temperature::celsius(temperature)), axis)
        }
        _ => {
            let error = "exactly one of pressure, angle and temperature is to be set";
            return Err(Problem::new(ProblemKind::Usage, error, "give one of them"));
        }
    };
    let program = program(subject, axis, record).map_err(|error| Problem::from(&error))?;
    Ok(Job {
        kind: RunKind::Set,
        title,
        subject,
        program: Arc::new(program),
        gains: None,
        note: String::new(),
        repeats: 1,
        attendance: Attendance::Detached,
        accept_margin: true,
        hand: None,
        whisk: None,
        open_loop: false,
        poses: Arc::default(),
        stepped: false,
        and_back: false,
        live: None,
        stop: Arc::default(),
    })
}

/// The angle at which the knob of the FREE `subject` sets `temperature`, degrees Celsius.
fn knob_angle(rig: &Rig, subject: usize, temperature: f64) -> Result<f64, Problem> {
    let name = &rig.control.frees[subject].name;
    let Some(table) = rig.temperatures(subject) else {
        let error = format!("`{name}` has no knob that sets temperatures");
        return Err(Problem::new(
            ProblemKind::Usage,
            error,
            "set an angle, or write the knob's table into [free.knob] of rig.toml",
        ));
    };
    table
        .angle_of(temperature, name)
        .map_err(|error| Problem::new(ProblemKind::Usage, error, "keep within the knob's table"))
}

fn to_pressure(free: &FreeControl, tick: &FreeTick, wanted: f64) -> Result<(String, Axis), Problem> {
    let max = free.limits.pressure_max;
    // The conversion from psi and back leaves some noise in the last digit.
    if !(0.0..=max * (1.0 + 1e-12)).contains(&wanted) {
        let (wanted, max) = (Pressure::pascals(wanted), Pressure::pascals(max));
        let error = format!("{wanted:.2} is outside 0 to {max:.2}, the range of `{}`", free.name);
        let remedy = "keep within the range, or raise max_pressure_psi in rig.toml if the FREE is proven for it";
        return Err(Problem::new(ProblemKind::Usage, error, remedy));
    }
    let way = ((wanted - tick.command).abs() / free.limits.slew).max(SHORTEST);
    let axis = pressure_axis(&[(way, tick.command, wanted), (SETTLE, wanted, wanted)]);
    Ok((format!("{:.2}", Pressure::pascals(wanted)), axis.map_err(|error| Problem::from(&error))?))
}

fn to_angle(free: &FreeControl, tick: &FreeTick, wanted: f64) -> Result<(String, Axis), Problem> {
    if !free.controls_angle() || !tick.estimate.valid {
        let error = format!("the angle of `{}` is not measured, or is its module's", free.name);
        return Err(Problem::new(ProblemKind::Refused, error, "set a pressure, or give the FREE an IMU in rig.toml"));
    }
    let (low, high) = free.limits.angle_soft;
    if !(low..=high).contains(&wanted) {
        let [wanted, low, high] = [wanted, low, high].map(Angle::radians);
        let error = format!("{wanted:.1} is outside {low:.1} to {high:.1}, the soft envelope of `{}`", free.name);
        return Err(Problem::new(ProblemKind::Usage, error, "keep within the envelope, or widen it in rig.toml"));
    }
    let from = tick.estimate.angle.clamp(low, high);
    let way = ((wanted - from).abs() / ANGULAR_RATE).max(SHORTEST);
    let segments = [Segment::new(from, Shape::Cubic, wanted, way), Segment::new(wanted, Shape::Linear, wanted, SETTLE)];
    let sequence = Sequence::new(segments).map_err(|e| Problem::from(&DaemonError::Unfit(e.to_string())))?;
    Ok((format!("{:.1}", Angle::radians(wanted)), Axis { quantity: Quantity::Angle, sequence }))
}

/// `axis` for the subject; every other FREE keeps its present command.
fn program(subject: usize, axis: Axis, record: &TickRecord) -> Result<Program, DaemonError> {
    let duration = axis.sequence.duration();
    let mut axes = vec![(subject, axis)];
    for (free, tick) in record.frees().iter().enumerate().filter(|(free, _)| *free != subject) {
        axes.push((free, pressure_axis(&[(duration, tick.command, tick.command)])?));
    }
    Program::new(axes).map_err(|e| DaemonError::Unfit(e.to_string()))
}

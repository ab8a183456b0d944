//! Torsional stiffness and hysteresis by a staircase of pressure, up, down, and with inner loops.

use std::f64::consts::PI;
use std::fmt::Write as _;

use super::{CalibrationError, Finding, FoundValue, Origin, conditions, on_its_own, range};
use crate::config::calibration::keys;
use crate::config::{Calibration, Conditions, Rig};
use crate::fem::lumped::LumpedStiffness;
use crate::ident::{Measured, SweepError, SweepFit, fit_shape, fit_sweep};
use crate::model::{EquilibriumError, Free, Kinematics, Law, Lumped};
use crate::record::{Run, stiffness_sheet};
use crate::units::PASCAL_PER_PSI;

/// Name of the experiment.
pub const NAME: &str = "calibrate stiffness";

/// The staircase in shares of the highest pressure: the whole range, inner loops, the whole range again. What a
/// Maxwell-slip element holds is told by where the loops turn.
const STAIRS: [f64; 49] = [
    0.0, 0.06, 0.11, 0.19, 0.28, 0.38, 0.47, 0.57, 0.66, 0.75, 0.85, 0.94, 1.0, 0.94, 0.89, 0.83, 0.75, 0.66, 0.57,
    0.47, 0.38, 0.28, 0.19, 0.13, 0.08, 0.04, 0.08, 0.15, 0.28, 0.47, 0.66, 0.6, 0.53, 0.42, 0.3, 0.38, 0.49, 0.64,
    0.79, 0.94, 1.0, 0.94, 0.85, 0.72, 0.57, 0.42, 0.26, 0.13, 0.0,
];
/// To get to each, and to stay there, s.
const MOVE: f64 = 0.5;
const HOLD: f64 = 1.5;
/// The highest pressure is where the model expects this share of the soft angle, for it may be wrong ...
const SHARE_OF_ANGLE: f64 = 0.7;
/// ... or this share of the highest pressure that may be commanded, whichever is lower.
const SHARE_OF_PRESSURE: f64 = 0.9;
/// Share by which the effective winding angle may be off the geometry's before the report says so.
const ANGLE_OFF: f64 = 0.05;
/// Variation of kt over the range above which the report says so (the paper: below 1 %).
const VARIATION_MAX: f64 = 0.01;

/// The highest pressure that the FREE `subject` of `rig` may be taken to, Pa.
///
/// # Errors
/// Where its limits leave no room, or the model has no such FREE.
pub fn highest_pressure(rig: &Rig, subject: usize) -> Result<f64, CalibrationError> {
    let free = &rig.control.frees[subject];
    let limits = &free.limits;
    let soft = if free.free.direction() > 0.0 { limits.angle_soft.1 } else { limits.angle_soft.0 };
    let angle = SHARE_OF_ANGLE * soft;
    let range = |reason: String| CalibrationError::Range { free: free.name.clone(), reason };
    if angle * free.free.direction() <= 0.0 {
        return Err(range("its soft angles do not let it turn in its own direction".into()));
    }
    let bound = SHARE_OF_PRESSURE * limits.pressure_max;
    let at_angle = Lumped::new(free.free, Law::Nonlinear(Kinematics::Exact))?.static_pressure(angle);
    let highest = match at_angle {
        Ok(pressure) => pressure.min(bound),
        // The model cannot turn so far at any pressure, or runs away before.
        Err(EquilibriumError::Domain(_)) => bound,
        Err(EquilibriumError::RunsAway { last }) => (SHARE_OF_ANGLE * last.pressure).min(bound),
    };
    if highest < 2.0 * limits.pressure_zero {
        let psi = highest / PASCAL_PER_PSI;
        return Err(range(format!("only {psi:.2} psi are left between its limits, which is hardly a pressure")));
    }
    Ok(highest)
}

/// The experiment for the FREE `subject` of `rig`, as the text of an experiment file.
///
/// # Errors
/// As [`highest_pressure`].
pub fn experiment(rig: &Rig, subject: usize) -> Result<String, CalibrationError> {
    on_its_own(rig, subject)?;
    let highest = highest_pressure(rig, subject)? / PASCAL_PER_PSI;
    let mut text = format!("kind = \"sweep\"\nname = \"{NAME}\"\npressures_psi = [");
    for share in STAIRS {
        // Writing to a String cannot fail.
        let _ = write!(text, "{:.3}, ", share * highest);
    }
    let _ = write!(text, "]\nmove_s = {MOVE:?}\nhold_s = {HOLD:?}\nand_back = false\n");
    Ok(text)
}

/// What `run`, an [`experiment`] with the FREE `subject` of `rig`, says; `date` is today's, `YYYY-MM-DD`.
///
/// # Errors
/// Where the run does not carry a stiffness.
pub fn evaluate(rig: &Rig, subject: usize, run: &Run, date: &str) -> Result<Finding, CalibrationError> {
    let free = &rig.control.frees[subject];
    let points = run.rest_points(subject)?;
    let unfit = |source| match source {
        SweepError::OtherHand(turned) => CalibrationError::Hand {
            free: free.name.clone(),
            run: run.id().to_owned(),
            gamma: free.free.gamma,
            turned,
            pressure: points.iter().map(|p| p.pressure).fold(0.0, f64::max),
        },
        source => CalibrationError::Sweep { run: run.id().to_owned(), source },
    };
    // From the angle that the FREE was wound at, whatever a measurement before has made of it.
    let wound = rig.calibrations[subject].value(&keys::WINDING_ANGLE).unwrap_or(free.free.gamma);
    let wound = Free { gamma: wound, ..free.free };
    let (angle, fit) = match fit_shape(&points, &wound).map_err(unfit)? {
        Some((angle, fit)) => (Some(angle), fit),
        None => (None, fit_sweep(&points, &free.free).map_err(unfit)?),
    };
    let mut calibration = rig.calibrations[subject].clone();
    let method = format!("least squares over {} points at rest of a staircase of pressure", fit.points.len());
    let origin = Origin { run, bench: &rig.bench, subject, date, method: &method, residual: Some(fit.residual) };
    let kt = Measured { value: fit.stiffness, uncertainty: fit.stiffness_uncertainty, freedom: fit.points.len() };
    let prediction = prediction(&calibration);
    let found = origin.enter(&mut calibration, &keys::TORSIONAL_STIFFNESS, kt, prediction);
    calibration.set_conditions(
        &keys::TORSIONAL_STIFFNESS,
        Conditions {
            pressure: range(points.iter().map(|p| p.pressure)),
            angle: range(points.iter().map(|p| p.angle)),
            ..conditions(rig, subject)
        },
    );
    let mut values = vec![found.clone()];
    if let Some(angle) = angle {
        let origin = Origin { method: "the shape of the moment over the angle, with kt and hysteresis", ..origin };
        values.push(origin.enter(&mut calibration, &keys::EFFECTIVE_ANGLE, angle.times(180.0 / PI), None));
    }
    calibration.hysteresis = Some(fit.hysteresis);
    let mut remarks = remarks(&fit);
    if let Some(angle) = angle.filter(|angle| (angle.value / wound.gamma - 1.0).abs() > ANGLE_OFF) {
        remarks.push(format!(
            "it turns as a FREE of {:.2} deg does, and its geometry says {:.2}: the lumped model takes the former, the finite \
             elements the latter; measure the winding angle, the radius and the length again",
            angle.value.to_degrees(),
            wound.gamma.to_degrees()
        ));
    }
    let title = format!("Stiffness and hysteresis of {}", free.name);
    let mut sheet = stiffness_sheet(&title, &fit, run.start().simulated(), facts(&fit, &found, run));
    sheet.remarks.clone_from(&remarks);
    Ok(Finding { calibration, values, remarks, sheet })
}

/// kt that the section's finite elements predict, N m/rad; `None` where the tube is none.
fn prediction(calibration: &Calibration) -> Option<f64> {
    let springs = LumpedStiffness::by_section(&calibration.tube().0, calibration.free().length).ok()?;
    Some(springs.torsional).filter(|kt| kt.is_finite())
}

fn remarks(fit: &SweepFit) -> Vec<String> {
    match fit.variation {
        Some(variation) if variation > VARIATION_MAX => vec![format!(
            "kt varies by {:.1} % over the range of angles, more than 1 %: the FREE is not quite the model's, or the \
             geometry in its calibration is not quite its own",
            100.0 * variation
        )],
        Some(_) => Vec::new(),
        None => vec!["too few points for the stiffness of each third of the range".into()],
    }
}

fn facts(fit: &SweepFit, found: &FoundValue, run: &Run) -> Vec<(String, String)> {
    let mut facts = vec![
        (
            "kt".into(),
            format!("{:.5} +- {:.5} N m/rad (standard uncertainty)", found.value, found.standard_uncertainty),
        ),
        ("before".into(), found.before.map_or("-".into(), |kt| format!("{kt:.5} N m/rad"))),
        ("by finite elements".into(), found.prediction.map_or("-".into(), |kt| format!("{kt:.5} N m/rad"))),
        (
            "variation over the range".into(),
            fit.variation.map_or("-".into(), |v| format!("{:.2} % (the paper: below 1 %)", 100.0 * v)),
        ),
        ("hysteresis".into(), format!("up to {:.2} mN m", 1e3 * fit.hysteresis.saturation())),
        ("left over".into(), format!("{:.3} mN m RMS over {} points", 1e3 * fit.residual, fit.points.len())),
        ("run".into(), run.id().to_owned()),
    ];
    let conditions = "pressure alone; geometry and axial stiffness taken as exact: 1 % in the radius is 3 % in kt";
    facts.push(("conditions".into(), conditions.into()));
    facts
}

//! Zero, span and hysteresis of an analogue regulator behind a DAC or a PWM output: a staircase of codes against a
//! gauge that a person reads.

use std::fmt::Write as _;

use super::stiffness::highest_pressure;
use super::{CalibrationError, Finding, Origin, conditions, range};
use crate::config::calibration::keys;
use crate::config::{Conditions, Rig};
use crate::hardware::mcp4728::code_of;
use crate::hardware::wiring::DacChannel;
use crate::ident::Measured;
use crate::ident::regulator::{Direction, StairPoint, StaircaseFit, StaircaseRules, fit_staircase};
use crate::record::{Run, gauge_sheet};
use crate::units::{PASCAL_PER_PSI, Pressure};

/// Name of the experiment.
pub const NAME: &str = "calibrate regulator";

/// Steps in shares of the highest pressure. Zero is none of them: it is code zero, below the regulator's own.
const STEPS: [f64; 17] =
    [0.06, 0.16, 0.28, 0.4, 0.52, 0.64, 0.76, 0.88, 1.0, 0.88, 0.76, 0.64, 0.52, 0.4, 0.28, 0.16, 0.06];
/// To get to each, to stay there, and the end of that which counts as rest, s.
const MOVE: f64 = 0.5;
const HOLD: f64 = 1.5;
const REST: f64 = 0.5;
/// A span this many times what it was believed to be is a wrong regulator or a wrong full scale.
const SPAN_FACTOR: f64 = 2.0;
/// What a reading by eye allows, as shares of the range: lower on the way down, hysteresis, off the line.
const LEAK: f64 = 0.04;
const HYSTERESIS: f64 = 0.06;
const LINEARITY: f64 = 0.04;
/// A zero below code zero by more than this many standard uncertainties leaves pressure in the FREE.
const CERTAIN: f64 = 3.0;

/// The pressures of the staircase of the FREE `subject` of `rig`, Pa.
///
/// # Errors
/// Where its limits leave no room.
pub fn pressures(rig: &Rig, subject: usize) -> Result<Vec<f64>, CalibrationError> {
    let highest = highest_pressure(rig, subject)?;
    Ok(STEPS.iter().map(|share| share * highest).collect())
}

/// The staircase as the text of an experiment file, for a rig where nobody has to be waited for.
///
/// # Errors
/// As [`pressures`].
pub fn experiment(rig: &Rig, subject: usize) -> Result<String, CalibrationError> {
    let mut text = format!("kind = \"sweep\"\nname = \"{NAME}\"\npressures_psi = [");
    for pressure in pressures(rig, subject)? {
        // Writing to a String cannot fail.
        let _ = write!(text, "{:?}, ", pressure / PASCAL_PER_PSI);
    }
    let _ = write!(text, "]\nmove_s = {MOVE:?}\nhold_s = {HOLD:?}\nand_back = false\n");
    Ok(text)
}

/// From, to: the rest at every step, in the program's time, s.
pub fn spans() -> Vec<(f64, f64)> {
    let end = |i: usize| (i + 1) as f64 * (MOVE + HOLD);
    (0..STEPS.len()).map(|i| (end(i) - REST, end(i))).collect()
}

/// The channel of the FREE `subject`; none where it has another regulator.
pub fn channel(rig: &Rig, subject: usize) -> Option<DacChannel> {
    let dacs = rig.wiring.i2c.iter().flat_map(|bus| &bus.dacs);
    let pwms = rig.wiring.serial.iter().flat_map(|line| &line.pwms).map(|pwm| pwm.channel);
    dacs.flat_map(|dac| dac.channels).flatten().chain(pwms).find(|channel| channel.free == subject)
}

/// What the `readings` (Pa, one at each of [`pressures`]) say of the regulator of the FREE `subject` of `rig`. `run` is
/// where its channel was measured, `map` what was found there; `date` is today's, `YYYY-MM-DD`.
///
/// # Errors
/// Where the readings are not as many as the steps, or the regulator is not sound.
pub fn evaluate(
    rig: &Rig,
    subject: usize,
    readings: &[f64],
    map: &str,
    run: &Run,
    date: &str,
) -> Result<Finding, CalibrationError> {
    let free = &rig.control.frees[subject];
    let pressures = pressures(rig, subject)?;
    if readings.len() != pressures.len() {
        let steps = pressures.iter().map(|p| format!("{:.2}", p / PASCAL_PER_PSI)).collect::<Vec<_>>().join(", ");
        let reason = format!(
            "{} readings of the gauge for {} steps; the steps are, in psi: {steps}",
            readings.len(),
            pressures.len()
        );
        return Err(CalibrationError::Gauge(reason));
    }
    let Some(channel) = channel(rig, subject) else {
        let reason = "its regulator is not behind a DAC".into();
        return Err(CalibrationError::Range { free: free.name.clone(), reason });
    };
    let mut before = f64::NEG_INFINITY;
    let points: Vec<StairPoint> = pressures
        .iter()
        .zip(readings)
        .map(|(&commanded, &pressure)| {
            let direction = if commanded >= before { Direction::Rising } else { Direction::Falling };
            before = commanded;
            StairPoint { command: f64::from(code_of(channel, commanded)), pressure, direction }
        })
        .collect();
    let believed = channel.pascals_per_code;
    let rules = StaircaseRules {
        span: believed / SPAN_FACTOR..=believed * SPAN_FACTOR,
        leak: LEAK,
        hysteresis: HYSTERESIS,
        linearity: LINEARITY,
    };
    let gauge = |error: crate::ident::regulator::StaircaseError| CalibrationError::Gauge(error.to_string());
    let fit = fit_staircase(&points, &rules).map_err(gauge)?;
    let opening = opening(&points, &rules, &fit).map_err(gauge)?;
    if opening.value < -CERTAIN * opening.uncertainty {
        let reason = format!(
            "it would begin to open at code {:.0} +- {:.0}, below zero: at code zero there is pressure in the FREE",
            opening.value, opening.uncertainty
        );
        return Err(CalibrationError::Gauge(reason));
    }
    let opening = Measured { value: opening.value.max(0.0), ..opening };
    let method = format!(
        "line over {} readings of a gauge, up and down; hysteresis {:.3} psi, residual in Pa",
        points.len(),
        fit.hysteresis.value / PASCAL_PER_PSI
    );
    let origin = Origin { run, bench: &rig.bench, subject, date, method: &method, residual: Some(fit.residual) };
    let mut calibration = rig.calibrations[subject].clone();
    let values = vec![
        origin.enter(&mut calibration, &keys::ZERO_CODE, opening, None),
        origin.enter(&mut calibration, &keys::PRESSURE_PER_CODE, fit.span, None),
    ];
    for key in [&keys::ZERO_CODE, &keys::PRESSURE_PER_CODE] {
        let pressure = range(readings.iter().copied());
        calibration
            .set_conditions(key, Conditions { geometry: None, sensor: None, pressure, ..conditions(rig, subject) });
    }
    let remarks = vec!["lag and dead time need a pressure sensor: they stay as the calibration has them".to_owned()];
    let facts = facts(&fit, &opening, map, run);
    let title = format!("Regulator of {}", free.name);
    let mut sheet = gauge_sheet(&title, &points, &fit, run.start().simulated(), facts);
    sheet.remarks.clone_from(&remarks);
    Ok(Finding { calibration, values, remarks, sheet })
}

/// Code at which the regulator begins to open. From there on the line's zero and its span are hardly correlated, so
/// that the zero's uncertainty is the opening's.
fn opening(
    points: &[StairPoint],
    rules: &StaircaseRules,
    fit: &StaircaseFit,
) -> Result<Measured, crate::ident::regulator::StaircaseError> {
    let shifted: Vec<_> = points.iter().map(|p| StairPoint { command: p.command - fit.opening, ..*p }).collect();
    let there = fit_staircase(&shifted, rules)?;
    let floor = fit.floor.map_or(0.0, |floor| floor.uncertainty);
    Ok(Measured { value: fit.opening, uncertainty: there.zero.uncertainty.hypot(floor) / fit.span.value, ..fit.span })
}

fn facts(fit: &StaircaseFit, opening: &Measured, map: &str, run: &Run) -> Vec<(String, String)> {
    let psi = |m: &Measured| format!("{:.4} +- {:.4} psi", m.value / PASCAL_PER_PSI, m.uncertainty / PASCAL_PER_PSI);
    vec![
        ("channels".into(), map.to_owned()),
        ("begins to open at".into(), format!("code {:.1} +- {:.1}", opening.value, opening.uncertainty)),
        ("span".into(), format!("{:.4} +- {:.4} Pa per code", fit.span.value, fit.span.uncertainty)),
        ("lowest pressure".into(), fit.floor.as_ref().map_or("follows the line all the way".into(), psi)),
        ("hysteresis".into(), psi(&fit.hysteresis)),
        ("off the line".into(), format!("at most {:.3}", Pressure::pascals(fit.linearity))),
        ("left over".into(), format!("{:.4} psi RMS over {} codes", fit.residual / PASCAL_PER_PSI, fit.levels)),
        ("run".into(), run.id().to_owned()),
        ("conditions".into(), "with the FREE on the regulator; the gauge is believed".into()),
    ]
}

//! Noise, drift and axis of an IMU: of a FREE that is left alone, then of one that a gentle pressure turns.

use std::f64::consts::PI;

use super::stiffness::highest_pressure;
use super::{CalibrationError, Finding, Origin, hand};
use crate::config::Rig;
use crate::config::calibration::keys;
use crate::control::ImuChannel;
use crate::ident::Measured;
use crate::ident::imu::{AxisFit, StillFit, StillRules, StillSample, Turn, fit_axis, fit_tare, noise_and_drift};
use crate::model::{EquilibriumError, Kinematics, Law, Lumped};
use crate::record::{ImuReading, Run, imu_sheet};
use crate::units::PASCAL_PER_PSI;

/// Name of the experiments.
pub const NAME: &str = "calibrate imu";

/// How long the FREE is left alone, s.
const STILL: f64 = 20.0;
/// To get to the gentle pressure and back, and to stay there, s.
const MOVE: f64 = 2.0;
const HOLD: f64 = 3.0;
/// How far the model expects the FREE to turn, rad.
const TURN: f64 = 0.35;
/// Farthest that the axis may lie from rig.toml's, rad: beyond it, somebody has mounted it otherwise.
const OFF_MAX: f64 = 0.14;
/// Farthest without a remark, rad, and in standard uncertainties.
const OFF_REMARK: (f64, f64) = (0.035, 3.0);
/// Nearer than this the axis is one of the sensor's own, rad.
const SQUARE: f64 = 0.035;

fn channel(rig: &Rig, subject: usize) -> Result<ImuChannel, CalibrationError> {
    let free = &rig.control.frees[subject];
    let reason = || "it has no IMU: describe its sensor in `[free.imu]` of rig.toml".to_owned();
    free.imu.ok_or_else(|| CalibrationError::Range { free: free.name.clone(), reason: reason() })
}

/// The experiment in which the FREE is left alone, as the text of an experiment file.
///
/// # Errors
/// Where it has no IMU.
pub fn still_experiment(rig: &Rig, subject: usize) -> Result<String, CalibrationError> {
    channel(rig, subject)?;
    Ok(format!(
        "kind = \"sweep\"\nname = \"{NAME}: at rest\"\nshape = \"step\"\npressures_psi = [0]\nmove_s = 0.0\nhold_s = \
         {STILL:?}\nand_back = false\n"
    ))
}

/// Noise and drift of the IMU of the FREE `subject` in `run`, a [`still_experiment`]; or why it must not be used.
///
/// # Errors
/// The rule that it breaks, with its value.
pub fn still(rig: &Rig, subject: usize, run: &Run) -> Result<(Vec<ImuReading>, StillFit), CalibrationError> {
    let readings = run.imu_readings(subject, channel(rig, subject)?.axis)?;
    let sample = |r: &ImuReading| StillSample { time: r.time, angle: r.angle, rate: r.rate };
    let samples: Vec<_> = readings.iter().map(sample).collect();
    let fit = noise_and_drift(&samples, &StillRules::default()).map_err(|error| unfit(run, error.to_string()))?;
    Ok((readings, fit))
}

/// The experiment in which a gentle pressure turns the FREE, as the text of an experiment file.
///
/// # Errors
/// Where it cannot be taken to a pressure worth the name.
pub fn turning_experiment(rig: &Rig, subject: usize) -> Result<String, CalibrationError> {
    let free = &rig.control.frees[subject];
    let highest = highest_pressure(rig, subject)?;
    let model = Lumped::new(free.free, Law::Nonlinear(Kinematics::Exact))?;
    let gentle = match model.static_pressure(TURN * free.free.direction()) {
        Ok(pressure) => pressure.min(highest),
        Err(EquilibriumError::Domain(_) | EquilibriumError::RunsAway { .. }) => highest,
    };
    let psi = gentle / PASCAL_PER_PSI;
    Ok(format!(
        "kind = \"sweep\"\nname = \"{NAME}: turning\"\nshape = \"cubic\"\npressures_psi = [0, {psi:.3}, 0]\nmove_s = \
         {MOVE:?}\nhold_s = {HOLD:?}\nand_back = false\n"
    ))
}

/// What both runs say; `date` is today's, `YYYY-MM-DD`. The sensor's profile is not in it: it is read from a disarmed
/// rig.
///
/// # Errors
/// Where the FREE did not turn about one axis, or about another than rig.toml has.
pub fn evaluate(
    rig: &Rig,
    subject: usize,
    (still_run, turning): (&Run, &Run),
    date: &str,
) -> Result<Finding, CalibrationError> {
    let free = &rig.control.frees[subject];
    let configured = channel(rig, subject)?.axis;
    let (still_readings, still) = still(rig, subject, still_run)?;
    let readings = turning.imu_readings(subject, configured)?;
    let at_rest: Vec<_> = readings.iter().filter(|r| r.time < MOVE + HOLD - 0.1).map(|r| r.quaternion).collect();
    let tare = fit_tare(&at_rest).map_err(|error| unfit(turning, error.to_string()))?;
    let orientations: Vec<_> = readings.iter().map(|r| r.quaternion).collect();
    let own = if free.free.direction() > 0.0 { Turn::Positive } else { Turn::Negative };
    let axis = fit_axis(&tare, &orientations, own).map_err(|error| unfit(turning, error.to_string()))?;
    let off = configured.iter().zip(axis.axis).map(|(a, b)| a * b).sum::<f64>().clamp(-1.0, 1.0).acos();
    if off > OFF_MAX {
        let mut remedy = line(&free.name, &axis);
        if off > PI - OFF_MAX {
            // Upside down and of the other hand look the same from here.
            remedy += &format!(
                " if the sensor sits that way round; if not, `{}` is of the other hand than its winding angle of {:.1} deg \
                 says, {}: correct the sign of winding_angle_deg in its calibration",
                free.name,
                free.free.gamma.to_degrees(),
                hand(free.free.gamma)
            );
        }
        return Err(CalibrationError::Axis { free: free.name.clone(), off, found: axis.axis, configured, remedy });
    }

    let mut calibration = rig.calibrations[subject].clone();
    let count = still.readings as f64;
    // A standard deviation of n values is known to 1 / sqrt(2 n) of itself.
    let spread =
        |noise: f64| Measured { value: noise, uncertainty: noise / (2.0 * count).sqrt(), freedom: still.readings };
    let per = 1f64.to_degrees();
    let method = format!("differences of {} readings at rest", still.readings);
    let origin = Origin { run: still_run, bench: &rig.bench, subject, date, method: &method, residual: None };
    let values = vec![
        origin.enter(&mut calibration, &keys::IMU_NOISE, spread(still.noise).times(per), None),
        origin.enter(&mut calibration, &keys::IMU_DRIFT, still.drift.times(per), None),
        origin.enter(&mut calibration, &keys::IMU_RATE_NOISE, spread(still.rate_noise).times(per), None),
    ];
    let mut remarks = Vec::new();
    if off > OFF_REMARK.0.max(OFF_REMARK.1 * axis.uncertainty) {
        remarks.push(format!(
            "the axis is {:.1} deg off rig.toml's: {}; as it is, turns read {:.2} % too small",
            off.to_degrees(),
            line(&free.name, &axis),
            100.0 * (1.0 - off.cos())
        ));
    }
    let delay = "the sensor's delay cannot be seen from its own readings: `delay_ms` stays as it is";
    remarks.push(delay.to_owned());
    let mut facts = facts(&still, &axis, off);
    facts.push(("tare".into(), format!("+- {:.4} deg over {} readings", tare.uncertainty.to_degrees(), tare.readings)));
    facts.push(("runs".into(), format!("{}, {}", still_run.id(), turning.id())));
    let title = format!("IMU of {}", free.name);
    let simulated = turning.start().simulated();
    let mut sheet = imu_sheet(&title, (&still_readings, &still), (&readings, &axis), simulated, facts);
    sheet.remarks.clone_from(&remarks);
    Ok(Finding { calibration, values, remarks, sheet })
}

fn unfit(run: &Run, reason: String) -> CalibrationError {
    CalibrationError::Imu { run: run.id().to_owned(), reason }
}

/// The line that rig.toml should have.
fn line(free: &str, axis: &AxisFit) -> String {
    let text = if axis.misalignment < SQUARE.max(3.0 * axis.uncertainty) {
        let one = if axis.along { "1" } else { "-1" };
        let mut words = ["0"; 3];
        words[axis.nearest] = one;
        words.join(", ")
    } else {
        axis.axis.map(|x| format!("{x:.5}")).join(", ")
    };
    format!("write `axis = [{text}]` in `[free.imu]` of `{free}` in rig.toml")
}

fn facts(still: &StillFit, axis: &AxisFit, off: f64) -> Vec<(String, String)> {
    let degrees = f64::to_degrees;
    vec![
        ("noise of the angle".into(), format!("{:.4} deg a reading, quantisation included", degrees(still.noise))),
        ("quantum".into(), still.quantum.map_or("not seen".into(), |q| format!("{:.5} deg", degrees(q)))),
        (
            "drift".into(),
            format!(
                "{:.4} +- {:.4} deg/min",
                60.0 * degrees(still.drift.value),
                60.0 * degrees(still.drift.uncertainty)
            ),
        ),
        ("random walk".into(), format!("{:.4} deg per square root of a second", degrees(still.walk))),
        (
            "gyro".into(),
            format!(
                "noise {:.3} deg/s, mean {:.4} +- {:.4} deg/s",
                degrees(still.rate_noise),
                degrees(still.rate_bias.value),
                degrees(still.rate_bias.uncertainty)
            ),
        ),
        (
            "readings".into(),
            format!(
                "every {:.3} ms, jitter {:.3} ms, {} of {} missing, longest gap {:.1} ms",
                1e3 * still.period,
                1e3 * still.jitter,
                still.missing,
                still.readings + still.missing,
                1e3 * still.longest_gap
            ),
        ),
        (
            "axis".into(),
            format!(
                "[{}] in the sensor's frame, +- {:.3} deg; {:.2} deg off rig.toml's",
                axis.axis.map(|x| format!("{x:.4}")).join(", "),
                degrees(axis.uncertainty),
                degrees(off)
            ),
        ),
        (
            "turned".into(),
            format!("{:.1} deg, {:.2} % of it across the axis", degrees(axis.movement), 100.0 * axis.share),
        ),
    ]
}

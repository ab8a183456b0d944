//! Zero, span, hysteresis, lag, dead time and slew of a regulator by steps of pressure, up and down.

use std::fmt::Write as _;

use super::stiffness::highest_pressure;
use super::{CalibrationError, Finding, Origin, conditions, range};
use crate::config::calibration::keys;
use crate::config::{Conditions, Rig};
use crate::ident::Measured;
use crate::ident::regulator::{
    Direction, Reading, StairPoint, StaircaseFit, StaircaseRules, StepsFit, fit_staircase, fit_steps,
};
use crate::record::{RegulatorRecord, Run, regulator_sheet};
use crate::units::PASCAL_PER_PSI;

/// Name of the experiment.
pub const NAME: &str = "calibrate regulator";

/// Steps in shares of the highest pressure: a staircase up and down, then large ones, which reach the slew limit.
const STEPS: [f64; 22] = [
    0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0, 0.875, 0.75, 0.625, 0.5, 0.375, 0.25, 0.125, 0.0, 0.9, 0.1,
    1.0, 0.3, 0.0,
];
/// How many of them are the staircase.
const STAIRS: usize = 17;
/// Time at each, s.
const HOLD: f64 = 1.2;
/// Of that, the end that counts as settled, s.
const SETTLED: f64 = 0.4;

/// The experiment for the regulator of the FREE `subject` of `rig`, as the text of an experiment file.
///
/// # Errors
/// Where the FREE cannot be taken to a pressure worth the name.
pub fn experiment(rig: &Rig, subject: usize) -> Result<String, CalibrationError> {
    let free = &rig.control.frees[subject];
    if !free.regulator.measures {
        let reason = "its regulator does not measure the pressure, and nothing else does".into();
        return Err(CalibrationError::Range { free: free.name.clone(), reason });
    }
    let highest = highest_pressure(rig, subject)? / PASCAL_PER_PSI;
    let mut text = format!("kind = \"sweep\"\nname = \"{NAME}\"\nshape = \"step\"\npressures_psi = [");
    for share in STEPS {
        // Writing to a String cannot fail.
        let _ = write!(text, "{:.3}, ", share * highest);
    }
    let _ = write!(text, "]\nhold_s = {HOLD:?}\nand_back = false\n");
    Ok(text)
}

/// What `run`, an [`experiment`] with the FREE `subject` of `rig`, says; `date` is today's, `YYYY-MM-DD`.
///
/// # Errors
/// Where the run does not carry the regulator's dynamics, or the regulator is not sound.
pub fn evaluate(rig: &Rig, subject: usize, run: &Run, date: &str) -> Result<Finding, CalibrationError> {
    let free = &rig.control.frees[subject];
    let record = run.regulator_record(subject)?;
    let unfit = |reason: String| CalibrationError::Regulator { run: run.id().to_owned(), reason };
    let steps = fit_steps(&record.commands, &record.readings).map_err(|e| unfit(e.to_string()))?;
    let stairs = stairs(&record);
    let staircase = fit_staircase(&stairs, &StaircaseRules::default()).map_err(|e| unfit(e.to_string()))?;

    let method = "least squares over steps of pressure: dead time, lag and slew limit";
    let origin = Origin { run, bench: &rig.bench, subject, date, method, residual: Some(steps.residual) };
    let mut calibration = rig.calibrations[subject].clone();
    // A command waits for the bus' next look, is held until the device's next turn, and travels along the line, as the
    // reading does on its way back: all of that is known, and not the regulator's.
    let tick = rig.control.period.as_secs_f64();
    let held = 0.5 * (free.regulator.period.as_secs_f64() - tick).max(0.0);
    let way = tick + held + rig.transport(subject) + rig.reply(subject);
    let dead_time = Measured { value: (steps.dead_time.value - way).max(0.0), ..steps.dead_time };
    let mut values = vec![
        origin.enter(&mut calibration, &keys::REGULATOR_LAG, steps.lag.times(1e3), None),
        origin.enter(&mut calibration, &keys::REGULATOR_DEAD_TIME, dead_time.times(1e3), None),
    ];
    let mut remarks = Vec::new();
    // The rise alone: the interlocks grow a stale pressure by it, and a regulator that empties more slowly fills no
    // less.
    match steps.rise {
        Some(rise) => {
            values.push(origin.enter(&mut calibration, &keys::FASTEST_FILL, rise.times(1.0 / PASCAL_PER_PSI), None))
        }
        None => remarks.push(
            "no step up reached a slew limit of the regulator's own: it is at least as fast as `slew_psi_per_s` in \
             rig.toml lets the commands be, and what stood for its fastest fill stays"
                .to_owned(),
        ),
    }
    for key in [&keys::REGULATOR_LAG, &keys::REGULATOR_DEAD_TIME] {
        let pressure = range(stairs.iter().map(|p| p.pressure));
        calibration
            .set_conditions(key, Conditions { geometry: None, sensor: None, pressure, ..conditions(rig, subject) });
    }
    let title = format!("Regulator of {}", free.name);
    let mut sheet =
        regulator_sheet(&title, &record, &steps, run.start().simulated(), facts(&steps, &staircase, way, run));
    sheet.remarks.clone_from(&remarks);
    Ok(Finding { calibration, values, remarks, sheet })
}

/// The settled ends of the staircase's steps.
fn stairs(record: &RegulatorRecord) -> Vec<StairPoint> {
    let mut before = f64::NEG_INFINITY;
    let mut points = Vec::new();
    for &(from, to, command) in record.holds.iter().take(STAIRS) {
        let late = |r: &&Reading| r.time > (to - SETTLED).max(from) && r.time <= to;
        let (sum, count) =
            record.readings.iter().filter(late).fold((0.0, 0.0), |(sum, n), r| (sum + r.pressure, n + 1.0));
        if count > 0.0 {
            let direction = if command >= before { Direction::Rising } else { Direction::Falling };
            points.push(StairPoint { command, pressure: sum / count, direction });
        }
        before = command;
    }
    points
}

fn facts(steps: &StepsFit, stairs: &StaircaseFit, way: f64, run: &Run) -> Vec<(String, String)> {
    let ms = |m: &Measured| format!("{:.1} +- {:.1} ms", 1e3 * m.value, 1e3 * m.uncertainty);
    let psi = |pa: f64| pa / PASCAL_PER_PSI;
    let slew = |m: Option<Measured>| m.map_or("not reached".into(), |m| format!("{:.1} psi/s", psi(m.value)));
    vec![
        ("lag".into(), ms(&steps.lag)),
        (
            "dead time".into(),
            format!(
                "{} from the command to the reading; {:.1} ms of it are the way to the device and back",
                ms(&steps.dead_time),
                1e3 * way
            ),
        ),
        ("fastest rise, fall".into(), format!("{}, {}", slew(steps.rise), slew(steps.fall))),
        ("zero".into(), format!("{:.4} +- {:.4} psi", psi(stairs.zero.value), psi(stairs.zero.uncertainty))),
        ("span".into(), format!("{:.5} +- {:.5}", stairs.span.value, stairs.span.uncertainty)),
        ("hysteresis".into(), format!("{:.4} psi", psi(stairs.hysteresis.value))),
        ("off the line".into(), format!("at most {:.4} psi", psi(stairs.linearity))),
        ("left over".into(), format!("{:.4} psi RMS over {} readings", psi(steps.residual), steps.fitted.len())),
        ("run".into(), run.id().to_owned()),
        ("conditions".into(), "with the FREE on the regulator: its volume is in the lag".into()),
    ]
}

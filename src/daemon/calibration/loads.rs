//! ke by known weights and kt by known torques, at one or several pressures.
//!
//! Loads go on one after another, up and down, and what is read under each is a length or an angle at rest. A
//! [`Session`] is the order of it as a program of pressures: the whole range up and down first, so that every element
//! of the hysteresis is known, then each load in its time; where load and pressure change together the load goes first.
//! The readings are fitted by [`crate::ident::loads`].
//!
//! A stiffness by known loads does not know the fibres' radius: that is where it is better than one by steps of
//! pressure, which is off by three times what the radius is off by.

use std::fmt::Write as _;

use super::stiffness::highest_pressure;
use super::{CalibrationError, Finding, FoundValue, Origin, conditions, range};
use crate::config::calibration::{Calibration, keys};
use crate::config::{Conditions, KnownLoad, Rig};
use crate::fem::lumped::LumpedStiffness;
use crate::ident::{LoadFit, LoadPoint, Measured, fit_loads};
use crate::model::{Free, GRAVITY, HysteresisState, Kinematics, Law, Load, Lumped};
use crate::record::{LoadsDrawing, Run, draw_loads};
use crate::units::{Angle, PASCAL_PER_PSI, Pressure};

/// Name of the experiment.
pub const NAME: &str = "calibrate stiffness by loads";

/// To get to a pressure, s.
const MOVE: f64 = 1.0;
/// To stay there, s; of that, the end counts as rest.
const HOLD: f64 = 1.6;
const REST: f64 = 0.8;
/// Pressures closer than this are one.
const SAME: f64 = 0.01 * PASCAL_PER_PSI;
/// Fewest pressures over which a stiffness is said to vary or not.
const PRESSURES_MIN: usize = 3;
/// The paper's claim: ke and kt vary by less than this over the pressure.
const VARIATION_MAX: f64 = 0.01;
/// Rounds for the extension at a given angle: each gains more than a digit.
const ROUNDS: usize = 40;

/// What is hung or turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sort {
    /// A weight; a length is read.
    Weight,
    /// A torque; an angle is read.
    Torque,
}

/// One state of the rig in a session.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Force of the weights, N.
    pub force: f64,
    /// Torque, N m.
    pub moment: f64,
    /// Pressure, Pa.
    pub pressure: f64,
    /// Which load is read here; none where it is on the way only.
    pub reads: Option<(Sort, usize)>,
    /// When it begins in the program, s.
    pub from: f64,
    /// When it ends, s.
    pub until: f64,
}

impl Step {
    /// From, to: when the FREE has come to rest.
    pub fn rest(&self) -> (f64, f64) {
        (self.until - REST, self.until)
    }
}

/// The order of weights and torques.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Session {
    /// What is done, in its order.
    pub steps: Vec<Step>,
}

/// What was read under one load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Length (m) or angle (rad).
    pub value: f64,
    /// Measured pressure, Pa; what was commanded where it is not measured.
    pub pressure: f64,
    /// Angle, rad; not a number where it was not measured.
    pub angle: f64,
}

impl Session {
    /// The session for the `weights` and `torques` on the FREE `subject` of `rig`.
    ///
    /// # Errors
    /// Where a load or a pressure would take the FREE beyond its limits.
    pub fn plan(
        rig: &Rig,
        subject: usize,
        weights: &[KnownLoad],
        torques: &[KnownLoad],
    ) -> Result<Self, CalibrationError> {
        let highest = highest_pressure(rig, subject)?;
        let free = &rig.control.frees[subject];
        let range = |reason: String| CalibrationError::Range { free: free.name.clone(), reason };
        let model = Lumped::new(free.free, Law::Nonlinear(Kinematics::Exact))?;
        let mut session = Self::default();
        for pressure in [0.0, highest, 0.0] {
            session.push(0.0, 0.0, pressure, None);
        }
        let sorts = [(Sort::Weight, weights), (Sort::Torque, torques)];
        for (sort, index, load) in
            sorts.into_iter().flat_map(|(sort, all)| all.iter().enumerate().map(move |(i, l)| (sort, i, l)))
        {
            let pressure = load.pressure;
            if pressure > highest * (1.0 + 1e-9) {
                let (asked, highest) = (Pressure::pascals(pressure), Pressure::pascals(highest));
                return Err(range(format!(
                    "a load at {asked:.2} is beyond {highest:.2}, to which its limits let it be taken"
                )));
            }
            let (force, moment) = match sort {
                Sort::Weight => (GRAVITY * load.amount, 0.0),
                Sort::Torque => (0.0, load.amount),
            };
            let at = model.equilibrium_at_pressure(pressure, Load { force, moment })?.rotation;
            let (low, high) = free.limits.angle_soft;
            if !(low..=high).contains(&at) {
                let [at, low, high] = [at, low, high].map(Angle::radians);
                let (moment, pressure) = (1e3 * moment, Pressure::pascals(pressure));
                return Err(range(format!(
                    "{moment:.1} mN m at {pressure:.2} would turn it to {at:.0}, beyond {low:.0} to {high:.0}"
                )));
            }
            session.push(force, moment, pressure, Some((sort, index)));
        }
        session.push(0.0, 0.0, 0.0, None);
        Ok(session)
    }

    fn push(&mut self, force: f64, moment: f64, pressure: f64, reads: Option<(Sort, usize)>) {
        let last = self.steps.last().copied();
        if let Some(last) = last
            .filter(|last| (last.pressure - pressure).abs() > SAME && (last.force != force || last.moment != moment))
        {
            self.push(force, moment, last.pressure, None);
        }
        let from = self.steps.last().map_or(0.0, |last| last.until);
        self.steps.push(Step { force, moment, pressure, reads, from, until: from + MOVE + HOLD });
    }

    /// Its pressures as the text of an experiment file.
    pub fn experiment(&self) -> String {
        let mut text = format!("kind = \"sweep\"\nname = \"{NAME}\"\nsegments = [\n");
        for step in &self.steps {
            let psi = step.pressure / PASCAL_PER_PSI;
            // Writing to a String cannot fail.
            let _ = writeln!(text, "    {{ to_psi = {psi:?}, shape = \"linear\", duration_s = {MOVE:?} }},");
            let _ = writeln!(text, "    {{ hold_s = {HOLD:?} }},");
        }
        text.push_str("]\n");
        text
    }

    /// What was read under the `weights` and `torques` that the session was planned for: at every step, what a person
    /// read (not a number where nothing is), and angle and pressure at rest.
    pub fn readings(&self, weights: &[KnownLoad], torques: &[KnownLoad], taken: &[(f64, f64, f64)]) -> Readings {
        let mut readings = Readings::default();
        for (step, &(read, angle, measured)) in self.steps.iter().zip(taken) {
            let pressure = if measured.is_finite() { measured } else { step.pressure };
            let mut torque = None;
            match step.reads {
                Some((Sort::Weight, i)) => {
                    readings.weights.push((weights[i], Reading { value: read, pressure, angle }))
                }
                Some((Sort::Torque, i)) => {
                    torque = Some(readings.torques.len());
                    let value = if angle.is_finite() { angle } else { read };
                    readings.torques.push((torques[i], Reading { value, pressure, angle: value }));
                    readings.path.push((value, torque));
                }
                None => {}
            }
            if torque.is_none() && angle.is_finite() {
                readings.path.push((angle, None));
            }
        }
        readings
    }

    /// The step of the program's time `now`, s.
    pub fn at(&self, now: f64) -> Option<&Step> {
        self.steps.iter().find(|step| now >= step.from && now < step.until)
    }
}

/// What was read in a session, by sort of load, and the angles on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Readings {
    /// The weights and what was read under each.
    pub weights: Vec<(KnownLoad, Reading)>,
    /// The torques and what was read under each.
    pub torques: Vec<(KnownLoad, Reading)>,
    /// Angles at rest in their order (rad), and which torque each is of: what the hysteresis remembers.
    pub path: Vec<(f64, Option<usize>)>,
}

impl Readings {
    /// Those that stand in a script: nothing was measured beside them.
    pub fn written(weights: &[KnownLoad], torques: &[KnownLoad]) -> Self {
        let all = |loads: &[KnownLoad]| -> Vec<_> {
            let reading = |load: &KnownLoad| {
                let value = load.reading?;
                Some((*load, Reading { value, pressure: load.pressure, angle: f64::NAN }))
            };
            loads.iter().filter_map(reading).collect()
        };
        let torques = all(torques);
        let path = torques.iter().enumerate().map(|(i, (_, reading))| (reading.value, Some(i))).collect();
        Self { weights: all(weights), torques, path }
    }
}

/// Adds to `finding`, the one of the staircase, what the known loads say: ke goes into the calibration, kt by torques
/// stands beside that of the staircase. `run` is where the readings come from, `date` is today's, `YYYY-MM-DD`.
///
/// # Errors
/// Where the readings do not carry a stiffness.
pub fn evaluate(
    finding: &mut Finding,
    readings: &Readings,
    rig: &Rig,
    subject: usize,
    run: &Run,
    date: &str,
) -> Result<(), CalibrationError> {
    let refused = |sort: &str, error: &dyn std::fmt::Display| CalibrationError::Loads(format!("{sort}: {error}"));
    let section = section(&finding.calibration);
    if !readings.weights.is_empty() {
        let points = weight_points(&finding.calibration, &readings.weights)?;
        let fit = fit_loads(&points).map_err(|error| refused("the weights", &error))?;
        let method = format!("least squares over {} known weights, loading and unloading", points.len());
        let origin = Origin { run, bench: &rig.bench, subject, date, method: &method, residual: Some(fit.residual) };
        let prediction = section.map(|s| s.0);
        let found = origin.enter(&mut finding.calibration, &keys::AXIAL_STIFFNESS, fit.stiffness, prediction);
        finding.values.push(found);
        let pressure = range(points.iter().map(|p| p.pressure));
        let conditions = Conditions { pressure, ..conditions(rig, subject) };
        finding.calibration.set_conditions(&keys::AXIAL_STIFFNESS, conditions);
        tell("ke", &fit, ("N/m", 1.0), ("mm", 1e3), &mut finding.remarks, &mut finding.sheet.facts);
        let drawing = LoadsDrawing {
            caption: "Known weights",
            load: ("force on the spring (N)", 1.0),
            reading: ("length (mm)", 1e3),
        };
        draw_loads(&mut finding.sheet, &drawing, &points, &fit);
    }
    if !readings.torques.is_empty() {
        let own = rig.control.frees[subject].free.direction();
        let limits = &rig.control.frees[subject].limits;
        let top = if own > 0.0 { limits.angle_soft.1 } else { -limits.angle_soft.0 };
        let points = torque_points(&finding.calibration, readings, top)?;
        let fit = fit_loads(&points).map_err(|error| refused("the torques", &error))?;
        let staircase = finding.values.iter().find(|v| v.key == keys::TORSIONAL_STIFFNESS.name).map(|v| v.value);
        finding.values.push(FoundValue {
            key: "torsional_stiffness_by_torques_nm_per_rad",
            before: None,
            value: fit.stiffness.value,
            standard_uncertainty: fit.stiffness.uncertainty,
            prediction: section.map(|s| s.1),
        });
        tell(
            "kt by known torques",
            &fit,
            ("N m/rad", 1.0),
            ("deg", 180.0 / std::f64::consts::PI),
            &mut finding.remarks,
            &mut finding.sheet.facts,
        );
        if let Some(staircase) = staircase {
            finding.remarks.push(beside(&fit.stiffness, staircase, finding.calibration.free().radius));
        }
        let drawing = LoadsDrawing {
            caption: "Known torques",
            load: ("moment on the spring (mN m)", 1e3),
            reading: ("angle (deg)", 180.0 / std::f64::consts::PI),
        };
        draw_loads(&mut finding.sheet, &drawing, &points, &fit);
    }
    finding.sheet.remarks.clone_from(&finding.remarks);
    Ok(())
}

/// ke and kt that the section's finite elements predict; `None` where the tube is none.
fn section(calibration: &Calibration) -> Option<(f64, f64)> {
    let lumped = LumpedStiffness::by_section(&calibration.tube().0, calibration.free().length).ok()?;
    (lumped.axial.is_finite() && lumped.torsional.is_finite()).then_some((lumped.axial, lumped.torsional))
}

/// kt by torques and by steps of pressure, and what explains their difference.
fn beside(torques: &Measured, staircase: f64, radius: f64) -> String {
    let ratio = staircase / torques.value;
    let radius = 1e3 * radius;
    format!(
        "kt is {:.5} +- {:.5} N m/rad by known torques and {staircase:.5} by steps of pressure, {:+.1} %: torques do not \
         know the fibres' radius, steps of pressure are off by three times what it is off by. A fibre radius of {:.3} mm \
         in place of {radius:.3} mm would explain it. The calibration keeps the one of the steps, which goes with its \
         radius: the controller needs their ratio",
        torques.value,
        torques.uncertainty,
        100.0 * (ratio - 1.0),
        radius * ratio.powf(-1.0 / 3.0)
    )
}

/// What a fit says, as facts and, where it is more or less than was hoped for, as a remark.
fn tell(
    name: &str,
    fit: &LoadFit,
    (unit, per): (&str, f64),
    (read, scale): (&str, f64),
    remarks: &mut Vec<String>,
    facts: &mut Vec<(String, String)>,
) {
    let value = |m: &Measured| format!("{:.5} +- {:.5} {unit}", per * m.value, per * m.uncertainty);
    let mut fact = |what: &str, text: String| facts.push((format!("{name}{what}"), text));
    fact("", format!("{} (standard uncertainty)", value(&fit.stiffness)));
    for (pressure, own) in &fit.own {
        fact(&format!(" at {:.2}", Pressure::pascals(*pressure)), value(own));
    }
    if let Some(factor) = &fit.actuation_factor {
        fact(
            ": effect of the pressure",
            format!("{:.4} +- {:.4} of what the geometry says", factor.value, factor.uncertainty),
        );
    }
    fact(
        ": hysteresis left",
        format!("{:.3} +- {:.3} {read}", 2.0 * scale * fit.hysteresis.value, 2.0 * scale * fit.hysteresis.uncertainty),
    );
    fact(": left over", format!("{:.3} {read} RMS over {} readings", scale * fit.residual, fit.fitted.len()));
    let claim = match fit.variation {
        Some(v) if fit.own.len() >= PRESSURES_MIN => {
            let text = format!(
                "{name} varies by {:.2} +- {:.2} % over {} pressures",
                100.0 * v.value,
                100.0 * v.uncertainty,
                fit.own.len()
            );
            let (low, high) = v.interval();
            if high < VARIATION_MAX {
                fact(" over pressure", format!("{text}: below 1 %, as the paper has it"));
                return;
            } else if low > VARIATION_MAX {
                format!(
                    "{text}: more than the paper's 1 %; the FREE is not quite the model's, or the geometry in its calibration is not quite its own"
                )
            } else {
                format!("{text}: the readings cannot tell it from the paper's 1 %; larger loads or more readings could")
            }
        }
        _ => format!(
            "{name} was measured at {} pressures: whether it varies with the pressure needs {PRESSURES_MIN}, five readings at each",
            fit.own.len()
        ),
    };
    fact(" over pressure", claim.clone());
    remarks.push(claim);
}

/// The numbers of the pressures, those that are one taken together.
fn groups(loads: impl Iterator<Item = f64>) -> Vec<usize> {
    let mut known: Vec<f64> = Vec::new();
    let number = |pressure: f64| match known.iter().position(|p| (p - pressure).abs() <= SAME) {
        Some(number) => number,
        None => {
            known.push(pressure);
            known.len() - 1
        }
    };
    loads.map(number).collect()
}

fn weight_points(
    calibration: &Calibration,
    weights: &[(KnownLoad, Reading)],
) -> Result<Vec<LoadPoint>, CalibrationError> {
    let free = calibration.free();
    let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact))?;
    let groups = groups(weights.iter().map(|(load, _)| load.pressure));
    let least = |a: &&(KnownLoad, Reading), b: &&(KnownLoad, Reading)| {
        (a.0.pressure + a.0.amount).total_cmp(&(b.0.pressure + b.0.amount))
    };
    let Some((first, reading)) = weights.iter().min_by(least) else { return Ok(Vec::new()) };
    // Extensions count from where the model has the lightest load; a ruler's zero is anywhere.
    let load = Load { force: GRAVITY * first.amount, moment: 0.0 };
    let begin = model.equilibrium_at_pressure(reading.pressure, load)?.extension - reading.value;
    let point = |((load, reading), group): (&(KnownLoad, Reading), usize)| -> Result<LoadPoint, CalibrationError> {
        let force = GRAVITY * load.amount;
        let angle = match reading.angle {
            angle if angle.is_finite() => angle,
            _ => model.equilibrium_at_pressure(reading.pressure, Load { force, moment: 0.0 })?.rotation,
        };
        let actuation =
            model.actuation(begin + reading.value, angle).map_err(crate::model::EquilibriumError::from)?.force;
        Ok(LoadPoint {
            load: force,
            deflection: reading.value,
            group,
            pressure: reading.pressure,
            actuation,
            hysteresis: 0.0,
        })
    };
    weights.iter().zip(groups).map(point).collect()
}

fn torque_points(calibration: &Calibration, readings: &Readings, top: f64) -> Result<Vec<LoadPoint>, CalibrationError> {
    let free = calibration.free();
    let own = free.direction();
    let hysteresis = calibration.hysteresis.unwrap_or_default();
    let mut state = HysteresisState::default();
    // Before it was measured it has been under pressure, farther than any element reaches.
    hysteresis.advance(&mut state, top);
    let mut borne = vec![0.0; readings.torques.len()];
    for (angle, torque) in &readings.path {
        hysteresis.advance(&mut state, own * angle);
        if let Some(borne) = torque.and_then(|i| borne.get_mut(i)) {
            *borne = own * hysteresis.moment(&state, own * angle);
        }
    }
    let groups = groups(readings.torques.iter().map(|(load, _)| load.pressure));
    let point = |(((load, reading), group), hysteresis): ((&(KnownLoad, Reading), usize), f64)| -> Result<LoadPoint, CalibrationError> {
        let actuation = moment_at(&free, reading.pressure, reading.value)?;
        Ok(LoadPoint { load: load.amount, deflection: reading.value, group, pressure: reading.pressure, actuation, hysteresis })
    };
    readings.torques.iter().zip(groups).zip(borne).map(point).collect()
}

/// Moment per pressure at an angle, the extension being in balance.
fn moment_at(free: &Free, pressure: f64, angle: f64) -> Result<f64, CalibrationError> {
    let mut extension = free.mass * GRAVITY / free.axial_stiffness;
    let mut at = Kinematics::Exact.actuation(free, extension, angle).map_err(crate::model::EquilibriumError::from)?;
    for _ in 0..ROUNDS {
        extension = (free.mass * GRAVITY + at.force * pressure) / free.axial_stiffness;
        at = Kinematics::Exact.actuation(free, extension, angle).map_err(crate::model::EquilibriumError::from)?;
    }
    Ok(at.moment)
}

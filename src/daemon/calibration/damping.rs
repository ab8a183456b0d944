//! Torsional damping, and inertia where one has been added, by plucks: a person turns the end, holds it, lets it go.

use std::f64::consts::TAU;

use super::{CalibrationError, Finding, FoundValue, Origin, on_its_own};
use crate::config::calibration::{Key, keys};
use crate::config::{Calibration, Rig};
use crate::ident::pluck::{
    Loaded, PluckError, PluckFit, Reading, Regime, Release, Rules, evened, fit_plucks, releases, torsion_of_series,
};
use crate::ident::ringdown::Torsion;
use crate::ident::{Measured, RingDownError};
use crate::record::{Run, damping_sheet};
use crate::sim::{BenchConfig, Hand};

/// Name of the experiment.
pub const NAME: &str = "calibrate damping";

/// The fusion output is trusted up to here, Hz: gyro bandwidth 32 Hz, 100 readings a second.
const BANDWIDTH: f64 = 20.0;
/// First release, from one to the next, how many, and the rest after the last, s.
const FIRST: f64 = 4.0;
const EVERY: f64 = 5.0;
const PLUCKS: u32 = 6;
/// The end is turned by this much, rad, ...
const TURN: f64 = 0.7;
/// ... by this share of the soft angle, ...
const SHARE_OF_ANGLE: f64 = 0.4;
/// ... or so far that it comes back at this rate, rad/s, whichever is least: the gyro ends at 34.9.
const RATE: f64 = 20.0;
/// Least turn worth the name, rad: of it the fusion's noise is a seventieth.
const TURN_MIN: f64 = 0.06;
/// An inertia that is known worse than this is none.
const UNSURE: f64 = 0.3;
/// Friction above this share of the turn is said.
const SLIP_REMARK: f64 = 0.01;

/// What is to be done: the experiment, as the text of an experiment file, and the hand's part in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The experiment: zero pressure.
    pub experiment: String,
    /// What the hand does.
    pub hand: Hand,
}

impl Plan {
    /// What a person is told at which time since the start, s.
    pub fn cues(&self) -> Vec<(f64, String)> {
        let angle = self.hand.angle_rad.to_degrees();
        let turn = |(n, release): (usize, &f64)| {
            let side = if n % 2 == 0 { "one" } else { "the other" };
            let text =
                format!("turn the end to {side} side by about {angle:.0} deg, without bending it, and hold it ...");
            [(release - Hand::BEFORE, text), (*release, "... let go, at once!".to_owned())]
        };
        self.hand.releases_s.iter().enumerate().flat_map(turn).collect()
    }

    /// What a person has to know before.
    pub fn instruction(&self) -> String {
        let added = self.hand.added_inertia_kg_m2;
        let carries = match added > 0.0 {
            true => format!("The inertia of {added:e} kg m2 is fixed to the FREE's end, centred on its axis."),
            false => "Nothing but its IMU is on the FREE's end.".to_owned(),
        };
        format!(
            "{carries} There is no pressure. Every {EVERY:.0} s you will turn the end by hand by about {:.0} deg, hold it \
             for a second, and let it go at once, {} times; you will be told when.",
            self.hand.angle_rad.to_degrees(),
            self.hand.releases_s.len()
        )
    }
}

/// What is to be done with the FREE `subject` of `rig`, its end carrying `added` kg m2 more.
///
/// # Errors
/// Where it has no IMU, or may hardly be turned.
pub fn plan(rig: &Rig, subject: usize, added: f64) -> Result<Plan, CalibrationError> {
    on_its_own(rig, subject)?;
    let control = &rig.control.frees[subject];
    let range = |reason: String| CalibrationError::Range { free: control.name.clone(), reason };
    if control.imu.is_none() {
        return Err(range("it has no IMU, and nothing else sees it move".into()));
    }
    let free = &control.free;
    let soft = control.limits.angle_soft;
    // From rest, how fast it comes back per angle: ringing or creeping.
    let natural = (free.torsional_stiffness / (free.inertia + added)).sqrt();
    let creep = free.torsional_stiffness / free.torsional_damping;
    let turn = TURN.min(SHARE_OF_ANGLE * soft.1.min(-soft.0)).min(RATE / natural.min(creep));
    if turn < TURN_MIN {
        return Err(range(format!(
            "it may be turned by {:.1} deg only, within its soft angles and the gyro's range, and {:.1} deg are the least: \
             add inertia, or widen `soft_angle_deg`",
            turn.to_degrees(),
            TURN_MIN.to_degrees()
        )));
    }
    let last = FIRST + EVERY * f64::from(PLUCKS - 1);
    let experiment = format!(
        "kind = \"sweep\"\nname = \"{NAME}\"\nshape = \"step\"\npressures_psi = [0]\nmove_s = 0.0\nhold_s = {:?}\nand_back = \
         false\n",
        last + EVERY
    );
    let releases_s = (0..PLUCKS).map(|n| FIRST + EVERY * f64::from(n)).collect();
    Ok(Plan { experiment, hand: Hand { releases_s, angle_rad: turn, added_inertia_kg_m2: added } })
}

/// What one run says.
#[derive(Clone, Debug)]
pub struct Look {
    /// The run.
    pub run: Run,
    /// Added inertia, kg m2.
    pub added: f64,
    record: Vec<Reading>,
    releases: Vec<Release>,
    fit: PluckFit,
}

/// What `run`, the experiment of a [`plan`] with `added`, says.
///
/// # Errors
/// Where nobody plucked, or what moved is beyond the sensor.
pub fn look(rig: &Rig, subject: usize, run: &Run, added: f64) -> Result<Look, CalibrationError> {
    let control = &rig.control.frees[subject];
    let axis = control.imu.map_or([0.0, 0.0, 1.0], |imu| imu.axis);
    let readings = run.imu_readings(subject, axis)?;
    let readings: Vec<_> = readings.iter().map(|r| Reading { time: r.time, angle: r.angle, rate: r.rate }).collect();
    let record = evened(&readings);
    let ratio = (control.free.inertia + added) / control.free.torsional_stiffness;
    let failed = |source| CalibrationError::Damping { run: run.id().to_owned(), source };
    let releases = releases(&record, &Rules::default()).map_err(failed)?;
    let fit = fit_plucks(&record, &releases, ratio, BANDWIDTH).map_err(failed)?;
    Ok(Look { run: run.clone(), added, record, releases, fit })
}

/// Whether `error` says that the FREE rings faster than its sensor can be trusted; with more inertia it would not.
pub fn is_too_fast(error: &CalibrationError) -> bool {
    match error {
        CalibrationError::Damping { source: PluckError::RingDown(RingDownError::BeyondSensor { .. }), .. } => true,
        // The gyro's range leaves no turn worth the name.
        CalibrationError::Range { .. } => true,
        _ => false,
    }
}

/// What the `looks` (at least one) say together; `date` is today's, `YYYY-MM-DD`.
///
/// # Errors
/// Where they contradict each other, or give no damping.
pub fn evaluate(rig: &Rig, subject: usize, looks: &[Look], date: &str) -> Result<Finding, CalibrationError> {
    let control = &rig.control.frees[subject];
    let free = &control.free;
    let Some(last) = looks.last() else {
        return Err(CalibrationError::Range { free: control.name.clone(), reason: "nothing was plucked".into() });
    };
    let mut calibration = rig.calibrations[subject].clone();
    let known = |key: &Key, value: f64| {
        let uncertainty = calibration.entry(key).and_then(|entry| entry.standard_uncertainty);
        (Measured { uncertainty: uncertainty.unwrap_or_default(), ..Measured::exact(value) }, uncertainty.is_some())
    };
    let (kt, kt_known) = known(&keys::TORSIONAL_STIFFNESS, free.torsional_stiffness);
    let (inertia, inertia_known) = known(&keys::END_INERTIA, free.inertia);
    let mut remarks = Vec::new();
    let mut facts = Vec::new();
    let freedom = looks.iter().map(|look| look.releases.len()).sum::<usize>() - 1;
    let measured = |e: Measured| Measured { freedom, ..e };
    let ringing: Vec<Loaded> = looks.iter().filter_map(Look::loaded).collect();
    let mut found: Vec<(&Key, Measured, String)> = Vec::new();
    let plucks = freedom + 1;
    match (ringing.as_slice(), &last.fit.regime) {
        ([], Regime::Creeps { time }) => {
            facts.push(("ct / kt".into(), format!("{:.3} +- {:.3} ms", 1e3 * time.value, 1e3 * time.uncertainty)));
            let method = format!("relaxation after {plucks} plucks, times kt of the calibration");
            found.push((&keys::TORSIONAL_DAMPING, product(*time, kt), method));
            remarks.push(
                "it creeps back and does not ring: its inertia is not identifiable and stays as it was; a thousandth of it \
                 shows in ct"
                    .to_owned(),
            );
            if !kt_known {
                remarks.push("kt of the calibration has no uncertainty: ct / kt is what was measured".into());
            }
        }
        ([], Regime::Rings { .. }) | ([_, ..], _) if ringing.len() != looks.len() => {
            let reason = "it rings in one run and creeps in another".to_owned();
            return Err(CalibrationError::Regulator { run: last.run.id().to_owned(), reason });
        }
        ([only], _) if only.added == 0.0 => {
            let torsion = torsion(only, inertia);
            let method = format!("ring-down after {plucks} plucks, with the inertia of the calibration");
            found.push((&keys::TORSIONAL_DAMPING, torsion.damping, method));
            compare(&mut facts, &mut remarks, torsion.stiffness, kt, "with the inertia of the calibration");
            if !inertia_known {
                remarks.push(
                    "the inertia of the calibration has no uncertainty, and ct is proportional to it: measure again with an \
                     added inertia to find both"
                        .into(),
                );
            }
        }
        ([only], _) => {
            let whole = quotient(kt, only.stiffness);
            let method = format!("ring-down after {plucks} plucks with an added inertia, and kt of the calibration");
            found.push((&keys::TORSIONAL_DAMPING, product(only.damping, whole), method));
            let rest = Measured { value: whole.value - only.added, ..whole };
            facts.push(("its own inertia".into(), format!("{:.3e} +- {:.1e} kg m2", rest.value, rest.uncertainty)));
            remarks.push(
                "one added inertia only, and no ring-down without it: the FREE's own inertia stays as it was; a second added \
                 inertia would give it, and kt"
                    .into(),
            );
        }
        _ => {
            let torsion = torsion_of_series(&ringing).map_err(|error| CalibrationError::Regulator {
                run: last.run.id().to_owned(),
                reason: error.to_string(),
            })?;
            let method = format!("ring-down after {plucks} plucks with {} inertias", ringing.len());
            let inertia = torsion.inertia;
            if inertia.uncertainty < UNSURE * inertia.value {
                found.push((&keys::END_INERTIA, inertia, method.clone()));
            } else {
                remarks.push(format!(
                    "the added inertias are too large, or the friction is, to tell the FREE's own ({:.1e} +- {:.1e} kg m2): it \
                     stays as it was",
                    inertia.value, inertia.uncertainty
                ));
            }
            found.push((&keys::TORSIONAL_DAMPING, torsion.damping, method.clone()));
            compare(&mut facts, &mut remarks, torsion.stiffness, kt, "with the added inertia");
            // What the staircase has found belongs to its geometry; what nobody has measured is replaced.
            if !kt_known {
                found.push((&keys::TORSIONAL_STIFFNESS, torsion.stiffness, method));
            }
        }
    }
    for look in looks {
        look.facts(&mut facts, &mut remarks);
    }
    facts.push(("runs".into(), looks.iter().map(|look| look.run.id()).collect::<Vec<_>>().join(", ")));
    remarks.push(axial(free.axial_stiffness, free.mass));
    let values = enter(&found, last, (&rig.bench, subject), date, &mut calibration, measured);
    let named: Vec<_> = looks.iter().map(|l| (l.name(), &l.record[..], &l.releases[..], &l.fit)).collect();
    let title = format!("Damping of {}", control.name);
    let mut sheet = damping_sheet(&title, &named, last.run.start().simulated(), facts);
    sheet.remarks.clone_from(&remarks);
    Ok(Finding { calibration, values, remarks, sheet })
}

fn enter(
    found: &[(&Key, Measured, String)],
    last: &Look,
    (bench, subject): (&BenchConfig, usize),
    date: &str,
    calibration: &mut Calibration,
    measured: impl Fn(Measured) -> Measured,
) -> Vec<FoundValue> {
    let residual = Some(last.fit.residual);
    let one = |(key, value, method): &(&Key, Measured, String)| {
        let origin = Origin { run: &last.run, bench, subject, date, method, residual };
        origin.enter(calibration, key, measured(*value), None)
    };
    found.iter().map(one).collect()
}

/// What the ring-down says of kt beside what the calibration says.
fn compare(
    facts: &mut Vec<(String, String)>,
    remarks: &mut Vec<String>,
    ringing: Measured,
    known: Measured,
    how: &str,
) {
    let text = format!(
        "{:.5} +- {:.5} N m/rad {how}; the calibration says {:.5}",
        ringing.value, ringing.uncertainty, known.value
    );
    facts.push(("kt by ringing".into(), text));
    let apart = (ringing.value - known.value).abs();
    if apart > 3.0 * ringing.uncertainty.hypot(known.uncertainty).max(0.01 * known.value) {
        remarks.push(format!(
            "kt by ringing is {:.1} % off the calibration's: inertia, geometry or stiffness are not what is believed",
            100.0 * (ringing.value / known.value - 1.0)
        ));
    }
}

/// kt and ct from one record and the whole inertia.
fn torsion(one: &Loaded, inertia: Measured) -> Torsion {
    Torsion { stiffness: product(one.stiffness, inertia), damping: product(one.damping, inertia), inertia }
}

fn product(a: Measured, b: Measured) -> Measured {
    let value = a.value * b.value;
    let uncertainty = value * (a.uncertainty / a.value).hypot(b.uncertainty / b.value);
    Measured { value, uncertainty, freedom: a.freedom.min(b.freedom) }
}

fn quotient(a: Measured, b: Measured) -> Measured {
    let value = a.value / b.value;
    let uncertainty = value * (a.uncertainty / a.value).hypot(b.uncertainty / b.value);
    Measured { value, uncertainty, freedom: a.freedom.min(b.freedom) }
}

/// Why ce stays as it is.
fn axial(stiffness: f64, mass: f64) -> String {
    let frequency = (stiffness / mass).sqrt() / TAU;
    match frequency > BANDWIDTH {
        true => format!("ce stays as it was: the axial mode, at about {frequency:.0} Hz, is beyond the accelerometer"),
        false => "ce stays as it was: a turn does not excite the axial mode".into(),
    }
}

impl Look {
    fn loaded(&self) -> Option<Loaded> {
        match self.fit.regime {
            Regime::Rings { damping, stiffness, .. } => Some(Loaded { added: self.added, damping, stiffness }),
            Regime::Creeps { .. } => None,
        }
    }

    fn name(&self) -> String {
        if self.added > 0.0 { format!("with {:e} kg m2 added", self.added) } else { "as it is".into() }
    }

    fn facts(&self, facts: &mut Vec<(String, String)>, remarks: &mut Vec<String>) {
        let widest = self.releases.iter().map(|r| r.turn.abs()).fold(0.0, f64::max);
        let motion = match self.fit.regime {
            Regime::Rings { damping, stiffness, frequency } => format!(
                "rings at {frequency:.2} Hz, damping ratio {:.4}; ct/I {:.4} +- {:.4} 1/s, kt/I {:.1} +- {:.1} 1/s2",
                0.5 * damping.value / stiffness.value.sqrt(),
                damping.value,
                damping.uncertainty,
                stiffness.value,
                stiffness.uncertainty
            ),
            Regime::Creeps { time } => format!("creeps back with {:.2} ms", 1e3 * time.value),
        };
        let text = format!(
            "{} releases from up to {:.1} deg: {motion}; friction {:.2} deg, left over {:.3} deg RMS",
            self.releases.len(),
            widest.to_degrees(),
            self.fit.slip.to_degrees(),
            self.fit.residual.to_degrees()
        );
        facts.push((self.name(), text));
        if self.fit.slip > SLIP_REMARK * widest {
            remarks.push(format!(
                "{}: friction holds it up to {:.1} deg off its rest; it has been fitted beside the damping, which a plain \
                 decay would have taken for more",
                self.name(),
                self.fit.slip.to_degrees()
            ));
        }
    }
}

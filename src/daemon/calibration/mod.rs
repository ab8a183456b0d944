//! What a calibration asks of the rig, and what its run says.
//!
//! A calibration is an experiment like any other, with the interlocks, the record and the report of one, and a fit over
//! its run: nothing is measured that could not be looked at again. Each file holds one: `experiment` writes the
//! experiment for the FREE that is to be measured, `evaluate` makes of its run the calibration with the new values,
//! each with its standard uncertainty, method, residual, date and run, and a page that shows the fit over the data.
//! Nothing is written before all of that has been successful.

pub mod channels;
pub mod damping;
pub mod gauge;
pub mod imu;
pub mod loads;
pub mod material;
pub mod regulator;
pub mod stiffness;

use thiserror::Error;

use super::{cycles, validity};
use crate::config::calibration::{Entry, Key, keys};
use crate::config::{Calibration, Conditions, FittedGeometry, Rig};
use crate::ident::pluck::PluckError;
use crate::ident::{Measured, RingDownError, SweepError};
use crate::model::{EquilibriumError, FreeError};
use crate::record::{RecordError, Run, Sheet};
use crate::sim::BenchConfig;
use crate::units::{PASCAL_PER_PSI, Pressure};

/// What a calibration found.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The FREE's calibration with the new values in it.
    pub calibration: Calibration,
    /// The new values, in the units of their keys.
    pub values: Vec<FoundValue>,
    /// What the user should know about them.
    pub remarks: Vec<String>,
    /// The page of the fit.
    pub sheet: Sheet,
}

/// One value that was found.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct FoundValue {
    /// Key in the calibration file; ends in its unit.
    pub key: &'static str,
    /// What the calibration said before; `None` where it said nothing.
    pub before: Option<f64>,
    /// What was found.
    pub value: f64,
    /// Its standard uncertainty.
    pub standard_uncertainty: f64,
    /// What the finite-element model predicts.
    pub prediction: Option<f64>,
}

/// What a value of the FREE `subject` of `rig` that is measured now holds for, without the ranges that it was measured
/// over.
fn conditions(rig: &Rig, subject: usize) -> Conditions {
    let known = &rig.calibrations[subject];
    let free = known.free();
    let gamma = known.value(&keys::WINDING_ANGLE).unwrap_or(free.gamma);
    Conditions {
        geometry: Some(FittedGeometry { gamma, length: free.length, radius: free.radius }),
        regulator: validity::regulator(rig, subject),
        sensor: rig.calibrations[subject].imu_profile.map(|profile| profile.unique_id),
        cycles: cycles::counted(rig).get(subject).copied(),
        ..Conditions::default()
    }
}

/// Lowest and highest of some numbers; `None` of none.
fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |range, x| Some(range.map_or((x, x), |(low, high): (f64, f64)| (low.min(x), high.max(x)))))
}

/// Where new values come from.
struct Origin<'a> {
    run: &'a Run,
    /// What the simulated rig is made of, and which of its FREEs was measured.
    bench: &'a BenchConfig,
    subject: usize,
    /// `YYYY-MM-DD`.
    date: &'a str,
    method: &'a str,
    /// Of the fit.
    residual: Option<f64>,
}

impl Origin<'_> {
    /// What the simulated FREE has for a `key` that its calibration says nothing of yet, in the unit of the key.
    fn nominal(&self, key: &Key) -> Option<f64> {
        let plant = self.bench.plants.get(self.subject)?;
        let (regulator, imu) = (&plant.regulator, &self.bench.imu);
        let all = [
            (&keys::EFFECTIVE_ANGLE, plant.nominal.gamma.to_degrees()),
            (&keys::REGULATOR_LAG, regulator.lag.as_secs_f64() * 1e3),
            (&keys::REGULATOR_DEAD_TIME, regulator.dead_time.as_secs_f64() * 1e3),
            (&keys::FASTEST_FILL, regulator.slew / PASCAL_PER_PSI),
            (&keys::IMU_NOISE, imu.noise.to_degrees()),
            (&keys::IMU_DRIFT, 0.0),
            (&keys::IMU_RATE_NOISE, imu.rate_noise.to_degrees()),
        ];
        all.into_iter().find(|(known, _)| known.name == key.name).map(|(_, value)| value)
    }

    /// Enters `found`, in the unit of `key`, into `calibration`.
    fn enter(&self, calibration: &mut Calibration, key: &Key, found: Measured, prediction: Option<f64>) -> FoundValue {
        let before = calibration.entry(key).cloned();
        let simulated = self.run.start().simulated();
        let nominal = match &before {
            Some(before) => before.simulated_nominal.unwrap_or(before.value),
            None => self.nominal(key).unwrap_or(found.value),
        };
        calibration.set(
            key,
            Entry {
                value: found.value,
                standard_uncertainty: Some(found.uncertainty),
                method: format!("{}{}", if simulated { "SIMULATED: " } else { "" }, self.method),
                residual: self.residual,
                date: Some(self.date.to_owned()),
                run: Some(self.run.id().to_owned()),
                prediction,
                simulated_nominal: simulated.then_some(nominal),
            },
        );
        FoundValue {
            key: key.name,
            before: before.map(|b| b.value),
            value: found.value,
            standard_uncertainty: found.uncertainty,
            prediction,
        }
    }
}

/// Refuses the FREE `subject` of `rig` where its end is not its own.
fn on_its_own(rig: &Rig, subject: usize) -> Result<(), CalibrationError> {
    match &rig.module {
        Some(module) if module.frees.contains(&subject) => {
            Err(CalibrationError::OnPlate { free: rig.control.frees[subject].name.clone() })
        }
        _ => Ok(()),
    }
}

/// The hand of a FREE wound at `gamma`, rad, and the rule of how it turns.
fn hand(gamma: f64) -> &'static str {
    if gamma < 0.0 {
        "an L FREE, which turns positive under pressure"
    } else {
        "an R FREE, which turns negative under pressure"
    }
}

/// Why there is no calibration.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// The FREE cannot be taken where it would have to go.
    #[error("FREE `{free}`: {reason}")]
    Range {
        /// The FREE.
        free: String,
        /// Why.
        reason: String,
    },
    /// The run says nothing.
    #[error("the run {run} gives no stiffness: {source}")]
    Sweep {
        /// Its id.
        run: String,
        /// Why.
        source: SweepError,
    },
    /// Its end turns with a plate.
    #[error("the end of `{free}` is on its module's plate, which turns as all its FREEs let it")]
    OnPlate {
        /// The FREE.
        free: String,
    },
    /// The FREE is of the other hand than its calibration says.
    #[error(
        "`{free}` turned to {:.1} deg under {:.2}, and its winding angle of {:.1} deg says that it is {}: the run {run}",
        .turned.to_degrees(), Pressure::pascals(*.pressure), .gamma.to_degrees(), hand(*.gamma)
    )]
    Hand {
        /// The FREE.
        free: String,
        /// The run's id.
        run: String,
        /// The winding angle of the calibration, rad.
        gamma: f64,
        /// How far it turned, rad ...
        turned: f64,
        /// ... and under which pressure, Pa.
        pressure: f64,
    },
    /// The run says nothing, or nothing good, of the regulator.
    #[error("the run {run}: {reason}")]
    Regulator {
        /// Its id.
        run: String,
        /// Why.
        reason: String,
    },
    /// The tubes hang on other channels than rig.toml says.
    #[error("the run {run} shows another map of channels than rig.toml: {reason}")]
    Map {
        /// Its id.
        run: String,
        /// What is fed by what, and what to write.
        reason: String,
    },
    /// The gauge's readings do not carry zero and span, or the regulator is not sound.
    #[error("the staircase against the gauge: {0}")]
    Gauge(String),
    /// Known loads do not carry a stiffness.
    #[error("{0}")]
    Loads(String),
    /// A test of the material does not carry what it is for.
    #[error("{0}")]
    Material(String),
    /// The run says nothing, or nothing good, of the IMU.
    #[error("the run {run} gives no IMU: {reason}")]
    Imu {
        /// Its id.
        run: String,
        /// Why.
        reason: String,
    },
    /// The IMU sits otherwise than rig.toml says.
    #[error(
        "the axis of `{free}` is [{:.3}, {:.3}, {:.3}] in its sensor's frame, and rig.toml says [{:.3}, {:.3}, {:.3}]: {:.1} deg \
         apart; {remedy}",
        .found[0], .found[1], .found[2], .configured[0], .configured[1], .configured[2], .off.to_degrees()
    )]
    Axis {
        /// The FREE.
        free: String,
        /// How far apart, rad.
        off: f64,
        /// What was found.
        found: [f64; 3],
        /// What rig.toml says.
        configured: [f64; 3],
        /// The line to write.
        remedy: String,
    },
    /// The run says nothing of the damping.
    #[error("the run {run} gives no damping: {source}")]
    Damping {
        /// Its id.
        run: String,
        /// Why.
        source: PluckError,
    },
    /// The model has no such FREE.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// The model has no such rest.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
    /// The run cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl CalibrationError {
    /// What to do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            CalibrationError::Range { .. } => "widen the limits in rig.toml as far as the FREE bears it",
            CalibrationError::Sweep { .. } => {
                "look at the run's report: nothing may hold the FREE or leak, and the winding angle, its sign and the \
                 radius in the calibration must be right; the old calibration is untouched"
            }
            CalibrationError::OnPlate { .. } => {
                "measure it before it is mounted, on a rig on which it hangs free with an IMU on its end"
            }
            CalibrationError::Hand { .. } => {
                "look which way its fibres run: correct the sign of winding_angle_deg in its calibration, or mount the FREE \
                 that belongs there; where the fibres are as written its IMU sits the other way round (`axis` in rig.toml); \
                 the old calibration is untouched"
            }
            CalibrationError::Regulator { .. } => {
                "look at the run's report; check supply, tubes and the unit's range and loop gains; the old calibration \
                 is untouched"
            }
            CalibrationError::Map { .. } => {
                "write these channels into rig.toml, or move the tubes, and start the daemon again; the old calibration is \
                 untouched"
            }
            CalibrationError::Gauge(_) => {
                "check the gauge, the supply, the tube and the regulator's zero and span screws; the old calibration is \
                 untouched"
            }
            CalibrationError::Loads(_) => {
                "hang every load up and down again at every pressure, and read each at rest; the old calibration is \
                 untouched"
            }
            CalibrationError::Material(_) => "correct the file or test again; the old calibration is untouched",
            CalibrationError::Imu { .. } => {
                "let the FREE hang still and untouched, look at the sensor's mounting and cable, and run it again; the old \
                 calibration is untouched"
            }
            CalibrationError::Axis { .. } => {
                "correct that line (the program never writes rig.toml), start the daemon again, and run this again; the old \
                 calibration is untouched"
            }
            CalibrationError::Damping { source: PluckError::RingDown(RingDownError::BeyondSensor { .. }), .. } => {
                "add an inertia to the end and say how large it is (`added_inertia_kg_m2 = [...]` in the script): it rings \
                 more slowly then; two different ones give the FREE's own inertia too"
            }
            CalibrationError::Damping { .. } => {
                "turn the end by hand as far as it says, hold it still for a second, let go at once, and let it come to rest; \
                 the old calibration is untouched"
            }
            CalibrationError::Free(_) | CalibrationError::Equilibrium(_) => {
                "correct the geometry and the stiffnesses in the calibration: they are the start of the search"
            }
            CalibrationError::Record(_) => "the old calibration is untouched; repeat the measurement",
        }
    }
}

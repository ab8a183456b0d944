//! What a calibration asks of the rig, and what its run says.
//!
//! A calibration is an experiment like any other, with the interlocks, the record and the report of one, and a fit over
//! its run: nothing is measured that could not be looked at again. Each file holds one: `experiment` writes the
//! experiment for the FREE that is to be measured, `evaluate` makes of its run the calibration with the new values, each
//! with its standard uncertainty, method, residual, date and run, and a page that shows the fit over the data. Nothing
//! is written before all of that has been successful.

pub mod stiffness;

use thiserror::Error;

use crate::config::Calibration;
use crate::ident::SweepError;
use crate::model::{EquilibriumError, FreeError};
use crate::record::{RecordError, Sheet};

/// What a calibration found.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The FREE's calibration with the new values in it.
    pub calibration: Calibration,
    /// Name of each new value with its unit, before, now, standard uncertainty.
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
            CalibrationError::Free(_) | CalibrationError::Equilibrium(_) => {
                "correct the geometry and the stiffnesses in the calibration: they are the start of the search"
            }
            CalibrationError::Record(_) => "the old calibration is untouched; repeat the measurement",
        }
    }
}

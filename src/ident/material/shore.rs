//! Shore A hardness and Young's modulus, by Gent's formula for the indenter of a durometer (1958):
//!
//! ```text
//! E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S))   MPa
//! ```
//!
//! An estimate: Gent found it within a few units of hardness between 20 and 80.

use thiserror::Error;

const FORCE: f64 = 0.0981;
const REST: f64 = 56.0;
const PER_DEGREE: f64 = 7.62336;
const DEPTH: f64 = 0.137505;
const FULL: f64 = 254.0;
const STEP: f64 = 2.54;
const MEGA: f64 = 1e6;

/// What is no hardness.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ShoreError {
    /// Beyond the scale.
    #[error("Shore A {0}: must be 0 or more and below 100")]
    Hardness(f64),
    /// A modulus that is off the scale.
    #[error("E {0} Pa is not on the Shore A scale, which begins at 1.57e5 Pa and has no end")]
    Modulus(f64),
}

/// Young's modulus of a Shore A hardness (0..100), Pa.
pub fn modulus_of_shore_a(hardness: f64) -> Result<f64, ShoreError> {
    if !(0.0..100.0).contains(&hardness) {
        return Err(ShoreError::Hardness(hardness));
    }
    Ok(MEGA * FORCE * (REST + PER_DEGREE * hardness) / (DEPTH * (FULL - STEP * hardness)))
}

/// Shore A hardness of a Young's modulus, Pa.
pub fn shore_a_of_modulus(modulus: f64) -> Result<f64, ShoreError> {
    let e = modulus / MEGA;
    let hardness = (DEPTH * FULL * e - FORCE * REST) / (FORCE * PER_DEGREE + DEPTH * STEP * e);
    // Rounding of the end of the scale is on the scale.
    if modulus.is_finite() && hardness > -1e-9 { Ok(hardness.max(0.0)) } else { Err(ShoreError::Modulus(modulus)) }
}

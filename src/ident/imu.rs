//! What an orientation sensor is worth, and how it sits on the FREE.
//!
//! | noun | from | gives |
//! | --- | --- | --- |
//! | [`still`] | readings of a FREE that is left alone | noise, quantum, drift, jitter, missing readings |
//! | [`tare`] | orientations of a FREE that is left alone | mean orientation |
//! | [`axis`] | orientations while the FREE turns | the FREE's axis in the sensor's frame, with its sign |

pub mod axis;
pub mod still;
pub mod tare;

pub use axis::{AxisError, AxisFit, Turn, fit_axis};
pub use still::{StillError, StillFit, StillRules, StillSample, noise_and_drift};
pub use tare::{Tare, TareError, fit_tare};

//! Whether a controller can be built from a configuration.

use thiserror::Error;

use super::static_map::StaticMapError;
use super::{FreeControl, Gains};
use crate::signal::MAX_FREES;

/// A configuration that no controller can be built from.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ControlError {
    /// No FREE or too many.
    #[error("a rig has 1 to {MAX_FREES} FREEs, not {0}")]
    FreeCount(usize),
    /// Period, vent time or ramp time is zero.
    #[error("{0} must be longer than zero")]
    Duration(&'static str),
    /// A value of a FREE is out of its range.
    #[error("FREE {free}: {what} is {value}, but must be {rule}")]
    Value {
        /// Its name.
        free: String,
        /// Which value, in the words of the configuration.
        what: &'static str,
        /// What it is, SI.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
    /// No inverse model for the controller `model`.
    #[error("FREE {free}: no inverse model for `controller = \"model\"`: {problem}")]
    Model {
        /// Its name.
        free: String,
        /// What is the matter.
        problem: StaticMapError,
    },
}

impl Gains {
    /// The first gain that is negative or not finite, by name.
    pub fn problem(&self) -> Option<(&'static str, f64)> {
        [
            ("proportional gain", self.proportional),
            ("integral gain", self.integral),
            ("derivative gain", self.derivative),
            ("derivative filter", self.derivative_filter),
        ]
        .into_iter()
        .find(|(_, value)| !(value.is_finite() && *value >= 0.0))
    }
}

/// The first value of `free` that is out of its range.
pub(super) fn check(free: &FreeControl, ramp_time: f64) -> Result<(), ControlError> {
    let FreeControl { limits: l, regulator: r, .. } = free;
    let mut rules = vec![
        ("max_pressure", l.pressure_max, l.pressure_max > 0.0 && l.pressure_max.is_finite(), "positive"),
        ("warn_pressure", l.pressure_warn, l.pressure_warn > l.pressure_max, "above max_pressure"),
        ("hard_pressure", l.pressure_hard, l.pressure_hard > l.pressure_warn, "above warn_pressure"),
        ("zero_pressure", l.pressure_zero, l.pressure_zero > 0.0, "positive"),
        ("slew", l.slew, l.slew * ramp_time >= l.pressure_max, "fast enough to take max_pressure down in ramp_time"),
        ("angle_soft", l.angle_soft.1, l.angle_soft.0 < l.angle_soft.1, "a range"),
        (
            "angle_hard",
            l.angle_hard.1,
            l.angle_hard.0 <= l.angle_soft.0 && l.angle_soft.1 <= l.angle_hard.1,
            "a range that holds angle_soft",
        ),
        ("tracking_error", l.tracking_error.0, l.tracking_error.0 > 0.0, "positive"),
        ("tracking_error time", l.tracking_error.1, l.tracking_error.1 >= 0.0, "zero or more"),
        ("regulator period", r.period.as_secs_f64(), !r.period.is_zero(), "longer than zero"),
        ("full_scale", r.full_scale, r.full_scale > 0.0 && r.full_scale.is_finite(), "positive"),
        ("fastest_fill", r.fastest_fill, r.fastest_fill > 0.0, "positive"),
        ("feedforward", free.feedforward, (0.0..=1.0).contains(&free.feedforward), "between 0 and 1"),
    ];
    if let Some((what, value)) = free.gains.problem() {
        rules.push((what, value, false, "zero or more, and finite"));
    }
    if let Some(imu) = free.imu {
        let norm = imu.axis.iter().map(|x| x * x).sum::<f64>().sqrt();
        rules.push(("IMU axis", norm, (norm - 1.0).abs() < 1e-6, "a unit vector (its norm is given)"));
        rules.push(("IMU period", imu.period.as_secs_f64(), !imu.period.is_zero(), "longer than zero"));
    }
    match rules.into_iter().find(|(_, _, good, _)| !good) {
        Some((what, value, _, rule)) => Err(ControlError::Value { free: free.name.clone(), what, value, rule }),
        None => Ok(()),
    }
}

//! The margin that arming asks for.

use super::DaemonError;
use crate::control::{ControlConfig, FreeControl, Gains, margin};

/// Checks the gains of every FREE whose angle can be controlled.
///
/// # Errors
/// The first one below the stated margin.
pub fn check(control: &ControlConfig) -> Result<(), DaemonError> {
    control.frees.iter().try_for_each(|free| check_one(free, control))
}

/// Checks other `gains` for one FREE.
///
/// # Errors
/// If their margin is below the stated one.
pub fn check_gains(control: &ControlConfig, free: usize, gains: Gains) -> Result<(), DaemonError> {
    match control.frees.get(free) {
        Some(own) => check_one(&FreeControl { gains, ..own.clone() }, control),
        None => Ok(()),
    }
}

fn check_one(free: &FreeControl, control: &ControlConfig) -> Result<(), DaemonError> {
    match margin::margin(free, control.period).and_then(|m| m.problem()) {
        Some(problem) => Err(DaemonError::Margin(format!("{}: {problem}", free.name))),
        None => Ok(()),
    }
}

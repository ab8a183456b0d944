//! Why there is no plan.

use thiserror::Error;

use super::End;
use crate::fem::module::ModuleError;

/// What is wrong with the question. An answer that falls short of its target is none of these.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PlanError {
    /// Another number of FREEs than four.
    #[error("the module has {0} FREEs: plans are made for four")]
    Rods(usize),
    /// The module has no stable state at rest.
    #[error("without pressure the module {0}: no margin can be measured; lighten the plate or shorten the FREEs")]
    Rest(String),
    /// A number out of its range.
    #[error("{what} is {value}: {rule}")]
    Invalid {
        /// What.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The rule.
        rule: &'static str,
    },
    /// A target at or below the plane of the bases.
    #[error(
        "the target's z is {:.1} mm and the FREEs stand on z = {:.1} mm: the plate would pass through the base; \
         choose a target above it (at rest the plate is at {:.1} mm)",
        1e3 * .z, 1e3 * .base, 1e3 * .rest
    )]
    BelowBase {
        /// m.
        z: f64,
        /// Height of the highest base, m.
        base: f64,
        /// The plate's height at rest, m.
        rest: f64,
    },
    /// Not even the lowest pressures allowed can be reached from rest.
    #[error("the allowed pressures cannot be reached from rest: the module {0}; allow lower pressures")]
    NoStart(End),
    /// The module refuses for a reason that is no end of a branch.
    #[error(transparent)]
    Module(#[from] ModuleError),
}

impl PlanError {
    pub(super) fn invalid(what: &'static str, value: f64, rule: &'static str) -> PlanError {
        PlanError::Invalid { what, value, rule }
    }
}

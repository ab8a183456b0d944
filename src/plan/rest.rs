//! A module at rest: where every plan begins and what every margin is measured against.

use super::margin::eigenvalues;
use super::{FREES, Margin, PlanError};
use crate::fem::module::{Loads, Module, State};

/// A module of four FREEs under its dead loads, without pressure.
#[derive(Debug)]
pub struct Rest<'a> {
    module: &'a Module,
    dead: Loads,
    state: State,
    /// Least eigenvalue of the plate's stiffness, N m.
    softest: f64,
    clearance: Option<f64>,
}

impl<'a> Rest<'a> {
    /// Of `module` under the force, moment and gravity of `dead`, whose pressures do not matter.
    ///
    /// # Errors
    /// Not four FREEs, no equilibrium without pressure, or an unstable one.
    pub fn new(module: &'a Module, dead: &Loads) -> Result<Rest<'a>, PlanError> {
        let rods = module.mounts().len();
        if rods != FREES {
            return Err(PlanError::Rods(rods));
        }
        let dead = Loads { pressures: vec![0.0; FREES], ..dead.clone() };
        let state = module.equilibrium(&dead)?;
        let softest = eigenvalues(&state.stiffness(), module.length()).min();
        if !(state.stable() && softest > 0.0) {
            return Err(PlanError::Rest("has no stable equilibrium under its weight".into()));
        }
        let clearance = state.least_clearance().map(|(_, c)| c);
        if clearance == Some(0.0) {
            return Err(PlanError::Rest("has tubes that touch".into()));
        }
        Ok(Rest { module, dead, state, softest, clearance })
    }

    /// The module.
    pub fn module(&self) -> &'a Module {
        self.module
    }

    /// The state without pressure.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The dead loads with `pressures`, Pa.
    pub fn loads(&self, pressures: &[f64; 4]) -> Loads {
        Loads { pressures: pressures.to_vec(), ..self.dead.clone() }
    }

    /// How far `state` is from its end.
    pub fn margin(&self, state: &State) -> Margin {
        let clearance = self.clearance.and_then(|c0| state.least_clearance().map(|(_, c)| c / c0));
        let shares = eigenvalues(&state.stiffness(), self.module.length()) / self.softest;
        Margin::new(&shares, clearance, state.stable())
    }
}

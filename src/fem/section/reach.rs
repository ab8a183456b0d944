//! One state from another in a step or a few: what tabulates a law, where most states are near the one before.

use super::newton::Condition;
use super::path::{self, End};
use super::{Section, SectionError, State};
use crate::fem::ends::{Ends, Equilibrium};

impl Section {
    /// Takes `state` to the gauge pressure `pressure`, Pa, and to `ends` as [`Section::advance`] does, but gives up
    /// early: none where four steps do not lead to a stable, symmetric equilibrium. No limit is searched. Then `state`
    /// stays somewhere on the way.
    ///
    /// # Errors
    /// Where pressure or ends are none.
    pub fn reach(&self, state: &mut State, pressure: f64, ends: Ends) -> Result<Option<Equilibrium>, SectionError> {
        let goal: [Condition; 3] = self.conditions(pressure, ends)?;
        let State { solution, workspace } = state;
        let stopped = matches!(path::follow(&self.sector, workspace, solution, goal, false), End::Stopped(_));
        if stopped || self.broken(state)?.is_some() {
            return Ok(None);
        }
        Ok(Some(self.equilibrium(state)))
    }
}

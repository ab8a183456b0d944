//! The least distance between the surfaces of two rods.

use super::newton::Solver;
use super::state::Unknowns;
use super::ModuleError;

impl Solver<'_> {
    pub fn clearance(&self, _at: &Unknowns) -> Result<Option<([usize; 2], f64)>, ModuleError> {
        Ok(None)
    }
}

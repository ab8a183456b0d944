//! Where a section goes that has folded: the stable equilibrium into which it snaps at held ends and pressure.
//!
//! Past a fold there is no equilibrium near by, and the rubber moves until its potential has a minimum again. Implicit
//! steps of the gradient flow on the incompressible fields,
//!
//! ```text
//!     [ K + c I  B^T ] [du]     [r]
//!     [ B        0   ] [dq] = - [g]
//! ```
//!
//! follow it down, with a drag c that keeps the matrix positive definite and the step short, and falls with every step
//! taken: next to the minimum they are Newton's. Nothing keeps the folded rubber from passing through itself.

use nalgebra::Vector3;

use super::newton::{Condition, Solution, Workspace};
use super::{Section, State};
use crate::fem::ends::Equilibrium;

/// Steps after which a minimum is given up. The folds of the reference tubes and of 60 seeded ones take 8 to 159; of
/// the seeded 46, one is not found.
const STEPS: usize = 600;
/// Longest way of a node in one step, over Ro: a fraction of the elements at the strip.
const LONGEST: f64 = 0.01;
/// Way of a step, over Ro, below which Newton's method is tried, and steps after which it is tried in any case.
const NEAR: f64 = 1e-4;
const EVERY: usize = 10;

impl Section {
    /// The stable equilibrium into which the tube snaps when the pressure goes from that of `state` to `pressure`, Pa,
    /// at once, its stretch and twist held. None where none is found.
    pub fn snapped(&self, state: &State, pressure: f64) -> Option<Equilibrium> {
        let goal = pressure / self.tube.law.shear_modulus();
        Some(self.outcome(&self.fall(&state.solution, goal)?))
    }

    fn fall(&self, from: &Solution, goal: f64) -> Option<Solution> {
        let sector = &self.sector;
        let mut workspace = Workspace::new(sector);
        let mut fields = from.fields.clone();
        fields.globals[2] = goal;
        let held = fields.globals.map(Condition::Held);
        let furthest = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
        let mut drag = 1.0;
        for step in 1..=STEPS {
            workspace.assembly.fill(sector, &fields).ok()?;
            let mut stiffness = workspace.assembly.stiffness.clone();
            (0..3 * sector.nodes()).for_each(|k| stiffness.add(k, k, drag));
            if workspace.saddle.factorise(&stiffness, &sector.even) != Some(0) {
                drag *= 4.0;
                continue;
            }
            let correction = workspace.saddle.correction(sector, &workspace.assembly);
            let way = correction.position.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            if way > LONGEST {
                drag *= 2.0;
                continue;
            }
            let mut next = fields.clone();
            next.advance(&correction, &Vector3::zeros());
            if workspace.assembly.fill(sector, &next).is_err() {
                drag *= 4.0;
                continue;
            }
            fields = next;
            drag *= 0.7;
            if way < NEAR || step % EVERY == 0 {
                let found = workspace.solve(sector, fields.clone(), held).filter(|found| found.stable([false; 2]));
                if found.as_ref().is_some_and(|found| furthest(&found.fields.position, &fields.position) < LONGEST) {
                    return found;
                }
            }
        }
        None
    }
}

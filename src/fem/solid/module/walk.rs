//! From rest to rows of pressures: steps, inertia on the way, contact, answers.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

use super::plate::{position, rotation, wrench};
use super::{ModulePath, PlateEquilibrium, SolidModule, State, Symmetry, TUBES};
use crate::fem::module::{Centreline, Wrench, least_clearance};
use crate::fem::solid::SolidError;
use crate::fem::solid::cap::{COORDINATES, Coordinates, TURN};
use crate::fem::solid::system::SystemError;
use crate::fem::sparse::SparseError;

/// Smallest part of a step that is tried.
const SMALLEST: f64 = 1.0 / 64.0;
/// Largest step of a pressure that is tried, in units of the shear modulus: 2 psi for the reference FREE.
const LARGEST_STEP: f64 = 0.0355;
/// Looks for the loss of stability within a step.
const LOOKS: usize = 4;
/// And how sharply it is found, as a share of the step.
const SHARP: f64 = 0.01;

/// How a path has ended.
#[derive(Clone, Debug, PartialEq)]
pub enum ModuleEnd {
    /// At the last pressures asked for.
    Reached,
    /// No further step converges beyond these pressures, Pa.
    Stuck([f64; TUBES]),
    /// Two tubes touch before these pressures, Pa: the model ends.
    Contact {
        /// Which.
        tubes: [usize; 2],
        /// Pa.
        pressures: [f64; TUBES],
        /// Negative, m.
        clearance: f64,
    },
}

/// All that moves.
#[derive(Clone)]
struct Place {
    plate: Coordinates,
    force: Vector3<f64>,
    states: Vec<Option<State>>,
    gas: [f64; TUBES],
}

/// Negative pivots beyond the expected ones, inside the tubes and of the plate, and the plate's least eigenvalue.
#[derive(Clone, Copy)]
struct Inertia {
    inside: usize,
    plate: usize,
    least: f64,
}

impl SolidModule {
    /// Equilibria from rest under the dead `force` (N, at the plate's centre) at the gauge pressures `pressures`, Pa,
    /// one set after the other, each approached along a straight line; `progress` is told the share of the
    /// way, from 0 to 1. A path that ends early says where. What `pressures` and `force` leave of the module's symmetry
    /// is kept: the perfect module stays on its straight branch, and its inertia says how long that is stable.
    pub fn follow(
        &mut self,
        force: &Vector3<f64>,
        pressures: &[[f64; TUBES]],
        progress: &mut dyn FnMut(f64),
    ) -> Result<ModulePath, SolidError> {
        if let Some(&value) = pressures.iter().flatten().find(|p| !p.is_finite()) {
            return Err(SolidError::NotFinite { what: "pressure", value });
        }
        if let Some(&value) = force.iter().find(|f| !f.is_finite()) {
            return Err(SolidError::NotFinite { what: "force", value });
        }
        self.symmetry = Symmetry::of(&self.gammas, self.fibers, pressures, force);
        self.plate = [0.0; COORDINATES];
        (self.force, self.iterations) = (Vector3::zeros(), 0);
        for tube in &mut self.tubes {
            tube.state = tube.system.body.rest();
        }
        self.carry();
        self.linearise()?;
        let force = force / (self.modulus * self.radius * self.radius);
        self.go([0.0; TUBES], force)?;
        let mut path = ModulePath { states: Vec::new(), end: ModuleEnd::Reached, unstable: None, iterations: 0 };
        let mut passed = 0.0;
        let mut last = [0.0; TUBES];
        let way = |a: &[f64; TUBES], b: &[f64; TUBES]| (0..TUBES).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
        let ways: Vec<f64> = pressures.iter().map(|p| way(&std::mem::replace(&mut last, *p), p)).collect();
        let total = ways.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        if self.inertia().lost() {
            path.unstable = Some([0.0; TUBES]);
        }
        'rows: for (goal, way) in pressures.iter().zip(&ways) {
            let goal = goal.map(|p| p / self.modulus);
            let start = self.gas();
            let steps = (way / self.modulus / LARGEST_STEP).ceil().max(1.0) as usize;
            for step in 1..=steps {
                let part = step as f64 / steps as f64;
                let (before, inertia) = (self.place(), self.inertia());
                if self.go(between(&start, &goal, part), force).is_err() {
                    path.end = ModuleEnd::Stuck(self.pascals());
                    break 'rows;
                }
                if path.unstable.is_none() && self.inertia().lost() {
                    path.unstable = Some(self.pinned(&before, inertia)?);
                }
                if let Some((tubes, clearance)) = self.clearance().filter(|(_, clearance)| *clearance < 0.0) {
                    path.end = ModuleEnd::Contact { tubes, pressures: self.pascals(), clearance };
                    break 'rows;
                }
                progress(((passed + part * way) / total).min(1.0));
            }
            passed += way;
            path.states.push(self.answer()?);
        }
        path.iterations = self.iterations;
        Ok(path)
    }

    fn pascals(&self) -> [f64; TUBES] {
        self.gas().map(|p| p * self.modulus)
    }

    fn place(&self) -> Place {
        let states = self.tubes.iter().enumerate().map(|(i, t)| self.symmetry.solves(i).then(|| t.state.clone()));
        Place { plate: self.plate, force: self.force, states: states.collect(), gas: self.gas() }
    }

    fn restore(&mut self, place: Place) -> Result<(), SystemError> {
        (self.plate, self.force) = (place.plate, place.force);
        for ((tube, state), gas) in self.tubes.iter_mut().zip(place.states).zip(place.gas) {
            if let Some(state) = state {
                tube.state = state;
            }
            tube.state.gas = gas;
        }
        self.carry();
        self.linearise()
    }

    /// Goes to the pressures `gas` and the force `force` in as many steps as it takes.
    fn go(&mut self, gas: [f64; TUBES], force: Vector3<f64>) -> Result<(), SystemError> {
        let (from, from_force) = (self.gas(), self.force);
        let (mut done, mut step) = (0.0, 1.0_f64);
        while done < 1.0 {
            let part = (done + step).min(1.0);
            let before = self.place();
            let rate = self.rate(std::array::from_fn(|i| (gas[i] - from[i]) * (part - done)))?;
            self.advance(&rate, 1.0);
            self.force = from_force + (force - from_force) * part;
            for (tube, gas) in self.tubes.iter_mut().zip(between(&from, &gas, part)) {
                tube.state.gas = gas;
            }
            match self.solve() {
                Ok(iterations) => {
                    self.iterations += iterations;
                    done = part;
                    step *= 2.0;
                }
                Err(error) => {
                    step *= 0.5;
                    self.restore(before)?;
                    if step < SMALLEST {
                        return Err(error);
                    }
                }
            }
        }
        Ok(())
    }

    fn inertia(&self) -> Inertia {
        let values = self.closed().0.symmetric_eigenvalues();
        let inside = self.symmetry.sources.iter().map(|(source, _)| self.tubes[*source].system.negative_inside()).sum();
        Inertia { inside, plate: values.iter().filter(|&&e| e < 0.0).count(), least: values.min() }
    }

    /// The pressures, Pa, between `before` and here at which stability is lost; where it is the plate that gives way,
    /// where its least eigenvalue vanishes. Ends where it began.
    fn pinned(&mut self, before: &Place, inertia: Inertia) -> Result<[f64; TUBES], SystemError> {
        let (here, force) = (self.place(), self.force);
        let (mut sound, mut lost) = ((0.0, inertia), (1.0, self.inertia()));
        for _ in 0..LOOKS {
            let way = lost.0 - sound.0;
            if way < SHARP {
                break;
            }
            // Not at the ends, lest one of them never moves.
            let share = if lost.1.inside > 0 { 0.5 } else { sound.1.least / (sound.1.least - lost.1.least) };
            let part = sound.0 + way * share.clamp(0.1, 0.9);
            self.restore(before.clone())?;
            if self.go(between(&before.gas, &here.gas, part), force).is_err() {
                break;
            }
            let found = self.inertia();
            if found.lost() { lost = (part, found) } else { sound = (part, found) }
        }
        let share = if lost.1.inside > 0 { 0.5 } else { sound.1.least / (sound.1.least - lost.1.least) };
        let part = sound.0 + (lost.0 - sound.0) * share.clamp(0.0, 1.0);
        let at = between(&before.gas, &here.gas, part).map(|p| p * self.modulus);
        self.restore(here)?;
        Ok(at)
    }

    /// The closest two tubes and the distance of their surfaces, m.
    fn clearance(&self) -> Option<([usize; 2], f64)> {
        let lines: Vec<(usize, Centreline)> = (0..TUBES)
            .map(|i| {
                let (source, signs) = &self.symmetry.sources[i];
                let Self { planes, outer, .. } = self;
                let super::Bonded { state, system, .. } = &self.tubes[*source];
                // Mirrors and half turns act on a tube's own x and y as on the plate's.
                let sides = Vector3::new(signs[2], signs[3], 1.0);
                let rate = state.cap[TURN] / system.body.length;
                let line = planes.iter().zip(outer).map(|(z, nodes)| {
                    let at = |n: usize| state.positions[n];
                    let middle: Vector3<f64> = nodes.iter().map(|&(n, weight)| at(n) * weight).sum();
                    let radius: f64 = nodes.iter().map(|&(n, weight)| (at(n) - middle).xy().norm() * weight).sum();
                    let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), rate * z) * middle;
                    ((self.tubes[i].arm + turned.component_mul(&sides)) * self.radius, radius * self.radius)
                });
                let (points, radii) = line.unzip();
                (i, Centreline::through(points, radii))
            })
            .collect();
        least_clearance(&lines)
    }

    /// The last equilibrium in SI units.
    fn answer(&self) -> Result<PlateEquilibrium, SystemError> {
        let Inertia { inside, plate, .. } = self.inertia();
        let expected = self.tubes.iter().map(|t| t.system.body.pressures()).sum();
        let unit = self.modulus * self.radius * self.radius;
        let nothing = Wrench { force: Vector3::zeros(), moment: Vector3::zeros() };
        let mut on_plate = [nothing; TUBES];
        for (i, of) in on_plate.iter_mut().enumerate() {
            let tube = &self.tubes[i];
            let work = self.cap_residual(i).map(|f| -f * unit);
            // None where the plate has turned over, which nothing can have done on the way.
            let (force, moment) = wrench(&tube.state.cap, &tube.system.body.cap_center, &work)
                .ok_or(SystemError::Sparse(SparseError::Singular(COORDINATES)))?;
            *of = Wrench { force, moment: moment * self.radius };
        }
        Ok(PlateEquilibrium {
            pressures: self.pascals(),
            position: position(&self.plate, &self.tubes[0].system.body.cap_center) * self.radius,
            rotation: UnitQuaternion::from_rotation_matrix(&rotation(&self.plate)),
            on_plate,
            negative_pivots: expected + inside + plate,
            expected_negative_pivots: expected,
            least_clearance: self.clearance(),
        })
    }
}

impl Inertia {
    fn lost(&self) -> bool {
        self.inside + self.plate > 0
    }
}

fn between(a: &[f64; TUBES], b: &[f64; TUBES], part: f64) -> [f64; TUBES] {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * part)
}

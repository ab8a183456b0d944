//! The reference of a module: four finite tubes bonded to one rigid plate.
//!
//! Each tube is a [`System`] of its own whose cap the plate carries (`plate`). Newton's step condenses every tube
//! to the six coordinates of its cap by its own factorisation, all four at once, and closes on the plate:
//!
//! ```text
//!     K = sum( J^T S J + f . J' ),   K dg = -sum( J^T r ) + loads        J = dq/dg, cap's coordinates by the plate's
//! ```
//!
//! with the tube's Schur complement S, its condensed residual r and the derivatives f of its energy by q. It is the
//! step of the whole system, and converges as that does. **Inertia**: by Haynsworth, what each tube has with its cap
//! held, plus the negative eigenvalues of K.

mod plate;

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use rayon::prelude::*;

use self::plate::{Joint, carried, position, rotation, wrench};
use super::SolidError;
use super::body::State;
use super::cap::{AXIAL, COORDINATES, Coordinates, LATERAL};
use super::mesh::{self, Mesh, Part};
use super::system::{Dead, Direction, FORCE_TOLERANCE, Pace, SAME, System, SystemError};
use crate::fem::module::{Wrench, square};
use crate::fem::sparse::SparseError;
use crate::fem::tube::Tube;

/// Tubes of a module.
pub const TUBES: usize = 4;
/// Most tangents of one step.
const MOST_TANGENTS: usize = 12;
/// Smallest part of a step that is tried.
const SMALLEST: f64 = 1.0 / 64.0;
/// Largest step of a pressure that is tried, in units of the shear modulus: 2 psi for the reference FREE.
const LARGEST_STEP: f64 = 0.0355;

/// A tube and where it stands.
struct Bonded {
    system: System,
    state: State,
    /// From the plate's centre, and of the base from the origin.
    arm: Vector3<f64>,
    joint: Joint,
}

impl Bonded {
    /// Goes where the plate carries the cap.
    fn carry(&mut self, plate: &Coordinates) {
        self.joint = Joint::of(plate, &self.arm);
        self.state.cap = self.joint.cap;
        self.system.body.carry(&mut self.state);
    }

    fn linearise(&mut self) -> Result<(), SystemError> {
        self.system.evaluate(&self.state, true)?;
        self.system.factorize()
    }

    /// What the tube does when the plate moves by `plate` and its gas by `gas`.
    fn moved(&self, with_residual: bool, plate: &Vector, gas: f64) -> Direction {
        let cap = (self.joint.slope * plate).into();
        let mut direction = self.system.moved(with_residual, cap, gas);
        self.system.recover(&self.state, with_residual, &mut direction);
        direction
    }
}

type Vector = SVector<f64, COORDINATES>;

/// A change of everything with the pressures.
struct Rate {
    plate: Vector,
    tubes: Vec<Direction>,
}

/// An equilibrium of the module. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PlateEquilibrium {
    /// Gauge pressures, Pa.
    pub pressures: [f64; TUBES],
    /// The plate's centre, m from the middle of the bases.
    pub position: Vector3<f64>,
    /// Its rotation from rest.
    pub rotation: UnitQuaternion<f64>,
    /// What each tube does to the plate, about the centre of its own cap, in the fixed frame.
    pub on_plate: [Wrench; TUBES],
    /// Negative pivots of the saddle-point matrix.
    pub negative_pivots: usize,
    /// Those that a stable state has: one for each pressure unknown of the rubber.
    pub expected_negative_pivots: usize,
}

impl PlateEquilibrium {
    /// Whether the energy is at a minimum at these pressures, among the motions that the mesh can make.
    pub fn stable(&self) -> bool {
        self.negative_pivots == self.expected_negative_pivots
    }
}

/// Equilibria at the pressures asked for, as far as they exist.
#[derive(Clone, Debug, PartialEq)]
pub struct ModulePath {
    /// One for each set of pressures reached, in the order asked for.
    pub states: Vec<PlateEquilibrium>,
    /// Where no further step converges, if it ended early, Pa.
    pub stuck: Option<[f64; TUBES]>,
    /// Newton iterations in all.
    pub iterations: usize,
}

/// Four tubes A, B, C, D on a square, A at (+, +), then counter-clockwise, under one rigid plate.
pub struct SolidModule {
    tubes: Vec<Bonded>,
    plate: Coordinates,
    force: Vector3<f64>,
    radius: f64,
    modulus: f64,
    iterations: usize,
}

impl SolidModule {
    /// Meshes `tube` of `length` m four times with the winding angles `gammas` (rad, signed), centre to centre
    /// `spacing` m. The mesh must be of the whole circumference. Neighbours may touch unseen: there is no contact.
    pub fn new(
        tube: &Tube,
        length: f64,
        gammas: [f64; TUBES],
        mesh: &Mesh,
        spacing: f64,
    ) -> Result<SolidModule, SolidError> {
        let least = 2.0 * tube.validated()?.outer_radius();
        if !(spacing >= least && spacing.is_finite()) {
            return Err(SolidError::Spacing { spacing, least });
        }
        if mesh.part == Part::Sector {
            return Err(SolidError::Lateral);
        }
        let radius = tube.outer_radius();
        let plate = [0.0; COORDINATES];
        let mut tubes: Vec<Bonded> = Vec::with_capacity(TUBES);
        for (gamma, base) in gammas.into_iter().zip(square(spacing / radius)) {
            let tube = Tube { gamma, ..*tube }.validated()?;
            let body = mesh::tube_body(&tube, length, mesh, None)?;
            let system = match tubes.first() {
                Some(first) => first.system.alike(body),
                None => System::new(body, [false; COORDINATES]),
            };
            let system = system.map_err(SystemError::from)?;
            let (state, joint) = (system.body.rest(), Joint::of(&plate, &base));
            tubes.push(Bonded { system, state, arm: base, joint });
        }
        let modulus = tube.law.shear_modulus();
        Ok(SolidModule { tubes, plate, force: Vector3::zeros(), radius, modulus, iterations: 0 })
    }

    /// Unknowns: displacements, pressures in the rubber, the plate.
    pub fn unknowns(&self) -> usize {
        self.tubes.iter().map(|t| t.system.size() + t.system.body.pressures()).sum::<usize>() + COORDINATES
    }

    /// Equilibria from rest under the dead `force` (N, at the plate's centre) at the gauge pressures `pressures`, Pa,
    /// one set after the other, each approached along a straight line; `progress` is told the share of the way, 0 to
    /// 1. A path that ends early says where.
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
        self.plate = [0.0; COORDINATES];
        (self.force, self.iterations) = (Vector3::zeros(), 0);
        for tube in &mut self.tubes {
            tube.state = tube.system.body.rest();
            tube.carry(&self.plate);
        }
        self.linearise()?;
        let force = force / (self.modulus * self.radius * self.radius);
        self.go([0.0; TUBES], force)?;
        let mut path = ModulePath { states: Vec::new(), stuck: None, iterations: 0 };
        let mut passed = 0.0;
        let mut last = [0.0; TUBES];
        let way = |a: &[f64; TUBES], b: &[f64; TUBES]| (0..TUBES).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
        let ways: Vec<f64> = pressures.iter().map(|p| way(&std::mem::replace(&mut last, *p), p)).collect();
        let total = ways.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        for (goal, way) in pressures.iter().zip(&ways) {
            let goal = goal.map(|p| p / self.modulus);
            let start = self.gas();
            let steps = (way / self.modulus / LARGEST_STEP).ceil().max(1.0) as usize;
            for step in 1..=steps {
                let part = step as f64 / steps as f64;
                let gas = std::array::from_fn(|i| start[i] + (goal[i] - start[i]) * part);
                if self.go(gas, force).is_err() {
                    path.stuck = Some(self.gas().map(|p| p * self.modulus));
                    path.iterations = self.iterations;
                    return Ok(path);
                }
                progress(((passed + part * way) / total).min(1.0));
            }
            passed += way;
            path.states.push(self.answer()?);
        }
        path.iterations = self.iterations;
        Ok(path)
    }

    fn gas(&self) -> [f64; TUBES] {
        std::array::from_fn(|i| self.tubes[i].state.gas)
    }

    /// Goes to the pressures `gas` and the force `force` in as many steps as it takes.
    fn go(&mut self, gas: [f64; TUBES], force: Vector3<f64>) -> Result<(), SystemError> {
        let (from, from_force) = (self.gas(), self.force);
        let (mut done, mut step) = (0.0, 1.0_f64);
        while done < 1.0 {
            let part = (done + step).min(1.0);
            let before = (self.plate, self.force, self.tubes.iter().map(|t| t.state.clone()).collect::<Vec<_>>());
            let rate = self.rate(std::array::from_fn(|i| (gas[i] - from[i]) * (part - done)))?;
            self.advance(&rate, 1.0);
            self.force = from_force + (force - from_force) * part;
            for (i, tube) in self.tubes.iter_mut().enumerate() {
                tube.state.gas = from[i] + (gas[i] - from[i]) * part;
            }
            match self.solve() {
                Ok(iterations) => {
                    self.iterations += iterations;
                    done = part;
                    step *= 2.0;
                }
                Err(error) => {
                    step *= 0.5;
                    (self.plate, self.force) = (before.0, before.1);
                    for (tube, state) in self.tubes.iter_mut().zip(before.2) {
                        tube.state = state;
                        tube.carry(&self.plate);
                    }
                    self.linearise()?;
                    if step < SMALLEST {
                        return Err(error);
                    }
                }
            }
        }
        Ok(())
    }

    fn linearise(&mut self) -> Result<(), SystemError> {
        self.tubes.par_iter_mut().try_for_each(Bonded::linearise)
    }

    /// The force's energy by the plate's coordinates.
    fn dead(&self) -> Dead {
        let mut loads = [0.0; COORDINATES];
        for (q, f) in [LATERAL[0], LATERAL[1], AXIAL].into_iter().zip(&self.force) {
            loads[q] = *f;
        }
        Dead::of(&loads, &self.plate)
    }

    /// K and the condensed residual at the last linearisation.
    fn closed(&self) -> (SMatrix<f64, COORDINATES, COORDINATES>, Vector) {
        let dead = self.dead();
        let (mut stiffness, mut residual) = (dead.second, dead.slope);
        for Bonded { system, joint, .. } in &self.tubes {
            let condensed = system.condensed();
            stiffness +=
                joint.slope.tr_mul(&(condensed.stiffness * joint.slope)) + joint.second(&system.cap_residual());
            residual += joint.slope.tr_mul(&condensed.residual);
        }
        ((stiffness + stiffness.transpose()) * 0.5, residual)
    }

    /// The change of the equilibrium when the pressures change by `gas`, from the last linearisation.
    fn rate(&self, gas: [f64; TUBES]) -> Result<Rate, SystemError> {
        let (stiffness, _) = self.closed();
        let mut right = Vector::zeros();
        for (tube, change) in self.tubes.iter().zip(gas) {
            right -= tube.joint.slope.tr_mul(&tube.system.condensed().by_gas) * change;
        }
        let plate = self.solved(&stiffness, &right)?;
        Ok(Rate {
            plate,
            tubes: self.tubes.iter().zip(gas).map(|(t, change)| t.moved(false, &plate, change)).collect(),
        })
    }

    fn solved(
        &self,
        stiffness: &SMatrix<f64, COORDINATES, COORDINATES>,
        right: &Vector,
    ) -> Result<Vector, SystemError> {
        stiffness.lu().solve(right).ok_or(SystemError::Sparse(SparseError::Singular(self.unknowns())))
    }

    /// Moves everything by `factor` times a rate; returns the largest displacement.
    fn advance(&mut self, rate: &Rate, factor: f64) -> f64 {
        let mut largest = factor.abs() * rate.plate.amax();
        for (q, change) in self.plate.iter_mut().zip(&rate.plate) {
            *q += factor * change;
        }
        for (tube, direction) in self.tubes.iter_mut().zip(&rate.tubes) {
            largest = largest.max(tube.system.advance(&mut tube.state, direction, factor));
            tube.carry(&self.plate);
        }
        largest
    }

    /// Largest force out of balance.
    fn imbalance(&self) -> f64 {
        let mut plate = self.dead().slope;
        let mut largest = 0.0_f64;
        for tube in &self.tubes {
            plate += carried(&tube.joint, &tube.system.cap_residual());
            largest = tube.system.residual().iter().fold(largest, |m, r| m.max(r.abs()));
        }
        largest.max(plate.amax())
    }

    /// Newton's iteration at the pressures of the states; a tangent is used again while it gains a digit at a time.
    fn solve(&mut self) -> Result<usize, SystemError> {
        let (mut pace, mut iterations) = (Pace::default(), 0);
        self.linearise()?;
        let first = self.imbalance();
        loop {
            let (stiffness, right) = self.closed();
            let plate = self.solved(&stiffness, &-right)?;
            let tubes = self.tubes.iter().map(|t| t.moved(true, &plate, 0.0)).collect();
            let last = self.advance(&Rate { plate, tubes }, 1.0);
            iterations += 1;
            self.tubes.par_iter_mut().try_for_each(|t| t.system.evaluate(&t.state, false))?;
            let residual = self.imbalance();
            if !(last + residual).is_finite() || (iterations > 2 && residual > 1e3 * first.max(1.0)) {
                return Err(SystemError::Diverged { iterations, residual });
            }
            let again = pace.again(last);
            let balanced = residual < FORCE_TOLERANCE && self.tubes.iter().all(|t| t.system.balanced_inside());
            if last < SAME && balanced {
                if pace.moved > SAME {
                    self.linearise()?;
                }
                return Ok(iterations);
            }
            if again {
                self.tubes.par_iter_mut().for_each(|t| t.system.resolve());
            } else if pace.tangents < MOST_TANGENTS {
                self.linearise()?;
                pace.renew();
            } else {
                return Err(SystemError::Diverged { iterations, residual });
            }
        }
    }

    /// The last equilibrium in SI units.
    fn answer(&self) -> Result<PlateEquilibrium, SystemError> {
        let (stiffness, _) = self.closed();
        let plate = stiffness.symmetric_eigenvalues().iter().filter(|&&e| e < 0.0).count();
        let inside: usize = self.tubes.iter().map(|t| t.system.negative_inside()).sum();
        let expected = self.tubes.iter().map(|t| t.system.body.pressures()).sum();
        let force = self.modulus * self.radius * self.radius;
        let nothing = Wrench { force: Vector3::zeros(), moment: Vector3::zeros() };
        let mut on_plate = [nothing; TUBES];
        for (of, Bonded { system, state, .. }) in on_plate.iter_mut().zip(&self.tubes) {
            let work = system.cap_residual().map(|f| -f * force);
            // None where the plate has turned over, which nothing can have done on the way.
            let (force, moment) = wrench(&state.cap, &system.body.cap_center, &work)
                .ok_or(SystemError::Sparse(SparseError::Singular(COORDINATES)))?;
            *of = Wrench { force, moment: moment * self.radius };
        }
        Ok(PlateEquilibrium {
            pressures: self.gas().map(|p| p * self.modulus),
            position: position(&self.plate, &self.tubes[0].system.body.cap_center) * self.radius,
            rotation: UnitQuaternion::from_rotation_matrix(&rotation(&self.plate)),
            on_plate,
            negative_pivots: expected + inside + plate,
            expected_negative_pivots: expected,
        })
    }
}

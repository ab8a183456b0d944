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
//! held, plus the negative eigenvalues of K. It is counted at every equilibrium on the way.
//!
//! Where the module is symmetric, one tube is solved for all that are its images (`symmetry`); K stays that of all
//! four, so that what breaks the symmetry is counted, too.

mod plate;
mod symmetry;
mod walk;

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use rayon::prelude::*;

use self::plate::{Joint, carried};
use self::symmetry::{Symmetry, image, imaged};
use super::SolidError;
use super::body::State;
use super::cap::{AXIAL, COORDINATES, Coordinates, LATERAL};
use super::mesh::{self, Mesh, Part};
use super::system::{Dead, Direction, FORCE_TOLERANCE, Pace, SAME, System, SystemError};
use crate::fem::module::{Wrench, square};
use crate::fem::sparse::SparseError;
use crate::fem::tube::Tube;

pub use walk::ModuleEnd;

/// Tubes of a module.
pub const TUBES: usize = 4;
/// Most tangents of one step.
const MOST_TANGENTS: usize = 12;

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
    /// None of the images.
    tubes: Vec<Option<Direction>>,
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
    /// The closest two tubes and the distance of their surfaces, m.
    pub least_clearance: Option<([usize; 2], f64)>,
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
    /// How it ended.
    pub end: ModuleEnd,
    /// Where the inertia of the straight way from one set of pressures to the next first says that stability is lost,
    /// Pa, as far as it was followed.
    pub unstable: Option<[f64; TUBES]>,
    /// Newton iterations in all.
    pub iterations: usize,
}

/// Four tubes A, B, C, D on a square, A at (+, +), then counter-clockwise, under one rigid plate.
pub struct SolidModule {
    tubes: Vec<Bonded>,
    gammas: [f64; TUBES],
    fibers: usize,
    /// Of every tube: heights of the divisions along it and the outer nodes there, with weights.
    planes: Vec<f64>,
    outer: Vec<Vec<(usize, f64)>>,
    symmetry: Symmetry,
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
        let (mut planes, mut outer) = (Vec::new(), Vec::new());
        for (gamma, base) in gammas.into_iter().zip(square(spacing / radius)) {
            let tube = Tube { gamma, ..*tube }.validated()?;
            let meshed = mesh::tube(&tube, length, mesh, None)?;
            let body = meshed.body;
            (planes, outer) = (meshed.planes, meshed.outer);
            let system = match tubes.first() {
                Some(first) => first.system.alike(body),
                None => System::new(body, [false; COORDINATES]),
            };
            let system = system.map_err(SystemError::from)?;
            let (state, joint) = (system.body.rest(), Joint::of(&plate, &base));
            tubes.push(Bonded { system, state, arm: base, joint });
        }
        let modulus = tube.law.shear_modulus();
        let (force, fibers, symmetry) = (Vector3::zeros(), tube.fibers, Symmetry::none());
        Ok(SolidModule { tubes, gammas, fibers, planes, outer, symmetry, plate, force, radius, modulus, iterations: 0 })
    }

    /// Unknowns: displacements, pressures in the rubber, the plate.
    pub fn unknowns(&self) -> usize {
        self.tubes.iter().map(|t| t.system.size() + t.system.body.pressures()).sum::<usize>() + COORDINATES
    }

    fn gas(&self) -> [f64; TUBES] {
        std::array::from_fn(|i| self.tubes[i].state.gas)
    }

    /// The tubes that are solved.
    fn solved(&self) -> impl Iterator<Item = &Bonded> {
        (0..TUBES).filter(|&i| self.symmetry.solves(i)).map(|i| &self.tubes[i])
    }

    /// Does `of` to every tube that is solved, all at once.
    fn each(&mut self, of: impl Fn(&mut Bonded) -> Result<(), SystemError> + Sync) -> Result<(), SystemError> {
        let symmetry = &self.symmetry;
        (self.tubes.par_iter_mut().enumerate()).filter(|(i, _)| symmetry.solves(*i)).try_for_each(|(_, tube)| of(tube))
    }

    fn linearise(&mut self) -> Result<(), SystemError> {
        self.each(Bonded::linearise)
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
        for (Bonded { joint, .. }, (source, signs)) in self.tubes.iter().zip(&self.symmetry.sources) {
            let system = &self.tubes[*source].system;
            let condensed = system.condensed();
            stiffness += joint.slope.tr_mul(&(image(&condensed.stiffness, signs) * joint.slope))
                + joint.second(&imaged(&system.cap_residual(), signs));
            residual += joint.slope.tr_mul(&condensed.residual.component_mul(signs));
        }
        ((stiffness + stiffness.transpose()) * 0.5, residual)
    }

    /// The change of the equilibrium when the pressures change by `gas`, from the last linearisation.
    fn rate(&self, gas: [f64; TUBES]) -> Result<Rate, SystemError> {
        let (stiffness, _) = self.closed();
        let mut right = Vector::zeros();
        for (i, (source, signs)) in self.symmetry.sources.iter().enumerate() {
            let by_gas = self.tubes[*source].system.condensed().by_gas.component_mul(signs);
            right -= self.tubes[i].joint.slope.tr_mul(&by_gas) * gas[i];
        }
        let plate = self.plate_step(&stiffness, &right)?;
        let tubes = self.tubes.iter().zip(gas).enumerate();
        let tubes = tubes.map(|(i, (t, change))| self.symmetry.solves(i).then(|| t.moved(false, &plate, change)));
        Ok(Rate { plate, tubes: tubes.collect() })
    }

    fn plate_step(
        &self,
        stiffness: &SMatrix<f64, COORDINATES, COORDINATES>,
        right: &Vector,
    ) -> Result<Vector, SystemError> {
        let step = stiffness.lu().solve(right).ok_or(SystemError::Sparse(SparseError::Singular(self.unknowns())))?;
        Ok(self.symmetry.project(&step))
    }

    /// Moves everything by `factor` times a rate; returns the largest displacement.
    fn advance(&mut self, rate: &Rate, factor: f64) -> f64 {
        let mut largest = factor.abs() * rate.plate.amax();
        for (q, change) in self.plate.iter_mut().zip(&rate.plate) {
            *q += factor * change;
        }
        for (tube, direction) in self.tubes.iter_mut().zip(&rate.tubes) {
            if let Some(direction) = direction {
                largest = largest.max(tube.system.advance(&mut tube.state, direction, factor));
            }
        }
        self.carry();
        largest
    }

    /// All caps go where the plate carries them.
    fn carry(&mut self) {
        for (i, tube) in self.tubes.iter_mut().enumerate() {
            if self.symmetry.solves(i) {
                tube.carry(&self.plate);
            } else {
                tube.joint = Joint::of(&self.plate, &tube.arm);
                tube.state.cap = tube.joint.cap;
            }
        }
    }

    /// Derivatives of tube `index`'s energy by its cap's coordinates.
    fn cap_residual(&self, index: usize) -> Coordinates {
        let (source, signs) = &self.symmetry.sources[index];
        imaged(&self.tubes[*source].system.cap_residual(), signs)
    }

    /// Largest force out of balance.
    fn imbalance(&self) -> f64 {
        let mut plate = self.dead().slope;
        for (i, tube) in self.tubes.iter().enumerate() {
            plate += carried(&tube.joint, &self.cap_residual(i));
        }
        self.solved().flat_map(|tube| tube.system.residual()).fold(plate.amax(), |m, r| m.max(r.abs()))
    }

    /// Newton's iteration at the pressures of the states; a tangent is used again while it gains a digit at a time.
    fn solve(&mut self) -> Result<usize, SystemError> {
        let (mut pace, mut iterations) = (Pace::default(), 0);
        self.linearise()?;
        let first = self.imbalance();
        loop {
            let (stiffness, right) = self.closed();
            let plate = self.plate_step(&stiffness, &-right)?;
            let tubes = self.tubes.iter().enumerate();
            let tubes = tubes.map(|(i, t)| self.symmetry.solves(i).then(|| t.moved(true, &plate, 0.0))).collect();
            let last = self.advance(&Rate { plate, tubes }, 1.0);
            iterations += 1;
            self.each(|t| t.system.evaluate(&t.state, false))?;
            let residual = self.imbalance();
            if !(last + residual).is_finite() || (iterations > 2 && residual > 1e3 * first.max(1.0)) {
                return Err(SystemError::Diverged { iterations, residual });
            }
            let again = pace.again(last);
            let balanced = residual < FORCE_TOLERANCE && self.solved().all(|t| t.system.balanced_inside());
            if last < SAME && balanced {
                if pace.moved > SAME {
                    self.linearise()?;
                }
                return Ok(iterations);
            }
            if again {
                self.each(|t| {
                    t.system.resolve();
                    Ok(())
                })?;
            } else if pace.tangents < MOST_TANGENTS {
                self.linearise()?;
                pace.renew();
            } else {
                return Err(SystemError::Diverged { iterations, residual });
            }
        }
    }
}

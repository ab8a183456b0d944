//! What FREEs that are not quite their model's do to the plate.
//!
//! No two FREEs of a batch are the same. What counts of their scatter is the winding angle, which decides how pressure
//! is shared between length and twist, the rubber's stiffness, and the wall, which carries the fibres farther out as
//! well. [`Family`] holds the module and, for each of these unknowns, the rod with a little more of it. On a held plate
//! an unknown u is a wrench w u, w by the change of the rod's law at the strains as they are ([`Module::pushed_by`]),
//! so that
//!
//! ```text
//!     x(u) = x + K^-1 sum(w u)
//! ```
//!
//! with w and the stiffness K of whatever state the module is in: corrected pressures are not the plan's, and a payload
//! that nobody knows of changes K far more than w.
//!
//! [`Course`] is where a plan is to take the plate.

use nalgebra::{SMatrix, Vector3};

use super::path::rising;
use super::{FREES, PlanError, Rest};
use crate::fem::module::{Module, ModuleError, ModuleScene, SceneError, State};
use crate::fem::rod::{Resolution, Rod};
use crate::fem::section::Mesh;
use crate::fem::section_law::{Request, SectionLaw, SectionLawError};
use crate::trajectory::{Segment, Shape};

/// Unknowns of the FREEs: four winding angles (of their magnitude, rad), then four stiffnesses of the rubber and four
/// thicknesses of the wall (relative).
pub const SCATTER: usize = 3 * FREES;

/// By how much the family's members differ: small against the scatter, large against the laws' own errors. By kind.
const STEPS: [f64; 3] = [0.25 * std::f64::consts::PI / 180.0, 0.02, 0.02];
/// Stations of a course: on the way up, and round a period.
const UP: usize = 8;
const ROUND: usize = 32;

/// The wrench (moment, force) about the plate's centre that each unknown is like, per its unit.
pub type Wrenches = SMatrix<f64, 6, SCATTER>;

/// A module and, for each unknown, the rod that has a little more of it.
#[derive(Debug)]
pub struct Family {
    module: Module,
    varied: Vec<(usize, Rod)>,
}

impl Family {
    /// The family of `scene`, whose laws, by `law`, reach up to `pressure`, Pa; each is asked for once.
    ///
    /// # Errors
    /// Where the scene is none, or a law is refused.
    pub fn new(
        scene: &ModuleScene,
        pressure: f64,
        mut law: impl FnMut(&Request) -> Result<SectionLaw, SectionLawError>,
    ) -> Result<Family, SceneError> {
        let mut known: Vec<SectionLaw> = Vec::new();
        let mut build = |scene: &ModuleScene| {
            scene.module(Mesh::default(), pressure, Resolution::DEFAULT, |request| {
                if let Some(found) = known.iter().find(|law| law.serves(request)) {
                    return Ok(found.clone());
                }
                let found = law(request)?;
                known.push(found.clone());
                Ok(found)
            })
        };
        let module = build(scene)?;
        let varied = (0..SCATTER).map(|unknown| {
            let (free, kind) = (unknown % FREES, unknown / FREES);
            let mut scene = scene.clone();
            let tube = &mut scene.frees[free].tube;
            match kind {
                0 => tube.gamma += STEPS[0] * tube.gamma.signum(),
                1 => tube.law = tube.law.with_shear_modulus(tube.law.shear_modulus() * (1.0 + STEPS[1])),
                _ => tube.wall *= 1.0 + STEPS[2],
            }
            build(&scene).map(|module| (free, module.mounts()[free].rod.clone()))
        });
        let varied = varied.collect::<Result<_, _>>()?;
        Ok(Family { module, varied })
    }

    /// The module.
    pub fn module(&self) -> &Module {
        &self.module
    }

    /// What the unknowns do to the plate of `state`, an equilibrium of the module.
    ///
    /// # Errors
    /// A law that refuses the rods' strains.
    pub fn wrenches(&self, state: &State) -> Result<Wrenches, ModuleError> {
        let pushes = self.module.pushed_by(state, &self.varied)?;
        Ok(Wrenches::from_fn(|row, unknown| pushes[unknown][row] / STEPS[unknown / FREES]))
    }
}

/// A plan of pressures, and where it is to take the plate's centre.
#[derive(Clone, Debug)]
pub struct Way<'a> {
    /// From rest to the first pressures, and back, s.
    pub lead: f64,
    /// How often the period runs.
    pub periods: u32,
    /// Over one period, rising from 0, s.
    pub times: &'a [f64],
    /// Of A, B, C, D at these times, Pa.
    pub pressures: &'a [[f64; 4]],
    /// Where the plate's centre is wanted at these times, m; empty for where the model puts it.
    pub targets: &'a [[f64; 3]],
}

/// A plan's way from rest up, through its periods and down again.
#[derive(Debug)]
pub struct Course {
    lead: Segment,
    period: f64,
    periods: f64,
    times: Vec<f64>,
    targets: Vec<Vector3<f64>>,
    /// Where the model puts the plate's centre, m, from rest to the first pressures, by their share.
    up: Vec<Vector3<f64>>,
    /// From the beginning to the end of a period.
    round: Vec<Vector3<f64>>,
    /// The least smooth margin on the way.
    least: f64,
}

impl Course {
    /// The course of `way` with the module of `rest`.
    ///
    /// # Errors
    /// Times that do not rise or are not as many as pressures and targets; a plan that the module cannot follow.
    pub fn new(rest: &Rest<'_>, way: &Way<'_>) -> Result<Course, PlanError> {
        rising(way.times, way.pressures.len())?;
        let (Some(first), Some(&period)) = (way.pressures.first(), way.times.last()) else {
            return Err(PlanError::invalid("the number of times", 0.0, "must be at least two"));
        };
        if !(way.targets.is_empty() || way.targets.len() == way.times.len()) {
            let count = way.targets.len() as f64;
            return Err(PlanError::invalid("the number of targets", count, "must be that of the times, or zero"));
        }
        let (mut state, mut least) = (rest.state().clone(), f64::INFINITY);
        let mut walk = |pressures: &[f64; 4]| {
            state = rest.module().equilibrium_from(&state, &rest.loads(pressures))?;
            least = least.min(rest.margin(&state).smooth);
            Ok::<_, PlanError>(state.position())
        };
        let up = (0..=UP).map(|k| walk(&first.map(|p| p * k as f64 / UP as f64)));
        let up = up.collect::<Result<Vec<_>, _>>()?;
        let round = (0..=ROUND).map(|k| {
            let t = period * k as f64 / ROUND as f64;
            let (k, share) = place(way.times, t);
            let (a, b) = (&way.pressures[k], &way.pressures[(k + 1).min(way.pressures.len() - 1)]);
            walk(&std::array::from_fn(|i| a[i] + share * (b[i] - a[i])))
        });
        let round = round.collect::<Result<_, _>>()?;
        Ok(Course {
            lead: Segment::new(0.0, Shape::Quintic, 1.0, way.lead),
            period,
            periods: f64::from(way.periods),
            times: way.times.to_vec(),
            targets: way.targets.iter().map(|p| Vector3::from(*p)).collect(),
            round,
            up,
            least,
        })
    }

    /// The least smooth margin that the plan itself leaves.
    pub fn least_margin(&self) -> f64 {
        self.least
    }

    /// Where the plate's centre is to be at the plan's time `t` (s), m.
    pub fn at(&self, t: f64) -> Vector3<f64> {
        let since = t - self.lead.duration;
        let over = since - self.period * self.periods;
        if since < 0.0 {
            return along(&self.up, self.lead.at(t.max(0.0)).0);
        }
        if over > 0.0 {
            // Down again from where it began, which is where a period ends.
            return along(&self.up, 1.0 - self.lead.at(over.min(self.lead.duration)).0);
        }
        let phase = since.rem_euclid(self.period);
        if self.targets.is_empty() {
            return along(&self.round, phase / self.period);
        }
        let (k, share) = place(&self.times, phase);
        let (a, b) = (self.targets[k], self.targets[(k + 1).min(self.targets.len() - 1)]);
        a.lerp(&b, share)
    }
}

/// Between which of `times` `t` is, and where.
fn place(times: &[f64], t: f64) -> (usize, f64) {
    let k = times.partition_point(|x| *x <= t).saturating_sub(1);
    match times.get(k + 1) {
        Some(next) => (k, ((t - times[k]) / (next - times[k])).clamp(0.0, 1.0)),
        None => (k, 0.0),
    }
}

/// The place at the share `x`, 0 to 1, of the way along `stations`.
fn along(stations: &[Vector3<f64>], x: f64) -> Vector3<f64> {
    let last = stations.len() - 1;
    let at = x.clamp(0.0, 1.0) * last as f64;
    let k = (at as usize).min(last - 1);
    stations[k].lerp(&stations[k + 1], at - k as f64)
}

//! What FREEs that are not quite their model's do to the plate.
//!
//! No two FREEs of a batch are the same. What counts of their scatter is the winding angle, which decides how pressure
//! is shared between length and twist, and the stiffness of the wall (its rubber, its thickness). [`Family`] holds
//! the module and, for each FREE, the same module with a little more of either. On a held plate each unknown u is a
//! wrench w u; w follows from how far the equilibria at the same pressures are apart,
//!
//! ```text
//!     w = K (x_varied - x) / step,      so that x(u) = x + K^-1 sum(w u)
//! ```
//!
//! with the stiffness K of whatever state the module is in when it is used: a payload that nobody knows of changes K
//! far more than w. [`Course`] has the wrenches along a plan, computed before it is run.

use nalgebra::{SMatrix, Vector3, Vector6};

use super::path::rising;
use super::{FREES, PlanError, Rest};
use crate::fem::module::{Loads, Module, ModuleScene, SceneError, State};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::fem::section_law::{Request, SectionLaw, SectionLawError};
use crate::trajectory::{Segment, Shape};

/// Unknowns of the FREEs: four winding angles (of their magnitude, rad), then four stiffnesses of the wall (relative).
pub const SCATTER: usize = 2 * FREES;

/// By how much the family's members differ: small against the scatter, large against the laws' own errors.
const ANGLE_STEP: f64 = 0.25 * std::f64::consts::PI / 180.0;
const STIFFNESS_STEP: f64 = 0.02;
/// Stations of a course: on the way up, and round a period.
const UP: usize = 8;
const ROUND: usize = 32;

/// The wrench (moment, force) about the plate's centre that each unknown is like, per its unit.
pub type Wrenches = SMatrix<f64, 6, SCATTER>;

/// A module and the same with one unknown more.
#[derive(Debug)]
pub struct Family {
    module: Module,
    varied: Vec<Module>,
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
            let mut scene = scene.clone();
            let tube = &mut scene.frees[unknown % FREES].tube;
            match unknown < FREES {
                true => tube.gamma += ANGLE_STEP * tube.gamma.signum(),
                false => tube.law = tube.law.with_shear_modulus(tube.law.shear_modulus() * (1.0 + STIFFNESS_STEP)),
            }
            build(&scene)
        });
        let varied = varied.collect::<Result<_, _>>()?;
        Ok(Family { module, varied })
    }

    /// The module.
    pub fn module(&self) -> &Module {
        &self.module
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

/// Where a plan's plate is to be at one instant, and what the unknowns do there.
#[derive(Clone, Copy, Debug)]
pub struct Station {
    /// Of the plate's centre, m.
    pub target: Vector3<f64>,
    /// See [`Wrenches`].
    pub wrenches: Wrenches,
}

/// A plan's way from rest up, through its periods and down again.
#[derive(Debug)]
pub struct Course {
    lead: Segment,
    period: f64,
    periods: f64,
    times: Vec<f64>,
    targets: Vec<Vector3<f64>>,
    /// From rest to the first pressures, by their share.
    up: Vec<Station>,
    /// From the beginning to the end of a period.
    round: Vec<Station>,
    /// The least smooth margin of the stations.
    least: f64,
}

impl Course {
    /// The course of `way` with the module of `rest`, which is that of `family`.
    ///
    /// # Errors
    /// Times that do not rise or are not as many as pressures and targets; a plan that the module, or one of its family,
    /// cannot follow.
    pub fn new(family: &Family, rest: &Rest<'_>, way: &Way<'_>) -> Result<Course, PlanError> {
        rising(way.times, way.pressures.len())?;
        let (Some(first), Some(&period)) = (way.pressures.first(), way.times.last()) else {
            return Err(PlanError::invalid("the number of times", 0.0, "must be at least two"));
        };
        if !(way.targets.is_empty() || way.targets.len() == way.times.len()) {
            let count = way.targets.len() as f64;
            return Err(PlanError::invalid("the number of targets", count, "must be that of the times, or zero"));
        }
        let mut walk = Walk::new(family, rest)?;
        let up = (0..=UP).map(|k| walk.to(&first.map(|p| p * k as f64 / UP as f64)));
        let up = up.collect::<Result<Vec<_>, _>>()?;
        let round = (0..=ROUND).map(|k| {
            let t = period * k as f64 / ROUND as f64;
            let (k, share) = place(way.times, t);
            let (a, b) = (&way.pressures[k], &way.pressures[(k + 1).min(way.pressures.len() - 1)]);
            walk.to(&std::array::from_fn(|i| a[i] + share * (b[i] - a[i])))
        });
        Ok(Course {
            lead: Segment::new(0.0, Shape::Quintic, 1.0, way.lead),
            period,
            periods: f64::from(way.periods),
            times: way.times.to_vec(),
            targets: way.targets.iter().map(|p| Vector3::from(*p)).collect(),
            round: round.collect::<Result<_, _>>()?,
            up,
            least: walk.least,
        })
    }

    /// The least smooth margin that the plan itself leaves.
    pub fn least_margin(&self) -> f64 {
        self.least
    }

    /// Where the plan is at its time `t`, s.
    pub fn at(&self, t: f64) -> Station {
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
        let station = along(&self.round, phase / self.period);
        if self.targets.is_empty() {
            return station;
        }
        let (k, share) = place(&self.times, phase);
        let (a, b) = (self.targets[k], self.targets[(k + 1).min(self.targets.len() - 1)]);
        Station { target: a.lerp(&b, share), ..station }
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

/// The station at the share `x`, 0 to 1, of the way along `stations`.
fn along(stations: &[Station], x: f64) -> Station {
    let last = stations.len() - 1;
    let at = x.clamp(0.0, 1.0) * last as f64;
    let k = (at as usize).min(last - 1);
    let (a, b, share) = (&stations[k], &stations[k + 1], at - k as f64);
    Station { target: a.target.lerp(&b.target, share), wrenches: a.wrenches + (b.wrenches - a.wrenches) * share }
}

/// The family on its way along a plan.
struct Walk<'a> {
    family: &'a Family,
    rest: &'a Rest<'a>,
    state: State,
    varied: Vec<State>,
    least: f64,
}

impl<'a> Walk<'a> {
    fn new(family: &'a Family, rest: &'a Rest<'a>) -> Result<Walk<'a>, PlanError> {
        let dead = rest.loads(&[0.0; FREES]);
        let varied = family.varied.iter().map(|module| module.equilibrium(&dead)).collect::<Result<_, _>>()?;
        Ok(Walk { family, rest, state: rest.state().clone(), varied, least: f64::INFINITY })
    }

    /// The station at `pressures`.
    fn to(&mut self, pressures: &[f64; 4]) -> Result<Station, PlanError> {
        let loads: Loads = self.rest.loads(pressures);
        self.state = self.family.module.equilibrium_from(&self.state, &loads)?;
        self.least = self.least.min(self.rest.margin(&self.state).smooth);
        let stiffness = self.state.stiffness();
        let mut wrenches = Wrenches::zeros();
        for (unknown, (module, state)) in self.family.varied.iter().zip(&mut self.varied).enumerate() {
            *state = module.equilibrium_from(state, &loads)?;
            let step = if unknown < FREES { ANGLE_STEP } else { STIFFNESS_STEP };
            wrenches.set_column(unknown, &(stiffness * apart(state, &self.state) / step));
        }
        Ok(Station { target: self.state.position(), wrenches })
    }
}

/// The small motion (rotation, translation of the centre) from `b` to `a`.
fn apart(a: &State, b: &State) -> Vector6<f64> {
    let turn = (a.rotation() * b.rotation().inverse()).scaled_axis();
    let shift = a.position() - b.position();
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

//! What the rods say of a module at rows of pressures: poses, resultants, stability, how far all that can be trusted.

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::{Kind, Loads, Module, ModuleError, ModuleScene, State, Wrench};

/// Looks along the way to loads that have no stable equilibrium, for the first fault.
const LOOKS: u32 = 16;
/// How sharply the first fault is found, as a share of the loads.
const SHARPNESS: f64 = 1e-4;

/// The plate at rest under one row of pressures. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// Plate's centre, m.
    pub position: Vector3<f64>,
    /// Plate's rotation from rest.
    pub rotation: UnitQuaternion<f64>,
    /// What each FREE does to the plate, about its own tip, in the fixed frame.
    pub on_plate: [Wrench; 4],
    /// Negative pivots of the tangent: 0 is stable.
    pub negative_pivots: i32,
    /// Least distance between the surfaces of two FREEs (from 0) and which, m.
    pub least_clearance: Option<([usize; 2], f64)>,
    /// Estimated error of the position that the rods' resolution makes, m: that of the resolution below the one
    /// answered. Infinite where it is not known.
    pub discretisation_error: f64,
}

/// Where the branch of stable equilibria from rest ends on the straight way from no loads to a row's loads.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Share of the loads, 0 to 1.
    pub fraction: f64,
    /// What happens there.
    pub reason: Reason,
}

/// Why a branch of stable equilibria ends.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// Rods buckle or the load turns.
    Critical(Kind),
    /// The model ends: tubes touch, a law's domain, no equilibrium.
    Module(ModuleError),
}

/// The answer to one row.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Gauge pressures of A, B, C, D, Pa.
    pub pressures: [f64; 4],
    /// The equilibrium on the branch from rest, stable or not; none where the branch ends before.
    pub pose: Option<Pose>,
    /// Where stability or the branch ended on the way; none where the pose is stable.
    pub limit: Option<Limit>,
}

impl std::fmt::Display for Limit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let share = 100.0 * self.fraction;
        match &self.reason {
            Reason::Critical(Kind::Bifurcation) => write!(f, "the FREEs buckle at {share:.1} % of these loads"),
            Reason::Critical(Kind::Limit) => write!(f, "the load turns at {share:.1} % of these loads"),
            Reason::Module(error) => write!(f, "at {share:.1} % of these loads: {error}"),
        }
    }
}

/// The rods' answers to `rows` of gauge pressures (Pa), each followed from rest with the scene's other loads growing
/// alongside. `module` is that of `scene`; its resolution is what the error is estimated with, and a finer one's poses
/// are what is answered. What has no equilibrium is answered by the limit that it lies beyond.
pub fn answer(scene: &ModuleScene, module: &Module, rows: &[[f64; 4]]) -> Vec<Answer> {
    rows.par_iter().map(|row| one(scene, module, *row)).collect()
}

fn one(scene: &ModuleScene, module: &Module, pressures: [f64; 4]) -> Answer {
    let loads = scene.loads(pressures);
    let found = module.equilibrium(&loads);
    let mut reason = fault(&found);
    let pose = found.ok().and_then(|state| match module.refined(&state) {
        Ok((fine, finer)) => {
            let error = (finer.position() - state.position()).norm();
            let pose = pose(&fine, &finer, error);
            reason = reason.take().or_else(|| fault(&Ok(finer)));
            pose
        }
        // Where finer rods have no such equilibrium, nothing is known of the error.
        Err(_) => pose(module, &state, f64::INFINITY),
    });
    let limit = reason.map(|reason| first(module, &loads, reason));
    Answer { pressures, pose, limit }
}

/// What is wrong with an equilibrium; none where it is stable.
fn fault(found: &Result<State, ModuleError>) -> Option<Reason> {
    match found {
        Ok(state) if state.stable() => None,
        // A load that is given has no way past a turn: what it passes is another branch's crossing.
        Ok(_) => Some(Reason::Critical(Kind::Bifurcation)),
        Err(ModuleError::Ends { cause: None, .. }) => Some(Reason::Critical(Kind::Limit)),
        Err(ModuleError::Ends { cause: Some(cause), .. }) => Some(Reason::Module((**cause).clone())),
        Err(error) => Some(Reason::Module(error.clone())),
    }
}

/// Where on the way to `loads`, at which there is `reason`, the first fault is met.
fn first(module: &Module, loads: &Loads, reason: Reason) -> Limit {
    let none = Loads::pressures(vec![0.0; loads.pressures.len()]);
    let at = |fraction: f64| fault(&module.equilibrium(&none.towards(loads, fraction)));
    let mut sound = 0.0;
    let mut limit = Limit { fraction: 1.0, reason };
    for k in 1..LOOKS {
        let fraction = f64::from(k) / f64::from(LOOKS);
        match at(fraction) {
            None => sound = fraction,
            Some(reason) => {
                limit = Limit { fraction, reason };
                break;
            }
        }
    }
    while limit.fraction - sound > SHARPNESS {
        let fraction = 0.5 * (sound + limit.fraction);
        match at(fraction) {
            None => sound = fraction,
            Some(reason) => limit = Limit { fraction, reason },
        }
    }
    limit
}

fn pose(module: &Module, state: &State, discretisation_error: f64) -> Option<Pose> {
    let mut on_plate = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; 4];
    for (index, wrench) in on_plate.iter_mut().enumerate() {
        *wrench = state.on_plate(module, index)?;
    }
    Some(Pose {
        position: state.position(),
        rotation: state.rotation(),
        on_plate,
        negative_pivots: state.negative_pivots(),
        least_clearance: state.least_clearance(),
        discretisation_error,
    })
}

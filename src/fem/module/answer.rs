//! What the rods say of a module at rows of pressures: poses, resultants, stability, how far all that can be trusted.

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::{Kind, Module, ModuleError, ModuleScene, Path, State, Wrench};

/// Longest step (radians, lengths or load factors) in which a critical point is looked for.
const STEP: f64 = 0.05;

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
    /// Estimated error of the position that the rods' resolution makes, m.
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

/// The rods' answers to `rows` of gauge pressures (Pa), each followed from rest with the scene's other loads growing alongside.
/// `module` is that of `scene`. What has no equilibrium is answered by the limit that it lies beyond.
pub fn answer(scene: &ModuleScene, module: &Module, rows: &[[f64; 4]]) -> Vec<Answer> {
    rows.par_iter().map(|row| one(scene, module, *row)).collect()
}

fn one(scene: &ModuleScene, module: &Module, pressures: [f64; 4]) -> Answer {
    let loads = scene.loads(pressures);
    let ended = |error: ModuleError| match error {
        ModuleError::Ends { fraction, cause } => {
            let reason = cause.map_or(Reason::Critical(Kind::Limit), |cause| Reason::Module(*cause));
            Limit { fraction, reason }
        }
        error => Limit { fraction: 1.0, reason: Reason::Module(error) },
    };
    let state = match module.equilibrium(&loads) {
        Ok(state) => state,
        Err(error) => return Answer { pressures, pose: None, limit: Some(ended(error)) },
    };
    let limit = if state.stable() { None } else { Some(critical(module, &state).unwrap_or_else(ended)) };
    Answer { pressures, pose: pose(module, &state), limit }
}

/// Where the branch from rest to `state` turned unstable.
fn critical(module: &Module, state: &State) -> Result<Limit, ModuleError> {
    let to = state.loads();
    let nothing = to.towards(to, 0.0);
    let none = super::Loads::pressures(vec![0.0; nothing.pressures.len()]);
    let rest = module.equilibrium(&none)?;
    let found = Path::new(module, &rest, to, STEP)?.next_critical((-STEP, 1.0 + STEP))?;
    let lost = |c: super::Critical| Limit { fraction: c.mu, reason: Reason::Critical(c.kind) };
    Ok(found.map_or(Limit { fraction: 1.0, reason: Reason::Critical(Kind::Bifurcation) }, lost))
}

fn pose(module: &Module, state: &State) -> Option<Pose> {
    let mut on_plate = [Wrench { force: Vector3::zeros(), moment: Vector3::zeros() }; 4];
    for (index, wrench) in on_plate.iter_mut().enumerate() {
        *wrench = state.on_plate(module, index)?;
    }
    // Where the finer rods have no such equilibrium, nothing is known of the error.
    let error = module.discretisation_error(state).unwrap_or(f64::INFINITY);
    Some(Pose {
        position: state.position(),
        rotation: state.rotation(),
        on_plate,
        negative_pivots: state.negative_pivots(),
        least_clearance: state.least_clearance(),
        discretisation_error: error * module.length(),
    })
}

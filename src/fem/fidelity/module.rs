//! How far the rods of a module are from what they stand for.
//!
//! Relative like all errors here; the measure is `hypot(|d x|, r |d turn|)` over the largest `hypot(|x - rest|, r |turn|)`
//! of the answers, with the plate's position x, its turn, and the distance r of the FREEs from the plate's centre.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::Vector3;

use super::{Fidelity, FidelityError, Hold, Scene, ask, model_error};
use crate::fem::module::{Answer, Free, ModuleScene};
use crate::fem::section_law::Errors;
use crate::fem::tube::Tube;

/// Estimated relative discretisation error of the rods' `answers`, whose module's laws have the errors `law`: rods'
/// resolution, section's mesh and the law's interpolation (a stretch that is wrong on one side of the plate tilts it),
/// one on top of the other. Zero where nothing moves.
pub fn rods_discretisation_error(scene: &ModuleScene, rest: &Vector3<f64>, law: &Errors, answers: &[Answer]) -> f64 {
    let radius = FRAC_1_SQRT_2 * scene.spacing;
    let poses = || answers.iter().filter_map(|answer| answer.pose.as_ref());
    let moved = poses().map(|pose| (pose.position - rest).norm().hypot(radius * pose.rotation.angle()));
    let scale = moved.fold(0.0, f64::max);
    if scale == 0.0 {
        return 0.0;
    }
    let rods = poses().map(|pose| pose.discretisation_error).fold(0.0, f64::max);
    let length = scene.frees.iter().map(|free| free.length).fold(0.0, f64::max);
    let stretch = law.stretch * (length + 0.5 * length * length / scene.spacing);
    let twist = law.twist * length * radius;
    (rods + stretch + twist) / scale + law.mesh
}

/// Estimated relative model error of the rods: the part of the ends, which a rod does not have, in what one of the
/// FREEs does by itself, free, at `pressure` Pa. None for fibres without width.
///
/// # Errors
/// As [`ask`].
pub fn rods_model_error(scene: &ModuleScene, pressure: f64) -> Result<Option<f64>, FidelityError> {
    let right = |free: &Free| Scene {
        tube: Tube { gamma: free.tube.gamma.abs(), ..free.tube },
        length: free.length,
        hold: Hold::Free,
        pressures: vec![pressure],
    };
    let mut singles: Vec<Scene> = scene.frees.iter().map(right).collect();
    singles.dedup();
    let mut worst: Option<f64> = None;
    for single in &singles {
        let ends = model_error(single, &ask(single, Fidelity::Section, &mut |_| {})?)?;
        worst = worst.into_iter().chain(ends).reduce(f64::max);
    }
    Ok(worst)
}

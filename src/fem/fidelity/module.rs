//! How far the rods of a module are from what they stand for.
//!
//! Relative like all errors here; the measure is `hypot(|d x|, r |d turn|)` over the largest `hypot(|x - rest|, r
//! |turn|)` of the answers, with the plate's position x, its turn, and the distance r of the FREEs from the plate's
//! centre.

use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{Fidelity, FidelityError, Hold, Scene, ask, model_error};
use crate::fem::ends::{End, Ends};
use crate::fem::module::{Answer, Free, Kind, Limit, Module, ModuleError, ModuleScene, Pose, Reason};
use crate::fem::section::{Mesh, Section};
use crate::fem::section_law::Errors;
use crate::fem::solid::{self, ModuleEnd, ModulePath, PathEnd, PlateEquilibrium, Solid, SolidModule, Tip};
use crate::fem::tube::Tube;

/// Closed, free to stretch, held from turning: what the others of a module make of a FREE.
const UNTWISTED: Ends = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };
/// Share of a solid module's time that its usual mesh takes; the rest is the coarser one's.
const USUAL: f64 = 0.7;

/// Estimated relative discretisation error of the `answers` of `module`, the rods of `scene`, whose laws have the
/// errors `law`: rods' resolution, section's mesh and the law's interpolation (a stretch that is wrong on one side of
/// the plate tilts it, and so does a bending stiffness that is wrong in all rods), one on top of the other. Zero where
/// nothing moves.
pub fn rods_discretisation_error(scene: &ModuleScene, module: &Module, law: &Errors, answers: &[Answer]) -> f64 {
    let (rest, radius) = (module.rest(), FRAC_1_SQRT_2 * scene.spacing);
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
    let bending = moved_by_bending(scene, module, law.mostly, answers);
    (rods + stretch + twist + bending) / scale + law.mesh
}

/// How far rods whose bending stiffness is off by `error` put the plate from the `answers`, m. Infinite where they
/// cannot follow.
fn moved_by_bending(scene: &ModuleScene, module: &Module, error: f64, answers: &[Answer]) -> f64 {
    if !error.is_finite() {
        return f64::INFINITY;
    }
    let (other, radius) = (module.with_bending(1.0 + error), FRAC_1_SQRT_2 * scene.spacing);
    let moved = |answer: &Answer| -> Result<f64, ModuleError> {
        let loads = scene.loads(answer.pressures);
        let state = module.equilibrium(&loads)?;
        let moved = other.equilibrium_from(&state, &loads)?;
        let turned = radius * state.rotation().angle_to(&moved.rotation());
        Ok((state.position() - moved.position()).norm().hypot(turned))
    };
    let answered = answers.par_iter().filter(|answer| answer.pose.is_some());
    answered.map(|answer| moved(answer).unwrap_or(f64::INFINITY)).reduce(|| 0.0, f64::max)
}

/// Estimated relative model error of the rods: the part of the ends, which a rod does not have, in what one of the
/// FREEs does by itself, free, at `pressure` Pa, or at half of it where it has no equilibrium there by itself. None
/// where it has neither or the ends cannot be seen, and for fibres without width.
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
    let mut worst = 0.0;
    for mut single in singles {
        let mut answer = ask(&single, Fidelity::Section, &mut |_| {})?;
        if answer.points[0].rest.is_none() {
            single.pressures = vec![0.5 * pressure];
            answer = ask(&single, Fidelity::Section, &mut |_| {})?;
        }
        let known = answer.points[0].rest.is_some();
        match model_error(&single, &answer)? {
            Some(ends) if known && ends.is_finite() => worst = f64::max(worst, ends),
            _ => return Ok(None),
        }
    }
    Ok(Some(worst))
}

/// What the solid of the whole module says.
#[derive(Clone, Debug, PartialEq)]
pub struct SolidAnswers {
    /// To each row.
    pub answers: Vec<Answer>,
    /// Estimated relative discretisation error, by a coarser mesh and by the section's of as many elements round.
    pub discretisation_error: f64,
}

/// The mesh of a module's tubes: with strips two elements between the strip and the middle between two, as few along
/// the tube as their turn lets be.
pub fn module_mesh(tube: &Tube) -> solid::Mesh {
    solid::Mesh { around_growth: 6.0, first: 2e-3, most_turn: 1.0, ..solid::Mesh::whole(tube) }
}

/// What a solid of the whole module says of `rows` of gauge pressures (Pa), each followed from rest under all of the
/// scene's dead load; `progress` is told the share of the way, 0 to 1.
///
/// # Errors
/// FREEs that differ in more than their winding angles, a dead moment, rest curvature or a dead length, which the solid
/// does not have; a solid that fails otherwise than at a limit.
pub fn solid_answers(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    progress: &mut dyn FnMut(f64),
) -> Result<SolidAnswers, FidelityError> {
    let Free { tube, length, .. } = scene.frees[0];
    for free in &scene.frees {
        let alike = Tube { gamma: tube.gamma, ..free.tube } == tube && free.length == length;
        if !(alike && free.rest_curvature.norm() == 0.0 && free.dead_length == 0.0) {
            return Err(FidelityError::Module(
                "FREEs that differ in more than their winding angles or are not straight",
            ));
        }
    }
    if scene.moment.norm() > 0.0 {
        return Err(FidelityError::Module("a dead moment on the plate"));
    }
    let usual = module_mesh(&tube);
    let coarser = solid::Mesh { around_growth: 12.0, first: 4e-3, most_turn: 1.2, ..usual };
    let count = rows.len().max(1) as f64;
    let ask = |mesh: &solid::Mesh, from: f64, share: f64, progress: &mut dyn FnMut(f64)| {
        let gammas = scene.frees.map(|free| free.tube.gamma);
        let mut solid = SolidModule::new(&tube, length, gammas, mesh, scene.spacing)?;
        let force = scene.force + scene.gravity * scene.plate_mass;
        let paths = rows.iter().enumerate().map(|(i, row)| {
            solid.follow(&force, &[*row], &mut |part| progress(from + share * (i as f64 + part) / count))
        });
        paths.collect::<Result<Vec<ModulePath>, _>>()
    };
    let paths = ask(&usual, 0.0, USUAL, progress)?;
    let others = ask(&coarser, USUAL, 1.0 - USUAL, progress)?;
    let rest = Vector3::z() * length;
    let radius = FRAC_1_SQRT_2 * scene.spacing;
    let (mut apart, mut scale) = (0.0_f64, 0.0_f64);
    let answers = rows.iter().zip(paths).zip(&others).map(|((row, path), other)| {
        let (found, coarse) = (path.states.first(), other.states.first());
        let off = found.zip(coarse).map_or(f64::INFINITY, |(a, b)| {
            let turned = radius * a.rotation.angle_to(&b.rotation);
            apart = apart.max((a.position - b.position).norm().hypot(turned));
            (a.position - b.position).norm()
        });
        if let Some(found) = found {
            scale = scale.max((found.position - rest).norm().hypot(radius * found.rotation.angle()));
        }
        answer(*row, &path, off)
    });
    let answers = answers.collect();
    let highest = rows.iter().flatten().copied().fold(0.0, f64::max);
    let discretisation_error = if scale > 0.0 { apart / scale + across(&tube, highest)? } else { 0.0 };
    Ok(SolidAnswers { answers, discretisation_error })
}

fn answer(row: [f64; 4], path: &ModulePath, discretisation_error: f64) -> Answer {
    let highest = row.iter().copied().fold(0.0, f64::max);
    let share = |at: &[f64; 4]| if highest > 0.0 { at.iter().copied().fold(0.0, f64::max) / highest } else { 1.0 };
    let of = |fraction: f64, reason: Reason| Some(Limit { fraction, reason });
    // Whichever comes first on the way.
    let limit = match (&path.unstable, &path.end) {
        (Some(at), _) => of(share(at), Reason::Critical(Kind::Bifurcation)),
        (None, ModuleEnd::Reached) => None,
        (None, ModuleEnd::Stuck(at)) => {
            of(share(at), Reason::Module(ModuleError::Ends { fraction: share(at), cause: None }))
        }
        (None, ModuleEnd::Contact { tubes, pressures, clearance }) => {
            let contact = ModuleError::Contact { rods: *tubes, clearance: *clearance };
            of(share(pressures), Reason::Module(contact))
        }
    };
    let pose = path.states.first().map(|found: &PlateEquilibrium| Pose {
        position: found.position,
        rotation: found.rotation,
        on_plate: found.on_plate,
        negative_pivots: (found.negative_pivots - found.expected_negative_pivots) as i32,
        least_clearance: found.least_clearance,
        discretisation_error,
    });
    Answer { pressures: row, pose, limit }
}

/// Relative error that the elements across a tube make, as the section with as many of them has it; none is known of
/// line fibres, which have no converged one.
fn across(tube: &Tube, pressure: f64) -> Result<f64, FidelityError> {
    if tube.fiber_width == 0.0 {
        return Ok(f64::INFINITY);
    }
    let stretch = |mesh: Mesh| -> Result<Option<f64>, FidelityError> {
        let section = Section::new(tube, mesh)?;
        let mut state = section.rest()?;
        Ok(section.reach(&mut state, 0.5 * pressure, UNTWISTED)?.map(|found| found.stretch - 1.0))
    };
    let few = stretch(Mesh::Counted { radial: 1, strip: 1, gap: 2, growth: 6.0 })?;
    let many = stretch(Mesh::level(1))?;
    Ok(few.zip(many).map_or(f64::INFINITY, |(few, many)| (few / many - 1.0).abs()))
}

/// The dead length, m, of a FREE of `tube` and `length` m: with it a rod without ends, held from turning and free to
/// stretch, is as long at `pressure` Pa as the solid of the single FREE. Negative where the ends give more than the
/// middle, infinite or no number where the section does not stretch.
///
/// # Errors
/// As [`ask`]; where solid or section has no equilibrium at `pressure`.
pub fn dead_length(tube: &Tube, length: f64, pressure: f64) -> Result<f64, FidelityError> {
    let section = Section::new(tube, Mesh::level(2))?;
    let mut state = section.rest()?;
    let found = section.advance(&mut state, pressure, UNTWISTED)?;
    let mut solid = Solid::new(tube, length, &solid::Mesh::sector(tube), None)?;
    let path = solid.follow(&Tip::straight(UNTWISTED), &[pressure], &mut |_| {})?;
    match (path.states.first(), path.end) {
        (Some(whole), PathEnd::Reached) => Ok(length * (1.0 - (whole.stretch - 1.0) / (found.stretch - 1.0))),
        _ => Err(FidelityError::Single(pressure)),
    }
}

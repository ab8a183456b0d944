//! The tiers' answers to a scene.

use super::certified::{ENDS, SOLID, factor};
use super::joined::{Joined, joined};
use super::{Answer, Fidelity, FidelityError, Limit, Point, Rest, Scene, difference};
use crate::fem::ends::Equilibrium;
use crate::fem::linear::LinearSection;
use crate::fem::lumped::LumpedStiffness;
use crate::fem::section::{SectionError, curve_within};
use crate::fem::solid::{self, PathEnd, Solid, SolidEquilibrium, Station, Tip};
use crate::fem::tube::Tube;
use crate::model::{EquilibriumError, Free, Kinematics, Law, Load, Lumped};
use crate::units::PASCAL_PER_PSI;

/// Mass and inertia of the end in the lumped equations, kg and kg m2: at rest only its weight counts, and a scene has
/// none.
const NOTHING: f64 = 1e-12;
/// Relative discretisation error asked of the section where nothing else is asked.
const SECTION_TOLERANCE: f64 = 5e-3;
/// Share of the section's limit pressure up to which a coarse solid is asked.
const SAFE: f64 = 0.9;
/// Levels of the section's mesh on which the solid's ends are put: the first one that has not folded.
const LEVELS: [usize; 2] = [2, 1];
/// Share of the solid's time that its usual mesh takes; the rest is the coarse one's.
const USUAL: f64 = 0.9;

impl Scene {
    /// Checks what no tier can do without.
    pub(super) fn validated(&self) -> Result<(), FidelityError> {
        let tube = self.tube.validated()?;
        let least = 2.0 * tube.outer_radius();
        if !(self.length >= least && self.length.is_finite()) {
            return Err(FidelityError::Length { length: self.length, least });
        }
        match self.pressures.iter().find(|p| !p.is_finite()) {
            Some(&pressure) => Err(FidelityError::Pressure(pressure)),
            None => Ok(()),
        }
    }

    /// Indices of the pressures from zero up, and from zero down: the ways from rest.
    fn ways(&self) -> [Vec<usize>; 2] {
        let way = |negative: bool| {
            let mut way: Vec<usize> = (0..self.pressures.len()).collect();
            way.retain(|&i| (self.pressures[i] < 0.0) == negative);
            way.sort_by(|&a, &b| self.pressures[a].abs().total_cmp(&self.pressures[b].abs()));
            way
        };
        [way(false), way(true)]
    }
}

/// What `fidelity` says of `scene`; `progress` is told the share of the way, 0 to 1, by the tier that takes seconds,
/// the solid.
///
/// # Errors
/// Where the scene is none, or the tier fails otherwise than at a limit.
pub fn ask(scene: &Scene, fidelity: Fidelity, progress: &mut dyn FnMut(f64)) -> Result<Answer, FidelityError> {
    scene.validated()?;
    match fidelity {
        Fidelity::Linear => linear(scene),
        Fidelity::Nonlinear => nonlinear(scene),
        Fidelity::Section => section(scene, SECTION_TOLERANCE),
        Fidelity::Solid => {
            let answer = solid(scene, progress)?;
            Ok(Answer { discretisation_error: factor(SOLID) * answer.discretisation_error, ..answer })
        }
    }
}

/// Estimated relative model error of `answer`, as the module's theory has it; none of the solid, which leaves nothing
/// out, and of line fibres, which have no section to be compared with.
///
/// # Errors
/// As [`ask`].
pub fn model_error(scene: &Scene, answer: &Answer) -> Result<Option<f64>, FidelityError> {
    match answer.fidelity {
        Fidelity::Solid => Ok(None),
        _ if scene.tube.fiber_width == 0.0 => Ok(None),
        Fidelity::Section => end_effects(scene, answer).map(Some),
        Fidelity::Linear | Fidelity::Nonlinear => {
            let section = section(scene, SECTION_TOLERANCE)?;
            Ok(Some(difference(&answer.points, &section.points, scene)))
        }
    }
}

/// Bound of the relative part of the ends in the scene's answer: [`ends_seen`] by the factor that makes it one.
pub(super) fn end_effects(scene: &Scene, section: &Answer) -> Result<f64, FidelityError> {
    Ok(factor(ENDS) * ends_seen(scene, section)?)
}

/// Relative part of the ends as a coarse solid has it, where `section` has an equilibrium: at its lowest and at its
/// highest pressure, and there no nearer to a limit than a coarse mesh can tell. Infinite where it cannot be seen.
pub(super) fn ends_seen(scene: &Scene, section: &Answer) -> Result<f64, FidelityError> {
    let most = section.limit.as_ref().map_or(f64::INFINITY, |limit| SAFE * limit.pressure.abs());
    let stable = section.points.iter().filter(|p| p.rest.is_some() && p.pressure != 0.0);
    let mut pressures: Vec<f64> = stable.map(|p| p.pressure.clamp(-most, most)).collect();
    if pressures.is_empty() {
        return Ok(0.0);
    }
    pressures.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let pressures: Vec<f64> = pressures.first().into_iter().chain(pressures.last()).copied().collect();
    let scene = Scene { pressures, ..scene.clone() };
    let (mut without, mut with) = (Vec::new(), Vec::new());
    for (_, states) in path(&scene, &ends(&scene.tube), &mut |_| {})?.ways {
        let Some(Joined { far, whole }) = joined(&scene, &states, &LEVELS)? else { return Ok(f64::INFINITY) };
        without.extend(far);
        with.extend(whole);
    }
    Ok(if with.is_empty() { f64::INFINITY } else { difference(&without, &with, &scene) })
}

/// [`difference`] over the pressures at which both have an equilibrium: a limit moves a little with mesh and length.
fn common_difference(points: &[Point], reference: &[Point], scene: &Scene) -> f64 {
    let both = points.iter().zip(reference).filter(|(a, b)| a.rest.is_some() && b.rest.is_some());
    let (points, reference): (Vec<Point>, Vec<Point>) = both.map(|(a, b)| (*a, *b)).unzip();
    difference(&points, &reference, scene)
}

fn empty(scene: &Scene) -> Vec<Point> {
    scene.pressures.iter().map(|&pressure| Point { pressure, rest: None }).collect()
}

fn linear(scene: &Scene) -> Result<Answer, FidelityError> {
    let law = LinearSection::new(&scene.tube)?;
    let points = scene.pressures.iter().map(|&pressure| {
        let rest = Some(Rest::from(&law.solve(pressure, scene.hold.ends())));
        Point { pressure, rest }
    });
    Ok(Answer {
        fidelity: Fidelity::Linear,
        points: points.collect(),
        limit: None,
        discretisation_error: 0.0,
        profile: Vec::new(),
    })
}

/// Eqs 1-4 at rest without gravity: inextensible fibres, and the springs of the linear section law.
fn nonlinear(scene: &Scene) -> Result<Answer, FidelityError> {
    let Scene { tube, length, .. } = scene;
    let springs = LumpedStiffness::by_closed_form(tube, *length)?;
    let free = Free {
        gamma: tube.gamma,
        length: *length,
        radius: tube.outer_radius(),
        mass: NOTHING,
        inertia: NOTHING,
        axial_stiffness: springs.axial,
        torsional_stiffness: springs.torsional,
        axial_damping: 0.0,
        torsional_damping: 0.0,
    };
    let lumped = Lumped::new(free, Law::Nonlinear(Kinematics::Exact))?;
    let mut limit = None;
    let points = scene.pressures.iter().map(|&pressure| {
        let (extension, rotation) = match scene.hold {
            super::Hold::Blocked => (0.0, 0.0),
            super::Hold::Free => match lumped.equilibrium_at_pressure(pressure, Load::default()) {
                Ok(found) => (found.extension, found.rotation),
                Err(error) => {
                    let at = match &error {
                        EquilibriumError::RunsAway { last } => last.pressure,
                        EquilibriumError::Domain(_) => pressure,
                    };
                    limit = Some(Limit { pressure: at, reason: error.to_string() });
                    return Point { pressure, rest: None };
                }
            },
        };
        let Ok(actuation) = lumped.actuation(extension, rotation) else { return Point { pressure, rest: None } };
        let rest = Rest {
            twist: rotation / length,
            stretch: 1.0 + extension / length,
            outer_radius_mean: actuation.radius,
            outer_radius_at_fiber: Some(actuation.radius),
            force: actuation.force * pressure - springs.axial * extension,
            moment: actuation.moment * pressure - springs.torsional * rotation,
        };
        Point { pressure, rest: Some(rest) }
    });
    let points = points.collect();
    Ok(Answer { fidelity: Fidelity::Nonlinear, points, limit, discretisation_error: 0.0, profile: Vec::new() })
}

/// The section on a mesh chosen for the relative error `tolerance`.
pub(super) fn section(scene: &Scene, tolerance: f64) -> Result<Answer, FidelityError> {
    if scene.tube.fiber_width == 0.0 {
        return Err(FidelityError::Line);
    }
    let mut points = empty(scene);
    let (mut limit, mut discretisation_error) = (None, 0.0_f64);
    for way in scene.ways().iter().filter(|way| !way.is_empty()) {
        let pressures: Vec<f64> = way.iter().map(|&i| scene.pressures[i]).collect();
        let curve = curve_within(&scene.tube, &pressures, scene.hold.ends(), tolerance)?;
        let any = curve.points.iter().flatten().any(|point| point.pressure != 0.0);
        let error = curve.error.unwrap_or(if any { f64::INFINITY } else { 0.0 });
        discretisation_error = discretisation_error.max(error);
        for (&i, found) in way.iter().zip(curve.points) {
            match found {
                Ok(equilibrium) => points[i].rest = Some(Rest::from(&equilibrium)),
                Err(SectionError::BeyondLimit { limit: at, .. }) => {
                    // The way up comes first, and is the one that is told.
                    limit.get_or_insert(Limit { pressure: at.pressure, reason: at.kind.to_string() });
                }
                Err(error) => return Err(error.into()),
            }
        }
    }
    let mut answer = Answer { fidelity: Fidelity::Section, points, limit, discretisation_error, profile: Vec::new() };
    if answer.limit.is_some() && !answer.moves() {
        answer.discretisation_error = f64::INFINITY;
    }
    Ok(answer)
}

/// The solid on its usual mesh, its discretisation error estimated against the coarse one, and, as the section knows
/// better what is across the tube, against its own ends on the section: whichever is larger.
pub(super) fn solid(scene: &Scene, progress: &mut dyn FnMut(f64)) -> Result<Answer, FidelityError> {
    let Walked { points, limit, profile, ways } =
        path(scene, &solid::Mesh::sector(&scene.tube), &mut |share| progress(USUAL * share))?;
    let other = path(scene, &coarse(&scene.tube), &mut |share| progress(USUAL + (1.0 - USUAL) * share))?;
    let mut discretisation_error = common_difference(&other.points, &points, scene);
    if scene.tube.fiber_width > 0.0 {
        for (way, states) in &ways {
            let Some(Joined { whole, .. }) = joined(scene, states, &LEVELS)? else { continue };
            let own: Vec<Point> = way.iter().zip(&whole).map(|(&i, _)| points[i]).collect();
            discretisation_error = discretisation_error.max(difference(&own, &whole, scene));
        }
    }
    Ok(Answer { fidelity: Fidelity::Solid, points, limit, discretisation_error, profile })
}

/// A mesh that only the ends are looked at with: a quarter of the elements each way, and still small ones at the ends.
/// What its elements are off across the tube cancels ([`joined`]).
fn ends(tube: &Tube) -> solid::Mesh {
    solid::Mesh {
        wall: 1,
        wall_growth: 1.0,
        around: 1,
        around_growth: 6.0,
        first: 0.2 * tube.outer_radius(),
        along_growth: 2.0,
        largest: 4.0 * tube.outer_radius(),
        ..solid::Mesh::sector(tube)
    }
}

/// Half as many elements each way.
fn coarse(tube: &Tube) -> solid::Mesh {
    let usual = solid::Mesh::sector(tube);
    solid::Mesh {
        wall: usual.wall.div_ceil(2),
        wall_growth: usual.wall_growth * usual.wall_growth,
        around: usual.around.div_ceil(2),
        around_growth: usual.around_growth * usual.around_growth,
        first: 2.0 * usual.first,
        along_growth: usual.along_growth * usual.along_growth,
        largest: 2.0 * usual.largest,
        ..usual
    }
}

/// A solid's way through the scene's pressures.
struct Walked {
    points: Vec<Point>,
    limit: Option<Limit>,
    /// The sections from base to tip at the farthest pressure.
    profile: Vec<Station>,
    /// The ways from rest: the indices of their pressures, and the states as far as they go.
    ways: Vec<(Vec<usize>, Vec<SolidEquilibrium>)>,
}

fn path(scene: &Scene, mesh: &solid::Mesh, progress: &mut dyn FnMut(f64)) -> Result<Walked, FidelityError> {
    let mut solid = Solid::new(&scene.tube, scene.length, mesh, None)?;
    let (mut points, mut limit, mut passed) = (empty(scene), None, 0.0);
    let mut ways = Vec::new();
    let (mut profile, mut farthest) = (Vec::new(), 0.0);
    for way in scene.ways().into_iter().filter(|way| !way.is_empty()) {
        let pressures: Vec<f64> = way.iter().map(|&i| scene.pressures[i]).collect();
        let part = way.len() as f64 / scene.pressures.len() as f64;
        let mut told = |share: f64| progress(passed + part * share);
        let path = solid.follow(&Tip::straight(scene.hold.ends()), &pressures, &mut told)?;
        passed += part;
        for (&i, state) in way.iter().zip(&path.states) {
            points[i].rest = Some(rest_of(state, scene.length));
            if state.pressure.abs() > farthest {
                (profile, farthest) = (state.profile.clone(), state.pressure.abs());
            }
        }
        match path.end {
            PathEnd::Reached => {}
            PathEnd::Limit(pressure) => {
                limit.get_or_insert(Limit { pressure, reason: "limit point of the pressure".into() });
            }
            PathEnd::Stuck(pressure) => {
                let reason = format!("no further step converges beyond {:.3} psi", pressure / PASCAL_PER_PSI);
                limit.get_or_insert(Limit { pressure, reason });
            }
        }
        ways.push((way, path.states));
    }
    Ok(Walked { points, limit, profile, ways })
}

fn rest_of(state: &SolidEquilibrium, length: f64) -> Rest {
    Rest {
        twist: state.rotation / length,
        stretch: state.stretch,
        outer_radius_mean: state.middle_radius,
        outer_radius_at_fiber: Some(state.middle_radius_at_fiber),
        force: state.force,
        moment: state.moment,
    }
}

impl From<&Equilibrium> for Rest {
    fn from(e: &Equilibrium) -> Rest {
        Rest {
            twist: e.twist,
            stretch: e.stretch,
            outer_radius_mean: e.outer_radius_mean,
            outer_radius_at_fiber: Some(e.outer_radius_at_fiber),
            force: e.force,
            moment: e.moment,
        }
    }
}

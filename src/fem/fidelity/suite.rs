//! Seeded scenes, and what the cheap tiers are really off by in them.
//!
//! Without units a scene is its winding angle, wall, fibres (number, cover, stiffness), rubber's exponent, length and
//! pressure. All are drawn evenly over their ranges (those that are ratios, over their logarithm), the winding angle
//! and the pressure over a [bucket](super::certified) that the seed chooses: every bucket is met equally often.
//!
//! The truth is joined of the section's finest mesh that has not folded, and a solid's ends.

use std::f64::consts::PI;
use std::ops::Range;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::certified::Bucket;
use super::joined::{Joined, joined};
use super::{Answer, Fidelity, FidelityError, Point, Scene, ask, difference, tiers};
use crate::fem::material::Law;
use crate::fem::solid::{self, Solid, Tip};
use crate::fem::tube::Tube;

/// Section levels from which the truth and the table's far field are taken: the first one that has not folded.
const FINE: [usize; 3] = [4, 3, 2];
const USUAL: [usize; 2] = [2, 1];

/// Ranges of a scene's ratios.
pub(super) struct Ranges {
    /// Wall over inner radius.
    pub wall: Range<f64>,
    /// Number of fibres.
    pub fibers: Range<usize>,
    /// Part of the circumference under the fibres.
    pub cover: Range<f64>,
    /// EA of a fibre over mu Ro^2: 53 of the reference FREE.
    pub stiffness: Range<f64>,
    /// Exponent of Ogden's law.
    pub alpha: Range<f64>,
    /// Length over outer radius.
    pub length: Range<f64>,
}

/// See [`Ranges`].
pub(super) const RANGES: Ranges = Ranges {
    wall: 0.1..0.33,
    fibers: 3..13,
    cover: 0.03..0.3,
    stiffness: 15.0..300.0,
    alpha: 0.8..3.0,
    length: 8.0..40.0,
};

impl Scene {
    /// The scene `seed`, at a third, two thirds and all of its pressure, and a tolerance between 0.5 and 20 %.
    pub fn seeded(seed: u64) -> (Scene, f64) {
        let bucket = Bucket::of_seed(seed);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut log = |range: Range<f64>| range.start * (range.end / range.start).powf(rng.random_range(0.0..1.0));
        let inner_radius = log(3e-3..8e-3);
        let wall = inner_radius * log(RANGES.wall);
        let radius = inner_radius + wall;
        let mu = log(0.2e6..0.8e6);
        let fiber_ea = mu * radius * radius * log(RANGES.stiffness);
        let length = radius * log(RANGES.length);
        let tolerance = log(5e-3..0.2);
        let cover = log(RANGES.cover);
        let fibers = rng.random_range(RANGES.fibers);
        let hand = if rng.random() { 1.0 } else { -1.0 };
        let tube = Tube {
            inner_radius,
            wall,
            gamma: hand * rng.random_range(bucket.winding.clone()).to_radians(),
            fibers,
            fiber_ea,
            fiber_width: cover * 2.0 * PI * radius / fibers as f64,
            law: Law::Ogden { mu, alpha: rng.random_range(RANGES.alpha) },
        };
        let pressure = rng.random_range(bucket.pressure.clone()) * mu * wall / inner_radius;
        let pressures = [1.0, 2.0, 3.0].map(|part| part / 3.0 * pressure).to_vec();
        (Scene { tube, length, hold: bucket.hold, pressures }, tolerance)
    }
}

/// The true answer to `scene`; none where the path of equilibria ends below its highest pressure, or every fine mesh of
/// the section has folded.
///
/// # Errors
/// As the section and the solid.
pub fn truth(scene: &Scene) -> Result<Option<Vec<Point>>, FidelityError> {
    Ok(best(scene)?.map(|joined| joined.whole))
}

fn best(scene: &Scene) -> Result<Option<Joined>, FidelityError> {
    let radius = scene.tube.outer_radius();
    let mesh = solid::Mesh { wall: 2, first: 0.03 * radius, along_growth: 1.6, ..across(&scene.tube) };
    parts(scene, &mesh, &FINE)
}

/// What the linear law has more of an error than the section, and the section's own times the length over the outer
/// radius; none as [`truth`]. On its mesh if `fine`, else on one that is some hundredths off, for a tenth of the time.
///
/// # Errors
/// As the section and the solid.
pub fn errors(scene: &Scene, fine: bool) -> Result<Option<(f64, f64)>, FidelityError> {
    let found = if fine { best(scene) } else { parts(scene, &across(&scene.tube), &USUAL) };
    let Some(Joined { far, whole }) = found? else { return Ok(None) };
    let linear = ask(scene, Fidelity::Linear, &mut |_| {})?;
    let ends = difference(&far, &whole, scene);
    let more = difference(&linear.points, &whole, scene) - ends;
    Ok(Some((more, ends * scene.length / scene.tube.outer_radius())))
}

/// True over estimated error of what the table has factors of ([`super::certified::ESTIMATES`]): of the section, what
/// is beyond its mesh's, over the ends' part as it is seen; of the solid, over its mesh's. None as [`truth`].
///
/// # Errors
/// As [`ask`].
pub fn ratios(scene: &Scene) -> Result<Option<[f64; 2]>, FidelityError> {
    let Some(truth) = truth(scene)? else { return Ok(None) };
    let off = |answer: &Answer| difference(&answer.points, &truth, scene);
    let section = ask(scene, Fidelity::Section, &mut |_| {})?;
    let beyond = (off(&section) - section.discretisation_error).max(0.0);
    let solid = tiers::solid(scene, &mut |_| {})?;
    Ok(Some([beyond / tiers::ends_seen(scene, &section)?, off(&solid) / solid.discretisation_error]))
}

/// One element through the wall and under half of the strip, small ones at the ends: what the ends add does not need
/// more across the tube.
fn across(tube: &Tube) -> solid::Mesh {
    let radius = tube.outer_radius();
    solid::Mesh {
        wall: 1,
        wall_growth: 1.0,
        around: 1,
        around_growth: 4.0,
        first: 0.05 * radius,
        along_growth: 1.8,
        largest: 2.0 * radius,
        ..solid::Mesh::sector(tube)
    }
}

fn parts(scene: &Scene, mesh: &solid::Mesh, levels: &[usize]) -> Result<Option<Joined>, FidelityError> {
    let mut solid = Solid::new(&scene.tube, scene.length, mesh, None)?;
    let path = solid.follow(&Tip::straight(scene.hold.ends()), &scene.pressures, &mut |_| {})?;
    if path.states.len() < scene.pressures.len() {
        return Ok(None);
    }
    joined(scene, &path.states, levels)
}

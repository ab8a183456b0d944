//! `auto`: the cheapest tier whose estimated error is within the tolerance.
//!
//! Inside the [certified range](super::certified) the linear law and the section are taken at the table's word, which
//! costs nothing; what the table cannot promise, and everything outside, is estimated against the dearer tiers.

use super::certified::bounds;
use super::tiers::{ask, end_effects, section};
use super::{Answer, Fidelity, FidelityError, Scene, difference};

/// Range of tolerances.
const TOLERANCES: (f64, f64) = (5e-4, 0.5);
/// Share of the tolerance that the section's mesh may take at first.
const SHARE: f64 = 0.25;
/// Finest relative error that a section's mesh is asked for.
const FINEST: f64 = 1e-4;
/// Coarsest relative error that is asked of a section whose ends are certified: as of one that is asked for by name.
const MESH: f64 = 5e-3;

/// A tier that was looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Considered {
    /// Which.
    pub fidelity: Fidelity,
    /// Estimated relative error, model and discretisation together.
    pub estimate: f64,
    /// Whether the model's part is the certified range's, not one against a dearer tier.
    pub certified: bool,
}

/// What was chosen, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The answer of the tier chosen.
    pub answer: Answer,
    /// Its estimated model error; none of the solid.
    pub model_error: Option<f64>,
    /// Every tier that was looked at, from the cheapest on; the last one is the one chosen.
    pub considered: Vec<Considered>,
    /// Whether the scene lies in the certified range.
    pub inside: bool,
}

impl Choice {
    /// Why, in a sentence.
    pub fn reason(&self, tolerance: f64) -> String {
        let percent = |x: f64| if x.is_finite() { format!("{:.2} %", 100.0 * x) } else { "no equilibrium".into() };
        let known = |certified: bool| if certified { " (certified)" } else { "" };
        let tier = |c: &Considered| format!("{} {}{}", c.fidelity.name(), percent(c.estimate), known(c.certified));
        let list = self.considered.iter().map(tier).collect::<Vec<_>>().join(", ");
        let outside = if self.inside { "" } else { "; outside of the certified range" };
        format!("the cheapest within {}; estimated errors: {list}{outside}", percent(tolerance))
    }
}

/// The cheapest tier whose estimated error in `scene` is at most `tolerance` (relative, 0.0005 to 0.5), and its answer;
/// `progress` as in [`ask`].
///
/// # Errors
/// [`FidelityError::NotReached`] where not even the solid is good enough; otherwise as [`ask`].
pub fn choose(scene: &Scene, tolerance: f64, progress: &mut dyn FnMut(f64)) -> Result<Choice, FidelityError> {
    if !(TOLERANCES.0..=TOLERANCES.1).contains(&tolerance) {
        return Err(FidelityError::Tolerance(tolerance));
    }
    scene.validated()?;
    if scene.tube.fiber_width == 0.0 {
        return Err(FidelityError::Line);
    }
    let known = bounds(scene);
    let inside = known.is_some();
    if let Some(bounds) = known {
        let linear = Considered { fidelity: Fidelity::Linear, estimate: bounds.linear, certified: true };
        if bounds.linear <= tolerance {
            let answer = ask(scene, Fidelity::Linear, progress)?;
            return Ok(Choice { answer, model_error: Some(bounds.linear), considered: vec![linear], inside });
        }
        if bounds.section + FINEST < tolerance {
            let answer = section(scene, (tolerance - bounds.section).min(MESH))?;
            let estimate = bounds.section + answer.discretisation_error;
            if estimate <= tolerance && answer.points.iter().all(|point| point.rest.is_some()) {
                let considered = vec![linear, Considered { fidelity: Fidelity::Section, estimate, certified: true }];
                return Ok(Choice { answer, model_error: Some(bounds.section), considered, inside });
            }
        }
    }
    let reference = section(scene, SHARE * tolerance)?;
    let mut considered = Vec::new();
    let estimated = |fidelity, estimate| Considered { fidelity, estimate, certified: false };
    // All pressures lie beyond a limit, which the section names as well as the solid: no number's error is asked for.
    if reference.limit.is_some() && !reference.moves() {
        considered.push(estimated(Fidelity::Section, f64::INFINITY));
        return Ok(Choice { answer: reference, model_error: None, considered, inside });
    }
    // The ends cost a solid: they are looked at once a tier is good enough without them.
    let mut ends = None;
    let mut ends = || match ends {
        Some(known) => Ok(known),
        None => end_effects(scene, &reference).map(|found| *ends.insert(found)),
    };
    for fidelity in [Fidelity::Linear, Fidelity::Nonlinear] {
        let answer = ask(scene, fidelity, progress)?;
        let mut model = difference(&answer.points, &reference.points, scene) + reference.discretisation_error;
        // Limits are not compared: the section's is told.
        if reference.limit.is_some() {
            model = f64::INFINITY;
        }
        if model <= tolerance {
            model += ends()?;
        }
        considered.push(estimated(fidelity, model));
        if model <= tolerance {
            return Ok(Choice { answer, model_error: Some(model), considered, inside });
        }
    }
    let model = ends()?;
    let mut answer = reference;
    if model + answer.discretisation_error > tolerance && model + FINEST < tolerance {
        answer = section(scene, 0.8 * (tolerance - model).max(1.25 * FINEST))?;
    }
    let estimate = model + answer.discretisation_error;
    considered.push(estimated(Fidelity::Section, estimate));
    if estimate <= tolerance {
        return Ok(Choice { answer, model_error: Some(model), considered, inside });
    }
    let answer = ask(scene, Fidelity::Solid, progress)?;
    let estimate = answer.discretisation_error;
    considered.push(estimated(Fidelity::Solid, estimate));
    if estimate <= tolerance {
        Ok(Choice { answer, model_error: None, considered, inside })
    } else {
        Err(FidelityError::NotReached { estimate, tolerance })
    }
}

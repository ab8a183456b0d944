//! `auto`: the cheapest tier whose estimated error is within the tolerance.

use super::tiers::{ask, end_effects, section};
use super::{Answer, Fidelity, FidelityError, Scene, difference};

/// Range of tolerances.
const TOLERANCES: (f64, f64) = (5e-4, 0.5);
/// Share of the tolerance that the section's mesh may take at first.
const SHARE: f64 = 0.25;
/// Finest relative error that a section's mesh is asked for.
const FINEST: f64 = 1e-4;

/// A tier that was looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Considered {
    /// Which.
    pub fidelity: Fidelity,
    /// Estimated relative error, model and discretisation together.
    pub estimate: f64,
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
}

impl Choice {
    /// Why, in a sentence.
    pub fn reason(&self, tolerance: f64) -> String {
        let percent = |x: f64| if x.is_finite() { format!("{:.2} %", 100.0 * x) } else { "no equilibrium".into() };
        let tier = |c: &Considered| format!("{} {}", c.fidelity.name(), percent(c.estimate));
        let list = self.considered.iter().map(tier).collect::<Vec<_>>().join(", ");
        format!("the cheapest within {}; estimated errors: {list}", percent(tolerance))
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
    let reference = section(scene, SHARE * tolerance)?;
    let mut considered = Vec::new();
    // The ends cost a solid: they are looked at once a tier is good enough without them.
    let mut ends = None;
    let mut ends = || match ends {
        Some(known) => Ok(known),
        None => end_effects(scene, &reference).map(|found| *ends.insert(found)),
    };
    for fidelity in [Fidelity::Linear, Fidelity::Nonlinear] {
        let answer = ask(scene, fidelity, progress)?;
        let mut model = difference(&answer.points, &reference.points, scene) + reference.discretisation_error;
        if model <= tolerance {
            model += ends()?;
        }
        considered.push(Considered { fidelity, estimate: model });
        if model <= tolerance {
            return Ok(Choice { answer, model_error: Some(model), considered });
        }
    }
    let model = ends()?;
    let mut answer = reference;
    if model + answer.discretisation_error > tolerance && model + FINEST < tolerance {
        answer = section(scene, 0.8 * (tolerance - model).max(1.25 * FINEST))?;
    }
    let estimate = model + answer.discretisation_error;
    considered.push(Considered { fidelity: Fidelity::Section, estimate });
    if estimate <= tolerance {
        return Ok(Choice { answer, model_error: Some(model), considered });
    }
    let answer = ask(scene, Fidelity::Solid, progress)?;
    let estimate = answer.discretisation_error;
    considered.push(Considered { fidelity: Fidelity::Solid, estimate });
    if estimate <= tolerance {
        Ok(Choice { answer, model_error: None, considered })
    } else {
        Err(FidelityError::NotReached { estimate, tolerance })
    }
}

//! Which model answers for a module: rods, rods whose ends are corrected, or the solid, and what its errors are.

use std::fmt;

use anyhow::anyhow;

use crate::cli::scene::build;
use crate::cli::{Context, Failure, Progress};
use crate::fem::fidelity::{FidelityError, dead_length, rods_discretisation_error, rods_model_error, solid_answers};
use crate::fem::module::{self, Answer, Limit, ModuleScene, Reason};
use crate::fem::section::SectionError;
use crate::fem::tube::Tube;
use crate::units::Percent;

/// The answers and what holds for all of them.
pub(super) struct Found {
    pub fidelity: &'static str,
    pub answers: Vec<Answer>,
    pub discretisation: f64,
    pub ends: Ends,
    /// More of the errors, a line each.
    pub notes: Vec<String>,
    pub reason: Option<String>,
}

/// What is known of the relative error that the FREEs' ends make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Ends {
    /// Nobody has asked, or the model has them.
    NotEstimated,
    /// Asked for, and not to be had.
    Unknown,
    Estimated(f64),
}

/// The most that rods with a dead length were off by, against the solid of the module, of the travel: the ends of a
/// FREE that is bent are not quite those of one that is stretched (six states at 30 and 60 deg, docs/models.md).
const BENT_ENDS: f64 = 0.007;

pub(super) fn by_rods(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    context: &Context,
) -> Result<Found, Failure> {
    let built = build(scene, highest, context)?;
    let answers = module::answer(scene, &built.module, rows);
    let law = &built.law_errors;
    Ok(Found {
        fidelity: "rod",
        discretisation: rods_discretisation_error(scene, &built.module, law, &answers),
        answers,
        ends: Ends::NotEstimated,
        notes: vec![
            format!("of it the section's mesh: {}", percent(law.mesh)),
            format!(
                "bending stiffness between the states it is interpolated from: nine of ten within {}, the worst {} off",
                percent(law.mostly),
                percent(law.bending)
            ),
        ],
        reason: None,
    })
}

pub(super) fn by_solid(scene: &ModuleScene, rows: &[[f64; 4]], context: &Context) -> Result<Found, Failure> {
    context.note("solid of the whole module, on two meshes: a minute or so a row, less where it is symmetric");
    let mut progress = Progress::new("solid", 100.0, "%");
    let found = solid_answers(scene, rows, &mut |share| progress.set(100.0 * share, ""));
    drop(progress);
    let found = found.map_err(|error| match error {
        FidelityError::Solid(_) | FidelityError::Section(_) => {
            Failure::failed(error).remedy("ask for lower pressures, or for `--fidelity rod`")
        }
        error => Failure::usage(error).remedy("ask for `--fidelity rod`, whose error estimates say what it is worth"),
    })?;
    Ok(Found {
        fidelity: "solid",
        answers: found.answers,
        discretisation: found.discretisation_error,
        ends: Ends::NotEstimated,
        notes: Vec::new(),
        reason: None,
    })
}

/// Rods; rods whose ends are corrected, where they are not good enough; or the solid.
pub(super) fn by_either(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    tolerance: Percent,
    context: &Context,
) -> Result<Found, Failure> {
    let mut rods = by_rods(scene, rows, highest, context)?;
    if highest > 0.0 {
        context.note("estimating what the FREEs' ends are worth, by a coarse solid of one: some seconds");
        let remedy = "ask for `--fidelity rod`, which does not look at the ends";
        let ends = rods_model_error(scene, highest).map_err(|error| Failure::failed(error).remedy(remedy))?;
        rods.ends = Ends::of(ends);
    }
    let mut tried = rods.told("rod");
    if !rods.within(tolerance) && rods.discretisation <= tolerance.si() && !rods.beyond_law() {
        context.note(format!("{tried}: above --tolerance {tolerance}; now with the ends corrected, some seconds"));
        if let Some(corrected) = by_corrected_rods(scene, rows, highest, context)? {
            rods = corrected;
            tried += &format!("; {}", rods.told("with a dead length"));
        }
    }
    if rods.within(tolerance) {
        rods.reason = Some(format!("the cheapest within {tolerance}; estimated error: {tried}"));
        return Ok(rods);
    }
    context.note(format!(
        "{tried}: above --tolerance {tolerance}. The solid is asked instead; a larger tolerance or `--fidelity rod` \
         answers at once"
    ));
    let mut solid = by_solid(scene, rows, context)?;
    if solid.discretisation.is_nan() || solid.discretisation > tolerance.si() {
        let solid = percent(solid.discretisation);
        let error = anyhow!("estimated error: {tried}; solid {solid}: none is within --tolerance {tolerance}");
        return Err(Failure::failed(error).remedy("give a larger --tolerance, or ask for one by --fidelity"));
    }
    solid.reason = Some(format!("the cheapest within {tolerance}; estimated error: {tried}"));
    Ok(solid)
}

/// Rods that are shorter by what the ends of a single FREE of their kind take of it at the highest pressure, by its
/// solid: exact there for a FREE that the others hold from turning. None where a single FREE has no equilibrium there,
/// or no dead length makes a rod of it.
///
/// What one length misses elsewhere: FREEs at other pressures have other dead lengths, of which the one at half of the
/// pressure shows how much they differ. A rod's tip goes with its length where it is stretched and with the square of
/// it where it is bent, so that a dead length wrong by d moves it by up to 2 d of its length. On top comes what ends do
/// otherwise when they bend, [`BENT_ENDS`].
fn by_corrected_rods(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    context: &Context,
) -> Result<Option<Found>, Failure> {
    let mut kinds: Vec<(Tube, f64, f64)> = Vec::new();
    let (mut corrected, mut worst) = (scene.clone(), 0.0);
    for free in &mut corrected.frees {
        let (tube, length) = (Tube { gamma: free.tube.gamma.abs(), ..free.tube }, free.length);
        let known = kinds.iter().find(|(other, of, _)| *other == tube && *of == length).map(|(.., dead)| *dead);
        free.dead_length = match known {
            Some(dead) => dead,
            None => {
                let Some([half, whole]) = dead_lengths(&tube, length, highest)? else { return Ok(None) };
                worst = f64::max(worst, 2.0 * (whole - half).abs() / length);
                kinds.push((tube, length, whole));
                whole
            }
        };
    }
    if corrected.validated().is_err() {
        return Ok(None);
    }
    let mut found = by_rods(&corrected, rows, highest, context)?;
    found.ends = Ends::Estimated(worst + BENT_ENDS);
    let told: Vec<String> = kinds.iter().map(|(.., dead)| format!("{:.2} mm", 1e3 * dead)).collect();
    found.notes.push(format!("the ends of a FREE are worth {} of it, by the solid of a single one", told.join(", ")));
    Ok(Some(found))
}

/// The dead lengths, m, of a FREE at half of `highest` (Pa) and at all of it; none where it has no equilibrium there.
fn dead_lengths(tube: &Tube, length: f64, highest: f64) -> Result<Option<[f64; 2]>, Failure> {
    let mut found = [0.0; 2];
    for (dead, share) in found.iter_mut().zip([0.5, 1.0]) {
        *dead = match dead_length(tube, length, share * highest) {
            Ok(dead) => dead,
            Err(
                FidelityError::Single(_)
                | FidelityError::Section(SectionError::BeyondLimit { .. } | SectionError::PathEnds { .. }),
            ) => return Ok(None),
            Err(error) => {
                let remedy = "ask for `--fidelity rod`, which does not look at the ends, or for `--fidelity solid`";
                return Err(Failure::failed(error).remedy(remedy));
            }
        };
    }
    Ok(Some(found))
}

impl Ends {
    /// An estimate that was asked for.
    fn of(estimate: Option<f64>) -> Ends {
        estimate.filter(|share| share.is_finite()).map_or(Ends::Unknown, Ends::Estimated)
    }

    pub fn estimate(self) -> Option<f64> {
        match self {
            Ends::Estimated(share) => Some(share),
            Ends::NotEstimated | Ends::Unknown => None,
        }
    }
}

impl fmt::Display for Ends {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Ends::NotEstimated => f.write_str("not estimated"),
            Ends::Unknown => f.write_str("unknown"),
            Ends::Estimated(share) => f.write_str(&percent(*share)),
        }
    }
}

impl Found {
    /// All that is estimated of the error; none where the ends' is unknown, or the law ends and not the module.
    fn error(&self) -> Option<f64> {
        let known = self.ends != Ends::Unknown && !self.beyond_law();
        known.then(|| self.discretisation + self.ends.estimate().unwrap_or(0.0))
    }

    /// Whether a row ends where the law's table does.
    fn beyond_law(&self) -> bool {
        let law = |limit: &Limit| matches!(&limit.reason, Reason::Module(error) if error.is_beyond_law());
        self.answers.iter().filter_map(|answer| answer.limit.as_ref()).any(law)
    }

    /// Whether that is within `tolerance`: what is not known is no reason to believe the rods.
    fn within(&self, tolerance: Percent) -> bool {
        self.error().is_some_and(|error| error <= tolerance.si())
    }

    /// "rod 1.20 % (discretisation 0.50 %, ends 0.70 %)".
    fn told(&self, what: &str) -> String {
        if self.beyond_law() {
            return format!("{what} unknown (beyond the section law's table)");
        }
        let error = self.error().map_or("unknown".into(), percent);
        format!("{what} {error} (discretisation {}, ends {})", percent(self.discretisation), self.ends)
    }
}

pub(super) fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.2} %", 100.0 * share) } else { "unknown".into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::module::ModuleError;
    use crate::fem::rod::{LawError, RodError};

    #[test]
    fn where_the_laws_table_ends_nothing_is_known_of_the_module() {
        let outside = LawError::OutsideTable { stretch: 1.0, twist: 0.0, pressure: 5e4 };
        let cause = ModuleError::Rod { index: 0, cause: RodError::Law(outside) };
        let limit = |reason| Some(Limit { fraction: 0.9, reason });
        let found = |limit| Found {
            fidelity: "rod",
            answers: vec![Answer { pressures: [5e4; 4], pose: None, limit }],
            discretisation: 0.0,
            ends: Ends::Estimated(0.01),
            notes: Vec::new(),
            reason: None,
        };
        let tolerance: Percent = "5%".parse().unwrap();
        let law = found(limit(Reason::Module(cause)));
        assert!(!law.within(tolerance) && law.told("rod").contains("beyond the section law's table"));
        // A limit of the module's own is an answer.
        assert!(found(limit(Reason::Critical(module::Kind::Bifurcation))).within(tolerance));
    }

    #[test]
    fn ends_of_which_nothing_is_known_are_within_no_tolerance_and_said_to_be_unknown() {
        let found = |ends| Found {
            fidelity: "rod",
            answers: Vec::new(),
            discretisation: 0.004,
            ends,
            notes: Vec::new(),
            reason: None,
        };
        let tolerance: Percent = "50%".parse().unwrap();
        for estimate in [None, Some(f64::INFINITY), Some(f64::NAN)] {
            let rods = found(Ends::of(estimate));
            assert!(!rods.within(tolerance) && rods.ends.estimate().is_none());
            assert_eq!(rods.told("rod"), "rod unknown (discretisation 0.40 %, ends unknown)");
        }
        let rods = found(Ends::of(Some(0.012)));
        assert!(rods.within("1.6%".parse().unwrap()) && !rods.within("1.59%".parse().unwrap()));
        assert_eq!(rods.told("rod"), "rod 1.60 % (discretisation 0.40 %, ends 1.20 %)");
        assert_eq!(found(Ends::NotEstimated).told("rod"), "rod 0.40 % (discretisation 0.40 %, ends not estimated)");
    }
}

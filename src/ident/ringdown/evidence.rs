//! Which model the samples speak for: how many modes, a drift or none, an oscillation or a relaxation.
//!
//! From simple to rich; a richer model is taken where its misfit falls by more than the Bayesian information criterion
//! asks for, (parameters more) ln(samples), and [`MARGIN`] on top. The misfit is counted in the richer model's own
//! noise, and divided by that noise's colour: correlated residuals carry less evidence than their number.

use super::basis::Shape;
use super::fit::{Fit, fit};
use super::noise::colour;
use super::record::Series;
use super::start::peaks;

/// Modes and relaxations, at most.
const OSCILLATIONS_MAX: usize = 3;
const RELAXATIONS_MAX: usize = 2;
/// Evidence asked for beyond the criterion: e^3 to one.
const MARGIN: f64 = 6.0;
/// Start values tried for the first mode, and for each further one.
const PEAKS: usize = 4;
const FURTHER: usize = 2;
/// Relaxations tried, as e-folds within the record.
const FOLDS: [f64; 5] = [1.0, 4.0, 12.0, 40.0, 120.0];

/// What was chosen.
pub(super) struct Choice {
    pub fit: Fit,
    /// Evidence against nothing but an offset and a drift: positive where something moves.
    pub evidence: f64,
}

/// Chooses a model for `series`. `None` where not even an offset can be fitted.
pub(super) fn choose(series: &[Series], span: f64) -> Option<Choice> {
    let still = Shape::default();
    let mut rest = fit(still, &[], series, span)?;
    if let Some(moving) = fit(Shape { drift: true, ..still }, &[], series, span)
        && gain(&moving, &rest) > 0.0
    {
        rest = moving;
    }
    let mut best: Option<Fit> = None;
    for next in relaxed(&rest, series).into_iter().chain(ringing(&rest, series, PEAKS)) {
        best = match best {
            Some(best) if gain(&next, &best) <= 0.0 => Some(best),
            _ => Some(next),
        };
    }
    let mut best = match best {
        Some(best) => best,
        None => return Some(Choice { fit: rest, evidence: f64::NEG_INFINITY }),
    };
    loop {
        let mut candidates = vec![];
        if best.shape.oscillations < OSCILLATIONS_MAX {
            candidates.extend(ringing(&best, series, FURTHER));
        }
        if best.shape.relaxations < RELAXATIONS_MAX {
            candidates.extend(relaxed(&best, series));
        }
        if best.shape.oscillations == 1 && best.shape.relaxations == 0 && best.theta[0] > best.theta[1] {
            candidates.extend(twice_relaxed(&best, series));
        }
        let toggled = Shape { drift: !best.shape.drift, ..best.shape };
        candidates.extend(fit(toggled, &best.theta, series, span));
        let better = candidates
            .into_iter()
            .map(|c| (gain(&c, &best), c))
            .filter(|(gain, _)| *gain > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        match better {
            Some((_, c)) => best = c,
            None => break,
        }
    }
    let evidence = gain(&best, &rest);
    Some(Choice { fit: best, evidence })
}

/// Evidence for `next` over `now`, beyond what its further parameters cost: positive to take it. Signed the other way
/// round where `next` is the simpler one.
fn gain(next: &Fit, now: &Fit) -> f64 {
    let channels = next.series.len();
    let (more, less) = (next.shape.parameters(channels) as f64, now.shape.parameters(channels) as f64);
    let samples: usize = next.series.iter().map(|s| s.time.len()).sum();
    let richer = if more >= less { next } else { now };
    let won = (now.misfit(&richer.scales) - next.misfit(&richer.scales)) / colouring(richer, 0.0);
    won - (more - less) * (samples as f64).ln() - MARGIN * (more - less).signum()
}

/// The greatest colour of any channel's residuals about `omega`, rad/s.
pub(super) fn colouring(fit: &Fit, omega: f64) -> f64 {
    let of = |c: usize| {
        let s = &fit.series[c];
        let kept = fit.projections[c].residuals.iter().zip(&s.weight).filter(|(_, w)| **w > 0.0);
        colour(&kept.map(|(r, _)| *r).collect::<Vec<_>>(), omega * s.interval)
    };
    (0..fit.series.len()).map(of).fold(1.0, f64::max)
}

/// `base` and one oscillation more, from the peaks of its residuals.
fn ringing(base: &Fit, series: &[Series], count: usize) -> Vec<Fit> {
    let shape = Shape { oscillations: base.shape.oscillations + 1, ..base.shape };
    let residuals: Vec<Vec<f64>> = base.projections.iter().map(|p| p.residuals.clone()).collect();
    let at = 2 * base.shape.oscillations;
    let start = |peak: [f64; 2]| [&base.theta[..at], &peak, &base.theta[at..]].concat();
    peaks(series, &residuals, base.span, count)
        .into_iter()
        .filter_map(|peak| fit(shape, &start(peak), series, base.span))
        .collect()
}

/// `base` and one relaxation more.
fn relaxed(base: &Fit, series: &[Series]) -> Vec<Fit> {
    let shape = Shape { relaxations: base.shape.relaxations + 1, ..base.shape };
    let start = |folds: f64| [&base.theta[..], &[folds / base.span]].concat();
    let fits = FOLDS.into_iter().filter_map(|folds| fit(shape, &start(folds), series, base.span));
    best_of(fits).into_iter().collect()
}

/// A strongly damped oscillation as two relaxations.
fn twice_relaxed(base: &Fit, series: &[Series]) -> Vec<Fit> {
    let shape = Shape { oscillations: 0, relaxations: 2, ..base.shape };
    let [decay, omega] = [base.theta[0], base.theta[1]];
    let apart = omega.max(0.2 * decay).min(0.9 * decay);
    fit(shape, &[decay - apart, decay + apart], series, base.span).into_iter().collect()
}

/// The one of one shape that fits best.
fn best_of(fits: impl Iterator<Item = Fit>) -> Option<Fit> {
    fits.reduce(|a, b| if b.misfit(&a.scales) < a.misfit(&a.scales) { b } else { a })
}

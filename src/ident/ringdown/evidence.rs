//! Which model the samples speak for: how many modes, a drift or none, an oscillation or a relaxation.
//!
//! From simple to rich; a richer model is taken where its misfit falls by more than the Bayesian information criterion
//! asks for, (parameters more) ln(samples), for the many frequencies that were tried, and [`MARGIN`] on top. The misfit
//! is counted in the richer model's own noise, each sample as an outlier at most, and divided by that noise's colour:
//! correlated residuals carry less evidence than their number.

use super::basis::{Shape, project};
use super::fit::{Fit, OUTLIER, fit};
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
/// Largest relative standard uncertainty of the rate or frequency of a component that is seen beside another.
const RELATIVE_MAX: f64 = 0.5;
/// Relaxations that can be told from each other.
const TRIES: f64 = 5.0;
/// Relaxations and strongly damped oscillations tried, as e-folds within the record.
const FOLDS: [f64; 5] = [1.0, 4.0, 12.0, 40.0, 120.0];

/// What was chosen.
pub(super) struct Choice {
    pub fit: Fit,
    /// Evidence against nothing but an offset and a drift: positive where something moves.
    pub evidence: f64,
}

/// Chooses a model for `series`. `None` where not even an offset can be fitted.
pub(super) fn choose(series: &[Series], span: f64) -> Option<Choice> {
    let still = fit(Shape::default(), &[], series, span)?;
    // A drift may leave again; one that is left out would pass for coloured noise.
    let moving = fit(Shape { drift: true, ..Shape::default() }, &[], series, span)?;
    let first = relaxed(&moving, series).into_iter().chain(ringing(&moving, series, PEAKS)).collect::<Vec<_>>();
    let rest = if gain(&moving, &still) > 0.0 { moving } else { still };
    let Some(mut best) = tournament(first.into_iter()) else {
        return Some(Choice { fit: rest, evidence: f64::NEG_INFINITY });
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
        candidates.retain(resolved);
        match tournament(candidates.into_iter()) {
            Some(next) if gain(&next, &best) > 0.0 => best = next,
            _ => break,
        }
    }
    let evidence = gain(&best, &rest);
    Some(Choice { fit: best, evidence })
}

/// The best of all, each pair judged in its own noise.
fn tournament(fits: impl Iterator<Item = Fit>) -> Option<Fit> {
    fits.reduce(|best, next| if gain(&next, &best) > 0.0 { next } else { best })
}

/// Whether the rates of all relaxations and the frequencies of all oscillations are known to better than themselves.
fn resolved(fit: &Fit) -> bool {
    let Some(covariance) = fit.normal().try_inverse() else { return false };
    let known = |i: usize| covariance[(i, i)].max(0.0).sqrt() < RELATIVE_MAX * fit.theta[i];
    let oscillations = 2 * fit.shape.oscillations;
    (1..oscillations).step_by(2).chain(oscillations..fit.theta.len()).all(known)
}

/// Evidence for `next` over `now`, beyond what its further parameters cost: positive to take it. Signed the other way
/// round where `next` is the simpler one.
fn gain(next: &Fit, now: &Fit) -> f64 {
    let channels = next.series.len();
    let samples = next.series.iter().map(|s| s.time.len()).sum::<usize>() as f64;
    // A frequency is one of as many as there are samples by half and decays: chance has so many tries.
    let cost = |f: &Fit| {
        let tries = 2.0 * f.shape.oscillations as f64 * samples.ln() + 2.0 * f.shape.relaxations as f64 * TRIES.ln();
        f.shape.parameters(channels) as f64 * samples.ln() + tries
    };
    let (more, less) = (cost(next), cost(now));
    let richer = if more >= less { next } else { now };
    let colour = richer.colours().iter().map(|c| c.density(0.0)).fold(1.0, f64::max);
    let won: f64 = (0..channels)
        .flat_map(|c| {
            let size = move |r: &f64| (r / richer.scales[c]).powi(2).min(OUTLIER * OUTLIER);
            let pairs = now.projections[c].residuals.iter().zip(&next.projections[c].residuals);
            pairs.map(move |(now, next)| (size(now), size(next)))
        })
        // What lies beyond all noise is no coloured noise either.
        .map(|(now, next)| (now - next) / if now.max(next) < OUTLIER * OUTLIER { colour } else { 1.0 })
        .sum();
    let margin = if next.shape == now.shape { 0.0 } else { MARGIN * (more - less).signum() };
    won - (more - less) - margin
}

/// `base` and one oscillation more, from the peaks of its residuals; and from the best of [`FOLDS`] at a damping ratio
/// of 0.7, where a spectrum has no peak.
fn ringing(base: &Fit, series: &[Series], count: usize) -> Vec<Fit> {
    let shape = Shape { oscillations: base.shape.oscillations + 1, ..base.shape };
    let residuals: Vec<Vec<f64>> = base.projections.iter().map(|p| p.residuals.clone()).collect();
    let at = 2 * base.shape.oscillations;
    let start = |peak: [f64; 2]| [&base.theta[..at], &peak, &base.theta[at..]].concat();
    let damped = FOLDS.map(|folds| start([folds / base.span; 2]));
    let peaks = peaks(series, &residuals, base.span, count).into_iter().map(start);
    peaks.chain(cheapest(shape, damped, series, base.span)).filter_map(|s| fit(shape, &s, series, base.span)).collect()
}

/// The start that comes closest as it is.
fn cheapest<const N: usize>(shape: Shape, starts: [Vec<f64>; N], series: &[Series], span: f64) -> Option<Vec<f64>> {
    let cost =
        |theta: &[f64]| series.iter().map(|s| project(shape, theta, s, span).map_or(f64::INFINITY, |p| p.cost)).sum();
    let costs = starts.map(|s| (cost(&s), s));
    costs.into_iter().min_by(|a: &(f64, _), b| a.0.total_cmp(&b.0)).map(|best| best.1)
}

/// `base` and one relaxation more, from the best of [`FOLDS`].
fn relaxed(base: &Fit, series: &[Series]) -> Option<Fit> {
    let shape = Shape { relaxations: base.shape.relaxations + 1, ..base.shape };
    let start = |folds: f64| [&base.theta[..], &[folds / base.span]].concat();
    let best = cheapest(shape, FOLDS.map(start), series, base.span)?;
    fit(shape, &best, series, base.span)
}

/// A strongly damped oscillation as two relaxations.
fn twice_relaxed(base: &Fit, series: &[Series]) -> Option<Fit> {
    let shape = Shape { oscillations: 0, relaxations: 2, ..base.shape };
    let [decay, omega] = [base.theta[0], base.theta[1]];
    let apart = omega.max(0.2 * decay).min(0.9 * decay);
    fit(shape, &[decay - apart, decay + apart], series, base.span)
}

//! Nonlinear least squares on the poles (Levenberg-Marquardt), with outliers taken out.

use nalgebra::{DMatrix, DVector};

use super::basis::{Projection, Shape, norm, orthogonalise, project};
use super::record::Series;
use crate::ident::noise::{Colour, median, quantile};

/// Steps of one minimisation, at most.
const STEPS: usize = 100;
/// Rounds of weights, at most; of which so many bend gently (Huber) before outliers are taken out.
const ROUNDS: usize = 20;
const GENTLE: usize = 5;
/// Huber's limit, standard deviations.
const HUBER: f64 = 1.5;
/// Beyond so many standard deviations a sample is an outlier: one in 150 000 of a normal distribution.
pub(super) const OUTLIER: f64 = 4.5;
/// What a step can still win, against the cost, below which it is not taken: on the way a thousandth of a standard
/// uncertainty of any parameter, in the end rounding.
const ROUGH: f64 = 1e-9;
const FINE: f64 = 1e-13;
/// Relative distance to an edge of the parameters that is none.
const EDGE: f64 = 1e-4;
/// Samples that the start of the motion has at least, for the check that it is not all "outliers".
const HEAD: usize = 12;

/// A fit of one shape.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub shape: Shape,
    pub theta: Vec<f64>,
    /// By channel.
    pub projections: Vec<Projection>,
    /// Standard deviation of the noise, by channel.
    pub scales: Vec<f64>,
    /// The series with the final weights.
    pub series: Vec<Series>,
    /// Length of the record, s.
    pub span: f64,
}

impl Fit {
    pub fn used(&self) -> usize {
        self.series.iter().map(|s| s.weight.iter().filter(|w| **w > 0.0).count()).sum()
    }

    /// Degrees of freedom: of so many independent samples as have left residuals of these `colours`.
    pub fn freedom(&self, colours: &[Colour]) -> usize {
        let samples = colours.iter().map(Colour::samples).fold(1.0, f64::max);
        let white = self.used().saturating_sub(self.shape.parameters(self.series.len()));
        ((white as f64 / samples) as usize).max(1)
    }

    /// What the noise of each channel looks like.
    pub fn colours(&self) -> Vec<Colour> {
        let of = |(s, p): (&Series, &Projection)| {
            let kept = |x: &[f64]| -> Vec<f64> {
                x.iter().zip(&s.weight).filter(|(_, w)| **w > 0.0).map(|(x, _)| *x).collect()
            };
            let columns = self.shape.columns(&self.theta, &s.time, self.span);
            let slope = |i: usize| self.shape.derivative(i, &columns, &p.coefficients, &s.time);
            let mut basis: Vec<Vec<f64>> = vec![];
            for column in columns.iter().cloned().chain((0..self.shape.nonlinear()).map(slope)) {
                let mut q = kept(&column);
                let before = norm(&q);
                orthogonalise(&mut q, &basis, |_, _| ());
                let left = norm(&q);
                if left > 1e-9 * before {
                    q.iter_mut().for_each(|x| *x /= left);
                    basis.push(q);
                }
            }
            Colour::of(&kept(&p.residuals), &basis)
        };
        self.series.iter().zip(&self.projections).map(of).collect()
    }

    pub fn normal(&self) -> DMatrix<f64> {
        let count = self.shape.nonlinear();
        self.projections.iter().fold(DMatrix::zeros(count, count), |sum, p| sum + &p.normal)
    }
}

/// Where the parameters may be: frequencies up to half a turn a sample, and nothing that is gone within one.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    omega_max: f64,
    rate_max: f64,
    span: f64,
}

impl Bounds {
    fn of(series: &[Series], span: f64) -> Self {
        let interval = series.iter().map(|s| s.interval).fold(f64::INFINITY, f64::min);
        Self { omega_max: std::f64::consts::PI / interval, rate_max: 1.5 / interval, span }
    }

    /// Whether the edge, and not a minimum, has ended the search: what the samples cannot tell.
    fn touched(self, shape: Shape, theta: &[f64]) -> bool {
        let scaled = |factor: f64| theta.iter().map(|x| factor * x).collect::<Vec<_>>();
        !self.admit(shape, &scaled(1.0 + EDGE)) || !self.admit(shape, &scaled(1.0 - EDGE))
    }

    fn admit(self, shape: Shape, theta: &[f64]) -> bool {
        let (oscillations, relaxations) = theta.split_at(2 * shape.oscillations);
        oscillations.chunks(2).all(|m| {
            m[0] > -1.0 / self.span && m[0] < self.rate_max && m[1] > 1e-3 / self.span && m[1] < self.omega_max
        }) && relaxations.iter().all(|p| *p > 0.02 / self.span && *p < self.rate_max)
    }
}

/// Robust fit of `shape` from `start` (nonlinear parameters): least squares, then weights that bend, then outliers
/// out, until the outliers are the same again. `None` where nothing converges.
pub(super) fn fit(shape: Shape, start: &[f64], series: &[Series], span: f64) -> Option<Fit> {
    let mut series = series.to_vec();
    let (mut theta, mut projections) = minimise(shape, start, &series, span, ROUGH)?;
    let mut scales = vec![];
    let mut out: Vec<usize> = vec![];
    for round in 0..ROUNDS {
        let gentle = round < GENTLE;
        scales = (0..series.len()).map(|c| scale(shape, &theta, &projections[c], &series[c])).collect();
        let mut next = vec![];
        for (c, s) in series.iter_mut().enumerate() {
            for (i, (w, r)) in s.weight.iter_mut().zip(&projections[c].residuals).enumerate() {
                let size = r.abs() / scales[c];
                let share = match gentle {
                    true => (HUBER / size).min(1.0),
                    false => f64::from(size < OUTLIER),
                };
                if size >= OUTLIER {
                    next.push(i + (c << 32));
                }
                *w = share / scales[c].powi(2);
            }
        }
        (theta, projections) = minimise(shape, &theta, &series, span, ROUGH)?;
        if !gentle && next == out {
            break;
        }
        out = next;
    }
    // The scale that the uncertainties need: the spread of what was used, and no less than the quantisation makes.
    for (c, s) in series.iter_mut().enumerate() {
        let used: Vec<f64> =
            projections[c].residuals.iter().zip(&s.weight).filter(|(_, w)| **w > 0.0).map(|(r, _)| *r).collect();
        let taken = shape.linear() as f64 + shape.nonlinear() as f64 / scales.len() as f64;
        let freedom = (used.len() as f64 - taken).max(1.0);
        scales[c] = (used.iter().map(|r| r * r).sum::<f64>() / freedom).sqrt().max(s.floor).max(tiny(s));
        s.weight.iter_mut().filter(|w| **w > 0.0).for_each(|w| *w = scales[c].powi(-2));
    }
    let (theta, projections) = minimise(shape, &theta, &series, span, FINE)?;
    if Bounds::of(&series, span).touched(shape, &theta) {
        return None;
    }
    Some(Fit { shape, theta, projections, scales, series, span })
}

/// Rounding, so that data without noise do not divide by zero.
fn tiny(series: &Series) -> f64 {
    1e-12 * series.value.iter().fold(f64::MIN_POSITIVE, |m, v| m.max(v.abs()))
}

/// Robust spread of the residuals. A long quiet tail must not make outliers of the whole motion where the model is not
/// right yet: at its start, where the motion is, no more than a quarter can be outliers.
fn scale(shape: Shape, theta: &[f64], projection: &Projection, series: &Series) -> f64 {
    let sizes: Vec<f64> = projection.residuals.iter().map(|r| r.abs()).collect();
    let free = (sizes.len() as f64 / (sizes.len() as f64 - shape.parameters(1) as f64).max(1.0)).sqrt();
    let slowest = if shape.oscillations > 0 { theta[0] } else { theta.first().copied().unwrap_or(0.0) };
    let within = series.time.iter().take_while(|t| **t * slowest < 2.0).count();
    let head = &sizes[..within.max(HEAD).min(sizes.len())];
    (1.4826 * free * median(&sizes)).max(quantile(head, 0.75) / 2.5).max(series.floor).max(tiny(series))
}

/// Minimises the weighted sum of squares over the poles, until a step would win less than `tolerance` of it.
fn minimise(
    shape: Shape,
    start: &[f64],
    series: &[Series],
    span: f64,
    tolerance: f64,
) -> Option<(Vec<f64>, Vec<Projection>)> {
    let all =
        |theta: &[f64]| -> Option<Vec<Projection>> { series.iter().map(|s| project(shape, theta, s, span)).collect() };
    let bounds = Bounds::of(series, span);
    let mut theta = start.to_vec();
    if !bounds.admit(shape, &theta) {
        return None;
    }
    let mut at = all(&theta)?;
    let mut cost: f64 = at.iter().map(|p| p.cost).sum();
    let mut damping = 1e-3;
    let inner = shape.nonlinear();
    if inner == 0 {
        return Some((theta, at));
    }
    for _ in 0..STEPS {
        let normal = at.iter().fold(DMatrix::zeros(inner, inner), |sum: DMatrix<f64>, p| sum + &p.normal);
        let gradient = at.iter().fold(DVector::zeros(inner), |sum: DVector<f64>, p| sum + &p.gradient);
        let mut moved = false;
        while damping < 1e12 {
            let mut lifted = normal.clone();
            (0..inner).for_each(|i| lifted[(i, i)] *= 1.0 + damping);
            let step = lifted.cholesky()?.solve(&gradient);
            let next: Vec<f64> = theta.iter().zip(step.iter()).map(|(t, s)| t + s).collect();
            if step.dot(&gradient) <= tolerance * cost {
                return Some((theta, at));
            }
            if bounds.admit(shape, &next)
                && let Some(there) = all(&next)
            {
                let lower: f64 = there.iter().map(|p| p.cost).sum();
                if lower < cost {
                    (theta, at, cost) = (next, there, lower);
                    damping = (damping / 10.0).max(1e-12);
                    moved = true;
                    break;
                }
            }
            damping *= 10.0;
        }
        if !moved {
            break;
        }
    }
    Some((theta, at))
}

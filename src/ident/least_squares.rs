//! Nonlinear least squares by Levenberg and Marquardt.

use nalgebra::{DMatrix, DVector};

use super::Measured;

/// Steps at most; a fit of a handful of parameters takes ten to thirty.
const ROUNDS: usize = 200;
/// Relative change of the sum of squares that is rounding.
const CHANGE: f64 = 1e-12;
/// Damping beyond which no step can be told from none.
const STIFF: f64 = 1e12;
/// Step of the central differences, as a share of a parameter's scale: their error is of its square, and residuals
/// of 1e-12 relative leave 1e-7 of a derivative.
const DIFFERENCE: f64 = 1e-5;

/// The least sum of squares.
#[derive(Clone, Debug)]
pub(super) struct Least {
    /// Where it is.
    pub parameters: Vec<f64>,
    /// Covariance of the parameters, the residuals' variance taken from themselves.
    pub covariance: DMatrix<f64>,
    /// Derivatives of the residuals by the parameters over their scales.
    pub jacobian: DMatrix<f64>,
    /// Sum of the squared residuals.
    pub sum: f64,
    /// Residuals less parameters, at least one.
    pub freedom: usize,
}

impl Least {
    /// Parameter `index` with its standard uncertainty.
    pub fn measured(&self, index: usize) -> Measured {
        Measured {
            value: self.parameters[index],
            uncertainty: self.covariance[(index, index)].max(0.0).sqrt(),
            freedom: self.freedom,
        }
    }

    /// Root mean square of the residuals, freed from the parameters.
    pub fn deviation(&self) -> f64 {
        (self.sum / self.freedom as f64).sqrt()
    }

    /// A score by which models of different size are compared, smaller is better: a further parameter must
    /// lower the sum of squares by sixteen variances (four standard deviations). `floor` is the residual that counts
    /// as none.
    pub fn score(&self, floor: f64) -> f64 {
        let count = (self.freedom + self.parameters.len()) as f64;
        count * (self.sum / count + floor * floor).ln() + 16.0 * self.parameters.len() as f64
    }
}

/// Minimises the sum of squares of what `residuals` gives (`None` outside its domain) from `start`. `scale` is what
/// counts as a large change of each parameter; without any, the sum is all there is. `None` if the start is outside,
/// there are no more residuals than parameters, or a parameter has no influence there.
pub(super) fn least_squares(
    start: &[f64],
    scale: &[f64],
    residuals: impl Fn(&[f64]) -> Option<Vec<f64>>,
) -> Option<Least> {
    let evaluate = |x: &[f64]| {
        let r = DVector::from_vec(residuals(x)?);
        let sum = r.norm_squared();
        sum.is_finite().then_some((r, sum))
    };
    let mut x = start.to_vec();
    let (mut r, mut sum) = evaluate(&x)?;
    if r.len() <= x.len() {
        return None;
    }
    if x.is_empty() {
        let freedom = r.len();
        let (covariance, jacobian) = (DMatrix::zeros(0, 0), DMatrix::zeros(freedom, 0));
        return Some(Least { parameters: x, covariance, jacobian, sum, freedom });
    }
    let mut damping = 1e-3;
    let mut jacobian = slopes(&x, scale, r.len(), &residuals)?;
    for _ in 0..ROUNDS {
        let gram = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &r;
        let before = sum;
        let mut moved = false;
        while damping < STIFF {
            let mut damped = gram.clone();
            for i in 0..x.len() {
                damped[(i, i)] += damping * gram[(i, i)].max(f64::MIN_POSITIVE);
            }
            let trial = damped.cholesky().map(|c| c.solve(&gradient)).and_then(|step| {
                let next: Vec<f64> = x.iter().zip(scale).zip(step.iter()).map(|((x, s), d)| x - s * d).collect();
                evaluate(&next).filter(|(_, sum)| *sum < before).map(|found| (next, found))
            });
            if let Some((next, found)) = trial {
                (x, (r, sum), moved) = (next, found, true);
                damping = (0.1 * damping).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        if moved {
            jacobian = slopes(&x, scale, r.len(), &residuals)?;
        }
        if !moved || before - sum <= CHANGE * before {
            break;
        }
    }
    let freedom = (r.len() - x.len()).max(1);
    let covariance = inverse(&(jacobian.transpose() * &jacobian))? * (sum / freedom as f64);
    let covariance = DMatrix::from_fn(x.len(), x.len(), |i, j| covariance[(i, j)] * scale[i] * scale[j]);
    Some(Least { parameters: x, covariance, jacobian, sum, freedom })
}

/// Inverse of a positive definite matrix by way of its correlations; `None` where that is singular to rounding.
pub(super) fn inverse(gram: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let d: Vec<f64> = gram.diagonal().iter().map(|x| x.sqrt()).collect();
    if !d.iter().all(|d| d.is_finite() && *d > 0.0) {
        return None;
    }
    let n = d.len();
    let factor = DMatrix::from_fn(n, n, |i, j| gram[(i, j)] / (d[i] * d[j])).cholesky()?;
    if factor.l_dirty().diagonal().iter().any(|x| *x < 1e-7) {
        return None;
    }
    let inverse = factor.inverse();
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] / (d[i] * d[j])))
}

/// Derivatives of the residuals by the parameters over their scales: central differences, one-sided at an edge.
fn slopes(
    x: &[f64],
    scale: &[f64],
    count: usize,
    residuals: &impl Fn(&[f64]) -> Option<Vec<f64>>,
) -> Option<DMatrix<f64>> {
    let mut jacobian = DMatrix::zeros(count, x.len());
    for j in 0..x.len() {
        let at = |side: f64| {
            let mut moved = x.to_vec();
            moved[j] += side * DIFFERENCE * scale[j];
            residuals(&moved)
        };
        let (low, high, width) = match (at(-1.0), at(1.0)) {
            (Some(low), Some(high)) => (low, high, 2.0),
            (Some(low), None) => (low, residuals(x)?, 1.0),
            (None, Some(high)) => (residuals(x)?, high, 1.0),
            (None, None) => return None,
        };
        for i in 0..count {
            jacobian[(i, j)] = (high[i] - low[i]) / (width * DIFFERENCE);
        }
    }
    Some(jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_comes_out_as_the_textbook_has_it() {
        // y = 2 + 3 x with residuals +1, -1, -1, +1 off a line at x = 0, 1, 2, 3: s2 = 4 / 2, var(slope) = s2 / 5.
        let y = [3.0, 4.0, 7.0, 12.0];
        let fit =
            least_squares(&[0.0, 0.0], &[1.0, 1.0], |p| Some((0..4).map(|i| p[0] + p[1] * i as f64 - y[i]).collect()))
                .unwrap();
        assert!((fit.parameters[0] - 2.0).abs() < 1e-9 && (fit.parameters[1] - 3.0).abs() < 1e-9);
        assert!((fit.sum - 4.0).abs() < 1e-9);
        assert!((fit.measured(1).uncertainty - (2.0f64 / 5.0).sqrt()).abs() < 1e-8);
    }

    #[test]
    fn rosenbrocks_valley_is_followed_to_its_end() {
        let fit =
            least_squares(&[-1.2, 1.0], &[1.0, 1.0], |p| Some(vec![10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0], 0.0]))
                .unwrap();
        assert!((fit.parameters[0] - 1.0).abs() < 1e-6 && (fit.parameters[1] - 1.0).abs() < 1e-6, "{fit:?}");
    }

    #[test]
    fn a_parameter_without_influence_is_no_fit() {
        assert!(least_squares(&[1.0, 1.0], &[1.0, 1.0], |p| Some(vec![p[0], p[0] - 1.0, p[0] + 1.0])).is_none());
        assert!(least_squares(&[1.0], &[1.0], |_| None).is_none());
        assert!(least_squares(&[1.0], &[1.0], |p| Some(vec![p[0]])).is_none());
    }
}

//! The columns of the model, and the residuals with everything linear eliminated (variable projection).

use nalgebra::{DMatrix, DVector};

use super::record::Series;

/// How many of what the model has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Shape {
    /// Damped oscillations: two nonlinear parameters each (decay, angular frequency).
    pub oscillations: usize,
    /// Relaxations: one each (rate). They follow the oscillations.
    pub relaxations: usize,
    /// Whether the offset moves linearly.
    pub drift: bool,
}

impl Shape {
    pub fn nonlinear(self) -> usize {
        2 * self.oscillations + self.relaxations
    }

    /// Linear parameters of one channel: offset, drift, then (cos, sin) of each oscillation, then the relaxations.
    pub fn linear(self) -> usize {
        self.first() + 2 * self.oscillations + self.relaxations
    }

    /// Column of the first oscillation or relaxation.
    pub fn first(self) -> usize {
        1 + usize::from(self.drift)
    }

    /// All parameters, over so many channels.
    pub fn parameters(self, channels: usize) -> usize {
        self.nonlinear() + channels * self.linear()
    }

    /// Columns at `theta`, each as long as `time`. The drift's is time over `span`.
    pub fn columns(self, theta: &[f64], time: &[f64], span: f64) -> Vec<Vec<f64>> {
        let mut columns = vec![vec![1.0; time.len()]];
        if self.drift {
            columns.push(time.iter().map(|t| t / span).collect());
        }
        for k in 0..self.oscillations {
            let (decay, omega) = (theta[2 * k], theta[2 * k + 1]);
            let (cos, sin) = time
                .iter()
                .map(|t| {
                    let (envelope, (sin, cos)) = ((-decay * t).exp(), (omega * t).sin_cos());
                    (envelope * cos, envelope * sin)
                })
                .unzip();
            columns.push(cos);
            columns.push(sin);
        }
        for rate in &theta[2 * self.oscillations..] {
            columns.push(time.iter().map(|t| (-rate * t).exp()).collect());
        }
        columns
    }

    /// Derivative of `columns * coefficients` by parameter `index`, at every time.
    pub fn derivative(self, index: usize, columns: &[Vec<f64>], coefficients: &DVector<f64>, time: &[f64]) -> Vec<f64> {
        let first = self.first();
        if index >= 2 * self.oscillations {
            let j = first + index;
            return time.iter().zip(&columns[j]).map(|(t, x)| -t * x * coefficients[j]).collect();
        }
        let j = first + 2 * (index / 2);
        let (a, b) = (coefficients[j], coefficients[j + 1]);
        let pairs = time.iter().zip(columns[j].iter().zip(&columns[j + 1]));
        if index.is_multiple_of(2) {
            pairs.map(|(t, (cos, sin))| -t * (a * cos + b * sin)).collect()
        } else {
            pairs.map(|(t, (cos, sin))| t * (b * cos - a * sin)).collect()
        }
    }
}

/// One channel at given nonlinear parameters, its linear ones eliminated.
#[derive(Clone, Debug)]
pub(super) struct Projection {
    /// Best linear parameters.
    pub coefficients: DVector<f64>,
    /// Value minus model at every sample, outliers too.
    pub residuals: Vec<f64>,
    /// Weighted sum of squares.
    pub cost: f64,
    /// Inverse of the linear parameters' own normal matrix.
    pub inverse: DMatrix<f64>,
    /// Normal matrix of the nonlinear parameters, with the linear ones free to follow.
    pub normal: DMatrix<f64>,
    /// Its right-hand side: the direction downhill.
    pub gradient: DVector<f64>,
    /// How the linear parameters follow: minus their derivative by the nonlinear ones.
    pub follow: DMatrix<f64>,
}

/// Projects one channel. `None` where the columns are not independent to rounding.
pub(super) fn project(shape: Shape, theta: &[f64], series: &Series, span: f64) -> Option<Projection> {
    let columns = shape.columns(theta, &series.time, span);
    let root: Vec<f64> = series.weight.iter().map(|w| w.sqrt()).collect();
    let weighted = |x: &[f64]| -> Vec<f64> { x.iter().zip(&root).map(|(x, w)| x * w).collect() };
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(columns.len());
    let count = columns.len();
    let mut upper = DMatrix::zeros(count, count);
    for (j, column) in columns.iter().enumerate() {
        let mut q = weighted(column);
        let before = norm(&q);
        orthogonalise(&mut q, &basis, |i, share| upper[(i, j)] += share);
        let left = norm(&q);
        if left.is_nan() || left <= 1e-10 * before {
            return None;
        }
        upper[(j, j)] = left;
        q.iter_mut().for_each(|x| *x /= left);
        basis.push(q);
    }
    let triangular = |right: &DVector<f64>| upper.solve_upper_triangular(right);
    let mut left = weighted(&series.value);
    let mut shares = DVector::zeros(count);
    orthogonalise(&mut left, &basis, |i, share| shares[i] += share);
    let coefficients = triangular(&shares)?;
    let residuals = (0..series.time.len())
        .map(|i| series.value[i] - (0..count).map(|j| columns[j][i] * coefficients[j]).sum::<f64>())
        .collect();
    let inner = shape.nonlinear();
    let mut follow = DMatrix::zeros(count, inner);
    let mut tangents = Vec::with_capacity(inner);
    for p in 0..inner {
        let mut tangent = weighted(&shape.derivative(p, &columns, &coefficients, &series.time));
        let mut shares = DVector::zeros(count);
        orthogonalise(&mut tangent, &basis, |i, share| shares[i] += share);
        follow.set_column(p, &triangular(&shares)?);
        tangents.push(tangent);
    }
    let inverse = upper.solve_upper_triangular(&DMatrix::identity(count, count))?;
    Some(Projection {
        coefficients,
        residuals,
        cost: dot(&left, &left),
        inverse: &inverse * inverse.transpose(),
        normal: DMatrix::from_fn(inner, inner, |i, j| dot(&tangents[i], &tangents[j])),
        gradient: DVector::from_fn(inner, |i, _| dot(&tangents[i], &left)),
        follow,
    })
}

/// Takes the part of `x` along each of `basis` (orthonormal) off, twice, so that what is left is orthogonal to
/// rounding; `shares` hears how much went.
pub(super) fn orthogonalise(x: &mut [f64], basis: &[Vec<f64>], mut shares: impl FnMut(usize, f64)) {
    for _ in 0..2 {
        for (i, q) in basis.iter().enumerate() {
            let share = dot(q, x);
            shares(i, share);
            x.iter_mut().zip(q).for_each(|(x, q)| *x -= share * q);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(super) fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ident::ringdown::record::{Channel, prepare};

    /// The gradient of the projected cost against differences of the cost itself.
    #[test]
    fn the_gradient_is_that_of_the_cost() {
        let times: Vec<f64> = (0..80).map(|i| 0.01 * f64::from(i)).collect();
        let values: Vec<f64> = times
            .iter()
            .map(|t| (-3.0 * t).exp() * (40.0 * t + 0.4).cos() + 0.1 * t + (91.0 * t).sin() * 0.02)
            .collect();
        let (series, _, span) = prepare(&[Channel::angle(&times, &values, 50.0)]).unwrap();
        let shape = Shape { oscillations: 1, relaxations: 1, drift: true };
        let theta = [2.7, 39.0, 5.0];
        let at = project(shape, &theta, &series[0], span).unwrap();
        for p in 0..3 {
            let h = 1e-5 * theta[p];
            let cost = |sign: f64| {
                let mut moved = theta;
                moved[p] += sign * h;
                project(shape, &moved, &series[0], span).unwrap().cost
            };
            let difference = (cost(1.0) - cost(-1.0)) / (2.0 * h);
            // Central differences: h^2 and rounding, both far below one in a million here.
            assert!(
                (difference + 2.0 * at.gradient[p]).abs() < 1e-5 * difference.abs().max(1e-3),
                "{p} {difference} {}",
                at.gradient[p]
            );
        }
    }
}

//! The two methods that a ring-down is usually read with, to compare the fit of this floor with.

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

/// Decay and angular frequency, without uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlainDecay {
    /// d, 1/s.
    pub decay: f64,
    /// w, damped, rad/s.
    pub omega: f64,
}

/// Why a plain method has no answer.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum PlainError {
    /// Too few peaks.
    #[error("a log decrement needs at least two peaks; there are {0}")]
    Peaks(usize),
    /// No decay.
    #[error("the curve fit did not converge")]
    NotConverged,
}

/// Log decrement: peaks between the zero crossings of the signal without its mean, down to a tenth of the first one; a
/// line through their logarithms; the frequency from their times.
pub fn log_decrement(times: &[f64], values: &[f64]) -> Result<PlainDecay, PlainError> {
    let tail = &values[values.len() / 2..];
    let mean = tail.iter().sum::<f64>() / tail.len().max(1) as f64;
    let mut peaks: Vec<(f64, f64)> = vec![];
    let mut sign = 0.0;
    for (t, v) in times.iter().zip(values) {
        let x = v - mean;
        match peaks.last_mut() {
            Some(peak) if x.signum() == sign => {
                if x.abs() > peak.1 {
                    *peak = (*t, x.abs());
                }
            }
            _ => peaks.push((*t, x.abs())),
        }
        sign = x.signum();
    }
    let first = peaks.first().map_or(0.0, |p| p.1);
    let end = peaks.iter().position(|p| p.1 < 0.1 * first).unwrap_or(peaks.len());
    let peaks = &peaks[..end];
    if peaks.len() < 2 {
        return Err(PlainError::Peaks(peaks.len()));
    }
    let count = peaks.len() as f64;
    let index = |i: usize| i as f64 - (count - 1.0) / 2.0;
    let slope = |y: &dyn Fn(usize) -> f64| {
        let top: f64 = (0..peaks.len()).map(|i| index(i) * y(i)).sum();
        top / (0..peaks.len()).map(|i| index(i).powi(2)).sum::<f64>()
    };
    let half = slope(&|i| peaks[i].0);
    Ok(PlainDecay { decay: -slope(&|i| peaks[i].1.ln()) / half, omega: std::f64::consts::PI / half })
}

/// Plain least squares of offset + exp(-d t)(a cos w t + b sin w t), all five parameters at once, from the log
/// decrement's values: no weights, no outliers, no choice of a model.
pub fn curve_fit(times: &[f64], values: &[f64]) -> Result<PlainDecay, PlainError> {
    let start = log_decrement(times, values)?;
    let t0 = times.first().copied().unwrap_or(0.0);
    let tail = &values[values.len() / 2..];
    let mean = tail.iter().sum::<f64>() / tail.len().max(1) as f64;
    let first = values.first().map_or(0.0, |v| v - mean);
    let mut p = DVector::from_vec(vec![mean, first, 0.0, start.decay, start.omega]);
    let residuals = |p: &DVector<f64>| {
        let model = |t: f64| {
            let (sin, cos) = (p[4] * t).sin_cos();
            p[0] + (-p[3] * t).exp() * (p[1] * cos + p[2] * sin)
        };
        DVector::from_iterator(times.len(), times.iter().zip(values).map(|(t, v)| v - model(t - t0)))
    };
    let mut left = residuals(&p);
    let mut damping = 1e-3;
    for _ in 0..200 {
        let jacobian = DMatrix::from_fn(times.len(), 5, |i, j| {
            let t = times[i] - t0;
            let ((sin, cos), envelope) = ((p[4] * t).sin_cos(), (-p[3] * t).exp());
            match j {
                0 => 1.0,
                1 => envelope * cos,
                2 => envelope * sin,
                3 => -t * envelope * (p[1] * cos + p[2] * sin),
                _ => t * envelope * (p[2] * cos - p[1] * sin),
            }
        });
        let gradient = jacobian.transpose() * &left;
        let mut normal = jacobian.transpose() * &jacobian;
        (0..5).for_each(|i| normal[(i, i)] *= 1.0 + damping);
        let step = normal.cholesky().ok_or(PlainError::NotConverged)?.solve(&gradient);
        if step.dot(&gradient) <= 1e-12 * left.norm_squared() {
            return Ok(PlainDecay { decay: p[3], omega: p[4].abs() });
        }
        let next = &p + step;
        let there = residuals(&next);
        if there.norm_squared() < left.norm_squared() {
            (p, left, damping) = (next, there, damping / 10.0);
        } else {
            damping *= 10.0;
        }
    }
    Err(PlainError::NotConverged)
}

//! From a fit to what it says, with uncertainties, and the refusals that only the result shows.

use std::f64::consts::TAU;

use nalgebra::DMatrix;

use super::RingDownError;
use super::decay::{ChannelFit, Decay, Mode, Motion, Relaxation, RingDown};
use super::fit::Fit;
use super::record::{ChannelKind, Series};
use crate::ident::Measured;
use crate::ident::noise::Colour;

/// Cycles that a record needs to hold, unless the motion is gone before that; a little under two, so that two cycles
/// cut at the last sample are two.
const CYCLES_MIN: f64 = 1.9;
/// e-folds after which a motion is as good as gone.
const FOLDS_GONE: f64 = 3.0;
/// Largest relative standard uncertainty of a decay that still says something.
const RELATIVE_MAX: f64 = 0.5;
/// Amplitude of a rate over that of its angle may be off from |pole| by this factor (sensor filters); an alias is off
/// by much more.
const ALIAS: f64 = 1.6;

/// Everything about the poles that the uncertainties need.
struct Poles {
    covariance: DMatrix<f64>,
    freedom: usize,
}

pub(super) fn summarise(fit: &Fit, start: f64) -> Result<Decay, RingDownError> {
    let shape = fit.shape;
    let plain = fit.normal().try_inverse().ok_or(RingDownError::NotConverged)?;
    // The noise counts where the mode is: a coloured one is denser there, or thinner.
    let colours = fit.colours();
    let dense = |i: usize| {
        let omega = if i < 2 * shape.oscillations { fit.theta[i / 2 * 2 + 1] } else { 0.0 };
        let at = |(c, s): (&Colour, &Series)| c.density(omega * s.interval);
        colours.iter().zip(&fit.series).map(at).fold(1.0, f64::max).sqrt()
    };
    let density: Vec<f64> = (0..shape.nonlinear()).map(dense).collect();
    let covariance = DMatrix::from_fn(plain.nrows(), plain.ncols(), |i, j| plain[(i, j)] * density[i] * density[j]);
    let poles = Poles { covariance, freedom: fit.freedom(&colours) };
    match shape.oscillations {
        0 => relaxation(fit, &poles, start).map(Decay::Relaxation),
        _ => ring_down(fit, &poles, start).map(Decay::RingDown),
    }
}

impl Poles {
    fn measured(&self, value: f64, variance: f64) -> Measured {
        Measured { value, uncertainty: variance.max(0.0).sqrt(), freedom: self.freedom }
    }

    fn estimate(&self, fit: &Fit, index: usize) -> Measured {
        self.measured(fit.theta[index], self.covariance[(index, index)])
    }
}

/// Covariance of one channel's linear parameters: their own, and how they follow the poles.
fn linear(fit: &Fit, poles: &Poles, channel: usize) -> DMatrix<f64> {
    let p = &fit.projections[channel];
    &p.inverse + &p.follow * &poles.covariance * p.follow.transpose()
}

fn channels(fit: &Fit, poles: &Poles) -> Vec<ChannelFit> {
    let of = |c: usize| {
        let (p, s) = (&fit.projections[c], &fit.series[c]);
        let covariance = linear(fit, poles, c);
        let estimate = |j: usize| poles.measured(p.coefficients[j], covariance[(j, j)]);
        let kept: Vec<f64> = p.residuals.iter().zip(&s.weight).filter(|(_, w)| **w > 0.0).map(|(r, _)| r * r).collect();
        ChannelFit {
            offset: estimate(0),
            drift: fit.shape.drift.then(|| estimate(1).times(1.0 / fit.span)),
            residual: (kept.iter().sum::<f64>() / kept.len().max(1) as f64).sqrt(),
            used: kept.len(),
            outliers: s.time.len() - kept.len(),
            clipped: s.clipped,
        }
    };
    (0..fit.series.len()).map(of).collect()
}

fn ring_down(fit: &Fit, poles: &Poles, start: f64) -> Result<RingDown, RingDownError> {
    let shape = fit.shape;
    let bandwidth = fit.series.iter().map(|s| s.bandwidth).fold(f64::INFINITY, f64::min);
    let mode = |k: usize| {
        let (decay, omega) = (poles.estimate(fit, 2 * k), poles.estimate(fit, 2 * k + 1));
        let motion = (0..fit.series.len()).map(|c| motion(fit, poles, c, k)).collect();
        Mode::new(decay, omega, poles.covariance[(2 * k, 2 * k + 1)], motion, omega.value / TAU <= bandwidth)
    };
    let modes: Vec<Mode> = (0..shape.oscillations).map(mode).collect();
    let energy =
        |m: &Mode| m.motion.first().map_or(0.0, |a| a.amplitude.value.powi(2)) / m.decay.value.max(0.1 / fit.span);
    let mut order: Vec<usize> = (0..modes.len()).collect();
    order.sort_by(|&a, &b| energy(&modes[b]).total_cmp(&energy(&modes[a])));
    let rows: Vec<usize> =
        order.iter().flat_map(|k| [2 * k, 2 * k + 1]).chain(2 * modes.len()..shape.nonlinear()).collect();
    let modes: Vec<Mode> = order.iter().map(|&k| modes[k].clone()).collect();
    if let Some(main) = modes.first() {
        check(main, fit, bandwidth)?;
    }
    Ok(RingDown {
        modes,
        creep: (2 * shape.oscillations..shape.nonlinear()).map(|i| poles.estimate(fit, i)).collect(),
        channels: channels(fit, poles),
        covariance: poles.covariance.select_rows(&rows).select_columns(&rows),
        freedom: poles.freedom,
        start,
    })
}

/// Whether the strongest mode may be believed.
fn check(mode: &Mode, fit: &Fit, bandwidth: f64) -> Result<(), RingDownError> {
    let frequency = mode.frequency.value;
    let find = |kind: ChannelKind| fit.series.iter().position(|s| s.kind == kind);
    if let (Some(angle), Some(rate)) = (find(ChannelKind::Angle), find(ChannelKind::Rate)) {
        let ratio = mode.motion[rate].amplitude.value / mode.motion[angle].amplitude.value;
        let off = ratio / mode.square().value.sqrt();
        if !(1.0 / ALIAS..ALIAS).contains(&off) {
            return Err(RingDownError::Aliased { apparent: frequency, implied: ratio / TAU });
        }
    }
    if !mode.trusted {
        return Err(RingDownError::BeyondSensor { frequency, bandwidth });
    }
    let cycles = frequency * fit.span;
    if cycles < CYCLES_MIN && mode.decay.value * fit.span < FOLDS_GONE {
        return Err(RingDownError::TooShort { cycles });
    }
    let unsure = mode.decay.value <= 0.0 || mode.decay.uncertainty > RELATIVE_MAX * mode.decay.value;
    if unsure || mode.omega.uncertainty > RELATIVE_MAX * mode.omega.value {
        return Err(RingDownError::Unresolved { decay: mode.decay.value, uncertainty: mode.decay.uncertainty });
    }
    Ok(())
}

fn motion(fit: &Fit, poles: &Poles, channel: usize, k: usize) -> Motion {
    let j = fit.shape.first() + 2 * k;
    let p = &fit.projections[channel];
    let covariance = linear(fit, poles, channel);
    // a cos + b sin = A cos(w t + phase): a = A cos(phase), b = -A sin(phase)
    let (a, b) = (p.coefficients[j], p.coefficients[j + 1]);
    let amplitude = a.hypot(b).max(f64::MIN_POSITIVE);
    let (c, s) = (a / amplitude, b / amplitude);
    let (aa, ab, bb) = (covariance[(j, j)], covariance[(j, j + 1)], covariance[(j + 1, j + 1)]);
    let along = c * c * aa + 2.0 * c * s * ab + s * s * bb;
    let across = s * s * aa - 2.0 * c * s * ab + c * c * bb;
    Motion {
        amplitude: poles.measured(amplitude, along),
        phase: poles.measured((-b).atan2(a), across / (amplitude * amplitude)),
    }
}

fn relaxation(fit: &Fit, poles: &Poles, start: f64) -> Result<Relaxation, RingDownError> {
    let mut order: Vec<usize> = (0..fit.theta.len()).collect();
    order.sort_by(|&a, &b| fit.theta[a].total_cmp(&fit.theta[b]));
    let slow = poles.estimate(fit, order[0]);
    let fast = order.get(1).map(|&i| poles.estimate(fit, i));
    if slow.value * fit.span < 1.0 {
        return Err(RingDownError::TooShort { cycles: 0.0 });
    }
    if slow.uncertainty > RELATIVE_MAX * slow.value {
        return Err(RingDownError::Unresolved { decay: slow.value, uncertainty: slow.uncertainty });
    }
    let inverse = |e: Measured| e.follows(1.0 / e.value, e.uncertainty / (e.value * e.value));
    let covariance = poles.covariance.select_rows(&order).select_columns(&order);
    let both = fast.map_or(inverse(slow), |fast| {
        let (s, f) = (inverse(slow), inverse(fast));
        let shared = covariance[(0, 1)] / (slow.value * fast.value).powi(2);
        let variance = s.uncertainty.powi(2) + f.uncertainty.powi(2) + 2.0 * shared;
        poles.measured(s.value + f.value, variance)
    });
    Ok(Relaxation {
        rate: slow,
        time_constant: inverse(slow),
        fast,
        damping_over_stiffness: both,
        channels: channels(fit, poles),
        covariance,
        freedom: poles.freedom,
        start,
    })
}

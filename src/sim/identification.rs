//! The identification study: ring-downs of FREEs that the fit does not know, and how far off it is.

use std::f64::consts::TAU;

use super::ringdown::{Plucked, Sensing};
use crate::ident::Measured;
use crate::ident::ringdown::{
    Channel, Decay, PlainDecay, PlainError, RingDownError, curve_fit, fit_ring_down, log_decrement,
};

/// Cycles of a record, at most: shorter where the motion is in the noise before.
pub const CYCLES: f64 = 30.0;

/// One FREE of the study.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// The true one.
    pub truth: Plucked,
    /// kt, N m/rad, with the inertia known.
    pub stiffness: Measured,
    /// ct, N m s/rad.
    pub damping: Measured,
    /// Damped frequency, Hz.
    pub frequency: Measured,
    /// Modes found; one is right.
    pub modes: usize,
    /// Whether a drift or a creep was seen; there is none.
    pub more: bool,
}

/// Errors of kt, ct and frequency, relative.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Of kt.
    pub stiffness: f64,
    /// Of ct.
    pub damping: f64,
    /// Of the damped frequency.
    pub frequency: f64,
}

/// What a study says: medians of the errors' magnitudes, and the share of 95 % intervals that hold the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Study {
    /// Median magnitude of the relative errors.
    pub median: Errors,
    /// Largest magnitude.
    pub worst: Errors,
    /// Share of intervals that hold the truth, 0 to 1.
    pub coverage: Errors,
    /// FREEs that were fitted.
    pub count: usize,
}

/// The record of one FREE of the study: times (s) and angles (rad), of `cycles` at most.
pub fn record(truth: &Plucked, sensing: &Sensing, cycles: f64) -> (Vec<f64>, Vec<f64>) {
    // A record of fewer samples than make a fit is nothing that a person would keep.
    let length = truth.length(cycles, sensing.noise).max(24.0 / sensing.rate);
    sensing.record(length, |t| truth.motion(t).0)
}

/// Identifies the FREE of `seed` from what `sensing` sees of at most `cycles`. A relaxation comes back as unresolved:
/// every FREE of the study oscillates.
pub fn trial(seed: u64, sensing: &Sensing, cycles: f64) -> Result<Trial, RingDownError> {
    let truth = Plucked::seeded(seed);
    let (times, angles) = record(&truth, sensing, cycles);
    let channel = Channel { resolution: sensing.resolution, ..Channel::angle(&times, &angles, 20.0) };
    match fit_ring_down(&[channel])? {
        Decay::RingDown(fit) if !fit.modes.is_empty() => {
            let mode = &fit.modes[0];
            let torsion = mode.torsion(Measured::exact(truth.inertia));
            Ok(Trial {
                truth,
                stiffness: torsion.stiffness,
                damping: torsion.damping,
                frequency: mode.frequency,
                modes: fit.modes.len(),
                more: !fit.creep.is_empty() || fit.channels.iter().any(|c| c.drift.is_some()),
            })
        }
        Decay::RingDown(_) => Err(RingDownError::NotConverged),
        Decay::Relaxation(fit) => {
            Err(RingDownError::Unresolved { decay: fit.rate.value, uncertainty: fit.rate.uncertainty })
        }
    }
}

impl Trial {
    /// Relative errors.
    pub fn errors(&self) -> Errors {
        let estimate = |value: f64, truth: f64| value / truth - 1.0;
        Errors {
            stiffness: estimate(self.stiffness.value, self.truth.stiffness),
            damping: estimate(self.damping.value, self.truth.damping),
            frequency: estimate(self.frequency.value, self.truth.omega() / TAU),
        }
    }

    /// Whether the 95 % intervals hold the truth.
    pub fn covered(&self) -> [bool; 3] {
        [
            self.stiffness.covers(self.truth.stiffness),
            self.damping.covers(self.truth.damping),
            self.frequency.covers(self.truth.omega() / TAU),
        ]
    }
}

impl Errors {
    /// Relative errors of a plain method.
    pub fn of_plain(plain: &PlainDecay, truth: &Plucked) -> Self {
        let square = truth.stiffness / truth.inertia;
        Self {
            stiffness: (plain.decay.powi(2) + plain.omega.powi(2)) / square - 1.0,
            damping: plain.decay / truth.decay() - 1.0,
            frequency: plain.omega / truth.omega() - 1.0,
        }
    }

    /// Medians of magnitudes; zero of nothing.
    pub fn median(errors: &[Self]) -> Self {
        Self::each(errors, |sorted| sorted[(sorted.len() - 1) / 2])
    }

    /// Largest magnitudes; zero of nothing.
    pub fn worst(errors: &[Self]) -> Self {
        Self::each(errors, |sorted| sorted[sorted.len() - 1])
    }

    fn each(errors: &[Self], pick: impl Fn(&[f64]) -> f64) -> Self {
        let of = |field: fn(&Self) -> f64| {
            let mut all: Vec<f64> = errors.iter().map(|e| field(e).abs()).collect();
            all.sort_by(f64::total_cmp);
            if all.is_empty() { 0.0 } else { pick(&all) }
        };
        Self { stiffness: of(|e| e.stiffness), damping: of(|e| e.damping), frequency: of(|e| e.frequency) }
    }
}

impl Study {
    /// Sums `trials` up.
    pub fn of(trials: &[Trial]) -> Self {
        let errors: Vec<_> = trials.iter().map(Trial::errors).collect();
        let share = |k: usize| trials.iter().filter(|t| t.covered()[k]).count() as f64 / trials.len().max(1) as f64;
        Self {
            median: Errors::median(&errors),
            worst: Errors::worst(&errors),
            coverage: Errors { stiffness: share(0), damping: share(1), frequency: share(2) },
            count: trials.len(),
        }
    }
}

/// The two plain methods on the same record: log decrement, curve fit.
pub fn plain(seed: u64, sensing: &Sensing, cycles: f64) -> [Result<Errors, PlainError>; 2] {
    let truth = Plucked::seeded(seed);
    let (times, angles) = record(&truth, sensing, cycles);
    [log_decrement(&times, &angles), curve_fit(&times, &angles)].map(|p| p.map(|p| Errors::of_plain(&p, &truth)))
}

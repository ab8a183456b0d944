//! What a ring-down says: modes, or a relaxation.

use nalgebra::DMatrix;

use crate::ident::Measured;

/// One damped oscillation, A exp(-d t) cos(w t + phase).
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// d, 1/s.
    pub decay: Measured,
    /// w, the damped angular frequency, rad/s.
    pub omega: Measured,
    /// Covariance of the two, 1/s2.
    pub covariance: f64,
    /// Frequency at which it is seen to oscillate, w / 2 pi, Hz.
    pub frequency: Measured,
    /// Damping ratio d / sqrt(d^2 + w^2), 1 is critical.
    pub damping_ratio: Measured,
    /// Amplitude and phase by channel.
    pub motion: Vec<Motion>,
    /// Whether the frequency lies within the bandwidth that every channel is trusted for.
    pub trusted: bool,
}

/// What one channel sees of a mode, at the start of the record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Amplitude, rad or rad/s.
    pub amplitude: Measured,
    /// Phase of the cosine, rad.
    pub phase: Measured,
}

impl Mode {
    pub(super) fn new(decay: Measured, omega: Measured, covariance: f64, motion: Vec<Motion>, trusted: bool) -> Self {
        let (d, w) = (decay.value, omega.value);
        let square = d * d + w * w;
        let ratio = d / square.sqrt();
        // d ratio = (w^2, -d w) / (d^2 + w^2)^(3/2)
        let (by_d, by_w) = (w * w / square.powf(1.5), -d * w / square.powf(1.5));
        let variance =
            (by_d * decay.uncertainty).powi(2) + (by_w * omega.uncertainty).powi(2) + 2.0 * by_d * by_w * covariance;
        let turn = std::f64::consts::TAU;
        Self {
            decay,
            omega,
            covariance,
            frequency: omega.times(1.0 / turn),
            damping_ratio: decay.follows(ratio, variance.max(0.0).sqrt()),
            motion,
            trusted,
        }
    }

    /// Square of the undamped angular frequency, d^2 + w^2 = kt / I, 1/s2.
    pub fn square(&self) -> Measured {
        let (d, w) = (self.decay.value, self.omega.value);
        let variance =
            (d * self.decay.uncertainty).powi(2) + (w * self.omega.uncertainty).powi(2) + 2.0 * d * w * self.covariance;
        self.decay.follows(d * d + w * w, 2.0 * variance.max(0.0).sqrt())
    }
}

/// What the fit says of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelFit {
    /// Value at rest, at the start of the record, rad or rad/s.
    pub offset: Measured,
    /// Its drift, per second; `None` where the samples do not speak for one.
    pub drift: Option<Measured>,
    /// Root mean square of the residuals of the samples used, rad or rad/s.
    pub residual: f64,
    /// Samples used.
    pub used: usize,
    /// Samples taken out as outliers.
    pub outliers: usize,
    /// Samples left out as clipped.
    pub clipped: usize,
}

/// A motion that oscillates.
#[derive(Clone, Debug, PartialEq)]
pub struct RingDown {
    /// By the energy of their motion in the first channel, the greatest first.
    pub modes: Vec<Mode>,
    /// Slow relaxations seen beside the modes (creep), by rate, 1/s.
    pub creep: Vec<Measured>,
    /// By channel.
    pub channels: Vec<ChannelFit>,
    /// Covariance of (d, w) of each mode in turn, then of the creep's rates.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom.
    pub freedom: usize,
    /// Time to which amplitudes, phases and offsets belong, s: the first usable sample.
    pub start: f64,
}

/// A motion that creeps back without oscillating: overdamped.
#[derive(Clone, Debug, PartialEq)]
pub struct Relaxation {
    /// Slow rate, 1/s; far beyond critical damping kt/ct.
    pub rate: Measured,
    /// Its inverse, s.
    pub time_constant: Measured,
    /// Fast rate, where the samples resolve it, 1/s.
    pub fast: Option<Measured>,
    /// ct/kt, s: the sum of both time constants. Without the fast one it is the slow time constant, low by
    /// 1/(4 ratio^2) (0.5 % at a damping ratio of 7.3).
    pub damping_over_stiffness: Measured,
    /// By channel.
    pub channels: Vec<ChannelFit>,
    /// Covariance of the rates, slow one first.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom.
    pub freedom: usize,
    /// Time to which offsets belong, s: the first usable sample.
    pub start: f64,
}

/// What a FREE does when it is let go.
#[derive(Clone, Debug, PartialEq)]
pub enum Decay {
    /// It oscillates.
    RingDown(RingDown),
    /// It does not: the inertia is not identifiable from the motion (unless the fast rate is seen too).
    Relaxation(Relaxation),
}

impl Relaxation {
    /// I/kt, s2: the product of both time constants. `None` where the samples do not resolve the fast rate: then the
    /// inertia is not identifiable from the motion.
    pub fn inertia_over_stiffness(&self) -> Option<Measured> {
        let fast = self.fast?;
        let value = 1.0 / (self.rate.value * fast.value);
        let (by_slow, by_fast) = (1.0 / self.rate.value, 1.0 / fast.value);
        let variance = (by_slow * self.rate.uncertainty).powi(2)
            + (by_fast * fast.uncertainty).powi(2)
            + 2.0 * by_slow * by_fast * self.covariance[(0, 1)];
        Some(fast.follows(value, value * variance.max(0.0).sqrt()))
    }
}

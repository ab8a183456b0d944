//! Ring-down: stiffness and damping from how a FREE comes to rest after a pluck or a dump of its pressure.
//!
//! I phi'' + ct phi' + kt phi = 0 has the poles -d +- i w with d = ct / 2I and d^2 + w^2 = kt / I; beyond critical
//! damping two real ones, whose product is kt / I and whose time constants add up to ct / kt. What a sensor sees is
//!
//! ```text
//! y(t) = offset (+ drift t) + sum exp(-d t) (a cos w t + b sin w t) (+ sum c exp(-p t)) + noise
//! ```
//!
//! linear in all but the poles. The linear parameters are eliminated (variable projection), the poles found by
//! Levenberg-Marquardt from the peaks of a bank of damped matched filters; outliers are taken out beyond 4.5 robust
//! standard deviations; the number of modes, a drift, and whether it oscillates at all are chosen by evidence.
//!
//! **Uncertainties** are those of least squares with the noise that the residuals show, never less than the
//! quantisation makes, and times the density of the noise at the mode where the residuals are correlated. They hold for
//! a linear FREE; an amplitude-dependent frequency shows in the residuals, and in part only.
//!
//! **What cannot be told.** A mode above half the sampling rate folds down and is one in the samples of one channel:
//! only the sensor's own filter keeps it away. With angles and rates together it is found out, as the rate's amplitude
//! is |pole| times the angle's. Of an overdamped FREE the slow pole alone remains: ct/kt, not the inertia.

use thiserror::Error;

mod basis;
mod decay;
mod evidence;
mod fit;
mod plain;
mod record;
mod start;
mod summary;
mod torsion;

pub use decay::{ChannelFit, Decay, Mode, Motion, Relaxation, RingDown};
pub use plain::{PlainDecay, PlainError, curve_fit, log_decrement};
pub use record::{CLIPPED_MAX, Channel, ChannelKind, SAMPLES_MIN};
pub use torsion::{SEPARATION_MIN, Torsion, TorsionError, torsion_from_added};

/// Evidence, in twice log-likelihood beyond what the parameters cost, below which nothing is said to have moved.
const EXCITATION_MIN: f64 = 40.0;

/// Why there is no ring-down.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RingDownError {
    /// No channel.
    #[error("a ring-down needs at least one channel")]
    Nothing,
    /// The histories do not fit together.
    #[error("channel {channel}: {times} times but {values} values")]
    Lengths {
        /// Which channel.
        channel: usize,
        /// Number of times.
        times: usize,
        /// Number of values.
        values: usize,
    },
    /// Times must increase, and all numbers be finite.
    #[error("channel {channel}: sample {index} is not finite, or not later than the one before it")]
    Sample {
        /// Which channel.
        channel: usize,
        /// Which sample.
        index: usize,
    },
    /// Impossible resolution, limit or bandwidth.
    #[error("channel {channel}: resolution must not be negative, limit and bandwidth must be positive")]
    Settings {
        /// Which channel.
        channel: usize,
    },
    /// Too few samples.
    #[error("channel {channel}: {samples} samples; at least {SAMPLES_MIN} are needed")]
    TooFew {
        /// Which channel.
        channel: usize,
        /// How many there are.
        samples: usize,
    },
    /// Most of it is at the sensor's limit.
    #[error("channel {channel}: {clipped} of {samples} samples are clipped: pluck it less, or choose a wider range")]
    Clipped {
        /// Which channel.
        channel: usize,
        /// Clipped samples.
        clipped: usize,
        /// All samples.
        samples: usize,
    },
    /// The signal is within the noise.
    #[error("no excitation: nothing but an offset, a drift and noise can be told: pluck it harder")]
    NoExcitation,
    /// The record ends too early.
    #[error("too short: {cycles:.1} cycles; at least two are needed, or a record until the motion is gone")]
    TooShort {
        /// Cycles in the record; zero where it is a relaxation.
        cycles: f64,
    },
    /// Beyond what the sensor can be trusted for.
    #[error(
        "a mode at {frequency:.1} Hz is beyond the sensor's {bandwidth} Hz: measure it in a non-fusion mode, or add \
         inertia"
    )]
    BeyondSensor {
        /// What was found, Hz.
        frequency: f64,
        /// What the sensor is trusted for, Hz.
        bandwidth: f64,
    },
    /// Angles and rates contradict each other.
    #[error(
        "aliased: it looks like {apparent:.1} Hz, but rates over angles imply about {implied:.1} Hz: sample faster, or \
         add inertia"
    )]
    Aliased {
        /// Frequency in the samples, Hz.
        apparent: f64,
        /// Frequency that the amplitudes imply, Hz.
        implied: f64,
    },
    /// It moves, but the decay is not seen.
    #[error("the decay is {decay} +- {uncertainty} 1/s: not resolved; record longer or with less noise")]
    Unresolved {
        /// Best value, 1/s.
        decay: f64,
        /// Standard uncertainty, 1/s.
        uncertainty: f64,
    },
    /// No minimum was found.
    #[error("the fit did not converge")]
    NotConverged,
}

/// Fits the decay that `channels` (angles, rates or both, of one motion on one clock, from the release on) show.
pub fn fit_ring_down(channels: &[Channel]) -> Result<Decay, RingDownError> {
    if channels.is_empty() {
        return Err(RingDownError::Nothing);
    }
    let (series, start, span) = record::prepare(channels)?;
    let choice = evidence::choose(&series, span).ok_or(RingDownError::NotConverged)?;
    if choice.evidence.is_nan() || choice.evidence <= EXCITATION_MIN {
        return Err(RingDownError::NoExcitation);
    }
    summary::summarise(&choice.fit, start)
}

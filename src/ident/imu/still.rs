//! Noise, quantum and drift of an angle that stands still.
//!
//! The readings are a line (the drift), white noise and, after a gyro, a random walk. Differences over one reading and
//! over a twentieth of the record tell the two kinds of noise apart: their mean square is `2 w^2 + s^2 T` over a time T
//! for a white noise w and a walk s. The drift is the least-squares line's slope; with N readings over a time T its
//! variance is `12 w^2 / (N T^2)` from the noise and `6/5 s^2 / T` from the walk.

use thiserror::Error;

use crate::ident::Measured;

/// Fewest readings: five seconds at 100 Hz.
pub const READINGS_MIN: usize = 500;
/// Parts of the record by which the random walk is seen.
const PARTS: usize = 20;
/// Most different angles, as a share of the readings, that are steps of a quantum rather than a continuum.
const LEVELS_MAX: f64 = 0.25;
/// Difference of angles or rates that is rounding, as a share of the whole spread.
const ROUNDING: f64 = 1e-9;
/// Noise beyond which a single reading is none by chance, in standard deviations.
const OUTLYING: f64 = 6.0;

/// A reading of a FREE that is left alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillSample {
    /// When it was taken, s.
    pub time: f64,
    /// Twist about the FREE's axis, rad.
    pub angle: f64,
    /// Angular rate about the same axis, rad/s.
    pub rate: f64,
}

/// What a sensor must keep to go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillRules {
    /// Greatest white noise of the angle, rad.
    pub noise: f64,
    /// Greatest drift of the angle, rad/s.
    pub drift: f64,
    /// Farthest from the line of the drift, rad, beyond what noise explains.
    pub motion: f64,
    /// Farthest from its mean, rad/s, that the rate may be beyond what noise explains.
    pub rate_motion: f64,
    /// Greatest share of missing readings.
    pub missing: f64,
}

impl Default for StillRules {
    /// Noise 0.2 deg, drift 1 deg/min, motion 0.5 deg and 3 deg/s, 2 % missing.
    fn default() -> Self {
        Self {
            noise: 0.2f64.to_radians(),
            drift: 1f64.to_radians() / 60.0,
            motion: 0.5f64.to_radians(),
            rate_motion: 3f64.to_radians(),
            missing: 0.02,
        }
    }
}

/// What a still sensor says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillFit {
    /// White noise of the angle, standard deviation of one reading, rad; contains the quantisation's.
    pub noise: f64,
    /// Step of the angle, rad; none where the readings are a continuum or never change.
    pub quantum: Option<f64>,
    /// Random walk of the angle, rad per square root of a second; zero where none is seen.
    pub walk: f64,
    /// Drift, rad/s.
    pub drift: Measured,
    /// White noise of the rate, standard deviation of one reading, rad/s.
    pub rate_noise: f64,
    /// Mean rate: the gyro's bias, rad/s.
    pub rate_bias: Measured,
    /// Period of the readings (median), s.
    pub period: f64,
    /// Standard deviation of the time between readings from whole periods, s.
    pub jitter: f64,
    /// Readings that should have been there and were not.
    pub missing: usize,
    /// Longest time without a reading, s.
    pub longest_gap: f64,
    /// Readings that were used.
    pub readings: usize,
}

/// Why the sensor must not be used, or nothing can be said.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StillError {
    /// Too few readings.
    #[error("noise and drift need at least {READINGS_MIN} readings; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("reading {0} is not finite")]
    NotFinite(usize),
    /// Times that do not increase.
    #[error("reading {0} is not later than the one before it")]
    NotInOrder(usize),
    /// Readings are missing.
    #[error(
        "{missing} readings are missing, {share:.3} of all; at most {limit} may be: bus, wiring, clock stretching?"
    )]
    Missing {
        /// How many.
        missing: usize,
        /// Share of those that should be there.
        share: f64,
        /// The rule.
        limit: f64,
    },
    /// The angle leaves its line.
    #[error(
        "the angle strays by {angle:.5} rad; a still FREE keeps within {limit} rad: let it rest, and do not touch it"
    )]
    Moving {
        /// How far, rad.
        angle: f64,
        /// The rule, with the noise's share, rad.
        limit: f64,
    },
    /// The rate leaves its mean.
    #[error(
        "the rate strays by {rate:.5} rad/s; a still FREE keeps within {limit} rad/s: let it rest, do not touch it"
    )]
    Turning {
        /// How far, rad/s.
        rate: f64,
        /// The rule, with the noise's share, rad/s.
        limit: f64,
    },
    /// Too noisy.
    #[error("the angle's noise is {noise:.6} rad; at most {limit} rad is allowed: mounting, vibration, fusion mode?")]
    Noisy {
        /// Standard deviation, rad.
        noise: f64,
        /// The rule, rad.
        limit: f64,
    },
    /// Drifts too fast.
    #[error(
        "the angle drifts by {drift:.2e} +- {uncertainty:.1e} rad/s; at most {limit} is allowed: calibrate the gyro"
    )]
    Drifting {
        /// Drift, rad/s.
        drift: f64,
        /// Standard uncertainty, rad/s.
        uncertainty: f64,
        /// The rule, rad/s.
        limit: f64,
    },
}

/// Noise and drift of readings at rest, in the order of their times, the angle unwrapped; or why the sensor must not
/// be used.
pub fn noise_and_drift(samples: &[StillSample], rules: &StillRules) -> Result<StillFit, StillError> {
    if samples.len() < READINGS_MIN {
        return Err(StillError::TooFew(samples.len()));
    }
    let finite = |s: &StillSample| s.time.is_finite() && s.angle.is_finite() && s.rate.is_finite();
    if let Some(index) = samples.iter().position(|s| !finite(s)) {
        return Err(StillError::NotFinite(index));
    }
    if let Some(index) = samples.windows(2).position(|w| w[1].time <= w[0].time) {
        return Err(StillError::NotInOrder(index + 1));
    }
    let timing = Timing::of(samples);
    let (fit, off_line, off_mean) = measure(samples, &timing);
    let share = timing.missing as f64 / (timing.missing + samples.len()) as f64;
    if share > rules.missing {
        return Err(StillError::Missing { missing: timing.missing, share, limit: rules.missing });
    }
    // Whoever moves is told to hold still before being told that the sensor is bad.
    let limit = rules.motion + OUTLYING * fit.noise.min(rules.noise);
    if off_line > limit {
        return Err(StillError::Moving { angle: off_line, limit });
    }
    let limit = rules.rate_motion + OUTLYING * fit.rate_noise.min(rules.rate_motion);
    if off_mean > limit {
        return Err(StillError::Turning { rate: off_mean, limit });
    }
    if fit.noise > rules.noise {
        return Err(StillError::Noisy { noise: fit.noise, limit: rules.noise });
    }
    if fit.drift.value.abs() > rules.drift {
        let Measured { value: drift, uncertainty, .. } = fit.drift;
        return Err(StillError::Drifting { drift, uncertainty, limit: rules.drift });
    }
    Ok(fit)
}

/// The fit, the farthest angle from its line, the farthest rate from its mean.
fn measure(samples: &[StillSample], timing: &Timing) -> (StillFit, f64, f64) {
    let count = samples.len() as f64;
    let mean = |f: &dyn Fn(&StillSample) -> f64| samples.iter().map(f).sum::<f64>() / count;
    let (time, angle, rate) = (mean(&|s| s.time), mean(&|s| s.angle), mean(&|s| s.rate));
    let moment = samples.iter().map(|s| (s.time - time).powi(2)).sum::<f64>();
    let slope = samples.iter().map(|s| (s.time - time) * (s.angle - angle)).sum::<f64>() / moment;
    let left: Vec<f64> = samples.iter().map(|s| s.angle - angle - slope * (s.time - time)).collect();
    let rates: Vec<f64> = samples.iter().map(|s| s.rate - rate).collect();

    let duration = samples[samples.len() - 1].time - samples[0].time;
    let lag = samples.len() / PARTS;
    let (near, far) = (mean_square(&left, 1), mean_square(&left, lag));
    let (short, long) = (duration / (count - 1.0), duration * lag as f64 / (count - 1.0));
    let walk = ((far - near) / (long - short)).max(0.0);
    let white = (0.5 * (near - walk * short)).max(0.0);
    let quantum = quantum(&left, samples);
    // Readings that never leave one step of the quantum have no noise to be seen, but the quantum's own.
    let unseen = quantum.map_or(0.0, |q| q * q / 12.0);
    let variance = 12.0 * white.max(unseen) / (count * duration * duration) + 1.2 * walk / duration;
    let rate_white = 0.5 * mean_square(&rates, 1);
    let rate_far = 0.5 * mean_square(&rates, lag);
    // What differs more over a long time than over a short one is averaged over the parts only.
    let rate_variance = rate_white / count + (rate_far - rate_white).max(0.0) / PARTS as f64;
    let fit = StillFit {
        noise: white.sqrt(),
        quantum,
        walk: walk.sqrt(),
        drift: Measured { value: slope, uncertainty: variance.sqrt(), freedom: samples.len() - 2 },
        rate_noise: rate_white.sqrt(),
        rate_bias: Measured { value: rate, uncertainty: rate_variance.sqrt(), freedom: samples.len() - 1 },
        period: timing.period,
        jitter: timing.jitter,
        missing: timing.missing,
        longest_gap: timing.longest,
        readings: samples.len(),
    };
    let farthest = |x: &[f64]| x.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    (fit, farthest(&left), farthest(&rates))
}

/// Mean square of the differences over `lag` readings.
fn mean_square(x: &[f64], lag: usize) -> f64 {
    let differences = x.windows(lag + 1).map(|w| (w[lag] - w[0]).powi(2));
    differences.sum::<f64>() / (x.len() - lag) as f64
}

/// The commonest step between neighbouring values, where the angles are few values taken again and again.
fn quantum(left: &[f64], samples: &[StillSample]) -> Option<f64> {
    let spread = left.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    let mut angles: Vec<f64> = samples.iter().map(|s| s.angle).collect();
    angles.sort_by(f64::total_cmp);
    let largest = angles.iter().fold(0.0f64, |a, b| a.max(b.abs()));
    let rounding = ROUNDING * spread.max(1e-6 * largest);
    let mut steps: Vec<f64> = angles.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > rounding).collect();
    if steps.is_empty() || (steps.len() + 1) as f64 > LEVELS_MAX * angles.len() as f64 {
        return None;
    }
    steps.sort_by(f64::total_cmp);
    Some(steps[steps.len() / 2])
}

/// When the readings came.
struct Timing {
    period: f64,
    jitter: f64,
    missing: usize,
    longest: f64,
}

impl Timing {
    fn of(samples: &[StillSample]) -> Self {
        let gaps: Vec<f64> = samples.windows(2).map(|w| w[1].time - w[0].time).collect();
        let mut sorted = gaps.clone();
        sorted.sort_by(f64::total_cmp);
        let period = sorted[sorted.len() / 2];
        let whole = |gap: f64| (gap / period).round().max(1.0);
        let square = gaps.iter().map(|&g| (g - whole(g) * period).powi(2)).sum::<f64>() / gaps.len() as f64;
        Self {
            period,
            jitter: square.sqrt(),
            missing: gaps.iter().map(|&g| whole(g) as usize - 1).sum(),
            longest: sorted[sorted.len() - 1],
        }
    }
}

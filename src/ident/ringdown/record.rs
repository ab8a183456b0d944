//! What is fitted: one or two channels of one motion.

use super::RingDownError;

/// Fewest samples of a channel.
pub const SAMPLES_MIN: usize = 16;
/// Largest share of clipped samples: with more, what is left says too little about the start of the motion.
pub const CLIPPED_MAX: f64 = 0.5;

/// One sensor's view of the motion: angles from the orientation, or rates from the gyro. Every channel has
/// amplitudes, phases, an offset and noise of its own; only the poles are shared, so that neither a filter nor a delay
/// nor a scale factor in one channel disturbs the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel<'a> {
    /// What it measures.
    pub kind: ChannelKind,
    /// When, s, increasing.
    pub times: &'a [f64],
    /// What, rad or rad/s; as many as times.
    pub values: &'a [f64],
    /// Step of the quantisation, rad or rad/s; zero if there is none that matters.
    pub resolution: f64,
    /// Largest magnitude the sensor can give, rad or rad/s: samples at or beyond it are clipped, and left out.
    pub limit: f64,
    /// Highest frequency up to which the sensor is trusted, Hz (15 to 20 Hz for the BNO055's fusion output).
    pub bandwidth: f64,
}

/// What a channel measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChannelKind {
    /// Angles, rad.
    Angle,
    /// Rates, rad/s.
    Rate,
}

impl<'a> Channel<'a> {
    /// Angles without quantisation or limit, trusted up to `bandwidth` (Hz).
    pub fn angle(times: &'a [f64], values: &'a [f64], bandwidth: f64) -> Self {
        Self { kind: ChannelKind::Angle, times, values, resolution: 0.0, limit: f64::INFINITY, bandwidth }
    }

    /// Rates without quantisation that clip at `limit` (rad/s), trusted up to `bandwidth` (Hz).
    pub fn rate(times: &'a [f64], values: &'a [f64], limit: f64, bandwidth: f64) -> Self {
        Self { kind: ChannelKind::Rate, limit, ..Self::angle(times, values, bandwidth) }
    }
}

/// A channel's usable samples, relative to the start of the record, with the weights of the fit.
#[derive(Clone, Debug)]
pub(super) struct Series {
    pub kind: ChannelKind,
    /// Since the start of the record, s.
    pub time: Vec<f64>,
    pub value: Vec<f64>,
    /// 1/variance; zero for an outlier.
    pub weight: Vec<f64>,
    /// Standard deviation that the quantisation alone makes.
    pub floor: f64,
    /// Nominal sampling interval, s: the median.
    pub interval: f64,
    pub clipped: usize,
    pub bandwidth: f64,
}

/// The usable samples of every channel, the time of the first (s), and the span (s).
pub(super) fn prepare(channels: &[Channel]) -> Result<(Vec<Series>, f64, f64), RingDownError> {
    for (channel, c) in channels.iter().enumerate() {
        if c.times.len() != c.values.len() {
            return Err(RingDownError::Lengths { channel, times: c.times.len(), values: c.values.len() });
        }
        let good =
            |i: usize| c.times[i].is_finite() && c.values[i].is_finite() && (i == 0 || c.times[i] > c.times[i - 1]);
        if let Some(index) = (0..c.times.len()).find(|&i| !good(i)) {
            return Err(RingDownError::Sample { channel, index });
        }
        let settings = c.resolution.is_finite() && c.resolution >= 0.0 && c.limit > 0.0 && c.bandwidth > 0.0;
        if !settings {
            return Err(RingDownError::Settings { channel });
        }
        if c.times.len() < SAMPLES_MIN {
            return Err(RingDownError::TooFew { channel, samples: c.times.len() });
        }
    }
    let mut all: Vec<_> = channels.iter().map(usable).collect();
    for (channel, s) in all.iter().enumerate() {
        let total = s.time.len() + s.clipped;
        if s.clipped as f64 > CLIPPED_MAX * total as f64 || s.time.len() < SAMPLES_MIN {
            return Err(RingDownError::Clipped { channel, clipped: s.clipped, samples: total });
        }
    }
    let start = all.iter().filter_map(|s| s.time.first().copied()).fold(f64::INFINITY, f64::min);
    let end = all.iter().filter_map(|s| s.time.last().copied()).fold(f64::NEG_INFINITY, f64::max);
    if end.is_nan() || start.is_nan() || end <= start {
        return Err(RingDownError::TooFew { channel: 0, samples: 0 });
    }
    all.iter_mut().for_each(|s| s.time.iter_mut().for_each(|t| *t -= start));
    Ok((all, start, end - start))
}

fn usable(c: &Channel) -> Series {
    // A clipped reading may be rounded to the step below the limit.
    let highest = c.limit - 0.75 * c.resolution;
    let kept: Vec<usize> = (0..c.times.len()).filter(|&i| c.values[i].abs() < highest).collect();
    let mut gaps: Vec<f64> = c.times.windows(2).map(|t| t[1] - t[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let value: Vec<f64> = kept.iter().map(|&i| c.values[i]).collect();
    let count = value.len().max(1) as f64;
    let mean = value.iter().sum::<f64>() / count;
    let variance = value.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    let floor = c.resolution / 12f64.sqrt();
    Series {
        kind: c.kind,
        time: kept.iter().map(|&i| c.times[i]).collect(),
        weight: vec![1.0 / variance.max(floor * floor).max(f64::MIN_POSITIVE.sqrt()); value.len()],
        value,
        floor,
        interval: gaps[gaps.len() / 2],
        clipped: c.times.len() - kept.len(),
        bandwidth: c.bandwidth,
    }
}

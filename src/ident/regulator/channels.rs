//! Which channel of a DAC drives which pressure: measured, never assumed.
//!
//! Each settled state of the rig, the commands on all channels and all pressures, is one [`Trial`]. The pressures are
//! fitted linearly by the commands, so the channels may be tried one after another or in any other independent way.
//! A pressure belongs to the channel that moves it; every doubt about that is an error with a name.

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use crate::ident::Measured;
use crate::ident::least_squares::inverse;

/// Largest response to another channel, as a share of that to the own one.
pub const CROSSTALK_MAX: f64 = 0.1;
/// A response smaller than this many standard uncertainties is none.
const SIGNIFICANT: f64 = 5.0;

/// One settled state.
#[derive(Clone, Debug, PartialEq)]
pub struct Trial {
    /// Command on every channel, in any one unit.
    pub commands: Vec<f64>,
    /// Every gauge pressure, Pa.
    pub pressures: Vec<f64>,
}

/// Which channel drives which pressure.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelMap {
    /// By pressure: its channel.
    pub channels: Vec<usize>,
    /// By pressure: its response to the whole range of its channel's commands, Pa.
    pub responses: Vec<Measured>,
    /// Greatest response of a pressure to another channel, as a share of that to its own.
    pub crosstalk: f64,
    /// Channels that drive no pressure.
    pub unconnected: Vec<usize>,
}

/// Why there is no map.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ChannelError {
    /// Too few trials.
    #[error("{channels} channels need at least {least} trials; there are {trials}", least = channels + 2)]
    TooFew {
        /// Channels.
        channels: usize,
        /// Trials.
        trials: usize,
    },
    /// Trials of different shapes, or without a channel or a pressure.
    #[error("trial {0} has other channels or pressures than the first, or none")]
    Shape(usize),
    /// A number that is none.
    #[error("trial {0} has a number that is not finite")]
    NotFinite(usize),
    /// A channel that was never moved.
    #[error("channel {0} was never moved: every channel must be tried")]
    NotTried(usize),
    /// Channels that were moved together.
    #[error("the channels were moved together: no trial tells them apart")]
    Together,
    /// A pressure that follows two channels.
    #[error(
        "pressure {pressure} follows channel {channel} and, by {share} of that, channel {other}; at most {CROSSTALK_MAX} \
         is allowed: two channels on one tube, or a common supply that sags"
    )]
    Shared {
        /// The pressure.
        pressure: usize,
        /// The channel that moves it most.
        channel: usize,
        /// The other one.
        other: usize,
        /// Response to the other as a share; negative where it falls.
        share: f64,
    },
    /// A channel that moves two pressures.
    #[error("channel {channel} moves pressure {first} and pressure {second}: two tubes on one regulator?")]
    Split {
        /// The channel.
        channel: usize,
        /// One pressure.
        first: usize,
        /// Another.
        second: usize,
    },
    /// A pressure that follows no channel.
    #[error(
        "pressure {pressure} follows no channel: it moves by {response} Pa +- {uncertainty} Pa at most and should by \
         {least} Pa; channels that move nothing: {dead:?}"
    )]
    Dead {
        /// The pressure.
        pressure: usize,
        /// Its greatest response, Pa.
        response: f64,
        /// Standard uncertainty, Pa.
        uncertainty: f64,
        /// The rule, Pa.
        least: f64,
        /// Channels that move no pressure.
        dead: Vec<usize>,
    },
}

/// Finds the channel of every pressure. A pressure that moves by less than `least` (Pa) over the whole range of a
/// channel's commands does not follow it.
pub fn map_channels(trials: &[Trial], least: f64) -> Result<ChannelMap, ChannelError> {
    let responses = responses(trials)?;
    let (pressures, channels) = (responses.len(), responses[0].len());
    let moves = |r: &Measured| r.value >= least && r.value > SIGNIFICANT * r.uncertainty;
    let dead: Vec<usize> = (0..channels).filter(|&c| !responses.iter().any(|p| moves(&p[c]))).collect();
    let mut own = Vec::with_capacity(pressures);
    let mut crosstalk: f64 = 0.0;
    for (pressure, row) in responses.iter().enumerate() {
        let best = (0..channels).fold(0, |best, c| if row[c].value > row[best].value { c } else { best });
        let Measured { value: response, uncertainty, .. } = row[best];
        if moves(&row[best]) {
            for other in (0..channels).filter(|&c| c != best) {
                let share = row[other].value / response;
                if share.abs() > CROSSTALK_MAX && row[other].value.abs() > SIGNIFICANT * row[other].uncertainty {
                    return Err(ChannelError::Shared { pressure, channel: best, other, share });
                }
                crosstalk = crosstalk.max(share.abs());
            }
            own.push((pressure, Ok(best)));
        } else {
            own.push((
                pressure,
                Err(ChannelError::Dead { pressure, response, uncertainty, least, dead: dead.clone() }),
            ));
        }
    }
    let found = |p: usize| own[p].1.as_ref().ok().copied();
    for second in 0..pressures {
        if let Some(first) = (0..second).find(|&first| found(first).is_some() && found(first) == found(second)) {
            return Err(ChannelError::Split { channel: found(second).unwrap_or_default(), first, second });
        }
    }
    let channels: Vec<usize> = own.into_iter().map(|(_, channel)| channel).collect::<Result<_, _>>()?;
    let responses = channels.iter().zip(&responses).map(|(&c, row)| row[c]).collect();
    Ok(ChannelMap { channels, responses, crosstalk, unconnected: dead })
}

/// By pressure and channel: the response to the whole range of the channel's commands, Pa.
fn responses(trials: &[Trial]) -> Result<Vec<Vec<Measured>>, ChannelError> {
    let (channels, pressures) = trials.first().map_or((0, 0), |t| (t.commands.len(), t.pressures.len()));
    let shaped = |t: &Trial| t.commands.len() == channels && t.pressures.len() == pressures;
    if let Some(index) = trials.iter().position(|t| !shaped(t) || channels == 0 || pressures == 0) {
        return Err(ChannelError::Shape(index));
    }
    let finite = |t: &Trial| t.commands.iter().chain(&t.pressures).all(|x| x.is_finite());
    if let Some(index) = trials.iter().position(|t| !finite(t)) {
        return Err(ChannelError::NotFinite(index));
    }
    if trials.len() < channels + 2 {
        return Err(ChannelError::TooFew { channels, trials: trials.len() });
    }
    let of = |channel: usize| trials.iter().map(move |t| t.commands[channel]);
    let low: Vec<f64> = (0..channels).map(|c| of(c).fold(f64::INFINITY, f64::min)).collect();
    let range: Vec<f64> = (0..channels).map(|c| of(c).fold(f64::NEG_INFINITY, f64::max) - low[c]).collect();
    if let Some(channel) = range.iter().position(|r| *r <= 0.0) {
        return Err(ChannelError::NotTried(channel));
    }
    let matrix = DMatrix::from_fn(trials.len(), channels + 1, |i, j| match j.checked_sub(1) {
        None => 1.0,
        Some(c) => (trials[i].commands[c] - low[c]) / range[c],
    });
    let inverse = inverse(&(matrix.transpose() * &matrix)).ok_or(ChannelError::Together)?;
    let freedom = trials.len() - channels - 1;
    let row = |p: usize| {
        let right = DVector::from_iterator(trials.len(), trials.iter().map(|t| t.pressures[p]));
        let solution = &inverse * (matrix.transpose() * &right);
        let variance = (&right - &matrix * &solution).norm_squared() / freedom as f64;
        let measured =
            |j: usize| Measured { value: solution[j], uncertainty: (variance * inverse[(j, j)]).sqrt(), freedom };
        (1..=channels).map(measured).collect()
    };
    Ok((0..pressures).map(row).collect())
}

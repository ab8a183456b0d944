//! Zero, span, hysteresis and linearity from a staircase of settled pressures, up and down.
//!
//! At each command the mean of the two directions lies on a line, or, below the command at which an analogue regulator
//! begins to open, on its lowest pressure. That floor is taken to be there where it explains the points better by
//! four standard deviations. The hysteresis is the greatest difference between the directions.
//!
//! A regulator's own hysteresis leaves the pressure higher on the way down. Lower on the way down is a leak that began
//! on the way (or a supply that fell), and is refused; a leak from the beginning shows as a span that is too small.

use std::ops::RangeInclusive;

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use crate::ident::Measured;
use crate::ident::least_squares::inverse;

/// Fewest different commands.
pub const LEVELS_MIN: usize = 6;
/// Fewest of them on the line, above a floor.
const ON_LINE_MIN: usize = 4;
/// Commands that differ by less than this share of their range are the same.
const SAME: f64 = 1e-6;
/// Gain of a score by which a floor must beat the line alone.
const FLOOR_COST: f64 = 16.0;

/// Which way a settled pressure was approached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From below.
    Rising,
    /// From above.
    Falling,
}

/// A settled pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StairPoint {
    /// Command, in the unit that the regulator takes: Pa, or DAC codes.
    pub command: f64,
    /// Settled gauge pressure, Pa.
    pub pressure: f64,
    /// How it was approached.
    pub direction: Direction,
}

/// What a sound regulator keeps.
#[derive(Clone, Debug, PartialEq)]
pub struct StaircaseRules {
    /// Span, Pa per unit of the command.
    pub span: RangeInclusive<f64>,
    /// How far the pressure may be lower on the way down, as a share of its range.
    pub leak: f64,
    /// Greatest hysteresis, as a share of the range.
    pub hysteresis: f64,
    /// Greatest distance from the line, as a share of the range.
    pub linearity: f64,
}

impl Default for StaircaseRules {
    /// A digital controller: command in Pa, span 1 within 5 %, leak 0.5 %, hysteresis 5 %, linearity 3 % of the range.
    fn default() -> Self {
        Self { span: 0.95..=1.05, leak: 0.005, hysteresis: 0.05, linearity: 0.03 }
    }
}

/// What a staircase says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StaircaseFit {
    /// Pressure of the line at command zero, Pa.
    pub zero: Measured,
    /// Pa per unit of the command.
    pub span: Measured,
    /// Lowest pressure, Pa, where the regulator does not come below it; none where it follows the line all the way.
    pub floor: Option<Measured>,
    /// Command at which the line crosses the floor, or zero pressure where there is no floor.
    pub opening: f64,
    /// Greatest difference of the directions at a command, falling less rising, Pa. The greatest of several noisy
    /// differences: about its uncertainty too large where there is hardly any.
    pub hysteresis: Measured,
    /// Greatest distance of a mean of both directions from the line (or floor), Pa.
    pub linearity: f64,
    /// Root mean square of the same, freed from the parameters, Pa.
    pub residual: f64,
    /// Different commands.
    pub levels: usize,
}

/// Why there is no fit, or the regulator is not sound.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StaircaseError {
    /// Too few different commands.
    #[error("a staircase needs at least {LEVELS_MIN} different commands; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("point {0} of the staircase is not finite")]
    NotFinite(usize),
    /// A step was taken in one direction only.
    #[error("command {0} was approached from one side only: every step between the ends must be taken up and down")]
    OneWay(f64),
    /// Lower on the way down.
    #[error(
        "at command {command} the pressure is {lower} Pa lower on the way down, {share} of the range (at most {limit} \
         allowed): a leak that began on the way, or a supply that fell"
    )]
    Leak {
        /// Command of the greatest loss.
        command: f64,
        /// Loss, Pa.
        lower: f64,
        /// The same over the range.
        share: f64,
        /// The rule.
        limit: f64,
    },
    /// Span out of its range.
    #[error(
        "the span is {value} Pa per unit of the command; it must be {low} to {high}: a leak, a low supply, a span \
         screw, or the wrong range in rig.toml"
    )]
    Span {
        /// What it is.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Greatest allowed.
        high: f64,
    },
    /// No line.
    #[error(
        "at command {command} the pressure is {off} Pa off the line, {share} of the range; at most {limit} is allowed"
    )]
    NotLinear {
        /// Command of the greatest distance.
        command: f64,
        /// Distance, Pa.
        off: f64,
        /// The same over the range.
        share: f64,
        /// The rule.
        limit: f64,
    },
    /// Too much hysteresis.
    #[error("the hysteresis at command {command} is {value} Pa, {share} of the range; at most {limit} is allowed")]
    Hysteresis {
        /// Command of the greatest hysteresis.
        command: f64,
        /// Hysteresis, Pa.
        value: f64,
        /// The same over the range.
        share: f64,
        /// The rule.
        limit: f64,
    },
}

/// One command and what came of it.
struct Level {
    command: f64,
    /// Mean of both directions, Pa.
    pressure: f64,
    /// Falling less rising, Pa; zero at the turning points, which belong to both.
    difference: f64,
}

/// Fits a staircase and holds it to `rules`. The points may come in any order and more than once.
pub fn fit_staircase(points: &[StairPoint], rules: &StaircaseRules) -> Result<StaircaseFit, StaircaseError> {
    if let Some(index) = points.iter().position(|p| !(p.command.is_finite() && p.pressure.is_finite())) {
        return Err(StaircaseError::NotFinite(index));
    }
    let levels = levels(points)?;
    let (fit, off) = line_or_floor(&levels).ok_or(StaircaseError::TooFew(levels.len()))?;
    let pressures = || levels.iter().map(|l| l.pressure);
    let range = pressures().fold(f64::NEG_INFINITY, f64::max) - pressures().fold(f64::INFINITY, f64::min);
    let worst = |value: &dyn Fn(&Level) -> f64| {
        levels.iter().map(|l| (l.command, value(l))).fold((0.0, 0.0), |a, b| if b.1 > a.1 { b } else { a })
    };
    let (command, lower) = worst(&|l| -l.difference);
    if lower > rules.leak * range {
        return Err(StaircaseError::Leak { command, lower, share: lower / range, limit: rules.leak });
    }
    if !rules.span.contains(&fit.span.value) {
        let (value, low, high) = (fit.span.value, *rules.span.start(), *rules.span.end());
        return Err(StaircaseError::Span { value, low, high });
    }
    let (command, value) = worst(&|l| l.difference);
    if value > rules.hysteresis * range {
        return Err(StaircaseError::Hysteresis { command, value, share: value / range, limit: rules.hysteresis });
    }
    if fit.linearity > rules.linearity * range {
        let share = fit.linearity / range;
        return Err(StaircaseError::NotLinear { command: off, off: fit.linearity, share, limit: rules.linearity });
    }
    Ok(fit)
}

fn levels(points: &[StairPoint]) -> Result<Vec<Level>, StaircaseError> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.command.total_cmp(&b.command));
    let range = sorted.last().zip(sorted.first()).map_or(0.0, |(b, a)| b.command - a.command);
    let groups: Vec<_> = sorted.chunk_by(|a, b| b.command - a.command <= SAME * range).collect();
    if groups.len() < LEVELS_MIN {
        return Err(StaircaseError::TooFew(groups.len()));
    }
    let level = |(index, group): (usize, &&[StairPoint])| {
        let mean = |direction| {
            let of: Vec<f64> = group.iter().filter(|p| p.direction == direction).map(|p| p.pressure).collect();
            (!of.is_empty()).then(|| of.iter().sum::<f64>() / of.len() as f64)
        };
        let command = group[0].command;
        let end = index == 0 || index == groups.len() - 1;
        match (mean(Direction::Rising), mean(Direction::Falling)) {
            (Some(up), Some(down)) => Ok(Level { command, pressure: 0.5 * (up + down), difference: down - up }),
            (Some(one), None) | (None, Some(one)) if end => Ok(Level { command, pressure: one, difference: 0.0 }),
            _ => Err(StaircaseError::OneWay(command)),
        }
    };
    groups.iter().enumerate().map(level).collect()
}

/// The better of the line alone and the line with the lowest levels on a floor, and the command that is farthest off.
fn line_or_floor(levels: &[Level]) -> Option<(StaircaseFit, f64)> {
    let pressures = || levels.iter().map(|l| l.pressure);
    let range = pressures().fold(f64::NEG_INFINITY, f64::max) - pressures().fold(f64::INFINITY, f64::min);
    let count = levels.len() as f64;
    let score = |fit: &StaircaseFit, freedom: usize, cost: f64| {
        let mean = fit.residual.powi(2) * freedom as f64 / count + (1e-9 * range).powi(2);
        count * mean.ln() + cost
    };
    let plain = split(levels, 0)?;
    let mut best = (score(&plain.0, plain.0.span.freedom, 0.0), plain);
    for below in 2..=levels.len().saturating_sub(ON_LINE_MIN) {
        let Some(fit) = split(levels, below) else { continue };
        // The line must meet the floor between the last level on one and the first on the other.
        let meets = fit.0.opening >= levels[below - 1].command && fit.0.opening <= levels[below].command;
        let score = score(&fit.0, fit.0.span.freedom, FLOOR_COST);
        if meets && score < best.0 {
            best = (score, fit);
        }
    }
    Some(best.1)
}

/// The line through all but the `below` lowest levels, which are on a floor.
fn split(levels: &[Level], below: usize) -> Option<(StaircaseFit, f64)> {
    let count = levels.len();
    // Columns: floor (where there is one), zero, span.
    let extra = usize::from(below > 0);
    let matrix = DMatrix::from_fn(count, 2 + extra, |i, j| match (i < below, j.checked_sub(extra)) {
        (true, None) => 1.0,
        (true, Some(_)) | (false, None) => 0.0,
        (false, Some(0)) => 1.0,
        (false, Some(_)) => levels[i].command,
    });
    let right = DVector::from_iterator(count, levels.iter().map(|l| l.pressure));
    let inverse = inverse(&(matrix.transpose() * &matrix))?;
    let solution = &inverse * (matrix.transpose() * &right);
    let left = &right - &matrix * &solution;
    let freedom = count - 2 - extra;
    let variance = left.norm_squared() / freedom as f64;
    let measured =
        |j: usize| Measured { value: solution[j], uncertainty: (variance * inverse[(j, j)]).sqrt(), freedom };
    let (zero, span, floor) = (measured(extra), measured(extra + 1), (below > 0).then(|| measured(0)));
    let greatest = levels.iter().map(|l| l.difference).fold(0.0, f64::max);
    let farthest = left.iamax();
    let fit = StaircaseFit {
        zero,
        span,
        floor,
        opening: (floor.map_or(0.0, |f| f.value) - zero.value) / span.value,
        // The residual is that of means of two points; a difference of two varies twice as much.
        hysteresis: Measured { value: greatest, uncertainty: 2.0 * variance.sqrt(), freedom },
        linearity: left[farthest].abs(),
        residual: variance.sqrt(),
        levels: count,
    };
    Some((fit, levels[farthest].command))
}

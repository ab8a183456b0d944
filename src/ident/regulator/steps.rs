//! Dead time, lag and slew limits from one record of steps of pressure, up and down.
//!
//! The model is a dead time D, then a lag tau whose rate of change is limited, of a target that the command u sets:
//!
//! ```text
//! dp/dt = clamp((z + g u(t - D) - p) / tau, -fall, rise)
//! ```
//!
//! Between two changes of the command it has an exact solution: a ramp until the target is a slew limit times tau
//! away, then an exponential. All of D, tau, z, g, the first pressure and the slew limits that are seen are fitted by
//! nonlinear least squares to the readings as they come, every 16 to 64 ms: no threshold is crossed, nothing is
//! differentiated. A slew limit is seen where it explains the readings better by four standard deviations.
//!
//! The standard uncertainties take the residuals as independent.

use thiserror::Error;

use crate::ident::Measured;
use crate::ident::least_squares::{Least, least_squares};

/// Fewest readings.
pub const READINGS_MIN: usize = 20;
/// Smallest change of the command that counts as a step, as a share of the commands' range.
pub const STEP_MIN: f64 = 0.05;
/// Largest residual, as a share of the commands' range times the span: what is above it follows another law.
pub const RESIDUAL_MAX: f64 = 0.03;
/// Largest standard uncertainty of the lag as a share of it.
pub const LAG_UNCERTAINTY_MAX: f64 = 0.25;
/// Smallest pressure per command (1 where both are in Pa).
pub const SPAN_MIN: f64 = 0.2;
/// A dead time below zero by more than this many standard uncertainties cannot be.
const ACAUSAL: f64 = 5.0;

/// Where a fit may begin, s.
const DEAD_TIMES: [f64; 5] = [0.0, 0.02, 0.05, 0.1, 0.25];
const LAGS: [f64; 7] = [0.005, 0.015, 0.04, 0.08, 0.16, 0.4, 1.2];
/// Slew limits, over the fastest change between two readings: noise makes that too fast, the period too slow.
const SLEWS: [f64; 3] = [0.7, 1.0, 1.4];
/// How many of the best beginnings are followed.
const FOLLOWED: usize = 2;

/// A change of the command: in force from its time until the next one's, the first one before that, too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// When it was given, s.
    pub time: f64,
    /// Pressure commanded, Pa.
    pub pressure: f64,
}

/// A reading of the pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When the device measured it, s.
    pub time: f64,
    /// Gauge pressure, Pa.
    pub pressure: f64,
}

/// How a regulator follows its command.
#[derive(Clone, Debug, PartialEq)]
pub struct StepsFit {
    /// Dead time, s. May be slightly negative where it is zero within its uncertainty.
    pub dead_time: Measured,
    /// Time constant of the lag, s.
    pub lag: Measured,
    /// Fastest rise, Pa/s; none where no step was large enough to reach it.
    pub rise: Option<Measured>,
    /// Fastest fall, Pa/s, positive; none where no step was large enough to reach it.
    pub fall: Option<Measured>,
    /// Settled pressure at command zero, Pa.
    pub zero: Measured,
    /// Settled pressure per commanded pressure.
    pub span: Measured,
    /// Root mean square of what is left over, Pa: the readings' noise, if the regulator follows the model.
    pub residual: f64,
    /// The model's pressure at each reading, Pa.
    pub fitted: Vec<f64>,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StepsError {
    /// Too few readings.
    #[error("a step response needs at least {READINGS_MIN} readings; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("{kind} {index} of the record is not finite")]
    NotFinite {
        /// "command" or "reading".
        kind: &'static str,
        /// Which one.
        index: usize,
    },
    /// Times that do not increase.
    #[error("{kind} {index} of the record is not later than the one before it")]
    NotInOrder {
        /// "command" or "reading".
        kind: &'static str,
        /// Which one.
        index: usize,
    },
    /// No step up, or none down, while readings were taken.
    #[error("{up} steps up and {down} down while readings were taken; at least one of each is needed")]
    OneWay {
        /// Steps up.
        up: usize,
        /// Steps down.
        down: usize,
    },
    /// The pressure hardly follows.
    #[error(
        "the pressure follows the command by {0} only; at least {SPAN_MIN} is needed: supply, tube, channel or leak?"
    )]
    NotFollowing(f64),
    /// Another law.
    #[error(
        "{residual} Pa are left over, {share} of the steps; at most {RESIDUAL_MAX} of them may be: this is not a dead \
         time, a lag and a slew limit (a leak, a dip of the supply, a valve that sticks?)"
    )]
    OtherLaw {
        /// Residual, Pa.
        residual: f64,
        /// The same over the range of pressure.
        share: f64,
    },
    /// Before its cause.
    #[error("the pressure answers {0} s before the command: do commands and readings have the same clock?")]
    Acausal(f64),
    /// Readings too rare or too noisy for the lag.
    #[error(
        "the lag is {lag} +- {uncertainty} s, and must be known to {LAG_UNCERTAINTY_MAX} of it: more steps, larger \
         ones, or readings more often than every {period} s"
    )]
    Unresolved {
        /// Lag, s.
        lag: f64,
        /// Its standard uncertainty, s.
        uncertainty: f64,
        /// Mean period of the readings, s.
        period: f64,
    },
    /// No minimum was found.
    #[error("no dead time, lag and slew limit fit the record")]
    NotConverged,
}

/// Fits the regulator's dynamics to one record. `commands` and `readings` are in the order of their times, which are of
/// one clock.
pub fn fit_steps(commands: &[Command], readings: &[Reading]) -> Result<StepsFit, StepsError> {
    check(commands, readings)?;
    let range = range(commands.iter().map(|c| c.pressure));
    let record = Record { commands, readings, range };
    let floor = 1e-9 * range;
    let candidates = [(false, false), (true, false), (false, true), (true, true)];
    let best = candidates
        .into_iter()
        .filter_map(|(rise, fall)| Some((record.fit(rise, fall)?, rise, fall)))
        .min_by(|a, b| a.0.score(floor).total_cmp(&b.0.score(floor)));
    let (least, rise, fall) = best.ok_or(StepsError::NotConverged)?;
    let fit = StepsFit {
        dead_time: least.measured(0),
        lag: least.measured(1),
        zero: least.measured(2),
        span: least.measured(3),
        rise: rise.then(|| least.measured(5)),
        fall: fall.then(|| least.measured(5 + usize::from(rise))),
        residual: least.deviation(),
        fitted: record.pressures(&least.parameters, rise, fall).ok_or(StepsError::NotConverged)?,
    };
    let period = (readings[readings.len() - 1].time - readings[0].time) / (readings.len() - 1) as f64;
    judge(&fit, range, period)?;
    Ok(fit)
}

fn check(commands: &[Command], readings: &[Reading]) -> Result<(), StepsError> {
    if readings.len() < READINGS_MIN {
        return Err(StepsError::TooFew(readings.len()));
    }
    let commanded: Vec<_> = commands.iter().map(|c| (c.time, c.pressure)).collect();
    let read: Vec<_> = readings.iter().map(|r| (r.time, r.pressure)).collect();
    for (kind, list) in [("command", &commanded), ("reading", &read)] {
        if let Some(index) = list.iter().position(|(t, p)| !(t.is_finite() && p.is_finite())) {
            return Err(StepsError::NotFinite { kind, index });
        }
        if let Some(index) = list.windows(2).position(|w| w[1].0 <= w[0].0) {
            return Err(StepsError::NotInOrder { kind, index: index + 1 });
        }
    }
    let least = STEP_MIN * range(commanded.iter().map(|c| c.1));
    let (first, last) = (read[0].0, read[read.len() - 1].0);
    // From the command that is in force at the first reading on.
    let in_force = |i: usize| commanded.get(i + 1).is_none_or(|next| next.0 > first);
    let seen = commanded.iter().enumerate().filter(|(i, c)| in_force(*i) && c.0 < last).map(|(_, c)| c.1);
    let (up, down) = moves(seen, least);
    if up == 0 || down == 0 { Err(StepsError::OneWay { up, down }) } else { Ok(()) }
}

/// Moves up and down of at least `least`. A command that is limited in its rate takes many small changes for one.
fn moves(commands: impl Iterator<Item = f64>, least: f64) -> (usize, usize) {
    let (mut up, mut down) = (0, 0);
    let mut turn: Option<f64> = None;
    let mut sense = 0.0;
    for command in commands {
        let from = *turn.get_or_insert(command);
        if (command - from) * sense > 0.0 || sense == 0.0 && (command - from).abs() < least {
            // On in the same way, or not far enough to be a move.
            if sense != 0.0 {
                turn = Some(command);
            }
            continue;
        }
        if (command - from).abs() >= least {
            sense = (command - from).signum();
            if sense > 0.0 {
                up += 1
            } else {
                down += 1
            }
            turn = Some(command);
        }
    }
    (up, down)
}

fn judge(fit: &StepsFit, range: f64, period: f64) -> Result<(), StepsError> {
    if fit.span.value < SPAN_MIN {
        return Err(StepsError::NotFollowing(fit.span.value));
    }
    let share = fit.residual / (range * fit.span.value);
    if share > RESIDUAL_MAX {
        return Err(StepsError::OtherLaw { residual: fit.residual, share });
    }
    let Measured { value: lag, uncertainty, .. } = fit.lag;
    if uncertainty > LAG_UNCERTAINTY_MAX * lag {
        return Err(StepsError::Unresolved { lag, uncertainty, period });
    }
    // A grid of the readings' times, or the command's way to the device, is no answer before its cause.
    if fit.dead_time.value < -ACAUSAL * fit.dead_time.uncertainty - 1e-3 {
        return Err(StepsError::Acausal(-fit.dead_time.value));
    }
    Ok(())
}

fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    high - low
}

/// What the fits share.
struct Record<'a> {
    commands: &'a [Command],
    readings: &'a [Reading],
    /// Of the commands, Pa.
    range: f64,
}

/// The model's parameters.
struct Dynamics {
    dead_time: f64,
    lag: f64,
    zero: f64,
    span: f64,
    rise: f64,
    fall: f64,
}

impl Record<'_> {
    /// Dead time, lag, zero, span, first pressure, then the slew limits that are asked for.
    fn fit(&self, rise: bool, fall: bool) -> Option<Least> {
        let residuals = |x: &[f64]| self.residuals(x, rise, fall);
        let mut starts: Vec<(f64, Vec<f64>)> = Vec::new();
        for start in self.starts(rise, fall) {
            if let Some(r) = residuals(&start) {
                starts.push((r.iter().map(|r| r * r).sum(), start));
            }
        }
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let followed = starts.iter().take(FOLLOWED).filter_map(|(_, start)| {
            let mut scale = vec![0.01, start[1], 0.1 * self.range, 0.1, 0.1 * self.range];
            scale.extend(&start[5..]);
            least_squares(start, &scale, residuals)
        });
        followed.min_by(|a, b| a.sum.total_cmp(&b.sum))
    }

    fn starts(&self, rise: bool, fall: bool) -> Vec<Vec<f64>> {
        let lowest = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::INFINITY, f64::min);
        let span = range(self.readings.iter().map(|r| r.pressure)) / self.range;
        let zero = lowest(&mut self.readings.iter().map(|r| r.pressure))
            - span * lowest(&mut self.commands.iter().map(|c| c.pressure));
        let fastest = |sign: f64| {
            let rates =
                self.readings.windows(2).map(|w| sign * (w[1].pressure - w[0].pressure) / (w[1].time - w[0].time));
            rates.fold(0.0, f64::max)
        };
        let slews: &[f64] = if rise || fall { &SLEWS } else { &SLEWS[..1] };
        let mut starts = Vec::new();
        for (&dead_time, &lag) in DEAD_TIMES.iter().flat_map(|d| LAGS.iter().map(move |l| (d, l))) {
            for slew in slews {
                let mut start = vec![dead_time, lag, zero, span, self.readings[0].pressure];
                start.extend(rise.then(|| slew * fastest(1.0)));
                start.extend(fall.then(|| slew * fastest(-1.0)));
                starts.push(start);
            }
        }
        starts
    }

    fn residuals(&self, x: &[f64], rise: bool, fall: bool) -> Option<Vec<f64>> {
        let pressures = self.pressures(x, rise, fall)?;
        Some(pressures.iter().zip(self.readings).map(|(p, r)| p - r.pressure).collect())
    }

    fn pressures(&self, x: &[f64], rise: bool, fall: bool) -> Option<Vec<f64>> {
        let slew = |there: bool, index: usize| if there { x[index] } else { f64::INFINITY };
        let dynamics = Dynamics {
            dead_time: x[0],
            lag: x[1],
            zero: x[2],
            span: x[3],
            rise: slew(rise, 5),
            fall: slew(fall, 5 + usize::from(rise)),
        };
        if !(dynamics.lag > 0.0 && dynamics.rise > 0.0 && dynamics.fall > 0.0) {
            return None;
        }
        let mut pressure = x[4];
        let mut now = self.readings[0].time;
        // Index of the command in force, and when the next one takes effect.
        let effect = |index: usize| self.commands.get(index).map_or(f64::INFINITY, |c| c.time + dynamics.dead_time);
        let mut next = 1;
        while effect(next) <= now {
            next += 1;
        }
        let mut pressures = Vec::with_capacity(self.readings.len());
        for reading in self.readings {
            while now < reading.time {
                let until = effect(next).min(reading.time);
                let target = dynamics.zero + dynamics.span * self.commands[next - 1].pressure;
                pressure = dynamics.advance(pressure, target, until - now);
                now = until;
                if effect(next) <= now {
                    next += 1;
                }
            }
            pressures.push(pressure);
        }
        Some(pressures)
    }
}

impl Dynamics {
    /// The pressure `time` after `pressure`, towards a constant target.
    fn advance(&self, pressure: f64, target: f64, time: f64) -> f64 {
        let gap = target - pressure;
        let slew = if gap > 0.0 { self.rise } else { self.fall };
        // Within this distance the lag alone is slower than the slew limit.
        let near = slew * self.lag;
        let ramp = (gap.abs() - near) / slew;
        if ramp > 0.0 && slew.is_finite() {
            if time <= ramp {
                return pressure + slew.copysign(gap) * time;
            }
            return target - near.copysign(gap) * (-(time - ramp) / self.lag).exp();
        }
        target - gap * (-time / self.lag).exp()
    }
}

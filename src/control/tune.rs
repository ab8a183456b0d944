//! Gains for a wanted damping, gain margin and phase margin.
//!
//! The zeros stand on the slow poles ([`super::design::shape`]), which leaves one number, the integral gain. It is
//! raised until the first of the three wishes is just fulfilled still: the damping of the slow poles in the extended
//! root locus ([`super::root_locus`]), and both margins of the very loop at this tick ([`super::margin`]). Of several
//! bands of good gains it is the lowest, so that every lower gain is good, too.

use std::time::Duration;

use thiserror::Error;

use super::design::shape;
use super::feedforward::actuation;
use super::margin::{Loop, Margin};
use super::root_locus::{LocusLoop, LocusPoint, damping_ratio};
use super::{Gains, ImuChannel, RegulatorChannel};
use crate::model::Free;

/// What the closed loop is to have at least.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Damping ratio of its slow poles, 0 to 1.
    pub damping: f64,
    /// Gain margin, a factor above 1.
    pub gain_margin: f64,
    /// Phase margin, deg, 0 to 90.
    pub phase_margin_deg: f64,
}

impl Target {
    /// For a PID that has to do everything.
    pub const PID: Self = Self { damping: 0.7, gain_margin: 3.0, phase_margin_deg: 60.0 };
    /// For the feedback around a model, which does little where the model is right: stable even where every parameter
    /// of the FREE is 20 % off, which makes the loop gain at rest up to three times as large, and twice that at 70 deg.
    pub const MODEL: Self = Self { gain_margin: 6.0, ..Self::PID };
}

/// What kept the gains from being higher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitedBy {
    /// The damping.
    Damping,
    /// The gain margin.
    GainMargin,
    /// The phase margin.
    PhaseMargin,
}

/// Gains with what they come to.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// The gains.
    pub gains: Gains,
    /// Their margins at this tick.
    pub margin: Margin,
    /// Least damping ratio of the slow poles.
    pub damping: f64,
    /// The closed loop's poles.
    pub poles: LocusPoint,
    /// What kept them from being higher.
    pub limited_by: LimitedBy,
}

/// Why there are no such gains.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TuneError {
    /// A wish that is none.
    #[error("the {what} asked for is {value}, but must be {rule}")]
    Target {
        /// Which.
        what: &'static str,
        /// What was asked.
        value: f64,
        /// What it must be.
        rule: &'static str,
    },
    /// Even the lowest gains do not have it.
    #[error(
        "even with gains so low that the loop is of no use (crossover at 0.05 rad/s) the {0:?} asked for is not reached"
    )]
    Unreachable(LimitedBy),
}

/// Crossover of the lowest gains tried, rad/s, and how the next are raised.
const LOWEST: f64 = 0.05;
const RAISE: f64 = 1.03;
const STEPS: usize = 400;

/// The highest gains of the shape that fulfil `target`.
pub fn tune(
    free: &Free,
    regulator: &RegulatorChannel,
    imu: &ImuChannel,
    period: Duration,
    target: &Target,
) -> Result<Tuned, TuneError> {
    check(target)?;
    let limit = |gains: &Gains| limit(free, gains, regulator, imu, period, target);
    let mut best = shape(free, regulator, LOWEST * free.torsional_stiffness / actuation(free));
    if let Some(by) = limit(&best) {
        return Err(TuneError::Unreachable(by));
    }
    let mut limited_by = LimitedBy::GainMargin;
    for _ in 0..STEPS {
        let next = shape(free, regulator, RAISE * best.integral);
        match limit(&next) {
            Some(by) => {
                limited_by = by;
                break;
            }
            None => best = next,
        }
    }
    // The frequency response is an average; the eigenvalues have the last word, and the gain margin is a factor.
    let mut margin = Loop::new(free, &best, regulator, imu, period).margin();
    if margin.gain_margin < target.gain_margin {
        best = shape(free, regulator, best.integral * margin.gain_margin / target.gain_margin);
        margin = Loop::new(free, &best, regulator, imu, period).margin();
        limited_by = LimitedBy::GainMargin;
    }
    let locus = LocusLoop::new(free, &best, regulator, imu, period);
    let poles = locus.poles(1.0);
    let damping = slow_damping(free, &locus, &poles);
    Ok(Tuned { gains: best, margin, damping, poles, limited_by })
}

fn check(target: &Target) -> Result<(), TuneError> {
    let rules = [
        ("damping", target.damping, (0.0..=1.0).contains(&target.damping), "between 0 and 1"),
        (
            "gain margin",
            target.gain_margin,
            target.gain_margin > 1.0 && target.gain_margin < 64.0,
            "a factor between 1 and 64",
        ),
        (
            "phase margin",
            target.phase_margin_deg,
            (0.0..=90.0).contains(&target.phase_margin_deg),
            "between 0 and 90 deg",
        ),
    ];
    match rules.into_iter().find(|r| !r.2) {
        Some((what, value, _, rule)) => Err(TuneError::Target { what, value, rule }),
        None => Ok(()),
    }
}

fn limit(
    free: &Free,
    gains: &Gains,
    regulator: &RegulatorChannel,
    imu: &ImuChannel,
    period: Duration,
    target: &Target,
) -> Option<LimitedBy> {
    let margins = Loop::new(free, gains, regulator, imu, period).frequency_margins();
    if margins.gain < target.gain_margin {
        return Some(LimitedBy::GainMargin);
    }
    if margins.phase < target.phase_margin_deg.to_radians() {
        return Some(LimitedBy::PhaseMargin);
    }
    let locus = LocusLoop::new(free, gains, regulator, imu, period);
    (slow_damping(free, &locus, &locus.poles(1.0)) < target.damping).then_some(LimitedBy::Damping)
}

/// Least damping ratio of the poles that the loop can move: slower than the delay's own (2/theta). The FREE's own mode,
/// where it rings, is not among them: a regulator with lag and delay cannot damp it, and the gain margin bounds what it
/// may be excited by.
fn slow_damping(free: &Free, locus: &LocusLoop, poles: &LocusPoint) -> f64 {
    let (omega, ratio) = (free.natural_frequencies().1, free.damping_ratios().1);
    let own = |norm: f64| ratio < 1.0 && (norm / omega - 1.0).abs() < 0.3;
    let slow = poles.extended.iter().filter(|z| z.norm() < 2.0 / locus.delay() && !own(z.norm()));
    slow.map(|z| damping_ratio(*z)).fold(1.0, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(2);

    fn devices() -> (RegulatorChannel, ImuChannel) {
        let ms = Duration::from_millis;
        (
            RegulatorChannel {
                period: ms(16),
                lag: ms(60),
                dead_time: ms(15),
                fastest_fill: 2e5,
                full_scale: 1e5,
                measures: true,
            },
            ImuChannel { axis: [0.0, 0.0, 1.0], period: ms(10), delay: ms(15) },
        )
    }

    #[test]
    fn every_wish_is_fulfilled_and_one_of_them_just() {
        let (regulator, imu) = devices();
        let ringing = Free { inertia: 1e-4, torsional_damping: 4e-4, ..Free::paper() };
        for free in [Free::paper(), Free::published_code(), ringing] {
            for target in [Target::PID, Target::MODEL, Target { damping: 0.95, ..Target::PID }] {
                let tuned = tune(&free, &regulator, &imu, TICK, &target).unwrap();
                let m = tuned.margin;
                // The averaged phase margin is the one that is tuned; bisected gain margin to its last step.
                assert!(m.stable && m.gain_margin > 0.98 * target.gain_margin, "{target:?} {tuned:?}");
                assert!(m.phase_margin_deg >= target.phase_margin_deg && tuned.damping >= target.damping);
                let more = shape(&free, &regulator, 1.1 * tuned.gains.integral);
                let beyond = Loop::new(&free, &more, &regulator, &imu, TICK).margin();
                let locus = LocusLoop::new(&free, &more, &regulator, &imu, TICK);
                let exceeded = match tuned.limited_by {
                    LimitedBy::GainMargin => beyond.gain_margin < target.gain_margin,
                    LimitedBy::PhaseMargin => beyond.phase_margin_deg < target.phase_margin_deg,
                    LimitedBy::Damping => slow_damping(&free, &locus, &locus.poles(1.0)) < target.damping,
                };
                assert!(exceeded, "{:?}", tuned.limited_by);
            }
        }
    }

    #[test]
    fn impossible_wishes_are_named() {
        let (regulator, imu) = devices();
        let wish = |target: Target| tune(&Free::paper(), &regulator, &imu, TICK, &target).unwrap_err();
        assert!(matches!(wish(Target { damping: 1.5, ..Target::PID }), TuneError::Target { what: "damping", .. }));
        assert!(matches!(wish(Target { gain_margin: 1.0, ..Target::PID }), TuneError::Target { .. }));
        assert!(matches!(wish(Target { phase_margin_deg: f64::NAN, ..Target::PID }), TuneError::Target { .. }));
    }
}

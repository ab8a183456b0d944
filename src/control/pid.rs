//! The PID of Eq. 5 as it runs in the tick:
//!
//! ```text
//! u = Kp e + I + D + feedforward        e = direction (reference - angle)
//! I <- I + Ki e dt                      D = Kd v,  v <- v + (1 - exp(-2 pi fc dt)) (d - v)
//! d = -direction rate  (on measurement)  or  direction (reference rate - rate)  (on error)
//! ```
//!
//! The error is taken in the FREE's own direction ([`crate::model::Free::direction`]), so that gains are
//! positive for L and R alike and a positive term asks for more pressure. The integral is stored pre-multiplied
//! by its gain: other gains change neither it nor, with [`Pid::set_gains`], the command. It takes up the
//! present error first (backward Euler), which gives back half of the tick's hold delay.
//!
//! **Windup.** The integral stands still while the command is held back, by 0, p_max or the slew limit, and the
//! error would drive it further in; and it never leaves -p_max..=p_max, beyond which it could not act.

use std::f64::consts::TAU;

use super::{DerivativeOn, Gains};
use crate::signal::{Estimate, LimitSet, Reference, Terms};

/// Which commands the tick can give, Pa.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Lowest: 0, or what the slew limit allows.
    pub lowest: f64,
    /// Highest: p_max, or what the slew limit allows.
    pub highest: f64,
    /// p_max.
    pub maximum: f64,
}

impl Band {
    /// The band after `last`, `dt` later.
    pub fn new(last: f64, maximum: f64, slew: f64, dt: f64) -> Self {
        let step = slew * dt;
        let step = if step >= 0.0 { step } else { 0.0 };
        Self { lowest: (last - step).clamp(0.0, maximum), highest: (last + step).clamp(0.0, maximum), maximum }
    }

    /// `wanted` brought into the band, and what held it back; what is not a number becomes the lowest command.
    pub fn limit(&self, wanted: f64) -> (f64, LimitSet) {
        let mut limits = LimitSet::default();
        if wanted.is_nan() {
            return (self.lowest, limits);
        }
        let mut target = wanted;
        if wanted > self.maximum {
            limits.insert(LimitSet::PRESSURE_MAX);
            target = self.maximum;
        } else if wanted < 0.0 {
            limits.insert(LimitSet::PRESSURE_ZERO);
            target = 0.0;
        }
        let command = target.max(self.lowest).min(self.highest);
        if command != target {
            limits.insert(LimitSet::SLEW);
        }
        (command, limits)
    }
}

/// The controller of one FREE. Its whole state is its [`Terms`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pid {
    gains: Gains,
    derivative_on: DerivativeOn,
    direction: f64,
    terms: Terms,
}

impl Pid {
    /// A controller at rest. `direction` is +1 or -1.
    pub fn new(gains: Gains, derivative_on: DerivativeOn, direction: f64) -> Self {
        Self { gains, derivative_on, direction, terms: Terms::default() }
    }

    /// Its terms of the latest step.
    pub fn terms(&self) -> Terms {
        self.terms
    }

    /// Its gains.
    pub fn gains(&self) -> Gains {
        self.gains
    }

    /// Takes over other gains where none are at work.
    pub fn replace_gains(&mut self, gains: Gains) {
        self.gains = gains;
    }

    /// Takes over recorded terms.
    pub fn resume(&mut self, terms: Terms) {
        self.terms = terms;
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.terms = Terms::default();
    }

    fn error(&self, reference: &Reference, estimate: &Estimate) -> f64 {
        self.direction * (reference.position - estimate.angle)
    }

    fn damped(&self, reference: &Reference, estimate: &Estimate) -> f64 {
        self.direction
            * match self.derivative_on {
                DerivativeOn::Measurement => -estimate.rate,
                DerivativeOn::Error => reference.rate - estimate.rate,
            }
    }

    /// Engages without a bump: for `reference` as it stands before the program begins, the terms sum up to
    /// `command` (Pa), so that what the program then asks acts from there.
    pub fn engage(&mut self, reference: &Reference, estimate: &Estimate, feedforward: f64, command: f64, maximum: f64) {
        let rate = self.damped(reference, estimate);
        let proportional = self.gains.proportional * self.error(reference, estimate);
        let derivative = self.gains.derivative * rate;
        let integral = bounded(command - proportional - derivative - feedforward, maximum);
        self.terms = Terms { proportional, integral, derivative, feedforward, filtered_rate: rate };
        if !self.terms.sum().is_finite() {
            self.reset();
        }
    }

    /// Takes over other gains; the integral takes up the difference, so that the command does not jump.
    pub fn set_gains(&mut self, gains: Gains, reference: &Reference, estimate: &Estimate, maximum: f64) {
        let before = self.terms.sum();
        self.gains = gains;
        self.terms.proportional = gains.proportional * self.error(reference, estimate);
        self.terms.derivative = gains.derivative * self.terms.filtered_rate;
        let others = self.terms.proportional + self.terms.derivative + self.terms.feedforward;
        self.terms.integral = bounded(before - others, maximum);
    }

    /// One step of `dt` seconds. Returns the command before and after the limits (Pa) and the limits in force.
    pub fn step(
        &mut self,
        reference: &Reference,
        estimate: &Estimate,
        feedforward: f64,
        band: &Band,
        dt: f64,
    ) -> (f64, f64, LimitSet) {
        let error = self.error(reference, estimate);
        let rate = self.damped(reference, estimate);
        let share =
            if self.gains.derivative_filter > 0.0 { -(-TAU * self.gains.derivative_filter * dt).exp_m1() } else { 1.0 };
        let filtered_rate = self.terms.filtered_rate + share * (rate - self.terms.filtered_rate);
        let proportional = self.gains.proportional * error;
        let derivative = self.gains.derivative * filtered_rate;
        let others = proportional + derivative + feedforward;
        let held = self.terms.integral;
        let grown = bounded(held + self.gains.integral * error * dt, band.maximum);
        // A program's reference and the estimate are finite; should one not be, the terms keep their last values.
        if !(others + grown).is_finite() {
            let wanted = self.terms.sum();
            let (command, mut limits) = band.limit(wanted);
            limits.insert(LimitSet::INTEGRATOR_HELD);
            return (wanted, command, limits);
        }
        let tentative = others + grown;
        let (command, _) = band.limit(tentative);
        let windup = (tentative > command && grown > held) || (tentative < command && grown < held);
        let integral = if windup { held } else { grown };
        self.terms = Terms { proportional, integral, derivative, feedforward, filtered_rate };
        let wanted = self.terms.sum();
        let (command, mut limits) = band.limit(wanted);
        if windup {
            limits.insert(LimitSet::INTEGRATOR_HELD);
        }
        (wanted, command, limits)
    }
}

fn bounded(integral: f64, maximum: f64) -> f64 {
    if integral.is_nan() { 0.0 } else { integral.max(-maximum).min(maximum) }
}

impl Terms {
    /// The unlimited command, Pa.
    pub fn sum(&self) -> f64 {
        self.proportional + self.integral + self.derivative + self.feedforward
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Quantity;

    const MAX: f64 = 70e3;
    const DT: f64 = 2e-3;
    const GAINS: Gains = Gains { proportional: 20e3, integral: 100e3, derivative: 1e3, derivative_filter: 20.0 };

    fn at(position: f64, rate: f64) -> Reference {
        Reference { quantity: Quantity::Angle, position, rate, acceleration: 0.0 }
    }

    fn seen(angle: f64, rate: f64) -> Estimate {
        Estimate { angle, rate, valid: true, ..Estimate::default() }
    }

    fn free_band(last: f64) -> Band {
        Band::new(last, MAX, f64::INFINITY, DT)
    }

    #[test]
    fn terms_are_those_of_the_equation() {
        let mut pid = Pid::new(Gains { derivative_filter: 0.0, ..GAINS }, DerivativeOn::Measurement, 1.0);
        let (wanted, command, _) = pid.step(&at(0.5, 1.0), &seen(0.3, 2.0), 100.0, &free_band(0.0), DT);
        let t = pid.terms();
        assert!((t.proportional - 20e3 * 0.2).abs() < 1e-9);
        assert!((t.integral - 100e3 * 0.2 * DT).abs() < 1e-9);
        assert!((t.derivative + 1e3 * 2.0).abs() < 1e-9);
        assert_eq!(wanted, command);
        assert_eq!(wanted, t.sum());
        let mut pid = Pid::new(Gains { derivative_filter: 0.0, ..GAINS }, DerivativeOn::Error, 1.0);
        pid.step(&at(0.5, 1.0), &seen(0.3, 2.0), 0.0, &free_band(0.0), DT);
        assert!((pid.terms().derivative + 1e3).abs() < 1e-9);
    }

    #[test]
    fn an_r_free_asks_for_pressure_when_it_must_turn_negative() {
        let (mut l, mut r) = (Pid::new(GAINS, DerivativeOn::Error, 1.0), Pid::new(GAINS, DerivativeOn::Error, -1.0));
        for _ in 0..10 {
            let a = l.step(&at(0.5, 0.2), &seen(0.1, 0.1), 0.0, &free_band(0.0), DT);
            let b = r.step(&at(-0.5, -0.2), &seen(-0.1, -0.1), 0.0, &free_band(0.0), DT);
            assert_eq!(a, b);
            assert!(a.1 > 0.0);
        }
    }

    #[test]
    fn the_derivative_filter_has_its_corner() {
        let mut pid = Pid::new(Gains { derivative_filter: 20.0, ..GAINS }, DerivativeOn::Measurement, 1.0);
        let tau = 1.0 / (TAU * 20.0);
        let steps = 8;
        for _ in 0..steps {
            pid.step(&at(0.0, 0.0), &seen(0.0, -1.0), 0.0, &free_band(0.0), DT);
        }
        let expected = 1.0 - (-(steps as f64) * DT / tau).exp();
        assert!((pid.terms().filtered_rate - expected).abs() < 1e-12, "{}", pid.terms().filtered_rate);
    }

    #[test]
    fn the_integral_stands_still_at_each_limit_and_leaves_it_at_once() {
        // At p_max with the error pushing up, at 0 with it pushing down, and at the slew limit.
        for (error, last, slew) in [(9.0, MAX, f64::INFINITY), (-9.0, 0.0, f64::INFINITY), (1.0, 0.0, 1e3)] {
            let mut pid = Pid::new(GAINS, DerivativeOn::Measurement, 1.0);
            let band = Band::new(last, MAX, slew, DT);
            for _ in 0..1000 {
                let (_, _, limits) = pid.step(&at(error, 0.0), &seen(0.0, 0.0), 0.0, &band, DT);
                assert!(limits.contains(LimitSet::INTEGRATOR_HELD));
            }
            assert_eq!(pid.terms().integral, 0.0);
            pid.step(&at(-error, 0.0), &seen(0.0, 0.0), 0.0, &band, DT);
            assert!(pid.terms().integral * error <= 0.0);
        }
    }

    #[test]
    fn other_gains_do_not_bump_the_command() {
        let mut pid = Pid::new(GAINS, DerivativeOn::Measurement, 1.0);
        for _ in 0..100 {
            pid.step(&at(0.5, 0.0), &seen(0.2, 0.3), 500.0, &free_band(0.0), DT);
        }
        let before = pid.terms().sum();
        let other = Gains { proportional: 5e3, integral: 400e3, derivative: 3e3, derivative_filter: 5.0 };
        pid.set_gains(other, &at(0.5, 0.0), &seen(0.2, 0.3), MAX);
        assert!((pid.terms().sum() - before).abs() < 1e-9);
        // The next step moves by no more than one step's worth of integral and of a filter settled already.
        let (wanted, _, _) = pid.step(&at(0.5, 0.0), &seen(0.2, 0.3), 500.0, &free_band(before), DT);
        assert!((wanted - before).abs() <= other.integral * 0.3 * DT + 1.0, "{wanted} {before}");
    }

    #[test]
    fn engaging_starts_from_the_pressure_that_is_held() {
        let mut pid = Pid::new(GAINS, DerivativeOn::Measurement, 1.0);
        pid.engage(&at(0.7, 0.0), &seen(0.6, 0.0), 0.0, 30e3, MAX);
        assert!((pid.terms().sum() - 30e3).abs() < 1e-9);
        let (wanted, _, _) = pid.step(&at(0.7, 0.0), &seen(0.6, 0.0), 0.0, &free_band(30e3), DT);
        assert!((wanted - 30e3).abs() <= GAINS.integral * 0.1 * DT + 1e-9);
    }

    #[test]
    fn nothing_that_is_not_a_number_gets_into_the_terms_or_the_command() {
        let mut pid = Pid::new(GAINS, DerivativeOn::Error, 1.0);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (_, command, _) = pid.step(&at(bad, bad), &seen(0.1, 0.0), 0.0, &free_band(10.0), DT);
            assert!((0.0..=MAX).contains(&command));
            pid.step(&at(0.0, 0.0), &seen(bad, bad), bad, &free_band(10.0), DT);
            pid.engage(&at(bad, bad), &seen(0.0, 0.0), 0.0, 1.0, MAX);
            assert!(pid.terms().sum().is_finite());
        }
    }
}

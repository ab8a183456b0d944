//! Feedforward: the pressure that the model needs for the reference, sent ahead by the regulator's lag.
//!
//! ```text
//! P_d = (kt phi + ct phi' + I phi'') / (2 pi r^3 |cot G|),      r = R / (1 + phi R / (L tan G))
//! feedforward = share (P_d + (lag + dead time) P_d'),           P_d' = (kt phi' + ct phi'') / (2 pi r^3 |cot G|)
//! ```
//!
//! The torsional equation of the lumped model (Eq. 4) at rest in the axial direction; r is the fibre radius at
//! s = 0, where neglecting it would ask for a third too much at 70 deg. The jerk is left out of P_d'.

use std::f64::consts::PI;

use crate::model::Free;
use crate::signal::Reference;

use super::RegulatorChannel;

/// The inverse model of one FREE behind its regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedforward {
    share: f64,
    free: Free,
    lead: f64,
}

impl Feedforward {
    /// `share` 0 switches it off.
    pub fn new(free: Free, regulator: &RegulatorChannel, share: f64) -> Self {
        Self { share, free, lead: (regulator.lag + regulator.dead_time).as_secs_f64() }
    }

    /// Pressure for the reference, Pa, positive in the FREE's own direction; 0 if it is not a number.
    pub fn pressure(&self, reference: &Reference) -> f64 {
        if self.share == 0.0 {
            return 0.0;
        }
        let f = &self.free;
        // Half the radius' denominator is beyond the lumped model's use; there the growth stops.
        let denominator = (1.0 + reference.position * f.radius / (f.length * f.gamma.tan())).max(0.5);
        let per_pascal = actuation(f) / (denominator * denominator * denominator);
        let Reference { position, rate, acceleration, .. } = *reference;
        let moment = f.torsional_stiffness * position + f.torsional_damping * rate + f.inertia * acceleration;
        let moment_rate = f.torsional_stiffness * rate + f.torsional_damping * acceleration;
        let pressure = self.share * f.direction() * (moment + self.lead * moment_rate) / per_pascal;
        if pressure.is_finite() { pressure } else { 0.0 }
    }
}

/// Moment per pressure at rest, a = 2 pi R^3 |cot G| (Eq. 7), N m/Pa, in the FREE's own direction.
pub fn actuation(free: &Free) -> f64 {
    2.0 * PI * free.radius.powi(3) / free.gamma.tan().abs()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::signal::Quantity;

    fn paper(gamma: f64) -> Free {
        Free {
            gamma: gamma.to_radians(),
            length: 0.11,
            radius: 0.007,
            mass: 0.028,
            inertia: 0.028 * 0.007 * 0.007,
            axial_stiffness: 10110.0,
            torsional_stiffness: 0.086,
            axial_damping: 5.0,
            torsional_damping: 0.005,
        }
    }

    fn regulator() -> RegulatorChannel {
        RegulatorChannel {
            period: Duration::from_millis(16),
            lag: Duration::from_millis(60),
            dead_time: Duration::from_millis(15),
            fastest_fill: 200e3,
            full_scale: 103e3,
            measures: true,
        }
    }

    #[test]
    fn the_static_inverse_balances_the_torsional_equation() {
        for gamma in [-40.0, 40.0] {
            let free = paper(gamma);
            let position = 40f64.to_radians() * free.direction();
            let r = Reference { quantity: Quantity::Angle, position, rate: 0.0, acceleration: 0.0 };
            let p = Feedforward::new(free, &regulator(), 1.0).pressure(&r);
            let radius = free.length * free.gamma.tan() / (free.length * free.gamma.tan() / free.radius + position);
            let moment = -2.0 * PI * radius.powi(3) * p / free.gamma.tan();
            assert!((moment - free.torsional_stiffness * position).abs() < 1e-12);
            assert!(p > 0.0);
        }
    }

    #[test]
    fn a_moving_reference_is_sent_ahead_by_the_lag() {
        let (free, rate) = (paper(-40.0), 0.01);
        let at = |position| Reference { quantity: Quantity::Angle, position, rate, acceleration: 0.0 };
        let ahead = Feedforward::new(free, &regulator(), 1.0).pressure(&at(0.0));
        let expected = (free.torsional_damping + 0.075 * free.torsional_stiffness) * rate / actuation(&free);
        assert!((ahead - expected).abs() < 1e-9);
        assert_eq!(Feedforward::new(free, &regulator(), 0.0).pressure(&at(1.0)), 0.0);
        assert_eq!(Feedforward::new(free, &regulator(), 1.0).pressure(&at(f64::NAN)), 0.0);
    }
}

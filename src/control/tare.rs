//! Where a FREE's angle is zero: the mean of readings at rest.

use super::swing_twist::{dot, unit, upright};
use crate::signal::{ImuHealth, ImuSample};

/// Mean orientation and rate of readings at rest: the tare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TareMean {
    sum: [f64; 4],
    count: u32,
    sequence: u32,
}

impl TareMean {
    /// Readings it takes.
    pub const READINGS: u32 = 10;
    /// Fastest motion at which the FREE counts as standing still, rad/s: ten times the gyro's noise, and a
    /// movement of the hand is above it.
    pub const STILL: f64 = 0.05;

    /// Adds a reading if it is new. False if it moves: then the mean starts anew.
    pub fn add(&mut self, sample: &ImuSample) -> bool {
        if sample.sequence == self.sequence && self.count > 0 {
            return true;
        }
        self.sequence = sample.sequence;
        let Some(q) = unit(sample.quaternion).filter(|_| sample.health == ImuHealth::Good) else { return true };
        let moving = dot(sample.rate, sample.rate).sqrt();
        if moving.is_nan() || moving > Self::STILL {
            *self = Self { sequence: sample.sequence, ..Self::default() };
            return false;
        }
        let sign = if self.sum.iter().zip(q).map(|(a, b)| a * b).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
        for (sum, q) in self.sum.iter_mut().zip(q) {
            *sum += sign * q;
        }
        self.count = self.count.saturating_add(1);
        true
    }

    /// The mean orientation, once there are enough readings.
    pub fn orientation(&self) -> Option<[f64; 4]> {
        let norm = self.sum.iter().map(|x| x * x).sum::<f64>().sqrt();
        (self.count >= Self::READINGS && norm > 0.0).then(|| upright(self.sum.map(|x| x / norm)))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::swing_twist::{difference, swing_twist};
    use super::*;

    fn sample(sequence: u32, q: UnitQuaternion<f64>, sign: f64, rate: f64) -> ImuSample {
        let quaternion = [q.w, q.i, q.j, q.k].map(|x| sign * x);
        let health = ImuHealth::Good;
        ImuSample { sequence, quaternion, rate: [0.0, 0.0, rate], health, ..ImuSample::default() }
    }

    #[test]
    fn the_tare_is_the_mean_of_readings_at_rest() {
        let mut tare = TareMean::default();
        let base = UnitQuaternion::from_euler_angles(0.1, 0.2, 3.1);
        for k in 0..TareMean::READINGS {
            assert!(tare.orientation().is_none());
            let noise = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), if k % 2 == 0 { 1e-3 } else { -1e-3 });
            let sign = if k % 3 == 0 { -1.0 } else { 1.0 };
            assert!(tare.add(&sample(k + 1, base * noise, sign, 0.0)));
        }
        let mean = tare.orientation().unwrap();
        let (twist, tilt) = swing_twist(difference(mean, [base.w, base.i, base.j, base.k]), [0.0, 0.0, 1.0]);
        assert!(twist.abs() < 1e-9 && tilt < 1e-9, "{twist} {tilt}");
        assert!(!tare.add(&sample(99, base, 1.0, 1.1 * TareMean::STILL)));
        assert!(tare.orientation().is_none());
    }
}

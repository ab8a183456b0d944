//! Angle and rate now, from an IMU's delayed, quantised readings.
//!
//! **Angle of a reading.** With q = q_tare^-1 q_now and the FREE's axis a in the sensor's frame, the twist of the
//! swing-twist decomposition is 2 atan2(q_v . a, q_w), right under any tilt but 180 deg. The quaternion's sign
//! drops out (it is chosen so that q_w >= 0), and the angle is unwrapped to the turn nearest to where the gyro
//! said it would be: a FREE turns beyond a full turn.
//!
//! **Plausible** is a reading with a norm within 0.02 of one, a rate within the gyro's range, a tilt below 160 deg, and
//! an angle that the gyro can explain ([`JUMP_MAX`], growing by [`JUMP_RATE`] with the time since the reading before).
//! A gyro at the end of its range says "at least": then the angle may have moved twice as far. Any other is refused and
//! counted by the interlocks; the estimate goes on from the last good one. Between two sessions the zero belongs to
//! nobody: there, an axis that stays tilted for [`NEW_ZERO_AFTER`] (the IMU was mounted anew, or a reset has turned its
//! north) becomes the new zero.
//!
//! **Now.** A reading speaks of the time `age + delay` ago. Between and beyond readings,
//!
//! ```text
//! predicted = measured angle + measured rate (age + delay)           (age + delay <= 50 ms)
//! angle    <- predicted + b (angle + measured rate dt - predicted)   b = exp(-dt / tau)
//! ```
//!
//! so a new reading is not a jump but a correction that dies out with `tau`, half the IMU's period: averaged over
//! a period, angle(s) = (predicted + tau rate) / (1 + tau s). An IMU that is read in every tick needs no
//! smoothing: there tau = 0, and with no delay the estimate is the reading. The rate is the gyro's about the
//! axis, as old as the reading: nothing is differentiated.
//!
//! Error for a motion with angular acceleration up to A and third derivative up to J, to first order:
//! A h^2 / 2 in the angle and A h in the rate, h = age + delay, beside the quantisation (2^-14 in the quaternion:
//! 1.2e-4 rad; 1/16 deg/s).

use crate::clock::Time;
use crate::signal::{Estimate, ImuHealth, ImuSample};

use super::ImuChannel;
use super::swing_twist::{difference, dot, swing_twist, unit};

/// Largest tilt of the axis against the tare, rad: the twist is undefined at 180 deg and its error grows as
/// 1/cos(tilt/2) towards it.
pub const TILT_MAX: f64 = 160.0 * std::f64::consts::PI / 180.0;
/// Largest difference between two readings' angles that the gyro does not explain, rad.
pub const JUMP_MAX: f64 = 0.25;
/// How it grows with the time between the readings beyond one period, rad/s: after an outage a reading is let in
/// again, half a turn after 0.6 s.
pub const JUMP_RATE: f64 = 5.0;
/// How long the tilt must be too large outside a session until the present orientation becomes the zero, s: as long
/// as any other difference is refused ([`JUMP_RATE`]).
pub const NEW_ZERO_AFTER: f64 = 0.6;
/// Fastest rate that a reading may give, rad/s: the gyro's range is 2000 deg/s.
pub const RATE_MAX: f64 = 36.0;
/// From here on the gyro is at the end of its range and the FREE may turn faster, rad/s: 1990 deg/s. One that bursts
/// does.
pub const RATE_FULL: f64 = 34.7;
/// Longest time over which a reading is extrapolated, s.
pub const HORIZON_MAX: f64 = 0.05;

/// What became of the latest reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reading {
    /// There is no new one.
    #[default]
    None,
    /// A new one, used.
    Accepted,
    /// A new one that cannot be, not used.
    Refused,
}

/// The estimator of one FREE. Its whole state is its [`Estimate`] and the time of the latest accepted reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimator {
    axis: [f64; 3],
    delay: f64,
    period: f64,
    smoothing: f64,
    estimate: Estimate,
    accepted: Time,
}

impl Estimator {
    /// An estimator for an IMU read by `channel` in a loop of `tick` seconds. The axis must be a unit vector.
    pub fn new(channel: &ImuChannel, tick: f64) -> Self {
        let period = channel.period.as_secs_f64();
        Self {
            axis: channel.axis,
            delay: channel.delay.as_secs_f64(),
            period,
            smoothing: smoothing(period, tick),
            estimate: Estimate::default(),
            accepted: Time::ZERO,
        }
    }

    /// What it believes.
    pub fn estimate(&self) -> Estimate {
        self.estimate
    }

    /// Takes over a recorded estimate.
    pub fn resume(&mut self, estimate: Estimate, time: Time) {
        self.estimate = estimate;
        let age = if estimate.age.is_finite() { (estimate.age - self.delay).max(0.0) } else { 0.0 };
        self.accepted = time - std::time::Duration::from_nanos((age * 1e9).round() as u64);
    }

    /// Makes `orientation` (unit quaternion) the zero of the angle.
    pub fn tare(&mut self, orientation: [f64; 4]) {
        self.estimate = Estimate {
            tare: orientation,
            sequence: self.estimate.sequence,
            age: self.estimate.age,
            ..Estimate::default()
        };
    }

    /// One tick, `dt` seconds after the one before, with the latest reading; `session` says whether somebody relies
    /// on the angle's zero.
    pub fn step(&mut self, sample: &ImuSample, now: Time, dt: f64, session: bool) -> Reading {
        let reading = self.take(sample, now, session);
        let e = &mut self.estimate;
        if e.valid {
            let horizon = (now.seconds_since(self.accepted).max(0.0) + self.delay).min(HORIZON_MAX);
            let predicted = e.measured_angle + e.measured_rate * horizon;
            let keep = if self.smoothing > 0.0 { (-dt / self.smoothing).exp() } else { 0.0 };
            let carried = e.angle + e.measured_rate * dt;
            e.angle = if e.age.is_finite() { predicted + keep * (carried - predicted) } else { predicted };
            e.rate = e.measured_rate;
            e.age = now.seconds_since(self.accepted).max(0.0) + self.delay;
        }
        reading
    }

    fn take(&mut self, sample: &ImuSample, now: Time, session: bool) -> Reading {
        // A lost sensor's slot repeats its last reading: that is no reading.
        if matches!(sample.health, ImuHealth::Absent | ImuHealth::Lost) || sample.sequence == self.estimate.sequence {
            return Reading::None;
        }
        self.estimate.sequence = sample.sequence;
        if sample.health != ImuHealth::Good {
            return Reading::Refused;
        }
        let Some(orientation) = unit(sample.quaternion) else { return Reading::Refused };
        let rate = dot(sample.rate, self.axis);
        if rate.abs() > RATE_MAX || rate.is_nan() {
            return Reading::Refused;
        }
        if self.estimate.tare == [0.0; 4] {
            // Before the first tare the first orientation seen is as good a zero as any.
            self.estimate.tare = orientation;
        }
        // A reading from the future is a clock gone wrong: it counts from its arrival.
        let taken = if sample.time > now { now } else { sample.time };
        let (mut twist, mut tilt) = swing_twist(difference(self.estimate.tare, orientation), self.axis);
        if tilt > TILT_MAX {
            if session || self.estimate.valid && taken.seconds_since(self.accepted) < NEW_ZERO_AFTER {
                return Reading::Refused;
            }
            self.tare(orientation);
            (twist, tilt) = (0.0, 0.0);
        }
        let e = &mut self.estimate;
        let angle = if e.valid {
            let elapsed = taken.seconds_since(self.accepted).max(0.0);
            let explained = elapsed.min(HORIZON_MAX);
            let expected = e.measured_angle + 0.5 * (e.measured_rate + rate) * explained;
            let angle = unwrap(twist, expected);
            let fastest = rate.abs().max(e.measured_rate.abs());
            // At most 1.8 rad: far from the half turn at which a turn could be lost.
            let beyond = if fastest >= RATE_FULL { fastest * explained } else { 0.0 };
            if (angle - expected).abs() > JUMP_MAX + beyond + JUMP_RATE * (elapsed - self.period).max(0.0) {
                return Reading::Refused;
            }
            angle
        } else {
            e.age = f64::INFINITY; // no estimate to blend with
            twist
        };
        e.measured_angle = angle;
        e.measured_rate = rate;
        e.tilt = tilt;
        e.valid = true;
        self.accepted = taken;
        Reading::Accepted
    }
}

/// Time constant (s) with which a reading's correction dies out: half the IMU's period, none where every tick
/// has its own reading.
pub fn smoothing(imu_period: f64, tick: f64) -> f64 {
    if imu_period > 1.5 * tick { 0.5 * imu_period } else { 0.0 }
}

/// The angle equal to `angle` up to whole turns that is nearest to `near`.
fn unwrap(angle: f64, near: f64) -> f64 {
    angle + std::f64::consts::TAU * ((near - angle) / std::f64::consts::TAU).round()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};
    use std::time::Duration;

    use nalgebra::{Unit, UnitQuaternion, Vector3};

    use super::*;

    const Z: [f64; 3] = [0.0, 0.0, 1.0];

    fn channel() -> ImuChannel {
        ImuChannel { axis: Z, period: Duration::from_millis(10), delay: Duration::from_millis(15) }
    }

    fn quaternion(q: UnitQuaternion<f64>) -> [f64; 4] {
        [q.w, q.i, q.j, q.k]
    }

    fn turned(angle: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle)
    }

    fn sample(sequence: u32, time: f64, q: [f64; 4], rate: f64) -> ImuSample {
        ImuSample {
            time: Time::from_nanos((time * 1e9).round() as u64),
            sequence,
            quaternion: q,
            rate: [0.0, 0.0, rate],
            health: ImuHealth::Good,
            calibration: 0xff,
            ..ImuSample::default()
        }
    }

    fn quantised(q: [f64; 4]) -> [f64; 4] {
        q.map(|x| (x * 16384.0).round() / 16384.0)
    }

    /// Runs the estimator at 500 Hz over readings at 100 Hz of `motion` (angle, rate), 15 ms late, quantised, with a
    /// random sign, tilted by `tilt`; calls `see` with time and estimate in every tick.
    fn run(motion: impl Fn(f64) -> (f64, f64), tilt: f64, seconds: f64, mut see: impl FnMut(f64, Estimate)) {
        let mut estimator = Estimator::new(&channel(), 2e-3);
        let swing = UnitQuaternion::from_axis_angle(&Unit::new_normalize(Vector3::new(1.0, 0.4, 0.0)), tilt);
        let base = UnitQuaternion::from_euler_angles(0.3, -0.8, 2.0);
        estimator.tare(quaternion(base));
        let mut latest = ImuSample::default();
        for k in 0..(seconds / 2e-3) as u64 {
            let now = k as f64 * 2e-3;
            if k % 5 == 0 {
                let (angle, rate) = motion(now - 0.015);
                let sign = if (k / 5) % 3 == 1 { -1.0 } else { 1.0 };
                let q = quantised(quaternion(base * swing * turned(angle))).map(|x| sign * x);
                let unit = PI / 180.0 / 16.0;
                latest = sample(1 + (k / 5) as u32, now, q, (rate / unit).round() * unit);
            }
            assert_ne!(
                estimator.step(&latest, Time::from_nanos(k * 2_000_000), 2e-3, true),
                Reading::Refused,
                "t = {now}"
            );
            see(now, estimator.estimate());
        }
    }

    #[test]
    fn constant_rate_is_followed_without_lag_through_several_turns() {
        let mut worst = 0f64;
        run(
            |t| (3.0 * t, 3.0),
            0.0,
            9.0,
            |t, e| {
                if t > 0.1 {
                    worst = worst.max((e.angle - 3.0 * t).abs());
                }
            },
        );
        // Two quanta of the quaternion (2 x 1.2e-4 rad) and half a quantum of the rate over 25 ms.
        assert!(worst < 4e-4, "{worst}");
    }

    #[test]
    fn a_swing_of_the_free_is_estimated_within_the_stated_bound() {
        let (amplitude, omega) = (0.6, TAU * 1.0);
        let (mut angle_error, mut rate_error) = (0f64, 0f64);
        run(
            |t| (amplitude * (omega * t).sin(), amplitude * omega * (omega * t).cos()),
            0.0,
            5.0,
            |t, e| {
                if t > 0.1 {
                    angle_error = angle_error.max((e.angle - amplitude * (omega * t).sin()).abs());
                    rate_error = rate_error.max((e.rate - amplitude * omega * (omega * t).cos()).abs());
                }
            },
        );
        let (acceleration, horizon) = (amplitude * omega * omega, 0.025);
        // The smoothing adds a lag of the correction, not of the motion: half as much again is room enough.
        assert!(angle_error < 0.75 * acceleration * horizon * horizon + 3e-4, "{angle_error}");
        assert!(rate_error < acceleration * horizon + 2e-3, "{rate_error}");
    }

    #[test]
    fn a_snap_that_is_too_fast_for_the_gyro_is_followed_to_its_end() {
        // From 309 degrees back at up to 5.4 omega / e = 60 rad/s; the gyro stops at 2048 deg/s.
        let omega: f64 = 30.0;
        let motion = move |t: f64| {
            let t = (t - 1.0).max(0.0);
            // One turn less: the tare's own turn is the one that the first reading is in.
            let angle = 5.4 * (1.0 + omega * t) * (-omega * t).exp() - TAU;
            (angle, (-5.4 * omega * omega * t * (-omega * t).exp()).max(-35.74))
        };
        let mut last = Estimate::default();
        run(motion, 0.0, 2.0, |_, e| last = e);
        assert!((last.angle - motion(1.998).0).abs() < 1e-3, "{}", last.angle);
    }

    #[test]
    fn a_tilted_axis_changes_nothing_up_to_160_degrees() {
        for degrees in [0.0f64, 20.0, 60.0, 120.0, 155.0] {
            let mut last = Estimate::default();
            run(|t| (2.0 * t, 2.0), degrees.to_radians(), 4.0, |_, e| last = e);
            assert!((last.tilt - degrees.to_radians()).abs() < 1e-3, "{degrees} {}", last.tilt);
            // Quantisation grows as 1/cos(tilt/2).
            let bound = 4e-4 / (0.5 * degrees.to_radians()).cos();
            assert!((last.angle - 2.0 * 3.998).abs() < bound, "{degrees} {}", last.angle - 2.0 * 3.998);
        }
    }

    #[test]
    fn the_sign_of_the_quaternion_is_irrelevant_to_the_bit() {
        let channel = channel();
        let (mut plus, mut minus) = (Estimator::new(&channel, 2e-3), Estimator::new(&channel, 2e-3));
        for k in 0..2000u32 {
            let t = f64::from(k) * 0.01;
            let q = quaternion(turned(0.7 * t));
            let now = Time::from_nanos(u64::from(k) * 10_000_000);
            plus.step(&sample(k + 1, t, q, 0.7), now, 2e-3, true);
            minus.step(&sample(k + 1, t, q.map(|x| -x), 0.7), now, 2e-3, true);
            assert_eq!(plus.estimate(), minus.estimate());
        }
        assert!((plus.estimate().measured_angle - 0.7 * 19.99).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_is_refused_and_the_estimate_goes_on() {
        let at = |k: u32| (f64::from(k) * 0.01, Time::from_nanos(u64::from(k) * 10_000_000));
        let good = |k: u32| sample(k + 1, at(k).0, quaternion(turned(0.1)), 0.0);
        let mut estimator = Estimator::new(&channel(), 2e-3);
        estimator.tare([1.0, 0.0, 0.0, 0.0]);
        for k in 0..5 {
            assert_eq!(estimator.step(&good(k), at(k).1, 2e-3, true), Reading::Accepted);
        }
        let before = estimator.estimate().angle;
        let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 175f64.to_radians());
        let off = |n: f64| quaternion(turned(0.1)).map(|x| x * n);
        let bad = [
            ImuSample { quaternion: [0.0; 4], ..good(5) },
            ImuSample { quaternion: [f64::NAN; 4], ..good(5) },
            ImuSample { quaternion: off(1.021), ..good(5) },
            ImuSample { quaternion: off(0.979), ..good(5) },
            ImuSample { rate: [0.0, 0.0, f64::INFINITY], ..good(5) },
            ImuSample { quaternion: quaternion(turned(0.1 + 1.01 * JUMP_MAX)), ..good(5) },
            ImuSample { quaternion: quaternion(flip), ..good(5) },
            ImuSample { health: ImuHealth::Restarting, ..good(5) },
            ImuSample { health: ImuHealth::Implausible, ..good(5) },
        ];
        for bad in bad {
            let mut estimator = estimator;
            assert_eq!(estimator.step(&bad, at(5).1, 2e-3, true), Reading::Refused, "{bad:?}");
            assert!((estimator.estimate().angle - before).abs() < 1e-12);
        }
        for n in [0.981, 1.019] {
            let mut estimator = estimator;
            let sample = ImuSample { quaternion: off(n), ..good(5) };
            assert_eq!(estimator.step(&sample, at(5).1, 2e-3, true), Reading::Accepted);
        }
        let jump = ImuSample { quaternion: quaternion(turned(0.1 + 0.99 * JUMP_MAX)), ..good(5) };
        assert_eq!(estimator.step(&jump, at(5).1, 2e-3, true), Reading::Accepted);
    }

    #[test]
    fn an_axis_that_stays_tilted_is_the_new_zero_between_sessions_and_never_within_one() {
        let tilted = quaternion(UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 175f64.to_radians()));
        for (session, becomes_zero) in [(true, None), (false, Some(60))] {
            let mut estimator = Estimator::new(&channel(), 2e-3);
            estimator.tare([1.0, 0.0, 0.0, 0.0]);
            let mut step = |k: u32, q| {
                let s = sample(k + 1, f64::from(k) * 0.01, q, 0.0);
                estimator.step(&s, Time::from_nanos(u64::from(k) * 10_000_000), 2e-3, session)
            };
            assert_eq!(step(0, [1.0, 0.0, 0.0, 0.0]), Reading::Accepted);
            let first = (1..200).find(|&k| step(k, tilted) == Reading::Accepted);
            assert_eq!(first, becomes_zero, "{session}");
            assert_eq!(estimator.estimate().angle, 0.0);
        }
    }

    #[test]
    fn without_delay_and_with_a_reading_in_every_tick_the_estimate_is_the_reading() {
        let ideal = ImuChannel { axis: Z, period: Duration::from_micros(500), delay: Duration::ZERO };
        let mut estimator = Estimator::new(&ideal, 5e-4);
        estimator.tare([1.0, 0.0, 0.0, 0.0]);
        for k in 0..1000u32 {
            let t = f64::from(k) * 5e-4;
            let angle = 0.8 * (20.0 * t).sin();
            let s = sample(k + 1, t, quaternion(turned(angle)), 16.0 * (20.0 * t).cos());
            estimator.step(&s, Time::from_nanos(u64::from(k) * 500_000), 5e-4, true);
            assert!((estimator.estimate().angle - angle).abs() < 1e-12);
        }
    }
}

//! Synthetic ring-downs: the exact motion of a FREE that is let go, and what a sensor makes of it. The motion is the
//! closed form of I phi'' + ct phi' + kt phi = 0 in every regime of damping, by its initial conditions; it shares
//! nothing with the fit.

use std::f64::consts::TAU;

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// A FREE that is let go at time zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plucked {
    /// I, kg m2.
    pub inertia: f64,
    /// kt, N m/rad.
    pub stiffness: f64,
    /// ct, N m s/rad.
    pub damping: f64,
    /// Angle at release, rad.
    pub angle: f64,
    /// Rate at release, rad/s.
    pub rate: f64,
}

impl Plucked {
    /// A FREE of `natural` (undamped) frequency, Hz, and damping `ratio`, let go at rest from `angle` (rad).
    pub fn of(inertia: f64, natural: f64, ratio: f64, angle: f64) -> Self {
        let omega = TAU * natural;
        Self { inertia, stiffness: inertia * omega * omega, damping: 2.0 * ratio * inertia * omega, angle, rate: 0.0 }
    }

    /// One of the FREEs of the identification study: 3 to 15 Hz, damping ratio 0.02 to 0.3 (both evenly in their
    /// logarithm), let go from 5 to 20 deg with some rate.
    pub fn seeded(seed: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut log = |low: f64, high: f64| low * (high / low).powf(random.random::<f64>());
        let free = Self::of(log(1e-6, 1e-4), log(3.0, 15.0), log(0.02, 0.3), log(5.0, 20.0).to_radians());
        let natural = (free.stiffness / free.inertia).sqrt();
        Self { rate: (random.random::<f64>() - 0.5) * free.angle * natural, ..free }
    }

    /// d = ct / 2I, 1/s.
    pub fn decay(&self) -> f64 {
        self.damping / (2.0 * self.inertia)
    }

    /// Damped angular frequency, rad/s; not a number beyond critical damping.
    pub fn omega(&self) -> f64 {
        (self.stiffness / self.inertia - self.decay().powi(2)).sqrt()
    }

    /// Angle (rad) and rate (rad/s) at `time` (s, from the release on).
    pub fn motion(&self, time: f64) -> (f64, f64) {
        let d = self.decay();
        let square = self.stiffness / self.inertia;
        let beyond = d * d - square;
        let push = self.rate + d * self.angle;
        // phi = exp(-d t) (phi0 C + (phi0' + d phi0) S), with C = cos wt, S = sin(wt)/w, or their hyperbolic kin
        let (c, s) = if beyond < 0.0 {
            let w = (-beyond).sqrt();
            ((-d * time).exp() * (w * time).cos(), (-d * time).exp() * (w * time).sin() / w)
        } else if beyond > 0.0 {
            let w = beyond.sqrt();
            // (d - w) from the product of the poles: no cancellation.
            let (slow, fast) = ((-square / (d + w) * time).exp(), (-(d + w) * time).exp());
            (0.5 * (slow + fast), 0.5 * (slow - fast) / w)
        } else {
            ((-d * time).exp(), time * (-d * time).exp())
        };
        let angle = self.angle * c + push * s;
        (angle, self.rate * c - (d * self.rate + square * self.angle) * s)
    }

    /// Length of a record that a person would take: `cycles`, or until the motion is below `noise` (rad), s.
    pub fn length(&self, cycles: f64, noise: f64) -> f64 {
        let gone = (self.angle.abs() / noise).max(2.0).ln() / self.decay();
        (cycles * TAU / (self.stiffness / self.inertia).sqrt()).min(gone)
    }
}

/// How a sensor sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Sampling rate, Hz.
    pub rate: f64,
    /// Standard deviation of the noise, rad or rad/s.
    pub noise: f64,
    /// Time constant over which the noise remembers itself (a first-order low-pass, as of a fusion filter), s; zero for
    /// white noise.
    pub memory: f64,
    /// Step of the quantisation, rad or rad/s; zero for none.
    pub resolution: f64,
    /// Offset, rad or rad/s.
    pub offset: f64,
    /// Drift, per second.
    pub drift: f64,
    /// Range: larger magnitudes are cut.
    pub limit: f64,
    /// Share of samples that are thrown off by up to `spike`.
    pub outliers: f64,
    /// Largest error of an outlier, rad or rad/s.
    pub spike: f64,
    /// Seed of noise and outliers.
    pub seed: u64,
}

impl Sensing {
    /// The IMU of the bench: 100 Hz, 0.05 deg noise, the 0.0625 deg steps of its Euler angles, turned by 3 deg.
    pub fn imu(seed: u64) -> Self {
        Self {
            rate: 100.0,
            noise: 0.05f64.to_radians(),
            memory: 0.0,
            resolution: 0.0625f64.to_radians(),
            offset: 3f64.to_radians(),
            drift: 0.0,
            limit: f64::INFINITY,
            outliers: 0.0,
            spike: 0.0,
            seed,
        }
    }

    /// Times (s) and values of a record of `truth` (by time), `length` (s) long.
    pub fn record(&self, length: f64, truth: impl Fn(f64) -> f64) -> (Vec<f64>, Vec<f64>) {
        let mut random = Pcg64::seed_from_u64(self.seed);
        let count = (length * self.rate).floor() as usize + 1;
        let kept = if self.memory > 0.0 { (-1.0 / (self.rate * self.memory)).exp() } else { 0.0 };
        let mut last: f64 = 0.0;
        let sample = |i: usize| {
            let time = i as f64 / self.rate;
            let fresh: f64 = StandardNormal.sample(&mut random);
            // Stationary from the first sample on.
            let normal = if i == 0 { fresh } else { kept * last + (1.0 - kept * kept).sqrt() * fresh };
            last = normal;
            let (thrown, spike) =
                (random.random::<f64>() < self.outliers, self.spike * (2.0 * random.random::<f64>() - 1.0));
            let error = self.noise * normal + if thrown { spike } else { 0.0 };
            let value = truth(time) + self.offset + self.drift * time + error;
            let stepped =
                if self.resolution > 0.0 { (value / self.resolution).round() * self.resolution } else { value };
            (time, stepped.clamp(-self.limit, self.limit))
        };
        (0..count).map(sample).unzip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed forms against the equation of motion itself, by differences, in all regimes.
    #[test]
    fn the_motion_obeys_its_equation() {
        for ratio in [0.0, 0.05, 0.8, 1.0, 1.0001, 7.3] {
            let free = Plucked { rate: 2.0, ..Plucked::of(1e-5, 6.0, ratio, 0.2) };
            assert_eq!(free.motion(0.0), (0.2, 2.0));
            for time in [0.01, 0.07, 0.3] {
                let h = 1e-4;
                let at = |k: f64| free.motion(time + k * h);
                let rate = (at(1.0).0 - at(-1.0).0) / (2.0 * h);
                let acceleration = (at(1.0).1 - at(-1.0).1) / (2.0 * h);
                let (angle, own) = at(0.0);
                let natural = (free.stiffness / free.inertia).sqrt();
                // Central differences: (h natural 2 ratio)^2 relative.
                assert!((rate - own).abs() < 3e-3 * natural * 0.2 * (1.0 + ratio), "{ratio} {time}");
                let left = free.inertia * acceleration + free.damping * own + free.stiffness * angle;
                assert!(left.abs() < 3e-3 * free.stiffness * 0.2 * (1.0 + ratio * ratio), "{ratio} {time} {left}");
            }
        }
    }
}

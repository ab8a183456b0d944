//! Root locus of Eq. 6, and of the same loop with the regulator's lag, the delays and the sampling in it.
//!
//! ```text
//! ideal:     (I s^2 + ct s + kt) s + g a (Kd s^2 + Kp s + Ki) = 0                                  (Eqs 6, 7)
//! extended:  1 + g L(s) = 0,
//!            L = a / (I s^2 + ct s + kt) / (1 + lag s) e^(-theta s) ((1 + d s)(Kp + Ki / s) + Kd s / (1 + s / wf))
//!            theta = dead time + half the regulator's period + d,   d = IMU delay + half of (IMU period - tick)
//! ```
//!
//! (1 + d s) is the estimator's extrapolation over the mean age of a reading. The delay is a Pade approximation of
//! third order, right to 1 deg up to theta w = 3; beyond, the discrete-time eigenvalues of [`super::margin`] are the
//! authority. Poles are in 1/s; the gains grow together by the factor g.

use std::f64::consts::TAU;
use std::time::Duration;

use nalgebra::{Complex, DMatrix, linalg::Schur};

use super::feedforward::actuation;
use super::{Gains, ImuChannel, RegulatorChannel};
use crate::model::Free;

/// Unit of time in which polynomials are solved, s: keeps their coefficients of one size.
const UNIT: f64 = 0.02;

/// The closed loop's poles at one gain.
#[derive(Clone, Debug, PartialEq)]
pub struct LocusPoint {
    /// Factor on all gains.
    pub factor: f64,
    /// Poles of Eq. 6, 1/s.
    pub ideal: Vec<Complex<f64>>,
    /// Poles of the extended loop, 1/s.
    pub extended: Vec<Complex<f64>>,
}

/// The loop as polynomials, lowest power first, in a unit of time of 20 ms.
#[derive(Clone, Debug, PartialEq)]
pub struct LocusLoop {
    ideal: (Vec<f64>, Vec<f64>),
    extended: (Vec<f64>, Vec<f64>),
    delay: f64,
}

impl LocusLoop {
    /// The loop of `free` with `gains` behind its devices, at a tick of `period`.
    pub fn new(free: &Free, gains: &Gains, regulator: &RegulatorChannel, imu: &ImuChannel, period: Duration) -> Self {
        let per_rad = actuation(free) / free.torsional_stiffness;
        let tick = period.as_secs_f64();
        let seen = imu.delay.as_secs_f64() + 0.5 * (imu.period.as_secs_f64() - tick).max(0.0);
        let delay = regulator.dead_time.as_secs_f64() + 0.5 * regulator.period.as_secs_f64().max(tick) + seen;
        // Everything over kt, with s in 1/UNIT.
        let plant = vec![
            1.0,
            free.torsional_damping / free.torsional_stiffness / UNIT,
            free.inertia / free.torsional_stiffness / (UNIT * UNIT),
        ];
        let (p, i, d) =
            (gains.proportional * per_rad, gains.integral * per_rad * UNIT, gains.derivative * per_rad / UNIT);
        let integrates = i > 0.0;
        let s = |a: &[f64]| if integrates { product(a, &[0.0, 1.0]) } else { a.to_vec() };
        let pi = if integrates { vec![i, p] } else { vec![p] };
        let ideal = (s(&plant), sum(&pi, &s(&[0.0, d])));
        let filter = if gains.derivative_filter > 0.0 {
            vec![1.0, 1.0 / (TAU * gains.derivative_filter * UNIT)]
        } else {
            vec![1.0]
        };
        let x = delay / UNIT;
        let pade = |x: f64| vec![120.0, 60.0 * x, 12.0 * x * x, x * x * x];
        let lag = [1.0, regulator.lag.as_secs_f64() / UNIT];
        let below = product(&product(&s(&plant), &lag), &product(&filter, &pade(x)));
        let control = sum(&product(&product(&pi, &[1.0, seen / UNIT]), &filter), &s(&[0.0, d]));
        Self { ideal, extended: (below, product(&control, &pade(-x))), delay }
    }

    /// Total delay in the loop, s.
    pub fn delay(&self) -> f64 {
        self.delay
    }

    /// Loop transfer function of the extended loop at `omega`, rad/s; closed with -1.
    pub fn response(&self, omega: f64) -> Complex<f64> {
        let s = Complex::new(0.0, omega * UNIT);
        let value = |p: &[f64]| p.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * s + c);
        value(&self.extended.1) / value(&self.extended.0)
    }

    /// The closed loop's poles with all gains multiplied by `factor` (not negative).
    pub fn poles(&self, factor: f64) -> LocusPoint {
        let closed = |(below, above): &(Vec<f64>, Vec<f64>)| {
            let above: Vec<_> = above.iter().map(|c| c * factor).collect();
            roots(&sum(below, &above)).into_iter().map(|z| z / UNIT).collect()
        };
        LocusPoint { factor, ideal: closed(&self.ideal), extended: closed(&self.extended) }
    }

    /// The locus over `factors`.
    pub fn locus(&self, factors: &[f64]) -> Vec<LocusPoint> {
        factors.iter().map(|&factor| self.poles(factor)).collect()
    }
}

/// Damping ratio of a pole: 1 and more on the negative real axis counts as 1, negative is unstable.
pub fn damping_ratio(pole: Complex<f64>) -> f64 {
    if pole.norm() > 0.0 { -pole.re / pole.norm() } else { 0.0 }
}

fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
    let at = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
    (0..a.len().max(b.len())).map(|i| at(a, i) + at(b, i)).collect()
}

/// Roots of a polynomial, lowest power first: eigenvalues of its companion matrix. Empty if they cannot be computed.
fn roots(polynomial: &[f64]) -> Vec<Complex<f64>> {
    let scale = polynomial.iter().fold(0.0, |a: f64, c| a.max(c.abs()));
    let degree = polynomial.iter().rposition(|c| c.abs() > 1e-14 * scale).unwrap_or(0);
    if degree == 0 || !scale.is_finite() {
        return Vec::new();
    }
    let mut companion = DMatrix::zeros(degree, degree);
    for i in 0..degree {
        companion[(i, degree - 1)] = -polynomial[i] / polynomial[degree];
        if i > 0 {
            companion[(i, i - 1)] = 1.0;
        }
    }
    let schur = Schur::try_new(companion, f64::EPSILON, 100_000);
    schur.map(|s| s.complex_eigenvalues().iter().copied().collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::design::default_gains;
    use super::super::margin::Loop;
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
    fn roots_are_found() {
        let polynomial = product(&product(&[6.0, 5.0, 1.0], &[25.0, 6.0, 1.0]), &[100.0, 1.0]);
        let found = roots(&polynomial);
        for expected in [(-2.0, 0.0), (-3.0, 0.0), (-3.0, 4.0), (-3.0, -4.0), (-100.0, 0.0)] {
            let nearest =
                found.iter().map(|z| (z - Complex::new(expected.0, expected.1)).norm()).fold(f64::MAX, f64::min);
            assert!(nearest < 1e-6, "{expected:?}: {found:?}");
        }
        assert!(roots(&[1.0]).is_empty());
    }

    #[test]
    fn without_gain_the_poles_are_those_of_the_free_and_its_devices() {
        let (regulator, imu) = devices();
        let free = Free::published_code();
        let gains = default_gains(&free, &regulator, &imu, TICK);
        let point = LocusLoop::new(&free, &gains, &regulator, &imu, TICK).poles(0.0);
        let (omega, ratio) = (free.natural_frequencies().1, free.damping_ratios().1);
        for poles in [&point.ideal, &point.extended] {
            let mode = poles.iter().find(|z| z.im > 0.9 * omega && (z.norm() / omega - 1.0).abs() < 0.01);
            // Seven and more poles of very different size in one companion matrix: six digits.
            assert!((damping_ratio(*mode.unwrap()) - ratio).abs() < 1e-5);
        }
        assert!(point.extended.iter().any(|z| (z - Complex::new(-1.0 / 0.06, 0.0)).norm() < 1e-4));
    }

    #[test]
    fn the_extended_loop_is_the_one_that_runs() {
        let (regulator, imu) = devices();
        let free = Free::paper();
        let gains = default_gains(&free, &regulator, &imu, TICK);
        let (locus, exact) =
            (LocusLoop::new(&free, &gains, &regulator, &imu, TICK), Loop::new(&free, &gains, &regulator, &imu, TICK));
        for omega in [0.5, 2.0, 5.0, 10.0, 20.0] {
            let ratio = locus.response(omega) / exact.response(omega);
            // What is left out: the smoothing between readings, which is of second order in the IMU's period.
            assert!((ratio - Complex::new(1.0, 0.0)).norm() < 0.05, "{omega}: {ratio}");
        }
        // The locus crosses the axis where the eigenvalues of the sampled loop leave the unit circle.
        let gain = exact.margin().gain_margin;
        let worst = |factor: f64| locus.poles(factor).extended.iter().map(|z| z.re).fold(f64::MIN, f64::max);
        assert!(
            worst(0.85 * gain) < 0.0 && worst(1.15 * gain) > 0.0,
            "{gain}: {} {}",
            worst(0.85 * gain),
            worst(1.15 * gain)
        );
    }
}

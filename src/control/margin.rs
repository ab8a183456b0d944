//! Stability margin of the very loop that runs: linearised FREE, regulator, IMU, estimator and PID at this tick.
//!
//! **Closed loop, exact.** The FREE at rest (Eq. 7: I phi'' + ct phi' + kt phi = a p, a = 2 pi R^3 |cot G|) behind
//! the regulator's lag and dead time, fed by a command that the device takes over once in its own period; the IMU
//! read once in its period, `delay` late; the estimator of [`super::estimator`] and the PID of [`super::pid`] line
//! by line, without limits. This loop is linear and periodic in the least common multiple of the three periods; it
//! is stable if and only if all eigenvalues of its map over one period (the monodromy matrix) lie inside the unit
//! circle. The gain margin is the factor on all gains at which the first one leaves it.
//!
//! **Frequency response, averaged.** Phase and delay margin need a loop transfer function, which a periodic loop
//! has only on average: sampling by its hold (sinc and half a period of delay), the estimator by its mean over an
//! IMU period. Exact where all periods are the tick's, but for images beyond half the tick rate.
//!
//! Units: pressures are scaled by kt/a (Pa/rad), so that every state is rad, rad/s.

use std::f64::consts::{PI, TAU};
use std::time::Duration;

use nalgebra::{Complex, DMatrix, Matrix4, Vector4, linalg::Schur};

use super::estimator::{HORIZON_MAX, smoothing};
use super::feedforward::actuation;
use super::{FreeControl, Gains, ImuChannel, RegulatorChannel};
use crate::model::Free;

/// Least gain margin to arm with: 6 dB. At 70 deg the actuation has grown by a third and the effective stiffness
/// fallen by as much (the fibre radius grows), which together double the loop gain found at rest.
pub const GAIN_MARGIN_MIN: f64 = 2.0;
/// Least phase margin to arm with, deg: half of what a loop without overshoot has; below it a step overshoots by
/// more than a third and rings.
pub const PHASE_MARGIN_MIN_DEG: f64 = 30.0;
/// Gain margins beyond this are reported as infinite (36 dB).
pub const GAIN_MARGIN_CAP: f64 = 64.0;

/// How far a loop is from instability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Whether the closed loop is stable as it is.
    pub stable: bool,
    /// Factor on all gains at which it becomes unstable; below one, the factor at which it becomes stable (0 if
    /// none does); infinite beyond [`GAIN_MARGIN_CAP`].
    pub gain_margin: f64,
    /// Smallest phase margin over all crossings, deg; infinite without a crossing, at most 0 if unstable.
    pub phase_margin_deg: f64,
    /// Delay that would make it unstable, s; infinite without a crossing, 0 if unstable.
    pub delay_margin_s: f64,
    /// Largest modulus of the closed loop's eigenvalues, per tick.
    pub spectral_radius: f64,
}

impl Margin {
    /// Whether the rig may be armed with it.
    pub fn sufficient(&self) -> bool {
        self.stable && self.gain_margin >= GAIN_MARGIN_MIN && self.phase_margin_deg >= PHASE_MARGIN_MIN_DEG
    }

    /// What is the matter, and the remedy; `None` if it is sufficient.
    pub fn problem(&self) -> Option<String> {
        if self.sufficient() {
            return None;
        }
        let what = if self.stable {
            format!(
                "the loop is stable, but with a gain margin of {:.2} (at least {GAIN_MARGIN_MIN}) and a phase margin of \
                 {:.0} deg (at least {PHASE_MARGIN_MIN_DEG})",
                self.gain_margin, self.phase_margin_deg
            )
        } else {
            format!(
                "the loop is unstable at this tick, delay and lag (spectral radius {:.4} per tick)",
                self.spectral_radius
            )
        };
        let remedy = match self.gain_margin {
            g if g > 0.0 && g < GAIN_MARGIN_MIN => {
                format!("lower all gains to {:.0} % of what they are", 100.0 * g / GAIN_MARGIN_MIN)
            }
            _ => "lower the gains".into(),
        };
        Some(format!(
            "{what}; {remedy}, use freerig's own gains, or shorten the tick; --accept-margin arms regardless of it"
        ))
    }
}

/// The margin of a FREE's loop at a tick of `period`; `None` where its angle is not controlled.
pub fn margin(free: &FreeControl, period: Duration) -> Option<Margin> {
    let imu = free.imu.as_ref().filter(|_| free.controls_angle())?;
    Some(Loop::new(&free.free, &free.gains, &free.regulator, imu, period).margin())
}

/// The linearised loop of one FREE.
#[derive(Clone, Debug)]
pub struct Loop {
    tick: f64,
    /// Natural frequency squared kt/I, 1/s2, and damping ct/I, 1/s.
    stiffness: f64,
    damping: f64,
    lag: f64,
    dead: f64,
    delay: f64,
    smoothing: f64,
    /// Ticks in the IMU's and in the regulator's period.
    imu_ticks: usize,
    regulator_ticks: usize,
    /// Scaled gains: 1, 1/s, s.
    proportional: f64,
    integral: f64,
    derivative: f64,
    /// Share of the derivative filter in one tick.
    share: f64,
    /// State after one tick's two pieces of constant input: [phi, phi', p, input].
    pieces: [Matrix4<f64>; 2],
}

/// Sizes of the fixed part of the state: phi, phi', p, measured angle and rate, estimate, integral, filtered rate,
/// command taken over.
const FIXED: usize = 9;

impl Loop {
    /// The loop of `free` with `gains` behind its devices, at a tick of `period`.
    pub fn new(free: &Free, gains: &Gains, regulator: &RegulatorChannel, imu: &ImuChannel, period: Duration) -> Self {
        let tick = period.as_secs_f64();
        let per_rad = actuation(free) / free.torsional_stiffness;
        let ticks = |d: Duration| ((d.as_secs_f64() / tick).round() as usize).clamp(1, 200);
        let imu_ticks = ticks(imu.period);
        let mut regulator_ticks = ticks(regulator.period);
        if lcm(imu_ticks, regulator_ticks) > 2000 {
            regulator_ticks = regulator_ticks.div_ceil(imu_ticks) * imu_ticks;
        }
        let mut this = Self {
            tick,
            stiffness: free.torsional_stiffness / free.inertia,
            damping: free.torsional_damping / free.inertia,
            lag: regulator.lag.as_secs_f64(),
            dead: regulator.dead_time.as_secs_f64(),
            delay: imu.delay.as_secs_f64(),
            smoothing: smoothing(imu.period.as_secs_f64(), tick),
            imu_ticks,
            regulator_ticks,
            proportional: gains.proportional * per_rad,
            integral: gains.integral * per_rad,
            derivative: gains.derivative * per_rad,
            share: if gains.derivative_filter > 0.0 { -(-TAU * gains.derivative_filter * tick).exp_m1() } else { 1.0 },
            pieces: [Matrix4::identity(); 2],
        };
        let fraction = (this.dead / tick).fract();
        this.pieces = [this.plant(fraction * tick), this.plant((1.0 - fraction) * tick)];
        this
    }

    /// The same loop with all gains multiplied by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            proportional: factor * self.proportional,
            integral: factor * self.integral,
            derivative: factor * self.derivative,
            ..self.clone()
        }
    }

    /// exp(A t) of plant, lag and constant input.
    fn plant(&self, t: f64) -> Matrix4<f64> {
        let mut a = Matrix4::zeros();
        a[(0, 1)] = 1.0;
        a[(1, 0)] = -self.stiffness;
        a[(1, 1)] = -self.damping;
        if self.lag > 0.0 {
            a[(1, 2)] = self.stiffness;
            a[(2, 2)] = -1.0 / self.lag;
            a[(2, 3)] = 1.0 / self.lag;
        } else {
            a[(1, 3)] = self.stiffness;
        }
        (a * t).exp()
    }

    /// Everything there is to say.
    pub fn margin(&self) -> Margin {
        let spectral_radius = self.spectral_radius();
        let stable = spectral_radius < 1.0;
        let frequency = self.frequency_margins();
        Margin {
            stable,
            gain_margin: self.gain_margin(stable),
            phase_margin_deg: if stable { frequency.phase.to_degrees() } else { frequency.phase.to_degrees().min(0.0) },
            delay_margin_s: if stable { frequency.delay } else { 0.0 },
            spectral_radius,
        }
    }

    fn is_stable_at(&self, factor: f64) -> bool {
        self.scaled(factor).spectral_radius() < 1.0
    }

    fn gain_margin(&self, stable: bool) -> f64 {
        let step: f64 = if stable { 1.25 } else { 0.8 };
        let (mut here, mut there) = (1.0, step);
        while self.is_stable_at(there) == stable {
            here = there;
            there *= step;
            if there > GAIN_MARGIN_CAP {
                return f64::INFINITY;
            }
            if there < 1.0 / GAIN_MARGIN_CAP {
                return 0.0;
            }
        }
        for _ in 0..10 {
            let middle = (here * there).sqrt();
            if self.is_stable_at(middle) == stable { here = middle } else { there = middle }
        }
        if stable { here } else { there }
    }

    /// Largest modulus of the closed loop's eigenvalues, per tick; infinite if it cannot be computed.
    pub fn spectral_radius(&self) -> f64 {
        let ticks = lcm(self.imu_ticks, self.regulator_ticks);
        let monodromy = self.monodromy(ticks);
        if monodromy.iter().any(|x| !x.is_finite()) {
            return f64::INFINITY;
        }
        match Schur::try_new(monodromy, f64::EPSILON, 100_000) {
            Some(schur) => {
                schur.complex_eigenvalues().iter().map(|z| z.norm()).fold(0.0, f64::max).powf(1.0 / ticks as f64)
            }
            None => f64::INFINITY,
        }
    }

    fn monodromy(&self, ticks: usize) -> DMatrix<f64> {
        let commands = (self.dead / self.tick) as usize + 2;
        let history = (self.delay / self.tick) as usize + 2;
        let size = FIXED + commands + 2 * history;
        let mut map = DMatrix::identity(size, size);
        for mut column in map.column_iter_mut() {
            for k in 0..ticks {
                self.step(column.as_mut_slice(), k, commands, history);
            }
        }
        map
    }

    /// One tick, number `k`, of the homogeneous loop. The newest entries of the delay lines come first.
    fn step(&self, x: &mut [f64], k: usize, commands: usize, history: usize) {
        let (fixed, lines) = x.split_at_mut(FIXED);
        let (line, lines) = lines.split_at_mut(commands);
        let (angles, rates) = lines.split_at_mut(history);
        let [phi, dphi, p, measured, measured_rate, estimate, integral, filtered, taken] = fixed else { return };
        push(angles, *phi);
        push(rates, *dphi);
        if k.is_multiple_of(self.imu_ticks) {
            *measured = delayed(angles, self.delay / self.tick);
            *measured_rate = delayed(rates, self.delay / self.tick);
        }
        let age = (k % self.imu_ticks) as f64 * self.tick;
        let predicted = *measured + *measured_rate * (age + self.delay).min(HORIZON_MAX);
        *estimate = predicted + self.keep() * (*estimate + *measured_rate * self.tick - predicted);
        *filtered += self.share * (-*measured_rate - *filtered);
        // Without integral gain the integral is no state (it would be a spurious eigenvalue of one).
        *integral = if self.integral > 0.0 { *integral - self.integral * *estimate * self.tick } else { 0.0 };
        let command = -self.proportional * *estimate + *integral + self.derivative * *filtered;
        if k.is_multiple_of(self.regulator_ticks) {
            *taken = command;
        }
        push(line, *taken);
        let mut state = Vector4::new(*phi, *dphi, *p, line[commands - 1]);
        state = self.pieces[0] * state;
        state[3] = line[commands - 2];
        state = self.pieces[1] * state;
        (*phi, *dphi) = (state[0], state[1]);
        *p = if self.lag > 0.0 { state[2] } else { 0.0 };
    }

    /// What the estimator keeps of a discrepancy from one tick to the next.
    fn keep(&self) -> f64 {
        if self.smoothing > 0.0 { (-self.tick / self.smoothing).exp() } else { 0.0 }
    }

    /// Loop transfer function (averaged, see the module) at `omega`, rad/s; the loop is closed with -1.
    pub fn response(&self, omega: f64) -> Complex<f64> {
        let i = Complex::new(0.0, 1.0);
        let s = i * omega;
        let one = Complex::new(1.0, 0.0);
        let z = (-s * self.tick).exp(); // one tick back
        let plant = one * self.stiffness / (s * s + s * self.damping + self.stiffness) / (one + s * self.lag);
        let held = self.regulator_ticks as f64 * self.tick;
        let hold = (one - (-s * held).exp()) / (s * held);
        let (mut predicted, mut rate) = (Complex::new(0.0, 0.0), Complex::new(0.0, 0.0));
        for k in 0..self.imu_ticks {
            let back = k as f64 * self.tick + self.delay;
            predicted += (-s * back).exp() * (one + s * back.min(HORIZON_MAX));
            rate += (-s * back).exp() * s;
        }
        let mean = 1.0 / self.imu_ticks as f64;
        let (predicted, rate) = (predicted * mean, rate * mean);
        let keep = self.keep();
        let angle = (predicted * (1.0 - keep) + rate * (keep * self.tick)) / (one - z * keep);
        let filter = one * self.share / (one - z * (1.0 - self.share));
        let control = angle * self.proportional
            + angle * (self.integral * self.tick) / (one - z)
            + rate * filter * self.derivative;
        plant * (-s * self.dead).exp() * hold * control
    }

    /// Margins from the frequency response, for a loop that is stable.
    pub fn frequency_margins(&self) -> FrequencyMargins {
        const POINTS: usize = 1500;
        let (lowest, highest) = (1e-2f64, PI / self.tick);
        let at = |k: usize| lowest * (highest / lowest).powf(k as f64 / (POINTS - 1) as f64);
        let mut found = FrequencyMargins { gain: f64::INFINITY, phase: f64::INFINITY, delay: f64::INFINITY };
        let mut last = (at(0), self.response(at(0)));
        for k in 1..POINTS {
            let here = (at(k), self.response(at(k)));
            if (last.1.norm() - 1.0) * (here.1.norm() - 1.0) <= 0.0 {
                let omega = self.bisect(last.0, here.0, |l| l.norm() - 1.0);
                let lead = self.response(omega).arg() + PI;
                let phase = if lead > PI { lead - TAU } else { lead };
                found.phase = if phase.abs() < found.phase.abs() { phase } else { found.phase };
                found.delay = found.delay.min(lead.rem_euclid(TAU) / omega);
            }
            if last.1.im * here.1.im <= 0.0 && here.1.re < 0.0 && last.1.re < 0.0 {
                let omega = self.bisect(last.0, here.0, |l| l.im);
                let gain = 1.0 / self.response(omega).norm();
                if gain >= 1.0 {
                    found.gain = found.gain.min(gain);
                }
            }
            last = here;
        }
        found
    }

    fn bisect(&self, mut low: f64, mut high: f64, f: impl Fn(Complex<f64>) -> f64) -> f64 {
        let sign = f(self.response(low)) > 0.0;
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if (f(self.response(middle)) > 0.0) == sign { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// Margins from the frequency response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrequencyMargins {
    /// Factor at the nearest crossing of the negative real axis.
    pub gain: f64,
    /// Smallest distance from -180 deg where the modulus is one, rad.
    pub phase: f64,
    /// Least delay that turns such a crossing to -180 deg, s.
    pub delay: f64,
}

fn push(line: &mut [f64], newest: f64) {
    line.rotate_right(1);
    line[0] = newest;
}

/// The line's value `ticks` back, linear between its entries.
fn delayed(line: &[f64], ticks: f64) -> f64 {
    let (whole, fraction) = (ticks as usize, ticks.fract());
    let at = |k: usize| line.get(k).copied().unwrap_or(0.0);
    (1.0 - fraction) * at(whole) + fraction * at(whole + 1)
}

fn lcm(a: usize, b: usize) -> usize {
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    a / x * b
}

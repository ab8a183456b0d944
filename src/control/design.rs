//! freerig's own gains, by design rather than by trial.
//!
//! At rest a FREE behind its regulator is a gain a/kt with up to two slow poles: the FREE's own where it is
//! overdamped (ct/kt = 58 ms for the paper's) and the regulator's lag, then dead time, sampling and the IMU's delay.
//! The PID's two zeros are put on the slow poles,
//!
//! ```text
//! Ki (1 + t1 s)(1 + t2 s) / s:      Kp = Ki (t1 + t2),   Kd = Ki t1 t2
//! ```
//!
//! so that the loop is an integrator with delay, which has a single number left: Ki is the largest with a gain margin
//! of [`GAIN_MARGIN`] and a phase margin of [`PHASE_MARGIN_DEG`] in the loop as it runs ([`super::margin`]), and below
//! which every smaller one has them, too. An underdamped FREE has one slow pole only, the lag; its resonance then
//! bounds Ki through the gain margin, by the closed loop's eigenvalues, and there is no derivative term.

use std::time::Duration;

use super::margin::Loop;
use super::{Gains, ImuChannel, RegulatorChannel};
use crate::model::Free;

/// Gain margin of the design: the loop gain doubles up to 70 deg, and half as much again is left for a FREE that is
/// not the nominal one.
pub const GAIN_MARGIN: f64 = 3.0;
/// Phase margin of the design, deg: a step response without overshoot.
pub const PHASE_MARGIN_DEG: f64 = 60.0;
/// Corner of the derivative filter, Hz: the IMU's fusion can be trusted up to 15 to 20 Hz.
pub const DERIVATIVE_FILTER: f64 = 20.0;

/// Gains for `free` behind `regulator` and `imu` at a tick of `period`.
pub fn default_gains(free: &Free, regulator: &RegulatorChannel, imu: &ImuChannel, period: Duration) -> Gains {
    let shape = |integral: f64| shape(free, regulator, integral);
    let good = |gains: &Gains| {
        let this = Loop::new(free, gains, regulator, imu, period);
        let margins = this.frequency_margins();
        margins.gain >= GAIN_MARGIN && margins.phase >= PHASE_MARGIN_DEG.to_radians()
    };
    // From a crossover at 0.05 rad/s upwards, in steps of 3 %, to the first that is not good enough.
    let per_rad = free.torsional_stiffness / super::feedforward::actuation(free);
    let mut best = shape(0.05 * per_rad);
    for _ in 0..400 {
        let next = shape(1.03 * best.integral);
        if !good(&next) || next.problem().is_some() {
            break;
        }
        best = next;
    }
    // The frequency response is an average; a mode near the IMU's rate is folded by its sampling. The eigenvalues
    // know, and the gain margin is a factor on all gains.
    let exact = Loop::new(free, &best, regulator, imu, period).margin();
    if exact.gain_margin < GAIN_MARGIN { shape(best.integral * exact.gain_margin / GAIN_MARGIN) } else { best }
}

/// Gains with both zeros on the slow poles, by the integral one (Pa/(rad s)).
pub fn shape(free: &Free, regulator: &RegulatorChannel, integral: f64) -> Gains {
    let lag = regulator.lag.as_secs_f64();
    let pole = slow_pole(free).unwrap_or(0.0);
    Gains {
        proportional: integral * (lag + pole),
        integral,
        derivative: integral * lag * pole,
        derivative_filter: DERIVATIVE_FILTER,
    }
}

/// Time constant of an overdamped FREE's slow pole, s; `None` if it rings.
pub fn slow_pole(free: &Free) -> Option<f64> {
    let Free { inertia: i, torsional_damping: c, torsional_stiffness: k, .. } = *free;
    let discriminant = c * c - 4.0 * i * k;
    (discriminant >= 0.0).then(|| (c + discriminant.sqrt()) / (2.0 * k))
}

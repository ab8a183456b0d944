//! What the model makes of a recorded pressure.

use thiserror::Error;

use super::{
    Feedback, Free, FreeError, Hysteresis, HysteresisState, IntegrationError, Kinematics, Law, Load, Lumped,
    LumpedState,
};

/// Why there is no response.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ResponseError {
    /// Impossible parameters.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// The histories do not fit together.
    #[error("{times} times but {pressures} pressures")]
    Lengths {
        /// Number of times.
        times: usize,
        /// Number of pressures.
        pressures: usize,
    },
    /// Times must increase, and all numbers be finite.
    #[error("sample {0} is not finite, or not later than the one before it")]
    Sample(usize),
    /// The model left its domain on the way.
    #[error("at {time:.4} s: {error}")]
    Integration {
        /// Time of the sample that was not reached, s.
        time: f64,
        /// Why.
        error: IntegrationError,
    },
}

/// Longest step of the integration, s, of a history that this does not make too long.
const LONGEST_STEP: f64 = 2e-3;
/// Fewest steps that a history may be cut into before they become longer than that: a second or two of work.
const MANY_STEPS: f64 = 1e6;

/// Open-loop response of the nonlinear model to a pressure history: (s, phi), m and rad, at each of `times` (s),
/// with `pressures` (Pa) linear between them. Starts at rest, s = phi = 0, with the `hysteresis` as a full cycle has
/// left it. Its corners fall into steps of at most 2 ms: what a step overlooks, the next one makes good.
///
/// A history of more than a million such steps is cut into as many longer ones; the method damps what is then faster
/// than a step.
pub fn response(
    free: &Free,
    hysteresis: &Hysteresis,
    kinematics: Kinematics,
    times: &[f64],
    pressures: &[f64],
) -> Result<Vec<(f64, f64)>, ResponseError> {
    let law = Law::Nonlinear(kinematics);
    let model = Lumped::new(*free, law)?;
    if times.len() != pressures.len() {
        return Err(ResponseError::Lengths { times: times.len(), pressures: pressures.len() });
    }
    let good = |i: usize| times[i].is_finite() && pressures[i].is_finite() && (i == 0 || times[i] > times[i - 1]);
    if let Some(bad) = (0..times.len()).find(|&i| !good(i)) {
        return Err(ResponseError::Sample(bad));
    }
    let whole = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    let step = model.suggested_step(0.0).min(LONGEST_STEP).max(whole / MANY_STEPS);
    let own = free.direction();
    let mut memory = HysteresisState::rested(hysteresis);
    let mut state = LumpedState::default();
    let mut motion = Vec::with_capacity(times.len());
    motion.extend(times.first().map(|_| (state.extension, state.rotation)));
    for (t, p) in times.windows(2).zip(pressures.windows(2)) {
        let span = t[1] - t[0];
        let pieces = (span / step).ceil().max(1.0);
        let h = span / pieces;
        let mut from = 0.0;
        while from < pieces {
            let pressure = |tau: f64| p[0] + (p[1] - p[0]) * ((from * h + tau) / span);
            // The elements that stick are springs beside the FREE's own until they slip.
            let angle = own * state.rotation;
            let sticking = hysteresis.tangent(&memory, angle);
            let held = hysteresis.moment_from_rest(&memory, angle) - sticking * angle;
            let stiffer = Free { torsional_stiffness: free.torsional_stiffness + sticking, ..*free };
            let load = Load { moment: -own * held, ..Load::default() };
            Lumped::new(stiffer, law)?
                .advance(&mut state, &mut 0.0, &Feedback::open(), load, pressure, h)
                .map_err(|error| ResponseError::Integration { time: t[1], error })?;
            hysteresis.advance(&mut memory, own * state.rotation);
            from += 1.0;
        }
        motion.push((state.extension, state.rotation));
    }
    Ok(motion)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_ramp_is_followed_statically() {
        let free = Free::paper();
        let times: Vec<f64> = (0..=400).map(|i| 0.05 * f64::from(i)).collect();
        let pressures: Vec<f64> = times.iter().map(|t| 1500.0 * t).collect();
        let motion = response(&free, &Hysteresis::NONE, Kinematics::Exact, &times, &pressures).unwrap();
        assert_eq!((motion.len(), motion[0]), (401, (0.0, 0.0)));
        let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
        for (i, &(s, phi)) in motion.iter().enumerate().skip(40) {
            // A ramp lags by ct/kt = 58 ms, a little more where the stiffness has fallen.
            let at = model.equilibrium_at_pressure(pressures[i] - 1500.0 * 0.058, Load::default()).unwrap();
            assert!((phi - at.rotation).abs() < 0.02 * at.rotation, "{i} {phi} {at:?}");
            assert!((s - at.extension).abs() < 1e-5);
        }
    }

    #[test]
    fn a_slow_cycle_with_hysteresis_is_followed_statically_and_comes_back_to_zero() {
        for gamma in [-40f64, 40.0] {
            let free = Free { gamma: gamma.to_radians(), ..Free::paper() };
            let weights = [0.02, 0.01, 0.012, 0.0, 0.008, 0.004, 0.0, 0.002];
            let hysteresis = Hysteresis::new(Hysteresis::grid(0.01, 0.3), weights).unwrap();
            let times: Vec<f64> = (0..=1000).map(|i| 0.1 * f64::from(i)).collect();
            let pressures: Vec<f64> = times.iter().map(|t| 600.0 * (50.0 - (t - 50.0).abs())).collect();
            let motion = response(&free, &hysteresis, Kinematics::Exact, &times, &pressures).unwrap();
            let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
            let mut memory = HysteresisState::rested(&hysteresis);
            let own = free.direction();
            for (&(_, phi), &pressure) in motion.iter().zip(&pressures) {
                hysteresis.advance(&mut memory, own * phi);
                let moment = -own * hysteresis.moment_from_rest(&memory, own * phi);
                let at = model.equilibrium_at_rotation(phi, Load { moment, ..Load::default() }).unwrap();
                // 600 Pa/s times the relaxation of 58 ms, with the elements' stiffness on top.
                assert!((at.pressure - pressure).abs() < 60.0, "{phi} {pressure} {at:?}");
            }
            // That relaxation at rest: 600 Pa/s * 58 ms * a / kt = 1.04e-3 rad.
            assert!(motion.last().unwrap().1.abs() < 1.2e-3, "{:?}", motion.last());
        }
    }

    #[test]
    fn sampling_the_same_history_more_finely_changes_nothing() {
        let free = Free::published_code();
        let run = |n: usize| {
            let times: Vec<f64> = (0..=n).map(|i| 0.1 * i as f64 / n as f64).collect();
            let pressures: Vec<f64> = times.iter().map(|t| 2e5 * t).collect();
            response(&free, &Hysteresis::NONE, Kinematics::Exact, &times, &pressures).unwrap()
        };
        let (coarse, fine) = (run(10), run(200));
        for (i, c) in coarse.iter().enumerate() {
            assert!((c.1 - fine[20 * i].1).abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_no_history_is_refused() {
        let of = |t: &[f64], p: &[f64]| response(&Free::paper(), &Hysteresis::NONE, Kinematics::Exact, t, p);
        assert_eq!(of(&[], &[]).unwrap(), []);
        assert_eq!(of(&[0.0, 1.0], &[0.0]).unwrap_err(), ResponseError::Lengths { times: 2, pressures: 1 });
        assert_eq!(of(&[0.0, 1.0, 1.0], &[0.0; 3]).unwrap_err(), ResponseError::Sample(2));
        assert_eq!(of(&[0.0, 1.0], &[0.0, f64::NAN]).unwrap_err(), ResponseError::Sample(1));
        let steep = response(
            &Free { gamma: -std::f64::consts::FRAC_PI_6, ..Free::paper() },
            &Hysteresis::NONE,
            Kinematics::Exact,
            &[0.0, 9.0],
            &[4.2e4; 2],
        );
        let error = steep.unwrap_err().to_string();
        assert!(error.contains("fibres unwound"), "{error}");
    }
}

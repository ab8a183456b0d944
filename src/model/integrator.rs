//! Integration in fixed steps, with the pressure given or under feedback.
//!
//! Every step is one Radau IIA step ([`super::radau`]). Three things do not fit a fixed step: a corner (the
//! command reaches a limit, or leaves it, where the right-hand side is not smooth), an iteration that does not
//! converge, and the edge of the kinematics' domain. There the step is halved, at most [`DEPTH`] times, and
//! doubled again behind it: a corner is enclosed in a piece too short for its kink to matter, at a bounded cost.
//! The step size never depends on anything else, so it cannot collapse. Nothing allocates.

use thiserror::Error;

use super::radau::{self, C, Failure};
use super::{DomainError, Law, Load, Lumped, LumpedState};

/// Most halvings of a step: 2^-14 of a quarter of a millisecond is 15 ns.
const DEPTH: u32 = 14;

/// Where the pressure comes from: P = clip(forward x(t) - Kp phi - Kd phi' + Ki int (x - phi) dt, low, high).
///
/// Closed loop, x is the reference angle and `forward` is Kp (Eq. 5); [`Feedback::open`] takes x as the pressure.
/// Gains are signed, in the coordinates' direction; see [`super::Free::direction`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedback {
    /// Gain of the signal x itself.
    pub forward: f64,
    /// Kp, Pa/rad.
    pub proportional: f64,
    /// Ki, Pa/(rad s). The integral is not clamped.
    pub integral: f64,
    /// Kd on the measured rate, Pa s/rad.
    pub derivative: f64,
    /// Lowest pressure, Pa.
    pub low: f64,
    /// Highest pressure, Pa.
    pub high: f64,
}

impl Feedback {
    /// No feedback: the signal is the pressure in Pa, and is not limited.
    pub const fn open() -> Self {
        Self {
            forward: 1.0,
            proportional: 0.0,
            integral: 0.0,
            derivative: 0.0,
            low: f64::NEG_INFINITY,
            high: f64::INFINITY,
        }
    }

    /// A PID loop on the rotation with gains in the coordinates' direction, limited to `low..=high` Pa.
    pub const fn pid(kp: f64, ki: f64, kd: f64, low: f64, high: f64) -> Self {
        Self { forward: kp, proportional: kp, integral: ki, derivative: kd, low, high }
    }

    /// The command before its limits, Pa.
    pub fn command(&self, signal: f64, state: &LumpedState, integral: f64) -> f64 {
        self.forward * signal - self.proportional * state.rotation - self.derivative * state.rotation_rate
            + self.integral * integral
    }

    /// The command within its limits, Pa.
    pub fn limited(&self, command: f64) -> f64 {
        command.max(self.low).min(self.high)
    }

    /// Whether a command that ranges over `span` passes a limit by more than the rounding of a pressure.
    fn has_corner(&self, span: (f64, f64)) -> bool {
        let across = |limit: f64| limit.is_finite() && span.0 < limit - 1e-3 && span.1 > limit + 1e-3;
        across(self.low) || across(self.high)
    }
}

/// What an integration took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Steps accepted.
    pub steps: u64,
    /// Steps thrown away because of a corner, a divergence or the domain's edge.
    pub rejected: u64,
    /// Newton iterations (6x6 systems solved) of the accepted steps.
    pub iterations: u64,
}

impl std::ops::AddAssign for Effort {
    fn add_assign(&mut self, other: Self) {
        self.steps += other.steps;
        self.rejected += other.rejected;
        self.iterations += other.iterations;
    }
}

/// Why the motion could not be followed to the end of a step.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum IntegrationError {
    /// The motion has left the domain of the kinematics.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The equations of even the shortest step could not be solved.
    #[error("the equations of a step of {step} s could not be solved; the gains are too high for double precision")]
    Divergence {
        /// The shortest step tried, s.
        step: f64,
    },
}

impl Lumped {
    /// Advances `state` by `dt` seconds at a constant pressure (Pa), under an extra axial force (N) and moment
    /// (N m) on the end. One step, halved only where it must be; 0.25 ms is fine for either preset FREE.
    ///
    /// On an error the state is the last one inside the domain.
    pub fn step(
        &self,
        state: &mut LumpedState,
        pressure: f64,
        extra_force: f64,
        extra_moment: f64,
        dt: f64,
    ) -> Result<Effort, IntegrationError> {
        let load = Load { force: extra_force, moment: extra_moment };
        self.advance(state, &mut 0.0, &Feedback::open(), load, |_| pressure, dt)
    }

    /// Advances `state` and `integral` (of signal - rotation, rad s) by `h` seconds under `feedback`.
    ///
    /// `signal` is given the time since the start of this step, 0..=h; it must be smooth there: a jump belongs
    /// between two steps. On an error state and integral are the last ones inside the domain.
    pub fn advance(
        &self,
        state: &mut LumpedState,
        integral: &mut f64,
        feedback: &Feedback,
        load: Load,
        signal: impl Fn(f64) -> f64,
        h: f64,
    ) -> Result<Effort, IntegrationError> {
        const WHOLE: u32 = 1 << DEPTH;
        let unit = h / f64::from(WHOLE);
        let mut effort = Effort::default();
        let (mut done, mut size) = (0, WHOLE);
        while done < WHOLE {
            let (t, piece) = (unit * f64::from(done), unit * f64::from(size));
            let x = [signal(t), signal(t + C[0] * piece), signal(t + C[1] * piece), signal(t + piece)];
            let outcome = radau::step(self, feedback, load, (state, *integral), x, piece);
            let shortest = size == 1;
            match outcome {
                Ok(step) if shortest || !feedback.has_corner(step.command) => {
                    (*state, *integral) = (step.state, step.integral);
                    effort.steps += 1;
                    effort.iterations += u64::from(step.iterations);
                    done += size;
                    // Pieces begin at multiples of their own size, so that they always meet the step's end.
                    while size < WHOLE && done % (2 * size) == 0 {
                        size *= 2;
                    }
                }
                Err(Failure::Domain(error)) if shortest => return Err(error.into()),
                Err(Failure::Divergence) if shortest => return Err(IntegrationError::Divergence { step: piece }),
                Ok(_) | Err(_) => {
                    effort.rejected += 1;
                    size /= 2;
                }
            }
        }
        Ok(effort)
    }

    /// A step that keeps the error of either preset FREE, alone or in a loop of proportional gain `kp` (Pa/rad),
    /// below 1e-6 rad over seconds: a fifth of a radian of the fastest undamped mode, s. Faster dampers do not
    /// shorten it, the method is L-stable.
    pub fn suggested_step(&self, kp: f64) -> f64 {
        let (axial, _) = self.free().natural_frequencies();
        let stiffness = self.free().torsional_stiffness + self.linearised().moment * kp.max(0.0);
        0.2 / axial.max((stiffness / self.free().inertia).sqrt())
    }

    /// Whether radius and winding angle are those at rest.
    pub fn is_linear(&self) -> bool {
        self.law() == Law::Linear
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Free, Kinematics};
    use super::*;

    fn nonlinear(free: Free) -> Lumped {
        Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap()
    }

    /// Open loop at 5 psi over 20 ms, in `n` steps.
    fn open_loop(model: &Lumped, n: u32) -> LumpedState {
        let mut state = LumpedState::default();
        for _ in 0..n {
            let effort = model.step(&mut state, 34473.8, 0.0, 0.0, 0.02 / f64::from(n)).unwrap();
            assert_eq!((effort.steps, effort.rejected), (1, 0), "smooth: no step is halved");
        }
        state
    }

    #[test]
    fn the_integrator_is_of_order_five() {
        let model = nonlinear(Free::published_code());
        let exact = open_loop(&model, 5120);
        let error = |n| {
            let state = open_loop(&model, n);
            (state.rotation - exact.rotation).hypot((state.extension - exact.extension) * 1e3)
        };
        // 20 ms hold two and a half axial periods. From 40 to 160 steps the error falls from 1e-6 to 1e-9, far
        // above the rounding.
        for n in [40, 80] {
            let order = (error(n) / error(2 * n)).log2();
            assert!((order - 5.0).abs() < 0.3, "order {order} at {n} steps, error {}", error(n));
        }
    }

    #[test]
    fn undamped_and_unpressurised_it_is_the_harmonic_oscillator() {
        let free = Free { axial_damping: 0.0, torsional_damping: 0.0, ..Free::published_code() };
        let model = Lumped::new(free, Law::Linear).unwrap();
        let (axial, torsional) = free.natural_frequencies();
        let mut state = LumpedState { rotation: 0.3, ..LumpedState::default() };
        for _ in 0..400 {
            model.step(&mut state, 0.0, 0.0, 0.0, 5e-5).unwrap();
        }
        let (t, sag) = (0.02, free.mass * super::super::GRAVITY / free.axial_stiffness);
        // Phase error per radian (omega h)^5/7200, 1e-11 here, over 15 rad.
        assert!((state.rotation - 0.3 * (torsional * t).cos()).abs() < 1e-10);
        assert!((state.extension - sag * (1.0 - (axial * t).cos())).abs() < 1e-12);
    }

    #[test]
    fn an_extra_load_is_carried_by_the_springs() {
        let free = Free::paper();
        let model = Lumped::new(free, Law::Linear).unwrap();
        let mut state = LumpedState::default();
        for _ in 0..4000 {
            model.step(&mut state, 0.0, 1.0, -0.0043, 5e-4).unwrap();
        }
        assert!((state.rotation - -0.05).abs() < 1e-12);
        assert!((state.extension - (1.0 + 0.028 * 9.81) / 10110.0).abs() < 1e-12);
    }

    /// The loop with the paper's printed PD gains follows `amplitude` (1 - cos) for 0.2 s.
    fn printed_pd(free: Free, amplitude: f64, h: f64) -> (LumpedState, Effort) {
        let model = nonlinear(free);
        let feedback = Feedback::pid(32000.0, 0.0, 1.2e6, 0.0, 68947.57);
        let (mut state, mut integral, mut effort) = (LumpedState::default(), 0.0, Effort::default());
        let n = (0.2 / h).round() as u32;
        for i in 0..n {
            let t0 = f64::from(i) * h;
            let reference = |t: f64| amplitude * (1.0 - (10.0 * std::f64::consts::PI * (t0 + t)).cos());
            effort += model.advance(&mut state, &mut integral, &feedback, Load::default(), reference, h).unwrap();
        }
        (state, effort)
    }

    #[test]
    fn a_loop_of_two_million_per_second_does_not_shorten_the_step() {
        for (free, amplitude) in [(Free::paper(), 0.6), (Free::paper(), 3.0), (Free::published_code(), 3.0)] {
            let (coarse, effort) = printed_pd(free, amplitude, 2.5e-4);
            // A corner costs at most two pieces and one rejection a halving; there are a handful in 0.2 s.
            assert!(effort.steps < 800 + 20 * 2 * u64::from(DEPTH), "{effort:?}");
            let (fine, _) = printed_pd(free, amplitude, 1.5625e-5);
            assert!((coarse.rotation - fine.rotation).abs() < 1e-7, "{coarse:?} {fine:?}");
        }
    }

    #[test]
    fn saturation_corners_do_not_spoil_the_order_of_magnitude() {
        // A step of 80 deg with gains that drive the command into both limits.
        let model = nonlinear(Free::published_code());
        let feedback = Feedback::pid(60000.0, 603291.5, 0.0, 0.0, 68947.57);
        let run = |h: f64| {
            let (mut state, mut integral, mut effort) = (LumpedState::default(), 0.0, Effort::default());
            for _ in 0..(0.05 / h).round() as u32 {
                effort += model.advance(&mut state, &mut integral, &feedback, Load::default(), |_| 1.4, h).unwrap();
            }
            (state, effort)
        };
        let ((coarse, effort), (fine, _)) = (run(2.5e-4), run(1.25e-5));
        assert!(effort.rejected > 0, "the case has corners");
        assert!((coarse.rotation - fine.rotation).abs() < 1e-6, "{coarse:?} {fine:?}");
    }

    #[test]
    fn a_run_away_ends_with_the_limits_name_and_a_state_inside_the_domain() {
        let model = nonlinear(Free { gamma: -30f64.to_radians(), ..Free::paper() });
        let mut state = LumpedState::default();
        let error = (0..40_000).find_map(|_| model.step(&mut state, 6.0 * 6894.757, 0.0, 0.0, 2.5e-4).err()).unwrap();
        assert!(matches!(error, IntegrationError::Domain(DomainError::Unwound { .. })), "{error}");
        assert!(model.actuation(state.extension, state.rotation).is_ok());
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        let model = Lumped::new(Free::paper(), Law::Linear).unwrap();
        let mut state = LumpedState { rotation: f64::NAN, ..LumpedState::default() };
        let error = model.step(&mut state, 0.0, 0.0, 0.0, 1e-4).unwrap_err();
        assert!(matches!(error, IntegrationError::Domain(DomainError::NotFinite { .. })));
        let mut state = LumpedState::default();
        assert!(model.step(&mut state, f64::NAN, 0.0, 0.0, 1e-4).is_err());
    }
}

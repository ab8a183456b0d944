//! The lumped model of one FREE in a loop with its controller: no regulator, no sensor, no bench. What
//! `freerig simulate` runs.
//!
//! With [`Controller::Continuous`] the PID of Eq. 5 is part of the differential equations, its pressure clipped and
//! its integral not clamped: the case that the reference solutions hold. With [`Controller::Sampled`] the tick's own
//! [`Pid`] runs at its rate on an ideal sensor, its command held until the next.

use std::collections::VecDeque;

use thiserror::Error;

use crate::control::pid::{Band, Pid};
use crate::control::{DerivativeOn, Gains};
use crate::model::{Effort, Feedback, Free, FreeError, IntegrationError, Law, Load, Lumped, LumpedState};
use crate::signal::{Estimate, Quantity, Reference};
use crate::trajectory::{Axis, Segment};

/// How the controller sees time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Controller {
    /// All the time.
    Continuous,
    /// Once a tick.
    Sampled {
        /// Period of the tick, s.
        period: f64,
        /// Ticks from a sample to its command taking effect; 0 is in the same tick.
        delay: u32,
    },
}

/// One run of the closed (or open) lumped loop.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosedLoop {
    /// The FREE; it starts at rest with s = phi = 0.
    pub free: Free,
    /// How the pressure acts on it.
    pub law: Law,
    /// What is asked of it: an angle, closed loop, or a pressure, open loop.
    pub axis: Axis,
    /// Gains; of no meaning to a pressure axis.
    pub gains: Gains,
    /// How the controller sees time.
    pub controller: Controller,
    /// Highest pressure of the controller, Pa; the lowest is 0.
    pub pressure_max: f64,
    /// Total time, s.
    pub duration: f64,
}

/// State of the loop at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// s.
    pub time: f64,
    /// Motion of the end.
    pub state: LumpedState,
    /// Pa; where the reference jumps, already with the new one.
    pub pressure: f64,
    /// Reference angle, rad; not a number for a pressure axis.
    pub reference: f64,
}

/// Why a run ended before its time.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ClosedLoopError {
    /// Impossible parameters.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// Impossible settings.
    #[error("{what} is {value} s; it must be finite and positive")]
    Time {
        /// Which time.
        what: &'static str,
        /// Its value, s.
        value: f64,
    },
    /// The model has left its domain; the samples before it have been seen.
    #[error("at {time:.4} s: {error}")]
    Ended {
        /// When, s.
        time: f64,
        /// Why.
        error: IntegrationError,
    },
}

/// Times that differ by less count as the same, s.
const SAME: f64 = 1e-9;

impl ClosedLoop {
    /// Runs the loop and shows every step that was computed to `see`: at least each multiple of `every` seconds.
    pub fn run(&self, every: f64, mut see: impl FnMut(&Sample)) -> Result<Effort, ClosedLoopError> {
        let model = Lumped::new(self.free, self.law)?;
        self.check(every)?;
        let mut actor = Actor::new(self);
        let step = model.suggested_step(actor.feedback.proportional.abs());
        let (mut state, mut integral, mut effort, mut time) = (LumpedState::default(), 0.0, Effort::default(), 0.0);
        loop {
            actor.meet(time, &state);
            see(&actor.sample(time, state, integral));
            if time >= self.duration - SAME {
                return Ok(effort);
            }
            let stop = self.next_stop(time, every, &actor);
            let pieces = ((stop - time) / step - 1e-6).ceil().max(1.0);
            let h = (stop - time) / pieces;
            let start = time;
            for piece in 1..=pieces as u64 {
                effort += actor
                    .advance(&model, &mut state, &mut integral, time, h)
                    .map_err(|error| ClosedLoopError::Ended { time, error })?;
                if piece as f64 == pieces {
                    time = stop;
                } else {
                    time = start + piece as f64 * h;
                    see(&actor.sample(time, state, integral));
                }
            }
        }
    }

    /// Runs the loop; the samples at multiples of `every` seconds, and how the run ended.
    pub fn samples(&self, every: f64) -> (Vec<Sample>, Result<Effort, ClosedLoopError>) {
        let mut samples = Vec::new();
        let outcome = self.run(every, |sample| {
            let next = samples.len() as f64 * every;
            if sample.time >= next - SAME {
                samples.push(*sample);
            }
        });
        (samples, outcome)
    }

    fn check(&self, every: f64) -> Result<(), ClosedLoopError> {
        let period = match self.controller {
            Controller::Sampled { period, .. } => period,
            Controller::Continuous => 1.0,
        };
        for (what, value) in [("the duration", self.duration), ("the output interval", every), ("the tick", period)] {
            if !(value.is_finite() && value > SAME) {
                return Err(ClosedLoopError::Time { what, value });
            }
        }
        Ok(())
    }

    /// The next output, tick, boundary of the axis or end after `time`, whichever comes first.
    fn next_stop(&self, time: f64, every: f64, actor: &Actor) -> f64 {
        let multiple = |period: f64| ((time + SAME) / period).floor().mul_add(period, period);
        let tick = match self.controller {
            Controller::Continuous => f64::INFINITY,
            Controller::Sampled { period, .. } => multiple(period),
        };
        multiple(every).min(tick).min(actor.piece.end).min(self.duration)
    }
}

/// The piece of the axis in force.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: f64,
    /// Infinite for the last value, which stands still.
    end: f64,
    /// None: it stands still at `value`.
    segment: Option<Segment>,
    value: f64,
}

impl Piece {
    /// The piece at `time`.
    fn at(axis: &Axis, time: f64) -> Self {
        let sequence = &axis.sequence;
        let piece = sequence.segments().find(|(start, segment)| time + SAME < start + segment.duration);
        match piece {
            Some((start, segment)) => {
                Self { start, end: start + segment.duration, segment: Some(*segment), value: segment.to }
            }
            None => Self { start: sequence.duration(), end: f64::INFINITY, segment: None, value: sequence.last() },
        }
    }

    /// Value and rate at `time`; at the end the limit from the left.
    fn value(&self, time: f64) -> (f64, f64) {
        match &self.segment {
            Some(segment) => {
                let (value, rate, _) = segment.at((time - self.start).clamp(0.0, segment.duration));
                (value, rate)
            }
            None => (self.value, 0.0),
        }
    }
}

/// What sets the pressure.
struct Actor<'a> {
    plan: &'a ClosedLoop,
    feedback: Feedback,
    piece: Piece,
    /// The sampled controller: itself, its number of ticks, its commands on their way, Pa.
    pid: Pid,
    ticks: u64,
    pending: VecDeque<f64>,
    /// The command in force, Pa, sampled.
    held: f64,
}

impl<'a> Actor<'a> {
    fn new(plan: &'a ClosedLoop) -> Self {
        let Gains { proportional, integral, derivative, .. } = plan.gains;
        let direction = plan.free.direction();
        let feedback = match plan.axis.quantity {
            Quantity::Angle => Feedback::pid(
                direction * proportional,
                direction * integral,
                direction * derivative,
                0.0,
                plan.pressure_max,
            ),
            Quantity::Pressure | Quantity::None => Feedback::open(),
        };
        Self {
            plan,
            feedback,
            piece: Piece::at(&plan.axis, 0.0),
            pid: Pid::new(plan.gains, DerivativeOn::Measurement, direction),
            ticks: 0,
            pending: VecDeque::new(),
            held: 0.0,
        }
    }

    /// Takes up what is due at `time`: the next piece of the axis, a tick.
    fn meet(&mut self, time: f64, state: &LumpedState) {
        if time + SAME >= self.piece.end {
            self.piece = Piece::at(&self.plan.axis, time);
        }
        let Controller::Sampled { period, delay } = self.plan.controller else { return };
        if time + SAME < self.ticks as f64 * period {
            return;
        }
        self.ticks += 1;
        let (position, rate) = self.piece.value(time);
        let command = match self.plan.axis.quantity {
            Quantity::Angle => {
                let reference = Reference { quantity: Quantity::Angle, position, rate, acceleration: 0.0 };
                let estimate =
                    Estimate { angle: state.rotation, rate: state.rotation_rate, valid: true, ..Estimate::default() };
                let band = Band::new(self.held, self.plan.pressure_max, f64::INFINITY, period);
                self.pid.step(&reference, &estimate, 0.0, &band, period).1
            }
            Quantity::Pressure | Quantity::None => position,
        };
        self.pending.push_back(command);
        if self.pending.len() > delay as usize {
            self.held = self.pending.pop_front().unwrap_or(command);
        }
    }

    fn pressure(&self, time: f64, state: &LumpedState, integral: f64) -> f64 {
        match self.plan.controller {
            Controller::Continuous => {
                self.feedback.limited(self.feedback.command(self.piece.value(time).0, state, integral))
            }
            Controller::Sampled { .. } => self.held,
        }
    }

    fn sample(&self, time: f64, state: LumpedState, integral: f64) -> Sample {
        let reference = match self.plan.axis.quantity {
            Quantity::Angle => self.piece.value(time).0,
            Quantity::Pressure | Quantity::None => f64::NAN,
        };
        Sample { time, state, pressure: self.pressure(time, &state, integral), reference }
    }

    fn advance(
        &self,
        model: &Lumped,
        state: &mut LumpedState,
        integral: &mut f64,
        time: f64,
        h: f64,
    ) -> Result<Effort, IntegrationError> {
        match self.plan.controller {
            Controller::Continuous => {
                let signal = |tau: f64| self.piece.value(time + tau).0;
                model.advance(state, integral, &self.feedback, Load::default(), signal, h)
            }
            Controller::Sampled { .. } => model.step(state, self.held, 0.0, 0.0, h),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Kinematics;
    use crate::trajectory::{Sequence, paper_steps};

    fn steps() -> ClosedLoop {
        ClosedLoop {
            free: Free::paper(),
            law: Law::Nonlinear(Kinematics::Exact),
            axis: Axis { quantity: Quantity::Angle, sequence: paper_steps().unwrap() },
            gains: Gains { proportional: 32000.0, integral: 1.2e6, ..Gains::default() },
            controller: Controller::Continuous,
            pressure_max: 68947.57,
            duration: 4.0,
        }
    }

    #[test]
    fn samples_stand_at_their_times_and_see_the_new_reference_where_it_jumps() {
        let (samples, outcome) = steps().samples(0.01);
        outcome.unwrap();
        assert_eq!(samples.len(), 401);
        assert!(samples.iter().enumerate().all(|(i, s)| (s.time - 0.01 * i as f64).abs() < 1e-9));
        assert_eq!(samples[299].reference, 50f64.to_radians());
        assert_eq!(samples[300].reference, 20f64.to_radians());
        assert!(samples[300].pressure < samples[299].pressure - 0.9 * 32000.0 * 30f64.to_radians());
    }

    #[test]
    fn an_r_free_mirrors_an_l_free() {
        let left = steps();
        let mut right = steps();
        right.free.gamma = -left.free.gamma;
        right.axis.sequence =
            Sequence::starting_at(0.0).step(-50f64.to_radians(), 3.0).step(-20f64.to_radians(), 3.0).build().unwrap();
        for controller in [Controller::Continuous, Controller::Sampled { period: 1e-3, delay: 1 }] {
            let run = |plan: &ClosedLoop| ClosedLoop { controller, ..plan.clone() }.samples(0.1).0;
            for (l, r) in run(&left).iter().zip(run(&right)) {
                assert!((l.state.rotation + r.state.rotation).abs() < 1e-9);
                assert!((l.pressure - r.pressure).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_sampled_open_loop_is_the_continuous_one_when_nothing_changes() {
        let axis = Axis { quantity: Quantity::Pressure, sequence: Sequence::constant(3e4, 1.0).unwrap() };
        let continuous = ClosedLoop { axis, duration: 0.5, ..steps() };
        let sampled = ClosedLoop { controller: Controller::Sampled { period: 2e-3, delay: 0 }, ..continuous.clone() };
        let (a, b) = (continuous.samples(0.1).0, sampled.samples(0.1).0);
        assert_eq!(a.len(), 6);
        for (a, b) in a.iter().zip(&b) {
            assert!(a.reference.is_nan() && (a.pressure, b.pressure) == (3e4, 3e4));
            assert!((a.state.rotation - b.state.rotation).abs() < 1e-7);
        }
    }

    #[test]
    fn a_run_away_keeps_the_samples_before_it() {
        let axis = Axis { quantity: Quantity::Pressure, sequence: Sequence::constant(4.2e4, 1.0).unwrap() };
        let free = Free { gamma: -30f64.to_radians(), ..Free::paper() };
        let (samples, outcome) = ClosedLoop { free, axis, duration: 9.0, ..steps() }.samples(0.01);
        let Err(ClosedLoopError::Ended { time, .. }) = outcome else { panic!("{outcome:?}") };
        assert!(samples.len() > 2 && samples.last().unwrap().time <= time && time < 1.0);
    }

    #[test]
    fn impossible_times_are_named() {
        let error = steps().samples(0.0).1.unwrap_err();
        assert_eq!(error, ClosedLoopError::Time { what: "the output interval", value: 0.0 });
        let bad = ClosedLoop { duration: f64::NAN, ..steps() };
        assert!(bad.samples(0.1).1.unwrap_err().to_string().contains("the duration"));
    }
}

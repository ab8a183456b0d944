//! The controller `model`: the inverse model sends the command ahead, the feedback sees only what the model did not.
//!
//! **Feedforward.** What the program asks at t + lead (its preview), shaped by [`super::shaper`], is put through the
//! inverse of everything between command and angle:
//!
//! ```text
//! P = P_static(phi) + (ct phi' + I phi'' + M_h(phi)) / a(phi)           pressure that the FREE needs then
//! u = P_last + (P - P_last) / (1 - exp(-dt / lag))                      command that brings the regulator there
//! lead = dead time + half of what the regulator's period exceeds the tick + tick
//! ```
//!
//! P_static and a are the table of [`super::static_map`], M_h is the Maxwell-slip moment of
//! [`crate::model::Hysteresis`] that moves along with the reference, from the tare. There the sliders stand as a full
//! cycle has left them: a FREE on a bench has been under pressure before.
//!
//! **Feedback.** If the model is right the angle *is* the shaped reference. So the PID compares the estimate with the
//! estimate that this reference would give: the reference as it was when the present reading was taken, `age` ago,
//! put through the very extrapolation and smoothing of [`super::estimator`] (the twin). Lag, dead time and the sensor's
//! delay then cause no error, which the integral would otherwise take up and give back late; and the loop that the
//! feedback closes is that of [`super::margin`], unchanged: the feedforward does not look at the angle.
//!
//! **Cost.** A tick reads the table twice and moves eight sliders. A jump of the reference costs at most 13 trials of
//! `GRID` points, once. Nothing allocates.

use crate::model::{Hysteresis, HysteresisState};
use crate::signal::{Estimate, Quantity, Reference};

use super::estimator::{HORIZON_MAX, smoothing};
use super::shaper::{Motion, PERIODS, Quintic, SHARE, Shaper};
use super::static_map::{StaticMap, StaticMapError};
use super::{FreeControl, ModelSpec};

/// Points at which a move is tried.
const GRID: usize = 32;
/// A move may miss the limits of the command by this share of p_max: less than a per cent of the angle.
const SLACK: f64 = 0.01;
/// References remembered, and how far apart they are at least, s: 128 ms, more than a reading may be old.
const MEMORY: usize = 256;
const MEMORY_STEP: f64 = 0.5e-3;

/// Inverse model, shaper and twin of one FREE.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelFollowing {
    statics: StaticMap,
    hysteresis: Hysteresis,
    direction: f64,
    damping: f64,
    inertia: f64,
    lag: f64,
    lead: f64,
    smoothing: f64,
    pressure_max: f64,
    /// Fastest change of the command and of the pressure that a move may ask for, Pa/s.
    slew: (f64, f64),
    /// Shortest move, s.
    shortest: f64,
    state: HysteresisState,
    shaper: Shaper,
    /// Pressure that the FREE is to have after the command before, Pa.
    pressure: f64,
    past: Past,
    /// Angle of the twin, rad, in the FREE's own direction.
    twin: f64,
}

impl ModelFollowing {
    /// The inverse model of `free` as `spec` knows it, in a loop of `tick` seconds.
    pub fn new(free: &FreeControl, spec: &ModelSpec, tick: f64) -> Result<Self, StaticMapError> {
        let FreeControl { free: f, limits, regulator, .. } = free;
        let direction = f.direction();
        let highest = (direction * limits.angle_soft.0).max(direction * limits.angle_soft.1);
        let statics = match &spec.statics {
            Some(map) => map.clone(),
            None => StaticMap::of_model(f, highest)?,
        };
        let held = (regulator.period.as_secs_f64() - tick).max(0.0);
        let (omega, ratio) = (f.natural_frequencies().1, f.damping_ratios().1);
        let period = if ratio < 1.0 { std::f64::consts::TAU / (omega * (1.0 - ratio * ratio).sqrt()) } else { 0.0 };
        Ok(Self {
            statics,
            hysteresis: spec.hysteresis,
            direction,
            damping: f.torsional_damping,
            inertia: f.inertia,
            lag: regulator.lag.as_secs_f64(),
            lead: regulator.dead_time.as_secs_f64() + 0.5 * held + tick,
            smoothing: free.imu.map_or(0.0, |imu| smoothing(imu.period.as_secs_f64(), tick)),
            pressure_max: limits.pressure_max,
            slew: (SHARE * limits.slew, SHARE * regulator.fastest_fill),
            // An overdamped FREE has no period: two ticks are a jump still.
            shortest: (PERIODS * period).max(2.0 * tick),
            state: HysteresisState::rested(&spec.hysteresis),
            shaper: Shaper::default(),
            pressure: 0.0,
            past: Past::at_rest(0.0),
            twin: 0.0,
        })
    }

    /// How far ahead of the time the program is asked, s.
    pub fn lead(&self) -> f64 {
        self.lead
    }

    /// Starts anew for a program that stands at `first` before it begins; returns the feedforward for that, Pa.
    pub fn engage(&mut self, first: &Reference, estimate: &Estimate) -> f64 {
        let position = self.direction * first.position;
        let at = self.direction * estimate.angle;
        self.state = HysteresisState::rested(&self.hysteresis);
        // Straight from the tare to where it is; an angle that is no number moves nothing.
        self.hysteresis.advance(&mut self.state, at);
        self.shaper = Shaper::at_rest(position);
        self.past = Past::at_rest(position);
        self.twin = position;
        self.pressure = self.turned([position, 0.0, 0.0]);
        self.pressure
    }

    /// One tick of `dt` seconds with the program's reference at now + [`ModelFollowing::lead`]. Returns what the
    /// feedback is to be compared with, and the feedforward, Pa.
    pub fn step(&mut self, ahead: &Reference, estimate: &Estimate, dt: f64) -> (Reference, f64) {
        let d = self.direction;
        let wanted = [d * ahead.position, d * ahead.rate, d * ahead.acceleration];
        if !(wanted.iter().all(|x| x.is_finite()) && dt > 0.0) {
            return (self.reference(0.0), self.pressure);
        }
        let mut shaper = self.shaper;
        let motion = shaper.step(wanted, dt, self.shortest, |program, quintic| self.feasible(program, quintic));
        self.shaper = shaper;
        let needed = self.turned(motion);
        let share = if self.lag > 0.0 { -(-dt / self.lag).exp_m1() } else { 1.0 };
        let command = self.pressure + (needed - self.pressure) / share;
        self.pressure = needed;
        self.past.push(motion, dt);
        let rate = self.twin_step(estimate, dt);
        (self.reference(rate), command)
    }

    /// What the feedback was compared with in the latest tick.
    pub fn compared_with(&self) -> Reference {
        self.reference(0.0)
    }

    /// Moves the twin by a tick; returns its rate, rad/s in the FREE's own direction.
    fn twin_step(&mut self, estimate: &Estimate, dt: f64) -> f64 {
        let age = if estimate.age.is_finite() { estimate.age.max(0.0) } else { 0.0 };
        let (measured, rate) = self.past.at(self.lead + age);
        let predicted = measured + rate * age.min(HORIZON_MAX);
        let keep = if self.smoothing > 0.0 { (-dt / self.smoothing).exp() } else { 0.0 };
        self.twin = predicted + keep * (self.twin + rate * dt - predicted);
        rate
    }

    fn reference(&self, rate: f64) -> Reference {
        let d = self.direction;
        Reference { quantity: Quantity::Angle, position: d * self.twin, rate: d * rate, acceleration: 0.0 }
    }

    /// Moves the sliders along; returns the pressure that the motion needs, Pa.
    fn turned(&mut self, motion: Motion) -> f64 {
        let angle = motion[0];
        self.hysteresis.advance(&mut self.state, angle);
        self.needed(motion, self.hysteresis.moment_from_rest(&self.state, angle))
    }

    /// Pressure that the motion needs, Pa, with `moment` of hysteresis.
    fn needed(&self, [position, rate, acceleration]: Motion, moment: f64) -> f64 {
        let torque = self.damping * rate + self.inertia * acceleration + moment;
        self.statics.pressure(position) + torque / self.statics.moment(position)
    }

    /// Whether regulator and limits allow the program, going on as in `program`, plus `difference`.
    fn feasible(&self, program: &Motion, difference: &Quintic) -> bool {
        let h = difference.duration / GRID as f64;
        let [start, speed, gain] = *program;
        let pressure = |i: usize| {
            let t = i as f64 * h;
            let [d, rate, acceleration] = difference.at(t);
            let position = start + speed * t + 0.5 * gain * t * t + d;
            self.needed([position, rate + speed + gain * t, acceleration + gain], 0.0)
        };
        let mut before = pressure(0);
        // What the program itself needs is allowed in any case: the limits hold it where it is out of reach.
        let slack = SLACK * self.pressure_max;
        let (first, last) = (before, pressure(GRID));
        let lowest = first.min(last).min(0.0) - slack;
        let highest = first.max(last).max(self.pressure_max) + slack;
        let mut command_before: Option<f64> = None;
        for i in 1..=GRID {
            let here = pressure(i);
            let rate = (here - before) / h;
            let command = 0.5 * (here + before) + self.lag * rate;
            let late = command_before.map_or(0.0, |c| (command - c) / h);
            if rate.abs() > self.slew.1 || late.abs() > self.slew.0 || command < lowest || command > highest {
                return false;
            }
            (before, command_before) = (here, Some(command));
        }
        true
    }
}

/// The shaped reference of the last 128 ms or more.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Past {
    entries: [Moment; MEMORY],
    newest: usize,
    /// Time since the start, s.
    clock: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moment {
    time: f64,
    position: f64,
    rate: f64,
}

impl Past {
    /// At rest for ever.
    fn at_rest(position: f64) -> Self {
        Self { entries: [Moment { time: 0.0, position, rate: 0.0 }; MEMORY], newest: 0, clock: 0.0 }
    }

    fn push(&mut self, [position, rate, _]: Motion, dt: f64) {
        self.clock += dt;
        // Where ticks come faster than it remembers, the newest entry moves along until it is far enough.
        let before = self.entries[(self.newest + MEMORY - 1) % MEMORY];
        if self.entries[self.newest].time - before.time >= MEMORY_STEP || self.newest == 0 {
            self.newest = (self.newest + 1) % MEMORY;
        }
        self.entries[self.newest] = Moment { time: self.clock, position, rate };
    }

    /// Position and rate `back` seconds before the newest; the oldest that is known beyond that.
    fn at(&self, back: f64) -> (f64, f64) {
        let time = self.clock - back;
        let mut later = self.entries[self.newest];
        for k in 1..MEMORY {
            let earlier = self.entries[(self.newest + MEMORY - k) % MEMORY];
            if earlier.time <= time {
                let span = later.time - earlier.time;
                let x = if span > 0.0 { ((time - earlier.time) / span).clamp(0.0, 1.0) } else { 0.0 };
                let mix = |a: f64, b: f64| a + x * (b - a);
                return (mix(earlier.position, later.position), mix(earlier.rate, later.rate));
            }
            later = earlier;
        }
        (later.position, later.rate)
    }
}

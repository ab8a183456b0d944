//! Damping from a dump: the pressure is let off through its regulator and measured, the FREE turns back.
//!
//! ```text
//! I phi'' + ct phi' + kt phi + M_h(phi) = a(phi) P(t)
//! ```
//!
//! with the measured P(t), linear between its samples; kt and the hysteresis M_h from a staircase ([`super::sweep`]),
//! a(phi) the moment of the exact fibre kinematics at the axial equilibrium. The motion is computed and its parameters
//! are changed until it is seen (an output-error fit), so that neither the regulator's lag nor what the pressure does
//! meanwhile matters. Beside ct the angle at the start and the offset of the sensor are free.
//!
//! First without inertia: a relaxation, whose time constants add up to ct/kt. Where the samples speak for an inertia it
//! is fitted, too; else it is said not to be identifiable.
//!
//! **Integration**: implicit midpoint, second order, in steps of at most 2 ms (1e-4 of a time constant of 58 ms);
//! without inertia it is that of the relaxation. **Uncertainty**: that of least squares with the noise of the
//! residuals, times its density at rest where they are correlated (noise of the pressure comes through the FREE as slow
//! noise), and what the uncertainties of kt and of the sensor's delay add. Between its samples the pressure is not
//! known: where a corner of its course falls is worth up to a twelfth of their interval squared over the regulator's
//! lag. That is of second order in the interval, so what every other sample alone says is off four times as much, and a
//! third of the difference is what is added.

use nalgebra::DMatrix;
use thiserror::Error;

use super::Measured;
use super::least_squares::{Least, least_squares};
use super::noise::Colour;
use crate::model::{DomainError, Free, FreeError, Hysteresis, HysteresisState, Kinematics, Law, Lumped};

/// Fewest angles.
pub const SAMPLES_MIN: usize = 30;
/// Smallest turn that says anything, rad: as for a sweep, twenty times the IMU's noise.
pub const TURN_MIN: f64 = 0.0175;
/// Longest and shortest step of the integration, s.
const STEP: (f64, f64) = (2e-3, 1e-4);
/// Step by the inverse of the undamped angular frequency: the midpoint rule is off by a twelfth of its square.
const STEP_SHARE: f64 = 0.05;
/// Start values of ct/kt, s.
const LAGS: [f64; 3] = [0.005, 0.04, 0.3];
/// Standard uncertainties that an inertia must be away from zero.
const SIGNIFICANT: f64 = 4.0;
/// Largest relative standard uncertainty of a damping that still says something.
const RELATIVE_MAX: f64 = 0.5;
/// Newton's iterations of a step, at most: the hysteresis is piecewise linear.
const ITERATIONS: usize = 12;

/// A record of a dump, from before it on, on one clock; the FREE rests at its start, inflated from its own rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dump<'a> {
    /// When the angles were given, s, increasing.
    pub times: &'a [f64],
    /// The end's rotation, rad.
    pub angles: &'a [f64],
    /// When the pressures were, s, increasing; from the angles' start (less the delay) to their end.
    pub pressure_times: &'a [f64],
    /// Gauge pressures in the FREE, Pa.
    pub pressures: &'a [f64],
    /// How much older than its time an angle is, s.
    pub delay: Measured,
}

/// What a dump says.
#[derive(Clone, Debug, PartialEq)]
pub struct DumpFit {
    /// ct, N m s/rad.
    pub damping: Measured,
    /// ct/kt, s.
    pub damping_over_stiffness: Measured,
    /// I, kg m2; `None` where it is not identifiable from this motion.
    pub inertia: Option<Measured>,
    /// Root mean square of what is left over, rad.
    pub residual: f64,
    /// The angles as fitted, rad.
    pub fitted: Vec<f64>,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DumpError {
    /// Too few samples, or not as many values as times.
    #[error("{what}: {times} times and {values} values; at least {SAMPLES_MIN} and two of each are needed")]
    Lengths {
        /// Angles or pressures.
        what: &'static str,
        /// Number of times.
        times: usize,
        /// Number of values.
        values: usize,
    },
    /// Times must increase, and all numbers be finite.
    #[error("{what}: sample {index} is not finite, or not later than the one before it")]
    Sample {
        /// Angles or pressures.
        what: &'static str,
        /// Which sample.
        index: usize,
    },
    /// The delay or the stiffness is impossible.
    #[error("{what} is {value}: it must be finite and positive (a delay may be zero)")]
    Known {
        /// Which one.
        what: &'static str,
        /// Its value, SI.
        value: f64,
    },
    /// The pressure is not known for all of the motion.
    #[error("the pressures must cover the angles, less their delay: from {from} s on, until {until} s")]
    Uncovered {
        /// First instant needed, s.
        from: f64,
        /// Last instant needed, s.
        until: f64,
    },
    /// The FREE hardly turned.
    #[error("the FREE turned by {0:.4} rad only; at least {TURN_MIN} rad are needed: dump from a higher pressure")]
    NoExcitation(f64),
    /// The motion says nothing about the damping.
    #[error(
        "ct is {damping:.3e} +- {uncertainty:.1e} N m s/rad: not resolved; sample faster than the motion, or longer"
    )]
    Unresolved {
        /// Best value, N m s/rad.
        damping: f64,
        /// Standard uncertainty, N m s/rad.
        uncertainty: f64,
    },
    /// The model has no such FREE.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// An angle beyond the kinematics.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// No minimum was found.
    #[error("the fit did not converge")]
    NotConverged,
}

/// Every other value, and the first and the last.
fn thinned(values: &[f64], parity: usize) -> Vec<f64> {
    let kept = |i: usize| i % 2 == parity || i == 0 || i + 1 == values.len();
    (0..values.len()).filter(|i| kept(*i)).map(|i| values[i]).collect()
}

/// What the motion is computed from.
#[derive(Clone, Copy)]
struct Setting<'a> {
    dump: Dump<'a>,
    model: Lumped,
    hysteresis: Hysteresis,
    stiffness: f64,
}

/// ct, angle at the start and offset, rad, and I where it is free.
struct Motion {
    damping: f64,
    start: f64,
    offset: f64,
    inertia: f64,
}

/// Fits ct, and I where it is identifiable, to `dump` of `free` (its geometry and axial parameters are taken as known;
/// its inertia is where the search for one begins), with kt and hysteresis of a staircase.
pub fn fit_dump(dump: &Dump, free: &Free, stiffness: Measured, hysteresis: &Hysteresis) -> Result<DumpFit, DumpError> {
    check(dump, stiffness)?;
    let model = Lumped::new(*free, Law::Nonlinear(Kinematics::Exact))?;
    let here = Setting { dump: *dump, model, hysteresis: *hysteresis, stiffness: stiffness.value };
    let sums = LAGS.map(|lag| (here.sum(&[lag * stiffness.value], free), lag * stiffness.value));
    let start = sums.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |best| best.1);
    let relaxation = here.fit(&[start], free).ok_or(DumpError::NotConverged)?;
    let swing = here.fit(&[relaxation.parameters[0], free.inertia], free);
    let swing = match swing.filter(|swing| swing.score(0.0) < relaxation.score(0.0)) {
        Some(swing) => Some((here.found(&swing, free, stiffness)?, swing)),
        None => None,
    };
    let significant = |inertia: &Measured| inertia.value > SIGNIFICANT * inertia.uncertainty;
    let (found, least, identified) = match swing.filter(|(found, _)| significant(&found[2])) {
        Some((found, swing)) => (found, swing, true),
        None => (here.found(&relaxation, free, stiffness)?, relaxation, false),
    };
    let [damping, damping_over_stiffness, inertia] = found;
    if damping.value <= 0.0 || damping.uncertainty > RELATIVE_MAX * damping.value {
        return Err(DumpError::Unresolved { damping: damping.value, uncertainty: damping.uncertainty });
    }
    let fitted = here.angles(&here.motion(&least.parameters)).ok_or(DumpError::NotConverged)?;
    let inertia = identified.then_some(inertia);
    Ok(DumpFit { damping, damping_over_stiffness, inertia, residual: least.deviation(), fitted })
}

impl Setting<'_> {
    /// ct, ct/kt and I (zero where it is not free) of `least`, with everything in their uncertainties.
    fn found(&self, least: &Least, free: &Free, stiffness: Measured) -> Result<[Measured; 3], DumpError> {
        let start: Vec<f64> =
            [least.parameters.first(), least.parameters.get(3)].into_iter().flatten().copied().collect();
        let values = |setting: &Setting, least: &Least| {
            let at = |i: usize| least.parameters.get(i).copied().unwrap_or_default();
            [at(0), at(0) / setting.stiffness, at(3)]
        };
        let value = values(self, least);
        // What else kt, the delay and the pressure between its samples may be moves the best values.
        let moved = |setting: Setting| -> Result<[f64; 3], DumpError> {
            let there = setting.fit(&start, free).ok_or(DumpError::NotConverged)?;
            let there = values(&setting, &there);
            Ok(std::array::from_fn(|k| there[k] - value[k]))
        };
        let stiffer = match stiffness.uncertainty > 0.0 {
            true => moved(Setting { stiffness: stiffness.value + stiffness.uncertainty, ..*self })?,
            false => [0.0; 3],
        };
        let delay = self.dump.delay;
        let later = match delay.uncertainty > 0.0 {
            true => {
                let delay = Measured { value: delay.value + delay.uncertainty, ..delay };
                moved(Setting { dump: Dump { delay, ..self.dump }, ..*self })?
            }
            false => [0.0; 3],
        };
        let thinner = |parity: usize| {
            let pressure_times = thinned(self.dump.pressure_times, parity);
            let pressures = thinned(self.dump.pressures, parity);
            let dump = Dump { pressure_times: &pressure_times, pressures: &pressures, ..self.dump };
            moved(Setting { dump, ..*self })
        };
        let (even, odd) = (thinner(0)?, thinner(1)?);
        let (own, freedom) = self.spread(least);
        let own = [own[0], own[0] / self.stiffness, own.get(3).copied().unwrap_or_default()];
        Ok(std::array::from_fn(|k| {
            let between = even[k].hypot(odd[k]) / 3.0 / 2f64.sqrt();
            let uncertainty = own[k].hypot(stiffer[k]).hypot(later[k]).hypot(between);
            Measured { value: value[k], uncertainty, freedom }
        }))
    }

    /// Parameters to begin with, from ct, and I where it is free.
    fn start(&self, start: &[f64], free: &Free) -> Vec<f64> {
        let last = self.dump.angles[self.dump.angles.len() - 1];
        let mut from = vec![start[0], free.direction() * (self.dump.angles[0] - last), last];
        from.extend(start.get(1));
        from
    }

    fn residuals(&self, parameters: &[f64]) -> Option<Vec<f64>> {
        let angles = self.angles(&self.motion(parameters))?;
        Some(angles.iter().zip(self.dump.angles).map(|(model, seen)| model - seen).collect())
    }

    /// Sum of the squared residuals where the search begins.
    fn sum(&self, start: &[f64], free: &Free) -> f64 {
        let residuals = self.residuals(&self.start(start, free));
        residuals.map_or(f64::INFINITY, |r| r.iter().map(|r| r * r).sum())
    }

    /// Least squares from `start`: ct, and I where it is free.
    fn fit(&self, start: &[f64], free: &Free) -> Option<Least> {
        let from = self.start(start, free);
        let mut scale = vec![start[0], 1.0, 1.0];
        scale.extend(start.get(1));
        least_squares(&from, &scale, |p| self.residuals(p))
    }

    fn motion(&self, p: &[f64]) -> Motion {
        Motion { damping: p[0], start: p[1], offset: p[2], inertia: p.get(3).copied().unwrap_or_default() }
    }

    /// Standard uncertainties of the parameters in the noise that the residuals show, and the degrees of freedom.
    fn spread(&self, least: &Least) -> (Vec<f64>, usize) {
        let colour = self.colour(least);
        let density = colour.as_ref().map_or(1.0, |c| c.density(0.0));
        let samples = colour.as_ref().map_or(1.0, Colour::samples);
        let spread = least.covariance.diagonal().iter().map(|v| (v.max(0.0) * density).sqrt()).collect();
        (spread, ((least.freedom as f64 / samples) as usize).max(1))
    }

    fn colour(&self, least: &Least) -> Option<Colour> {
        let residuals = self.residuals(&least.parameters)?;
        let orthonormal = DMatrix::clone(&least.jacobian).qr().q();
        let basis: Vec<Vec<f64>> = orthonormal.column_iter().map(|c| c.iter().copied().collect()).collect();
        Some(Colour::of(&residuals, &basis))
    }

    /// The angles that the sensor would give, rad. `None` outside the domain.
    fn angles(&self, motion: &Motion) -> Option<Vec<f64>> {
        if !(motion.damping > 0.0 && motion.inertia >= 0.0) {
            return None;
        }
        let own = self.model.free().direction();
        let natural = (motion.inertia / self.stiffness).sqrt();
        let step = if motion.inertia > 0.0 { (STEP_SHARE * natural).clamp(STEP.1, STEP.0) } else { STEP.0 };
        let mut sliders = HysteresisState::rested(&self.hysteresis);
        self.hysteresis.advance(&mut sliders, motion.start);
        let (mut x, mut rate) = (motion.start, 0.0);
        let mut at = self.dump.times.first()? - self.dump.delay.value;
        let mut pressure = Course { times: self.dump.pressure_times, values: self.dump.pressures, index: 0 };
        let mut angles = Vec::with_capacity(self.dump.times.len());
        for time in self.dump.times {
            let span = time - self.dump.delay.value - at;
            let parts = (span / step).ceil().max(0.0);
            for k in 0..parts as usize {
                let h = span / parts;
                let mid = pressure.at(at + (k as f64 + 0.5) * h);
                let mean = self.mean_rate(motion, (x, rate), &sliders, mid, h)?;
                (x, rate) = (x + h * mean, 2.0 * mean - rate);
                self.hysteresis.advance(&mut sliders, x);
            }
            at += span;
            angles.push(own * x + motion.offset);
        }
        Some(angles)
    }

    /// Mean rate over a step of `h` (s) from (angle, rate), rad/s, by Newton's method: implicit midpoint.
    fn mean_rate(
        &self,
        motion: &Motion,
        (x, rate): (f64, f64),
        sliders: &HysteresisState,
        pressure: f64,
        h: f64,
    ) -> Option<f64> {
        let free = self.model.free();
        let own = free.direction();
        // The axial motion is far faster than the rotation, and hardly moves the moment: it follows at rest.
        let at_rest = self.model.actuation(0.0, own * x).ok()?;
        let extension = (free.mass * crate::model::GRAVITY + at_rest.force * pressure) / free.axial_stiffness;
        let (inert, mut mean) = (2.0 * motion.inertia / h, rate);
        for _ in 0..ITERATIONS {
            let middle = x + 0.5 * h * mean;
            let actuation = self.model.actuation(extension, own * middle).ok()?;
            let springs = self.stiffness * middle + self.hysteresis.moment_from_rest(sliders, middle);
            let left = own * actuation.moment * pressure - springs - motion.damping * mean - inert * (mean - rate);
            let stiffness =
                self.stiffness + self.hysteresis.tangent(sliders, middle) - actuation.moment_by[1] * pressure;
            let change = left / (motion.damping + inert + 0.5 * h * stiffness);
            mean += change;
            if change.abs() <= 1e-10 * (1.0 + mean.abs()) {
                return Some(mean);
            }
        }
        None
    }
}

/// A signal that is linear between its samples, read forwards.
struct Course<'a> {
    times: &'a [f64],
    values: &'a [f64],
    index: usize,
}

impl Course<'_> {
    fn at(&mut self, time: f64) -> f64 {
        while self.index + 2 < self.times.len() && self.times[self.index + 1] <= time {
            self.index += 1;
        }
        let (i, j) = (self.index, self.index + 1);
        let share = ((time - self.times[i]) / (self.times[j] - self.times[i])).clamp(0.0, 1.0);
        self.values[i] + share * (self.values[j] - self.values[i])
    }
}

fn check(dump: &Dump, stiffness: Measured) -> Result<(), DumpError> {
    let lists =
        [("angles", dump.times, dump.angles, SAMPLES_MIN), ("pressures", dump.pressure_times, dump.pressures, 2)];
    for (what, times, values, least) in lists {
        if times.len() != values.len() || times.len() < least {
            return Err(DumpError::Lengths { what, times: times.len(), values: values.len() });
        }
        let good = |i: usize| times[i].is_finite() && values[i].is_finite() && (i == 0 || times[i] > times[i - 1]);
        if let Some(index) = (0..times.len()).find(|&i| !good(i)) {
            return Err(DumpError::Sample { what, index });
        }
    }
    if !(stiffness.value.is_finite() && stiffness.value > 0.0) {
        return Err(DumpError::Known { what: "kt", value: stiffness.value });
    }
    if !(dump.delay.value.is_finite() && dump.delay.value >= 0.0) {
        return Err(DumpError::Known { what: "the delay", value: dump.delay.value });
    }
    let (from, until) = (dump.times[0] - dump.delay.value, dump.times[dump.times.len() - 1] - dump.delay.value);
    if dump.pressure_times[0] > from || dump.pressure_times[dump.pressure_times.len() - 1] < until {
        return Err(DumpError::Uncovered { from, until });
    }
    let (low, high) = dump.angles.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), a| (l.min(*a), h.max(*a)));
    if high - low < TURN_MIN {
        return Err(DumpError::NoExcitation(high - low));
    }
    Ok(())
}

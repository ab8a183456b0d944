//! Whisks: closed figures of the plate, again and again.
//!
//! The paper's pattern moves one waveform round the four FREEs, a quarter of a period apart. The order matters.
//! Crossing the square (A, B, D, C), highest and lowest are neighbours: the plate bends along one line as cos u while
//! it turns as sin u, and their product moves it across as sin 2u: a figure eight. Round the square (A, B, C, D)
//! highest and lowest are opposite, the turns cancel, and the plate draws a circle. How wide that eight is hangs on how
//! the bending stiffness changes while the FREEs turn. At 60 deg and 4 +- 2 psi the section's law draws 10.7 x 4.7 mm:
//! held at the pressed tube's own twist its EI rises with the pressure, held at the opposite one it falls. With an EI
//! that rises with the pressure alone, as of a FREE that may turn, the same rods draw 10.6 x 2.5 mm, with one that does
//! not change 10.6 x 5.0 mm; shear is worth 0.1 mm. freerig's own whisk is an eight of chosen size, place and
//! frequency, whose pressures the inverse finds.
//!
//! A whisk that lies past a critical point or outside the model's domain is answered with where it ends and, beside it,
//! the largest one of its kind that does not: found by bisection of its scale, on the assumption that what is valid at
//! one scale is valid at every smaller one; the plan offered is itself predicted throughout.

use std::f64::consts::{PI, TAU};

use nalgebra::{Unit, Vector3};

use super::path::{estimate, walk};
use super::{Figure, Limits, PathPlan, PlanError, Rest, Target, inverse, path};

/// Samples of a period while a scale is sought.
const COARSE: usize = 48;
/// Halvings of the scale: to 1/1024.
const HALVINGS: usize = 10;
/// Fall-backs, by a hundredth each, where the full sampling sees more than the coarse one.
const FALLBACKS: usize = 5;

/// The plane of a pattern's figure.
const LEVEL: [Vector3<f64>; 2] = [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0)];

/// The order in which the waveform reaches the FREEs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// A, B, D, C.
    Crossing,
    /// A, B, C, D.
    Round,
}

/// The paper's pattern: each pressure between the lowest and the highest, two of the four in the middle whenever one is
/// at either.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pattern {
    /// Pa.
    pub lowest: f64,
    /// Pa.
    pub highest: f64,
    /// Pressure a quarter of a period from either, Pa. The mean of the two makes a sinusoid; another one adds a second
    /// harmonic, and must be within a quarter of their difference of the mean, lest the pressure pass them.
    pub middle: f64,
    /// s.
    pub period: f64,
    /// Who follows whom.
    pub order: Order,
}

/// A figure eight, `centre + width/2 sin(2 pi f t) across + height/2 sin(4 pi f t) up`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eight {
    /// Where it crosses itself, m.
    pub centre: Vector3<f64>,
    /// Extent along `across`, m.
    pub width: f64,
    /// Extent along `up`, m.
    pub height: f64,
    /// Direction of its long axis.
    pub across: Unit<Vector3<f64>>,
    /// The other direction of its plane; at a right angle to `across`.
    pub up: Unit<Vector3<f64>>,
    /// Hz.
    pub frequency: f64,
}

/// A whisk's plan of one period, the first sample's time 0 and the last one's the period.
#[derive(Clone, Debug, PartialEq)]
pub struct WhiskPlan {
    /// s.
    pub period: f64,
    /// What was asked for, as far as it goes.
    pub plan: PathPlan,
    /// What the predicted tip draws, on the plane of x and y or of the eight; none where the plan is not valid to its
    /// end.
    pub figure: Option<Figure>,
    /// How far apart its last and first samples are: plate, m, and pressures, Pa.
    pub closure: Option<(f64, f64)>,
    /// The stable plan offered instead, where the one asked for ends, falls short of its targets or of the margin; none
    /// where not even the centre of an eight is reached.
    pub instead: Option<Instead>,
}

/// The largest valid whisk of the kind asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Instead {
    /// What was made smaller.
    pub scaled: Scaled,
    /// By which factor, 0 to 1.
    pub scale: f64,
    /// It.
    pub plan: PathPlan,
    /// What it draws.
    pub figure: Option<Figure>,
}

/// What a scale multiplies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scaled {
    /// The pressures' swing about their mean.
    Swing,
    /// All pressures, where not even their mean is valid.
    Pressures,
    /// Width and height.
    Size,
}

impl Pattern {
    /// The paper's: 2 to 10 psi, on every second, in the sinusoid's own middle, 6 psi.
    pub fn paper() -> Pattern {
        let psi = crate::units::PASCAL_PER_PSI;
        Pattern { lowest: 2.0 * psi, highest: 10.0 * psi, middle: 6.0 * psi, period: 4.0, order: Order::Crossing }
    }

    /// Mean, amplitudes of the first and the second harmonic, Pa.
    fn harmonics(&self) -> [f64; 3] {
        let mean = 0.5 * (self.highest + self.lowest);
        let second = 0.5 * (mean - self.middle);
        [mean - second, 0.5 * (self.highest - self.lowest), second]
    }

    /// The pressures of A, B, C, D at `t` s with the swing scaled by `swing` and all by `all`.
    fn at(&self, t: f64, swing: f64, all: f64) -> [f64; 4] {
        let [mean, first, second] = self.harmonics();
        let quarters = match self.order {
            Order::Crossing => [0.0, 1.0, 3.0, 2.0],
            Order::Round => [0.0, 1.0, 2.0, 3.0],
        };
        quarters.map(|quarter| {
            let u = TAU * t / self.period - 0.5 * PI * quarter;
            all * (mean + swing * (first * u.cos() + second * (2.0 * u).cos()))
        })
    }

    fn check(&self, limits: &Limits) -> Result<(), PlanError> {
        limits.check()?;
        let [_, first, second] = self.harmonics();
        let values = [
            ("the lowest pressure (Pa)", self.lowest, self.lowest.is_finite(), "must be finite"),
            ("the highest pressure (Pa)", self.highest, self.highest > self.lowest, "must be above the lowest"),
            (
                "the middle pressure (Pa)",
                self.middle,
                4.0 * second.abs() <= first,
                "must be within a quarter of the swing from highest to lowest of their mean",
            ),
            ("the period (s)", self.period, self.period > 0.0 && self.period.is_finite(), "must be positive"),
        ];
        if let Some((what, value, _, rule)) = values.into_iter().find(|v| !(v.2 && v.1.is_finite())) {
            return Err(PlanError::invalid(what, value, rule));
        }
        // |first sin u + 2 second sin 2u| is at most this.
        let fastest = (first + 2.0 * second.abs()) * TAU / self.period;
        if fastest > limits.slew {
            let rule = "must not exceed the slew rate; lengthen the period or narrow the swing";
            return Err(PlanError::invalid("the pattern's fastest change (Pa/s)", fastest, rule));
        }
        Ok(())
    }
}

/// What `pattern` does, sampled at `rate` Hz. Pressures are clipped to the limits, and said to be; its margin is what a
/// plan offered instead keeps.
///
/// # Errors
/// A pattern, limits or a rate that are none.
pub fn pattern(rest: &Rest<'_>, pattern: &Pattern, limits: &Limits, rate: f64) -> Result<WhiskPlan, PlanError> {
    pattern.check(limits)?;
    let times = times(pattern.period, rate)?;
    let coarse: Vec<f64> = (0..=COARSE).map(|k| pattern.period * k as f64 / COARSE as f64).collect();
    let run = |times: &[f64], swing: f64, all: f64| {
        let wanted: Vec<_> = times.iter().map(|t| pattern.at(*t, swing, all)).collect();
        let pressures: Vec<_> = wanted.iter().map(|p| limits.clip(p)).collect();
        walk(rest, times, &pressures).map(|(mut plan, states)| {
            plan.clipped = wanted.iter().map(|p| limits.clips(p)).collect();
            (plan, states)
        })
    };
    let good = |plan: &PathPlan| plan.valid() && plan.margins.iter().all(|m| m.smooth >= limits.margin);
    let (mut plan, states) = run(&times, 1.0, 1.0)?;
    plan.facts.discretisation = estimate(rest, &states);
    let mut instead = None;
    if !good(&plan) {
        let scaled = if good(&run(&coarse[..1], 0.0, 1.0)?.0) { Scaled::Swing } else { Scaled::Pressures };
        let at = |times: &[f64], scale: f64| match scaled {
            Scaled::Swing => run(times, scale, 1.0),
            _ => run(times, 1.0, scale),
        };
        let scale = largest(|scale| Ok(good(&at(&coarse, scale)?.0)))?;
        for k in 0..FALLBACKS {
            let scale = scale * (1.0 - 0.01 * k as f64);
            let (mut plan, states) = at(&times, scale)?;
            if good(&plan) {
                plan.facts.discretisation = estimate(rest, &states);
                let figure = drawn(&plan, LEVEL);
                instead = Some(Instead { scaled, scale, plan, figure });
                break;
            }
        }
    }
    Ok(WhiskPlan { period: pattern.period, figure: drawn(&plan, LEVEL), closure: closure(&plan), plan, instead })
}

impl Eight {
    /// Of `width` x `height` m about `centre`, lying along x and y.
    pub fn level(centre: Vector3<f64>, width: f64, height: f64, frequency: f64) -> Eight {
        Eight { centre, width, height, across: Vector3::x_axis(), up: Vector3::y_axis(), frequency }
    }

    /// Across and up.
    fn plane(&self) -> [Vector3<f64>; 2] {
        [self.across.into_inner(), self.up.into_inner()]
    }

    /// The target at `t` s of the eight scaled about its centre.
    fn at(&self, t: f64, scale: f64) -> Target {
        let u = TAU * self.frequency * t;
        let (x, y) = (0.5 * self.width * u.sin(), 0.5 * self.height * (2.0 * u).sin());
        let [across, up] = self.plane();
        Target::point(self.centre + (across * x + up * y) * scale)
    }

    fn check(&self) -> Result<(), PlanError> {
        let right = self.across.dot(&self.up).abs();
        let values = [
            ("the width (m)", self.width, self.width >= 0.0, "must not be negative"),
            ("the height (m)", self.height, self.height >= 0.0, "must not be negative"),
            ("the frequency (Hz)", self.frequency, self.frequency > 0.0, "must be positive"),
            ("the cosine between the eight's directions", right, right < 1e-6, "they must be at a right angle"),
        ];
        match values.into_iter().find(|v| !(v.2 && v.1.is_finite())) {
            Some((what, value, _, rule)) => Err(PlanError::invalid(what, value, rule)),
            None => Ok(()),
        }
    }
}

/// The pressures of `eight`, sampled at `rate` Hz, by the inverse; it begins in its crossing point.
///
/// # Errors
/// An eight, limits or a rate that are none; a centre through the base.
pub fn eight(rest: &Rest<'_>, eight: &Eight, limits: &Limits, rate: f64) -> Result<WhiskPlan, PlanError> {
    eight.check()?;
    let period = 1.0 / eight.frequency;
    let times = times(period, rate)?;
    // Every scale begins in the centre, from where the search is warm.
    let centre = inverse::cold(rest, &eight.at(0.0, 1.0), limits)?;
    let run = |times: &[f64], scale: f64| -> Result<PathPlan, PlanError> {
        let targets: Vec<_> = times.iter().map(|t| eight.at(*t, scale)).collect();
        let mut plan = path::follow(rest, times, &targets, limits, Some(&centre.state), &mut |_| {})?;
        plan.facts.ramp = centre.ramp.clone();
        Ok(plan)
    };
    let plan = run(&times, 1.0)?;
    let mut instead = None;
    if plan.facts.missed > 0 && centre.shortfall.is_none() {
        let coarse: Vec<f64> = (0..=COARSE).map(|k| period * k as f64 / COARSE as f64).collect();
        let scale = largest(|scale| Ok(run(&coarse, scale)?.facts.missed == 0))?;
        for k in 0..FALLBACKS {
            let scale = scale * (1.0 - 0.01 * k as f64);
            let plan = run(&times, scale)?;
            if plan.facts.missed == 0 {
                let figure = drawn(&plan, eight.plane());
                instead = Some(Instead { scaled: Scaled::Size, scale, plan, figure });
                break;
            }
        }
    }
    Ok(WhiskPlan { period, figure: drawn(&plan, eight.plane()), closure: closure(&plan), plan, instead })
}

/// The largest scale from 0 to 1 that is good, given that none larger than a bad one is.
fn largest(good: impl Fn(f64) -> Result<bool, PlanError>) -> Result<f64, PlanError> {
    if good(1.0)? {
        return Ok(1.0);
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if good(middle)? { low = middle } else { high = middle }
    }
    Ok(low)
}

fn drawn(plan: &PathPlan, plane: [Vector3<f64>; 2]) -> Option<Figure> {
    // The last sample is the first one again.
    plan.valid().then(|| Figure::of(&plan.predicted[..plan.predicted.len() - 1], plane)).flatten()
}

fn closure(plan: &PathPlan) -> Option<(f64, f64)> {
    if !plan.valid() {
        return None;
    }
    let (first, last) = (plan.predicted.first()?, plan.predicted.last()?);
    let apart = (Vector3::from(last.position) - Vector3::from(first.position)).norm();
    let (first, last) = (plan.pressures.first()?, plan.pressures.last()?);
    Some((apart, first.iter().zip(last).fold(0.0, |far, (a, b)| f64::max(far, (b - a).abs()))))
}

/// From 0 to `period`, both in it, at about `rate` Hz.
fn times(period: f64, rate: f64) -> Result<Vec<f64>, PlanError> {
    let samples = (period * rate).round();
    if !(8.0..=1e6).contains(&samples) {
        let rule = "must give 8 to a million samples a period";
        return Err(PlanError::invalid("the sampling rate (Hz)", rate, rule));
    }
    Ok((0..=samples as usize).map(|k| period * k as f64 / samples).collect())
}

//! Pressures over time, and where they take the plate.
//!
//! [`follow`] turns targets over time into pressures by one warm inverse after the other, within the slew rate;
//! [`forecast`] says what given pressures do. Both go along one branch of stable equilibria, sample by sample.

use super::end::pressures as pressures_of;
use super::{Bound, Ended, Inverse, Limits, Margin, PlanError, Rest, Shortfall, Target, inverse};
use crate::fem::module::State;

/// States of a plan whose discretisation error is estimated.
const ESTIMATES: usize = 8;

/// Where the plate is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Of its centre, m.
    pub position: [f64; 3],
    /// From rest, as a unit quaternion (w, x, y, z).
    pub rotation: [f64; 4],
}

/// A plan: columns of equal length, but for `predicted` and `margins`, which are as long as the plan is valid, and
/// `planned`, which is empty where pressures were given and not targets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PathPlan {
    /// s.
    pub times: Vec<f64>,
    /// Gauge pressures of A, B, C, D, Pa.
    pub pressures: Vec<[f64; 4]>,
    /// What was asked for.
    pub planned: Vec<Pose>,
    /// What comes of it.
    pub predicted: Vec<Pose>,
    /// How far from its end the module is.
    pub margins: Vec<Margin>,
    /// Which bounds hold the pressures where the target is not reached, or clip given ones.
    pub clipped: Vec<[Option<Bound>; 4]>,
    /// What is to be known of it.
    pub facts: Facts,
}

/// Facts of a plan, over the samples that are valid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// Largest weighted error, m; none without targets.
    pub worst_error: Option<f64>,
    /// Root of its mean square, m.
    pub rms_error: Option<f64>,
    /// Samples that fall short of their target.
    pub missed: usize,
    /// Why the first of them does.
    pub shortfall: Option<Shortfall>,
    /// The least margin and when, s.
    pub least_margin: Option<(f64, f64)>,
    /// Fastest change of a pressure, Pa/s.
    pub fastest: f64,
    /// Estimated error of the predicted positions by the rods' resolution, m: the largest of eight samples; none where
    /// a finer resolution refuses one of them, as it may beside a contact.
    pub discretisation: Option<f64>,
    /// Where it ends before it is over, and when, s: later samples are not predicted.
    pub ended: Option<(f64, Ended)>,
    /// Where the straight ramp from rest to its first pressures ends, if it does not get there: then nothing is
    /// predicted, or, for targets, another way leads there.
    pub ramp: Option<Ended>,
}

impl Pose {
    /// Of the plate of `state`.
    pub fn of(state: &State) -> Pose {
        let (p, q) = (state.position(), state.rotation());
        Pose { position: p.into(), rotation: [q.w, q.i, q.j, q.k] }
    }
}

impl PathPlan {
    /// All of it is predicted: no sample lies past an end.
    pub fn valid(&self) -> bool {
        self.predicted.len() == self.times.len()
    }

    fn push(&mut self, rest: &Rest<'_>, state: &State) {
        self.predicted.push(Pose::of(state));
        self.margins.push(rest.margin(state));
    }

    /// What the samples themselves say.
    fn sum_up(&mut self) {
        let least = self.margins.iter().zip(&self.times).min_by(|a, b| a.0.least().total_cmp(&b.0.least()));
        self.facts.least_margin = least.map(|(margin, t)| (margin.least(), *t));
        for (t, p) in self.times.windows(2).zip(self.pressures.windows(2)) {
            for (before, after) in p[0].iter().zip(&p[1]) {
                self.facts.fastest = self.facts.fastest.max((after - before).abs() / (t[1] - t[0]));
            }
        }
    }
}

/// The pressures of `targets` at `times` (s, rising). The first is found from rest, wherever it is ([`inverse::cold`]),
/// or, with `start`, from that equilibrium within the slew rate over the first interval; the others each within the
/// slew rate of the one before. A target out of reach is projected and counted. `progress` is told how many are
/// planned.
///
/// # Errors
/// Times that do not rise or are not as many as targets; see [`inverse::cold`].
pub fn follow(
    rest: &Rest<'_>,
    times: &[f64],
    targets: &[Target],
    limits: &Limits,
    start: Option<&State>,
    progress: &mut dyn FnMut(usize),
) -> Result<PathPlan, PlanError> {
    rising(times, targets.len())?;
    for target in targets {
        target.check(rest)?;
    }
    let mut plan = PathPlan { times: times.to_vec(), ..PathPlan::default() };
    let (mut squares, mut worst) = (0.0, 0.0f64);
    let mut states: Vec<State> = Vec::with_capacity(targets.len());
    for (k, target) in targets.iter().enumerate() {
        let found: Inverse = match (states.last().or(start), k) {
            (None, _) => inverse::cold(rest, target, limits)?,
            (Some(last), k) => {
                let interval = if k == 0 { first_interval(times) } else { times[k] - times[k - 1] };
                inverse::warm(rest, target, limits, last, limits.slew * interval)?
            }
        };
        plan.pressures.push(found.pressures);
        plan.planned.push(pose(target));
        plan.push(rest, &found.state);
        plan.clipped.push(if found.shortfall.is_some() { found.active } else { [None; 4] });
        squares += found.residual * found.residual;
        worst = worst.max(found.residual);
        if let Some(shortfall) = found.shortfall {
            plan.facts.missed += 1;
            plan.facts.shortfall.get_or_insert(shortfall);
        }
        if k == 0 {
            plan.facts.ramp = found.ramp;
        }
        states.push(found.state);
        progress(k + 1);
    }
    plan.facts.worst_error = Some(worst);
    plan.facts.rms_error = Some((squares / targets.len() as f64).sqrt());
    plan.facts.discretisation = estimate(rest, &states);
    plan.sum_up();
    Ok(plan)
}

/// What `pressures` (Pa) at `times` (s, rising) do, from the straight ramp from rest to the first of them on, as far as
/// the module follows.
///
/// # Errors
/// Times that do not rise or are not as many as pressures, pressures that are no numbers.
pub fn forecast(rest: &Rest<'_>, times: &[f64], pressures: &[[f64; 4]]) -> Result<PathPlan, PlanError> {
    let (mut plan, states) = walk(rest, times, pressures)?;
    plan.facts.discretisation = estimate(rest, &states);
    Ok(plan)
}

/// [`forecast`] without the estimate of its error, and the states.
pub(super) fn walk(
    rest: &Rest<'_>,
    times: &[f64],
    pressures: &[[f64; 4]],
) -> Result<(PathPlan, Vec<State>), PlanError> {
    rising(times, pressures.len())?;
    if let Some(p) = pressures.iter().flatten().find(|p| !p.is_finite()) {
        return Err(PlanError::invalid("a pressure (Pa)", *p, "must be finite"));
    }
    let mut plan = PathPlan { times: times.to_vec(), pressures: pressures.to_vec(), ..PathPlan::default() };
    let mut states: Vec<State> = Vec::with_capacity(pressures.len());
    for (t, p) in times.iter().zip(pressures) {
        let next = match states.last() {
            None => rest.ramp(rest.state(), p),
            Some(last) if pressures_of(last) == *p => Ok(last.clone()),
            Some(last) => rest.onward(last, p),
        };
        match next {
            Ok(state) => {
                plan.push(rest, &state);
                states.push(state);
            }
            Err(ended) if states.is_empty() => {
                plan.facts.ramp = Some(*ended);
                break;
            }
            Err(ended) => {
                plan.facts.ended = Some((*t, *ended));
                break;
            }
        }
    }
    plan.sum_up();
    Ok((plan, states))
}

/// The largest discretisation error, m, of some of `states`; none where a finer resolution refuses one of them, as it
/// may beside a contact.
pub(super) fn estimate(rest: &Rest<'_>, states: &[State]) -> Option<f64> {
    let stride = states.len().div_ceil(ESTIMATES).max(1);
    let mut worst: Option<f64> = None;
    for state in states.iter().step_by(stride) {
        let error = rest.module().discretisation_error(state).ok()? * rest.module().length();
        worst = Some(worst.map_or(error, |w| w.max(error)));
    }
    worst
}

fn pose(target: &Target) -> Pose {
    let q = target.rotation;
    Pose { position: target.position.into(), rotation: [q.w, q.i, q.j, q.k] }
}

fn first_interval(times: &[f64]) -> f64 {
    if times.len() > 1 { times[1] - times[0] } else { f64::INFINITY }
}

pub(super) fn rising(times: &[f64], samples: usize) -> Result<(), PlanError> {
    if samples == 0 || times.len() != samples {
        let rule = "must be the number of samples, at least one";
        return Err(PlanError::invalid("the number of times", times.len() as f64, rule));
    }
    if let Some(t) = times.iter().find(|t| !t.is_finite()) {
        return Err(PlanError::invalid("a time (s)", *t, "must be finite"));
    }
    match times.windows(2).find(|t| t[1] <= t[0]) {
        Some(t) => Err(PlanError::invalid("a time (s)", t[1], "must be later than the one before")),
        None => Ok(()),
    }
}

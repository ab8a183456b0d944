//! The pressures that put the plate on a target.
//!
//! ```text
//!     min |W (x(P) - x_d)|^2     low <= P <= high,   |P - P_start| <= reach,   smooth margin >= m
//! ```
//!
//! by Gauss and Newton's method in a box of trust: each step is the least of the linearised problem over the pressures
//! allowed (an active set), with the module's own Jacobian, which its last factorisation gives. Where the margin is in
//! the way its gradient, by differences, is one plane more. Every trial is an equilibrium followed from the last one
//! and stable, so no step changes the branch. What the target leaves free then goes to the margin: Newton's method
//! along the null directions of the Jacobian, with the margin's slope and curvature by differences.
//!
//! A target that cannot be reached is projected: the answer is the (locally) nearest plate, what it is off by, and
//! why.

use nalgebra::Vector3;

use super::end::pressures as pressures_of;
use super::search::{Point, REACHED, Search};
use super::{Bound, End, Ended, FREES, Limits, Margin, PlanError, Rest, Target};
use crate::fem::module::State;

/// Steps along the freedoms where nothing is known yet; a warm start makes one.
const ROUNDS: usize = 16;

/// Where a search that knows nothing begins, in halves of the limits: rest, the two turns, and bends all round.
const STARTS: [[f64; 4]; 11] = [
    [0.0, 0.0, 0.0, 0.0],
    [1.0, 0.0, 1.0, 0.0],
    [0.0, 1.0, 0.0, 1.0],
    [1.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
    [0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
    [1.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 1.0],
    [0.0, 1.0, 1.0, 0.0],
    [1.0, 0.0, 0.0, 1.0],
];
/// Searches that agree are enough when there are so many.
const AGREED: usize = 3;
/// Pa: answers that differ by less agree.
const ALIKE: f64 = 100.0;

/// Pressures and what they do.
#[derive(Clone, Debug)]
pub struct Inverse {
    /// Pa, of A, B, C, D.
    pub pressures: [f64; 4],
    /// The equilibrium.
    pub state: State,
    /// What the plate's centre is off by, m.
    pub position_error: Vector3<f64>,
    /// What the plate's rotation is off by, a rotation vector, rad.
    pub rotation_error: Vector3<f64>,
    /// The weighted error, m.
    pub residual: f64,
    /// How far the state is from its end.
    pub margin: Margin,
    /// Which bounds hold the pressures.
    pub active: [Option<Bound>; 4],
    /// Why the target is not reached; none where it is.
    pub shortfall: Option<Shortfall>,
    /// Equilibria that it took.
    pub equilibria: usize,
    /// Where the straight ramp from rest to these pressures ends before it gets there (then another way leads there:
    /// first up to a stable neighbour); none where it does not. Looked at by [`cold`] alone.
    pub ramp: Option<Ended>,
}

/// What keeps the plate from its target.
#[derive(Clone, Debug, PartialEq)]
pub enum Shortfall {
    /// Pressures at their bounds ([`Inverse::active`]) would have to go beyond.
    Bounds,
    /// The least margin.
    Margin,
    /// The way there ends.
    Ends(Ended),
    /// Four pressures do not move the plate that way.
    Freedom,
}

impl std::fmt::Display for Shortfall {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Shortfall::Bounds => write!(f, "pressures at their bounds would have to go beyond them"),
            Shortfall::Margin => write!(f, "the least margin is in the way"),
            Shortfall::Ends(ended) => write!(f, "on the way {ended}"),
            Shortfall::Freedom => write!(f, "four pressures cannot move the plate that way"),
        }
    }
}

/// The pressures for `target`, wherever the module is: from rest and from states turned and bent by half of what the
/// limits allow, the best of what they lead to; enough when three lead to the same. The slew rate does not count.
///
/// # Errors
/// A target or limits that are none; pressures that cannot be reached from rest. Not a target out of reach.
pub fn cold(rest: &Rest<'_>, target: &Target, limits: &Limits) -> Result<Inverse, PlanError> {
    target.check(rest)?;
    limits.check()?;
    let window = limits.around(&[0.0; FREES], f64::INFINITY);
    let (mut found, mut first_end, mut equilibria) = (Vec::new(), None, 0);
    for start in STARTS {
        let at = std::array::from_fn(|i| window.low[i] + 0.5 * start[i] * (window.high[i] - window.low[i]));
        let state = match rest.ramp(rest.state(), &at) {
            Ok(state) => state,
            Err(ended) => {
                first_end.get_or_insert(ended.end);
                continue;
            }
        };
        let mut search = Search::new(rest, target, limits, window);
        let Some(begin) = search.point(state) else { continue };
        let (at, cause) = search.approach(begin);
        let at = search.spend(at, ROUNDS);
        equilibria += search.equilibria;
        found.push(search.answer(at, cause));
        if agreeing(&found) >= AGREED {
            break;
        }
    }
    // Those that reach it by margin, then the others by what they are off by.
    found.sort_by(|a, b| {
        let reached = |x: &Inverse| x.shortfall.is_none();
        let by_margin = b.margin.smooth.total_cmp(&a.margin.smooth);
        let within = reached(a) && reached(b);
        reached(b).cmp(&reached(a)).then(if within { by_margin } else { a.residual.total_cmp(&b.residual) })
    });
    // The first whose straight ramp from rest is stable and leads to the same plate.
    for candidate in &mut found {
        match rest.ramp(rest.state(), &candidate.pressures) {
            Ok(state) if same(rest, &state, &candidate.state) => {
                return Ok(Inverse { equilibria, ..candidate.clone() });
            }
            Ok(_) => candidate.ramp = Some(Ended { end: End::Limit, pressures: candidate.pressures }),
            Err(ended) => candidate.ramp = Some(*ended),
        }
    }
    let best = found.into_iter().next().ok_or(PlanError::NoStart(first_end.unwrap_or(End::Limit)))?;
    Ok(Inverse { equilibria, ..best })
}

/// The pressures for `target` within a change of `reach` Pa from the equilibrium `start`, of whose branch the answer
/// is. A start outside the limits is led towards them as fast as `reach` allows.
///
/// # Errors
/// A target or limits that are none, a start that cannot be led into the limits.
pub fn warm(
    rest: &Rest<'_>,
    target: &Target,
    limits: &Limits,
    start: &State,
    reach: f64,
) -> Result<Inverse, PlanError> {
    target.check(rest)?;
    limits.check()?;
    if reach.is_nan() || reach <= 0.0 {
        return Err(PlanError::invalid("the reach (Pa)", reach, "must be positive"));
    }
    let at = pressures_of(start);
    let window = limits.around(&at, reach);
    let inside: [f64; 4] = std::array::from_fn(|i| at[i].clamp(window.low[i], window.high[i]));
    let state = match inside == at {
        true => start.clone(),
        false => rest.onward(start, &inside).map_err(|ended| PlanError::NoStart(ended.end))?,
    };
    let mut search = Search::new(rest, target, limits, window);
    let Some(begin) = search.point(state) else { return Err(PlanError::NoStart(End::Limit)) };
    let (at, cause) = search.approach(begin);
    let at = search.spend(at, 1);
    Ok(search.answer(at, cause))
}

/// The state that comes nearest to `target` from `start`, which is within the limits. The target is no more than a
/// direction: it is not checked, and nothing is spent on the margin beyond the limit.
pub(super) fn towards(rest: &Rest<'_>, target: &Target, limits: &Limits, start: &State) -> Result<State, PlanError> {
    let window = limits.around(&pressures_of(start), f64::INFINITY);
    let mut search = Search::new(rest, target, limits, window);
    let Some(begin) = search.point(start.clone()) else { return Err(PlanError::NoStart(End::Limit)) };
    Ok(search.approach(begin).0.state)
}

/// How many agree with the last of `found`.
fn agreeing(found: &[Inverse]) -> usize {
    let Some(last) = found.last() else { return 0 };
    let apart = |other: &Inverse| {
        let pairs = last.pressures.iter().zip(&other.pressures);
        pairs.fold(0.0, |far, (a, b)| f64::max(far, (a - b).abs()))
    };
    found.iter().filter(|other| apart(other) < ALIKE).count()
}

/// Two equilibria at the same pressures are one.
fn same(rest: &Rest<'_>, a: &State, b: &State) -> bool {
    let apart = (a.position() - b.position()).norm();
    apart < REACHED * rest.module().length() && a.rotation().angle_to(&b.rotation()) < REACHED
}

impl Search<'_> {
    fn answer(&self, at: Point, cause: Option<Shortfall>) -> Inverse {
        let (rotation_error, position_error) = self.target.off(&at.state);
        let active = self.window.active(&at.pressures);
        // A bound explains it if a kilopascal beyond would bring the plate nearer by something that counts.
        let slope = at.jacobian.tr_mul(&at.residual) * (1e3 / at.residual.norm());
        let pushed = |i: usize| match active[i] {
            Some(Bound::Low | Bound::SlewDown) => slope[i] > self.reached || self.window.fixed(i),
            Some(Bound::High | Bound::SlewUp) => slope[i] < -self.reached,
            None => false,
        };
        let cause = match cause {
            Some(Shortfall::Freedom) if (0..FREES).any(pushed) => Some(Shortfall::Bounds),
            cause => cause,
        };
        Inverse {
            pressures: at.pressures,
            position_error,
            rotation_error,
            residual: at.residual.norm(),
            margin: at.margin,
            active,
            shortfall: cause.filter(|_| at.residual.norm() > self.reached),
            equilibria: self.equilibria,
            ramp: None,
            state: at.state,
        }
    }
}

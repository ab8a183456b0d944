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

use nalgebra::{Matrix4, SymmetricEigen, Vector3, Vector4};

use super::end::pressures as pressures_of;
use super::limits::Window;
use super::quadratic::Quadratic;
use super::target::Jacobian;
use super::{Bound, End, Ended, FREES, Limits, Margin, PlanError, Rest, Target};
use crate::fem::module::State;

/// A target is reached within this share of the module's length: a tenth of what the rods' resolution is worth.
const REACHED: f64 = 1e-5;
/// Steps towards a target; far ones take ten, projections along a curved edge the most.
const STEPS: usize = 80;
/// A step that promises to come nearer by less than this share of that is none.
const FLAT: f64 = 0.1;
/// Pa: what no regulator can do.
const FINEST: f64 = 1.0;
/// Pa, the widest step from where a search begins.
const TRUST: f64 = 14e3;
/// Eigenvalues of the squared Jacobian below this share of the largest are freedoms that the target leaves.
const FREE: f64 = 1e-7;
/// Keeps steps along such freedoms at nothing; a share of the squared Jacobian's trace.
const DAMPING: f64 = 1e-10;
/// Half the width, Pa, of the margin's differences.
const DIFFERENCE: f64 = 200.0;
/// Pa, the longest step along a freedom.
const SPEND: f64 = 7e3;
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

/// An equilibrium seen from the target.
#[derive(Clone)]
struct Point {
    pressures: [f64; 4],
    state: State,
    residual: nalgebra::Vector6<f64>,
    jacobian: Jacobian,
    margin: Margin,
}

impl Point {
    fn vector(&self) -> Vector4<f64> {
        Vector4::from(self.pressures)
    }
}

/// One search.
struct Search<'a> {
    rest: &'a Rest<'a>,
    target: &'a Target,
    limits: &'a Limits,
    window: Window,
    /// Error that is none, m.
    reached: f64,
    equilibria: usize,
}

impl<'a> Search<'a> {
    fn new(rest: &'a Rest<'a>, target: &'a Target, limits: &'a Limits, window: Window) -> Search<'a> {
        Search { rest, target, limits, window, reached: REACHED * rest.module().length(), equilibria: 0 }
    }

    fn point(&self, state: State) -> Option<Point> {
        let (residual, jacobian) = (self.target.residual(&state), self.target.jacobian(&state)?);
        let margin = self.rest.margin(&state);
        Some(Point { pressures: pressures_of(&state), residual, jacobian, margin, state })
    }

    fn go(&mut self, from: &Point, step: &Vector4<f64>) -> Result<Point, Box<Ended>> {
        let to: [f64; 4] = std::array::from_fn(|i| {
            // On the bounds exactly, where it goes to them.
            (from.pressures[i] + step[i]).clamp(self.window.low[i], self.window.high[i])
        });
        self.equilibria += 1;
        let state = self.rest.onward(&from.state, &to)?;
        self.point(state).ok_or_else(|| Box::new(Ended { end: End::Limit, pressures: to }))
    }

    /// The bounds of a step from `at` within `trust`.
    fn room(&self, at: &Point, trust: f64) -> (Vector4<f64>, Vector4<f64>) {
        let of = |bound: &[f64; 4]| (Vector4::from(*bound) - at.vector()).map(|x| x.clamp(-trust, trust));
        (of(&self.window.low).map(|x| x.min(0.0)), of(&self.window.high).map(|x| x.max(0.0)))
    }

    /// To the target, or as near as it gets and why not on.
    fn approach(&mut self, mut at: Point) -> (Point, Option<Shortfall>) {
        let mut trust = TRUST;
        let (mut slope, mut shift) = (None, 0.0);
        let mut stopped = None;
        for _ in 0..STEPS {
            if at.residual.norm() <= self.reached {
                return (at, None);
            }
            let square = at.jacobian.tr_mul(&at.jacobian);
            let h = square + Matrix4::identity() * (DAMPING * square.trace()).max(f64::MIN_POSITIVE);
            let (low, high) = self.room(&at, trust);
            let problem = Quadratic { h, g: at.jacobian.tr_mul(&at.residual), low, high };
            let floor = self.limits.margin.min(at.margin.smooth);
            let step = match &slope {
                Some(slope) => problem.beyond(slope, self.limits.margin + shift - at.margin.smooth),
                None => problem.least(),
            };
            let linear = (at.residual + at.jacobian * step).norm_squared();
            let promised = 0.5 * (at.residual.norm_squared() - linear);
            if promised <= FLAT * self.reached * at.residual.norm() || step.amax() < FINEST {
                break;
            }
            match self.go(&at, &step) {
                Ok(next) if next.margin.smooth < floor => {
                    // First learn where the margin falls, then keep off by what the plane missed.
                    if slope.is_none() {
                        slope = Some(self.slope(&at));
                    } else {
                        shift += 1.5 * (floor - next.margin.smooth);
                        trust = 0.5 * step.amax();
                    }
                    stopped = Some(Shortfall::Margin);
                }
                Ok(next) => {
                    let gained = 0.5 * (at.residual.norm_squared() - next.residual.norm_squared());
                    if gained < 0.25 * promised {
                        trust = 0.5 * step.amax();
                    } else if gained > 0.75 * promised {
                        trust = trust.max(2.0 * step.amax());
                    }
                    if gained > 1e-3 * promised {
                        at = next;
                        (stopped, shift) = (slope.is_some().then_some(Shortfall::Margin), 0.0);
                        if slope.is_some() {
                            slope = (at.margin.smooth < self.limits.margin + 0.1).then(|| self.slope(&at));
                        }
                    }
                }
                Err(ended) => {
                    stopped = Some(Shortfall::Ends(*ended));
                    trust = 0.5 * step.amax();
                }
            }
            if trust < FINEST {
                break;
            }
        }
        (at, stopped.or(Some(Shortfall::Freedom)))
    }

    /// The smooth margin's derivative by the pressures, by differences into the box; zero where a channel cannot move.
    fn slope(&mut self, at: &Point) -> Vector4<f64> {
        let (low, high) = self.room(at, DIFFERENCE);
        Vector4::from_fn(|i, _| {
            let by = if high[i] >= -low[i] { high[i] } else { low[i] };
            if by.abs() < 0.1 * DIFFERENCE {
                return 0.0;
            }
            let mut step = Vector4::zeros();
            step[i] = by;
            self.go(at, &step).map_or(0.0, |next| (next.margin.smooth - at.margin.smooth) / by)
        })
    }

    /// Along what a reached target leaves free to the largest margin.
    fn spend(&mut self, mut at: Point, rounds: usize) -> Point {
        if at.residual.norm() > self.reached {
            return at;
        }
        for _ in 0..rounds {
            let Some(way) = self.freedom(&at) else { break };
            let Some(length) = self.best(&at, &way) else { break };
            let mut share = 1.0;
            let mut gained = None;
            while share > 0.1 && gained.is_none() {
                gained = self.go(&at, &(way * (length * share))).ok().and_then(|next| self.settled(next, &at));
                share *= 0.4;
            }
            let Some(next) = gained else { break };
            at = next;
            if length.abs() < 10.0 * FINEST {
                break;
            }
        }
        at
    }

    /// `moved` led back onto the target; none where it has less margin than `from`.
    fn settled(&mut self, moved: Point, from: &Point) -> Option<Point> {
        let at = if moved.residual.norm() > self.reached { self.approach(moved).0 } else { moved };
        (at.residual.norm() <= self.reached && at.margin.smooth >= from.margin.smooth).then_some(at)
    }

    /// The unit direction of pressures that leaves the target alone and along which the margin grows the most, without
    /// leaving the box; its sign is no one's.
    fn freedom(&mut self, at: &Point) -> Option<Vector4<f64>> {
        let (low, high) = self.room(at, SPEND);
        let mut jacobian = at.jacobian;
        let mut held: [bool; FREES] = std::array::from_fn(|i| high[i] - low[i] < 2.0 * DIFFERENCE);
        let mut slope = None;
        for _ in 0..FREES {
            for (i, mut column) in jacobian.column_iter_mut().enumerate() {
                if held[i] {
                    column.fill(0.0);
                }
            }
            let eigen = SymmetricEigen::new(jacobian.tr_mul(&jacobian));
            let largest = eigen.eigenvalues.max();
            let free: Vec<Vector4<f64>> = (0..FREES)
                .filter(|i| eigen.eigenvalues[*i] <= FREE * largest)
                .map(|i| eigen.eigenvectors.column(i).into_owned())
                // The held channels' own directions are in the null space too.
                .map(|v| Vector4::from_fn(|i, _| if held[i] { 0.0 } else { v[i] }))
                .filter(|v| v.norm() > 0.5)
                .collect();
            if free.is_empty() {
                return None;
            }
            if let [way] = free[..] {
                // Which way it goes is for the margin to say, if the box leaves any.
                let (shortest, longest) = reach(&way, &low, &high);
                return (longest - shortest >= 2.0 * DIFFERENCE).then(|| way.normalize());
            }
            let slope = *slope.get_or_insert_with(|| self.slope(at));
            let uphill: Vector4<f64> = free.iter().map(|v| v * (v.dot(&slope) / v.norm_squared())).sum();
            if uphill.norm() == 0.0 {
                return None;
            }
            let way = uphill.normalize();
            // A channel that this would push out of the box at once is held instead.
            let room = |i: usize| if way[i] > 0.0 { high[i] } else { -low[i] };
            match (0..FREES).find(|i| way[*i].abs() > 1e-6 && room(*i) < FINEST) {
                Some(i) => held[i] = true,
                None => return Some(way),
            }
        }
        None
    }

    /// How far along `way` the margin is the largest, by a parabola through three points; none where the box leaves no
    /// room or it is here.
    fn best(&mut self, at: &Point, way: &Vector4<f64>) -> Option<f64> {
        let (low, high) = self.room(at, SPEND);
        let (shortest, longest) = reach(way, &low, &high);
        if longest - shortest < 2.0 * DIFFERENCE {
            return None;
        }
        let middle = 0f64.clamp(shortest + DIFFERENCE, longest - DIFFERENCE);
        let mut margin = |t: f64| match t {
            0.0 => Some(at.margin.smooth),
            t => self.go(at, &(way * t)).ok().map(|next| next.margin.smooth),
        };
        let (below, here, above) = (margin(middle - DIFFERENCE)?, margin(middle)?, margin(middle + DIFFERENCE)?);
        let rise = 0.5 * (above - below) / DIFFERENCE;
        let bend = (above - 2.0 * here + below) / (DIFFERENCE * DIFFERENCE);
        let top = if bend < 0.0 {
            middle - rise / bend
        } else if rise > 0.0 {
            longest
        } else {
            shortest
        };
        let length = top.clamp(shortest, longest);
        (length.abs() > FINEST).then_some(length)
    }

    fn answer(&self, at: Point, cause: Option<Shortfall>) -> Inverse {
        let (rotation_error, position_error) = self.target.off(&at.state);
        let active = self.window.active(&at.pressures);
        // Bounds that hold explain a shortfall before a want of freedom does.
        let cause = match cause {
            Some(Shortfall::Freedom) if active.iter().any(Option::is_some) => Some(Shortfall::Bounds),
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

/// From where to where along `way` a step stays in the box: at most 0 and at least 0.
fn reach(way: &Vector4<f64>, low: &Vector4<f64>, high: &Vector4<f64>) -> (f64, f64) {
    let (mut shortest, mut longest) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..FREES {
        if way[i].abs() > 1e-9 {
            let (a, b) = (low[i] / way[i], high[i] / way[i]);
            shortest = shortest.max(a.min(b));
            longest = longest.min(a.max(b));
        }
    }
    (shortest.min(0.0), longest.max(0.0))
}

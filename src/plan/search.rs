//! The way to a target: Gauss and Newton's method among the pressures allowed.

use nalgebra::{Matrix4, Vector4, Vector6};

use super::end::pressures as pressures_of;
use super::inverse::Shortfall;
use super::limits::Window;
use super::quadratic::Quadratic;
use super::target::Jacobian;
use super::{End, Ended, Limits, Margin, Rest, Target};
use crate::fem::module::State;

/// A target is reached within this share of the module's length: a tenth of what the rods' resolution is worth.
pub(super) const REACHED: f64 = 1e-5;
/// Steps towards a target; far ones take ten, projections along a curved edge the most.
const STEPS: usize = 80;
/// A step that promises to come nearer by less than this share of that is none.
const FLAT: f64 = 0.1;
/// Pa: what no regulator can do.
pub(super) const FINEST: f64 = 1.0;
/// Pa, the widest step from where a search begins.
const TRUST: f64 = 14e3;
/// Keeps steps along what the target leaves free at nothing; a share of the squared Jacobian's trace.
const DAMPING: f64 = 1e-10;
/// Half the width, Pa, of the margin's differences.
pub(super) const DIFFERENCE: f64 = 200.0;

/// An equilibrium seen from the target.
#[derive(Clone)]
pub(super) struct Point {
    pub pressures: [f64; 4],
    pub state: State,
    pub residual: Vector6<f64>,
    pub jacobian: Jacobian,
    pub margin: Margin,
}

impl Point {
    pub fn vector(&self) -> Vector4<f64> {
        Vector4::from(self.pressures)
    }
}

/// One search.
pub(super) struct Search<'a> {
    rest: &'a Rest<'a>,
    pub target: &'a Target,
    limits: &'a Limits,
    pub window: Window,
    /// Error that is none, m.
    pub reached: f64,
    /// Equilibria that it took.
    pub equilibria: usize,
}

impl<'a> Search<'a> {
    pub fn new(rest: &'a Rest<'a>, target: &'a Target, limits: &'a Limits, window: Window) -> Search<'a> {
        Search { rest, target, limits, window, reached: REACHED * rest.module().length(), equilibria: 0 }
    }

    pub fn point(&self, state: State) -> Option<Point> {
        let (residual, jacobian) = (self.target.residual(&state), self.target.jacobian(&state)?);
        let margin = self.rest.margin(&state);
        Some(Point { pressures: pressures_of(&state), residual, jacobian, margin, state })
    }

    pub fn go(&mut self, from: &Point, step: &Vector4<f64>) -> Result<Point, Box<Ended>> {
        let to: [f64; 4] = std::array::from_fn(|i| {
            // On the bounds exactly, where it goes to them.
            (from.pressures[i] + step[i]).clamp(self.window.low[i], self.window.high[i])
        });
        self.equilibria += 1;
        let state = self.rest.onward(&from.state, &to)?;
        self.point(state).ok_or_else(|| Box::new(Ended { end: End::Limit, pressures: to }))
    }

    /// The bounds of a step from `at` within `trust`.
    pub fn room(&self, at: &Point, trust: f64) -> (Vector4<f64>, Vector4<f64>) {
        let of = |bound: &[f64; 4]| (Vector4::from(*bound) - at.vector()).map(|x| x.clamp(-trust, trust));
        (of(&self.window.low).map(|x| x.min(0.0)), of(&self.window.high).map(|x| x.max(0.0)))
    }

    /// To the target, or as near as it gets and why not on.
    pub fn approach(&mut self, mut at: Point) -> (Point, Option<Shortfall>) {
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
            let promise = |step: &Vector4<f64>| {
                0.5 * (at.residual.norm_squared() - (at.residual + at.jacobian * step).norm_squared())
            };
            let flat =
                |step: &Vector4<f64>| promise(step) <= FLAT * self.reached * at.residual.norm() || step.amax() < FINEST;
            if flat(&step) {
                // What would get on without the margin's plane is held by the margin.
                if slope.is_some() && !flat(&problem.least()) {
                    stopped = Some(Shortfall::Margin);
                }
                break;
            }
            let promised = promise(&step);
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
                        (stopped, shift) = (None, 0.0);
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
    pub fn slope(&mut self, at: &Point) -> Vector4<f64> {
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
}

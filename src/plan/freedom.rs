//! What a reached target leaves free, and the margin that is made of it.

use nalgebra::{SymmetricEigen, Vector4};

use super::FREES;
use super::search::{DIFFERENCE, FINEST, Point, Search};

/// Eigenvalues of the squared Jacobian below this share of the largest are freedoms that the target leaves.
const FREE: f64 = 1e-7;
/// Pa, the longest step along a freedom.
const SPEND: f64 = 7e3;

impl Search<'_> {
    /// Along what a reached target leaves free to the largest margin.
    pub fn spend(&mut self, mut at: Point, rounds: usize) -> Point {
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

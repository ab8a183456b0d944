//! The least of a convex quadratic function of four variables in a box, and beyond a plane.

use nalgebra::{Matrix4, Vector4};

/// Changes of the active set: each of its 81 is met at most once.
const CHANGES: usize = 81;
/// Doublings and halvings of the plane's multiplier.
const SEARCHES: usize = 60;

/// `x.H x / 2 + g.x` with H positive definite, over `low <= x <= high` (which contain 0).
pub(super) struct Quadratic {
    pub h: Matrix4<f64>,
    pub g: Vector4<f64>,
    pub low: Vector4<f64>,
    pub high: Vector4<f64>,
}

impl Quadratic {
    /// Its least point.
    pub fn least(&self) -> Vector4<f64> {
        self.tilted(&self.g)
    }

    /// The least point with `a.x >= b`; where the box has none, the one that comes nearest.
    pub fn beyond(&self, a: &Vector4<f64>, b: f64) -> Vector4<f64> {
        let free = self.least();
        let a_norm = a.amax();
        if a.dot(&free) >= b || a_norm == 0.0 {
            return free;
        }
        // a.x rises with the plane's multiplier.
        let at = |multiplier: f64| self.tilted(&(self.g - a * multiplier));
        let (mut low, mut high) = (0.0, self.g.amax().max(f64::MIN_POSITIVE) / a_norm);
        for _ in 0..SEARCHES {
            if a.dot(&at(high)) >= b {
                break;
            }
            (low, high) = (high, 2.0 * high);
        }
        for _ in 0..SEARCHES {
            let middle = 0.5 * (low + high);
            if a.dot(&at(middle)) >= b { high = middle } else { low = middle }
        }
        at(high)
    }

    /// With `g` in place of its own: the active-set method.
    fn tilted(&self, g: &Vector4<f64>) -> Vector4<f64> {
        let mut x = Vector4::zeros();
        let mut held = [false; 4];
        for _ in 0..CHANGES {
            let gradient = self.h * x + g;
            // Newton's step of the free variables: the held ones' rows and columns are the identity's.
            let (mut h, mut right) = (self.h, -gradient);
            for i in (0..4).filter(|i| held[*i]) {
                h.fill_row(i, 0.0);
                h.fill_column(i, 0.0);
                h[(i, i)] = 1.0;
                right[i] = 0.0;
            }
            let Some(step) = h.cholesky().map(|c| c.solve(&right)) else { return x };
            let (mut share, mut blocking) = (1.0, None);
            for i in (0..4).filter(|i| !held[*i]) {
                let room = if step[i] > 0.0 { self.high[i] - x[i] } else { self.low[i] - x[i] };
                if step[i] != 0.0 && room / step[i] < share {
                    (share, blocking) = (room / step[i], Some(i));
                }
            }
            x += step * share;
            if let Some(i) = blocking {
                x[i] = if step[i] > 0.0 { self.high[i] } else { self.low[i] };
                held[i] = true;
                continue;
            }
            // At the least point of this face: let go of what is pushed the most inwards.
            let gradient = self.h * x + g;
            let inwards = |i: usize| if x[i] >= self.high[i] { gradient[i] } else { -gradient[i] };
            let scale = 1e-12 * g.amax();
            let fixed = |i: usize| self.low[i] == self.high[i];
            let most = (0..4).filter(|i| held[*i] && !fixed(*i)).max_by(|a, b| inwards(*a).total_cmp(&inwards(*b)));
            match most {
                Some(i) if inwards(i) > scale => held[i] = false,
                _ => return x,
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn no_point_of_the_box_is_lower_and_none_beyond_the_plane() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut vector = |size: f64| Vector4::from_fn(|_, _| random.random_range(-size..size));
        for k in 0..200 {
            let columns = [vector(1.0), vector(1.0), vector(1.0)];
            let h = columns.iter().map(|c| c * c.transpose()).sum::<Matrix4<f64>>() + Matrix4::identity() * 1e-6;
            let mut q = Quadratic { h, g: vector(1.0), low: -vector(1.0).abs(), high: vector(1.0).abs() };
            if k % 5 == 0 {
                (q.low[1], q.high[1]) = (0.0, 0.0);
            }
            let value = |x: &Vector4<f64>| 0.5 * x.dot(&(q.h * x)) + q.g.dot(x);
            let a = vector(1.0);
            let corner = Vector4::from_fn(|i, _| if a[i] > 0.0 { q.high[i] } else { q.low[i] });
            let b = 0.5 * a.dot(&corner);
            let (free, beyond) = (q.least(), q.beyond(&a, b));
            assert!(a.dot(&beyond) >= b - 1e-9);
            for _ in 0..300 {
                let share = vector(0.5).add_scalar(0.5);
                let x = q.low + share.component_mul(&(q.high - q.low));
                assert!(value(&x) >= value(&free) - 1e-9);
                assert!(a.dot(&x) < b || value(&x) >= value(&beyond) - 1e-6, "{k}");
            }
        }
    }
}

//! The rigid cap at the tip: six coordinates that carry the nodes of the last face.
//!
//! In the frame that has turned with the tip, a node at r from the cap's centre is at `y = c + d + Q(w) r` with
//! the displacement d, and the tilt `Q = exp(w x)`, `w = (w_x, w_y, 0)`; the turn phi about z is that of the
//! frame. Together they are a finite displacement and a finite rotation.

use nalgebra::{Matrix3, SMatrix, Vector3};

/// Coordinates of the cap: turn phi about z, then displacement z, x, y, then tilt x, y.
pub const COORDINATES: usize = 6;
/// Index of the turn.
pub const TURN: usize = 0;
/// Index of the axial displacement.
pub const AXIAL: usize = 1;
/// Indices of the lateral displacement.
pub const LATERAL: [usize; 2] = [2, 3];
/// Indices of the tilt.
pub const TILT: [usize; 2] = [4, 5];

/// The cap's coordinates, in the units of the body.
pub type Coordinates = [f64; COORDINATES];

/// The tilt and its derivatives.
pub struct Tilt {
    /// Q.
    pub rotation: Matrix3<f64>,
    /// dQ / dw_i.
    pub first: [Matrix3<f64>; 2],
    /// d2Q / dw_i dw_j.
    pub second: [[Matrix3<f64>; 2]; 2],
}

fn spin(x: f64, y: f64) -> Matrix3<f64> {
    Matrix3::new(0.0, 0.0, y, 0.0, 0.0, -x, -y, x, 0.0)
}

/// sum_k (-s)^k / (2k + offset)! and its first two derivatives by s: sin(t)/t for offset 1, (1 - cos t)/t^2 for 2.
fn series(s: f64, offset: u32) -> [f64; 3] {
    let mut sum = [0.0; 3];
    let mut coefficient = 1.0 / f64::from(offset);
    let mut powers = [1.0, 0.0, 0.0];
    for k in 0..40_u32 {
        let n = f64::from(k);
        sum[0] += coefficient * powers[0];
        sum[1] += coefficient * n * powers[1];
        sum[2] += coefficient * n * (n - 1.0) * powers[2];
        powers = [powers[0] * s, powers[0], powers[1]];
        let next = 2.0 * n + f64::from(offset);
        coefficient *= -1.0 / ((next + 1.0) * (next + 2.0));
    }
    sum
}

impl Tilt {
    /// The tilt of the cap, |w| below pi.
    pub fn of(q: &Coordinates) -> Tilt {
        let w = [q[TILT[0]], q[TILT[1]]];
        let s = w[0] * w[0] + w[1] * w[1];
        let ([a, a1, a2], [b, b1, b2]) = (series(s, 1), series(s, 2));
        let (m, e) = (spin(w[0], w[1]), [spin(1.0, 0.0), spin(0.0, 1.0)]);
        let square = m * m;
        let pair = |i: usize| e[i] * m + m * e[i];
        let second = |i: usize, j: usize| {
            let same = if i == j { 2.0 } else { 0.0 };
            let product = 4.0 * w[i] * w[j];
            m * (same * a1 + product * a2)
                + (e[i] * w[j] + e[j] * w[i]) * (2.0 * a1)
                + square * (same * b1 + product * b2)
                + (pair(j) * w[i] + pair(i) * w[j]) * (2.0 * b1)
                + (e[i] * e[j] + e[j] * e[i]) * b
        };
        Tilt {
            rotation: Matrix3::identity() + m * a + square * b,
            first: std::array::from_fn(|i| m * (2.0 * w[i] * a1) + e[i] * a + square * (2.0 * w[i] * b1) + pair(i) * b),
            second: std::array::from_fn(|i| std::array::from_fn(|j| second(i, j))),
        }
    }

    /// dy / dq of a node at `arm` from the centre.
    pub fn slope(&self, arm: &Vector3<f64>) -> SMatrix<f64, 3, COORDINATES> {
        let mut slope = SMatrix::<f64, 3, COORDINATES>::zeros();
        slope[(2, AXIAL)] = 1.0;
        slope[(0, LATERAL[0])] = 1.0;
        slope[(1, LATERAL[1])] = 1.0;
        for i in 0..2 {
            slope.set_column(TILT[i], &(self.first[i] * arm));
        }
        slope
    }

    /// Displacement of the centre.
    pub fn displacement(q: &Coordinates) -> Vector3<f64> {
        Vector3::new(q[LATERAL[0]], q[LATERAL[1]], q[AXIAL])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn the_tilt_is_the_rotation_by_its_vector_and_its_derivatives_are_exact() {
        for w in [[0.0, 0.0], [1e-4, -2e-4], [0.3, -0.7], [2.0, 1.5]] {
            let q = |x: f64, y: f64| [0.0, 0.0, 0.0, 0.0, w[0] + x, w[1] + y];
            let tilt = Tilt::of(&q(0.0, 0.0));
            let exact = Rotation3::from_scaled_axis(Vector3::new(w[0], w[1], 0.0));
            assert!((tilt.rotation - exact.matrix()).norm() < 1e-14);
            let h = 1e-5;
            for i in 0..2 {
                let at = |s: f64| Tilt::of(&if i == 0 { q(s, 0.0) } else { q(0.0, s) });
                let (plus, minus) = (at(h), at(-h));
                assert!(((plus.rotation - minus.rotation) / (2.0 * h) - tilt.first[i]).norm() < 1e-9);
                for j in 0..2 {
                    assert!(((plus.first[j] - minus.first[j]) / (2.0 * h) - tilt.second[i][j]).norm() < 1e-9);
                }
            }
        }
    }
}

//! Principal values of a symmetric matrix, and functions of them that are exact where they coincide.

use nalgebra::{Matrix3, Vector3};

/// sinh(x) / x.
pub fn sinhc(x: f64) -> f64 {
    if x.abs() < 0.2 {
        let s = x * x;
        1.0 + s / 6.0 * (1.0 + s / 20.0 * (1.0 + s / 42.0 * (1.0 + s / 72.0 * (1.0 + s / 110.0))))
    } else {
        x.sinh() / x
    }
}

/// (exp(x) - 1) / x.
pub fn expc(x: f64) -> f64 {
    if x.abs() < 1e-5 { 1.0 + x / 2.0 + x * x / 6.0 } else { x.exp_m1() / x }
}

/// (exp(x) - 1 - x) / x^2.
pub fn expc2(x: f64) -> f64 {
    if x.abs() < 0.5 {
        // Taylor series: the twelfth term is below 1e-17 here.
        let mut term = 0.5;
        let mut sum = 0.5;
        for k in 3..16 {
            term *= x / f64::from(k);
            sum += term;
        }
        sum
    } else {
        (x.exp_m1() - x) / (x * x)
    }
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations: accurate to round-off
/// for coincident eigenvalues too.
pub fn eigen(matrix: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
    let mut a = *matrix;
    let mut v = Matrix3::identity();
    let scale = a.norm_squared();
    for _ in 0..30 {
        let off = a[(0, 1)] * a[(0, 1)] + a[(0, 2)] * a[(0, 2)] + a[(1, 2)] * a[(1, 2)];
        if off <= 1e-34 * scale {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let apq = a[(p, q)];
            if apq == 0.0 {
                continue;
            }
            let theta = (a[(q, q)] - a[(p, p)]) / (2.0 * apq);
            // Squares that overflow leave t = 0, which is what they should.
            let t = 1.0_f64.copysign(theta) / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let r = 3 - p - q;
            let (arp, arq) = (a[(r, p)], a[(r, q)]);
            a[(p, p)] -= t * apq;
            a[(q, q)] += t * apq;
            a[(p, q)] = 0.0;
            a[(q, p)] = 0.0;
            a[(r, p)] = c * arp - s * arq;
            a[(p, r)] = a[(r, p)];
            a[(r, q)] = s * arp + c * arq;
            a[(q, r)] = a[(r, q)];
            for i in 0..3 {
                let (vip, viq) = (v[(i, p)], v[(i, q)]);
                v[(i, p)] = c * vip - s * viq;
                v[(i, q)] = s * vip + c * viq;
            }
        }
    }
    (Vector3::new(a[(0, 0)], a[(1, 1)], a[(2, 2)]), v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_functions_are_continuous_across_the_ends_of_their_series() {
        // Where the series ends the other form has lost at most 1e-16 / x^2 of its digits.
        for (at, f) in [(0.2, sinhc as fn(f64) -> f64), (1e-5, expc), (0.5, expc2)] {
            for x in [at, -at] {
                let (inside, outside) = (f(x * (1.0 - 1e-12)), f(x * (1.0 + 1e-12)));
                let rounding = 1e-12 * at + 4.0 * f64::EPSILON / (at * at).min(at);
                assert!((inside - outside).abs() < rounding, "{at} {x} {inside} {outside}");
            }
        }
    }

    #[test]
    fn principal_values_and_axes_put_the_matrix_together_again_also_where_they_coincide() {
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.8, 2.0);
        for values in [[1.0, 2.0, 5.0], [3.0, 3.0, 1.0], [2.0, 2.0, 2.0], [1e-6, 1.0, 1e6]] {
            let matrix = turn.matrix() * Matrix3::from_diagonal(&values.into()) * turn.matrix().transpose();
            let (found, axes) = eigen(&matrix);
            let again = axes * Matrix3::from_diagonal(&found) * axes.transpose();
            let size = values.iter().fold(0.0_f64, |most, v| most.max(*v));
            assert!((again - matrix).norm() < 1e-14 * size, "{values:?}");
        }
    }
}

//! Rigid motions as rotations over dual numbers.
//!
//! With `e^2 = 0`, a twist (w, v) is the dual vector `w + e v`, a pose (R, p) the dual rotation `(1 + e [p]) R`, and a
//! wrench (m, f) the dual vector `f + e m`, so that its work on a twist, `f.v + m.w`, is the e-part of their scalar
//! product. Then the bracket of se(3) is the cross product, and its exponential, the exponential's derivatives and
//! the change of frames are the formulas of so(3) word for word: half the code, and half the multiplications, of
//! 6 x 6 matrices.
//!
//! With `x = t.t` and Stumpff's functions `c_k(x) = sum_j (-x)^j / (2 j + k)!`, `c_k' = (k c_{k+2} - c_{k+1}) / 2`:
//!
//! ```text
//!     exp(t)     = 1 + c1 [t] + c2 [t]^2
//!     dexp(t) u  = u + c2 t x u + c3 t x (t x u)            (d exp(t)) exp(-t) = [dexp(t) dt]
//! ```

use std::ops::{Add, AddAssign, Mul, Sub};

use nalgebra::{Matrix3, Vector3};

/// `re + e du`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Dual {
    pub re: f64,
    pub du: f64,
}

/// A twist `angular + e linear`, or a wrench `force + e moment`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DualVector {
    pub re: Vector3<f64>,
    pub du: Vector3<f64>,
}

/// A linear map of dual vectors: a dual rotation (pose) among others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DualMatrix {
    pub re: Matrix3<f64>,
    pub du: Matrix3<f64>,
}

impl Dual {
    fn scaled(self, s: f64) -> Dual {
        Dual { re: s * self.re, du: s * self.du }
    }
}

impl Add for Dual {
    type Output = Dual;
    fn add(self, o: Dual) -> Dual {
        Dual { re: self.re + o.re, du: self.du + o.du }
    }
}

impl Mul for Dual {
    type Output = Dual;
    fn mul(self, o: Dual) -> Dual {
        Dual { re: self.re * o.re, du: self.re * o.du + self.du * o.re }
    }
}

impl DualVector {
    pub const ZERO: DualVector = DualVector { re: Vector3::new(0.0, 0.0, 0.0), du: Vector3::new(0.0, 0.0, 0.0) };

    pub fn dot(&self, o: &DualVector) -> Dual {
        Dual { re: self.re.dot(&o.re), du: self.re.dot(&o.du) + self.du.dot(&o.re) }
    }

    /// Work of a wrench on a twist.
    #[cfg(test)]
    pub fn work(&self, o: &DualVector) -> f64 {
        self.dot(o).du
    }

    pub fn cross(&self, o: &DualVector) -> DualVector {
        DualVector { re: self.re.cross(&o.re), du: self.re.cross(&o.du) + self.du.cross(&o.re) }
    }

    pub fn scaled(&self, s: f64) -> DualVector {
        DualVector { re: self.re * s, du: self.du * s }
    }

    fn times(&self, s: Dual) -> DualVector {
        DualVector { re: self.re * s.re, du: self.du * s.re + self.re * s.du }
    }

    /// `[self]`, the matrix of the cross product.
    pub fn skew(&self) -> DualMatrix {
        DualMatrix { re: skew(&self.re), du: skew(&self.du) }
    }

    /// `self o^T + o self^T`.
    fn symmetric_product(&self, o: &DualVector) -> DualMatrix {
        let re = self.re * o.re.transpose();
        let du = self.re * o.du.transpose() + self.du * o.re.transpose();
        DualMatrix { re: re + re.transpose(), du: du + du.transpose() }
    }
}

impl Add for DualVector {
    type Output = DualVector;
    fn add(self, o: DualVector) -> DualVector {
        DualVector { re: self.re + o.re, du: self.du + o.du }
    }
}

impl Sub for DualVector {
    type Output = DualVector;
    fn sub(self, o: DualVector) -> DualVector {
        DualVector { re: self.re - o.re, du: self.du - o.du }
    }
}

impl AddAssign for DualVector {
    fn add_assign(&mut self, o: DualVector) {
        self.re += o.re;
        self.du += o.du;
    }
}

impl DualMatrix {
    pub const ZERO: DualMatrix = DualMatrix {
        re: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        du: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    pub fn identity() -> DualMatrix {
        DualMatrix { re: Matrix3::identity(), du: Matrix3::zeros() }
    }

    /// The pose that turns by `rotation` and carries the origin to `position`.
    pub fn pose(rotation: Matrix3<f64>, position: &Vector3<f64>) -> DualMatrix {
        DualMatrix { re: rotation, du: skew(position) * rotation }
    }

    /// Where the pose carries the origin.
    pub fn position(&self) -> Vector3<f64> {
        let s = self.du * self.re.transpose();
        Vector3::new(s[(2, 1)] - s[(1, 2)], s[(0, 2)] - s[(2, 0)], s[(1, 0)] - s[(0, 1)]) * 0.5
    }

    /// The inverse of a pose.
    pub fn transpose(&self) -> DualMatrix {
        DualMatrix { re: self.re.transpose(), du: self.du.transpose() }
    }

    #[cfg(test)]
    pub fn apply(&self, v: &DualVector) -> DualVector {
        DualVector { re: self.re * v.re, du: self.re * v.du + self.du * v.re }
    }

    #[inline]
    pub fn transpose_apply(&self, v: &DualVector) -> DualVector {
        DualVector { re: self.re.tr_mul(&v.re), du: self.re.tr_mul(&v.du) + self.du.tr_mul(&v.re) }
    }

    /// `self^T o`.
    #[inline]
    pub fn transpose_mul(&self, o: &DualMatrix) -> DualMatrix {
        DualMatrix { re: self.re.tr_mul(&o.re), du: self.re.tr_mul(&o.du) + self.du.tr_mul(&o.re) }
    }

    #[inline]
    pub fn scaled(&self, s: f64) -> DualMatrix {
        DualMatrix { re: self.re * s, du: self.du * s }
    }

    /// `self += s o`.
    #[inline]
    pub fn add_scaled(&mut self, s: f64, o: &DualMatrix) {
        self.re += o.re * s;
        self.du += o.du * s;
    }
}

impl Add for DualMatrix {
    type Output = DualMatrix;
    #[inline]
    fn add(self, o: DualMatrix) -> DualMatrix {
        DualMatrix { re: self.re + o.re, du: self.du + o.du }
    }
}

impl Mul for DualMatrix {
    type Output = DualMatrix;
    #[inline]
    fn mul(self, o: DualMatrix) -> DualMatrix {
        DualMatrix { re: self.re * o.re, du: self.re * o.du + self.du * o.re }
    }
}

pub(crate) fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Largest angle |t| for which [`Exponential`] is exact to rounding, rad; more than half a turn.
pub(crate) const MAX_ANGLE: f64 = 3.4;

/// The exponential of a twist t and what its first two derivatives need.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exponential {
    t: DualVector,
    /// t.t
    x: Dual,
    c1: Dual,
    c2: Dual,
    c3: Dual,
    /// dc2/dx and dc3/dx.
    slope: [Dual; 2],
}

impl Exponential {
    /// For angles up to [`MAX_ANGLE`].
    pub fn new(t: DualVector) -> Exponential {
        let x = t.dot(&t);
        let c = stumpff(x.re);
        let slope = |k: usize| 0.5 * (k as f64 * c[k + 2] - c[k + 1]);
        // c(x.re + e x.du) = c + e c' x.du
        let dual = |k: usize| Dual { re: c[k], du: slope(k) * x.du };
        // The same for c_k' = (k c_{k+2} - c_{k+1}) / 2.
        let dual_slope = |k: usize| Dual { re: slope(k), du: 0.5 * (k as f64 * slope(k + 2) - slope(k + 1)) * x.du };
        Exponential { t, x, c1: dual(1), c2: dual(2), c3: dual(3), slope: [dual_slope(2), dual_slope(3)] }
    }

    /// `1 + a [t] + b [t]^2`, with `[t]^2 = t t^T - x`.
    fn polynomial(&self, a: Dual, b: Dual) -> DualMatrix {
        let at = self.t.times(a);
        let bt = self.t.times(b);
        let diagonal = Dual { re: 1.0, du: 0.0 } + (b * self.x).scaled(-1.0);
        let tt = bt.re * self.t.re.transpose();
        let td = bt.re * self.t.du.transpose() + bt.du * self.t.re.transpose();
        DualMatrix {
            re: skew(&at.re) + tt + Matrix3::from_diagonal_element(diagonal.re),
            du: skew(&at.du) + td + Matrix3::from_diagonal_element(diagonal.du),
        }
    }

    /// exp(t).
    pub fn pose(&self) -> DualMatrix {
        self.polynomial(self.c1, self.c2)
    }

    /// dexp(t): the spatial twist of exp(t) by a change of t.
    pub fn derivative(&self) -> DualMatrix {
        self.polynomial(self.c2, self.c3)
    }

    /// The symmetric part M of `w . d(dexp(t) u)[v] = u^T M v` for the wrench w.
    ///
    /// From `a v x u + b (v x (t x u) + t x (v x u)) + 2 (t.v) (a' t x u + b' t x (t x u))` with a = c2, b = c3; the
    /// antisymmetric rest is that of the bracket (Maurer-Cartan).
    pub fn second_derivative(&self, w: &DualVector) -> DualMatrix {
        let [a_slope, b_slope] = self.slope;
        let wt = w.dot(&self.t);
        let mixed = (self.c3.scaled(0.5) + b_slope * self.x).scaled(-1.0);
        let partner = w.times(mixed) + w.cross(&self.t).times(a_slope) + self.t.times(b_slope * wt);
        let mut m = partner.symmetric_product(&self.t);
        let diagonal = self.c3 * wt;
        for i in 0..3 {
            m.re[(i, i)] += diagonal.re;
            m.du[(i, i)] += diagonal.du;
        }
        m
    }
}

/// c_0 to c_7 at x, by the series of the last two and `c_k = 1/k! - x c_{k+2}`.
fn stumpff(x: f64) -> [f64; 8] {
    const FACTORIAL: [f64; 8] = [1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0];
    // Twelve terms: the next is below 12^12 / 30! = 4e-20.
    let series = |k: f64| {
        let mut sum = 1.0;
        for j in (1..12).rev() {
            let n = 2.0 * j as f64 + k;
            sum = 1.0 - x / (n * (n - 1.0)) * sum;
        }
        sum
    };
    let mut c = [0.0; 8];
    c[6] = series(6.0) / FACTORIAL[6];
    c[7] = series(7.0) / FACTORIAL[7];
    for k in (0..6).rev() {
        c[k] = 1.0 / FACTORIAL[k] - x * c[k + 2];
    }
    c
}

/// The small spatial twist that carries the pose `from` to `to`, exact to second order (zero if and only if they are
/// equal and less than half a turn apart).
pub(crate) fn small_twist(from: &DualMatrix, to: &DualMatrix) -> DualVector {
    let relative = to.re * from.re.transpose();
    let d = relative - relative.transpose();
    let angle = Vector3::new(d[(2, 1)], d[(0, 2)], d[(1, 0)]) * 0.5;
    // p - R p0 about the origin, with half of the turn taken back.
    let shift = to.position() - relative * from.position();
    DualVector { re: angle, du: shift - angle.cross(&shift) * 0.5 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vector(a: [f64; 6]) -> DualVector {
        DualVector { re: Vector3::new(a[0], a[1], a[2]), du: Vector3::new(a[3], a[4], a[5]) }
    }

    fn norm(v: &DualVector) -> f64 {
        v.re.norm().max(v.du.norm())
    }

    #[test]
    fn stumpffs_functions_are_sine_and_cosine() {
        for x in [0.0f64, 1e-9, 0.3, 2.0, 9.0, MAX_ANGLE * MAX_ANGLE] {
            let (c, r) = (stumpff(x), x.sqrt());
            assert!((c[0] - r.cos()).abs() < 1e-14 && (c[1] * r - r.sin()).abs() < 1e-14, "{x}");
            assert!((c[2] * x - (1.0 - r.cos())).abs() < 1e-14 && (c[3] * r * x - (r - r.sin())).abs() < 2e-14);
        }
    }

    #[test]
    fn the_exponential_is_a_screw() {
        let t = vector([0.0, 0.0, 2.0, 0.0, 0.0, 0.5]);
        let g = Exponential::new(t).pose();
        assert!((g.position() - Vector3::new(0.0, 0.0, 0.5)).norm() < 1e-15);
        assert!((g.re[(1, 0)] - 2f64.sin()).abs() < 1e-15);
        // A quarter of a circle of radius 2 about x.
        let quarter = std::f64::consts::FRAC_PI_2;
        let g = Exponential::new(vector([quarter, 0.0, 0.0, 0.0, 0.0, 2.0 * quarter])).pose();
        assert!((g.position() - Vector3::new(0.0, -2.0, 2.0)).norm() < 1e-14);
        // Orthonormal, and the dual part is a cross product times the rotation.
        let g = Exponential::new(vector([0.4, -1.1, 0.7, 0.3, 0.2, -0.9])).pose();
        let back = DualMatrix::pose(g.re, &g.position());
        assert!((g.re * g.re.transpose() - Matrix3::identity()).norm() < 1e-15 && (g.du - back.du).norm() < 1e-15);
    }

    #[test]
    fn both_derivatives_of_the_exponential_are_those_of_differences() {
        let t = vector([0.4, -0.8, 0.9, 0.3, 0.2, -0.7]);
        let (u, v) = (vector([0.2, 0.5, -0.3, 0.1, 0.9, 0.4]), vector([-0.6, 0.1, 0.3, 0.8, -0.2, 0.5]));
        let w = vector([0.3, -0.4, 0.6, 0.2, 0.7, -0.1]);
        let e = 1e-5;
        let at = |s: f64| Exponential::new(t + v.scaled(s));
        let twist = small_twist(&at(-e).pose(), &at(e).pose()).scaled(0.5 / e);
        let exact = at(0.0).derivative().apply(&v);
        assert!(norm(&(twist - exact)) < 1e-9, "{twist:?} {exact:?}");
        // u^T D v, made symmetric by taking off half of the bracket: D(u,v) - D(v,u) = w . (dexp v x dexp u).
        let bent = w.work(&(at(e).derivative().apply(&u) - at(-e).derivative().apply(&u))) * 0.5 / e;
        let d = at(0.0).derivative();
        let want = bent - 0.5 * w.work(&d.apply(&v).cross(&d.apply(&u)));
        let got = u.work(&at(0.0).second_derivative(&w).apply(&v));
        assert!((got - want).abs() < 1e-9, "{got} {want}");
    }

    #[test]
    fn the_small_twist_is_exact_to_second_order() {
        let from = Exponential::new(vector([0.4, -0.8, 0.9, 0.3, 0.2, -0.7])).pose();
        let v = vector([-0.6, 0.1, 0.3, 0.8, -0.2, 0.5]);
        let error = |s: f64| {
            let to = Exponential::new(v.scaled(s)).pose() * from;
            norm(&(small_twist(&from, &to) - v.scaled(s)))
        };
        let order = (error(0.1) / error(0.05)).log2();
        assert!((order - 3.0).abs() < 0.1, "{order}");
    }
}

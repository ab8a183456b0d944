//! A rod seen from its tip: its unknowns eliminated, its stiffness 6 x 6, its inertia counted.
//!
//! The rod's strains q and the wrench W at its tip solve, for a spatial twist `eta` of the tip's target and a gap c
//! between tip and target,
//!
//! ```text
//!     [ H   -J^T ] [ dq ]   [ -R      ]                  R = dU/dq - J^T W
//!     [ J     0  ] [ y  ] = [ eta + c ]
//! ```
//!
//! where y is dW up to multiples of `eta + c`. H alone may be indefinite where the held rod is stable (a cantilever
//! buckles earlier than a rod held at both ends); adding `J^T S J` with a positive definite S changes neither dq nor
//! the inertia of the whole matrix, and makes H positive definite wherever the held rod is stable. So a Cholesky-like
//! `U^T D U` without pivoting serves, its negative pivots are counted, and where a pivot nearly vanishes another S
//! is tried.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector6};

use super::assembly::{Assembly, STRAINS};
use super::dual::{DualVector, skew};

/// Right-hand sides eliminated together: J^T (6), R and dR/dP.
const SIDES: usize = 8;
/// A pivot below this fraction of its diagonal entry before elimination counts as vanished.
const VANISHED: f64 = 1e-11;

/// A rod's eliminated equations.
#[derive(Clone, Debug, Default)]
pub(crate) struct Condensed {
    n: usize,
    /// U and D of `H + J^T S J`, by rows.
    factor: Vec<f64>,
    /// `U^-T (J^T | R | dR/dP)`, n x 8 by rows.
    sides: Vec<f64>,
    /// The diagonal before elimination.
    diagonal: Vec<f64>,
    /// S, of spatial twists (angular, linear).
    support: Matrix6<f64>,
    /// `(J H^-1 J^T)^-1`.
    stiffness: Matrix6<f64>,
    /// `J H^-1 R` and `J H^-1 dR/dP`.
    free: [Vector6<f64>; 2],
    /// Half of the bracket of W, which completes the change of W.
    bracket: Matrix6<f64>,
    /// Negative pivots beyond the six of the tip's constraints: unstable modes of the rod held at its tip.
    pub unstable: i32,
}

pub(crate) fn vector6(v: &DualVector) -> Vector6<f64> {
    Vector6::new(v.re.x, v.re.y, v.re.z, v.du.x, v.du.y, v.du.z)
}

pub(crate) fn twist(v: &Vector6<f64>) -> DualVector {
    DualVector { re: v.fixed_rows::<3>(0).into(), du: v.fixed_rows::<3>(3).into() }
}

/// (moment, force) of a wrench, which pairs with (angular, linear).
pub(crate) fn moment_force(w: &DualVector) -> Vector6<f64> {
    Vector6::new(w.du.x, w.du.y, w.du.z, w.re.x, w.re.y, w.re.z)
}

pub(crate) fn wrench(v: &Vector6<f64>) -> DualVector {
    DualVector { re: v.fixed_rows::<3>(3).into(), du: v.fixed_rows::<3>(0).into() }
}

pub(crate) fn blocks(aa: Matrix3<f64>, al: Matrix3<f64>, la: Matrix3<f64>, ll: Matrix3<f64>) -> Matrix6<f64> {
    let mut m = Matrix6::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&aa);
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(&al);
    m.fixed_view_mut::<3, 3>(3, 0).copy_from(&la);
    m.fixed_view_mut::<3, 3>(3, 3).copy_from(&ll);
    m
}

/// Half of `[[m x, f x], [f x, 0]]`: the antisymmetric part of the derivative of a constant wrench's work.
pub(crate) fn half_bracket(w: &DualVector) -> Matrix6<f64> {
    let f = skew(&w.re) * 0.5;
    blocks(skew(&w.du) * 0.5, f, f, Matrix3::zeros())
}

impl Condensed {
    /// Eliminates the rod's unknowns. `scale` is its bending stiffness EI, N m2, and `length` its length, m.
    /// False where the matrix is singular.
    pub fn eliminate(&mut self, a: &Assembly, w: &DualVector, scale: f64, length: f64) -> bool {
        self.n = a.n;
        self.bracket = half_bracket(w);
        // A hundred times the stiffness of a cantilever's tip; the other choices only dodge a vanishing pivot.
        [100.0, 263.0, 37.0].iter().any(|s| self.attempt(a, w, s * scale / length, length))
    }

    fn attempt(&mut self, a: &Assembly, w: &DualVector, rotational: f64, length: f64) -> bool {
        let n = a.n;
        // About the middle of the base and the tip, for good scaling.
        let arm = skew(&a.tip().position());
        let linear = rotational / (length * length);
        self.support = blocks(
            Matrix3::from_diagonal_element(rotational) + arm.tr_mul(&arm) * linear,
            arm * linear,
            arm.transpose() * linear,
            Matrix3::from_diagonal_element(linear),
        );
        self.sides.clear();
        self.sides.resize(n * SIDES, 0.0);
        for (m, j) in a.jacobian.iter().enumerate() {
            for c in 0..3 {
                for r in 0..3 {
                    let row = (STRAINS * m + c) * SIDES + r;
                    self.sides[row] = j.re[(r, c)];
                    self.sides[row + 3] = j.du[(r, c)];
                    self.sides[row + 3 * SIDES + 3] = j.re[(r, c)];
                }
            }
        }
        self.diagonal.resize(n, 0.0);
        let work = moment_force(w);
        self.factor.clone_from(&a.hessian);
        for (i, row) in self.sides.chunks_exact_mut(SIDES).enumerate() {
            let j: Vector6<f64> = Vector6::from_column_slice(&row[..6]);
            row[6] = a.internal[i] - j.dot(&work);
            row[7] = a.by_pressure[i];
        }
        for i in 0..n {
            let j: Vector6<f64> = Vector6::from_column_slice(&self.sides[i * SIDES..][..6]);
            let js = self.support * j;
            let row = &mut self.factor[i * n + i..(i + 1) * n];
            for (entry, side) in row.iter_mut().zip(self.sides[i * SIDES..].chunks_exact(SIDES)) {
                let mut sum = 0.0;
                for (x, y) in js.iter().zip(&side[..6]) {
                    sum += x * y;
                }
                *entry += sum;
            }
        }
        let Some(negative) = factorise(&mut self.factor, &mut self.sides, &mut self.diagonal) else { return false };
        let mut compliance = SMatrix::<f64, 8, 8>::zeros();
        for (i, row) in self.sides.chunks_exact(SIDES).enumerate() {
            let inverse = 1.0 / self.factor[i * n + i];
            for c in 0..8 {
                let scaled = row[c] * inverse;
                for r in 0..6 {
                    compliance[(r, c)] += row[r] * scaled;
                }
            }
        }
        self.free = [6, 7].map(|c| compliance.fixed_view::<6, 1>(0, c).into());
        let a: Matrix6<f64> = compliance.fixed_view::<6, 6>(0, 0).into();
        // The same elimination inverts it and counts: the constraint's six pivots are those of -a.
        let mut upper = [0.0; 36];
        let mut identity = [0.0; 6 * SIDES];
        for i in 0..6 {
            identity[i * SIDES + i] = 1.0;
            for j in i..6 {
                upper[6 * i + j] = a[(i, j)];
            }
        }
        let Some(soft) = factorise(&mut upper, &mut identity, &mut [0.0; 6]) else { return false };
        let mut inverse = Matrix6::zeros();
        for (i, row) in identity.chunks_exact(SIDES).enumerate() {
            let pivot = 1.0 / upper[7 * i];
            for c in 0..6 {
                for r in 0..6 {
                    inverse[(r, c)] += row[r] * row[c] * pivot;
                }
            }
        }
        self.stiffness = inverse;
        self.unstable = negative - soft;
        true
    }

    /// The tip's stiffness: what the wrench of an exactly closed, balanced rod gains by a spatial twist, symmetric
    /// part and bracket apart.
    pub fn tip_stiffness(&self) -> Matrix6<f64> {
        self.stiffness - self.support
    }

    /// `dW = tip_stiffness eta - bracket eta + this` (moment, force) for the gap `c`.
    pub fn wrench_offset(&self, c: &Vector6<f64>) -> Vector6<f64> {
        self.stiffness * (c + self.free[0]) - (self.support + self.bracket) * c
    }

    /// The change of W per pressure at a held tip, (moment, force) per Pa.
    pub fn wrench_by_pressure(&self) -> Vector6<f64> {
        self.stiffness * self.free[1]
    }

    /// The change of W, (moment, force), at a held tip by the change `residual` of R, which is used up.
    pub fn wrench_by(&self, mut residual: Vec<f64>) -> Vector6<f64> {
        let mut free = Vector6::zeros();
        for (i, side) in self.sides.chunks_exact(SIDES).enumerate() {
            let row = &self.factor[i * self.n..][..self.n];
            let (head, tail) = residual.split_at_mut(i + 1);
            for (r, u) in tail.iter_mut().zip(&row[i + 1..]) {
                *r -= u * head[i];
            }
            free += Vector6::from_column_slice(&side[..6]) * (head[i] / row[i]);
        }
        self.stiffness * free
    }

    /// dW (moment, force) and dq into `dq`, for the tip's target moving by `eta`, the gap `c` and the change of
    /// pressure `dp`; `residual` is 1 to remove the residual, 0 for a tangent.
    pub fn expand(
        &self,
        eta: &Vector6<f64>,
        c: &Vector6<f64>,
        dp: f64,
        residual: f64,
        dq: &mut Vec<f64>,
    ) -> Vector6<f64> {
        let n = self.n;
        let target = eta + c;
        let y = self.stiffness * (target + self.free[0] * residual + self.free[1] * dp);
        dq.clear();
        for (i, row) in self.sides.chunks_exact(SIDES).enumerate() {
            let mut sum = -residual * row[6] - dp * row[7];
            for (side, y) in row[..6].iter().zip(y.iter()) {
                sum += side * y;
            }
            dq.push(sum / self.factor[i * n + i]);
        }
        for i in (0..n).rev() {
            let (head, tail) = dq.split_at_mut(i + 1);
            let row = &self.factor[i * n + i + 1..(i + 1) * n];
            head[i] -= row.iter().zip(tail.iter()).map(|(u, x)| u * x).sum::<f64>();
        }
        y - (self.support + self.bracket) * target
    }
}

/// `U^T D U` of the upper triangle in place (D on the diagonal, U's unit diagonal not stored), and
/// `sides <- U^-T sides`. The number of negative pivots; none where one vanishes, so that not even its sign says
/// anything. `diagonal` is room for the diagonal, whose length is the matrix's size.
fn factorise(matrix: &mut [f64], sides: &mut [f64], diagonal: &mut [f64]) -> Option<i32> {
    let n = diagonal.len();
    for (k, d) in diagonal.iter_mut().enumerate() {
        *d = matrix[k * n + k];
    }
    let mut negative = 0;
    for k in 0..n {
        let (above, below) = matrix.split_at_mut((k + 1) * n);
        let row = &mut above[k * n + k..];
        let pivot = row[0];
        if !(pivot.abs() > VANISHED * diagonal[k].abs() && pivot.is_finite()) {
            return None;
        }
        negative += i32::from(pivot < 0.0);
        let inverse = 1.0 / pivot;
        let (sides_above, sides_below) = sides.split_at_mut((k + 1) * SIDES);
        let side = &sides_above[k * SIDES..];
        let rows = below.chunks_exact_mut(n).zip(sides_below.chunks_exact_mut(SIDES));
        for (i, (target, target_side)) in rows.enumerate() {
            let factor = row[i + 1] * inverse;
            for (t, r) in target[k + 1 + i..].iter_mut().zip(&row[i + 1..]) {
                *t -= factor * r;
            }
            for (t, r) in target_side.iter_mut().zip(side) {
                *t -= factor * r;
            }
        }
        for r in &mut row[1..] {
            *r *= inverse;
        }
    }
    Some(negative)
}

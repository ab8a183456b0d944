//! Symmetric factorisation `L D L^T` of a matrix whose columns reach a known distance below the diagonal.
//!
//! No pivoting: the matrices are positive definite on a stable branch, and off it the signs of D give the inertia
//! (Sylvester), which is what asks for them.

/// Columns that are eliminated together.
const PANEL: usize = 4;

/// Lower triangle of a symmetric matrix, column by column, each `width` long. Column j reaches down to row
/// `last[j]`, which never falls from one column to the next, so that the factor fills nothing outside.
#[derive(Clone, Debug)]
pub(super) struct Band {
    width: usize,
    last: Vec<usize>,
    values: Vec<f64>,
}

impl Band {
    /// A zero matrix whose column j ends at row `last[j]`.
    pub(super) fn new(last: Vec<usize>) -> Band {
        let width = last.iter().enumerate().map(|(j, &end)| end - j + 1).max().unwrap_or(0);
        let values = vec![0.0; width * last.len()];
        Band { width, last, values }
    }

    pub(super) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds `value` at (row, column), row >= column.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        debug_assert!(row >= column && row <= self.last[column]);
        self.values[column * self.width + row - column] += value;
    }

    /// Takes over `other`, of the same shape, with the rows and columns marked in `fixed` replaced by unit ones.
    pub(super) fn copy_fixed(&mut self, other: &Band, fixed: &[bool]) {
        self.values.copy_from_slice(&other.values);
        for (j, column) in self.values.chunks_exact_mut(self.width).enumerate() {
            let column = &mut column[..=self.last[j] - j];
            if fixed[j] {
                column.fill(0.0);
                column[0] = 1.0;
            } else {
                for (value, _) in column.iter_mut().zip(&fixed[j..]).filter(|(_, fixed)| **fixed) {
                    *value = 0.0;
                }
            }
        }
    }

    /// Product with a vector.
    #[cfg(test)]
    pub(super) fn multiply(&self, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        for (j, column) in self.values.chunks_exact(self.width).enumerate() {
            y[j] += column[0] * x[j];
            let below = self.last[j] - j;
            for k in 1..=below {
                y[j + k] += column[k] * x[j];
                y[j] += column[k] * x[j + k];
            }
        }
    }

    /// Factorises in place. Number of negative pivots, or None where a pivot is zero or not finite.
    pub(super) fn factorise(&mut self) -> Option<usize> {
        let (width, columns) = (self.width, self.last.len());
        let mut negative = 0;
        let mut first = 0;
        while first < columns {
            // Columns that end in the same row are taken out of the rest together: that reads and writes the rest once.
            let end = self.last[first];
            let next = (first + PANEL).min(columns);
            let next = (first + 1..next).find(|&j| self.last[j] != end).unwrap_or(next);
            let (head, tail) = self.values.split_at_mut(next * width);
            let panel = &mut head[first * width..];
            let mut pivots = [0.0; PANEL];
            for p in 0..next - first {
                let (own, others) = panel[p * width..].split_at_mut(width);
                let own = &mut own[..=end - first - p];
                let pivot = own[0];
                if !pivot.is_finite() || pivot == 0.0 {
                    return None;
                }
                negative += usize::from(pivot < 0.0);
                pivots[p] = pivot;
                let inverse = 1.0 / pivot;
                for (k, other) in others.chunks_exact_mut(width).enumerate().take(next - first - p - 1) {
                    let factor = own[k + 1] * inverse;
                    for (t, s) in other.iter_mut().zip(&own[k + 1..]) {
                        *t -= factor * s;
                    }
                }
                own[1..].iter_mut().for_each(|value| *value *= inverse);
            }
            for (k, target) in tail.chunks_exact_mut(width).enumerate().take((end + 1).saturating_sub(next)) {
                // Rows from this column's pivot on.
                let rows = |p: usize| &panel[p * width..][next - first - p + k..=end - first - p];
                let target = &mut target[..=end - next - k];
                if next - first == PANEL {
                    let [a, b, c, d] = [0, 1, 2, 3].map(rows);
                    let [fa, fb, fc, fd] = [a[0] * pivots[0], b[0] * pivots[1], c[0] * pivots[2], d[0] * pivots[3]];
                    for ((((t, a), b), c), d) in target.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                        *t -= (fa * a + fb * b) + (fc * c + fd * d);
                    }
                } else {
                    for (p, pivot) in pivots.iter().enumerate().take(next - first) {
                        let column = rows(p);
                        let factor = column[0] * pivot;
                        for (t, s) in target.iter_mut().zip(column) {
                            *t -= factor * s;
                        }
                    }
                }
            }
            first = next;
        }
        Some(negative)
    }

    /// Solves in place with the factors.
    pub(super) fn solve(&self, x: &mut [f64]) {
        let n = self.last.len();
        for j in 0..n {
            let column = &self.values[j * self.width..][1..=self.last[j] - j];
            let (head, tail) = x.split_at_mut(j + 1);
            let value = head[j];
            for (t, l) in tail.iter_mut().zip(column) {
                *t -= value * l;
            }
        }
        for (j, value) in x.iter_mut().enumerate() {
            *value /= self.values[j * self.width];
        }
        for j in (0..n).rev() {
            let column = &self.values[j * self.width..][1..=self.last[j] - j];
            x[j] -= dot(column, &x[j + 1..][..column.len()]);
        }
    }
}

/// Scalar product of two slices of one length, in four sums that do not wait for each other.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn factors_solve_and_count_signs_as_a_dense_matrix_does() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for shift in [8.0, 0.3] {
            let last = vec![3, 3, 5, 5, 5, 8, 8, 8, 8];
            let mut band = Band::new(last.clone());
            let mut dense = DMatrix::zeros(9, 9);
            for j in 0..9 {
                for i in j..=last[j] {
                    let value = rng.random_range(-1.0..1.0) + if i == j { shift } else { 0.0 };
                    band.add(i, j, value);
                    (dense[(i, j)], dense[(j, i)]) = (value, value);
                }
            }
            let x = DVector::from_fn(9, |_, _| rng.random_range(-1.0..1.0));
            let mut y = vec![0.0; 9];
            band.multiply(x.as_slice(), &mut y);
            assert!((&dense * &x - DVector::from_vec(y.clone())).norm() < 1e-13);
            let negative = dense.symmetric_eigenvalues().iter().filter(|v| **v < 0.0).count();
            assert_eq!(negative > 0, shift < 1.0);
            let mut factor = band.clone();
            factor.copy_fixed(&band, &[false; 9]);
            assert_eq!(factor.factorise(), Some(negative));
            factor.solve(&mut y);
            assert!((x - DVector::from_vec(y)).norm() < 1e-11);
        }
    }

    #[test]
    fn fixed_rows_are_unit_rows() {
        let mut band = Band::new(vec![1, 1]);
        for (i, j, value) in [(0, 0, 2.0), (1, 0, 1.0), (1, 1, 3.0)] {
            band.add(i, j, value);
        }
        let mut factor = band.clone();
        factor.copy_fixed(&band, &[false, true]);
        assert_eq!(factor.factorise(), Some(0));
        let mut x = [4.0, 5.0];
        factor.solve(&mut x);
        assert_eq!(x, [2.0, 5.0]);
        assert_eq!(Band::new(vec![0]).factorise(), None);
    }
}

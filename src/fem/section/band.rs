//! Symmetric factorisation `L D L^T` of a matrix whose columns reach a known distance below the diagonal.
//!
//! No pivoting: the matrices are positive definite on a stable branch, and off it the signs of D give the inertia
//! (Sylvester), which is what asks for them.

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
        let width = self.width;
        let mut negative = 0;
        for j in 0..self.last.len() {
            let (head, tail) = self.values.split_at_mut((j + 1) * width);
            let column = &mut head[j * width..][..=self.last[j] - j];
            let pivot = column[0];
            if !pivot.is_finite() || pivot == 0.0 {
                return None;
            }
            negative += usize::from(pivot < 0.0);
            let inverse = 1.0 / pivot;
            for k in 1..column.len() {
                let factor = column[k] * inverse;
                if factor != 0.0 {
                    let target = &mut tail[(k - 1) * width..][..column.len() - k];
                    for (t, s) in target.iter_mut().zip(&column[k..]) {
                        *t -= factor * s;
                    }
                }
            }
            column[1..].iter_mut().for_each(|value| *value *= inverse);
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
            let sum: f64 = column.iter().zip(&x[j + 1..]).map(|(l, x)| l * x).sum();
            x[j] -= sum;
        }
    }
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

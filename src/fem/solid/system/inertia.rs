//! Factorisation of the tangent, and its inertia.
//!
//! By Haynsworth, the saddle-point matrix has one negative pivot for each pressure (M is positive definite), plus
//! those of the condensed matrix, plus those of the border's Schur complement.

use nalgebra::{DMatrix, SMatrix, SVector};

use super::{GAS, System, SystemError};
use crate::fem::solid::cap::COORDINATES;

/// What is left of a body when all but its cap is eliminated: derivatives of the energy by the cap's coordinates.
pub(in crate::fem::solid) struct Condensed {
    /// Second derivatives.
    pub stiffness: SMatrix<f64, COORDINATES, COORDINATES>,
    /// First ones, once the inside is in equilibrium.
    pub residual: SVector<f64, COORDINATES>,
    /// Change of the first ones by the gas's pressure.
    pub by_gas: SVector<f64, COORDINATES>,
}

impl System {
    /// Factorises the last tangent, solves for residual and border, counts negative pivots.
    pub fn factorize(&mut self) -> Result<(), SystemError> {
        let size = self.matrix.size();
        let sparse = self.matrix.factorize()?;
        // Columns of held coordinates are not needed: the others move together, and are spread again.
        let needed: Vec<usize> = self.active().into_iter().chain([GAS]).collect();
        self.solved[..size].copy_from_slice(&self.right);
        for (at, &q) in needed.iter().enumerate() {
            self.solved[(at + 1) * size..][..size].copy_from_slice(&self.border[q * size..][..size]);
        }
        self.matrix.solve(&mut self.solved[..(needed.len() + 1) * size]);
        for (at, &q) in needed.iter().enumerate().rev() {
            self.solved.copy_within((at + 1) * size..(at + 2) * size, (q + 1) * size);
        }
        self.negative_inside = sparse;
        self.negative = sparse;
        if needed.len() > 1 {
            self.negative += self.schur().symmetric_eigenvalues().iter().filter(|&&e| e < 0.0).count();
        }
        Ok(())
    }

    /// Solves for the residual of the last evaluation with the last factorisation, which may be of another state.
    pub(in crate::fem::solid) fn resolve(&mut self) {
        let size = self.matrix.size();
        self.solved[..size].copy_from_slice(&self.right);
        self.matrix.solve(&mut self.solved[..size]);
    }

    /// The loaded coordinates.
    pub(super) fn active(&self) -> Vec<usize> {
        (0..COORDINATES).filter(|&q| !self.held[q]).collect()
    }

    pub(super) fn dot(&self, column: usize, solved: usize) -> f64 {
        let size = self.matrix.size();
        self.border[column * size..][..size].iter().zip(&self.solved[solved * size..][..size]).map(|(a, b)| a * b).sum()
    }

    /// Schur complement of the loaded coordinates.
    pub(super) fn schur(&self) -> DMatrix<f64> {
        let active = self.active();
        DMatrix::from_fn(active.len(), active.len(), |r, c| {
            self.corner[(active[r], active[c])] - self.dot(active[r], active[c] + 1)
        })
    }

    /// Negative pivots beyond one for each pressure, of the last factorisation: 0 for a stable state.
    pub fn negative(&self) -> usize {
        self.negative
    }

    /// Those of them that the body has with its cap held.
    pub fn negative_inside(&self) -> usize {
        self.negative_inside
    }

    /// The body condensed to its cap, at the last factorisation; all coordinates must be loaded.
    pub(in crate::fem::solid) fn condensed(&self) -> Condensed {
        let corner = |q: usize, p: usize| self.corner[(q, p)] - self.dot(q, p + 1);
        Condensed {
            stiffness: SMatrix::from_fn(corner),
            residual: SVector::from_fn(|q, _| self.cap_right[q] - self.dot(q, 0)),
            by_gas: SVector::from_fn(|q, _| corner(q, GAS)),
        }
    }
}

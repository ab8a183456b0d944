//! Solving with the tangent of the incompressible sector, and its condensation to (stretch, twist, pressure).
//!
//! ```text
//!     [ K   B^T ] [du]   [f]
//!     [ B   0   ] [dq] = [g]
//! ```
//!
//! is solved by iterating with `-EPSILON M` in place of the zero, whose elimination leaves the positive definite,
//! banded `K + B^T M^-1 B / EPSILON`: every pass reduces the error of the constraint by about EPSILON. The negative
//! pivots of that matrix are those of K on the incompressible fields (inf-sup stable elements, EPSILON small).

use nalgebra::{Matrix3, Vector3};

use super::assembly::{Assembly, EPSILON};
use super::band::Band;
use super::fields::{NODES, Sector};

/// Passes of the iteration where the answer is wanted to round-off: what two leave, EPSILON squared, is below that of
/// the penalised matrix.
pub(super) const EXACT: usize = 2;

/// Positions and the M multipliers of every element.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Increment<const M: usize = 3> {
    pub(super) position: Vec<f64>,
    pub(super) multiplier: Vec<[f64; M]>,
}

/// The factorised tangent of one class of fields, with `components` unknowns a node.
#[derive(Clone, Debug)]
pub(super) struct Saddle {
    factor: Band,
}

impl Saddle {
    pub(super) fn new(sector: &Sector, components: usize) -> Saddle {
        Saddle { factor: sector.band(components) }
    }

    /// Factorises with the unknowns in `fixed` held. Number of negative pivots, None if singular.
    pub(super) fn factorise(&mut self, stiffness: &Band, fixed: &[bool]) -> Option<usize> {
        self.factor.copy_fixed(stiffness, fixed);
        self.factor.factorise()
    }

    /// Solves for the unknowns that are not `fixed`, in `passes` passes. `gradient` is B, element by element.
    pub(super) fn solve<const D: usize, const M: usize>(
        &self,
        sector: &Sector,
        gradient: &[[[f64; D]; M]],
        fixed: &[bool],
        right: &[f64],
        constraint: impl Fn(usize) -> [f64; M],
        passes: usize,
    ) -> Increment<M> {
        let elements = sector.points.len();
        let mut total = Increment { position: vec![0.0; right.len()], multiplier: vec![[0.0; M]; elements] };
        let mut target: Vec<[f64; M]> = (0..elements).map(constraint).collect();
        let mut x = right.to_vec();
        for pass in 0..passes {
            if pass > 0 {
                x.fill(0.0);
            }
            for (index, target) in target.iter().enumerate() {
                // B^T M^-1 g / EPSILON.
                let scaled: [f64; M] = std::array::from_fn(|k| target[k] / (EPSILON * sector.mass[index][k % 3]));
                let b = &gradient[index];
                each_dof::<D>(sector, index, |local, global| {
                    x[global] += (0..M).map(|k| b[k][local] * scaled[k]).sum::<f64>();
                });
            }
            for (value, _) in x.iter_mut().zip(fixed).filter(|(_, fixed)| **fixed) {
                *value = 0.0;
            }
            self.factor.solve(&mut x);
            for (index, target) in target.iter_mut().enumerate() {
                let mut gained = [0.0; M];
                each_dof::<D>(sector, index, |local, global| {
                    for (sum, b) in gained.iter_mut().zip(&gradient[index]) {
                        *sum += b[local] * x[global];
                    }
                });
                for k in 0..M {
                    // What the pass leaves of the constraint is EPSILON M dq.
                    let left = target[k] - gained[k];
                    total.multiplier[index][k] -= left / (EPSILON * sector.mass[index][k % 3]);
                    target[k] = left;
                }
            }
            for (sum, value) in total.position.iter_mut().zip(&x) {
                *sum += value;
            }
        }
        total
    }

    /// Response of the fields to the residual: `-K^-1 r`.
    pub(super) fn correction(&self, sector: &Sector, assembly: &Assembly) -> Increment {
        let mut step = self.solve(
            sector,
            &assembly.gradient,
            &sector.even,
            &assembly.residual,
            |index| assembly.constraint[index],
            1,
        );
        step.scale(-1.0);
        step
    }

    /// Response of the fields to unit stretch, twist and pressure, and the condensed second derivative.
    pub(super) fn condense(&self, sector: &Sector, assembly: &Assembly, exact: bool) -> ([Increment; 3], Matrix3<f64>) {
        let passes = if exact { EXACT } else { 1 };
        let responses = [0, 1, 2].map(|k| {
            let mut column = self.solve(
                sector,
                &assembly.gradient,
                &sector.even,
                &assembly.coupling[k],
                |index| assembly.constraint_coupling[index][k],
                passes,
            );
            column.scale(-1.0);
            column
        });
        let mut hessian = assembly.hessian;
        for (column, response) in responses.iter().enumerate() {
            hessian.set_column(column, &(hessian.column(column) + assembly.conjugate_change(response)));
        }
        // Symmetric but for round-off (and for the single pass, EPSILON).
        (responses, (hessian + hessian.transpose()) * 0.5)
    }
}

/// Local and global number of the D unknowns of an element.
fn each_dof<const D: usize>(sector: &Sector, index: usize, mut visit: impl FnMut(usize, usize)) {
    let components = D / NODES;
    let nodes = sector.element(index / sector.rows(), index % sector.rows());
    for local in 0..D {
        visit(local, components * nodes[local / components] + local % components);
    }
}

impl Assembly {
    /// Change of the derivative by (stretch, twist, pressure) when the fields change by `step`.
    pub(super) fn conjugate_change(&self, step: &Increment) -> Vector3<f64> {
        Vector3::from_fn(|k, _| {
            let fields: f64 = self.coupling[k].iter().zip(&step.position).map(|(c, x)| c * x).sum();
            let multipliers: f64 = (self.constraint_coupling.iter().zip(&step.multiplier))
                .map(|(c, q)| c[k].iter().zip(q).map(|(c, q)| c * q).sum::<f64>())
                .sum();
            fields + multipliers
        })
    }
}

impl<const M: usize> Increment<M> {
    pub(super) fn scale(&mut self, factor: f64) {
        self.position.iter_mut().for_each(|x| *x *= factor);
        self.multiplier.iter_mut().flatten().for_each(|x| *x *= factor);
    }

    /// Adds `factor` times `other`.
    pub(super) fn add(&mut self, other: &Increment<M>, factor: f64) {
        for (x, y) in self.position.iter_mut().zip(&other.position) {
            *x += factor * y;
        }
        for (x, y) in self.multiplier.iter_mut().flatten().zip(other.multiplier.iter().flatten()) {
            *x += factor * y;
        }
    }
}

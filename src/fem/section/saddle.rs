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
use super::fields::{DOFS, Sector};

/// Passes of the iteration where the answer is wanted to round-off.
const EXACT: usize = 3;

/// Positions and multipliers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Increment {
    pub(super) position: Vec<f64>,
    pub(super) multiplier: Vec<[f64; 3]>,
}

/// The factorised tangent of one symmetry class.
#[derive(Clone, Debug)]
pub(super) struct Saddle {
    factor: Band,
}

impl Saddle {
    pub(super) fn new(sector: &Sector) -> Saddle {
        Saddle { factor: sector.band(3) }
    }

    /// Factorises with the unknowns in `fixed` held. Number of negative pivots, None if singular.
    pub(super) fn factorise(&mut self, assembly: &Assembly, fixed: &[bool]) -> Option<usize> {
        self.factor.copy_fixed(&assembly.stiffness, fixed);
        self.factor.factorise()
    }

    /// Solves for the unknowns that are not `fixed`, in `passes` passes.
    fn solve(
        &self,
        sector: &Sector,
        assembly: &Assembly,
        fixed: &[bool],
        right: &[f64],
        constraint: impl Fn(usize) -> [f64; 3],
        passes: usize,
    ) -> Increment {
        let elements = sector.points.len();
        let mut total = Increment { position: vec![0.0; right.len()], multiplier: vec![[0.0; 3]; elements] };
        let mut target: Vec<[f64; 3]> = (0..elements).map(constraint).collect();
        let mut x = right.to_vec();
        for pass in 0..passes {
            if pass > 0 {
                x.fill(0.0);
            }
            self.scatter(sector, assembly, &target, &mut x);
            for (value, _) in x.iter_mut().zip(fixed).filter(|(_, fixed)| **fixed) {
                *value = 0.0;
            }
            self.factor.solve(&mut x);
            for (index, target) in target.iter_mut().enumerate() {
                let gained = gather(sector, assembly, index, &x);
                for k in 0..3 {
                    // What the pass leaves of the constraint is EPSILON M dq.
                    let left = target[k] - gained[k];
                    total.multiplier[index][k] -= left / (EPSILON * sector.mass[index][k]);
                    target[k] = left;
                }
            }
            for (sum, value) in total.position.iter_mut().zip(&x) {
                *sum += value;
            }
        }
        total
    }

    /// Adds `B^T M^-1 g / EPSILON`.
    fn scatter(&self, sector: &Sector, assembly: &Assembly, g: &[[f64; 3]], x: &mut [f64]) {
        for (index, g) in g.iter().enumerate() {
            let scaled: [f64; 3] = std::array::from_fn(|k| g[k] / (EPSILON * sector.mass[index][k]));
            let nodes = sector.element(index / sector.rows(), index % sector.rows());
            for local in 0..DOFS {
                let b = &assembly.gradient[index];
                x[3 * nodes[local / 3] + local % 3] +=
                    b[0][local] * scaled[0] + b[1][local] * scaled[1] + b[2][local] * scaled[2];
            }
        }
    }

    /// Response of the fields to the residual: `-K^-1 r`.
    pub(super) fn correction(&self, sector: &Sector, assembly: &Assembly) -> Increment {
        let mut step =
            self.solve(sector, assembly, &sector.even, &assembly.residual, |index| assembly.constraint[index], 1);
        step.scale(-1.0);
        step
    }

    /// Response of the fields to unit stretch, twist and pressure, and the condensed second derivative.
    pub(super) fn condense(&self, sector: &Sector, assembly: &Assembly, exact: bool) -> ([Increment; 3], Matrix3<f64>) {
        let passes = if exact { EXACT } else { 1 };
        let responses = [0, 1, 2].map(|k| {
            let mut column = self.solve(
                sector,
                assembly,
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

fn gather(sector: &Sector, assembly: &Assembly, index: usize, x: &[f64]) -> [f64; 3] {
    let nodes = sector.element(index / sector.rows(), index % sector.rows());
    let mut sums = [0.0; 3];
    for local in 0..DOFS {
        let value = x[3 * nodes[local / 3] + local % 3];
        for (sum, b) in sums.iter_mut().zip(&assembly.gradient[index]) {
            *sum += b[local] * value;
        }
    }
    sums
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

impl Increment {
    pub(super) fn scale(&mut self, factor: f64) {
        self.position.iter_mut().for_each(|x| *x *= factor);
        self.multiplier.iter_mut().flatten().for_each(|x| *x *= factor);
    }

    /// Adds `factor` times `other`.
    pub(super) fn add(&mut self, other: &Increment, factor: f64) {
        for (x, y) in self.position.iter_mut().zip(&other.position) {
            *x += factor * y;
        }
        for (x, y) in self.multiplier.iter_mut().flatten().zip(other.multiplier.iter().flatten()) {
            *x += factor * y;
        }
    }
}

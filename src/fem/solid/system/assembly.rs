//! Residual, tangent and border of a body, element by element.

use nalgebra::{Matrix4, SMatrix, Vector3, Vector4};

use super::{GAS, STIFF, System, SystemError};
use crate::fem::solid::body::{Body, Cell, State, Support};
use crate::fem::solid::cap::{COORDINATES, TILT, TURN, Tilt};
use crate::fem::solid::element::{SIZE, TWIST};
use crate::fem::solid::shapes::NODES;
use crate::fem::solid::{fiber, surface};
use crate::fem::sparse::HELD;

impl System {
    /// Evaluates residual and, if asked, tangent at `state`. Without, the last tangent stays what is corrected with.
    pub fn evaluate(&mut self, state: &State, tangent: bool) -> Result<(), SystemError> {
        let size = self.matrix.size();
        self.energy = 0.0;
        self.volume = 0.0;
        self.misfit = 0.0;
        self.slack = 0.0;
        self.residual.fill(0.0);
        self.cap_residual = [0.0; COORDINATES];
        self.right.fill(0.0);
        self.cap_right = [0.0; COORDINATES];
        if tangent {
            self.matrix.clear();
            self.border.fill(0.0);
            self.corner = SMatrix::zeros();
        }
        let tilt = Tilt::of(&state.cap);
        for index in 0..self.body.cells.len() {
            let gathered = self.body.gather(&self.body.cells[index], state);
            let cell = &self.body.cells[index];
            let place = self.body.place(cell, &gathered, state);
            let out = &mut self.contribution;
            self.kernel
                .solid(&place, &state.pressures[index], &self.body.rubber, tangent, out)
                .map_err(|source| SystemError::Material { cell: index, source })?;
            if cell.inner {
                surface::add(&place, state.gas, tangent, out);
            }
            fiber::add(&place, cell.fiber, self.body.fiber_ea, &state.tensions[index], tangent, out);
            self.slack = self.slack.max(out.slack);
            self.energy += out.energy;
            self.volume += out.volume;
            let volume = out.mass[(0, 0)].abs();
            self.misfit = out.misfit.iter().fold(self.misfit, |m, x| m.max((x / volume).abs()));
            let carried = carried(&self.body, cell, &tilt);
            let slope = |v: &[f64; SIZE]| -> SMatrix<f64, COORDINATES, 1> {
                let mut sum = SMatrix::zeros();
                sum[TURN] = v[TWIST] / self.body.length;
                for (n, of) in &carried {
                    sum += of.transpose() * Vector3::new(v[3 * n], v[3 * n + 1], v[3 * n + 2]);
                }
                sum
            };
            let kept = &mut self.kept[index];
            kept.misfit = out.misfit;
            if tangent {
                let compressibility = self.body.rubber.compressibility;
                let bulk = if compressibility > 0.0 {
                    1.0 / compressibility
                } else {
                    STIFF * self.body.rubber.law.shear_modulus()
                };
                kept.stiffness = out.mass.try_inverse().unwrap_or_else(Matrix4::zeros) * bulk;
                kept.constraint = out.constraint;
            }
            // What is left once the element's pressures and tensions have taken up its misfit.
            let pressures = kept.stiffness * Vector4::from(out.misfit);
            let mut right = out.force;
            right.iter_mut().zip(&out.taken_up).for_each(|(r, t)| *r += t);
            for (constraint, pressure) in kept.constraint.iter().zip(&pressures) {
                for (r, c) in right.iter_mut().zip(constraint) {
                    *r += c * pressure;
                }
            }
            let (force, carried_right) = (slope(&out.force), slope(&right));
            for q in 0..COORDINATES {
                self.cap_residual[q] += force[q];
                self.cap_right[q] += carried_right[q];
            }
            let block = &self.matrix.blocks()[index];
            for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                self.residual[unknown] += out.force[r];
                self.right[unknown] += right[r];
            }
            if !tangent {
                continue;
            }

            for c in 0..SIZE {
                let column = kept.stiffness * Vector4::from_fn(|a, _| out.constraint[a][c]);
                let of_column = &mut out.matrix[SIZE * c..][..SIZE];
                for (constraint, factor) in out.constraint.iter().zip(&column) {
                    for (m, r) in of_column.iter_mut().zip(constraint) {
                        *m += r * factor;
                    }
                }
            }
            self.matrix.add(index, &out.matrix, SIZE);
            // The border: the turn through the rate of twist, the other coordinates through carried nodes.
            let block = &self.matrix.blocks()[index];
            let by_twist = &out.matrix[SIZE * TWIST..];
            for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                self.border[TURN * size + unknown] += by_twist[r] / self.body.length;
                self.border[GAS * size + unknown] -= out.volume_slope[r];
            }
            let volume = slope(&out.volume_slope);
            for q in 0..COORDINATES {
                self.corner[(q, GAS)] -= volume[q];
            }
            self.corner[(TURN, TURN)] += by_twist[TWIST] / (self.body.length * self.body.length);
            if carried.is_empty() {
                continue;
            }
            for (n, of) in &carried {
                for q in 1..COORDINATES {
                    let column: [f64; SIZE] =
                        std::array::from_fn(|r| (0..3).map(|i| out.matrix[SIZE * (3 * n + i) + r] * of[(i, q)]).sum());
                    for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                        self.border[q * size + unknown] += column[r];
                    }
                    let projected = slope(&column);
                    self.corner[(TURN, q)] += projected[TURN];
                    for p in 0..COORDINATES {
                        if p != TURN {
                            self.corner[(p, q)] += projected[p];
                        }
                    }
                }
                // The second derivative of the tilt.
                let arm = self.body.reference[cell.nodes[*n]] - self.body.cap_center;
                let force = Vector3::new(out.force[3 * n], out.force[3 * n + 1], out.force[3 * n + 2]);
                for i in 0..2 {
                    for j in 0..2 {
                        self.corner[(TILT[i], TILT[j])] += force.dot(&(tilt.second[i][j] * arm));
                    }
                }
            }
        }
        self.cap_and_loads(state, &tilt, tangent);
        Ok(())
    }
}

/// Nodes of a cell that the cap carries, with their slopes by its coordinates.
pub(super) fn carried(body: &Body, cell: &Cell, tilt: &Tilt) -> Vec<(usize, SMatrix<f64, 3, COORDINATES>)> {
    let on_cap = |n: &usize| body.supports[cell.nodes[*n]] == Support::Cap;
    (0..NODES).filter(on_cap).map(|n| (n, tilt.slope(&(body.reference[cell.nodes[n]] - body.cap_center)))).collect()
}

//! What acts on the cap and on single nodes: the gas under the cap, external loads.

use nalgebra::{SMatrix, SVector};

use super::{GAS, System};
use crate::fem::solid::body::State;
use crate::fem::solid::cap::{AXIAL, COORDINATES, Coordinates, LATERAL, TILT, TURN, Tilt};
use crate::fem::sparse::HELD;

/// The energy of dead loads on a cap, or on a plate, and its derivatives by the coordinates.
pub(in crate::fem::solid) struct Dead {
    pub energy: f64,
    pub slope: SVector<f64, COORDINATES>,
    pub second: SMatrix<f64, COORDINATES, COORDINATES>,
}

impl Dead {
    /// Of `loads` by the coordinates `cap`. Lateral ones and bending moments are fixed in space: -f . Rz(phi) u.
    pub fn of(loads: &Coordinates, cap: &Coordinates) -> Dead {
        let mut dead = Dead { energy: 0.0, slope: SVector::zeros(), second: SMatrix::zeros() };
        for q in [TURN, AXIAL] {
            dead.energy -= loads[q] * cap[q];
            dead.slope[q] -= loads[q];
        }
        let (sine, cosine) = cap[TURN].sin_cos();
        for [x, y] in [LATERAL, TILT] {
            let (fx, fy) = (loads[x], loads[y]);
            let (px, py) = (cosine * fx + sine * fy, cosine * fy - sine * fx);
            let (ux, uy) = (cap[x], cap[y]);
            dead.energy -= px * ux + py * uy;
            dead.slope[x] -= px;
            dead.slope[y] -= py;
            dead.slope[TURN] -= py * ux - px * uy;
            // Derivatives of p by phi: (py, -px).
            for (q, value) in [(x, py), (y, -px)] {
                dead.second[(TURN, q)] -= value;
                dead.second[(q, TURN)] -= value;
            }
            dead.second[(TURN, TURN)] += px * ux + py * uy;
        }
        dead
    }
}

impl System {
    /// The gas under the cap, and the external loads.
    pub(super) fn cap_and_loads(&mut self, state: &State, tilt: &Tilt, tangent: bool) {
        // V = area / 3 (c + d) . Q e_z.
        let at = self.body.cap_center + Tilt::displacement(&state.cap);
        let share = self.cap_area / 3.0;
        let normal = tilt.rotation.column(2).into_owned();
        self.volume += share * at.dot(&normal);
        let mut by = SMatrix::<f64, COORDINATES, 1>::zeros();
        let lateral = [(LATERAL[0], 0), (LATERAL[1], 1), (AXIAL, 2)];
        for (q, i) in lateral {
            by[q] = share * normal[i];
        }
        for i in 0..2 {
            by[TILT[i]] = share * at.dot(&tilt.first[i].column(2));
        }
        self.energy -= state.gas * share * at.dot(&normal);
        let dead = Dead::of(&self.loads, &state.cap);
        self.energy += dead.energy;
        for q in 0..COORDINATES {
            let value = dead.slope[q] - state.gas * by[q];
            self.cap_residual[q] += value;
            self.cap_right[q] += value;
            if tangent {
                self.corner[(q, GAS)] -= by[q];
                for p in 0..COORDINATES {
                    self.corner[(q, p)] += dead.second[(q, p)];
                }
            }
        }
        if tangent {
            for i in 0..2 {
                for (q, row) in lateral {
                    let value = state.gas * share * tilt.first[i][(row, 2)];
                    self.corner[(TILT[i], q)] -= value;
                    self.corner[(q, TILT[i])] -= value;
                }
                for j in 0..2 {
                    let value = state.gas * share * at.dot(&tilt.second[i][j].column(2));
                    self.corner[(TILT[i], TILT[j])] -= value;
                }
            }
            for q in 1..COORDINATES {
                self.corner[(q, TURN)] = self.corner[(TURN, q)];
            }
        }
        for (n, dead) in self.dead.iter().enumerate() {
            self.energy -= dead.dot(&state.positions[n]);
            for i in 0..3 {
                let unknown = self.unknowns[n][i];
                if unknown != HELD && dead[i] != 0.0 {
                    self.residual[unknown] -= dead[i];
                    self.right[unknown] -= dead[i];
                }
            }
        }
    }
}

//! Directions of the linearised system.

use nalgebra::{DMatrix, DVector, SMatrix, Vector4};

use super::assembly::carried;
use super::{Control, GAS, System};
use crate::fem::solid::body::State;
use crate::fem::solid::cap::{COORDINATES, Coordinates, TURN, Tilt};
use crate::fem::solid::element::{SIZE, TWIST};
use crate::fem::solid::fiber::{self, Fiber, THREADS};
use crate::fem::solid::shapes::PRESSURES;
use crate::fem::sparse::HELD;

/// A direction in the space of states.
#[derive(Clone, Debug)]
pub struct Direction {
    pub(super) nodes: Vec<f64>,
    pub(super) pressures: Vec<[f64; PRESSURES]>,
    pub(super) tensions: Vec<[f64; THREADS]>,
    pub(super) cap: [f64; COORDINATES],
    /// Change of the gas's pressure.
    pub gas: f64,
    /// Change of the cavity's volume.
    pub volume: f64,
}

impl System {
    /// Solves the linearised system: with the residual or without it, and `by_pressure dP + by_volume dV = value`.
    pub fn direction(&self, with_residual: bool, control: &Control) -> Option<Direction> {
        let active = self.active();
        let count = active.len();
        let on = if with_residual { 1.0 } else { 0.0 };
        let mut small = DMatrix::zeros(count + 1, count + 1);
        let mut right = DVector::zeros(count + 1);
        small.view_mut((0, 0), (count, count)).copy_from(&self.schur());
        for (r, &q) in active.iter().enumerate() {
            small[(r, count)] = self.corner[(q, GAS)] - self.dot(q, GAS + 1);
            right[r] = on * (self.dot(q, 0) - self.cap_right[q]);
            // V_q = -corner, V_u = -border.
            small[(count, r)] = control.by_volume * (self.dot(GAS, q + 1) - self.corner[(q, GAS)]);
        }
        small[(count, count)] = control.by_pressure + control.by_volume * self.dot(GAS, GAS + 1);
        right[count] = control.value - control.by_volume * on * self.dot(GAS, 0);
        let solution = small.lu().solve(&right)?;
        let gas = solution[count];
        let mut cap = [0.0; COORDINATES];
        for (r, &q) in active.iter().enumerate() {
            cap[q] = solution[r];
        }
        Some(self.moved(with_residual, cap, gas))
    }

    /// What the nodes do when the cap's coordinates and the gas's pressure change by this much.
    pub(in crate::fem::solid) fn moved(&self, with_residual: bool, cap: Coordinates, gas: f64) -> Direction {
        let size = self.matrix.size();
        let on = if with_residual { 1.0 } else { 0.0 };
        let mut nodes: Vec<f64> = self.solved[..size].iter().map(|x| -on * x).collect();
        let mut volume = 0.0;
        for (column, change) in cap.iter().chain([&gas]).enumerate().filter(|(_, c)| **c != 0.0) {
            for (u, x) in nodes.iter_mut().zip(&self.solved[(column + 1) * size..][..size]) {
                *u -= x * change;
            }
        }
        for (u, b) in nodes.iter().zip(&self.border[GAS * size..][..size]) {
            volume -= u * b;
        }
        for q in 0..COORDINATES {
            volume -= self.corner[(q, GAS)] * cap[q];
        }
        Direction { nodes, pressures: Vec::new(), tensions: Vec::new(), cap, gas, volume }
    }

    /// Fills in the pressures and tensions of a direction, from `state`, that of the last evaluation.
    pub fn recover(&self, state: &State, with_residual: bool, direction: &mut Direction) {
        let tilt = Tilt::of(&state.cap);
        let inside = (self.body.cells.iter().zip(&self.kept).zip(self.matrix.blocks()).enumerate()).map(
            |(index, ((cell, kept), block))| {
                let mut change: [f64; SIZE] = [0.0; SIZE];
                for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                    change[r] = direction.nodes[unknown];
                }
                change[TWIST] = direction.cap[TURN] / self.body.length;
                for (n, of) in carried(&self.body, cell, &tilt) {
                    let moved = of * SMatrix::<f64, COORDINATES, 1>::from(direction.cap);
                    change[3 * n..3 * n + 3].copy_from_slice(moved.as_slice());
                }
                let misfit = Vector4::from_fn(|a, _| {
                    let by: f64 = kept.constraint[a].iter().zip(&change).map(|(b, u)| b * u).sum();
                    by + if with_residual { kept.misfit[a] } else { 0.0 }
                });
                let mut tensions = [0.0; THREADS];
                if cell.fiber != Fiber::None {
                    let gathered = self.body.gather(cell, state);
                    let place = self.body.place(cell, &gathered, state);
                    let now = with_residual.then(|| &state.tensions[index]);
                    tensions = fiber::tighten(&place, cell.fiber, self.body.fiber_ea, now, &change);
                }
                let pressures: [f64; PRESSURES] = (kept.stiffness * misfit).into();
                (pressures, tensions)
            },
        );
        (direction.pressures, direction.tensions) = inside.unzip::<_, _, Vec<_>, Vec<_>>();
    }

    /// Moves `state` by `factor` times a direction; returns the largest displacement.
    pub fn advance(&self, state: &mut State, direction: &Direction, factor: f64) -> f64 {
        let mut largest = 0.0_f64;
        for (position, unknowns) in state.positions.iter_mut().zip(&self.unknowns) {
            for i in 0..3 {
                if unknowns[i] != HELD {
                    let change = factor * direction.nodes[unknowns[i]];
                    position[i] += change;
                    largest = largest.max(change.abs());
                }
            }
        }
        for (cap, change) in state.cap.iter_mut().zip(direction.cap) {
            *cap += factor * change;
            largest = largest.max((factor * change).abs());
        }
        for (pressures, change) in state.pressures.iter_mut().zip(&direction.pressures) {
            for (p, dp) in pressures.iter_mut().zip(change) {
                *p += factor * dp;
            }
        }
        for (tensions, change) in state.tensions.iter_mut().zip(&direction.tensions) {
            for (t, dt) in tensions.iter_mut().zip(change) {
                *t += factor * dt;
            }
        }
        state.gas += factor * direction.gas;
        self.body.carry(state);
        largest
    }
}

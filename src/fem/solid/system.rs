//! The system of a body: residual, tangent, one Newton step, inertia.
//!
//! Unknowns are the free nodes (sparse), the pressures in the rubber, and a border of the cap's coordinates and the
//! gas's pressure, since these touch every element. The rubber's pressures are discontinuous: each element's four
//! are condensed into its own matrix, `A + kappa B^T M^-1 B`, so the sparse matrix has displacements only, is
//! positive definite wherever the body is stable, and needs no pivoting. For an incompressible rubber the matrix is
//! that of a bulk modulus of [`STIFF`] shear moduli, while the residual stays that of the incompressible one: an
//! iteration then gains that factor on the volume, and what is converged is exactly incompressible.
//!
//! Inertia: by Haynsworth, the saddle-point matrix has one negative pivot for each pressure (M is positive
//! definite), plus those of the condensed matrix, plus those of the border's Schur complement.

use nalgebra::{DMatrix, DVector, Matrix4, SMatrix, Vector3, Vector4};
use thiserror::Error;

use super::body::{Body, Cell, State, Support};
use super::cap::{AXIAL, COORDINATES, LATERAL, TILT, TURN, Tilt};
use super::element::{Contribution, Kernel, SIZE, TWIST};
use super::shapes::{NODES, PRESSURES};
use super::{fiber, surface};
use crate::fem::material::MaterialError;
use crate::fem::sparse::{HELD, SparseError, Symmetric, dissect};

/// Bulk modulus over shear modulus that stands for an incompressible rubber in the tangent.
pub const STIFF: f64 = 1e5;
/// Largest force on a node, in the body's units, at which a state counts as an equilibrium.
const FORCE_TOLERANCE: f64 = 1e-9;
/// Largest misfit of an element's volume, relative to that volume.
const VOLUME_TOLERANCE: f64 = 1e-9;
const BORDER: usize = COORDINATES + 1;
const GAS: usize = COORDINATES;

/// Why a Newton iteration has not ended in an equilibrium.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SystemError {
    /// An element is turned inside out.
    #[error("element {cell}: {source}")]
    Material {
        /// Its number.
        cell: usize,
        /// What the law says.
        source: MaterialError,
    },
    /// The tangent cannot be factorised.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// No convergence.
    #[error("no equilibrium within {iterations} iterations (residual {residual:.1e})")]
    Diverged {
        /// Newton iterations done.
        iterations: usize,
        /// Largest force on a node, in units of shear modulus times radius squared.
        residual: f64,
    },
}

/// What is prescribed of the gas: `by_pressure P + by_volume V = value`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Control {
    /// Factor of the pressure.
    pub by_pressure: f64,
    /// Factor of the cavity's volume.
    pub by_volume: f64,
    /// What the sum is to be.
    pub value: f64,
}

impl Control {
    /// The pressure is prescribed.
    pub fn pressure(value: f64) -> Control {
        Control { by_pressure: 1.0, by_volume: 0.0, value }
    }

    /// The volume is prescribed.
    pub fn volume(value: f64) -> Control {
        Control { by_pressure: 0.0, by_volume: 1.0, value }
    }
}

/// A direction in the space of states.
#[derive(Clone, Debug)]
pub struct Direction {
    nodes: Vec<f64>,
    pressures: Vec<[f64; PRESSURES]>,
    cap: [f64; COORDINATES],
    /// Change of the gas's pressure.
    pub gas: f64,
    /// Change of the cavity's volume.
    pub volume: f64,
}

/// What an element keeps for the recovery of its pressures.
#[derive(Clone)]
struct Kept {
    constraint: [[f64; SIZE]; PRESSURES],
    misfit: [f64; PRESSURES],
    /// kappa M^-1.
    stiffness: Matrix4<f64>,
}

/// A body with its matrix.
pub struct System {
    /// The body.
    pub body: Body,
    /// External loads by the cap's coordinates; lateral ones are fixed in space.
    pub loads: [f64; COORDINATES],
    /// Which of the cap's coordinates are held.
    pub held: [bool; COORDINATES],
    /// Dead load on the nodes, in the frame (0 unless set).
    pub dead: Vec<Vector3<f64>>,
    matrix: Symmetric,
    unknowns: Vec<[usize; 3]>,
    kernel: Kernel,
    contribution: Contribution,
    kept: Vec<Kept>,
    cap_area: f64,
    energy: f64,
    residual: Vec<f64>,
    right: Vec<f64>,
    border: Vec<f64>,
    corner: SMatrix<f64, COORDINATES, BORDER>,
    cap_residual: [f64; COORDINATES],
    cap_right: [f64; COORDINATES],
    misfit: f64,
    volume: f64,
    /// Solutions for the right-hand side and the border, of the last factorisation.
    solved: Vec<f64>,
    negative: usize,
}

impl System {
    /// Builds pattern and elimination order. Nothing is held of the cap but what `held` says.
    pub fn new(body: Body, held: [bool; COORDINATES]) -> Result<System, SparseError> {
        let mut size = 0;
        let unknowns: Vec<[usize; 3]> = body
            .supports
            .iter()
            .map(|s| match s {
                Support::Cap => [HELD; 3],
                Support::Held(held) => held.map(|held| {
                    size += usize::from(!held);
                    if held { HELD } else { size - 1 }
                }),
            })
            .collect();
        let nodes: Vec<Vec<usize>> = body.cells.iter().map(|c| c.nodes.to_vec()).collect();
        let centers: Vec<[f64; 3]> = body.cells.iter().map(|c| c.center).collect();
        let order: Vec<usize> = dissect(body.reference.len(), &nodes, &centers)
            .into_iter()
            .flat_map(|n| unknowns[n])
            .filter(|&u| u != HELD)
            .collect();
        let blocks = body.cells.iter().map(|c| c.nodes.iter().flat_map(|&n| unknowns[n]).collect()).collect();
        let matrix = Symmetric::new(size, blocks, &order)?;
        let kept = Kept { constraint: [[0.0; SIZE]; PRESSURES], misfit: [0.0; PRESSURES], stiffness: Matrix4::zeros() };
        Ok(System {
            loads: [0.0; COORDINATES],
            held,
            dead: vec![Vector3::zeros(); body.reference.len()],
            matrix,
            unknowns,
            kernel: Kernel::default(),
            contribution: Contribution::zero(),
            kept: vec![kept; body.cells.len()],
            cap_area: body.cap_area(),
            energy: 0.0,
            residual: vec![0.0; size],
            right: vec![0.0; size],
            border: vec![0.0; size * BORDER],
            corner: SMatrix::zeros(),
            cap_residual: [0.0; COORDINATES],
            cap_right: [0.0; COORDINATES],
            misfit: 0.0,
            volume: 0.0,
            solved: vec![0.0; size * (BORDER + 1)],
            negative: 0,
            body,
        })
    }

    /// Unknowns in the sparse matrix.
    pub fn size(&self) -> usize {
        self.matrix.size()
    }

    /// Energy of the last evaluation (rubber, fibres, gas and loads).
    pub fn energy(&self) -> f64 {
        self.energy
    }

    /// Volume of the cavity at the last evaluation (of one sector, where the body is one).
    pub fn volume(&self) -> f64 {
        self.volume
    }

    /// Derivatives of the energy by the cap's coordinates at the last evaluation, loads included: what holds it.
    pub fn cap_residual(&self) -> [f64; COORDINATES] {
        self.cap_residual
    }

    /// Derivatives of the energy by the free nodes at the last evaluation.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }

    /// Negative pivots beyond one for each pressure, of the last factorisation: 0 for a stable state.
    pub fn negative(&self) -> usize {
        self.negative
    }

    /// Evaluates residual and, if asked, tangent at `state`.
    pub fn evaluate(&mut self, state: &State, tangent: bool) -> Result<(), SystemError> {
        let size = self.matrix.size();
        self.energy = 0.0;
        self.volume = 0.0;
        self.misfit = 0.0;
        self.residual.fill(0.0);
        self.cap_residual = [0.0; COORDINATES];
        if tangent {
            self.matrix.clear();
            self.right.fill(0.0);
            self.border.fill(0.0);
            self.corner = SMatrix::zeros();
            self.cap_right = [0.0; COORDINATES];
        }
        let tilt = Tilt::of(&state.cap);
        for index in 0..self.body.cells.len() {
            let gathered = self.body.gather(&self.body.cells[index], state);
            let place = self.body.place(&gathered, state);
            let out = &mut self.contribution;
            let cell = &self.body.cells[index];
            self.kernel
                .solid(&place, &state.pressures[index], &self.body.rubber, tangent, out)
                .map_err(|source| SystemError::Material { cell: index, source })?;
            if cell.inner {
                surface::add(&place, state.gas, tangent, out);
            }
            fiber::add(&place, cell.fiber, self.body.fiber_ea, tangent, out);
            turn_back(cell, self.body.image_angle, tangent, out);
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
            let force = slope(&out.force);
            for q in 0..COORDINATES {
                self.cap_residual[q] += force[q];
            }
            let block = &self.matrix.blocks()[index];
            for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                self.residual[unknown] += out.force[r];
            }
            if !tangent {
                continue;
            }

            let compressibility = self.body.rubber.compressibility;
            let bulk = if compressibility > 0.0 {
                1.0 / compressibility
            } else {
                STIFF * self.body.rubber.law.shear_modulus()
            };
            let stiffness = out.mass.try_inverse().unwrap_or_else(Matrix4::zeros) * bulk;
            let misfit = stiffness * Vector4::from(out.misfit);
            let mut right = out.force;
            for c in 0..SIZE {
                let column = stiffness * Vector4::from_fn(|a, _| out.constraint[a][c]);
                let of_column = &mut out.matrix[SIZE * c..][..SIZE];
                for a in 0..PRESSURES {
                    let (constraint, factor) = (&out.constraint[a], column[a]);
                    for r in 0..SIZE {
                        of_column[r] += constraint[r] * factor;
                    }
                    right[c] += out.constraint[a][c] * misfit[a];
                }
            }
            self.kept[index] = Kept { constraint: out.constraint, misfit: out.misfit, stiffness };
            self.matrix.add(index, &out.matrix, SIZE);
            // The border: the turn through the rate of twist, the other coordinates through carried nodes.
            let block = &self.matrix.blocks()[index];
            let by_twist = &out.matrix[SIZE * TWIST..];
            for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                self.right[unknown] += right[r];
                self.border[TURN * size + unknown] += by_twist[r] / self.body.length;
                self.border[GAS * size + unknown] -= out.volume_slope[r];
            }
            let right = slope(&right);
            let volume = slope(&out.volume_slope);
            for q in 0..COORDINATES {
                self.cap_right[q] += right[q];
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

    /// The gas under the cap, and the external loads.
    fn cap_and_loads(&mut self, state: &State, tilt: &Tilt, tangent: bool) {
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
        let mut load = SMatrix::<f64, COORDINATES, COORDINATES>::zeros();
        let mut force = [0.0; COORDINATES];
        force[TURN] = self.loads[TURN];
        force[AXIAL] = self.loads[AXIAL];
        self.energy -= self.loads[TURN] * state.cap[TURN] + self.loads[AXIAL] * state.cap[AXIAL];
        // Loads that are fixed in space, in the frame of the tip: -f . Rz(phi) u.
        let (sine, cosine) = state.cap[TURN].sin_cos();
        for [x, y] in [LATERAL, TILT] {
            let (fx, fy) = (self.loads[x], self.loads[y]);
            let (px, py) = (cosine * fx + sine * fy, cosine * fy - sine * fx);
            let (ux, uy) = (state.cap[x], state.cap[y]);
            force[x] += px;
            force[y] += py;
            force[TURN] += py * ux - px * uy;
            self.energy -= px * ux + py * uy;
            // Derivatives of p by phi: (py, -px).
            for (q, value) in [(x, py), (y, -px)] {
                load[(TURN, q)] += value;
                load[(q, TURN)] += value;
            }
            load[(TURN, TURN)] -= px * ux + py * uy;
        }
        for q in 0..COORDINATES {
            let value = state.gas * by[q] + force[q];
            self.cap_residual[q] -= value;
            if tangent {
                self.cap_right[q] -= value;
                self.corner[(q, GAS)] -= by[q];
                for p in 0..COORDINATES {
                    self.corner[(q, p)] -= load[(q, p)];
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
                    if tangent {
                        self.right[unknown] -= dead[i];
                    }
                }
            }
        }
    }

    /// Factorises the last tangent, solves for residual and border, counts negative pivots.
    pub fn factorize(&mut self) -> Result<(), SystemError> {
        let size = self.matrix.size();
        let sparse = self.matrix.factorize()?;
        let (right, border) = self.solved.split_at_mut(size);
        right.copy_from_slice(&self.right);
        border.copy_from_slice(&self.border);
        self.matrix.solve(&mut self.solved);
        let schur = self.schur().symmetric_eigenvalues();
        self.negative = sparse + schur.iter().filter(|&&e| e < 0.0).count();
        Ok(())
    }

    /// The loaded coordinates.
    fn active(&self) -> Vec<usize> {
        (0..COORDINATES).filter(|&q| !self.held[q]).collect()
    }

    fn dot(&self, column: usize, solved: usize) -> f64 {
        let size = self.matrix.size();
        self.border[column * size..][..size].iter().zip(&self.solved[solved * size..][..size]).map(|(a, b)| a * b).sum()
    }

    /// Schur complement of the loaded coordinates.
    fn schur(&self) -> DMatrix<f64> {
        let active = self.active();
        DMatrix::from_fn(active.len(), active.len(), |r, c| {
            self.corner[(active[r], active[c])] - self.dot(active[r], active[c] + 1)
        })
    }

    /// Solves the linearised system: with the residual or without it, and `by_pressure dP + by_volume dV = value`.
    pub fn direction(&self, with_residual: bool, control: &Control) -> Option<Direction> {
        let size = self.matrix.size();
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
        Some(Direction { nodes, pressures: Vec::new(), cap, gas, volume })
    }

    /// Fills in the pressures of a direction, from the state of the last tangent.
    pub fn recover(&self, state: &State, with_residual: bool, direction: &mut Direction) {
        let tilt = Tilt::of(&state.cap);
        direction.pressures = (self.body.cells.iter().zip(&self.kept).zip(self.matrix.blocks()))
            .map(|((cell, kept), block)| {
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
                (kept.stiffness * misfit).into()
            })
            .collect();
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
        state.gas += factor * direction.gas;
        self.body.carry(state);
        largest
    }

    /// Largest residual, forces of the loaded coordinates included.
    fn imbalance(&self) -> f64 {
        let cap = (0..COORDINATES).filter(|&q| !self.held[q]).map(|q| self.cap_residual[q].abs());
        self.residual.iter().map(|r| r.abs()).chain(cap).fold(0.0, f64::max)
    }

    fn balanced(&self, state: &State, control: &Control) -> bool {
        let gas = control.by_pressure * state.gas + control.by_volume * self.volume - control.value;
        self.imbalance() < FORCE_TOLERANCE && self.misfit < VOLUME_TOLERANCE && gas.abs() < VOLUME_TOLERANCE
    }

    /// Newton's iteration from `state` to an equilibrium under `control`. On success the last factorisation is that
    /// of a state within the last increment, and the number of iterations is returned.
    pub fn solve(&mut self, state: &mut State, control: &Control, most: usize) -> Result<usize, SystemError> {
        self.body.carry(state);
        let mut last = f64::INFINITY;
        let mut first = f64::INFINITY;
        for iteration in 0..most {
            self.evaluate(state, true)?;
            let residual = self.imbalance();
            if iteration == 0 {
                first = residual;
            }
            if !residual.is_finite() || (iteration > 2 && residual > 1e3 * first.max(1.0)) {
                return Err(SystemError::Diverged { iterations: iteration, residual });
            }
            self.factorize()?;
            let value = control.value - control.by_pressure * state.gas - control.by_volume * self.volume;
            let mut direction = self
                .direction(true, &Control { value, ..*control })
                .ok_or(SystemError::Sparse(SparseError::Singular(self.matrix.size())))?;
            self.recover(state, true, &mut direction);
            last = self.advance(state, &direction, 1.0);
            if !last.is_finite() {
                return Err(SystemError::Diverged { iterations: iteration + 1, residual });
            }
            if last < 1e-3 {
                self.evaluate(state, false)?;
                if self.balanced(state, control) {
                    return Ok(iteration + 1);
                }
            }
        }
        Err(SystemError::Diverged { iterations: most, residual: last })
    }
}

/// Nodes of a cell that the cap carries, with their slopes by its coordinates.
fn carried(body: &Body, cell: &Cell, tilt: &Tilt) -> Vec<(usize, SMatrix<f64, 3, COORDINATES>)> {
    let on_cap = |n: &usize| body.supports[cell.nodes[*n]] == Support::Cap;
    (0..NODES).filter(on_cap).map(|n| (n, tilt.slope(&(body.reference[cell.nodes[n]] - body.cap_center)))).collect()
}

/// Turns what belongs to image nodes back to the nodes themselves.
fn turn_back(cell: &Cell, angle: f64, tangent: bool, out: &mut Contribution) {
    let (sine, cosine) = angle.sin_cos();
    for n in (0..NODES).filter(|&n| cell.images[n]) {
        let back = |v: &mut [f64]| {
            let (a, b) = (v[3 * n], v[3 * n + 1]);
            v[3 * n] = cosine * a + sine * b;
            v[3 * n + 1] = cosine * b - sine * a;
        };
        back(&mut out.force);
        back(&mut out.volume_slope);
        out.constraint.iter_mut().for_each(|row| back(row));
        if !tangent {
            continue;
        }
        for column in out.matrix.chunks_exact_mut(SIZE) {
            back(column);
        }
        let (left, right) = out.matrix.split_at_mut(SIZE * (3 * n + 1));
        for (a, b) in left[SIZE * 3 * n..].iter_mut().zip(&mut right[..SIZE]) {
            (*a, *b) = (cosine * *a + sine * *b, cosine * *b - sine * *a);
        }
    }
}

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
            let cell = &self.body.cells[index];
            let place = self.body.place(cell, &gathered, state);
            let out = &mut self.contribution;
            self.kernel
                .solid(&place, &state.pressures[index], &self.body.rubber, tangent, out)
                .map_err(|source| SystemError::Material { cell: index, source })?;
            if cell.inner {
                surface::add(&place, state.gas, tangent, out);
            }
            fiber::add(&place, cell.fiber, self.body.fiber_ea, tangent, out);
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
        self.negative = sparse;
        if needed.len() > 1 {
            self.negative += self.schur().symmetric_eigenvalues().iter().filter(|&&e| e < 0.0).count();
        }
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
        let mut first = f64::INFINITY;
        let mut residual = f64::INFINITY;
        for iteration in 0..most {
            self.evaluate(state, true)?;
            residual = self.imbalance();
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
            let last = self.advance(state, &direction, 1.0);
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
        Err(SystemError::Diverged { iterations: most, residual })
    }
}

/// Nodes of a cell that the cap carries, with their slopes by its coordinates.
fn carried(body: &Body, cell: &Cell, tilt: &Tilt) -> Vec<(usize, SMatrix<f64, 3, COORDINATES>)> {
    let on_cap = |n: &usize| body.supports[cell.nodes[*n]] == Support::Cap;
    (0..NODES).filter(on_cap).map(|n| (n, tilt.slope(&(body.reference[cell.nodes[n]] - body.cap_center)))).collect()
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "System({:?}, {} elements)", self.matrix, self.body.cells.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::solid::mesh::{Mesh, Part, tube_body};
    use crate::fem::tube::Tube;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn bodies() -> Vec<Body> {
        let strip = Tube::reference(0.7);
        let line = Tube { fiber_width: 0.0, fibers: 3, ..Tube::reference(-0.3) };
        let mesh = |tube: &Tube, part| Mesh {
            part,
            wall: 1,
            around: 1,
            around_growth: 20.0,
            first: 4e-3,
            largest: 4e-3,
            ..Mesh::sector(tube)
        };
        [(strip, Part::Sector), (line, Part::Sector), (line, Part::Whole)]
            .map(|(tube, part)| tube_body(&tube, 8e-3, &mesh(&tube, part), None).unwrap())
            .to_vec()
    }

    /// A loaded system in a random state, and a random direction with the change of pressures that goes with it.
    fn disturbed(body: Body, whole: bool, seed: u64) -> (System, State, Direction) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let held: [bool; COORDINATES] = std::array::from_fn(|q| q > AXIAL && !whole);
        let mut system = System::new(body, held).unwrap();
        system.loads = [0.02, -0.03, 0.01, 0.02, 0.03, -0.01];
        let mut state = system.body.rest();
        let small = |rng: &mut Pcg64Mcg, size: f64| rng.random_range(-size..size);
        state.gas = 0.15;
        for (position, unknowns) in state.positions.iter_mut().zip(&system.unknowns) {
            for i in (0..3).filter(|&i| unknowns[i] != HELD) {
                position[i] += small(&mut rng, 0.003);
            }
        }
        for q in (0..COORDINATES).filter(|&q| !held[q]) {
            state.cap[q] = small(&mut rng, if q == TURN { 0.5 } else { 0.02 });
        }
        state.pressures.iter_mut().flatten().for_each(|p| *p = small(&mut rng, 0.2));
        system.body.carry(&mut state);
        system.evaluate(&state, true).unwrap();
        let mut direction = Direction {
            nodes: (0..system.size()).map(|_| small(&mut rng, 1.0)).collect(),
            pressures: Vec::new(),
            cap: std::array::from_fn(|q| if held[q] { 0.0 } else { small(&mut rng, 1.0) }),
            gas: small(&mut rng, 1.0),
            volume: 0.0,
        };
        system.recover(&state, false, &mut direction);
        // The condensed pressures are stiff: leave them the part that the direction asks for, scaled down.
        (system, state, direction)
    }

    #[test]
    fn the_tangent_is_the_derivative_of_the_residual_with_slope_two() {
        // The condensed matrix times du is A du + B^T dp with dp = kappa M^-1 B du: rubber, gas, fibre, cap, loads.
        for (case, body) in bodies().into_iter().enumerate() {
            let whole = case == 2;
            let (mut system, state, direction) = disturbed(body, whole, case as u64);
            let size = system.size();
            let mut slope = system.matrix.times(&direction.nodes);
            let mut cap = [0.0; COORDINATES];
            for (q, change) in direction.cap.iter().chain([&direction.gas]).enumerate() {
                for (s, b) in slope.iter_mut().zip(&system.border[q * size..]) {
                    *s += b * change;
                }
            }
            for (q, of) in cap.iter_mut().enumerate() {
                *of = system.border[q * size..][..size].iter().zip(&direction.nodes).map(|(b, u)| b * u).sum();
                *of += (0..COORDINATES).map(|p| system.corner[(q, p)] * direction.cap[p]).sum::<f64>();
                *of += system.corner[(q, GAS)] * direction.gas;
            }
            let (residual, cap_residual) = (system.residual.clone(), system.cap_residual);
            let scale = slope.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
            let mut remainder = |h: f64| {
                let mut there = state.clone();
                system.advance(&mut there, &direction, h);
                system.evaluate(&there, false).unwrap();
                let nodes = (system.residual.iter().zip(&residual).zip(&slope)).map(|((a, b), s)| a - b - h * s);
                let ends = (0..COORDINATES)
                    .filter(|&q| !system.held[q])
                    .map(|q| system.cap_residual[q] - cap_residual[q] - h * cap[q]);
                nodes.chain(ends).map(|r| r * r).sum::<f64>().sqrt()
            };
            let (large, small) = (remainder(1e-4), remainder(1e-5));
            let order = (large / small).log10();
            assert!((order - 2.0).abs() < 0.05, "case {case}: {order} ({large:.2e} {small:.2e} of {scale:.2e})");
        }
    }

    #[test]
    fn the_residual_and_the_volume_slope_are_derivatives() {
        for (case, body) in bodies().into_iter().enumerate() {
            let (mut system, state, mut direction) = disturbed(body, case == 2, 10 + case as u64);
            direction.pressures.iter_mut().flatten().for_each(|p| *p = 0.0);
            direction.gas = 0.0;
            let size = system.size();
            let sum = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            let slope = sum(&system.residual, &direction.nodes) + sum(&system.cap_residual, &direction.cap);
            let volume = -sum(&system.border[GAS * size..], &direction.nodes)
                - (0..COORDINATES).map(|q| system.corner[(q, GAS)] * direction.cap[q]).sum::<f64>();
            let mut at = |h: f64| {
                let mut there = state.clone();
                system.advance(&mut there, &direction, h);
                system.evaluate(&there, false).unwrap();
                (system.energy, system.volume)
            };
            // Central differences: truncation about 1e-8 of the third derivative.
            let h = 1e-5;
            let (plus, minus) = (at(h), at(-h));
            let by_difference = (plus.0 - minus.0) / (2.0 * h);
            assert!((by_difference - slope).abs() < 1e-5 * (1.0 + slope.abs()), "case {case}: {by_difference} {slope}");
            let by_difference = (plus.1 - minus.1) / (2.0 * h);
            assert!((by_difference - volume).abs() < 1e-6 * (1.0 + volume.abs()), "case {case}");
        }
    }

    #[test]
    fn a_rigid_motion_changes_nothing() {
        // The whole tube, deformed at random, turned about any axis and moved: energy of rubber and fibres, and
        // misfit of volume stay, forces turn with it.
        let body = Body { supports: vec![Support::FREE; bodies()[2].reference.len()], ..bodies().remove(2) };
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let mut system = System::new(body, [true; COORDINATES]).unwrap();
        let mut state = system.body.rest();
        state.pressures.iter_mut().flatten().for_each(|p| *p = rng.random_range(-0.2..0.2));
        for y in &mut state.positions {
            *y += Vector3::from_fn(|_, _| rng.random_range(-0.01..0.01));
        }
        system.evaluate(&state, false).unwrap();
        let (energy, residual) = (system.energy, system.residual.clone());
        let turn = nalgebra::Rotation3::from_scaled_axis(Vector3::new(1.0, -2.0, 0.7));
        state.positions.iter_mut().for_each(|y| *y = turn * *y + Vector3::new(0.3, 2.0, -1.0));
        system.evaluate(&state, false).unwrap();
        assert!((system.energy / energy - 1.0).abs() < 1e-12);
        let largest = residual.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
        for (n, unknowns) in system.unknowns.iter().enumerate() {
            let force = |of: &[f64]| Vector3::from_fn(|i, _| of[unknowns[i]]);
            let difference = force(&system.residual) - turn * force(&residual);
            assert!(difference.norm() < 1e-11 * largest, "node {n}");
        }
    }

    #[test]
    fn inertia_is_that_of_the_full_saddle_point_matrix() {
        // With a bulk modulus the condensed count plus the number of pressures is that of the dense matrix in
        // displacements, cap and pressures.
        let tube = Tube { fiber_width: 0.0, fibers: 3, ..Tube::reference(0.3) };
        let mesh = Mesh { wall: 1, around: 1, first: 4e-3, largest: 4e-3, ..Mesh::sector(&tube) };
        for gas in [0.0, -4.0] {
            let body = tube_body(&tube, 8e-3, &mesh, Some(100.0)).unwrap();
            let held = std::array::from_fn(|q| q > AXIAL);
            let mut system = System::new(body, held).unwrap();
            let mut state = system.body.rest();
            state.gas = gas;
            system.evaluate(&state, true).unwrap();
            system.factorize().unwrap();
            // Dense: undo the condensation. Unknowns: nodes, two of the cap, pressures.
            let (n, m) = (system.size(), system.body.pressures());
            let mut dense = DMatrix::zeros(n + 2 + m, n + 2 + m);
            for c in 0..n {
                let mut unit = vec![0.0; n];
                unit[c] = 1.0;
                dense.view_mut((0, c), (n, 1)).copy_from_slice(&system.matrix.times(&unit));
            }
            for q in 0..2 {
                for r in 0..n {
                    dense[(r, n + q)] = system.border[q * n + r];
                    dense[(n + q, r)] = system.border[q * n + r];
                }
                for p in 0..2 {
                    dense[(n + q, n + p)] = system.corner[(q, p)];
                }
            }
            let tilt = Tilt::of(&state.cap);
            for (index, kept) in system.kept.iter().enumerate() {
                let block = &system.matrix.blocks()[index];
                let mut rows = DMatrix::zeros(PRESSURES, n + 2);
                for a in 0..PRESSURES {
                    for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                        rows[(a, unknown)] += kept.constraint[a][r];
                    }
                    rows[(a, n)] += kept.constraint[a][TWIST] / system.body.length;
                    for (node, of) in carried(&system.body, &system.body.cells[index], &tilt) {
                        for i in 0..3 {
                            rows[(a, n + 1)] += kept.constraint[a][3 * node + i] * of[(i, AXIAL)];
                        }
                    }
                }
                let stiffness = DMatrix::from_fn(PRESSURES, PRESSURES, |r, c| kept.stiffness[(r, c)]);
                let condensed = rows.transpose() * &stiffness * &rows;
                let mut corner = dense.view_mut((0, 0), (n + 2, n + 2));
                corner -= condensed;
                let at = n + 2 + PRESSURES * index;
                let mass = stiffness.try_inverse().unwrap();
                dense.view_mut((at, at), (PRESSURES, PRESSURES)).copy_from(&(-mass));
                dense.view_mut((at, 0), (PRESSURES, n + 2)).copy_from(&rows);
                dense.view_mut((0, at), (n + 2, PRESSURES)).copy_from(&rows.transpose());
            }
            let negative = dense.symmetric_eigenvalues().iter().filter(|&&e| e < 0.0).count();
            assert_eq!(negative, m + system.negative(), "gas {gas}");
            assert_eq!(system.negative() > 0, gas < 0.0, "gas {gas}: {}", system.negative());
        }
    }
}

//! The system of a body: residual, tangent, one Newton step, inertia.
//!
//! Unknowns are the free nodes (sparse), the pressures in the rubber, and a border of the cap's coordinates and the
//! gas's pressure, since these touch every element. The rubber's pressures are discontinuous: each element's four
//! are condensed into its own matrix, `A + kappa B^T M^-1 B`, so the sparse matrix has displacements only, is
//! positive definite wherever the body is stable, and needs no pivoting. For an incompressible rubber the matrix is
//! that of a bulk modulus of [`STIFF`] shear moduli, while the residual stays that of the incompressible one: an
//! iteration then gains that factor on the volume, and what is converged is exactly incompressible.

mod assembly;
mod direction;
mod inertia;
mod loads;
mod newton;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix4, SMatrix, Vector3};

use super::body::{Body, Support};
use super::cap::COORDINATES;
use super::element::{Contribution, Kernel, SIZE};
use super::shapes::PRESSURES;
use crate::fem::sparse::{HELD, SparseError, Symmetric, dissect};

pub use direction::Direction;
pub(super) use loads::Dead;
pub use newton::{Control, SystemError};
pub(super) use newton::{FORCE_TOLERANCE, Pace, SAME};

/// Bulk modulus over shear modulus that stands for an incompressible rubber in the tangent.
pub const STIFF: f64 = 1e5;
const BORDER: usize = COORDINATES + 1;
const GAS: usize = COORDINATES;

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
    slack: f64,
    volume: f64,
    /// Solutions for the right-hand side and the border, of the last factorisation.
    solved: Vec<f64>,
    negative: usize,
    negative_inside: usize,
}

impl System {
    /// Builds pattern and elimination order. Nothing is held of the cap but what `held` says.
    pub fn new(body: Body, held: [bool; COORDINATES]) -> Result<System, SparseError> {
        let mut size = 0;
        let mut number = |held: bool| {
            size += usize::from(!held);
            if held { HELD } else { size - 1 }
        };
        let unknowns: Vec<[usize; 3]> = (body.supports.iter())
            .map(|support| match support {
                Support::Cap => [HELD; 3],
                Support::Held(held) => held.map(&mut number),
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
        Ok(System::of(body, held, unknowns, matrix))
    }

    /// The same of another body; where its elements join as these do, it shares their pattern.
    pub fn alike(&self, body: Body) -> Result<System, SparseError> {
        let nodes = |body: &Body| body.cells.iter().map(|c| c.nodes).collect::<Vec<_>>();
        if self.body.supports != body.supports || nodes(&self.body) != nodes(&body) {
            return System::new(body, self.held);
        }
        Ok(System::of(body, self.held, self.unknowns.clone(), self.matrix.alike()?))
    }

    fn of(body: Body, held: [bool; COORDINATES], unknowns: Vec<[usize; 3]>, matrix: Symmetric) -> System {
        let size = matrix.size();
        let kept = Kept { constraint: [[0.0; SIZE]; PRESSURES], misfit: [0.0; PRESSURES], stiffness: Matrix4::zeros() };
        System {
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
            slack: 0.0,
            volume: 0.0,
            solved: vec![0.0; size * (BORDER + 1)],
            negative: 0,
            negative_inside: 0,
            body,
        }
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
}

impl std::fmt::Debug for System {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "System({:?}, {} elements)", self.matrix, self.body.cells.len())
    }
}

//! The mixed element: 27 nodes, four pressures of its own, in a frame that turns along z.
//!
//! Positions are interpolated in a frame that turns with the reference coordinate Z: `x = Rz(psi + omega Z) y`, with
//! the quadratic field y as unknown. In the reference state the rate is `w0` and y is Y. A straight tube under
//! pressure has a y that does not depend on Z, however far it is twisted; a helical element whose edges follow the
//! fibres is a straight brick in the frame; and with the angle round the circumference as the phase psi, a circular
//! tube is exactly circular and y are its polar components. With psi = omega = w0 = 0 it is the ordinary
//! isoparametric hexahedron. Up to the rotation `Rz`, which no energy sees,
//!
//! ```text
//!     F = (y_k + e_z x y (psi_k + omega Z_k)) (Y_k + e_z x Y (psi_k + w0 Z_k))^-1      k = coordinates of the cube
//!       = sum_a [ y_a (x) grad N_a + N_a (e_z x y_a) (x) (grad psi + omega grad Z) ]
//!     Pi = int Psi(F) + k/2 (det F - 1)^2 + p (det F - 1) - p^2 / (2 (kappa - k)) dV
//! ```
//!
//! The four pressures hold averages of the volume only. k is what the rubber itself sets against the rest of it, which
//! the mesh cannot see: 2/3 mu ([`LOCAL_BULK`]) is that of Ogden's law written in whole stretches instead of isochoric
//! ones, `2 mu / alpha^2 sum(l^alpha - 1 - alpha ln l)`, which for an incompressible rubber is the same law. The term
//! and its derivative vanish where det F = 1, so the exact solution is that of every k (it is a consistent
//! augmentation), and a mesh's answers for different k meet as it is refined: of a blocked tube of 40 deg with strips
//! at 4 psi, k from 0 to 2 mu moves the force by 1.9 % on the coarse mesh of the fidelity's estimate and by 0.25 % on
//! the usual one. Under a line fibre the field is singular, nothing converges, and k goes on mattering as the mesh does
//! (4 % of that force).
//!
//! F is bilinear in y and omega: that is why a step of 50 degrees is no harder than one of 1 degree. The rate omega
//! is one more unknown of each element (the last row of its matrix), the same for all.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use nalgebra::{Matrix3, Matrix4, SMatrix, Vector3};

use super::shapes::{NODES, POINTS, PRESSURES, Shape};
use crate::fem::material::{Law, MaterialError};

/// Rows of an element's matrix: three for each node, and the rate of twist.
pub const SIZE: usize = 3 * NODES + 1;
/// The row of the rate of twist.
pub const TWIST: usize = SIZE - 1;
/// Local bulk modulus k over the shear modulus.
pub const LOCAL_BULK: f64 = 2.0 / 3.0;
const STACK: usize = 4 * POINTS;
/// Components (of the row, of the column) of the tangent's blocks; the others are mirror images.
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

/// Positions of an element's nodes.
pub type Positions = [Vector3<f64>; NODES];

/// One element's contribution to a system: derivatives of its energy by nodes and rate of twist.
#[derive(Clone, Debug)]
pub struct Contribution {
    /// Energy.
    pub energy: f64,
    /// First derivatives.
    pub force: [f64; SIZE],
    /// What the first derivatives gain once the fibre's tensions are those of its stretch.
    pub taken_up: [f64; SIZE],
    /// Largest difference of such a tension from what the stretch says.
    pub slack: f64,
    /// Second derivatives, column-major `SIZE` by `SIZE`.
    pub matrix: Vec<f64>,
    /// Derivatives of the misfit of volume.
    pub constraint: [[f64; SIZE]; PRESSURES],
    /// Misfit of volume, int phi (J - 1 - p / kappa).
    pub misfit: [f64; PRESSURES],
    /// int phi phi.
    pub mass: Matrix4<f64>,
    /// Part of the cavity's volume under its inner face.
    pub volume: f64,
    /// Derivatives of `volume`.
    pub volume_slope: [f64; SIZE],
}

impl Contribution {
    /// All zero.
    pub fn zero() -> Contribution {
        Contribution {
            energy: 0.0,
            force: [0.0; SIZE],
            taken_up: [0.0; SIZE],
            slack: 0.0,
            matrix: vec![0.0; SIZE * SIZE],
            constraint: [[0.0; SIZE]; PRESSURES],
            misfit: [0.0; PRESSURES],
            mass: Matrix4::zeros(),
            volume: 0.0,
            volume_slope: [0.0; SIZE],
        }
    }

    /// Adds to a second derivative and its mirror image.
    pub fn add_symmetric(&mut self, r: usize, c: usize, value: f64) {
        self.matrix[c * SIZE + r] += value;
        if r != c {
            self.matrix[r * SIZE + c] += value;
        }
    }

    /// Clears for the next element. The block of the nodes is overwritten by [`Kernel::solid`].
    fn reset(&mut self) {
        self.energy = 0.0;
        self.force = [0.0; SIZE];
        self.taken_up = [0.0; SIZE];
        self.slack = 0.0;
        self.constraint = [[0.0; SIZE]; PRESSURES];
        self.misfit = [0.0; PRESSURES];
        self.mass = Matrix4::zeros();
        self.volume = 0.0;
        self.volume_slope = [0.0; SIZE];
        for r in 0..SIZE {
            self.matrix[TWIST * SIZE + r] = 0.0;
            self.matrix[r * SIZE + TWIST] = 0.0;
        }
    }
}

/// Where an element is: reference positions in the frame, and the frame's rates.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// Y of the nodes.
    pub reference: &'a Positions,
    /// y of the nodes.
    pub current: &'a Positions,
    /// Phase of the frame at the nodes, rad: a turn of its own that varies round the circumference.
    pub phases: &'a [f64; NODES],
    /// Rate of turn of the frame in the reference state, per length.
    pub reference_rate: f64,
    /// Rate of turn of the frame, omega.
    pub rate: f64,
}

/// The rubber of an element.
#[derive(Clone, Copy, Debug)]
pub struct Rubber {
    /// Isochoric law.
    pub law: Law,
    /// 1 / (bulk modulus - local bulk modulus), 0 for an incompressible rubber.
    pub compressibility: f64,
    /// Local bulk modulus k.
    pub local_bulk: f64,
}

impl Rubber {
    /// A rubber of this bulk over shear modulus (above [`LOCAL_BULK`]); `None` is incompressible.
    pub fn new(law: Law, bulk: Option<f64>) -> Rubber {
        let local_bulk = LOCAL_BULK * law.shear_modulus();
        let compressibility = bulk.map_or(0.0, |bulk| 1.0 / (bulk * law.shear_modulus() - local_bulk));
        Rubber { law, compressibility, local_bulk }
    }
}

/// Shape functions and room for one element's products.
pub struct Kernel {
    shapes: Vec<Shape>,
    /// (gradients and value) of the shape functions at all points: `STACK` rows, a column for each node.
    gradients: Vec<f64>,
    /// Tangent times gradients: `STACK` rows, columns (pair of components, node).
    products: Vec<f64>,
    result: Vec<f64>,
}

impl Default for Kernel {
    fn default() -> Kernel {
        Kernel {
            shapes: Shape::gauss(),
            gradients: vec![0.0; STACK * NODES],
            products: vec![0.0; STACK * PAIRS.len() * NODES],
            result: vec![0.0; NODES * PAIRS.len() * NODES],
        }
    }
}

/// e_z x v.
pub fn across(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-v.y, v.x, 0.0)
}

/// The transposed operation: v . (e_z x u) = across_back(v) . u.
pub fn across_back(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.y, -v.x, 0.0)
}

impl Kernel {
    /// The rubber's part of `out`, which is reset. With `tangent` false the second derivatives stay undefined.
    pub fn solid(
        &mut self,
        place: &Place,
        pressure: &[f64; PRESSURES],
        rubber: &Rubber,
        tangent: bool,
        out: &mut Contribution,
    ) -> Result<(), MaterialError> {
        out.reset();
        for g in 0..POINTS {
            let shape = &self.shapes[g];
            let (mut base, mut here, mut turn) = (Matrix3::zeros(), Vector3::zeros(), Vector3::zeros());
            for (n, y) in place.reference.iter().enumerate() {
                here += y * shape.value[n];
                for k in 0..3 {
                    turn[k] += place.phases[n] * shape.slope[n][k];
                    for i in 0..3 {
                        base[(i, k)] += y[i] * shape.slope[n][k];
                    }
                }
            }
            let rise = base.row(2).transpose();
            base += across(&here) * (rise * place.reference_rate + turn).transpose();
            let determinant = base.determinant();
            let Some(inverse) = base.try_inverse().filter(|_| determinant > 0.0) else {
                return Err(MaterialError::Inverted(determinant));
            };
            let dv = determinant * shape.weight;
            let rise = inverse.transpose() * rise;
            // Gradient of the frame's whole turn.
            let turn = inverse.transpose() * turn + rise * place.rate;
            let (mut f, mut y) = (Matrix3::zeros(), Vector3::zeros());
            let mut gradient = [[0.0; 4]; NODES];
            for n in 0..NODES {
                let slope = &shape.slope[n];
                for j in 0..3 {
                    gradient[n][j] =
                        slope[0] * inverse[(0, j)] + slope[1] * inverse[(1, j)] + slope[2] * inverse[(2, j)];
                }
                gradient[n][3] = shape.value[n];
                let current = &place.current[n];
                y += current * shape.value[n];
                for j in 0..3 {
                    for i in 0..3 {
                        f[(i, j)] += current[i] * gradient[n][j];
                    }
                }
            }
            f += across(&y) * turn.transpose();
            let by_rate = across(&y) * rise.transpose();
            let response = rubber.law.respond(&f)?;
            let (ratio, cofactor) = rubber.law.volume(&f);
            let p: f64 = pressure.iter().zip(&shape.pressure).map(|(p, phi)| p * phi).sum();
            let local = rubber.local_bulk;
            let hydrostatic = p + local * (ratio - 1.0);
            let stress = response.stress + cofactor * hydrostatic;
            let change = ratio - 1.0;
            out.energy +=
                dv * (response.energy + (p + 0.5 * local * change) * change - 0.5 * p * p * rubber.compressibility);

            let stress4 = extend(&(stress * dv), &turn);
            let cofactor4 = extend(&(cofactor * dv), &turn);
            for n in 0..NODES {
                for i in 0..3 {
                    let dot = |v: &[[f64; 4]; 3]| -> f64 {
                        let (g, v) = (&gradient[n], &v[i]);
                        g[0] * v[0] + g[1] * v[1] + g[2] * v[2] + g[3] * v[3]
                    };
                    out.force[3 * n + i] += dot(&stress4);
                    let c = dot(&cofactor4);
                    for (row, phi) in out.constraint.iter_mut().zip(&shape.pressure) {
                        row[3 * n + i] += phi * c;
                    }
                }
            }
            out.force[TWIST] += dv * stress.dot(&by_rate);
            let misfit = ratio - 1.0 - p * rubber.compressibility;
            for (a, phi) in shape.pressure.iter().enumerate() {
                out.constraint[a][TWIST] += dv * phi * cofactor.dot(&by_rate);
                out.misfit[a] += dv * phi * misfit;
                for (b, other) in shape.pressure.iter().enumerate() {
                    out.mass[(a, b)] += dv * phi * other;
                }
            }
            if !tangent {
                continue;
            }

            let mut modulus = response.tangent;
            rubber.law.add_volume_tangent(hydrostatic, &f, &mut modulus);
            let by_volume = SMatrix::<f64, 9, 1>::from_fn(|r, _| cofactor[(r / 3, r % 3)]);
            modulus.ger(local, &by_volume, &by_volume, 1.0);
            modulus *= dv;
            // Second derivatives by the rate.
            let flat = SMatrix::<f64, 9, 1>::from_fn(|r, _| by_rate[(r / 3, r % 3)]);
            let pull = modulus * flat;
            out.matrix[SIZE * SIZE - 1] += pull.dot(&flat);
            let pull = Matrix3::from_fn(|i, j| pull[3 * i + j]);
            let mut pull4 = extend(&pull, &turn);
            let extra = across_back(&(stress * rise * dv));
            for i in 0..3 {
                pull4[i][3] += extra[i];
            }
            for n in 0..NODES {
                for i in 0..3 {
                    let (g, v) = (&gradient[n], &pull4[i]);
                    let value = g[0] * v[0] + g[1] * v[1] + g[2] * v[2] + g[3] * v[3];
                    out.matrix[TWIST * SIZE + 3 * n + i] += value;
                }
            }
            // The modulus on (gradients, value): 12 by 12, as blocks [i][k] of [n][m].
            let blocks = modulus12(&modulus, &turn);
            for (n, gradient) in gradient.iter().enumerate() {
                self.gradients[STACK * n + 4 * g..][..4].copy_from_slice(gradient);
                for (pair, (i, k)) in PAIRS.into_iter().enumerate() {
                    let block = &blocks[i][k];
                    let target = &mut self.products[STACK * (NODES * pair + n) + 4 * g..][..4];
                    for m in 0..4 {
                        target[m] = block[0][m] * gradient[0]
                            + block[1][m] * gradient[1]
                            + block[2][m] * gradient[2]
                            + block[3][m] * gradient[3];
                    }
                }
            }
        }
        if !tangent {
            return Ok(());
        }
        matmul(
            MatMut::from_column_major_slice_mut(&mut self.result, NODES, PAIRS.len() * NODES),
            Accum::Replace,
            MatRef::from_column_major_slice(&self.gradients, STACK, NODES).transpose(),
            MatRef::from_column_major_slice(&self.products, STACK, PAIRS.len() * NODES),
            1.0,
            Par::Seq,
        );
        for (pair, (i, k)) in PAIRS.into_iter().enumerate() {
            for m in 0..NODES {
                let from = &self.result[NODES * (NODES * pair + m)..][..NODES];
                for (n, value) in from.iter().enumerate() {
                    out.matrix[SIZE * (3 * m + k) + 3 * n + i] = *value;
                    out.matrix[SIZE * (3 * n + i) + 3 * m + k] = *value;
                }
            }
        }
        for n in 0..TWIST {
            out.matrix[SIZE * n + TWIST] = out.matrix[SIZE * TWIST + n];
        }
        Ok(())
    }
}

/// What multiplies (gradient, value) of a shape function when `stress` multiplies F: columns J, and the value.
fn extend(stress: &Matrix3<f64>, turn: &Vector3<f64>) -> [[f64; 4]; 3] {
    let turned = across_back(&(stress * turn));
    std::array::from_fn(|i| [stress[(i, 0)], stress[(i, 1)], stress[(i, 2)], turned[i]])
}

/// The same for the tangent, on both sides: `[i][k][q][m]` multiplies component q of the column's function (k) and
/// component m of the row's (i).
fn modulus12(modulus: &SMatrix<f64, 9, 9>, turn: &Vector3<f64>) -> [[[[f64; 4]; 4]; 3]; 3] {
    // Columns first: 9 by (k, q).
    let mut half = [[[0.0; 4]; 3]; 9];
    for (row, half) in half.iter_mut().enumerate() {
        let of_row = Matrix3::from_fn(|k, l| modulus[(row, 3 * k + l)]);
        *half = extend(&of_row, turn);
    }
    let mut blocks = [[[[0.0; 4]; 4]; 3]; 3];
    for k in 0..3 {
        for q in 0..4 {
            let of_column = Matrix3::from_fn(|i, j| half[3 * i + j][k][q]);
            let full = extend(&of_column, turn);
            for i in 0..3 {
                blocks[i][k][q] = full[i];
            }
        }
    }
    blocks
}

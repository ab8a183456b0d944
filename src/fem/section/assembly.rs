//! Residual and tangent of half a sector's potential at a state.
//!
//! In the frame that turns with the point, `d = (d_r, d_theta, d_z)` is linear in the unknowns, and with
//! `E d = e_z x d`
//!
//! ```text
//!     F = [ d_R,  (d_psi + E d) / R,  lam e_z + tau E d - w d_psi ]
//! ```
//!
//! so everything is a function of nine values a point, `(d_R, d_psi, d)`, and of (lam, tau). A rigid turn about the
//! axis and a shift along it lie in the discrete space exactly.
//!
//! Incompressibility is exact: the tangent is that of the saddle point, and `B^T M^-1 B / EPSILON` is added to its
//! displacement block only to factorise it as a positive definite matrix (see [`super::saddle`]).

use nalgebra::{Matrix3, Vector3};

use super::SectionError;
use super::band::Band;
use super::fields::{DOFS, Fields, NODES, Point, Sector};
use crate::fem::material::Tangent;

/// Compressibility, over 1 / mu, of the matrix that is factorised. It sets how fast the saddle point's iteration
/// contracts (by about this much), never what it converges to.
pub(super) const EPSILON: f64 = 1e-6;

/// B of one element: derivative of its three volume constraints by its unknowns.
pub(super) type Gradient = [[f64; DOFS]; 3];

/// Everything that Newton's method and the section's law need at one state, for half a sector.
#[derive(Clone, Debug)]
pub(super) struct Assembly {
    /// Second derivative of the potential by the positions, plus `B^T M^-1 B / EPSILON`.
    pub(super) stiffness: Band,
    /// Derivative of the potential by the positions.
    pub(super) residual: Vec<f64>,
    /// Volume constraints of every element and their derivative.
    pub(super) constraint: Vec<[f64; 3]>,
    pub(super) gradient: Vec<Gradient>,
    /// Derivative of the residual by (stretch, twist, pressure).
    pub(super) coupling: [Vec<f64>; 3],
    /// Derivative of the constraints by (stretch, twist, pressure).
    pub(super) constraint_coupling: Vec<[[f64; 3]; 3]>,
    /// Derivative of the potential by (stretch, twist, pressure), and the second derivative.
    pub(super) conjugate: Vector3<f64>,
    pub(super) hessian: Matrix3<f64>,
    /// The potential.
    pub(super) energy: f64,
}

impl Assembly {
    pub(super) fn new(sector: &Sector) -> Assembly {
        let (dofs, elements) = (3 * sector.nodes(), sector.points.len());
        Assembly {
            stiffness: sector.band(3),
            residual: vec![0.0; dofs],
            constraint: vec![[0.0; 3]; elements],
            gradient: vec![[[0.0; DOFS]; 3]; elements],
            coupling: [vec![0.0; dofs], vec![0.0; dofs], vec![0.0; dofs]],
            constraint_coupling: vec![[[0.0; 3]; 3]; elements],
            conjugate: Vector3::zeros(),
            hessian: Matrix3::zeros(),
            energy: 0.0,
        }
    }

    /// Fills everything at `fields`. Fails where the rubber is turned inside out.
    pub(super) fn fill(&mut self, sector: &Sector, fields: &Fields) -> Result<(), SectionError> {
        self.stiffness.clear();
        self.residual.fill(0.0);
        self.coupling.iter_mut().for_each(|column| column.fill(0.0));
        (self.conjugate, self.hessian, self.energy) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
        for column in 0..sector.columns() {
            for row in 0..sector.rows() {
                self.add_element(sector, fields, column, row)?;
            }
            self.add_cavity(sector, fields, column);
            if column < sector.grid.strip_columns {
                self.add_strip(sector, fields, column);
            }
        }
        if sector.half_width == 0.0 {
            self.add_fiber(sector, fields, &[(sector.rings() - 1, 1.0)], 1.0);
        }
        Ok(())
    }

    fn add_element(&mut self, sector: &Sector, fields: &Fields, column: usize, row: usize) -> Result<(), SectionError> {
        let nodes = sector.element(column, row);
        let index = column * sector.rows() + row;
        let mut local = Local::default();
        let mut values = [[0.0; 3]; NODES];
        for (value, node) in values.iter_mut().zip(nodes) {
            value.copy_from_slice(&fields.position[3 * node..][..3]);
        }
        for point in &sector.points[index] {
            local.add_point(sector, point, &values, &fields.multiplier[index], &fields.globals)?;
        }
        let penalty = sector.mass[index].map(|mass| 1.0 / (EPSILON * mass));
        for (b, &node_b) in nodes.iter().enumerate() {
            for (a, &node_a) in nodes.iter().enumerate().skip(b) {
                let block = &mut local.stiffness[b][a];
                for (gradient, factor) in local.gradient.iter().zip(penalty) {
                    for c in 0..3 {
                        let value = factor * gradient[3 * b + c];
                        for k in 0..3 {
                            block[3 * c + k] += value * gradient[3 * a + k];
                        }
                    }
                }
                for c in 0..3 {
                    for k in if a == b { c } else { 0 }..3 {
                        self.stiffness.add(3 * node_a + k, 3 * node_b + c, block[3 * c + k]);
                    }
                }
            }
            for c in 0..3 {
                let (local_dof, global) = (3 * b + c, 3 * node_b + c);
                self.residual[global] += local.residual[local_dof];
                self.coupling[0][global] += local.coupling[0][local_dof];
                self.coupling[1][global] += local.coupling[1][local_dof];
            }
        }
        self.constraint[index] = local.constraint;
        self.gradient[index] = local.gradient;
        self.constraint_coupling[index] = [local.constraint_coupling[0], local.constraint_coupling[1], [0.0; 3]];
        self.conjugate += local.conjugate;
        self.hessian += local.hessian;
        self.energy += local.energy;
        Ok(())
    }

    /// `-P V`, with `V = 1/2 int lam (r^2 + d_r d_theta,psi - d_theta d_r,psi) - (w + tau) r^2 d_z,psi dpsi`.
    fn add_cavity(&mut self, sector: &Sector, fields: &Fields, column: usize) {
        let [stretch, twist, pressure] = fields.globals;
        let rate = sector.winding + twist;
        let nodes: [usize; 3] = std::array::from_fn(|k| sector.node(2 * column + k, 0));
        for point in &sector.edges[column] {
            let (mut d, mut s) = (Vector3::zeros(), Vector3::zeros());
            for (node, [slope, value]) in nodes.iter().zip(point.shape) {
                let x = Vector3::from_column_slice(&fields.position[3 * node..][..3]);
                d += x * value;
                s += x * slope;
            }
            let square = d.x * d.x + d.y * d.y;
            let swept = 0.5 * (square + d.x * s.y - d.y * s.x);
            let turned = -0.5 * square * s.z;
            let weight = point.weight;
            self.energy -= pressure * weight * (stretch * swept + rate * turned);
            self.conjugate -=
                Vector3::new(pressure * swept, pressure * turned, stretch * swept + rate * turned) * weight;
            self.hessian[(0, 2)] -= weight * swept;
            self.hessian[(2, 0)] -= weight * swept;
            self.hessian[(1, 2)] -= weight * turned;
            self.hessian[(2, 1)] -= weight * turned;
            // Derivatives by (s, d), and the second ones.
            let of_swept = [-0.5 * d.y, 0.5 * d.x, 0.0, d.x + 0.5 * s.y, d.y - 0.5 * s.x, 0.0];
            let of_turned = [0.0, 0.0, -0.5 * square, -d.x * s.z, -d.y * s.z, 0.0];
            let mut second = [[0.0; 6]; 6];
            let own = stretch - rate * s.z;
            for (i, j, value) in [
                (3, 3, own),
                (4, 4, own),
                (3, 1, 0.5 * stretch),
                (4, 0, -0.5 * stretch),
                (3, 2, -rate * d.x),
                (4, 2, -rate * d.y),
            ] {
                second[i][j] = value;
                second[j][i] = value;
            }
            let scaled = |node: usize, at: usize| point.shape[node][usize::from(at >= 3)];
            for (b, &node_b) in nodes.iter().enumerate() {
                for at_b in 0..6 {
                    let factor = weight * scaled(b, at_b);
                    let global = 3 * node_b + at_b % 3;
                    self.coupling[0][global] -= pressure * factor * of_swept[at_b];
                    self.coupling[1][global] -= pressure * factor * of_turned[at_b];
                    let gradient = stretch * of_swept[at_b] + rate * of_turned[at_b];
                    self.coupling[2][global] -= factor * gradient;
                    self.residual[global] -= pressure * factor * gradient;
                    for (a, &node_a) in nodes.iter().enumerate().skip(b) {
                        for (at_a, second) in second.iter().enumerate() {
                            let row = 3 * node_a + at_a % 3;
                            if row >= global && second[at_b] != 0.0 {
                                let value = pressure * factor * scaled(a, at_a) * second[at_b];
                                self.stiffness.add(row, global, -value);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Fibres of a column under the strip: average over the strip's angle, of which half lies here.
    fn add_strip(&mut self, sector: &Sector, fields: &Fields, column: usize) {
        let ring = sector.rings() - 1;
        for point in &sector.edges[column] {
            let nodes: [(usize, f64); 3] =
                std::array::from_fn(|k| (sector.node(2 * column + k, ring), point.shape[k][1]));
            self.add_fiber(sector, fields, &nodes, point.weight / sector.half_width);
        }
    }

    /// `weight EA / (4 cos G) (lf - 1)^2` of a fibre through the point that `nodes` interpolate.
    fn add_fiber(&mut self, sector: &Sector, fields: &Fields, nodes: &[(usize, f64)], weight: f64) {
        let stretch = fields.globals[0];
        let rate = sector.winding + fields.globals[1];
        let (mut x, mut y) = (0.0, 0.0);
        for &(node, value) in nodes {
            x += value * fields.position[3 * node];
            y += value * fields.position[3 * node + 1];
        }
        let square = x * x + y * y;
        let length = (rate * rate * square + stretch * stretch).sqrt();
        let strain = sector.cosine * length - 1.0;
        let factor = weight * sector.fiber;
        let slope = 2.0 * factor * sector.cosine * strain;
        let curvature = 2.0 * factor * sector.cosine * sector.cosine;
        // Derivatives of the length by (x, y, stretch, rate).
        let first = [rate * rate * x, rate * rate * y, stretch, rate * square].map(|value| value / length);
        let mut second = [[0.0; 4]; 4];
        for (i, j, value) in [
            (0, 0, rate * rate),
            (1, 1, rate * rate),
            (2, 2, 1.0),
            (3, 3, square),
            (3, 0, 2.0 * rate * x),
            (3, 1, 2.0 * rate * y),
        ] {
            second[i][j] = value;
            second[j][i] = value;
        }
        for i in 0..4 {
            for j in 0..4 {
                second[i][j] = slope * (second[i][j] - first[i] * first[j]) / length + curvature * first[i] * first[j];
            }
        }
        self.energy += factor * strain * strain;
        for i in 0..2 {
            self.conjugate[i] += slope * first[2 + i];
            for j in 0..2 {
                self.hessian[(i, j)] += second[2 + i][2 + j];
            }
        }
        for (position, &(node_b, value_b)) in nodes.iter().enumerate() {
            for j in 0..2 {
                let global = 3 * node_b + j;
                self.residual[global] += slope * first[j] * value_b;
                for k in 0..2 {
                    self.coupling[k][global] += second[j][2 + k] * value_b;
                }
                for &(node_a, value_a) in &nodes[position..] {
                    for (i, row) in second.iter().enumerate().take(2) {
                        if 3 * node_a + i >= global {
                            self.stiffness.add(3 * node_a + i, global, row[j] * value_a * value_b);
                        }
                    }
                }
            }
        }
    }
}

/// Sums over one element. `stiffness[b][a][3 c + k]` is the entry in the row of component k of node a and the column of
/// component c of node b; only a >= b is filled.
struct Local {
    stiffness: [[[f64; 9]; NODES]; NODES],
    residual: [f64; DOFS],
    coupling: [[f64; DOFS]; 2],
    constraint: [f64; 3],
    gradient: Gradient,
    constraint_coupling: [[f64; 3]; 2],
    conjugate: Vector3<f64>,
    hessian: Matrix3<f64>,
    energy: f64,
}

impl Default for Local {
    fn default() -> Local {
        Local {
            stiffness: [[[0.0; 9]; NODES]; NODES],
            residual: [0.0; DOFS],
            coupling: [[0.0; DOFS]; 2],
            constraint: [0.0; 3],
            gradient: [[0.0; DOFS]; 3],
            constraint_coupling: [[0.0; 3]; 2],
            conjugate: Vector3::zeros(),
            hessian: Matrix3::zeros(),
            energy: 0.0,
        }
    }
}

/// Columns of dF by (d_R, d_psi, d): what a 3 x 3 "stress" does on them. `frame` is (1 / R, w, tau).
fn pull_back(stress: impl Fn(usize, usize) -> f64, frame: [f64; 3]) -> [f64; 9] {
    let [inverse, winding, twist] = frame;
    let turned = |i: usize| stress(i, 1) * inverse + twist * stress(i, 2);
    let slope = |i: usize| stress(i, 1) * inverse - winding * stress(i, 2);
    // E^T v = (v_theta, -v_r, 0).
    [stress(0, 0), stress(1, 0), stress(2, 0), slope(0), slope(1), slope(2), turned(1), -turned(0), 0.0]
}

/// (d_R, d_psi, d) at a point.
pub(super) fn values_at(point: &Point, values: &[[f64; 3]; NODES]) -> [Vector3<f64>; 3] {
    let mut sums = [Vector3::zeros(); 3];
    for (shape, value) in point.shape.iter().zip(values) {
        let value = Vector3::from(*value);
        for (sum, factor) in sums.iter_mut().zip(shape) {
            *sum += value * *factor;
        }
    }
    sums
}

/// E d = e_z x d.
pub(super) fn turn(d: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-d.y, d.x, 0.0)
}

/// Deformation gradient at a point.
pub(super) fn deformation(
    [across, along, d]: &[Vector3<f64>; 3],
    radius: f64,
    winding: f64,
    globals: &[f64; 3],
) -> Matrix3<f64> {
    let turned = turn(d);
    let axial = turned * globals[1] - along * winding + Vector3::new(0.0, 0.0, globals[0]);
    Matrix3::from_columns(&[*across, (along + turned) / radius, axial])
}

impl Local {
    fn add_point(
        &mut self,
        sector: &Sector,
        point: &Point,
        values: &[[f64; 3]; NODES],
        multiplier: &[f64; 3],
        globals: &[f64; 3],
    ) -> Result<(), SectionError> {
        let (law, weight) = (sector.law, point.weight);
        let at = values_at(point, values);
        let f = deformation(&at, point.radius, sector.winding, globals);
        let response = law.respond(&f).map_err(|_| SectionError::Inverted)?;
        let (volume, cofactor) = law.volume(&f);
        let q: f64 = multiplier.iter().zip(point.pressure).map(|(q, n)| q * n).sum();
        let mut tangent = response.tangent;
        law.add_volume_tangent(q, &f, &mut tangent);
        let stress = response.stress + cofactor * q;
        let frame = [1.0 / point.radius, sector.winding, globals[1]];

        // dF / dtau = E d in the last column.
        let by_twist = turn(&at[2]);
        let on_twist = |row: usize| tangent[(row, 2)] * by_twist.x + tangent[(row, 5)] * by_twist.y;
        self.energy += weight * (response.energy + q * (volume - 1.0));
        self.conjugate.x += weight * stress[(2, 2)];
        self.conjugate.y += weight * (stress[(0, 2)] * by_twist.x + stress[(1, 2)] * by_twist.y);
        let mixed = weight * on_twist(8);
        self.hessian[(0, 0)] += weight * tangent[(8, 8)];
        self.hessian[(0, 1)] += mixed;
        self.hessian[(1, 0)] += mixed;
        self.hessian[(1, 1)] += weight * (on_twist(2) * by_twist.x + on_twist(5) * by_twist.y);

        let force = pull_back(|i, j| stress[(i, j)], frame);
        let volumetric = pull_back(|i, j| cofactor[(i, j)], frame);
        let by_stretch = pull_back(|i, j| tangent[(3 * i + j, 8)], frame);
        let mut of_twist = pull_back(|i, j| on_twist(3 * i + j), frame);
        of_twist[6] += stress[(1, 2)];
        of_twist[7] -= stress[(0, 2)];
        let gained = weight * (volume - 1.0);
        let volume_by_twist = cofactor[(0, 2)] * by_twist.x + cofactor[(1, 2)] * by_twist.y;
        for (k, n) in point.pressure.iter().enumerate() {
            self.constraint[k] += n * gained;
            self.constraint_coupling[0][k] += n * weight * cofactor[(2, 2)];
            self.constraint_coupling[1][k] += n * weight * volume_by_twist;
        }
        let moduli = condensed(&tangent, frame);

        for (b, shape) in point.shape.iter().enumerate() {
            let scaled = shape.map(|s| s * weight);
            let project = |vector: &[f64; 9], c: usize| {
                scaled[0] * vector[c] + scaled[1] * vector[3 + c] + scaled[2] * vector[6 + c]
            };
            for c in 0..3 {
                let local = 3 * b + c;
                self.residual[local] += project(&force, c);
                self.coupling[0][local] += project(&by_stretch, c);
                self.coupling[1][local] += project(&of_twist, c);
                let volumetric = project(&volumetric, c);
                for (k, n) in point.pressure.iter().enumerate() {
                    self.gradient[k][local] += n * volumetric;
                }
            }
            // Rows (d_R, d_psi, d) of the moduli against this node's three components, then every node's own shape on
            // them.
            let mut rows = [[0.0; 9]; 3];
            for (which, row) in rows.iter_mut().enumerate() {
                for c in 0..3 {
                    for k in 0..3 {
                        row[3 * c + k] = project(&moduli[3 * which + k], c);
                    }
                }
            }
            for (block, s) in self.stiffness[b][b..].iter_mut().zip(&point.shape[b..]) {
                for (i, value) in block.iter_mut().enumerate() {
                    *value += s[0] * rows[0][i] + s[1] * rows[1][i] + s[2] * rows[2][i];
                }
            }
        }
        Ok(())
    }
}

/// Second derivative of the energy by (d_R, d_psi, d).
fn condensed(tangent: &Tangent, frame: [f64; 3]) -> [[f64; 9]; 9] {
    let mut half = [[0.0; 9]; 9];
    for (row, target) in half.iter_mut().enumerate() {
        *target = pull_back(|k, l| tangent[(row, 3 * k + l)], frame);
    }
    let mut moduli = [[0.0; 9]; 9];
    for column in 0..9 {
        let values = pull_back(|i, j| half[3 * i + j][column], frame);
        for (row, value) in values.into_iter().enumerate() {
            moduli[row][column] = value;
        }
    }
    moduli
}

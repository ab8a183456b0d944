//! Second variation of the potential in fields that go m times round the section, about an equilibrium.
//!
//! The fields are `Re( exp(i m (psi + (w + tau) Z)) d )` with d periodic over a sector: the same in every section
//! when seen from outside. The derivative round and along the tube turns with the phase, `E -> T = E + i m`:
//!
//! ```text
//!     F1 = [ d_R,  (d_psi + T d) / R,  tau T d - w d_psi + gam + kap x d0 ]
//! ```
//!
//! Uniform curvature kap and shear strain gam (m = 1, fixed directions outside) enter as shown, and to second order
//! `kap x d` in the last column. Half a turn about the radius through the fibre, with complex conjugation, makes the
//! Hermitian form real: `d = d_even + i d_odd` on half a sector, where d_even has the equilibrium's symmetry and d_odd
//! the opposite one, with kap and gam in the direction `i (1, i, 0)`.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::SectionError;
use super::assembly::{EPSILON, deformation, turn, values_at};
use super::band::Band;
use super::fields::{Fields, NODES, Sector};

/// Displacement unknowns of one element: even and odd fields.
pub(super) const DOFS: usize = 54;
/// Unknowns at a point, (d_R, d_psi, d) even and odd, and the curvature and the shear strain.
const POINT: usize = 20;
/// Where the two macroscopic strains stand.
const CURVATURE: usize = 18;
const SHEAR: usize = 19;

/// A 3-vector's real or imaginary part as a linear map of a point's unknowns.
type Map = SMatrix<f64, 3, POINT>;

/// Quadratic form `x^T K x + 2 q^T B x + 2 z^T f^T x + ...` of half a sector; the energy per length is a quarter of
/// it times the half sectors.
#[derive(Clone, Debug)]
pub(super) struct Phased {
    /// K, plus the penalty that [`super::saddle`] takes.
    pub(super) stiffness: Band,
    pub(super) gradient: Vec<[[f64; DOFS]; 6]>,
    /// Derivatives of `K x` and `B x` by the curvature and the shear strain.
    pub(super) coupling: [Vec<f64>; 2],
    pub(super) constraint_coupling: Vec<[[f64; 6]; 2]>,
    pub(super) macroscopic: [[f64; 2]; 2],
    /// Mean translation and mean turn of the section as functionals of x.
    pub(super) translation: Vec<f64>,
    pub(super) rotation: Vec<f64>,
}

/// The linear maps of the first variation at a point: real parts, then imaginary ones.
struct Maps {
    /// d.
    position: [Map; 2],
    /// Derivative round the section at fixed Z, d_psi + T d.
    around: [Map; 2],
    /// Derivative along a fibre, (w + tau) T d + kap x d0.
    along: [Map; 2],
    /// gam.
    shear: [Map; 2],
    /// `Re(kap* x d)` per unit curvature, on even and odd d.
    bend: Map,
}

/// Skew matrix of `v x`.
fn cross(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

impl Maps {
    fn new(order: f64, rate: f64, d0: &Vector3<f64>) -> Maps {
        let place = |part: usize, which: usize, block: &Matrix3<f64>| {
            let mut map = Map::zeros();
            map.fixed_view_mut::<3, 3>(0, 9 * part + 3 * which).copy_from(block);
            map
        };
        let identity = Matrix3::identity();
        let turn = cross(&Vector3::z());
        let phase = identity * order;
        let position = [place(0, 2, &identity), place(1, 2, &identity)];
        // T d: real part E d_even - m d_odd, imaginary part E d_odd + m d_even.
        let turned = [place(0, 2, &turn) - place(1, 2, &phase), place(1, 2, &turn) + place(0, 2, &phase)];
        let around = [place(0, 1, &identity) + turned[0], place(1, 1, &identity) + turned[1]];
        let directions = [-Vector3::y(), Vector3::x()];
        let mut along = turned.map(|map| map * rate);
        let mut shear = [Map::zeros(), Map::zeros()];
        let mut bend = Map::zeros();
        for (part, direction) in directions.iter().enumerate() {
            along[part].set_column(CURVATURE, &direction.cross(d0));
            shear[part].set_column(SHEAR, direction);
            bend += place(part, 2, &cross(direction));
        }
        Maps { position, around, along, shear, bend }
    }
}

/// Adds `2 row x[CURVATURE]` to a symmetric quadratic form.
fn add_bend(form: &mut SMatrix<f64, POINT, POINT>, row: &SMatrix<f64, 1, POINT>, factor: f64) {
    for k in 0..POINT {
        form[(CURVATURE, k)] += factor * row[k];
        form[(k, CURVATURE)] += factor * row[k];
    }
}

impl Phased {
    /// The form about `fields` in fields that go `order` times round.
    pub(super) fn new(sector: &Sector, fields: &Fields, order: usize) -> Result<Phased, SectionError> {
        let (unknowns, elements) = (6 * sector.nodes(), sector.points.len());
        let zero = || vec![0.0; unknowns];
        let mut form = Phased {
            stiffness: sector.band(6),
            gradient: vec![[[0.0; DOFS]; 6]; elements],
            coupling: [zero(), zero()],
            constraint_coupling: vec![[[0.0; 6]; 2]; elements],
            macroscopic: [[0.0; 2]; 2],
            translation: zero(),
            rotation: zero(),
        };
        let order = order as f64;
        for column in 0..sector.columns() {
            for row in 0..sector.rows() {
                form.add_element(sector, fields, order, column, row)?;
            }
            form.add_cavity(sector, fields, order, column);
            if column < sector.grid.strip_columns {
                let ring = sector.rings() - 1;
                for point in &sector.edges[column] {
                    let nodes: [(usize, f64); 3] =
                        std::array::from_fn(|k| (sector.node(2 * column + k, ring), point.shape[k][1]));
                    form.add_fiber(sector, fields, order, &nodes, point.weight / sector.half_width);
                }
            }
        }
        if sector.half_width == 0.0 {
            form.add_fiber(sector, fields, order, &[(sector.rings() - 1, 1.0)], 1.0);
        }
        Ok(form)
    }

    /// Unknowns that the symmetry holds.
    pub(super) fn fixed(sector: &Sector) -> Vec<bool> {
        let (nodes, rings) = (sector.nodes(), sector.rings());
        let mut fixed = vec![false; 6 * nodes];
        for node in (0..rings).chain(nodes - rings..nodes) {
            for component in [1, 2, 3] {
                fixed[6 * node + component] = true;
            }
        }
        fixed
    }

    fn add_element(
        &mut self,
        sector: &Sector,
        fields: &Fields,
        order: f64,
        column: usize,
        row: usize,
    ) -> Result<(), SectionError> {
        let nodes = sector.element(column, row);
        let index = column * sector.rows() + row;
        let mut values = [[0.0; 3]; NODES];
        for (value, node) in values.iter_mut().zip(nodes) {
            value.copy_from_slice(&fields.position[3 * node..][..3]);
        }
        let [_, twist, _] = fields.globals;
        for point in &sector.points[index] {
            let at = values_at(point, &values);
            let d0 = at[2];
            let f = deformation(&at, point.radius, sector.winding, &fields.globals);
            let response = sector.law.respond(&f).map_err(|_| SectionError::Inverted)?;
            let (_, cofactor) = sector.law.volume(&f);
            let q: f64 = fields.multiplier[index].iter().zip(point.pressure).map(|(q, n)| q * n).sum();
            let mut tangent = response.tangent;
            sector.law.add_volume_tangent(q, &f, &mut tangent);
            let stress = response.stress + cofactor * q;

            // Along Z: the derivative along a fibre less w times the one round the section.
            let maps = Maps::new(order, sector.winding + twist, &d0);
            let mut form = SMatrix::<f64, POINT, POINT>::zeros();
            let mut volumes = [SVector::<f64, POINT>::zeros(); 2];
            for (part, volume) in volumes.iter_mut().enumerate() {
                let mut across = Map::zeros();
                across.fixed_view_mut::<3, 3>(0, 9 * part).copy_from(&Matrix3::identity());
                let axial = maps.along[part] + maps.shear[part] - maps.around[part] * sector.winding;
                let columns = [across, maps.around[part] / point.radius, axial];
                let gradient = SMatrix::<f64, 9, POINT>::from_fn(|row, column| columns[row % 3][(row / 3, column)]);
                form += gradient.transpose() * tangent * gradient;
                let flat = SVector::<f64, 9>::from_fn(|row, _| cofactor[(row / 3, row % 3)]);
                *volume = gradient.transpose() * flat;
            }
            add_bend(&mut form, &(stress.column(2).transpose() * maps.bend), 1.0);
            form *= point.weight;

            let project = |column: &SVector<f64, POINT>, shape: &[f64; 3], component: usize| -> f64 {
                let base = 9 * (component / 3) + component % 3;
                (0..3).map(|which| shape[which] * column[base + 3 * which]).sum()
            };
            for (b, shape_b) in point.shape.iter().enumerate() {
                for c in 0..6 {
                    let global = 6 * nodes[b] + c;
                    let column: SVector<f64, POINT> =
                        SVector::from_fn(|row, _| project(&form.column(row).into_owned(), shape_b, c));
                    for (a, shape_a) in point.shape.iter().enumerate().skip(b) {
                        for k in 0..6 {
                            if a > b || k >= c {
                                self.stiffness.add(6 * nodes[a] + k, global, project(&column, shape_a, k));
                            }
                        }
                    }
                    self.coupling[0][global] += column[CURVATURE];
                    self.coupling[1][global] += column[SHEAR];
                    for (part, volume) in volumes.iter().enumerate() {
                        let value = point.weight * project(volume, shape_b, c);
                        for (k, n) in point.pressure.iter().enumerate() {
                            self.gradient[index][3 * part + k][6 * b + c] += n * value;
                        }
                    }
                }
                // Mean translation (along the radius through the fibre) and turn (about it).
                let weight = point.weight * shape_b[2];
                self.translation[6 * nodes[b]] += 0.5 * weight;
                self.translation[6 * nodes[b] + 4] += 0.5 * weight;
                self.rotation[6 * nodes[b] + 2] += weight * d0.y;
                self.rotation[6 * nodes[b] + 5] -= weight * d0.x;
            }
            for (part, volume) in volumes.iter().enumerate() {
                for (k, n) in point.pressure.iter().enumerate() {
                    for (strain, at) in [CURVATURE, SHEAR].into_iter().enumerate() {
                        self.constraint_coupling[index][strain][3 * part + k] += n * point.weight * volume[at];
                    }
                }
            }
            self.add_macroscopic(&form);
        }
        self.add_penalty(sector, &nodes, index);
        Ok(())
    }

    fn add_penalty(&mut self, sector: &Sector, nodes: &[usize; NODES], index: usize) {
        for (k, gradient) in self.gradient[index].iter().enumerate() {
            let factor = 1.0 / (EPSILON * sector.mass[index][k % 3]);
            for b in 0..DOFS {
                for a in b..DOFS {
                    let (row, column) = (6 * nodes[a / 6] + a % 6, 6 * nodes[b / 6] + b % 6);
                    self.stiffness.add(row, column, factor * gradient[a] * gradient[b]);
                }
            }
        }
    }

    fn add_macroscopic(&mut self, form: &SMatrix<f64, POINT, POINT>) {
        for i in 0..2 {
            for j in 0..2 {
                self.macroscopic[i][j] += form[(CURVATURE + i, CURVATURE + j)];
            }
        }
    }

    /// Adds a form in the values (and derivatives by psi) on a line of nodes.
    fn add_edge(&mut self, form: &SMatrix<f64, POINT, POINT>, nodes: &[(usize, [f64; 2])]) {
        // Column of the point's unknowns for a node's component: (d_psi, d) of its part.
        let project = |column: &SVector<f64, POINT>, shape: &[f64; 2], component: usize| {
            let base = 9 * (component / 3) + component % 3;
            shape[0] * column[base + 3] + shape[1] * column[base + 6]
        };
        for (position, (node_b, shape_b)) in nodes.iter().enumerate() {
            for c in 0..6 {
                let global = 6 * node_b + c;
                let column: SVector<f64, POINT> =
                    SVector::from_fn(|row, _| project(&form.column(row).into_owned(), shape_b, c));
                self.coupling[0][global] += column[CURVATURE];
                self.coupling[1][global] += column[SHEAR];
                for (node_a, shape_a) in &nodes[position..] {
                    for k in 0..6 {
                        if 6 * node_a + k >= global {
                            self.stiffness.add(6 * node_a + k, global, project(&column, shape_a, k));
                        }
                    }
                }
            }
        }
        self.add_macroscopic(form);
    }

    /// `-P V''`. The volume between sections is swept by the rays from the axis: with Y the position and G its
    /// derivative along a fibre, `V = int (Y x Y_psi) . (Gam / 2 + G / 3) dpsi`.
    fn add_cavity(&mut self, sector: &Sector, fields: &Fields, order: f64, column: usize) {
        let [stretch, twist, pressure] = fields.globals;
        let rate = sector.winding + twist;
        for point in &sector.edges[column] {
            let nodes: [(usize, [f64; 2]); 3] =
                std::array::from_fn(|k| (sector.node(2 * column + k, 0), point.shape[k]));
            let (mut d0, mut slope) = (Vector3::zeros(), Vector3::zeros());
            for (node, [derivative, value]) in nodes {
                let x = Vector3::from_column_slice(&fields.position[3 * node..][..3]);
                d0 += x * value;
                slope += x * derivative;
            }
            let around = slope + turn(&d0);
            let middle = Vector3::z() * (0.5 * stretch) + turn(&d0) * (rate / 3.0);
            let maps = Maps::new(order, rate, &d0);
            let mut form = SMatrix::<f64, POINT, POINT>::zeros();
            for part in 0..2 {
                let (y, a) = (&maps.position[part], &maps.around[part]);
                let g = maps.shear[part] * 0.5 + maps.along[part] / 3.0;
                // (Y x A) . m = Y . (A x m) = -Y . (m x A), and the mixed terms with the equilibrium.
                let product = -(y.transpose() * cross(&middle) * a) - y.transpose() * cross(&around).transpose() * g
                    + (a.transpose() * cross(&d0).transpose() * g);
                form += product + product.transpose();
            }
            let bend = d0.cross(&around).transpose() * maps.bend / 3.0;
            add_bend(&mut form, &bend, 1.0);
            self.add_edge(&(form * (-pressure * point.weight)), &nodes);
        }
    }

    fn add_fiber(&mut self, sector: &Sector, fields: &Fields, order: f64, nodes: &[(usize, f64)], weight: f64) {
        let [stretch, twist, _] = fields.globals;
        let rate = sector.winding + twist;
        let mut d0 = Vector3::zeros();
        for &(node, value) in nodes {
            d0 += Vector3::from_column_slice(&fields.position[3 * node..][..3]) * value;
        }
        let tangent = turn(&d0) * rate + Vector3::z() * stretch;
        let length = tangent.norm();
        let direction = tangent / length;
        let factor = weight * sector.fiber;
        let slope = 2.0 * factor * sector.cosine * (sector.cosine * length - 1.0);
        let curvature = 2.0 * factor * sector.cosine * sector.cosine;
        let along = direction * direction.transpose();
        let second = along * curvature + (Matrix3::identity() - along) * (slope / length);
        let maps = Maps::new(order, rate, &d0);
        let mut form = SMatrix::<f64, POINT, POINT>::zeros();
        for part in 0..2 {
            let t = maps.along[part] + maps.shear[part];
            form += t.transpose() * second * t;
        }
        add_bend(&mut form, &(direction.transpose() * maps.bend), slope);
        let nodes: Vec<(usize, [f64; 2])> = nodes.iter().map(|&(node, value)| (node, [0.0, value])).collect();
        self.add_edge(&form, &nodes);
    }
}

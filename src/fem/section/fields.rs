//! The discrete fields of half a sector: numbering, shape functions, quadrature, symmetry, and the tube in its own
//! units (length Ro, stress mu).

use std::f64::consts::PI;

use super::SectionError;
use super::band::Band;
use super::mesh::{Grid, Mesh};
use crate::fem::material::Law;
use crate::fem::tube::Tube;

/// Nodes of one element: 3 lines of 3 rings, in the order of the global numbers.
pub(super) const NODES: usize = 9;
/// Displacement unknowns of one element.
pub(super) const DOFS: usize = 3 * NODES;

/// Shape functions of the nodes of an element at a point: derivatives by R and psi, and the values.
pub(super) type Shape = [[f64; 3]; NODES];

/// Quadrature point of an element.
#[derive(Clone, Debug)]
pub(super) struct Point {
    /// Reference area R dR dpsi.
    pub(super) weight: f64,
    pub(super) radius: f64,
    pub(super) shape: Shape,
    /// Pressure functions 1, xi, eta.
    pub(super) pressure: [f64; 3],
}

/// Quadrature point of a column's edge.
#[derive(Clone, Debug)]
pub(super) struct EdgePoint {
    /// dpsi.
    pub(super) weight: f64,
    /// Derivative by psi and value for the three lines.
    pub(super) shape: [[f64; 2]; 3],
}

/// A point of an element: xi through the wall and eta round it, -1 to 1.
struct Place {
    column: usize,
    row: usize,
    xi: f64,
    eta: f64,
}

/// The solution's unknowns.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fields {
    /// Position (radial, tangential, axial in the turning frame of the point), three a node.
    pub(super) position: Vec<f64>,
    /// Pressure of the incompressible rubber, `1, xi, eta` parts of every element.
    pub(super) multiplier: Vec<[f64; 3]>,
    /// Axial stretch, twist per length, gauge pressure.
    pub(super) globals: [f64; 3],
}

/// Gauss points and weights on (-1, 1), exact to degree 5.
pub(super) const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Quadratic shape functions at -1, 0, 1 and their derivatives.
fn quadratic(x: f64) -> [[f64; 2]; 3] {
    [[x - 0.5, 0.5 * x * (x - 1.0)], [-2.0 * x, (1.0 - x) * (1.0 + x)], [x + 0.5, 0.5 * x * (x + 1.0)]]
}

/// Everything about the tube and its mesh that does not change with the state. Lengths over Ro, stresses over mu.
#[derive(Clone, Debug)]
pub(super) struct Sector {
    pub(super) law: Law,
    /// w = tan G / Ro.
    pub(super) winding: f64,
    /// cos G.
    pub(super) cosine: f64,
    /// EA / (4 cos G): energy of half a fibre over (lf - 1)^2.
    pub(super) fiber: f64,
    /// Half of the strip's angle; 0 for a line.
    pub(super) half_width: f64,
    /// Half sectors of the tube.
    pub(super) copies: f64,
    pub(super) grid: Grid,
    pub(super) points: Vec<[Point; 9]>,
    pub(super) edges: Vec<[EdgePoint; 3]>,
    /// Element's mass of the pressure functions, as far as the penalty needs it: the diagonal.
    pub(super) mass: Vec<[f64; 3]>,
    /// Unknowns held by the mirror symmetry of the equilibrium.
    pub(super) even: Vec<bool>,
    /// Unknowns held in fields of the opposite symmetry, and their two rigid motions.
    pub(super) odd: Vec<bool>,
}

impl Sector {
    pub(super) fn new(tube: &Tube, mesh: Mesh) -> Result<Sector, SectionError> {
        let tube = tube.validated()?;
        let mesh = mesh.validated()?;
        let grid = Grid::new(&tube, mesh);
        let (mu, ro) = (tube.law.shear_modulus(), tube.outer_radius());
        let cosine = tube.gamma.cos();
        let (rows, columns) = (grid.radii.len() - 1, grid.angles.len() - 1);
        let mut points = Vec::with_capacity(rows * columns);
        let mut mass = Vec::with_capacity(rows * columns);
        let mut edges = Vec::with_capacity(columns);
        for angle in grid.angles.windows(2) {
            let half_angle = 0.5 * (angle[1] - angle[0]);
            for radius in grid.radii.windows(2) {
                let (half, middle) = (0.5 * (radius[1] - radius[0]), 0.5 * (radius[0] + radius[1]));
                points.push(std::array::from_fn(|index| {
                    let ((eta, weight_eta), (xi, weight_xi)) = (GAUSS[index / 3], GAUSS[index % 3]);
                    let (along, across) = (quadratic(eta), quadratic(xi));
                    let r = middle + half * xi;
                    let shape = std::array::from_fn(|node| {
                        let ([dl, l], [dr, n]) = (along[node / 3], across[node % 3]);
                        [l * dr / half, dl * n / half_angle, l * n]
                    });
                    let weight = weight_eta * weight_xi * half * half_angle * r;
                    Point { weight, radius: r, shape, pressure: [1.0, xi, eta] }
                }));
                let area = 4.0 * half * half_angle * middle;
                mass.push([area, area / 3.0, area / 3.0]);
            }
            edges.push(GAUSS.map(|(eta, weight)| EdgePoint {
                weight: weight * half_angle,
                shape: quadratic(eta).map(|[slope, value]| [slope / half_angle, value]),
            }));
        }
        let mut sector = Sector {
            law: tube.law.with_shear_modulus(1.0),
            winding: tube.gamma.tan(),
            cosine,
            fiber: tube.fiber_ea / (mu * ro * ro) / (4.0 * cosine),
            half_width: 0.5 * tube.fiber_width / ro,
            copies: 2.0 * tube.fibers as f64,
            grid,
            points,
            edges,
            mass,
            even: Vec::new(),
            odd: Vec::new(),
        };
        let (nodes, rings) = (sector.nodes(), sector.rings());
        sector.even = vec![false; 3 * nodes];
        sector.odd = vec![false; 3 * nodes];
        for node in (0..rings).chain(nodes - rings..nodes) {
            sector.even[3 * node + 1] = true;
            sector.even[3 * node + 2] = true;
            sector.odd[3 * node] = true;
        }
        // Turning about the axis and moving along it leave the energy alone: one node holds them.
        sector.odd[3 * rings - 2] = true;
        sector.odd[3 * rings - 1] = true;
        Ok(sector)
    }

    /// Elements through the wall.
    pub(super) fn rows(&self) -> usize {
        self.grid.radii.len() - 1
    }

    /// Columns of elements.
    pub(super) fn columns(&self) -> usize {
        self.grid.angles.len() - 1
    }

    /// Nodes of one line through the wall.
    pub(super) fn rings(&self) -> usize {
        2 * self.rows() + 1
    }

    pub(super) fn nodes(&self) -> usize {
        (2 * self.columns() + 1) * self.rings()
    }

    /// Global node of a line (of constant angle) and a ring (of constant radius).
    pub(super) fn node(&self, line: usize, ring: usize) -> usize {
        line * self.rings() + ring
    }

    /// Global nodes of the element in `column` and `row`; elements are numbered `column * rows + row`.
    pub(super) fn element(&self, column: usize, row: usize) -> [usize; NODES] {
        std::array::from_fn(|local| self.node(2 * column + local / 3, 2 * row + local % 3))
    }

    /// An empty matrix for fields with `components` unknowns a node.
    pub(super) fn band(&self, components: usize) -> Band {
        let lines = 2 * self.columns() + 1;
        let line = components * self.rings();
        let last = (0..lines).flat_map(|index| {
            let reach = if index % 2 == 0 { index + 2 } else { index + 1 };
            std::iter::repeat_n((reach.min(lines - 1) + 1) * line - 1, line)
        });
        Band::new(last.collect())
    }

    /// The tube at rest: no load, no strain.
    pub(super) fn rest(&self) -> Fields {
        let rings = self.rings();
        let radius = |ring: usize| {
            let radii = &self.grid.radii[ring / 2..];
            if ring.is_multiple_of(2) { radii[0] } else { 0.5 * (radii[0] + radii[1]) }
        };
        // The isotropic response at rest is stress-free on its own.
        Fields {
            position: (0..self.nodes()).flat_map(|node| [radius(node % rings), 0.0, 0.0]).collect(),
            multiplier: vec![[0.0; 3]; self.points.len()],
            globals: [1.0, 0.0, 0.0],
        }
    }

    /// Fields that `coarse` has on another mesh of the same tube.
    pub(super) fn interpolated(&self, coarse: &Sector, fields: &Fields) -> Fields {
        let middles = |edges: &[f64], node: usize| {
            let edges = &edges[node / 2..];
            if node.is_multiple_of(2) { edges[0] } else { 0.5 * (edges[0] + edges[1]) }
        };
        let rings = self.rings();
        let position = (0..self.nodes()).flat_map(|node| {
            let at = coarse.locate(middles(&self.grid.radii, node % rings), middles(&self.grid.angles, node / rings));
            coarse.position_at(fields, &at)
        });
        // A linear function from its values in the middle of the element and beside it.
        let multiplier = |column: usize, row: usize| {
            let (angle, radius) = (&self.grid.angles[column..], &self.grid.radii[row..]);
            let at = |xi: f64, eta: f64| {
                let between = |ends: &[f64], x: f64| 0.5 * (ends[0] * (1.0 - x) + ends[1] * (1.0 + x));
                let at = coarse.locate(between(radius, xi), between(angle, eta));
                let [q, by_xi, by_eta] = fields.multiplier[at.column * coarse.rows() + at.row];
                q + by_xi * at.xi + by_eta * at.eta
            };
            [at(0.0, 0.0), at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5)]
        };
        Fields {
            position: position.collect(),
            multiplier: (0..self.columns())
                .flat_map(|column| (0..self.rows()).map(move |row| multiplier(column, row)))
                .collect(),
            globals: fields.globals,
        }
    }

    /// The element that holds a point, and where in it.
    fn locate(&self, radius: f64, angle: f64) -> Place {
        let interval = |edges: &[f64], x: f64| {
            let index = edges.partition_point(|edge| *edge <= x).clamp(1, edges.len() - 1) - 1;
            (index, (2.0 * x - edges[index] - edges[index + 1]) / (edges[index + 1] - edges[index]))
        };
        let ((row, xi), (column, eta)) = (interval(&self.grid.radii, radius), interval(&self.grid.angles, angle));
        Place { column, row, xi, eta }
    }

    fn position_at(&self, fields: &Fields, at: &Place) -> [f64; 3] {
        let (along, across) = (quadratic(at.eta), quadratic(at.xi));
        let mut sum = [0.0; 3];
        for (local, node) in self.element(at.column, at.row).into_iter().enumerate() {
            let shape = along[local / 3][1] * across[local % 3][1];
            for (sum, x) in sum.iter_mut().zip(&fields.position[3 * node..]) {
                *sum += shape * x;
            }
        }
        sum
    }

    /// Distance from the axis at a node.
    pub(super) fn radius_at(&self, fields: &Fields, node: usize) -> f64 {
        fields.position[3 * node].hypot(fields.position[3 * node + 1])
    }

    /// Outer radius averaged over the reference circumference.
    pub(super) fn mean_outer_radius(&self, fields: &Fields) -> f64 {
        let ring = self.rings() - 1;
        let mut sum = 0.0;
        for (column, points) in self.edges.iter().enumerate() {
            for point in points {
                let at = |component: usize| -> f64 {
                    (0..3)
                        .map(|k| point.shape[k][1] * fields.position[3 * self.node(2 * column + k, ring) + component])
                        .sum()
                };
                sum += point.weight * at(0).hypot(at(1));
            }
        }
        sum * self.copies / (2.0 * PI)
    }
}

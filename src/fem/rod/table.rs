//! psi0 interpolated over (stretch, twist, pressure): one potential, twice continuously differentiable.
//!
//! On a rectangular grid whose points give the potential's value, gradient and Hessian, every cell is a tensor product
//! of quintic Hermite polynomials. They match all derivatives up to the second in each variable at the corners, so the
//! potential is C2 across cells, its derivatives are derivatives of one function, and its tangent is symmetric. Of the
//! 27 derivatives that a corner needs the law gives 10; the 17 mixed ones of higher order are differences of those
//! along the grid. They are fourth-order exact and multiply the basis functions that vanish with at least the third
//! power of the cell's size, so the interpolant keeps its sixth order.
//!
//! A cell is valid where all its eight corners were accepted; elsewhere the table refuses by name.

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use super::grid::{Axis, Grid};
use super::law::{Jet, LawError};

/// Derivatives 0 to 2 in each variable.
const DERIVATIVES: usize = 27;
/// Those of them that a law gives: value, gradient, Hessian.
pub(crate) const KNOWN: usize = 10;
/// Where these stand among the 27.
const PLACES: [usize; KNOWN] = [0, 9, 3, 1, 18, 12, 10, 6, 4, 2];
/// Points of a difference formula.
const STENCIL: usize = 5;

/// What is no table.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TableError {
    /// An axis is empty, reversed or has too few points.
    #[error("axis {0:?}: must rise from finite to finite in at least {STENCIL} points")]
    Axis(Axis),
    /// Another number of states than of points, or a skew that is no number.
    #[error("{states} states for a grid of {points} points with skew {skew:?}: one for each, and finite skews")]
    States {
        /// Given.
        states: usize,
        /// Needed.
        points: usize,
        /// Of the grid.
        skew: [f64; 2],
    },
    /// No cell has all its corners accepted.
    #[error("the law accepts no whole cell of the grid: choose ranges about the states that it has")]
    Empty,
}

/// The interpolated potential.
#[derive(Clone, Debug)]
pub struct Table {
    grid: Grid,
    axes: [Axis; 3],
    /// By point (pressure fastest): the derivatives `d^(a+b+c) psi0` times the cell's sizes to their powers, at
    /// `9 a + 3 b + c`.
    corners: Vec<[f64; DERIVATIVES]>,
    accepted: Vec<bool>,
}

/// By edge of a cell along the pressure, order of the pressure's derivative, and `3 a + b`.
type Lines = [[[f64; 9]; 3]; 4];

/// A table at one pressure. The states along a rod mostly share a cell: its sums over the pressure, which are most of
/// the work, are kept from one to the next.
#[derive(Clone, Debug)]
pub(crate) struct Slice<'a> {
    table: &'a Table,
    pressure: f64,
    /// The cell along the pressure and its polynomials there; none outside.
    layer: Option<(usize, [[f64; 6]; 3])>,
    /// The valid cell (stretch, twist) last looked into.
    kept: Option<([usize; 2], Lines)>,
}

/// How far a table is from its law, over the points where both answer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TableDeviation {
    /// Largest deviation of axial force N, moment N m and volume per length m2.
    pub gradient: Vector3<f64>,
    /// Largest deviation of each second derivative.
    pub hessian: Matrix3<f64>,
    /// Points compared.
    pub points: usize,
}

impl Jet {
    /// The same by (x, twist, pressure), where `stretch = x + skew . (twist, pressure)`.
    fn skewed(&self, [by_twist, by_pressure]: [f64; 2]) -> Jet {
        let j = Matrix3::new(1.0, by_twist, by_pressure, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        Jet { value: self.value, gradient: j.tr_mul(&self.gradient), hessian: j.tr_mul(&(self.hessian * j)) }
    }
}

impl Table {
    /// The table of the potential at a grid's points, none where the law has no accepted state, in the order of
    /// [`Grid::index`].
    pub fn new(grid: Grid, states: &[Option<Jet>]) -> Result<Table, TableError> {
        let spacing = grid.axes().map(|a| a.spacing());
        let known = |state: &Option<Jet>| state.map(|jet| known(&jet.skewed(grid.skew), spacing));
        Table::from_known(grid, states.iter().map(known))
    }

    /// The table from what it keeps of each point, in the order of [`Grid::index`].
    pub(crate) fn from_known(
        grid: Grid,
        states: impl ExactSizeIterator<Item = Option<[f64; KNOWN]>>,
    ) -> Result<Table, TableError> {
        let axes = grid.axes();
        for axis in axes {
            if !(axis.points >= STENCIL && axis.from < axis.to && axis.from.is_finite() && axis.to.is_finite()) {
                return Err(TableError::Axis(axis));
            }
        }
        let (points, skew) = (grid.points(), grid.skew);
        if states.len() != points || !skew.iter().all(|s| s.is_finite()) {
            return Err(TableError::States { states: states.len(), points, skew });
        }
        let mut table = Table { grid, axes, corners: Vec::with_capacity(points), accepted: Vec::with_capacity(points) };
        for state in states {
            let mut corner = [0.0; DERIVATIVES];
            for (place, value) in PLACES.into_iter().zip(state.unwrap_or_default()) {
                corner[place] = value;
            }
            table.corners.push(corner);
            table.accepted.push(state.is_some());
        }
        table.difference();
        if !table.cells().any(|c| table.valid(c)) {
            return Err(TableError::Empty);
        }
        Ok(table)
    }

    /// Tabulates `law`, which gives the potential at (stretch, twist rad/m, pressure Pa), or none where it has no
    /// accepted state.
    pub fn build(grid: Grid, mut law: impl FnMut(f64, f64, f64) -> Option<Jet>) -> Result<Table, TableError> {
        let states: Vec<_> = grid.all().map(|at| grid.at(at)).map(|[x, y, z]| law(x, y, z)).collect();
        Table::new(grid, &states)
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// What it was made from: [`Table::from_known`] of this is the same to the last bit.
    pub(crate) fn known(&self) -> impl ExactSizeIterator<Item = Option<[f64; KNOWN]>> + '_ {
        let keep = |(corner, accepted): (&[f64; DERIVATIVES], &bool)| accepted.then(|| PLACES.map(|at| corner[at]));
        self.corners.iter().zip(&self.accepted).map(keep)
    }

    /// The potential at (stretch, twist rad/m, pressure Pa).
    pub fn jet(&self, stretch: f64, twist: f64, pressure: f64) -> Result<Jet, LawError> {
        self.at(pressure).jet(stretch, twist)
    }

    /// The table at `pressure` Pa.
    pub(crate) fn at(&self, pressure: f64) -> Slice<'_> {
        let layer = self.axes[2].cell(pressure).map(|(cell, place)| (cell, quintic(place)));
        Slice { table: self, pressure, layer, kept: None }
    }

    /// The share of the grid's cells in which the table answers, 0 to 1.
    pub fn coverage(&self) -> f64 {
        let cells = self.axes.iter().map(|a| a.points - 1).product::<usize>();
        self.cells().filter(|c| self.valid(*c)).count() as f64 / cells as f64
    }

    /// The share of the cells at `pressure` Pa in which the table answers, 0 to 1.
    pub fn coverage_at(&self, pressure: f64) -> f64 {
        let Some((layer, _)) = self.axes[2].cell(pressure) else { return 0.0 };
        let cells = || self.cells().filter(|cell| cell[2] == layer);
        cells().filter(|cell| self.valid(*cell)).count() as f64 / cells().count() as f64
    }

    /// Compares with `law` at the middle of every `stride`-th valid cell, where the interpolant is worst.
    pub fn deviation(&self, stride: usize, mut law: impl FnMut(f64, f64, f64) -> Option<Jet>) -> TableDeviation {
        let mut worst = TableDeviation::default();
        for cell in self.cells().filter(|c| self.valid(*c)).step_by(stride.max(1)) {
            let [x, y, z] = self.grid.middle(cell);
            if let (Ok(got), Some(want)) = (self.jet(x, y, z), law(x, y, z)) {
                worst.gradient = worst.gradient.sup(&(got.gradient - want.gradient).abs());
                worst.hessian = worst.hessian.sup(&(got.hessian - want.hessian).abs());
                worst.points += 1;
            }
        }
        worst
    }

    fn cells(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [n, m, l] = self.axes.map(|a| a.points - 1);
        (0..n * m * l).map(move |c| [c / (m * l), c / l % m, c % l])
    }

    /// The sums over the pressure along the four edges of a cell, see [`Slice`].
    fn lines(&self, cell: [usize; 3], weights: &[[f64; 6]; 3]) -> Lines {
        let mut lines = Lines::default();
        for (edge, line) in lines.iter_mut().enumerate() {
            for ck in 0..2 {
                let corner = &self.corners[self.grid.index([cell[0] + edge / 2, cell[1] + edge % 2, cell[2] + ck])];
                for (order, w) in line.iter_mut().zip(weights) {
                    for (sum, c) in order.iter_mut().zip(corner.chunks_exact(3)) {
                        *sum += w[3 * ck] * c[0] + w[3 * ck + 1] * c[1] + w[3 * ck + 2] * c[2];
                    }
                }
            }
        }
        lines
    }

    fn valid(&self, cell: [usize; 3]) -> bool {
        (0..8).all(|c| self.accepted[self.grid.index([cell[0] + (c >> 2), cell[1] + (c >> 1 & 1), cell[2] + (c & 1)])])
    }

    /// Fills the mixed derivatives of higher order from lower ones, along the axis where one order is missing.
    fn difference(&mut self) {
        // (target, source, axis along which the source is differentiated), each source known before its target.
        const PLAN: [([usize; 3], [usize; 3], usize); 17] = [
            ([1, 1, 1], [1, 1, 0], 2),
            ([2, 1, 0], [2, 0, 0], 1),
            ([2, 0, 1], [2, 0, 0], 2),
            ([1, 2, 0], [0, 2, 0], 0),
            ([0, 2, 1], [0, 2, 0], 2),
            ([1, 0, 2], [0, 0, 2], 0),
            ([0, 1, 2], [0, 0, 2], 1),
            ([2, 1, 1], [2, 1, 0], 2),
            ([1, 2, 1], [1, 2, 0], 2),
            ([1, 1, 2], [1, 0, 2], 1),
            ([2, 2, 0], [2, 1, 0], 1),
            ([2, 0, 2], [1, 0, 2], 0),
            ([0, 2, 2], [0, 1, 2], 1),
            ([2, 2, 1], [2, 2, 0], 2),
            ([2, 1, 2], [2, 0, 2], 1),
            ([1, 2, 2], [0, 2, 2], 0),
            ([2, 2, 2], [1, 2, 2], 0),
        ];
        let place = |d: [usize; 3]| 9 * d[0] + 3 * d[1] + d[2];
        let sizes = self.axes.map(|a| a.points);
        for (target, source, axis) in PLAN {
            for point in 0..self.corners.len() {
                if !self.accepted[point] {
                    continue;
                }
                let at = [point / (sizes[1] * sizes[2]), point / sizes[2] % sizes[1], point % sizes[2]];
                let line = |i: usize| {
                    let mut other = at;
                    other[axis] = i;
                    self.grid.index(other)
                };
                // The accepted neighbours, as evenly about the point as there are.
                let (mut first, mut last) = (at[axis], at[axis]);
                while last - first + 1 < STENCIL {
                    let below = first > 0 && self.accepted[line(first - 1)];
                    let above = last + 1 < sizes[axis] && self.accepted[line(last + 1)];
                    if below && (!above || at[axis] - first <= last - at[axis]) {
                        first -= 1;
                    } else if above {
                        last += 1;
                    } else {
                        break;
                    }
                }
                let sum = (first..=last)
                    .map(|i| slope_weight(first, last, at[axis], i) * self.corners[line(i)][place(source)])
                    .sum();
                self.corners[point][place(target)] = sum;
            }
        }
    }
}

impl Slice<'_> {
    /// The potential at (stretch, twist rad/m).
    pub fn jet(&mut self, stretch: f64, twist: f64) -> Result<Jet, LawError> {
        let Slice { table, pressure, .. } = *self;
        let outside = LawError::OutsideTable { stretch, twist, pressure };
        let (layer, by_pressure) = self.layer.as_ref().ok_or(outside)?;
        let x = table.grid.skewed([stretch, twist, pressure]);
        let (i, place) = table.axes[0].cell(x[0]).ok_or(outside)?;
        let by_stretch = quintic(place);
        let (j, place) = table.axes[1].cell(x[1]).ok_or(outside)?;
        let by_twist = quintic(place);
        let lines = match &mut self.kept {
            Some((at, lines)) if *at == [i, j] => lines,
            kept => {
                if !table.valid([i, j, *layer]) {
                    return Err(outside);
                }
                &mut kept.insert(([i, j], table.lines([i, j, *layer], by_pressure))).1
            }
        };
        // Sums over twist, then stretch, as far as second derivatives need them; by order of the derivatives.
        let mut sums = [[[0.0; 3]; 3]; 3];
        for ci in 0..2 {
            for a in 0..3 {
                let mut plane = [[0.0; 3]; 3];
                for cj in 0..2 {
                    for b in 0..3 {
                        for (z, line) in lines[2 * ci + cj].iter().enumerate() {
                            for y in 0..3 - z {
                                plane[y][z] += by_twist[y][3 * cj + b] * line[3 * a + b];
                            }
                        }
                    }
                }
                for (x, w) in by_stretch.iter().enumerate() {
                    for y in 0..3 - x {
                        for z in 0..3 - x - y {
                            sums[x][y][z] += w[3 * ci + a] * plane[y][z];
                        }
                    }
                }
            }
        }
        let inverse = table.axes.map(|a| 1.0 / a.spacing());
        Ok(jet(|a, b, c| sums[a][b][c], inverse).skewed(table.grid.skew.map(|s| -s)))
    }
}

/// The derivatives that a law gives, times the spacings, in the order of [`PLACES`].
fn known(jet: &Jet, [h, k, l]: [f64; 3]) -> [f64; KNOWN] {
    let (g, d) = (jet.gradient, jet.hessian);
    let second = [d.m11 * h * h, d.m12 * h * k, d.m13 * h * l, d.m22 * k * k, d.m23 * k * l, d.m33 * l * l];
    let [xx, xy, xz, yy, yz, zz] = second;
    [jet.value, g.x * h, g.y * k, g.z * l, xx, xy, xz, yy, yz, zz]
}

/// The jet of derivatives `d(a, b, c)` in units of the spacings, whose inverses are given.
fn jet(d: impl Fn(usize, usize, usize) -> f64, [h, k, l]: [f64; 3]) -> Jet {
    let (xy, xz, yz) = (d(1, 1, 0) * h * k, d(1, 0, 1) * h * l, d(0, 1, 1) * k * l);
    let (xx, yy, zz) = (d(2, 0, 0) * h * h, d(0, 2, 0) * k * k, d(0, 0, 2) * l * l);
    Jet {
        value: d(0, 0, 0),
        gradient: Vector3::new(d(1, 0, 0) * h, d(0, 1, 0) * k, d(0, 0, 1) * l),
        hessian: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
    }
}

/// Weight of node `i` in the derivative at node `at` of the polynomial through the nodes `first..=last` (spacing 1).
fn slope_weight(first: usize, last: usize, at: usize, i: usize) -> f64 {
    let d = |a: usize, b: usize| a as f64 - b as f64;
    let nodes = || first..=last;
    if i == at {
        return nodes().filter(|k| *k != at).map(|k| 1.0 / d(at, k)).sum();
    }
    let up: f64 = nodes().filter(|k| *k != i && *k != at).map(|k| d(at, k)).product();
    let down: f64 = nodes().filter(|k| *k != i).map(|k| d(i, k)).product();
    up / down
}

/// Quintic Hermite polynomials on [0, 1]: by order of the derivative taken, then at 0 the weights of value, slope and
/// curvature and at 1 the same.
fn quintic(s: f64) -> [[f64; 6]; 3] {
    // Coefficients of s^0 to s^5.
    const BASIS: [[f64; 6]; 6] = [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ];
    let mut weights = [[0.0; 6]; 3];
    for (b, c) in BASIS.iter().enumerate() {
        let (mut value, mut slope, mut curvature) = (0.0, 0.0, 0.0);
        for c in c.iter().rev() {
            curvature = curvature * s + 2.0 * slope;
            slope = slope * s + value;
            value = value * s + c;
        }
        (weights[0][b], weights[1][b], weights[2][b]) = (value, slope, curvature);
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth potential whose derivatives of every order are mixed: exp(a . x) of scaled variables.
    fn smooth(x: f64, y: f64, z: f64) -> Jet {
        let a = Vector3::new(0.9, -0.7, 0.8);
        let value = a.dot(&Vector3::new(x, y, z)).exp() + (x * y * z).sin();
        let (s, c) = (x * y * z).sin_cos();
        let g = Vector3::new(y * z, x * z, x * y);
        let e = a.dot(&Vector3::new(x, y, z)).exp();
        let cross = Matrix3::new(0.0, z, y, z, 0.0, x, y, x, 0.0);
        Jet { value, gradient: a * e + g * c, hessian: a * a.transpose() * e - g * g.transpose() * s + cross * c }
    }

    fn axis(points: usize) -> Axis {
        Axis { from: -1.0, to: 1.0, points }
    }

    fn grid(points: [usize; 3]) -> Grid {
        Grid::straight(axis(points[0]), axis(points[1]), axis(points[2]))
    }

    fn table(points: usize) -> Table {
        Table::build(grid([points; 3]), |x, y, z| Some(smooth(x, y, z))).unwrap()
    }

    #[test]
    fn it_converges_with_order_six_and_its_hessian_with_four() {
        let worst = |points| table(points).deviation(1, |x, y, z| Some(smooth(x, y, z)));
        let (coarse, fine) = (worst(9), worst(17));
        let order = (coarse.hessian.amax() / fine.hessian.amax()).log2();
        assert!(order > 3.7, "{order} {coarse:?} {fine:?}");
        let order = (coarse.gradient.amax() / fine.gradient.amax()).log2();
        assert!(order > 4.7, "{order} {coarse:?} {fine:?}");
        assert!(fine.hessian.amax() < 1e-4, "{fine:?}");
    }

    #[test]
    fn grid_points_are_met_exactly_and_the_hessian_is_continuous_across_cells() {
        let t = table(6);
        let (x, y, z) = (-1.0 + 2.0 * 0.4, 0.2, 0.6);
        let (got, want) = (t.jet(x, y, z).unwrap(), smooth(x, y, z));
        assert!((got.hessian - want.hessian).amax() < 1e-12 && (got.gradient - want.gradient).amax() < 1e-13);
        // On a face between cells, in its middle.
        let e = 1e-9;
        let (low, high) = (t.jet(x - e, 0.07, 0.33).unwrap(), t.jet(x + e, 0.07, 0.33).unwrap());
        assert!((low.hessian - high.hessian).amax() < 1e-7, "{}", low.hessian - high.hessian);
        // One function: its derivatives are those of differences.
        let at = [0.13, 0.27, -0.41];
        let jet = t.jet(at[0], at[1], at[2]).unwrap();
        for i in 0..3 {
            let [mut a, mut b] = [at; 2];
            a[i] -= 1e-5;
            b[i] += 1e-5;
            let (a, b) = (t.jet(a[0], a[1], a[2]).unwrap(), t.jet(b[0], b[1], b[2]).unwrap());
            assert!(((b.value - a.value) / 2e-5 - jet.gradient[i]).abs() < 1e-8);
            assert!(((b.gradient - a.gradient) / 2e-5 - jet.hessian.column(i)).amax() < 1e-7);
        }
    }

    #[test]
    fn a_quadratic_law_is_reproduced() {
        let k = Matrix3::new(3.0, 0.4, -0.2, 0.4, 0.7, 0.3, -0.2, 0.3, -0.1);
        let law = |x: f64, y: f64, z: f64| {
            let v = Vector3::new(x, y, z);
            Jet { value: 0.5 * v.dot(&(k * v)), gradient: k * v, hessian: k }
        };
        let t = Table::build(grid([5, 6, 7]), |x, y, z| Some(law(x, y, z))).unwrap();
        let off = t.deviation(1, |x, y, z| Some(law(x, y, z)));
        assert!(off.points == 4 * 5 * 6 && off.gradient.amax() < 1e-13 && off.hessian.amax() < 1e-12, "{off:?}");
    }

    #[test]
    fn outside_and_where_the_law_refused_it_refuses_by_name() {
        // Accepted below a slanted plane only.
        let inside = |x: f64, _: f64, z: f64| x + z < 0.6;
        let t = Table::build(grid([9, 5, 9]), |x, y, z| inside(x, y, z).then(|| smooth(x, y, z))).unwrap();
        assert!((0.5..0.8).contains(&t.coverage()), "{}", t.coverage());
        assert!(matches!(t.jet(0.9, 0.0, 0.9), Err(LawError::OutsideTable { .. })));
        assert!(matches!(t.jet(1.01, 0.0, -0.9), Err(LawError::OutsideTable { .. })));
        assert!(matches!(t.jet(f64::NAN, 0.0, 0.0), Err(LawError::OutsideTable { .. })));
        // The valid cells are as good as those of a whole table, within the one-sided differences' constants.
        let off = t.deviation(1, |x, y, z| Some(smooth(x, y, z)));
        assert!(off.points > 50 && off.hessian.amax() < 5e-2, "{off:?}");
        assert_eq!(Table::build(grid([5; 3]), |_, _, _| None).unwrap_err(), TableError::Empty);
        let flat = Grid { twist: Axis { from: 1.0, to: 1.0, points: 5 }, ..grid([5; 3]) };
        assert!(matches!(Table::build(flat, |_, _, _| None), Err(TableError::Axis(_))));
        assert!(matches!(Table::build(grid([4, 5, 5]), |_, _, _| None), Err(TableError::Axis(_))));
        assert!(matches!(Table::new(grid([5; 3]), &[None; 7]), Err(TableError::States { states: 7, .. })));
    }

    #[test]
    fn a_skewed_table_is_of_the_same_order_and_gives_back_what_it_was_made_from() {
        let worst = |points: usize| {
            let skewed = Grid { skew: [0.4, -0.3], ..grid([points; 3]) };
            let table = Table::build(skewed, |x, y, z| Some(smooth(x, y, z))).unwrap();
            for at in skewed.all() {
                let [x, y, z] = skewed.at(at);
                let (got, want) = (table.jet(x, y, z).unwrap(), smooth(x, y, z));
                assert!((got.hessian - want.hessian).amax() < 1e-11 && (got.gradient - want.gradient).amax() < 1e-12);
            }
            let again = Table::from_known(skewed, table.known()).unwrap();
            assert!(again.corners == table.corners && again.accepted == table.accepted);
            table.deviation(1, |x, y, z| Some(smooth(x, y, z)))
        };
        let (coarse, fine) = (worst(9), worst(17));
        assert!((coarse.gradient.amax() / fine.gradient.amax()).log2() > 4.7, "{coarse:?} {fine:?}");
        assert!((coarse.hessian.amax() / fine.hessian.amax()).log2() > 3.7, "{coarse:?} {fine:?}");
    }
}

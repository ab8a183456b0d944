//! Quadratic shape functions of the 27-node hexahedron and its Gauss points.
//!
//! Node `i + 3 j + 9 k` sits at (i - 1, j - 1, k - 1) of the cube [-1, 1]^3. In a tube's mesh i runs through the
//! wall, j round the circumference and k along the tube.

/// Nodes of an element.
pub const NODES: usize = 27;
/// Gauss points of an element.
pub const POINTS: usize = 27;
/// Unknown pressures of an element: 1 and the three coordinates of the cube.
pub const PRESSURES: usize = 4;

/// Gauss-Legendre points of order 5 on [-1, 1].
pub const GAUSS: [(f64, f64); 3] =
    [(-0.774_596_669_241_483_4, 5.0 / 9.0), (0.0, 8.0 / 9.0), (0.774_596_669_241_483_4, 5.0 / 9.0)];

/// Values and slopes of the three quadratic Lagrange polynomials at `x`.
pub fn line(x: f64) -> ([f64; 3], [f64; 3]) {
    ([0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0)], [x - 0.5, -2.0 * x, x + 0.5])
}

/// Shape functions at one point of the cube.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Values of the 27 functions.
    pub value: [f64; NODES],
    /// Their slopes by the three coordinates of the cube.
    pub slope: [[f64; 3]; NODES],
    /// The four pressure functions.
    pub pressure: [f64; PRESSURES],
    /// Gauss weight.
    pub weight: f64,
}

impl Shape {
    /// The functions at `x` of the cube.
    pub fn at(x: [f64; 3], weight: f64) -> Shape {
        let [(a, da), (b, db), (c, dc)] = x.map(line);
        let (mut value, mut slope) = ([0.0; NODES], [[0.0; 3]; NODES]);
        for k in 0..3 {
            for j in 0..3 {
                for i in 0..3 {
                    let n = i + 3 * j + 9 * k;
                    value[n] = a[i] * b[j] * c[k];
                    slope[n] = [da[i] * b[j] * c[k], a[i] * db[j] * c[k], a[i] * b[j] * dc[k]];
                }
            }
        }
        Shape { value, slope, pressure: [1.0, x[0], x[1], x[2]], weight }
    }

    /// The functions at all Gauss points.
    pub fn gauss() -> Vec<Shape> {
        let mut shapes = Vec::with_capacity(POINTS);
        for (z, wz) in GAUSS {
            for (y, wy) in GAUSS {
                for (x, wx) in GAUSS {
                    shapes.push(Shape::at([x, y, z], wx * wy * wz));
                }
            }
        }
        shapes
    }
}

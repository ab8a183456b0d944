//! Meshes of a tube, swept along its fibres.
//!
//! Through the wall, round the circumference and along the tube a mesh is a product of three divisions, and its
//! edges along the tube are helices of the fibres' pitch. A sector, one fibre's share of the circumference, has
//! cyclic symmetry: the nodes of its last face are those of its first. It is meshed in a frame that turns with
//! the fibres and round the circumference, where it is a brick. Bending needs the whole circumference, and a rigid
//! motion sideways should be exact, so the whole is meshed in space, with elements so short that they turn by half a
//! radian or so.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use thiserror::Error;

use super::body::{Body, Cell, Support};
use super::element::Rubber;
use super::fiber::Fiber;
use super::shapes::NODES;
use crate::fem::tube::Tube;

/// Most that an element of a whole tube may ever turn, rad: beyond it a parabola is no helix any more.
const MOST_TURN: f64 = 1.2;
/// Most elements of a mesh.
pub const MOST_ELEMENTS: usize = 20_000;

/// What is no mesh.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum MeshError {
    /// A count of elements is zero.
    #[error("mesh of {wall} elements through the wall and {around} round a sector: each must be at least 1")]
    Empty {
        /// Through the wall.
        wall: usize,
        /// Round a sector.
        around: usize,
    },
    /// Sizes along the tube.
    #[error(
        "elements along the tube from {first} m at the ends, growing by {growth}, to {largest} m: need 0 < first <= largest and growth >= 1"
    )]
    Along {
        /// First element, m.
        first: f64,
        /// Ratio of neighbours.
        growth: f64,
        /// Largest element, m.
        largest: f64,
    },
    /// Turn of an element out of range.
    #[error("elements that turn by up to {0} rad along a whole tube: must be above 0 and at most {MOST_TURN}")]
    Turn(f64),
    /// Length not positive.
    #[error("length {0} m: must be positive and finite")]
    Length(f64),
    /// Too many elements.
    #[error("{elements} elements (most: {MOST_ELEMENTS}): {remedy}")]
    TooMany {
        /// Number of elements.
        elements: usize,
        /// What to do.
        remedy: &'static str,
    },
}

/// How much of the circumference is meshed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// One fibre's share, with cyclic symmetry: the tube stretches and twists, and cannot bend.
    Sector,
    /// All of it.
    Whole,
}

/// A tube's mesh. The fibre's model is the tube's: a strip of its width, or a line where that is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh {
    /// How much of the circumference.
    pub part: Part,
    /// Elements through the wall.
    pub wall: usize,
    /// Ratio of neighbouring elements through the wall, inner over outer: 1 is uniform.
    pub wall_growth: f64,
    /// Elements round a sector: all, for line fibres; under the strip, for strips.
    pub around: usize,
    /// Ratio of neighbouring elements beside a strip.
    pub around_growth: f64,
    /// Element at either end, m, before all are scaled to fill the length.
    pub first: f64,
    /// Ratio of neighbouring elements along the tube.
    pub along_growth: f64,
    /// Largest element along the tube, m.
    pub largest: f64,
    /// Most that an element of a whole tube may turn along the tube, rad; of no account in a sector.
    pub most_turn: f64,
}

impl Mesh {
    /// A sector with 2 elements through the wall, 6 round for line fibres and 2 under a strip, from 0.5 mm (strips:
    /// 1 mm) at the ends to 10 mm. With strips at 40 deg it is within 0.05 % of three times as many unknowns where the
    /// tube is free, and within 0.4 % in force and moment where it is blocked.
    pub fn sector(tube: &Tube) -> Mesh {
        let line = tube.fiber_width == 0.0;
        Mesh {
            part: Part::Sector,
            wall: 2,
            wall_growth: if line { 1.0 } else { 1.5 },
            around: if line { 6 } else { 2 },
            around_growth: 2.2,
            first: if line { 0.5e-3 } else { 1e-3 },
            along_growth: if line { 1.5 } else { 2.0 },
            largest: 10e-3,
            most_turn: 0.5,
        }
    }

    /// The whole circumference, coarse: one element through the wall.
    pub fn whole(tube: &Tube) -> Mesh {
        Mesh {
            part: Part::Whole,
            wall: 1,
            wall_growth: 1.0,
            around: if tube.fiber_width == 0.0 { 2 } else { 1 },
            around_growth: 4.0,
            first: 1e-3,
            along_growth: 2.0,
            ..Mesh::sector(tube)
        }
    }
}

/// A tube's body and where its nodes are.
pub(super) struct Meshed {
    pub body: Body,
    /// Coordinates of the divisions along the tube, at corners and mid-points of elements.
    pub planes: Vec<f64>,
    /// Nodes of the outer surface of each plane, with weights that sum to 1.
    pub outer: Vec<Vec<(usize, f64)>>,
    /// Node in the middle of a fibre, of each plane.
    pub fiber: Vec<usize>,
    /// How many times the body makes the tube.
    pub copies: f64,
}

/// Sizes growing from `first` by `growth` up to `largest`, scaled to fill `length`.
fn graded(length: f64, first: f64, growth: f64, largest: f64) -> Vec<f64> {
    let mut sizes = Vec::new();
    let (mut sum, mut size) = (0.0, first.min(largest));
    while sum < length * (1.0 - 1e-9) && sizes.len() < MOST_ELEMENTS {
        sizes.push(size);
        sum += size;
        size = (size * growth).min(largest);
    }
    sizes.iter().map(|s| s * length / sum).collect()
}

/// Coordinates of corners and mid-points.
fn points(start: f64, sizes: &[f64]) -> Vec<f64> {
    let mut points = vec![start];
    let mut at = start;
    for size in sizes {
        points.extend([at + 0.5 * size, at + size]);
        at += size;
    }
    points
}

/// Meshes a tube of `length` in units of its outer radius and shear modulus.
pub(super) fn tube(tube: &Tube, length: f64, mesh: &Mesh, bulk: Option<f64>) -> Result<Meshed, MeshError> {
    if !(length.is_finite() && length > 0.0) {
        return Err(MeshError::Length(length));
    }
    if mesh.wall == 0 || mesh.around == 0 {
        return Err(MeshError::Empty { wall: mesh.wall, around: mesh.around });
    }
    if !(mesh.first > 0.0 && mesh.first <= mesh.largest && mesh.along_growth >= 1.0 && mesh.largest.is_finite()) {
        let Mesh { first, along_growth: growth, largest, .. } = *mesh;
        return Err(MeshError::Along { first, growth, largest });
    }
    if mesh.part == Part::Whole && !(mesh.most_turn > 0.0 && mesh.most_turn <= MOST_TURN) {
        return Err(MeshError::Turn(mesh.most_turn));
    }
    let unit = tube.outer_radius();
    let length = length / unit;
    let pitch = tube.gamma.tan();
    let share = TAU / tube.fibers as f64;

    let (first, mut largest) = (mesh.first / unit, mesh.largest / unit);
    if mesh.part == Part::Whole {
        largest = largest.min(mesh.most_turn / pitch.abs());
    }
    let half = graded(0.5 * length, first, mesh.along_growth, largest);
    let along: Vec<f64> = half.iter().chain(half.iter().rev()).copied().collect();
    let planes = points(0.0, &along);

    let mut wall: Vec<f64> = (0..mesh.wall).map(|i| mesh.wall_growth.powi((mesh.wall - 1 - i) as i32)).collect();
    let sum: f64 = wall.iter().sum();
    wall.iter_mut().for_each(|s| *s *= tube.wall / unit / sum);
    let radii = points(tube.inner_radius / unit, &wall);

    // One sector's divisions, and the fibre over each.
    let strip = (tube.fiber_width / unit).min(share);
    let (start, mut around, mut fibers) = if strip == 0.0 {
        let fibers = (0..mesh.around).map(|j| if j == 0 { Fiber::Line } else { Fiber::None }).collect();
        (0.0, vec![share / mesh.around as f64; mesh.around], fibers)
    } else {
        let under = strip / mesh.around as f64;
        (-0.5 * strip, vec![under; mesh.around], vec![Fiber::Strip(1.0 / mesh.around as f64); mesh.around])
    };
    if strip > 0.0 && strip < share {
        let gap = graded(0.5 * (share - strip), strip / mesh.around as f64, mesh.around_growth, f64::INFINITY);
        around.extend(gap.iter().chain(gap.iter().rev()));
        fibers.resize(around.len(), Fiber::None);
    }
    let sectors = if mesh.part == Part::Whole { tube.fibers } else { 1 };
    let (one, one_fibers) = (around.clone(), fibers.clone());
    for _ in 1..sectors {
        around.extend(&one);
        fibers.extend(&one_fibers);
    }
    let mut angles = points(start, &around);
    angles.pop();

    let elements = wall.len() * around.len() * along.len();
    if elements > MOST_ELEMENTS {
        let remedy = if mesh.part == Part::Whole && largest < mesh.largest / unit {
            "fibres this steep need many elements along a whole tube: mesh a sector, a shorter tube or fewer elements round"
        } else {
            "take fewer or larger elements"
        };
        return Err(MeshError::TooMany { elements, remedy });
    }

    let (n_wall, n_around) = (radii.len(), angles.len());
    let index = |i: usize, j: usize, k: usize| i + n_wall * (j + n_around * k);
    let mut reference = Vec::with_capacity(n_wall * n_around * planes.len());
    let mut supports = Vec::with_capacity(reference.capacity());
    for (k, &z) in planes.iter().enumerate() {
        let support = match k {
            0 => Support::FIXED,
            k if k + 1 == planes.len() => Support::Cap,
            _ => Support::FREE,
        };
        for &angle in &angles {
            // A sector's positions are polar components, its angles phases; the whole tube is in space.
            let angle = if mesh.part == Part::Whole { angle + pitch * z } else { 0.0 };
            for &r in &radii {
                reference.push(Vector3::new(r * angle.cos(), r * angle.sin(), z));
                supports.push(support);
            }
        }
    }
    let mut cells = Vec::with_capacity(elements);
    for k in 0..along.len() {
        for (j, &fiber) in fibers.iter().enumerate() {
            for i in 0..wall.len() {
                let (mut nodes, mut phases) = ([0; NODES], [0.0; NODES]);
                for n in 0..NODES {
                    let (a, b, c) = (2 * i + n % 3, 2 * j + n / 3 % 3, 2 * k + n / 9);
                    if mesh.part == Part::Sector {
                        phases[n] = if b == n_around { start + share } else { angles[b] };
                    }
                    nodes[n] = index(a, b % n_around, c);
                }
                cells.push(Cell {
                    nodes,
                    phases,
                    inner: i == 0,
                    fiber: if i + 1 == wall.len() { fiber } else { Fiber::None },
                    center: [i as f64, j as f64, k as f64],
                });
            }
        }
    }
    let total: f64 = around.iter().sum();
    let mut weights = vec![0.0; n_around];
    for (j, size) in around.iter().enumerate() {
        for (at, weight) in [(2 * j, 1.0), (2 * j + 1, 4.0), ((2 * j + 2) % n_around, 1.0)] {
            weights[at] += weight / 6.0 * size / total;
        }
    }
    let outer = (0..planes.len())
        .map(|k| weights.iter().enumerate().map(|(j, &w)| (index(n_wall - 1, j, k), w)).collect())
        .collect();
    // The fibre's middle is at angle 0 of the base: the first node of a line's sector, the strip's middle one.
    let middle = if strip == 0.0 { 0 } else { mesh.around };
    let fiber = (0..planes.len()).map(|k| index(n_wall - 1, middle, k)).collect();
    let mu = tube.law.shear_modulus();
    let body = Body {
        reference,
        supports,
        cells,
        rubber: Rubber::new(tube.law.with_shear_modulus(1.0), bulk),
        fiber_ea: tube.fiber_ea / (mu * unit * unit),
        reference_rate: if mesh.part == Part::Whole { 0.0 } else { pitch },
        length,
        cap_center: Vector3::new(0.0, 0.0, length),
    };
    let copies = if mesh.part == Part::Whole { 1.0 } else { tube.fibers as f64 };
    Ok(Meshed { body, planes, outer, fiber, copies })
}

#[cfg(test)]
/// The body of a tube of `length` m alone, in units of its outer radius and shear modulus.
pub fn tube_body(of: &Tube, length: f64, mesh: &Mesh, bulk: Option<f64>) -> Result<Body, MeshError> {
    Ok(tube(of, length, mesh, bulk)?.body)
}

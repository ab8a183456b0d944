//! The mesh of half a fibre's sector: lines of constant angle and rings of constant radius, graded to the strip's end.

use std::f64::consts::PI;

use super::SectionError;
use crate::fem::tube::Tube;

/// How half of a fibre's sector is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mesh {
    /// Elements through the wall (1 to 32), in half of the strip (1 to 64; not used for line fibres) and between the
    /// strip's end and the middle between two fibres (1 to 64; not used where strips touch).
    Counted {
        /// Through the wall.
        radial: usize,
        /// In half of the strip.
        strip: usize,
        /// From the strip's end to the middle between two fibres.
        gap: usize,
        /// Size of an element over that of its neighbour nearer to the strip's end, 1 (all alike) to 8.
        growth: f64,
    },
    /// Sizes that grow geometrically from the strip's end, where the traction jumps, measured across the fibre.
    Graded {
        /// Elements in half of the strip, 1 to 16.
        strip: usize,
        /// Size of an element over that of its neighbour nearer to the strip's end, at most, 1.05 to 8.
        growth: f64,
    },
}

impl Default for Mesh {
    fn default() -> Mesh {
        Mesh::level(1)
    }
}

impl Mesh {
    /// Every length divided in two, as far as the ranges allow.
    pub fn refined(self) -> Mesh {
        match self {
            Mesh::Counted { radial, strip, gap, growth } => {
                let twice = |count: usize, most: usize| (2 * count).min(most);
                let growth = growth.sqrt();
                Mesh::Counted { radial: twice(radial, 32), strip: twice(strip, 64), gap: twice(gap, 64), growth }
            }
            Mesh::Graded { strip, growth } => {
                Mesh::Graded { strip: (2 * strip).min(16), growth: growth.sqrt().max(1.2) }
            }
        }
    }

    /// Checks the ranges.
    pub(super) fn validated(self) -> Result<Mesh, SectionError> {
        let valid = match self {
            Mesh::Counted { radial, strip, gap, growth } => {
                let counts = (1..=32).contains(&radial) && (1..=64).contains(&strip) && (1..=64).contains(&gap);
                counts && (1.0..=8.0).contains(&growth)
            }
            Mesh::Graded { strip, growth } => (1..=16).contains(&strip) && (1.05..=8.0).contains(&growth),
        };
        if valid { Ok(self) } else { Err(SectionError::Mesh(self)) }
    }
}

/// `count` steps from `from` to `to`, the smallest at `from`, each `growth` times the one before.
fn steps(from: f64, to: f64, count: usize, growth: f64) -> impl Iterator<Item = f64> {
    let total: f64 = (0..count).map(|k| growth.powi(k as i32)).sum();
    let mut sum = 0.0;
    (0..count).map(move |k| {
        sum += growth.powi(k as i32);
        if k + 1 == count { to } else { from + (to - from) * sum / total }
    })
}

/// Element edges: radii over Ro from the inside out, and angles from the middle of the fibre to the middle between
/// two fibres, with the number of columns that lie in the strip.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Grid {
    pub(super) radii: Vec<f64>,
    pub(super) angles: Vec<f64>,
    pub(super) strip_columns: usize,
}

impl Grid {
    pub(super) fn new(tube: &Tube, mesh: Mesh) -> Grid {
        let end = PI / tube.fibers as f64;
        let half_width = 0.5 * tube.fiber_width / tube.outer_radius();
        let wall = tube.wall / tube.outer_radius();
        let gap_width = end - half_width;
        // Lengths across the fibre, which is what the fields see: along it nothing changes.
        let cosine = tube.gamma.cos();
        let (radial, strip, gap, growth) = match mesh {
            Mesh::Counted { radial, strip, gap, growth } => (radial, strip, gap, growth),
            Mesh::Graded { strip, growth } => {
                // Counted for one element in half of the strip, each of which is then divided into `strip`: so the mesh
                // of 2 n divides every element of that of n.
                let whole = growth.powi(strip as i32);
                let across = if half_width > 0.0 { (half_width * cosine).min(wall) } else { 0.25 * wall };
                let count =
                    |length: f64| strip * (1.0 + length * (whole - 1.0) / across).log(whole).round().max(1.0) as usize;
                (count(wall), strip, count(gap_width * cosine), growth)
            }
        };
        let mut radii: Vec<f64> = std::iter::once(1.0).chain(steps(1.0, 1.0 - wall, radial, growth)).collect();
        radii.reverse();
        let mut angles = vec![half_width];
        let mut strip_columns = 0;
        if half_width > 0.0 {
            angles.extend(steps(half_width, 0.0, strip, growth));
            angles.reverse();
            strip_columns = strip;
        }
        // Strips that touch leave no gap: what round-off leaves of it is no column.
        if gap_width > 1e-9 * end {
            angles.extend(steps(half_width, end, gap, growth));
        }
        Grid { radii, angles, strip_columns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_lie_at_the_strips_end_and_sizes_grow_away_from_it() {
        let tube = Tube::reference(0.7);
        let grid = Grid::new(&tube, Mesh::Counted { radial: 2, strip: 2, gap: 3, growth: 2.0 });
        let (end, half) = (PI / 6.0, 0.2 / 5.56);
        assert_eq!((grid.strip_columns, grid.angles.len()), (2, 6));
        let expected = [0.0, half * 2.0 / 3.0, half, half + (end - half) / 7.0, half + (end - half) * 3.0 / 7.0, end];
        for (got, want) in grid.angles.iter().zip(expected) {
            assert!((got - want).abs() < 1e-15);
        }
        let (ri, thin) = (4.76 / 5.56, 0.8 / 5.56 / 3.0);
        for (got, want) in grid.radii.iter().zip([ri, 1.0 - thin, 1.0]) {
            assert!((got - want).abs() < 1e-15);
        }
    }

    #[test]
    fn graded_sizes_match_at_the_strips_end_across_the_fibre() {
        for degrees in [20.0_f64, 40.0, 60.0, 80.0, 89.0] {
            for level in 1..=4 {
                let tube = Tube::reference(degrees.to_radians());
                let grid = Grid::new(&tube, Mesh::level(level));
                let cosine = degrees.to_radians().cos();
                let rings = grid.radii.len();
                let end = grid.strip_columns;
                let smallest = (grid.angles[end] - grid.angles[end - 1]) * cosine;
                for size in
                    [grid.radii[rings - 1] - grid.radii[rings - 2], (grid.angles[end + 1] - grid.angles[end]) * cosine]
                {
                    // Whole numbers of elements stretch or shrink a row by up to half a growth.
                    let ratio = size / smallest;
                    assert!((0.45..2.2).contains(&ratio), "{degrees} level {level}: {ratio}");
                }
            }
        }
    }

    #[test]
    fn lines_have_no_strip_and_touching_strips_no_gap() {
        let line = Tube { fiber_width: 0.0, ..Tube::reference(0.7) };
        let grid = Grid::new(&line, Mesh::default());
        assert_eq!((grid.strip_columns, grid.angles[0]), (0, 0.0));
        let share = 2.0 * PI * line.outer_radius() / 6.0;
        let full = Grid::new(&Tube { fiber_width: share, ..line }, Mesh::Graded { strip: 2, growth: 2.0 });
        assert_eq!((full.strip_columns, full.angles.len()), (2, 3));
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        for mesh in [
            Mesh::Counted { radial: 0, strip: 1, gap: 1, growth: 1.0 },
            Mesh::Counted { radial: 1, strip: 1, gap: 65, growth: 1.0 },
            Mesh::Graded { strip: 1, growth: f64::NAN },
            Mesh::Graded { strip: 17, growth: 2.0 },
        ] {
            assert!(matches!(mesh.validated(), Err(SectionError::Mesh(_))), "{mesh:?}");
        }
    }
}

//! The mesh of half a fibre's sector: lines of constant angle and rings of constant radius, graded to the strip's end.

use std::f64::consts::PI;

use super::SectionError;
use crate::fem::tube::Tube;

/// Number of elements in each direction. Sizes grow geometrically away from the strip's end at the outer surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh {
    /// Elements through the wall, 1 to 32.
    pub radial: usize,
    /// Elements in half of the strip, 1 to 64; not used where fibres are lines.
    pub strip: usize,
    /// Elements between the strip's end and the middle between two fibres, 1 to 64; not used where the strips touch.
    pub gap: usize,
    /// Size of an element over that of its neighbour nearer to the strip's end, 1 (uniform) to 8.
    pub growth: f64,
}

impl Default for Mesh {
    fn default() -> Mesh {
        Mesh { radial: 2, strip: 2, gap: 4, growth: 2.0 }
    }
}

impl Mesh {
    /// The mesh with every element divided into `factor` by `factor`; the grading's span is kept.
    pub fn refined(self, factor: usize) -> Mesh {
        Mesh {
            radial: self.radial * factor,
            strip: self.strip * factor,
            gap: self.gap * factor,
            growth: self.growth.powf(1.0 / factor as f64),
        }
    }

    /// Checks the ranges.
    pub(super) fn validated(self) -> Result<Mesh, SectionError> {
        let counts = (1..=32).contains(&self.radial) && (1..=64).contains(&self.strip) && (1..=64).contains(&self.gap);
        if counts && (1.0..=8.0).contains(&self.growth) { Ok(self) } else { Err(SectionError::Mesh(self)) }
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
        let mut radii: Vec<f64> = std::iter::once(1.0)
            .chain(steps(1.0, tube.inner_radius / tube.outer_radius(), mesh.radial, mesh.growth))
            .collect();
        radii.reverse();
        let mut angles = vec![half_width];
        let mut strip_columns = 0;
        if half_width > 0.0 {
            angles.extend(steps(half_width, 0.0, mesh.strip, mesh.growth));
            angles.reverse();
            strip_columns = mesh.strip;
        }
        // Strips that touch leave no gap: what round-off leaves of it is no column.
        if end - half_width > 1e-9 * end {
            angles.extend(steps(half_width, end, mesh.gap, mesh.growth));
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
        let grid = Grid::new(&tube, Mesh { radial: 2, strip: 2, gap: 3, growth: 2.0 });
        let (end, half) = (PI / 6.0, 0.2 / 5.56);
        assert_eq!(grid.strip_columns, 2);
        assert_eq!(grid.angles.len(), 6);
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
    fn lines_have_no_strip_and_touching_strips_no_gap() {
        let line = Tube { fiber_width: 0.0, ..Tube::reference(0.7) };
        let grid = Grid::new(&line, Mesh::default());
        assert_eq!((grid.strip_columns, grid.angles[0], grid.angles.len()), (0, 0.0, 5));
        let share = 2.0 * PI * line.outer_radius() / 6.0;
        let full = Grid::new(&Tube { fiber_width: share, ..line }, Mesh::default());
        assert_eq!((full.strip_columns, full.angles.len()), (2, 3));
    }

    #[test]
    fn refinement_keeps_the_old_edges_when_uniform_and_the_span_when_graded() {
        let fine = Mesh::default().refined(2);
        assert_eq!((fine.radial, fine.strip, fine.gap), (4, 4, 8));
        assert!((fine.growth * fine.growth - 2.0).abs() < 1e-15);
        assert!(Mesh { radial: 0, ..Mesh::default() }.validated().is_err());
        assert!(Mesh { growth: f64::NAN, ..Mesh::default() }.validated().is_err());
    }
}

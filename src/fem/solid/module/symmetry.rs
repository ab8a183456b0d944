//! What a module's symmetry saves: tubes that are images of others, and need not be solved.
//!
//! Half a turn about z exchanges A with C and B with D; the mirror in a plane of x or y exchanges neighbours of
//! opposite hand. Where winding angles, pressures and force are alike under such a motion, so is the equilibrium that
//! grows from rest: one tube is solved, and its image is the same seen in other coordinates. What breaks the symmetry
//! is not lost: the plate's stiffness is that of all four tubes in all six coordinates.

use nalgebra::{SMatrix, SVector, Vector3};

use super::TUBES;
use crate::fem::solid::cap::{COORDINATES, Coordinates};

/// Signs of the coordinates (turn; z, x, y; tilt x, y) under a motion.
pub(super) type Signs = SVector<f64, COORDINATES>;

/// A motion that maps the square of bases onto itself.
struct Motion {
    /// Which tube goes where.
    to: [usize; TUBES],
    signs: [f64; COORDINATES],
    /// Whether it changes hands.
    mirror: bool,
    /// Whether it maps the fibres of a tube of odd number onto the other's.
    any_fibers: bool,
}

const MOTIONS: [Motion; 3] = [
    Motion { to: [2, 3, 0, 1], signs: [1.0, 1.0, -1.0, -1.0, -1.0, -1.0], mirror: false, any_fibers: false },
    // x to -x.
    Motion { to: [1, 0, 3, 2], signs: [-1.0, 1.0, -1.0, 1.0, 1.0, -1.0], mirror: true, any_fibers: false },
    // y to -y.
    Motion { to: [3, 2, 1, 0], signs: [-1.0, 1.0, 1.0, -1.0, -1.0, 1.0], mirror: true, any_fibers: true },
];

/// Which tubes are images of which.
pub(super) struct Symmetry {
    /// The tube that is solved for each, and the signs that make the one's coordinates the other's.
    pub sources: [(usize, Signs); TUBES],
    motions: Vec<Signs>,
}

impl Symmetry {
    /// None: every tube for itself.
    pub fn none() -> Symmetry {
        Symmetry { sources: std::array::from_fn(|i| (i, Signs::repeat(1.0))), motions: Vec::new() }
    }

    /// Of tubes of `fibers` fibres with these winding angles under these rows of pressures and this force.
    pub fn of(gammas: &[f64; TUBES], fibers: usize, pressures: &[[f64; TUBES]], force: &Vector3<f64>) -> Symmetry {
        let mut symmetry = Symmetry::none();
        for motion in &MOTIONS {
            let hand = if motion.mirror { -1.0 } else { 1.0 };
            let alike = motion
                .to
                .iter()
                .enumerate()
                .all(|(i, &j)| gammas[j] == hand * gammas[i] && pressures.iter().all(|p| p[i] == p[j]));
            let along = [motion.signs[2], motion.signs[3]].iter().zip(force).all(|(sign, f)| *sign > 0.0 || *f == 0.0);
            if !(alike && along && (motion.any_fibers || fibers.is_multiple_of(2))) {
                continue;
            }
            let signs = Signs::from(motion.signs);
            symmetry.motions.push(signs);
            for (i, &j) in motion.to.iter().enumerate() {
                // Towards lower numbers: the source of a source is itself.
                if i < j && symmetry.sources[j].0 == j && symmetry.sources[i].0 == i {
                    symmetry.sources[j] = (i, signs);
                }
            }
        }
        // A source may be an image itself; it has a lower number, and is settled.
        for i in 0..TUBES {
            let (source, signs) = symmetry.sources[i];
            let (first, other) = symmetry.sources[source];
            symmetry.sources[i] = (first, signs.component_mul(&other));
        }
        symmetry
    }

    /// Whether tube `index` is solved.
    pub fn solves(&self, index: usize) -> bool {
        self.sources[index].0 == index
    }

    /// The part of the plate's coordinates that the symmetry leaves.
    pub fn project(&self, plate: &SVector<f64, COORDINATES>) -> SVector<f64, COORDINATES> {
        plate.map_with_location(|q, _, x| if self.motions.iter().any(|signs| signs[q] < 0.0) { 0.0 } else { x })
    }
}

/// A matrix by a tube's coordinates as one by its image's.
pub(super) fn image(
    of: &SMatrix<f64, COORDINATES, COORDINATES>,
    signs: &Signs,
) -> SMatrix<f64, COORDINATES, COORDINATES> {
    SMatrix::from_fn(|i, j| signs[i] * of[(i, j)] * signs[j])
}

/// The same of coordinates or what is conjugate to them.
pub(super) fn imaged(of: &Coordinates, signs: &Signs) -> Coordinates {
    std::array::from_fn(|q| signs[q] * of[q])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pressures: [f64; 4], force: Vector3<f64>, gammas: [f64; 4]) -> [usize; 4] {
        Symmetry::of(&gammas, 6, &[pressures], &force).sources.map(|s| s.0)
    }

    #[test]
    fn cases_are_as_symmetric_as_they_look() {
        let (rlrl, zero) = ([1.0, -1.0, 1.0, -1.0], Vector3::zeros());
        assert_eq!(of([5.0; 4], zero, rlrl), [0, 0, 0, 0]);
        assert_eq!(of([5.0, 0.0, 5.0, 0.0], zero, rlrl), [0, 1, 0, 1]);
        assert_eq!(of([5.0, 0.0, 0.0, 0.0], zero, rlrl), [0, 1, 2, 3]);
        // A and B mirror one another in the plane of y and z.
        assert_eq!(of([5.0, 5.0, 0.0, 0.0], zero, rlrl), [0, 0, 2, 2]);
        assert_eq!(of([5.0, 0.0, 0.0, 5.0], zero, rlrl), [0, 1, 1, 0]);
        // Of one hand all, no mirror is left.
        assert_eq!(of([5.0; 4], zero, [1.0; 4]), [0, 1, 0, 1]);
        // A force takes what does not leave it alone.
        assert_eq!(of([5.0; 4], Vector3::new(0.0, 0.1, 0.0), rlrl), [0, 0, 2, 2]);
        assert_eq!(of([5.0; 4], Vector3::new(0.1, 0.1, 0.0), rlrl), [0, 1, 2, 3]);
        assert_eq!(of([5.0; 4], Vector3::new(0.0, 0.0, 0.1), rlrl), [0, 0, 0, 0]);
        // Five fibres are not five again after half a turn.
        assert_eq!(Symmetry::of(&rlrl, 5, &[[5.0; 4]], &zero).sources.map(|s| s.0), [0, 1, 1, 0]);
    }

    #[test]
    fn the_plate_keeps_what_the_symmetry_leaves() {
        let plate = SVector::from([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        let at = |p: [f64; 4]| Symmetry::of(&[1.0, -1.0, 1.0, -1.0], 6, &[p], &Vector3::zeros()).project(&plate).into();
        let all: [f64; 6] = at([1.0; 4]);
        assert_eq!(all, [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(at([1.0, 0.0, 1.0, 0.0]), [0.1, 0.2, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(at([1.0, 1.0, 0.0, 0.0]), [0.0, 0.2, 0.0, 0.4, 0.5, 0.0]);
        assert_eq!(at([1.0, 0.0, 0.0, 0.0]), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
    }
}

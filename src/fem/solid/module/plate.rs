//! Where a plate carries a cap, and what the cap does to it.
//!
//! The plate's coordinates are those of a [cap](crate::fem::solid::cap): turn phi, displacement D and tilt w in the
//! frame that has turned by phi. A cap that is bonded to the plate at the arm o from its centre, above a base that
//! stands at o too, has the same turn and tilt, and the displacement
//!
//! ```text
//!     d = D - Rz(-phi) o + Q(w) o
//! ```

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use crate::fem::solid::cap::{AXIAL, COORDINATES, Coordinates, LATERAL, TILT, TURN, Tilt};
use crate::fem::solid::element::across;

/// Rows of the displacement x, y, z.
const DISPLACEMENT: [usize; 3] = [LATERAL[0], LATERAL[1], AXIAL];

/// A cap on a plate.
pub struct Joint {
    /// The cap's coordinates.
    pub cap: Coordinates,
    /// Their derivatives by the plate's.
    pub slope: SMatrix<f64, COORDINATES, COORDINATES>,
    /// Second derivatives of d by phi, and by the tilt.
    by_turn: Vector3<f64>,
    by_tilt: [[Vector3<f64>; 2]; 2],
}

impl Joint {
    /// Of a cap at `arm` (x and y) on a plate at `plate`.
    pub fn of(plate: &Coordinates, arm: &Vector3<f64>) -> Joint {
        let tilt = Tilt::of(plate);
        let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), -plate[TURN]) * arm;
        let shift = tilt.rotation * arm - turned;
        let (mut cap, mut slope) = (*plate, SMatrix::identity());
        let by_turn = across(&turned);
        for (i, q) in DISPLACEMENT.into_iter().enumerate() {
            cap[q] += shift[i];
            slope[(q, TURN)] = by_turn[i];
            for (first, of) in tilt.first.iter().zip(TILT) {
                slope[(q, of)] = (first * arm)[i];
            }
        }
        Joint { cap, slope, by_turn: turned, by_tilt: tilt.second.map(|row| row.map(|second| second * arm)) }
    }

    /// The second derivatives by the plate's coordinates of what has the first derivatives `force` by the cap's.
    pub fn second(&self, force: &Coordinates) -> SMatrix<f64, COORDINATES, COORDINATES> {
        let force = Vector3::from(DISPLACEMENT.map(|q| force[q]));
        let mut second = SMatrix::zeros();
        second[(TURN, TURN)] = force.dot(&self.by_turn);
        for i in 0..2 {
            for j in 0..2 {
                second[(TILT[i], TILT[j])] = force.dot(&self.by_tilt[i][j]);
            }
        }
        second
    }
}

/// Rotation by the coordinates.
pub fn rotation(at: &Coordinates) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), at[TURN]) * Rotation3::from_matrix_unchecked(Tilt::of(at).rotation)
}

/// Where the centre is in space that was at `center` at rest.
pub fn position(at: &Coordinates, center: &Vector3<f64>) -> Vector3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), at[TURN]) * (center + Tilt::displacement(at))
}

/// Force and moment in space, about the centre, that have the `work` by the coordinates; none where the tilt is pi.
pub fn wrench(at: &Coordinates, center: &Vector3<f64>, work: &Coordinates) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let tilt = Tilt::of(at);
    let force = Vector3::from(DISPLACEMENT.map(|q| work[q]));
    // Spins of the tilt, in the frame.
    let spin = |i: usize| {
        let m = tilt.first[i] * tilt.rotation.transpose();
        Vector3::new(m[(2, 1)], m[(0, 2)], m[(1, 0)])
    };
    let about_z = work[TURN] - (center + Tilt::displacement(at)).cross(&force).z;
    let spins = Matrix3::from_columns(&[spin(0), spin(1), Vector3::z()]).transpose();
    let moment = spins.lu().solve(&Vector3::new(work[TILT[0]], work[TILT[1]], about_z))?;
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), at[TURN]);
    Some((turn * force, turn * moment))
}

/// Derivatives of the cap's as derivatives of the plate's.
pub fn carried(joint: &Joint, force: &Coordinates) -> SVector<f64, COORDINATES> {
    joint.slope.tr_mul(&SVector::from(*force))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLATE: Coordinates = [0.7, 0.3, -1.2, 0.8, 0.4, -0.3];

    fn moved(direction: &Coordinates, h: f64) -> Coordinates {
        std::array::from_fn(|q| PLATE[q] + h * direction[q])
    }

    #[test]
    fn the_cap_stays_where_it_is_bonded() {
        let (center, arm) = (Vector3::new(0.0, 0.0, 23.0), Vector3::new(1.8, -1.8, 0.0));
        let cap = Joint::of(&PLATE, &arm).cap;
        let bonded = position(&PLATE, &center) + rotation(&PLATE) * arm;
        assert!((position(&cap, &center) + arm - bonded).norm() < 1e-13);
        assert!((rotation(&cap).matrix() - rotation(&PLATE).matrix()).norm() < 1e-15);
    }

    #[test]
    fn slopes_and_second_derivatives_are_derivatives() {
        let arm = Vector3::new(1.8, -1.8, 0.0);
        let direction: Coordinates = [0.5, -0.2, 0.9, 0.4, -0.6, 0.7];
        let force: Coordinates = [0.3, 1.1, -0.7, 0.2, 0.9, -0.5];
        let by = SVector::from(direction);
        let at = |h: f64| Joint::of(&moved(&direction, h), &arm);
        let h = 1e-4;
        let (minus, here, plus) = (at(-h), at(0.0), at(h));
        let difference = (SVector::from(plus.cap) - SVector::from(minus.cap)) / (2.0 * h);
        assert!((difference - here.slope * by).norm() < 1e-7);
        let difference = (carried(&plus, &force) - carried(&minus, &force)) / (2.0 * h);
        assert!((difference - here.second(&force) * by).norm() < 1e-7);
    }

    #[test]
    fn a_wrench_does_the_work_of_the_coordinates() {
        let center = Vector3::new(0.0, 0.0, 23.0);
        let work: Coordinates = [0.3, 1.1, -0.7, 0.2, 0.9, -0.5];
        let (force, moment) = wrench(&PLATE, &center, &work).unwrap();
        let direction: Coordinates = [0.5, -0.2, 0.9, 0.4, -0.6, 0.7];
        let h = 1e-4;
        let (minus, plus) = (moved(&direction, -h), moved(&direction, h));
        let shift = (position(&plus, &center) - position(&minus, &center)) / (2.0 * h);
        let spin = (rotation(&plus) * rotation(&minus).inverse()).scaled_axis() / (2.0 * h);
        let exact: f64 = work.iter().zip(direction).map(|(w, d)| w * d).sum();
        assert!((force.dot(&shift) + moment.dot(&spin) - exact).abs() < 1e-6);
    }
}

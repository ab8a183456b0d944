//! The figure that a closed tip path draws on a plane.

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix2, Quaternion, SymmetricEigen, UnitQuaternion, Vector2, Vector3};

use super::Pose;

/// Size and kind of a closed figure, in the coordinates of its plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// Middle of its extents, m.
    pub centre: [f64; 2],
    /// Direction of its long axis, a unit vector.
    pub axis: [f64; 2],
    /// Extent along the long axis, m.
    pub length: f64,
    /// Extent across it, m.
    pub width: f64,
    /// Area that it encloses, counter-clockwise positive, m2: the lobes of an eight cancel.
    pub area: f64,
    /// Least and greatest turn of the plate about z, rad.
    pub twist: [f64; 2],
}

impl Figure {
    /// Of one period of `poses` on the plane of two unit vectors at a right angle; none of fewer than three.
    pub fn of(poses: &[Pose], plane: [Vector3<f64>; 2]) -> Option<Figure> {
        if poses.len() < 3 {
            return None;
        }
        let on = |p: &Pose| Vector2::from(plane.map(|way| way.dot(&Vector3::from(p.position))));
        let points: Vec<Vector2<f64>> = poses.iter().map(on).collect();
        let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
        let spread: Matrix2<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
        let eigen = SymmetricEigen::new(spread);
        let long = eigen.eigenvectors.column(if eigen.eigenvalues[0] >= eigen.eigenvalues[1] { 0 } else { 1 });
        let axis = Vector2::new(long[0], long[1]);
        let across = Vector2::new(-axis.y, axis.x);
        let extent = |way: &Vector2<f64>| {
            let along = points.iter().map(|p| p.dot(way));
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)))
        };
        let ((a, b), (c, d)) = (extent(&axis), extent(&across));
        let centre = (axis * (a + b) + across * (c + d)) * 0.5;
        let next = points.iter().cycle().skip(1);
        let area = 0.5 * points.iter().zip(next).map(|(p, q)| (p - mean).perp(&(q - mean))).sum::<f64>();
        let twists = poses.iter().map(twist);
        let twist = twists.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
        Some(Figure { centre: centre.into(), axis: axis.into(), length: b - a, width: d - c, area, twist })
    }
}

/// Of a plate's rotation (w, x, y, z) from rest, rad: the turn about its own axis, -pi to pi (what is left when the
/// tilt is undone the shortest way), and the angle between its normal and z.
pub fn turn_and_tilt([w, x, y, z]: [f64; 4]) -> (f64, f64) {
    let turn = (2.0 * z.atan2(w) + PI).rem_euclid(TAU) - PI;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    (turn, (rotation * Vector3::z()).z.clamp(-1.0, 1.0).acos())
}

/// [`turn_and_tilt`]'s turn.
pub(super) fn twist(pose: &Pose) -> f64 {
    turn_and_tilt(pose.rotation).0
}

/// [`turn_and_tilt`]'s tilt.
pub(super) fn tilt(pose: &Pose) -> f64 {
    turn_and_tilt(pose.rotation).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(curve: impl Fn(f64) -> (f64, f64)) -> Figure {
        let poses = (0..400).map(|k| {
            let (x, y) = curve(TAU * f64::from(k) / 400.0);
            Pose { position: [x, y, 0.1], rotation: [1.0, 0.0, 0.0, 0.0] }
        });
        Figure::of(&poses.collect::<Vec<_>>(), [Vector3::x(), Vector3::y()]).unwrap()
    }

    #[test]
    fn an_eight_is_long_and_encloses_nothing_and_a_circle_does() {
        // Turned by 30 deg, off the centre.
        let (sine, cosine) = 0.5235987755982988f64.sin_cos();
        let eight = drawn(|u| {
            let (x, y) = (5.0 * u.sin(), 1.0 * (2.0 * u).sin());
            (3.0 + cosine * x - sine * y, -2.0 + sine * x + cosine * y)
        });
        assert!((eight.length - 10.0).abs() < 1e-2 && (eight.width - 2.0).abs() < 1e-2 && eight.area.abs() < 1e-9);
        assert!((eight.axis[0].abs() - cosine).abs() < 1e-9);
        assert!((eight.centre[0] - 3.0).abs() < 1e-2 && (eight.centre[1] + 2.0).abs() < 1e-2);
        let circle = drawn(|u| (2.0 * u.cos(), -2.0 * u.sin()));
        // A polygon of 400 sides.
        assert!((circle.area / (4.0 * PI) + 1.0).abs() < 1e-4);
        assert_eq!(Figure::of(&[], [Vector3::x(), Vector3::y()]), None);
    }

    #[test]
    fn twist_and_tilt_come_apart() {
        let turn = UnitQuaternion::from_euler_angles(0.3, 0.0, 0.0) * UnitQuaternion::from_euler_angles(0.0, 0.0, -1.2);
        let pose = Pose { position: [0.0; 3], rotation: [turn.w, turn.i, turn.j, turn.k] };
        let flipped = Pose { rotation: pose.rotation.map(|x| -x), ..pose };
        for pose in [pose, flipped] {
            assert!((twist(&pose) + 1.2).abs() < 1e-12 && (tilt(&pose) - 0.3).abs() < 1e-12);
        }
    }
}

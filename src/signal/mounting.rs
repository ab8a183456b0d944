//! How an orientation sensor sits on what carries it.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};

/// How a sensor is mounted in whose frame z of what carries it is `axis` (of any length but zero): the short way, from
/// the carrier's frame to the sensor's; opposite directions have none, and turn about x.
pub fn mounting(axis: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), &axis.into())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_carriers_z_is_the_axis_in_the_sensors_frame_whichever_way_it_points() {
        for axis in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8]] {
            let seen = mounting(axis) * Vector3::z();
            assert!((seen - Vector3::from(axis)).norm() < 1e-12, "{axis:?} {seen:?}");
        }
    }
}

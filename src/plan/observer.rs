//! Where the plate's centre is, from the pressures and the plate's measured rotation.
//!
//! An orientation sensor does not see the tip. What the model knows of it, at the measured pressures, is corrected by
//! what it got wrong of the rotation. Two things are taken to be unknown: each FREE's actuation by a share of its
//! pressure, and a small dead force and moment on the plate. With J the plate's motion by the pressures and C its
//! compliance, what they make of it has the covariance
//!
//! ```text
//!     S = J diag(share P)^2 J^T + C diag(moment^2, force^2) C^T
//! ```
//!
//! and the motion that goes with a rotation off by `d` is the linear estimate `S_xr (S_rr + noise^2)^-1 d`; what of
//! the position it leaves unknown is `S_xx - S_xr (S_rr + noise^2)^-1 S_rx`.

use nalgebra::{Matrix3, Matrix6, Quaternion, UnitQuaternion, Vector3};

use crate::fem::module::State;
use crate::signal::mounting;

/// What is not known, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unknown {
    /// Actuation of each FREE, relative.
    pub actuation: f64,
    /// Force on the plate, N, in each direction; as a moment on an arm of 1 cm.
    pub force: f64,
    /// Rotation's measurement, rad, about each axis.
    pub rotation: f64,
}

impl Default for Unknown {
    /// FREEs of the same batch, a cable that pulls, a BNO055.
    fn default() -> Unknown {
        Unknown { actuation: 0.05, force: 2e-3, rotation: 0.3f64.to_radians() }
    }
}

/// The arm on which a stray force is a moment, m.
const ARM: f64 = 0.01;

/// How a module's plate has turned from rest, from its sensor's quaternions (w, x, y, z) then and `now`; `axis` is the
/// plate's normal in the sensor's frame. None of what is no orientation.
pub fn turned(axis: [f64; 3], rest: [f64; 4], now: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let unit = |[w, x, y, z]: [f64; 4]| UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.5);
    let (rest, now) = (unit(rest)?, unit(now)?);
    let sensor = mounting(axis);
    Some(sensor.inverse() * (rest.inverse() * now) * sensor)
}

/// An estimate of the plate's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// m.
    pub position: Vector3<f64>,
    /// Its standard deviation along x, y, z, m, by what is taken to be unknown.
    pub deviation: Vector3<f64>,
}

/// The tip of the plate that the model puts at `model` and that is turned by `rotation`; none at a critical point.
pub fn tip(model: &State, rotation: &UnitQuaternion<f64>, unknown: &Unknown) -> Option<Tip> {
    let compliance = model.compliance()?;
    let (m, f) = ((unknown.force * ARM).powi(2), unknown.force.powi(2));
    let loads = Matrix6::from_diagonal(&nalgebra::Vector6::new(m, m, m, f, f, f));
    let mut covariance = compliance * loads * compliance.transpose();
    for (by, pressure) in model.by_pressure()?.iter().zip(&model.loads().pressures) {
        covariance += by * by.transpose() * (unknown.actuation * pressure).powi(2);
    }
    let turns: Matrix3<f64> = covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let both: Matrix3<f64> = covariance.fixed_view::<3, 3>(3, 0).into_owned();
    let seen = turns + Matrix3::identity() * unknown.rotation.powi(2);
    let gain = both * seen.try_inverse()?;
    let off = (rotation * model.rotation().inverse()).scaled_axis();
    let left = covariance.fixed_view::<3, 3>(3, 3) - gain * both.transpose();
    Some(Tip { position: model.position() + gain * off, deviation: left.diagonal().map(|x| x.max(0.0).sqrt()) })
}

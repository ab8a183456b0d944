//! The orientation of a FREE at rest: the mean of many.
//!
//! The mean quaternion is the eigenvector of the largest eigenvalue of `sum q q^T`, which no sign of a reading can
//! change (Markley and others, 2007).

use nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector4};
use thiserror::Error;

/// Fewest readings.
pub const READINGS_MIN: usize = 10;
/// Farthest from one that a reading's norm may be.
pub const NORM_MAX: f64 = 0.02;
/// Farthest that any reading of a still FREE may be from the mean, rad: 1 deg.
pub const SPREAD_MAX: f64 = 0.01745;

/// A tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tare {
    /// Mean orientation, unit quaternion (w, x, y, z), w not negative.
    pub quaternion: [f64; 4],
    /// Standard uncertainty about each axis, rad, the readings taken as independent.
    pub uncertainty: f64,
    /// Root mean square angle between a reading and the mean, rad.
    pub spread: f64,
    /// Readings that were used.
    pub readings: usize,
}

/// Why there is no tare.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TareError {
    /// Too few readings.
    #[error("a tare needs at least {READINGS_MIN} readings; there are {0}")]
    TooFew(usize),
    /// No orientation.
    #[error("reading {index} has the norm {norm:.4}; an orientation's is 1 within {NORM_MAX}")]
    Norm {
        /// Which one.
        index: usize,
        /// Its norm.
        norm: f64,
    },
    /// It moved.
    #[error(
        "reading {index} is {angle:.4} rad from the mean; at rest it is within {SPREAD_MAX} rad: let the FREE rest"
    )]
    Moving {
        /// Which one.
        index: usize,
        /// How far, rad.
        angle: f64,
    },
}

/// The mean of orientations (w, x, y, z) at rest.
pub fn fit_tare(readings: &[[f64; 4]]) -> Result<Tare, TareError> {
    if readings.len() < READINGS_MIN {
        return Err(TareError::TooFew(readings.len()));
    }
    let units = units(readings).map_err(|(index, norm)| TareError::Norm { index, norm })?;
    let moment: Matrix4<f64> = units.iter().map(|q| q.as_vector() * q.as_vector().transpose()).sum();
    let eigen = moment.symmetric_eigen();
    let mut mean: Vector4<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into();
    // nalgebra's order is x, y, z, w.
    if mean.w < 0.0 {
        mean = -mean;
    }
    let mean = UnitQuaternion::from_quaternion(Quaternion::from_vector(mean));
    let angles: Vec<f64> = units.iter().map(|q| mean.angle_to(q)).collect();
    let farthest = (0..angles.len()).fold(0, |a, b| if angles[b] > angles[a] { b } else { a });
    if angles[farthest] > SPREAD_MAX {
        return Err(TareError::Moving { index: farthest, angle: angles[farthest] });
    }
    let square = angles.iter().map(|a| a * a).sum::<f64>();
    let count = angles.len() as f64;
    Ok(Tare {
        quaternion: [mean.w, mean.i, mean.j, mean.k],
        // A third of the square belongs to each axis.
        uncertainty: (square / 3.0 / (count - 1.0) / count).sqrt(),
        spread: (square / count).sqrt(),
        readings: readings.len(),
    })
}

/// The readings as unit quaternions, or the first that is none and its norm.
pub(super) fn units(readings: &[[f64; 4]]) -> Result<Vec<UnitQuaternion<f64>>, (usize, f64)> {
    let unit = |(index, q): (usize, &[f64; 4])| {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        let plausible = (norm - 1.0).abs() <= NORM_MAX;
        let unit = || UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
        if plausible { Ok(unit()) } else { Err((index, norm)) }
    };
    readings.iter().enumerate().map(unit).collect()
}

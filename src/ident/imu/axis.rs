//! The FREE's axis in the sensor's frame, found by turning it.
//!
//! With the tare q0, `q0^-1 q = (cos x/2, a sin x/2)` is a rotation x about a in the sensor's frame, up to a whole
//! turn, the quaternion's sign following its predecessor. The axis is the line through the origin nearest to all the
//! chords `v = 2 a sin x/2` (the principal axis of `sum v v^T`): a small rotation by noise moves the chord by as much
//! across the axis whatever x is, which is not true of the rotation vector `x a`. The axis points to where the movement
//! is positive by the right-hand rule about the FREE's z. What is left across it is bending, or an IMU that slipped.
//!
//! The uncertainty is the residuals', taken as independent, and the tare's: its error e moves every chord across the
//! axis by e, turned by x/2.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

use super::tare::{NORM_MAX, Tare, units};

/// Fewest readings.
pub const READINGS_MIN: usize = 20;
/// Smallest movement, rad: 5 deg, a hundred times the noise.
pub const MOVEMENT_MIN: f64 = 0.0873;
/// Largest root mean square across the axis, over that along it: 0.2 is a tilt of 11 deg.
pub const ACROSS_MAX: f64 = 0.2;
/// Largest movement to the other side, over the movement.
pub const BACK_MAX: f64 = 0.3;
/// Farthest that two readings in a row may be apart, rad: beyond it the sign of the quaternion cannot be followed.
pub const JUMP_MAX: f64 = 1.0;

/// Which way the FREE was turned, by the right-hand rule about its z, which runs from base to tip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// As an L FREE turns under pressure.
    Positive,
    /// As an R FREE turns under pressure.
    Negative,
}

/// How the sensor sits on the FREE.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisFit {
    /// The FREE's axis in the sensor's frame, a unit vector; rotation about it is positive as the FREE's is.
    pub axis: [f64; 3],
    /// Standard uncertainty of its direction, rad, in each direction across it.
    pub uncertainty: f64,
    /// The nearest of the sensor's axes: 0, 1, 2 for x, y, z.
    pub nearest: usize,
    /// Whether the nearest points along the FREE's axis rather than against it.
    pub along: bool,
    /// Angle between the two, rad.
    pub misalignment: f64,
    /// Farthest rotation, rad, with the sign of the turn.
    pub movement: f64,
    /// Root mean square of the chords across the axis, rad.
    pub across: f64,
    /// The same, over that along the axis.
    pub share: f64,
    /// Readings that were used.
    pub readings: usize,
}

/// Why there is no axis.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AxisError {
    /// Too few readings.
    #[error("an axis needs at least {READINGS_MIN} readings; there are {0}")]
    TooFew(usize),
    /// No orientation.
    #[error("reading {index} has the norm {norm:.4}; an orientation's is 1 within {NORM_MAX}")]
    Norm {
        /// Which one.
        index: usize,
        /// Its norm.
        norm: f64,
    },
    /// The tare is none.
    #[error("the tare has the norm {0:.4}; an orientation's is 1 within {NORM_MAX}")]
    Tare(f64),
    /// Too far from one reading to the next.
    #[error("reading {index} is {angle:.4} rad from the one before it; at most {JUMP_MAX} rad can be followed")]
    Jump {
        /// Which one.
        index: usize,
        /// How far, rad.
        angle: f64,
    },
    /// Hardly turned.
    #[error("the FREE turned by {0:.4} rad only; at least {MOVEMENT_MIN} rad are needed: turn it farther")]
    TooSmall(f64),
    /// Turned about more than one axis.
    #[error("{share:.3} of the movement is across the axis; at most {ACROSS_MAX} may be: turn it without bending it")]
    Across {
        /// Share.
        share: f64,
    },
    /// Turned to both sides.
    #[error("the FREE turned by {there:.4} rad and by {back:.4} rad to the other side: turn it to one side only")]
    BothWays {
        /// Farthest, rad.
        there: f64,
        /// Farthest to the other side, rad.
        back: f64,
    },
}

/// Finds the FREE's axis from orientations (w, x, y, z) while it turns from `tare` in the direction `turn`, and perhaps
/// back.
pub fn fit_axis(tare: &Tare, readings: &[[f64; 4]], turn: Turn) -> Result<AxisFit, AxisError> {
    if readings.len() < READINGS_MIN {
        return Err(AxisError::TooFew(readings.len()));
    }
    let zero = units(&[tare.quaternion]).map_err(|(_, norm)| AxisError::Tare(norm))?[0];
    let units = units(readings).map_err(|(index, norm)| AxisError::Norm { index, norm })?;
    let turns = turns(zero, &units)?;
    let chords: Vec<Vector3<f64>> = turns.iter().map(|q| 2.0 * q.vector()).collect();
    let moment: Matrix3<f64> = chords.iter().map(|v| v * v.transpose()).sum();
    let eigen = moment.symmetric_eigen();
    let mut axis: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into();
    // First towards the movement, then by the sign that the movement has.
    let (low, high) = extremes(&turns, &axis);
    if -low > high {
        axis = -axis;
    }
    let (low, high) = extremes(&turns, &axis);
    if high < MOVEMENT_MIN {
        return Err(AxisError::TooSmall(high));
    }
    let along: f64 = chords.iter().map(|v| v.dot(&axis).powi(2)).sum();
    let across: f64 = chords.iter().map(|v| (v - axis * v.dot(&axis)).norm_squared()).sum();
    let share = (across / along).sqrt();
    if share > ACROSS_MAX {
        return Err(AxisError::Across { share });
    }
    if -low > BACK_MAX * high {
        return Err(AxisError::BothWays { there: high, back: -low });
    }
    let (cosines, sines) = turns.iter().zip(&chords).fold((0.0, 0.0), |(c, s), (q, v)| {
        let chord = v.dot(&axis);
        (c + chord * q.w, s + 0.5 * chord * chord)
    });
    let from_tare = cosines.hypot(sines) / along * tare.uncertainty;
    let (axis, movement) = match turn {
        Turn::Positive => (axis, high),
        Turn::Negative => (-axis, -high),
    };
    let nearest = axis.iamax();
    let count = chords.len() as f64;
    Ok(AxisFit {
        axis: axis.into(),
        // The slope of a line through the origin, in each of the two directions across.
        uncertainty: (0.5 * across / (count - 1.0) / along).sqrt().hypot(from_tare),
        nearest,
        along: axis[nearest] > 0.0,
        misalignment: axis[nearest].abs().min(1.0).acos(),
        movement,
        across: (across / count).sqrt(),
        share,
        readings: readings.len(),
    })
}

/// Smallest and largest rotation about `axis`, rad.
fn extremes(turns: &[Quaternion<f64>], axis: &Vector3<f64>) -> (f64, f64) {
    let angles = turns.iter().map(|q| 2.0 * q.vector().dot(axis).atan2(q.w));
    angles.fold((0.0, 0.0), |(low, high), x| (low.min(x), high.max(x)))
}

/// Rotations from the tare in the sensor's frame, w negative where the FREE turned farther than half a turn.
fn turns(tare: UnitQuaternion<f64>, units: &[UnitQuaternion<f64>]) -> Result<Vec<Quaternion<f64>>, AxisError> {
    let mut before = Quaternion::new(1.0, 0.0, 0.0, 0.0);
    let mut turns = Vec::with_capacity(units.len());
    for (index, unit) in units.iter().enumerate() {
        let mut q = (tare.inverse() * unit).into_inner();
        if q.dot(&before) < 0.0 {
            q = -q;
        }
        let angle = 2.0 * q.dot(&before).min(1.0).acos();
        if angle > JUMP_MAX {
            return Err(AxisError::Jump { index, angle });
        }
        turns.push(q);
        before = q;
    }
    Ok(turns)
}

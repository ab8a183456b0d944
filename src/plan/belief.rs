//! What is known of a module's unknowns, and learned of them while it moves: recursive least squares.
//!
//! Unknown are the FREEs' scatter ([`super::scatter`]), what hangs on the plate beyond its own mass, and how long the
//! plate lags behind its pressures. They begin at zero with the standard deviations of a batch, wander slowly (what was
//! seen long ago is forgotten), and are corrected by every measurement row by row,
//!
//! ```text
//!     k = C h / (h.C h + noise^2)      u += k (measured - predicted)      C -= k (C h)^T
//! ```
//!
//! A reading's own noise is white. What else it is off by (the fusion drifts, the linear model is off by the same
//! amount for a while) successive readings share, so that of it a reading counts only for its share of `ALIKE`.

use nalgebra::{SMatrix, SVector};

use super::FREES;
use super::scatter::SCATTER;

/// All unknowns: the scatter, a payload (kg), a lag (s).
pub const UNKNOWNS: usize = SCATTER + 2;
/// Index of the payload.
pub(super) const PAYLOAD: usize = SCATTER;
/// Index of the lag.
pub(super) const LAG: usize = SCATTER + 1;

/// Standard deviations to begin with: a winding machine's degree; 5 % each of the rubber and of the wall.
const ANGLE: f64 = std::f64::consts::PI / 180.0;
const BATCH: f64 = 0.05;
/// kg, s. A payload is hardly seen in a rotation: of those that nobody has said the likely ones are a plate's own
/// weight.
const LOAD: f64 = 0.01;
const DELAY: f64 = 0.02;
/// s, after which what is not seen again is as unknown as at first.
const FORGOTTEN: f64 = 120.0;
/// s, for which what successive readings share stays the same: a quarter of an eight of four seconds.
const ALIKE: f64 = 1.0;

/// How a measured number follows from the unknowns, per unit of each.
pub(super) type Row = SVector<f64, UNKNOWNS>;

/// The unknowns, as far as they are known.
#[derive(Clone, Debug)]
pub struct Belief {
    mean: SVector<f64, UNKNOWNS>,
    covariance: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
}

impl Default for Belief {
    /// Nothing but what a batch is like.
    fn default() -> Self {
        let variance = first().map(|x| x * x);
        Self { mean: SVector::zeros(), covariance: SMatrix::from_diagonal(&variance) }
    }
}

/// The standard deviations to begin with.
fn first() -> SVector<f64, UNKNOWNS> {
    SVector::from_fn(|i, _| match i {
        PAYLOAD => LOAD,
        LAG => DELAY,
        i if i < FREES => ANGLE,
        _ => BATCH,
    })
}

impl Belief {
    /// The scatter of the FREEs.
    pub(super) fn scatter(&self) -> SVector<f64, SCATTER> {
        self.mean.fixed_rows::<SCATTER>(0).into_owned()
    }

    /// What hangs on the plate beyond its own mass, kg; may be negative, where the plate is lighter than it is said to
    /// be.
    pub fn payload(&self) -> f64 {
        self.mean[PAYLOAD]
    }

    /// How long the plate lags behind its pressures, s.
    pub fn lag(&self) -> f64 {
        self.mean[LAG]
    }

    /// The unknowns and their standard deviations: winding angles (rad), rubbers and walls (relative) of A, B, C, D,
    /// payload (kg), lag (s).
    pub fn unknowns(&self) -> [(f64, f64); UNKNOWNS] {
        std::array::from_fn(|i| (self.mean[i], self.covariance[(i, i)].max(0.0).sqrt()))
    }

    /// What the unknowns make of the number of `row`, beyond a model that has the `payload` (kg) in it already.
    pub(super) fn expected(&self, row: &Row, payload: f64) -> f64 {
        row.dot(&self.mean) - row[PAYLOAD] * payload
    }

    /// Variance of what follows from the unknowns by `row`.
    pub(super) fn variance(&self, row: &Row) -> f64 {
        row.dot(&(self.covariance * row))
    }

    /// `dt` s go by.
    pub(super) fn wander(&mut self, dt: f64) {
        for (i, x) in first().iter().enumerate() {
            let first = x * x;
            // Never wider than at first.
            let variance = &mut self.covariance[(i, i)];
            *variance += (first - *variance).max(0.0).min(first * dt / FORGOTTEN);
        }
    }

    /// Learns from a number that is `off` by what the unknowns as they are say of it, read `dt` s after the one before;
    /// standard deviations of its `white` noise and of what it has `shared` with that one.
    pub(super) fn learn(&mut self, row: &Row, off: f64, (white, shared): (f64, f64), dt: f64) {
        let along = self.covariance * row;
        let variance = row.dot(&along) + white * white + shared * shared * (ALIKE / dt).max(1.0);
        if !(variance > 0.0 && off.is_finite() && variance.is_finite()) {
            return;
        }
        let gain = along / variance;
        self.mean += gain * off;
        self.covariance -= gain * along.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }
}

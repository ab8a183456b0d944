//! A module's plate led along its path.
//!
//! [`Pursuit::see`] takes what is measured of the plate (its rotation, and its position where something outside sees
//! it) with the pressures that made it, and learns ([`Belief`]). [`Pursuit::correct`] looks a little ahead, at where
//! the plate is going to be by the model and all that was learned, and says by how much the plan's pressures are to be
//! changed: half of a Gauss-Newton step a turn,
//!
//! ```text
//!     min |J dp - (target - predicted)|^2 + weight^2 |trim + dp|^2        0 <= p + trim + dp <= p_max
//! ```
//!
//! which follows the minimum as it moves. The fourth freedom stays near the plan. Nothing that is measured goes into
//! the correction but by way of what was learned, which changes slowly: the loop has no fast gain that a regulator's
//! lag could turn into an oscillation.

use nalgebra::{Matrix4, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector4, Vector6};

use super::belief::{Belief, LAG, PAYLOAD, Row};
use super::quadratic::Quadratic;
use super::scatter::{Family, SCATTER};
use super::{FREES, Rest};
use crate::fem::module::{Loads, State};

/// White noise of a measured rotation about each axis, rad: the most that `freerig calibrate imu` lets pass. Of a
/// pressure, Pa.
const ROTATION: f64 = 0.2 * std::f64::consts::PI / 180.0;
const PRESSURE: f64 = 0.01 * crate::units::PASCAL_PER_PSI;
/// What the unknowns' linear model leaves of a rotation, rad: of six modules, as far from theirs as a batch is, 0.06 to
/// 0.15 deg over an eight of 8 mm.
const LINEAR: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Error of a target, m, that a change of a pressure by 1 Pa is worth (0.02 mm and 1 psi).
const WEIGHT: f64 = 2e-5 / crate::units::PASCAL_PER_PSI;
/// Share of a step that is taken. What was learned moves with the pressures too, which the Jacobian does not know:
/// where a module is far from its model, whole steps swing about the minimum.
const SHARE: f64 = 0.5;
/// A model that has learned all it can is still off by so much, m: a pose is not judged by less.
const MODEL: f64 = 5e-4;
/// A reading that is farther from what is expected than so many standard deviations is none.
const OUTLIER: f64 = 6.0;
/// Longest time between two readings that counts as such, s.
const PAUSE: f64 = 0.1;

/// What is measured of the plate at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Since the reading before, s.
    pub dt: f64,
    /// Pressures in the FREEs then, Pa, and how they changed, Pa/s.
    pub pressures: [f64; 4],
    /// Pa/s.
    pub rates: [f64; 4],
    /// The plate's rotation from rest, where it has been read.
    pub rotation: Option<UnitQuaternion<f64>>,
    /// Its centre, m, with the standard deviation of each coordinate, where something outside saw it.
    pub position: Option<(Vector3<f64>, f64)>,
}

/// Where the plate is held to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Its centre, m.
    pub position: Vector3<f64>,
    /// Standard deviation along x, y, z, m, by what is still unknown.
    pub deviation: Vector3<f64>,
    /// Whether a position that was given was believed; none where none was given.
    pub believed: Option<bool>,
}

/// The pressures of a plan, a little ahead of now.
#[derive(Clone, Copy, Debug)]
pub struct Ahead {
    /// Of A, B, C, D, Pa.
    pub pressures: [f64; 4],
    /// The highest they may be, Pa.
    pub highest: [f64; 4],
    /// The largest change of each, Pa.
    pub most: f64,
    /// The least smooth margin that a change may leave.
    pub margin: f64,
}

/// The way along a path.
#[derive(Debug)]
pub struct Pursuit<'a> {
    rest: &'a Rest<'a>,
    family: &'a Family,
    belief: Belief,
    /// The model at the pressures last seen, and at those that were last asked for.
    seen: State,
    ahead: State,
    trim: Vector4<f64>,
}

impl<'a> Pursuit<'a> {
    /// From rest on; the module of `rest` is that of `family`.
    pub fn new(rest: &'a Rest<'a>, family: &'a Family) -> Self {
        let (seen, ahead) = (rest.state().clone(), rest.state().clone());
        Self { rest, family, belief: Belief::default(), seen, ahead, trim: Vector4::zeros() }
    }

    /// What has been learned.
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// Learns from what was `seen`; none where the model has no equilibrium there, and then nothing is learned.
    pub fn see(&mut self, seen: &Seen) -> Option<Held> {
        let dt = seen.dt.clamp(1e-3, PAUSE);
        self.belief.wander(dt);
        // What is in the model's own state is not expected of it a second time.
        let payload = self.belief.payload();
        self.seen = self.follow(&self.seen, &seen.pressures)?;
        let (compliance, by_scatter) = self.by_scatter(&self.seen)?;
        let by_pressure = self.seen.by_pressure()?;
        let by_payload = self.by_payload(&compliance);
        let speed: Vector6<f64> = by_pressure.iter().zip(&seen.rates).map(|(by, rate)| by * *rate).sum();
        let rows: [Row; 6] = std::array::from_fn(|i| {
            let mut row = Row::zeros();
            row.fixed_rows_mut::<SCATTER>(0).copy_from(&by_scatter.row(i).transpose());
            (row[PAYLOAD], row[LAG]) = (by_payload[i], -speed[i]);
            row
        });
        if let Some(rotation) = &seen.rotation {
            let off = (rotation * self.seen.rotation().inverse()).scaled_axis();
            for (i, (row, off)) in rows.iter().zip(&off).enumerate() {
                // The pressures are read, too.
                let turns = by_pressure.iter().map(|by| (by[i] * PRESSURE).powi(2)).sum::<f64>();
                let white = (ROTATION * ROTATION + turns).sqrt();
                self.belief.learn(row, off - self.belief.expected(row, payload), (white, LINEAR), dt);
            }
        }
        let model = self.seen.position();
        let mut believed = None;
        if let Some((position, noise)) = seen.position {
            let off = |belief: &Belief, i: usize| position[i] - model[i] - belief.expected(&rows[3 + i], payload);
            let sure = |i: usize| (self.belief.variance(&rows[3 + i]) + noise * noise + MODEL * MODEL).sqrt();
            let within = (0..3).all(|i| off(&self.belief, i).abs() <= OUTLIER * sure(i));
            for i in (0..3).filter(|_| within) {
                let off = off(&self.belief, i);
                self.belief.learn(&rows[3 + i], off, (0.0, noise), dt);
            }
            believed = Some(within);
        }
        let position = Vector3::from_fn(|i, _| model[i] + self.belief.expected(&rows[3 + i], payload));
        let deviation = Vector3::from_fn(|i, _| self.belief.variance(&rows[3 + i]).max(0.0).sqrt());
        Some(Held { position, deviation, believed })
    }

    /// By how much the pressures of A, B, C, D that the plan has where its `target` (m) is, ahead of now, are to be
    /// changed, Pa; none where the model has no stable equilibrium there.
    pub fn correct(&mut self, target: &Vector3<f64>, ahead: &Ahead) -> Option<[f64; 4]> {
        let plan = Vector4::from(ahead.pressures);
        let low = (-plan).map(|p| p.clamp(-ahead.most, 0.0));
        let high = (Vector4::from(ahead.highest) - plan).map(|p| p.clamp(0.0, ahead.most));
        let bounded = |trim: Vector4<f64>| Vector4::from_fn(|i, _| trim[i].clamp(low[i], high[i]));
        self.trim = bounded(self.trim);
        let state = self.follow(&self.ahead, &(plan + self.trim).into())?;
        if !state.stable() {
            return None;
        }
        let motion = self.by_scatter(&state)?.1 * self.belief.scatter();
        let by_pressure = state.by_pressure()?;
        let jacobian = SMatrix::<f64, 3, FREES>::from_fn(|i, j| by_pressure[j][3 + i]);
        let off = target - state.position() - motion.fixed_rows::<3>(3);
        let margin = self.rest.margin(&state).smooth;
        self.ahead = state;
        if margin < ahead.margin {
            // Back towards the plan, as fast as the loop learns.
            self.trim *= 0.8;
            return Some(self.trim.into());
        }
        let h = jacobian.tr_mul(&jacobian) + Matrix4::identity() * (WEIGHT * WEIGHT);
        let g = self.trim * (WEIGHT * WEIGHT) - jacobian.tr_mul(&off);
        let step = Quadratic { h, g, low: low - self.trim, high: high - self.trim }.least();
        self.trim = bounded(self.trim + SHARE * step);
        Some(self.trim.into())
    }

    /// The equilibrium at `pressures`, Pa, under the payload that is believed in, from `state` on.
    fn follow(&self, state: &State, pressures: &[f64; 4]) -> Option<State> {
        let loads = self.rest.loads(pressures);
        let force = loads.force + loads.gravity * self.belief.payload();
        self.rest.module().equilibrium_from(state, &Loads { force, ..loads }).ok()
    }

    /// The compliance of `state`, and the plate's motion by the scatter.
    fn by_scatter(&self, state: &State) -> Option<(Matrix6<f64>, SMatrix<f64, 6, SCATTER>)> {
        let compliance = state.compliance()?;
        Some((compliance, compliance * self.family.wrenches(state).ok()?))
    }

    /// The plate's motion by a kilogram on it.
    fn by_payload(&self, compliance: &Matrix6<f64>) -> Vector6<f64> {
        let gravity = self.rest.loads(&[0.0; FREES]).gravity;
        compliance * Vector6::new(0.0, 0.0, 0.0, gravity.x, gravity.y, gravity.z)
    }
}

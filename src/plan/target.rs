//! Where the plate should be.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3, Vector6};

use super::{FREES, PlanError, Rest};
use crate::fem::module::State;

/// Derivative of the weighted error by the pressures.
pub(super) type Jacobian = SMatrix<f64, 6, FREES>;

/// A pose of the plate, of which every component counts as much as its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Of the plate's centre, m, in the base's frame.
    pub position: Vector3<f64>,
    /// From rest.
    pub rotation: UnitQuaternion<f64>,
    /// Of the position's components; 1 counts, 0 does not matter.
    pub position_weight: Vector3<f64>,
    /// Of the components of the rotation vector from the target to the plate in the base's frame, m (per rad).
    pub rotation_weight: Vector3<f64>,
}

impl Target {
    /// The plate's centre at `position` m, turned in any way.
    pub fn point(position: Vector3<f64>) -> Target {
        let (position_weight, rotation_weight) = (Vector3::repeat(1.0), Vector3::zeros());
        Target { position, rotation: UnitQuaternion::identity(), position_weight, rotation_weight }
    }

    /// A whole pose; an error of a radian counts like one of `lever` m.
    pub fn pose(position: Vector3<f64>, rotation: UnitQuaternion<f64>, lever: f64) -> Target {
        Target { rotation, rotation_weight: Vector3::repeat(lever), ..Target::point(position) }
    }

    /// An error that names what is no target for this module.
    pub fn check(&self, rest: &Rest<'_>) -> Result<(), PlanError> {
        for x in &self.position {
            if !x.is_finite() {
                return Err(PlanError::invalid("a coordinate of the target (m)", *x, "must be finite"));
            }
        }
        for x in self.rotation.coords.iter() {
            if !x.is_finite() {
                return Err(PlanError::invalid("a component of the target's rotation", *x, "must be finite"));
            }
        }
        for x in self.position_weight.iter().chain(&self.rotation_weight) {
            if !(*x >= 0.0 && x.is_finite()) {
                return Err(PlanError::invalid("a weight of the target", *x, "must be finite and not negative"));
            }
        }
        if self.weights().amax() == 0.0 {
            return Err(PlanError::invalid("the largest weight of the target", 0.0, "something has to count"));
        }
        let base = rest.module().mounts().iter().map(|m| m.base.z).fold(f64::NEG_INFINITY, f64::max);
        if self.position_weight.z > 0.0 && self.position.z <= base {
            let z = self.position.z;
            return Err(PlanError::BelowBase { z, base, rest: rest.state().position().z });
        }
        Ok(())
    }

    /// Weights of (rotation, position).
    fn weights(&self) -> Vector6<f64> {
        let (r, p) = (self.rotation_weight, self.position_weight);
        Vector6::new(r.x, r.y, r.z, p.x, p.y, p.z)
    }

    /// What the plate of `state` is off by: rotation vector, rad, and position, m.
    pub fn off(&self, state: &State) -> (Vector3<f64>, Vector3<f64>) {
        ((state.rotation() * self.rotation.inverse()).scaled_axis(), state.position() - self.position)
    }

    /// The weighted error of `state`, m: rotation's components, then position's.
    pub fn residual(&self, state: &State) -> Vector6<f64> {
        let (turn, shift) = self.off(state);
        self.weights().component_mul(&Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z))
    }

    /// Derivative of [`Target::residual`] by the pressures, m/Pa; none at a critical point.
    pub fn jacobian(&self, state: &State) -> Option<SMatrix<f64, 6, 4>> {
        let (turn, _) = self.off(state);
        let turn = left_jacobian_inverse(&turn);
        let weights = self.weights();
        let mut jacobian = Jacobian::zeros();
        for (mut column, twist) in jacobian.column_iter_mut().zip(state.by_pressure()?) {
            column.fixed_rows_mut::<3>(0).copy_from(&(turn * twist.fixed_rows::<3>(0)));
            column.fixed_rows_mut::<3>(3).copy_from(&twist.fixed_rows::<3>(3));
            column.component_mul_assign(&weights);
        }
        Some(jacobian)
    }
}

/// What makes the rate of a rotation vector of an angular velocity in the fixed frame.
fn left_jacobian_inverse(turn: &Vector3<f64>) -> Matrix3<f64> {
    let angle = turn.norm();
    let cross = turn.cross_matrix();
    // (1 - (a/2) cot(a/2)) / a^2, 1/12 at zero.
    let factor = if angle < 1e-3 { 1.0 / 12.0 } else { (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle) };
    Matrix3::identity() - cross * 0.5 + cross * cross * factor
}

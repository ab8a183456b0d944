//! One step of the three-stage Radau IIA method (order 5, L-stable, stiffly accurate) for the lumped model.
//!
//! Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.5. The unknowns are the
//! *accelerations* of the three stages: velocities, positions and the controller's integral follow from them
//! linearly, with A, A^2 and A^3 of the method, so that the closed loop of ten integrated quantities takes one
//! Newton iteration on a 6x6 matrix. The command's limits are part of the equations (semismooth Newton).

use nalgebra::{SMatrix, SVector};

use super::{DomainError, Feedback, Load, Lumped, LumpedState};

const SQRT_6: f64 = 2.449_489_742_783_178;

/// Nodes.
pub(super) const C: [f64; 3] = [(4.0 - SQRT_6) / 10.0, (4.0 + SQRT_6) / 10.0, 1.0];

/// Coefficients: the stages integrate once.
const A: [[f64; 3]; 3] = [
    [(88.0 - 7.0 * SQRT_6) / 360.0, (296.0 - 169.0 * SQRT_6) / 1800.0, (-2.0 + 3.0 * SQRT_6) / 225.0],
    [(296.0 + 169.0 * SQRT_6) / 1800.0, (88.0 + 7.0 * SQRT_6) / 360.0, (-2.0 - 3.0 * SQRT_6) / 225.0],
    [(16.0 - SQRT_6) / 36.0, (16.0 + SQRT_6) / 36.0, 1.0 / 9.0],
];
/// The stages integrate twice.
const A2: [[f64; 3]; 3] = product(&A, &A);
/// The stages integrate three times.
const A3: [[f64; 3]; 3] = product(&A2, &A);

const fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut c = [[0.0; 3]; 3];
    let mut i = 0;
    while i < 9 {
        let (row, column) = (i / 3, i % 3);
        c[row][column] = a[row][0] * b[0][column] + a[row][1] * b[1][column] + a[row][2] * b[2][column];
        i += 1;
    }
    c
}

/// Newton gives up after this many iterations; it needs two or three.
const MAX_ITERATIONS: u32 = 12;
/// Newton's last correction of a rotation, rad, and of an extension, m. The error left is of its square.
const CORRECTION: [f64; 2] = [1e-11, 1e-9];

/// State at the end of a step, and what it took.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) state: LumpedState,
    /// Integral of signal - rotation.
    pub(super) integral: f64,
    /// Lowest and highest command before its limits, over the step's start and stages, Pa.
    pub(super) command: (f64, f64),
    pub(super) iterations: u32,
}

/// Why a step was not possible.
#[derive(Clone, Copy, Debug)]
pub(super) enum Failure {
    Domain(DomainError),
    /// Newton did not converge.
    Divergence,
}

/// Steps `h` seconds from `state` with the signal's values at the start and at the three nodes.
pub(super) fn step(
    model: &Lumped,
    feedback: &Feedback,
    load: Load,
    (state, integral): (&LumpedState, f64),
    signal: [f64; 4],
    h: f64,
) -> Result<Step, Failure> {
    let start = feedback.command(signal[0], state, integral);
    let first = model.tangent(state, feedback.limited(start), load).map_err(Failure::Domain)?;
    let mut acceleration = [first.acceleration; 3];
    let mut saturated = [None; 3];
    for iterations in 1..=MAX_ITERATIONS {
        let mut residual = SVector::<f64, 6>::zeros();
        let mut jacobian = SMatrix::<f64, 6, 6>::identity();
        let mut command = (start, start);
        let mut settled = true;
        for i in 0..3 {
            let (stage, stage_integral) = stage(state, integral, &signal, h, i, &acceleration);
            let wanted = feedback.command(signal[i + 1], &stage, stage_integral);
            let limited = feedback.limited(wanted);
            command = (command.0.min(wanted), command.1.max(wanted));
            let side = (wanted < feedback.low, wanted > feedback.high);
            settled &= saturated[i].replace(side) == Some(side);
            let free = if side == (false, false) { 1.0 } else { 0.0 };
            let tangent = model.tangent(&stage, limited, load).map_err(Failure::Domain)?;
            for row in 0..2 {
                residual[2 * i + row] = acceleration[i][row] - tangent.acceleration[row];
                for j in 0..3 {
                    let (once, twice, thrice) = (h * A[i][j], h * h * A2[i][j], h * h * h * A3[i][j]);
                    jacobian[(2 * i + row, 2 * j)] -= tangent.by_position[row][0] * twice;
                    jacobian[(2 * i + row, 2 * j + 1)] -= tangent.by_position[row][1] * twice;
                    jacobian[(2 * i + row, 2 * j + row)] -= tangent.by_rate[row] * once;
                    jacobian[(2 * i + row, 2 * j + 1)] += free
                        * tangent.by_pressure[row]
                        * (feedback.proportional * twice + feedback.derivative * once + feedback.integral * thrice);
                }
            }
        }
        let correction = jacobian.lu().solve(&residual).ok_or(Failure::Divergence)?;
        let mut largest = 0.0f64;
        for (i, a) in acceleration.iter_mut().enumerate() {
            for row in 0..2 {
                let c = correction[2 * i + row];
                a[row] -= c;
                largest = largest.max((h * h * c).abs() / CORRECTION[row]);
            }
        }
        if !largest.is_finite() {
            return Err(Failure::Divergence);
        }
        // A correction this small leaves an error of its square: the stage values that belong to it are final
        // once the correction has been applied to them too.
        if settled && largest <= 1.0 {
            let (state, integral) = stage(state, integral, &signal, h, 2, &acceleration);
            return Ok(Step { state, integral, command, iterations });
        }
    }
    Err(Failure::Divergence)
}

/// Stage `i`: everything that is integrated from the accelerations.
fn stage(
    start: &LumpedState,
    integral: f64,
    signal: &[f64; 4],
    h: f64,
    i: usize,
    acceleration: &[[f64; 2]; 3],
) -> (LumpedState, f64) {
    let sum = |weights: &[f64; 3], row: usize| -> f64 { (0..3).map(|j| weights[j] * acceleration[j][row]).sum() };
    let t = h * C[i];
    let stage = LumpedState {
        extension: start.extension + t * start.extension_rate + h * h * sum(&A2[i], 0),
        rotation: start.rotation + t * start.rotation_rate + h * h * sum(&A2[i], 1),
        extension_rate: start.extension_rate + h * sum(&A[i], 0),
        rotation_rate: start.rotation_rate + h * sum(&A[i], 1),
    };
    let of_signal: f64 = (0..3).map(|j| h * A[i][j] * signal[j + 1]).sum();
    let of_rotation = t * start.rotation + 0.5 * t * t * start.rotation_rate + h * h * h * sum(&A3[i], 1);
    (stage, integral + of_signal - of_rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tableau_satisfies_the_simplifying_conditions() {
        // C(3): sum_j a_ij c_j^(k-1) = c_i^k / k. B(5): sum_j b_j c_j^(k-1) = 1/k with b the last row.
        for i in 0..3 {
            for k in 1..=3 {
                let sum: f64 = (0..3).map(|j| A[i][j] * C[j].powi(k - 1)).sum();
                assert!((sum - C[i].powi(k) / f64::from(k)).abs() < 1e-15);
            }
        }
        for k in 1..=5 {
            let sum: f64 = (0..3).map(|j| A[2][j] * C[j].powi(k - 1)).sum();
            assert!((sum - 1.0 / f64::from(k)).abs() < 1e-15);
        }
    }
}

//! How far a state is from its end.

use nalgebra::{Matrix6, Vector6};

/// Power of the smooth minimum: seven equal shares make it 22 % smaller than their minimum.
const POWER: i32 = 8;

/// Shares of what there is at rest: 1 at rest, 0 where the state's branch ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// The plate's stiffness in its softest direction; not positive where the state is unstable.
    pub stiffness: f64,
    /// Clearance between the two nearest tubes; none where contact is ignored.
    pub clearance: Option<f64>,
    /// A smooth function of all the shares, never above the least of them.
    pub smooth: f64,
}

impl Margin {
    /// Of a state whose plate's stiffness has these `eigenvalues`, per the least at rest.
    pub(super) fn new(eigenvalues: &Vector6<f64>, clearance: Option<f64>, stable: bool) -> Margin {
        let mut stiffness = eigenvalues.min();
        if !stable {
            stiffness = stiffness.min(0.0);
        }
        let worst = stiffness.min(clearance.unwrap_or(f64::INFINITY));
        if worst <= 0.0 {
            return Margin { stiffness, clearance, smooth: worst };
        }
        // Scaled by the worst so that no power over- or underflows.
        let sum: f64 = eigenvalues.iter().copied().chain(clearance).map(|share| (worst / share).powi(POWER)).sum();
        Margin { stiffness, clearance, smooth: worst * sum.powf(-1.0 / f64::from(POWER)) }
    }

    /// The least of the shares.
    pub fn least(&self) -> f64 {
        self.stiffness.min(self.clearance.unwrap_or(f64::INFINITY))
    }
}

/// Eigenvalues, N m, of the symmetric part of a plate's stiffness, translations measured in `length` m.
pub(super) fn eigenvalues(stiffness: &Matrix6<f64>, length: f64) -> Vector6<f64> {
    let scale = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, length, length, length));
    let scaled = scale * stiffness * scale;
    ((scaled + scaled.transpose()) * 0.5).symmetric_eigenvalues()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smooth_margin_lies_below_the_least_share_and_is_continuous_where_two_cross() {
        let of = |a: f64, b: f64| Margin::new(&Vector6::new(a, b, 2.0, 3.0, 4.0, 5.0), Some(0.9), true);
        for (a, b) in [(0.5, 0.5), (0.1, 0.9), (1e-60, 1.0)] {
            let m = of(a, b);
            assert!(m.smooth <= m.least() && m.smooth > 0.78 * m.least() && m.least() == a, "{m:?}");
        }
        let slope = |at: f64| (of(at + 1e-6, 0.5).smooth - of(at - 1e-6, 0.5).smooth) / 2e-6;
        assert!((slope(0.5 + 1e-4) - slope(0.5 - 1e-4)).abs() < 1e-2, "{} {}", slope(0.5001), slope(0.4999));
        let equal = Margin::new(&Vector6::repeat(1.0), Some(1.0), true);
        assert!((equal.smooth - 7f64.powf(-0.125)).abs() < 1e-12);
    }

    #[test]
    fn an_unstable_state_has_no_margin() {
        let m = Margin::new(&Vector6::new(-0.2, 1.0, 1.0, 1.0, 1.0, 1.0), None, false);
        assert_eq!((m.least(), m.smooth), (-0.2, -0.2));
        // Rods that buckle without moving the plate are not in its stiffness.
        assert_eq!(Margin::new(&Vector6::repeat(1.0), None, false).least(), 0.0);
    }
}

//! Where the end comes to rest.
//!
//! The solution is followed from rest, so that it is the branch which a FREE really takes, as far as it is
//! stable: at a limit point the fibres' grip grows as fast as the springs', and beyond it the FREE runs away.

use nalgebra::{Matrix2, Vector2};
use thiserror::Error;

use super::{DomainError, Load, Lumped, LumpedState};

/// A stable static solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Equilibrium {
    /// Pressure, Pa; negative where only suction would reach the rotation.
    pub pressure: f64,
    /// s, m.
    pub extension: f64,
    /// phi, rad.
    pub rotation: f64,
}

/// Why there is no stable static solution.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum EquilibriumError {
    /// Followed as far as it goes, the equilibrium ends or becomes unstable.
    #[error(
        "no stable equilibrium: the FREE runs away beyond {:.3} psi, {:.2} deg",
        .last.pressure / crate::units::PASCAL_PER_PSI, .last.rotation.to_degrees()
    )]
    RunsAway {
        /// The last stable solution.
        last: Equilibrium,
    },
    /// The state asked for is outside the domain of the kinematics.
    #[error(transparent)]
    Domain(#[from] DomainError),
}

/// Pieces in which the way from rest is covered where nothing is in it.
const PIECES: f64 = 16.0;
/// The way is halved down to this fraction before it counts as ended.
const SHORTEST: f64 = 1e-7;

/// What is given; the other one is sought.
#[derive(Clone, Copy)]
enum Given {
    Pressure(f64),
    Rotation(f64),
}

impl Lumped {
    /// Rotation at rest under `pressure` (Pa), gravity only, rad.
    pub fn static_angle(&self, pressure: f64) -> Result<f64, EquilibriumError> {
        Ok(self.equilibrium_at_pressure(pressure, Load::default())?.rotation)
    }

    /// Pressure (Pa) that holds the rotation `phi` (rad), gravity only. Negative for a rotation against the FREE's
    /// own direction, which no regulator can hold.
    pub fn static_pressure(&self, phi: f64) -> Result<f64, EquilibriumError> {
        Ok(self.equilibrium_at_rotation(phi, Load::default())?.pressure)
    }

    /// The equilibrium under `pressure` (Pa) and `load`.
    pub fn equilibrium_at_pressure(&self, pressure: f64, load: Load) -> Result<Equilibrium, EquilibriumError> {
        if !pressure.is_finite() {
            return Err(DomainError::NotFinite { extension: 0.0, rotation: f64::NAN }.into());
        }
        let start = self.at_no_pressure(load);
        self.follow(start, load, |fraction| Given::Pressure(fraction * pressure))
    }

    /// The equilibrium at rotation `phi` (rad) under `load`.
    pub fn equilibrium_at_rotation(&self, phi: f64, load: Load) -> Result<Equilibrium, EquilibriumError> {
        let start = self.at_no_pressure(load);
        self.actuation(start.extension, phi)?;
        self.follow(start, load, |fraction| Given::Rotation(start.rotation + fraction * (phi - start.rotation)))
    }

    /// Gravity and load on the bare springs.
    fn at_no_pressure(&self, load: Load) -> Equilibrium {
        let free = self.free();
        Equilibrium {
            pressure: 0.0,
            extension: (free.mass * super::GRAVITY + load.force) / free.axial_stiffness,
            rotation: load.moment / free.torsional_stiffness,
        }
    }

    /// Follows the solution from `start` along `way(0..=1)`, in pieces that are halved where it does not go on.
    fn follow(
        &self,
        start: Equilibrium,
        load: Load,
        way: impl Fn(f64) -> Given,
    ) -> Result<Equilibrium, EquilibriumError> {
        let mut at = self.solve(start, load, way(0.0)).ok_or(EquilibriumError::RunsAway { last: start })?;
        let (mut done, mut piece) = (0.0, 1.0 / PIECES);
        while done < 1.0 {
            let next = f64::min(done + piece, 1.0);
            match self.solve(at, load, way(next)) {
                Some(found) => {
                    (at, done) = (found, next);
                    piece = f64::min(2.0 * piece, 1.0 / PIECES);
                }
                None if piece < SHORTEST => return Err(EquilibriumError::RunsAway { last: at }),
                None => piece *= 0.5,
            }
        }
        Ok(at)
    }

    /// The stable solution near `guess`, if Newton finds one there.
    fn solve(&self, guess: Equilibrium, load: Load, given: Given) -> Option<Equilibrium> {
        let mut at = guess;
        for _ in 0..12 {
            match given {
                Given::Pressure(p) => at.pressure = p,
                Given::Rotation(phi) => at.rotation = phi,
            }
            let state = LumpedState { extension: at.extension, rotation: at.rotation, ..LumpedState::default() };
            let tangent = self.tangent(&state, at.pressure, load).ok()?;
            let [[ss, sp], [ps, pp]] = tangent.by_position;
            let residual = Vector2::from(tangent.acceleration);
            let by_second = match given {
                Given::Pressure(_) => Vector2::new(sp, pp),
                Given::Rotation(_) => Vector2::from(tangent.by_pressure),
            };
            let jacobian = Matrix2::from_columns(&[Vector2::new(ss, ps), by_second]);
            let change = jacobian.lu().solve(&residual)?;
            at.extension -= change[0];
            let second = match given {
                Given::Pressure(_) => {
                    at.rotation -= change[1];
                    change[1]
                }
                Given::Rotation(_) => {
                    at.pressure -= change[1];
                    // As a rotation: what the pressure turns against the spring.
                    change[1] * tangent.by_pressure[1] * self.free().inertia / self.free().torsional_stiffness
                }
            };
            // Newton converges quadratically: a last correction of 1e-9 leaves rounding only.
            if change[0].abs() < 1e-11 && second.abs() < 1e-9 {
                // Stable: the matrix of -stiffness/inertia has a negative trace and a positive determinant.
                return (ss + pp < 0.0 && ss * pp - sp * ps > 0.0).then_some(at);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Free, Kinematics, Law};
    use super::*;

    const PSI: f64 = crate::units::PASCAL_PER_PSI;

    fn model(free: Free, kinematics: Kinematics) -> Lumped {
        Lumped::new(free, Law::Nonlinear(kinematics)).unwrap()
    }

    #[test]
    fn nothing_accelerates_and_the_inverse_gives_the_pressure_back() {
        for gamma in [-60f64, -40.0, 35.0, 50.0] {
            for kinematics in [Kinematics::Exact, Kinematics::Published] {
                let free = Free { gamma: gamma.to_radians(), ..Free::paper() };
                let m = model(free, kinematics);
                for psi in [0.5, 2.0, 3.0] {
                    let load = Load { force: 0.2, moment: 0.001 };
                    let e = m.equilibrium_at_pressure(psi * PSI, load).unwrap();
                    let state = LumpedState { extension: e.extension, rotation: e.rotation, ..LumpedState::default() };
                    let [a, b] = m.acceleration(&state, e.pressure, load).unwrap();
                    // The terms are of 1e3 m/s2 and 1e5 rad/s2: rounding.
                    assert!(a.abs() < 1e-9 && b.abs() < 1e-7, "{a} {b}");
                    let back = m.equilibrium_at_rotation(e.rotation, load).unwrap();
                    assert!((back.pressure - e.pressure).abs() < 1e-6 && (back.extension - e.extension).abs() < 1e-12);
                    assert!(m.static_angle(psi * PSI).unwrap() * free.direction() > 0.0);
                }
            }
        }
    }

    #[test]
    fn the_linear_law_is_solved_by_hand() {
        let free = Free::paper();
        let m = Lumped::new(free, Law::Linear).unwrap();
        let a = 2.0 * std::f64::consts::PI * free.radius.powi(3) / 40f64.to_radians().tan();
        assert!((m.static_angle(3e4).unwrap() - a * 3e4 / free.torsional_stiffness).abs() < 1e-12);
        assert!((m.static_pressure(-0.5).unwrap() + 0.5 * free.torsional_stiffness / a).abs() < 1e-6);
    }

    #[test]
    fn beyond_the_limit_point_the_run_away_is_named_with_its_pressure() {
        // 30 deg at 6 psi: the radius grows faster than kt holds.
        let m = model(Free { gamma: -30f64.to_radians(), ..Free::paper() }, Kinematics::Exact);
        let Err(EquilibriumError::RunsAway { last }) = m.equilibrium_at_pressure(6.0 * PSI, Load::default()) else {
            panic!("30 deg at 6 psi has no equilibrium");
        };
        assert!(last.pressure < 6.0 * PSI && last.rotation > 0.0, "{last:?}");
        // The limit is a property of the FREE, not of how it is approached; a halved way of 1e-7 finds it that well.
        let Err(EquilibriumError::RunsAway { last: again }) = m.equilibrium_at_pressure(9.0 * PSI, Load::default())
        else {
            panic!("nor at 9 psi");
        };
        assert!((last.pressure / again.pressure - 1.0).abs() < 1e-6);
        assert!(m.static_angle(0.999 * last.pressure).is_ok());
        // The unstable branch beyond is not offered either, although the statics would be solved there.
        assert!(matches!(m.static_pressure(1.2 * last.rotation), Err(EquilibriumError::RunsAway { .. })));
        assert!(m.static_pressure(0.99 * last.rotation).is_ok());
    }

    #[test]
    fn outside_the_domain_is_an_error_by_name() {
        let m = model(Free::paper(), Kinematics::Exact);
        assert!(matches!(m.static_pressure(20.0), Err(EquilibriumError::Domain(DomainError::Unwound { .. }))));
        assert!(matches!(m.static_angle(f64::NAN), Err(EquilibriumError::Domain(DomainError::NotFinite { .. }))));
    }
}

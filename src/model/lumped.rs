//! Eqs 3-4: the equations of motion and their tangent.

use super::{Actuation, DomainError, Free, FreeError, Kinematics};

/// Acceleration of gravity, m/s2, as in the paper's model. The tip hangs: it pulls along +z.
pub const GRAVITY: f64 = 9.81;

/// How the pressure acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// As in the rest position: radius and winding angle do not change.
    Linear,
    /// On the fibres as they lie now.
    Nonlinear(Kinematics),
}

/// Motion of the end. At rest everything is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LumpedState {
    /// s, m.
    pub extension: f64,
    /// phi, rad.
    pub rotation: f64,
    /// s', m/s.
    pub extension_rate: f64,
    /// phi', rad/s.
    pub rotation_rate: f64,
}

/// What acts on the end beside pressure and gravity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Along +z, N.
    pub force: f64,
    /// About +z, N m.
    pub moment: f64,
}

/// Accelerations and their derivatives at one state, pressure and load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tangent {
    /// (s'', phi''), m/s2 and rad/s2.
    pub acceleration: [f64; 2],
    /// By (s, phi): `by_position[i][j]` is the derivative of acceleration i by coordinate j.
    pub by_position: [[f64; 2]; 2],
    /// Each by its own rate (dampers do not couple), 1/s.
    pub by_rate: [f64; 2],
    /// By the pressure, per Pa.
    pub by_pressure: [f64; 2],
}

/// The lumped model of one FREE.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lumped {
    free: Free,
    law: Law,
    rest: Actuation,
}

impl Lumped {
    /// The model of `free`, whose parameters are checked.
    pub fn new(free: Free, law: Law) -> Result<Self, FreeError> {
        free.validate()?;
        let Free { gamma, radius, .. } = free;
        let cot = 1.0 / gamma.tan();
        let area = std::f64::consts::PI * radius * radius;
        let rest = Actuation {
            radius,
            winding: gamma,
            force: area * (1.0 - 2.0 * cot * cot),
            moment: -2.0 * area * radius * cot,
            force_by: [0.0; 2],
            moment_by: [0.0; 2],
        };
        Ok(Self { free, law, rest })
    }

    /// Its parameters.
    pub fn free(&self) -> &Free {
        &self.free
    }

    /// How the pressure acts.
    pub fn law(&self) -> Law {
        self.law
    }

    /// What one pascal does at extension `s` (m) and rotation `phi` (rad); in the linear law, what it does at rest.
    pub fn actuation(&self, s: f64, phi: f64) -> Result<Actuation, DomainError> {
        match self.law {
            Law::Nonlinear(kinematics) => kinematics.actuation(&self.free, s, phi),
            Law::Linear if s.is_finite() && phi.is_finite() => Ok(self.rest),
            Law::Linear => Err(DomainError::NotFinite { extension: s, rotation: phi }),
        }
    }

    /// Accelerations (s'', phi''), m/s2 and rad/s2, under `pressure` (Pa).
    pub fn acceleration(&self, state: &LumpedState, pressure: f64, load: Load) -> Result<[f64; 2], DomainError> {
        Ok(self.tangent(state, pressure, load)?.acceleration)
    }

    /// Accelerations under `pressure` (Pa) with their derivatives.
    pub fn tangent(&self, state: &LumpedState, pressure: f64, load: Load) -> Result<Tangent, DomainError> {
        let f = &self.free;
        let act = self.actuation(state.extension, state.rotation)?;
        let force = f.mass * GRAVITY + load.force
            - f.axial_stiffness * state.extension
            - f.axial_damping * state.extension_rate
            + act.force * pressure;
        let moment = load.moment - f.torsional_stiffness * state.rotation - f.torsional_damping * state.rotation_rate
            + act.moment * pressure;
        Ok(Tangent {
            acceleration: [force / f.mass, moment / f.inertia],
            by_position: [
                [(act.force_by[0] * pressure - f.axial_stiffness) / f.mass, act.force_by[1] * pressure / f.mass],
                [
                    act.moment_by[0] * pressure / f.inertia,
                    (act.moment_by[1] * pressure - f.torsional_stiffness) / f.inertia,
                ],
            ],
            by_rate: [-f.axial_damping / f.mass, -f.torsional_damping / f.inertia],
            by_pressure: [act.force / f.mass, act.moment / f.inertia],
        })
    }

    /// The rotation's transfer function at rest (Eq. 7).
    pub fn linearised(&self) -> Linearised {
        Linearised {
            moment: self.rest.moment.abs(),
            inertia: self.free.inertia,
            damping: self.free.torsional_damping,
            stiffness: self.free.torsional_stiffness,
        }
    }
}

/// The rotation at rest, in the FREE's own direction: I phi'' + ct phi' + kt phi = a P.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearised {
    /// a = |2 pi R^3 cot G|, N m/Pa (Eq. 7: -2 pi R^3 cot G, positive for G < 0).
    pub moment: f64,
    /// I, kg m2.
    pub inertia: f64,
    /// ct, N m s/rad.
    pub damping: f64,
    /// kt, N m/rad.
    pub stiffness: f64,
}

/// Eq. 6: B phi'' + C phi' + E phi + F int phi dt = D phi_d + F int phi_d dt + M.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopCoefficients {
    /// B = I.
    pub b: f64,
    /// C = a Kd + ct.
    pub c: f64,
    /// D = a Kp.
    pub d: f64,
    /// E = D + kt.
    pub e: f64,
    /// F = a Ki.
    pub f: f64,
}

impl Linearised {
    /// The closed loop with gains Kp (Pa/rad), Ki (Pa/(rad s)), Kd (Pa s/rad), positive in the FREE's own direction.
    pub fn closed_loop(&self, kp: f64, ki: f64, kd: f64) -> LoopCoefficients {
        let d = self.moment * kp;
        LoopCoefficients {
            b: self.inertia,
            c: self.moment * kd + self.damping,
            d,
            e: d + self.stiffness,
            f: self.moment * ki,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAWS: [Law; 3] = [Law::Linear, Law::Nonlinear(Kinematics::Exact), Law::Nonlinear(Kinematics::Published)];

    #[test]
    fn the_tangent_is_the_derivative_of_the_accelerations() {
        let load = Load { force: 0.3, moment: -0.01 };
        for free in [Free::paper(), Free { gamma: 0.9, ..Free::published_code() }] {
            for law in LAWS {
                let model = Lumped::new(free, law).unwrap();
                let y = [-4e-4, 0.9 * free.direction(), 0.02, -3.0];
                let at = |y: [f64; 4], p| {
                    let [extension, rotation, extension_rate, rotation_rate] = y;
                    let state = LumpedState { extension, rotation, extension_rate, rotation_rate };
                    model.tangent(&state, p, load).unwrap()
                };
                let tangent = at(y, 3e4);
                for column in 0..5 {
                    let step = [1e-7, 1e-5, 1e-4, 1e-3, 1.0][column];
                    let moved = |sign: f64| {
                        let mut y = y;
                        if column < 4 {
                            y[column] += sign * step;
                        }
                        at(y, 3e4 + if column == 4 { sign * step } else { 0.0 }).acceleration
                    };
                    let (up, down) = (moved(1.0), moved(-1.0));
                    for row in 0..2 {
                        let exact = match column {
                            0 | 1 => tangent.by_position[row][column],
                            2 | 3 if column - 2 == row => tangent.by_rate[row],
                            2 | 3 => 0.0,
                            _ => tangent.by_pressure[row],
                        };
                        let difference = (up[row] - down[row]) / (2.0 * step);
                        // Rounding: the accelerations' digits (1e-16 of up to 1e5) over the step.
                        let tolerance = 1e-6 * exact.abs() + 1e-10 / step;
                        assert!((exact - difference).abs() < tolerance, "{law:?} {row} {column} {exact} {difference}");
                    }
                }
            }
        }
    }

    #[test]
    fn the_linear_law_is_the_nonlinear_one_at_rest() {
        let state = LumpedState::default();
        let at = |law| Lumped::new(Free::paper(), law).unwrap().acceleration(&state, 2e4, Load::default()).unwrap();
        for law in LAWS {
            for (a, b) in at(law).into_iter().zip(at(Law::Linear)) {
                assert!((a - b).abs() < 1e-12 * b.abs());
            }
        }
    }

    #[test]
    fn the_closed_loop_has_the_coefficients_of_eq_7() {
        let model = Lumped::new(Free::paper(), Law::Linear).unwrap();
        let k = model.linearised().closed_loop(32000.0, 1.2e6, 7.0);
        let a = 2.0 * std::f64::consts::PI * 0.007f64.powi(3) / 40f64.to_radians().tan();
        for (got, expected) in [
            (k.b, 0.028 * 0.007 * 0.007),
            (k.c, a * 7.0 + 0.005),
            (k.d, a * 32000.0),
            (k.e, a * 32000.0 + 0.086),
            (k.f, a * 1.2e6),
        ] {
            assert!((got / expected - 1.0).abs() < 1e-12);
        }
        let right = Lumped::new(Free { gamma: -Free::paper().gamma, ..Free::paper() }, Law::Linear).unwrap();
        assert_eq!(right.linearised(), model.linearised(), "gains are positive in the FREE's own direction");
    }
}

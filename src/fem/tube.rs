//! The tube of one FREE as the finite elements see it: geometry, fibres, rubber.

use std::f64::consts::PI;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use thiserror::Error;

use super::material::{Law, MaterialError};

/// What is no tube that can be computed. Each message names the value, the rule and, where there is one, the way out.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TubeError {
    /// Inner radius not positive.
    #[error("inner radius {0} m: must be positive and finite")]
    InnerRadius(f64),
    /// Wall out of 0.005 to 2 inner radii.
    #[error("wall {wall} m at inner radius {inner_radius} m: must be between 0.005 and 2 inner radii")]
    Wall {
        /// Wall thickness, m.
        wall: f64,
        /// Inner radius, m.
        inner_radius: f64,
    },
    /// Winding angle out of 0.1 to 89.9 deg.
    #[error("winding angle {0} rad: its magnitude must be between 0.1 and 89.9 deg")]
    Gamma(f64),
    /// Fewer than 2 or more than 96 fibres.
    #[error(
        "{0} fibers: must be 2 to 96 (one fibre bends the tube into a helix, which a straight section cannot show)"
    )]
    Fibers(usize),
    /// Fibre stiffness negative or not finite.
    #[error("fibre stiffness EA {0} N: must be finite and not negative")]
    FiberStiffness(f64),
    /// Fibre width negative, or wider than the fibre's share of the circumference.
    #[error("fibre width {width} m: must be between 0 and the fibre's share of the circumference, {share} m")]
    FiberWidth {
        /// Arc along the circumference, m.
        width: f64,
        /// 2 pi Ro / n, m.
        share: f64,
    },
    /// The rubber's law is refused.
    #[error(transparent)]
    Material(#[from] MaterialError),
}

/// A fibre-reinforced tube at rest. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tube {
    /// Inner radius Ri, m.
    pub inner_radius: f64,
    /// Wall thickness Ro - Ri, m.
    pub wall: f64,
    /// Winding angle from the axis, rad, signed (R positive), 0.1 to 89.9 deg.
    pub gamma: f64,
    /// Number of fibres n, evenly spaced, one family.
    pub fibers: usize,
    /// Stiffness EA of one fibre, N per unit strain, in tension and compression.
    pub fiber_ea: f64,
    /// Arc of the circumference that one fibre covers at rest, m; 0 is a line, whose answers depend on the mesh.
    pub fiber_width: f64,
    /// The rubber, incompressible; moduli in Pa.
    pub law: Law,
}

impl Tube {
    /// The reference FREE of the finite-element part (physics: Ri 4.76 mm, wall 0.8 mm, six fibres of 644 N and
    /// 0.4 mm, mu 0.393 MPa, alpha 1.2) at the winding angle `gamma`, rad.
    pub fn reference(gamma: f64) -> Tube {
        Tube {
            inner_radius: 4.76e-3,
            wall: 0.8e-3,
            gamma,
            fibers: 6,
            fiber_ea: 644.0,
            fiber_width: 0.4e-3,
            law: Law::Ogden { mu: 0.393e6, alpha: 1.2 },
        }
    }

    /// A tube of the study `seed`: inner radius 3 to 8 mm, wall a tenth to a third of it, 20 to 80 deg of either hand,
    /// 3 to 12 fibres of 200 to 2000 N that cover 3 to 30 % of the circumference, mu 0.2 to 0.8 MPa, alpha 0.8 to 3.
    pub fn seeded(seed: u64) -> Tube {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let inner_radius = rng.random_range(3e-3..8e-3);
        let wall = inner_radius * rng.random_range(0.1..0.33);
        let hand = if rng.random() { 1.0 } else { -1.0 };
        let fibers = rng.random_range(3..=12);
        let share = 2.0 * PI * (inner_radius + wall) / fibers as f64;
        Tube {
            inner_radius,
            wall,
            gamma: hand * rng.random_range(20_f64..80.0).to_radians(),
            fibers,
            fiber_ea: rng.random_range(200.0..2000.0),
            fiber_width: share * rng.random_range(0.03..0.3),
            law: Law::Ogden { mu: rng.random_range(0.2e6..0.8e6), alpha: rng.random_range(0.8..3.0) },
        }
    }

    /// A pressure at which the tube is strained well but below its limits, `0.4 mu wall / Ri`, Pa: 3.8 psi of the
    /// reference FREE, whose free limits lie between 7 and 9 psi.
    pub fn moderate_pressure(&self) -> f64 {
        0.4 * self.law.shear_modulus() * self.wall / self.inner_radius
    }

    /// Checks every field; the first problem is the error.
    pub fn validated(self) -> Result<Tube, TubeError> {
        if !(self.inner_radius.is_finite() && self.inner_radius > 0.0) {
            return Err(TubeError::InnerRadius(self.inner_radius));
        }
        if !(self.wall >= 0.005 * self.inner_radius && self.wall <= 2.0 * self.inner_radius) {
            return Err(TubeError::Wall { wall: self.wall, inner_radius: self.inner_radius });
        }
        let degrees = self.gamma.to_degrees().abs();
        if !(0.1..=89.9).contains(&degrees) {
            return Err(TubeError::Gamma(self.gamma));
        }
        if !(2..=96).contains(&self.fibers) {
            return Err(TubeError::Fibers(self.fibers));
        }
        if !(self.fiber_ea.is_finite() && self.fiber_ea >= 0.0) {
            return Err(TubeError::FiberStiffness(self.fiber_ea));
        }
        let share = 2.0 * PI * self.outer_radius() / self.fibers as f64;
        if !(self.fiber_width >= 0.0 && self.fiber_width <= share) {
            return Err(TubeError::FiberWidth { width: self.fiber_width, share });
        }
        match self.law {
            Law::Ogden { mu, alpha } => Law::ogden(mu, alpha)?,
            Law::NeoHookean { mu } => Law::neo_hookean(mu)?,
            Law::Linear { mu } => Law::linear(mu)?,
        };
        Ok(self)
    }

    /// Outer radius Ro, where the fibres lie, m.
    pub fn outer_radius(&self) -> f64 {
        self.inner_radius + self.wall
    }
}

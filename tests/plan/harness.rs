//! The modules that plans are tested on, with the closed-form section law.

use freerig::fem::linear::LinearSection;
use freerig::fem::module::{Module, Mount, square};
use freerig::fem::rod::{Law, Profile, Resolution, Rod, Straight};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector2;

pub const LENGTH: f64 = 0.13;

/// Layout RLRL at 20 mm without a plate's mass; EI at 0, 3.5 and 7 psi as in the reference values.
pub fn module(gamma_deg: f64) -> Module {
    let ei = if gamma_deg == 30.0 { [673.0, 909.0, 1854.0] } else { [416.0, 476.0, 551.0] };
    let section = LinearSection::new(&Tube::reference(gamma_deg.to_radians())).unwrap();
    let mounts = square(0.02).into_iter().enumerate().map(|(i, base)| {
        let law = Law {
            straight: Straight::closed_form(&section),
            bending: Profile::through([(0.0, ei[0] * 1e-6), (3.5 * PSI, ei[1] * 1e-6), (7.0 * PSI, ei[2] * 1e-6)]),
            shear: Profile::constant(1e4),
            coupling: Profile::constant(0.0),
            mirrored: i % 2 == 1,
        };
        let rod = Rod { length: LENGTH, law, rest_curvature: Vector2::zeros(), outer_radius: 5.56e-3 };
        Mount { base, rod }
    });
    Module::new(mounts.collect(), 0.0, Resolution::DEFAULT).unwrap()
}

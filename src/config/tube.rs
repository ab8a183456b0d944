//! The tube that the finite elements see, from a calibration.

use super::calibration::{Calibration, Key, keys};
use crate::fem::material::Law;
use crate::fem::tube::Tube;

impl Calibration {
    /// The tube, and the keys that the calibration does not hold: those are taken from the reference FREE
    /// ([`Tube::reference`]), except for the inner diameter, which then follows from the fibres' radius and the wall.
    pub fn tube(&self) -> (Tube, Vec<&'static str>) {
        let free = self.free();
        // The lumped model's own angle is none of the tube's.
        let gamma = self.value(&keys::WINDING_ANGLE).unwrap_or(free.gamma);
        let reference = Tube::reference(gamma);
        let (mu, alpha) = match reference.law {
            Law::Ogden { mu, alpha } => (mu, alpha),
            Law::NeoHookean { mu } => (mu, 2.0),
            Law::Linear { mu } => (mu, 0.0),
        };
        let mut assumed = Vec::new();
        let mut value = |key: &Key, otherwise: f64| {
            self.value(key).unwrap_or_else(|| {
                assumed.push(key.name);
                otherwise
            })
        };
        let wall = value(&keys::WALL, reference.wall);
        let tube = Tube {
            inner_radius: 0.5 * value(&keys::INNER_DIAMETER, 2.0 * (free.radius - wall)),
            wall,
            gamma,
            fibers: value(&keys::FIBERS, reference.fibers as f64).round() as usize,
            fiber_ea: value(&keys::FIBER_STIFFNESS, reference.fiber_ea),
            fiber_width: value(&keys::FIBER_WIDTH, reference.fiber_width),
            law: Law::Ogden { mu: value(&keys::SHEAR_MODULUS, mu), alpha: value(&keys::OGDEN_EXPONENT, alpha) },
        };
        (tube, assumed)
    }
}

#[cfg(test)]
mod tests {
    use super::super::calibration::Entry;
    use super::*;

    #[test]
    fn what_the_calibration_lacks_is_named_and_the_fibres_stay_at_their_radius() {
        let mut calibration = Calibration::default();
        let mut set = |key: &Key, value| calibration.set(key, Entry { value, ..Entry::default() });
        set(&keys::WINDING_ANGLE, -40.0);
        set(&keys::FIBER_RADIUS, 7.0);
        set(&keys::SHEAR_MODULUS, 0.5);
        let (tube, assumed) = calibration.tube();
        assert!((tube.outer_radius() - 7e-3).abs() < 1e-15 && tube.wall == 0.8e-3);
        assert_eq!(tube.law, Law::Ogden { mu: 0.5e6, alpha: 1.2 });
        assert!(assumed.contains(&"inner_diameter_mm") && !assumed.contains(&"shear_modulus_mpa"));
        calibration.set(&keys::INNER_DIAMETER, Entry { value: 9.52, ..Entry::default() });
        assert!((calibration.tube().0.inner_radius - 4.76e-3).abs() < 1e-15);
    }
}

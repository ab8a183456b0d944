//! The tube of a FREE in a run's start document, and what finite elements make of it at rest.

use serde::{Deserialize, Serialize};

use crate::fem::ends::Ends;
use crate::fem::material::Law;
use crate::fem::section::{Mesh, Section};
use crate::fem::tube::Tube;

/// A tube, as [`Tube`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TubeDocument {
    pub inner_radius_m: f64,
    pub wall_m: f64,
    pub gamma_rad: f64,
    pub fibers: usize,
    pub fiber_ea_n: f64,
    pub fiber_width_m: f64,
    pub shear_modulus_pa: f64,
    /// 2 is neo-Hookean.
    pub ogden_exponent: f64,
}

impl TubeDocument {
    /// The document of `tube`; `None` of one whose rubber is not of Ogden's law.
    pub fn of(tube: &Tube) -> Option<TubeDocument> {
        let (shear_modulus_pa, ogden_exponent) = match tube.law {
            Law::Ogden { mu, alpha } => (mu, alpha),
            Law::NeoHookean { mu } => (mu, 2.0),
            Law::Linear { .. } => return None,
        };
        Some(TubeDocument {
            inner_radius_m: tube.inner_radius,
            wall_m: tube.wall,
            gamma_rad: tube.gamma,
            fibers: tube.fibers,
            fiber_ea_n: tube.fiber_ea,
            fiber_width_m: tube.fiber_width,
            shear_modulus_pa,
            ogden_exponent,
        })
    }

    /// The tube.
    pub fn tube(&self) -> Tube {
        Tube {
            inner_radius: self.inner_radius_m,
            wall: self.wall_m,
            gamma: self.gamma_rad,
            fibers: self.fibers,
            fiber_ea: self.fiber_ea_n,
            fiber_width: self.fiber_width_m,
            law: Law::Ogden { mu: self.shear_modulus_pa, alpha: self.ogden_exponent },
        }
    }

    /// Twist of the long free tube by the section at equally spaced pressures from 0 to `highest` (Pa): (pressure,
    /// twist), Pa and rad/m, as far as there is an equilibrium.
    pub fn free_twist(&self, highest: f64) -> (Vec<f64>, Vec<f64>) {
        const POINTS: usize = 24;
        let pressures: Vec<f64> = (0..=POINTS).map(|i| highest * i as f64 / POINTS as f64).collect();
        let points =
            Section::new(&self.tube(), Mesh::default()).and_then(|section| section.curve(&pressures, Ends::FREE));
        points.unwrap_or_default().into_iter().map_while(Result::ok).map(|rest| (rest.pressure, rest.twist)).unzip()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_keeps_the_tube_and_its_curve_ends_at_the_limit() {
        let tube = Tube::reference(-40f64.to_radians());
        let document = TubeDocument::of(&tube).unwrap();
        let (pressure, twist) = document.free_twist(7e4);
        // The free reference FREE of 40 deg has its pressure maximum at 8.24 psi.
        assert!(*pressure.last().unwrap() < 8.3 * crate::units::PASCAL_PER_PSI && pressure.len() > 15);
        assert!(twist[0].abs() < 1e-9 && twist.windows(2).all(|w| w[1] > w[0]), "an L FREE turns positive");
    }
}

//! The springs that the finite elements give the lumped model (`--from fem`).
//!
//! At small pressure a straight FREE is a 2 x 2 section stiffness K (axial strain e, twist tau) and its actuation
//! `f = -d2 Pi / (dx dP)`. The lumped model (Eqs 3-4) has two springs that do not know each other, and an actuation
//! with inextensible fibres. Its `ke = K11 / L` is the axial stiffness at held twist; its kt is the one that turns a
//! free FREE by as much as the section at small pressure: `kt = -2 pi Ro^3 cot G / (L dtau/dP)`. What is lost, the
//! coupling `K12^2 / (K11 K22)`, is told beside them.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2};

use super::ends::Equilibrium;
use super::linear::LinearSection;
use super::section::{Mesh, Section, SectionError};
use super::tube::{Tube, TubeError};

/// The lumped stiffnesses of a FREE of finite length, and what they cannot hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LumpedStiffness {
    /// ke = K11 / L, N/m.
    pub axial: f64,
    /// kt such that the linear lumped model's free rotation equals the section's at small pressure, N m/rad.
    pub torsional: f64,
    /// K12^2 / (K11 K22), 0 to 1: the coupling of stretch and twist that the lumped model has no place for.
    pub lost_coupling: f64,
}

impl LumpedStiffness {
    /// By the section with its discrete fibres: some milliseconds. `length` in m.
    ///
    /// # Errors
    /// As the section's.
    pub fn by_section(tube: &Tube, length: f64) -> Result<LumpedStiffness, SectionError> {
        let section = Section::new(tube, Mesh::default())?;
        Ok(Self::at_rest(&section.equilibrium(&section.rest()?), tube, length))
    }

    /// By the closed form, where the fibres are smeared. `length` in m.
    ///
    /// # Errors
    /// As the closed form's.
    pub fn by_closed_form(tube: &Tube, length: f64) -> Result<LumpedStiffness, TubeError> {
        let law = LinearSection::new(tube)?;
        Ok(Self::at_rest(&law.solve(0.0, super::ends::Ends::FREE), tube, length))
    }

    fn at_rest(rest: &Equilibrium, tube: &Tube, length: f64) -> LumpedStiffness {
        let k: Matrix2<f64> = rest.tangent.fixed_view::<2, 2>(0, 0).into_owned();
        let actuation = -Vector2::new(rest.tangent[(0, 2)], rest.tangent[(1, 2)]);
        // Cramer's rule: dtau/dP of the free FREE.
        let twist = (k[(0, 0)] * actuation.y - k[(1, 0)] * actuation.x) / k.determinant();
        LumpedStiffness {
            axial: k[(0, 0)] / length,
            torsional: -2.0 * PI * tube.outer_radius().powi(3) / tube.gamma.tan() / (twist * length),
            lost_coupling: k[(0, 1)].powi(2) / (k[(0, 0)] * k[(1, 1)]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::ends::Ends;

    const LENGTH: f64 = 0.13;

    fn turn(springs: &LumpedStiffness, tube: &Tube, pressure: f64) -> f64 {
        -2.0 * PI * tube.outer_radius().powi(3) * pressure / tube.gamma.tan() / springs.torsional / LENGTH
    }

    #[test]
    fn the_closed_forms_springs_reproduce_its_free_rotation() {
        let tube = Tube::reference(40f64.to_radians());
        let springs = LumpedStiffness::by_closed_form(&tube, LENGTH).unwrap();
        let free = LinearSection::new(&tube).unwrap().solve(1e4, Ends::FREE);
        assert!((turn(&springs, &tube, 1e4) / free.twist - 1.0).abs() < 1e-12);
        // ke 0.6-0.9 kN/m from the material (40 deg, 110 to 130 mm: 0.58 to 0.68).
        assert!((550.0..900.0).contains(&springs.axial), "{}", springs.axial);
        assert!(springs.torsional > 0.0 && (0.52..0.54).contains(&springs.lost_coupling));
    }

    #[test]
    fn the_sections_springs_reproduce_its_free_rotation_at_small_pressure_and_are_mirrored_with_the_fibres() {
        for degrees in [20.0, -40.0, 60.0, 80.0_f64] {
            let tube = Tube::reference(degrees.to_radians());
            let springs = LumpedStiffness::by_section(&tube, LENGTH).unwrap();
            let section = Section::new(&tube, Mesh::default()).unwrap();
            // The error is of first order in the pressure; twists of both signs of it leave the second.
            let pressure = 10.0;
            let [up, down] = [pressure, -pressure].map(|p| section.solve(p, Ends::FREE).unwrap().twist);
            let ratio = turn(&springs, &tube, pressure) / (0.5 * (up - down));
            assert!((ratio - 1.0).abs() < 1e-5, "{degrees}: {ratio}");
            let mirrored = LumpedStiffness::by_section(&Tube { gamma: -tube.gamma, ..tube }, LENGTH).unwrap();
            assert!((mirrored.torsional / springs.torsional - 1.0).abs() < 1e-9);
            assert!((mirrored.axial / springs.axial - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_finer_mesh_hardly_moves_the_sections_springs() {
        let tube = Tube::reference(40f64.to_radians());
        let springs = LumpedStiffness::by_section(&tube, LENGTH).unwrap();
        let section = Section::new(&tube, Mesh::level(3)).unwrap();
        let finer = LumpedStiffness::at_rest(&section.equilibrium(&section.rest().unwrap()), &tube, LENGTH);
        // What the section is held to: twist 0.2 %; the axial stiffness at held twist is a blocked quantity: 1 %.
        assert!((springs.torsional / finer.torsional - 1.0).abs() < 2e-3);
        assert!((springs.axial / finer.axial - 1.0).abs() < 1e-2);
    }
}

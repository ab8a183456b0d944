//! What a rod is made of: one potential of its strains and its pressure, per reference length.
//!
//! ```text
//!     psi = psi0(lam, tau; P) + EI |kappa|^2 / 2 + GA |gamma + q kappa|^2 / 2
//! ```
//!
//! with EI, GA and q of (lam, tau, P), too: a tube that is held from turning bends more easily than one that is free.
//! EI is that of bending by a moment alone, in which the shear strain is -q kappa; `C = GA q` couples the two.
//!
//! psi0 is the energy of the straight section less `P V`, minimised over the section's own fields, so its derivatives
//! are the *total* force and moment: pressure acts through the potential and nowhere else, with no lateral load and no
//! thrust on a cap. All derivatives are taken of this one function: the tangent is symmetric and energy is conserved.

use std::sync::Arc;

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use thiserror::Error;

use super::profile::{Isobaric, Profile};
use super::table::{Slice, Table};
use crate::fem::linear::LinearSection;
use crate::units::PASCAL_PER_PSI;

/// Where a law refuses to answer.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LawError {
    /// The state is not in the tabulated domain of accepted, stable sections.
    #[error(
        "stretch {stretch:.4}, twist {twist:.2} rad/m at {:.2} psi lie outside the tabulated section law: \
         lower the pressure or the load",
        pressure / PASCAL_PER_PSI
    )]
    OutsideTable {
        /// Axial stretch.
        stretch: f64,
        /// Twist, rad per reference metre.
        twist: f64,
        /// Gauge pressure, Pa.
        pressure: f64,
    },
    /// A linear law was strained to stretch zero or below, or the strain is not finite.
    #[error("axial stretch {0}: the rod is squeezed to nothing; the load is far beyond what the law describes")]
    Stretch(f64),
    /// Bending and shear are no positive definite form.
    #[error(
        "at stretch {stretch:.4}, twist {twist:.2} rad/m and {pressure:.0} Pa bending stiffness {bending} N m2 and shear \
         stiffness {shear} N: both must be positive"
    )]
    Bending {
        /// Axial stretch.
        stretch: f64,
        /// Twist, rad per reference metre.
        twist: f64,
        /// Gauge pressure, Pa.
        pressure: f64,
        /// EI, N m2.
        bending: f64,
        /// GA, N.
        shear: f64,
    },
}

/// Value and derivatives of psi0 by (stretch, twist, pressure).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    /// psi0, N (J per reference metre).
    pub value: f64,
    /// (N, M, -V): axial force N, moment N m, minus the cavity's volume per reference length m2.
    pub gradient: Vector3<f64>,
    /// The symmetric second derivatives.
    pub hessian: Matrix3<f64>,
}

/// psi0, the straight section.
#[derive(Clone, Debug)]
pub enum Straight {
    /// `x.K x / 2 - P a.x - P V0 - P^2 c / 2` of x = (stretch - 1, twist).
    Linear {
        /// K: N, N m, N m2.
        stiffness: Matrix2<f64>,
        /// a: force and moment per pressure that a blocked section exerts, m2, m3.
        actuation: Vector2<f64>,
        /// V0, m2.
        volume: f64,
        /// c = dV/dP at fixed x, m2/Pa.
        compliance: f64,
    },
    /// Interpolated.
    Table(Arc<Table>),
}

/// The law of a rod.
#[derive(Clone, Debug)]
pub struct Law {
    /// psi0.
    pub straight: Straight,
    /// EI, N m2, of curvature per reference length, where the shear strain follows freely.
    pub bending: Profile,
    /// GA, N, of shear per reference length. A rod that cannot shear is one with a large GA: shear strains are
    /// unknowns of their own, so nothing locks.
    pub shear: Profile,
    /// q, m: minus the shear strain per curvature where only a moment bends.
    pub coupling: Profile,
    /// The mirror image (other handedness): everything at -tau, and -q.
    pub mirrored: bool,
}

/// A law at one pressure.
#[derive(Clone, Debug)]
pub(crate) struct Isobar<'a> {
    law: &'a Law,
    pressure: f64,
    /// Of a table.
    slice: Option<Slice<'a>>,
    /// EI, GA, q.
    lateral: [Isobaric<'a>; 3],
}

impl Jet {
    /// That of the mirror image, whose twist is the opposite.
    fn mirrored(mut self) -> Jet {
        self.gradient.y = -self.gradient.y;
        for other in [0, 2] {
            self.hessian[(1, other)] = -self.hessian[(1, other)];
            self.hessian[(other, 1)] = -self.hessian[(other, 1)];
        }
        self
    }
}

impl Straight {
    /// The closed-form section law of a tube.
    pub fn closed_form(section: &LinearSection) -> Straight {
        let rest = section.solve(0.0, crate::fem::ends::Ends::BLOCKED);
        Straight::Linear {
            stiffness: section.stiffness,
            actuation: section.actuation,
            volume: rest.volume,
            compliance: -rest.tangent[(2, 2)],
        }
    }

    /// An elastic rod whose rest state moves with its "pressure" p, a plain load factor here: p `extension` is its
    /// spontaneous strain and p `twist` its spontaneous twist (rad/m). EA in N, GJ in N m2.
    pub fn spontaneous(ea: f64, gj: f64, extension: f64, twist: f64) -> Straight {
        let stiffness = Matrix2::new(ea, 0.0, 0.0, gj);
        let rest = Vector2::new(extension, twist);
        let actuation = stiffness * rest;
        // (x - p rest) . K (x - p rest) / 2
        Straight::Linear { stiffness, actuation, volume: 0.0, compliance: -actuation.dot(&rest) }
    }

    fn jet(&self, stretch: f64, twist: f64, pressure: f64) -> Result<Jet, LawError> {
        match self {
            Straight::Linear { stiffness, actuation, volume, compliance } => {
                if !(stretch > 0.0 && stretch.is_finite() && twist.is_finite()) {
                    return Err(LawError::Stretch(stretch));
                }
                let x = Vector2::new(stretch - 1.0, twist);
                let kx = stiffness * x;
                let push = actuation.dot(&x);
                let force = kx - actuation * pressure;
                let v = volume + push + compliance * pressure;
                let a = -actuation;
                let k = stiffness;
                Ok(Jet {
                    value: 0.5 * x.dot(&kx) - pressure * (push + volume + 0.5 * compliance * pressure),
                    gradient: Vector3::new(force.x, force.y, -v),
                    hessian: Matrix3::new(k.m11, k.m12, a.x, k.m21, k.m22, a.y, a.x, a.y, -compliance),
                })
            }
            Straight::Table(table) => table.jet(stretch, twist, pressure),
        }
    }
}

impl Law {
    /// psi0 of this law's handedness by (stretch, twist rad/m, pressure Pa).
    pub fn jet(&self, stretch: f64, twist: f64, pressure: f64) -> Result<Jet, LawError> {
        if !self.mirrored {
            return self.straight.jet(stretch, twist, pressure);
        }
        Ok(self.straight.jet(stretch, -twist, pressure)?.mirrored())
    }

    /// The law at `pressure` Pa.
    pub(crate) fn at(&self, pressure: f64) -> Isobar<'_> {
        let slice = match &self.straight {
            Straight::Linear { .. } => None,
            Straight::Table(table) => Some(table.at(pressure)),
        };
        let lateral = [&self.bending, &self.shear, &self.coupling].map(|profile| profile.isobaric(pressure));
        Isobar { law: self, pressure, slice, lateral }
    }

    /// EI at rest, N m2.
    pub fn bending_at_rest(&self) -> f64 {
        self.bending.at([1.0, 0.0, 0.0])
    }
}

impl Isobar<'_> {
    /// psi0.
    pub fn jet(&mut self, stretch: f64, twist: f64) -> Result<Jet, LawError> {
        match &mut self.slice {
            None => self.law.jet(stretch, twist, self.pressure),
            Some(slice) if self.law.mirrored => Ok(slice.jet(stretch, -twist)?.mirrored()),
            Some(slice) => slice.jet(stretch, twist),
        }
    }

    /// EI, GA and q with their derivatives by (stretch, twist, pressure), the second by pressure left out.
    pub fn lateral(&self, stretch: f64, twist: f64) -> Result<[Jet; 3], LawError> {
        let jets = match self.law.mirrored {
            false => self.lateral.map(|of| of.jet(stretch, twist)),
            true => {
                let [bending, shear, coupling] = self.lateral.map(|of| of.jet(stretch, -twist).mirrored());
                let Jet { value, gradient, hessian } = coupling;
                [bending, shear, Jet { value: -value, gradient: -gradient, hessian: -hessian }]
            }
        };
        let [bending, shear] = [jets[0].value, jets[1].value];
        if bending > 0.0 && shear > 0.0 && jets[2].value.is_finite() {
            return Ok(jets);
        }
        Err(LawError::Bending { stretch, twist, pressure: self.pressure, bending, shear })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::ends::{End, Ends};
    use crate::fem::tube::Tube;

    #[test]
    fn the_closed_form_law_is_the_linear_section() {
        let section = LinearSection::new(&Tube::reference(0.7)).unwrap();
        let law = Straight::closed_form(&section);
        let held = Ends { axial: End::Held(1.03), torsion: End::Held(-2.0) };
        let want = section.solve(2e4, held);
        let got = law.jet(1.03, -2.0, 2e4).unwrap();
        assert!((got.gradient - Vector3::new(-want.force, -want.moment, -want.volume)).norm() < 1e-14);
        assert!((got.hessian - want.tangent).norm() < 1e-12);
    }

    #[test]
    fn every_derivative_is_that_of_the_one_potential_of_either_hand() {
        let section = LinearSection::new(&Tube::reference(0.7)).unwrap();
        for mirrored in [false, true] {
            let law = Law {
                straight: Straight::closed_form(&section),
                bending: Profile::constant(4e-4),
                shear: Profile::constant(5.0),
                coupling: Profile::constant(0.0),
                mirrored,
            };
            let at = [1.03, -2.0, 2e4];
            let jet = law.jet(at[0], at[1], at[2]).unwrap();
            for (i, step) in [1e-4, 1e-3, 1.0].into_iter().enumerate() {
                let [mut low, mut high] = [at; 2];
                low[i] -= step;
                high[i] += step;
                let [low, high] = [low, high].map(|a| law.jet(a[0], a[1], a[2]).unwrap());
                let slope = (high.value - low.value) / (2.0 * step);
                // A quadratic function: central differences are exact but for the rounding of the value.
                assert!((slope - jet.gradient[i]).abs() < 1e-14 / step + 1e-9 * jet.gradient[i].abs());
                let slope = (high.gradient - low.gradient) / (2.0 * step);
                let column = jet.hessian.column(i);
                assert!((slope - column).norm() < 1e-14 / step + 1e-9 * column.norm(), "{slope} {column}");
            }
        }
    }

    #[test]
    fn a_law_without_stiffness_is_refused_by_name() {
        let law = Law {
            straight: Straight::spontaneous(30.0, 3e-4, 0.0, 0.0),
            bending: Profile::through([(0.0, 4e-4), (1.0, 2e-4), (2.0, 0.0)]),
            shear: Profile::constant(5.0),
            coupling: Profile::constant(0.0),
            mirrored: false,
        };
        assert!(law.at(1.0).lateral(1.0, 0.0).is_ok());
        for pressure in [2.0, f64::NAN] {
            assert!(matches!(law.at(pressure).lateral(1.0, 0.0), Err(LawError::Bending { .. })));
        }
        assert!(matches!(law.jet(-0.1, 0.0, 0.0), Err(LawError::Stretch(_))));
        assert!(matches!(law.jet(1.0, f64::NAN, 0.0), Err(LawError::Stretch(_))));
    }
}

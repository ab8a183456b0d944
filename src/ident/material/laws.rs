//! A material law that was fitted, and its stresses in uniaxial tension.

use nalgebra::{Matrix3, Vector3};

use crate::fem::material::{Law, MaterialError};
use crate::ident::Measured;

/// Ogden exponents from which a fit begins.
pub(super) const ALPHAS: [f64; 6] = [-3.0, 0.5, 1.2, 2.5, 4.5, 8.0];
/// What counts as a large change of one.
pub(super) const ALPHA_SCALE: f64 = 1.0;

/// A law as the data have it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawFit {
    /// The law with its fitted parameters, Pa.
    pub law: Law,
    /// Shear modulus at rest, Pa: fitted, or as it was given.
    pub shear_modulus: Measured,
    /// Ogden's exponent; none for the laws that have none.
    pub alpha: Option<Measured>,
    /// Root mean square of what is left over, Pa.
    pub rmsd: f64,
    /// The same over the range of the measured stresses or pressures.
    pub rmsd_share: f64,
}

impl LawFit {
    /// Nominal stress in uniaxial tension at `stretch`, Pa; `None` outside the law's domain.
    pub fn tension(&self, stretch: f64) -> Option<f64> {
        uniaxial(&self.law, stretch).ok()
    }
}

/// Principal first Piola-Kirchhoff stresses of the isochoric part at these stretches.
pub(super) fn principal(law: &Law, stretches: [f64; 3]) -> Result<[f64; 3], MaterialError> {
    let stress = law.respond(&Matrix3::from_diagonal(&Vector3::from(stretches)))?.stress;
    Ok([stress[(0, 0)], stress[(1, 1)], stress[(2, 2)]])
}

/// Nominal stress of an incompressible bar at `stretch`, Pa. The linear law takes the stretch less one as its strain.
pub(super) fn uniaxial(law: &Law, stretch: f64) -> Result<f64, MaterialError> {
    if let Law::Linear { .. } = law {
        let half = 1.0 - 0.5 * (stretch - 1.0);
        let [along, across, _] = principal(law, [stretch, half, half])?;
        return Ok(along - across);
    }
    let thin = stretch.sqrt().recip();
    let [along, across, _] = principal(law, [stretch, thin, thin])?;
    // The pressure that keeps the volume is what frees the sides.
    Ok(along - across * thin / stretch)
}

/// Range of some values.
pub(super) fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
    high - low
}

//! E, mu and the hyperelastic laws from tensile tests of one or several specimens.
//!
//! E is the slope at rest of a cubic through the origin, fitted to the strains up to [`SMALL_STRAIN`]; the rubber is
//! incompressible, mu = E/3. The laws are fitted to the whole curves. With several specimens all points are fitted
//! together, and the uncertainties are what the specimens differ by.

use thiserror::Error;

use super::laws::{ALPHA_SCALE, ALPHAS, LawFit, range, uniaxial};
use crate::fem::material::Law;
use crate::ident::Measured;
use crate::ident::least_squares::{Least, least_squares};

/// Largest strain of the fit of E: there a cubic is within 0.1 % of the laws' own slope at rest.
pub const SMALL_STRAIN: f64 = 0.1;
/// Fewest points of a curve up to that strain.
pub const SMALL_MIN: usize = 8;
/// Smallest strain that says anything about an exponent.
pub const STRAIN_MIN: f64 = 0.2;
/// Largest standard uncertainty of an exponent.
pub const ALPHA_UNCERTAINTY_MAX: f64 = 1.0;

/// A point of a tensile curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TensilePoint {
    /// Length over length at rest.
    pub stretch: f64,
    /// Force over area at rest, Pa.
    pub stress: f64,
}

impl TensilePoint {
    /// From what a testing machine writes: elongation and length at rest (m), force (N), area at rest (m2).
    pub fn from_force(elongation: f64, length: f64, force: f64, area: f64) -> Self {
        Self { stretch: 1.0 + elongation / length, stress: force / area }
    }
}

/// What tensile tests say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TensileFit {
    /// Young's modulus at rest, Pa.
    pub youngs_modulus: Measured,
    /// A third of it, Pa.
    pub shear_modulus: Measured,
    /// Ogden's law, both parameters fitted.
    pub ogden: LawFit,
    /// The neo-Hookean law.
    pub neo_hookean: LawFit,
    /// Hooke's law over the whole range.
    pub linear: LawFit,
    /// Specimens.
    pub specimens: usize,
    /// Points of all.
    pub points: usize,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TensileError {
    /// No curve.
    #[error("there is no tensile curve")]
    None,
    /// A number that is none, or a length that cannot be.
    #[error(
        "point {} of specimen {} is stretch {stretch} at {stress} Pa: both must be finite, the stretch positive",
        .index + 1,
        .specimen + 1
    )]
    Point {
        /// Which curve.
        specimen: usize,
        /// Which point.
        index: usize,
        /// Stretch.
        stretch: f64,
        /// Stress, Pa.
        stress: f64,
    },
    /// Too few points at small strain.
    #[error(
        "specimen {} has {count} points at strains of 0 to {SMALL_STRAIN}; {SMALL_MIN} are needed for E",
        .specimen + 1
    )]
    SmallStrain {
        /// Which curve.
        specimen: usize,
        /// How many.
        count: usize,
    },
    /// Hardly stretched.
    #[error("specimen {} was stretched by {strain:.3} only; an exponent needs {STRAIN_MIN}", .specimen + 1)]
    TooShort {
        /// Which curve.
        specimen: usize,
        /// Largest strain.
        strain: f64,
    },
    /// E is not positive.
    #[error("E at rest is {0} Pa: it must be positive; are force and area in N and m2, tension positive?")]
    NotPositive(f64),
    /// The exponent is not known.
    #[error("alpha is {alpha} +- {uncertainty}; it must be known to {ALPHA_UNCERTAINTY_MAX}: stretch farther")]
    Undetermined {
        /// Exponent.
        alpha: f64,
        /// Standard uncertainty.
        uncertainty: f64,
    },
    /// No minimum was found.
    #[error("no exponent within the law's domain fits the curves")]
    NotConverged,
}

/// Fits the curves, one of each specimen.
pub fn fit_tensile(curves: &[Vec<TensilePoint>]) -> Result<TensileFit, TensileError> {
    for (specimen, curve) in curves.iter().enumerate() {
        check(specimen, curve)?;
    }
    if curves.is_empty() {
        return Err(TensileError::None);
    }
    let all = curves.concat();
    let modulus = |points: &[TensilePoint]| small_strain(points).map(|l| l.measured(0));
    let youngs_modulus = scattered(modulus(&all).ok_or(TensileError::NotConverged)?, curves, &modulus);
    if youngs_modulus.value <= 0.0 {
        return Err(TensileError::NotPositive(youngs_modulus.value));
    }
    let mu = youngs_modulus.value / 3.0;
    let fit = |make: Make, starts: &[Vec<f64>]| -> Result<LawFit, TensileError> {
        let least = fitted(&all, make, starts, mu).ok_or(TensileError::NotConverged)?;
        let law = make(&least.parameters).ok_or(TensileError::NotConverged)?;
        let parameter = |at: usize| {
            let one = |points: &[TensilePoint]| fitted(points, make, starts, mu).map(|l| l.measured(at));
            scattered(least.measured(at), curves, &one)
        };
        let alpha = (least.parameters.len() > 1).then(|| parameter(1));
        Ok(described(&all, law, parameter(0), alpha))
    };
    let starts: Vec<_> = ALPHAS.iter().map(|&alpha| vec![mu, alpha]).collect();
    let ogden = fit(|x| Law::ogden(x[0], x[1]).ok(), &starts)?;
    if let Some(Measured { value: alpha, uncertainty, .. }) =
        ogden.alpha.filter(|a| a.uncertainty > ALPHA_UNCERTAINTY_MAX)
    {
        return Err(TensileError::Undetermined { alpha, uncertainty });
    }
    Ok(TensileFit {
        youngs_modulus,
        shear_modulus: youngs_modulus.times(1.0 / 3.0),
        ogden,
        neo_hookean: fit(|x| Law::neo_hookean(x[0]).ok(), &[vec![mu]])?,
        linear: fit(|x| Law::linear(x[0]).ok(), &[vec![mu]])?,
        specimens: curves.len(),
        points: all.len(),
    })
}

/// A law of its parameters: the shear modulus and, for Ogden's, the exponent.
type Make = fn(&[f64]) -> Option<Law>;

fn check(specimen: usize, curve: &[TensilePoint]) -> Result<(), TensileError> {
    let wrong = |p: &TensilePoint| !(p.stretch.is_finite() && p.stretch > 0.0 && p.stress.is_finite());
    if let Some(index) = curve.iter().position(wrong) {
        let TensilePoint { stretch, stress } = curve[index];
        return Err(TensileError::Point { specimen, index, stretch, stress });
    }
    let count = small(curve).count();
    if count < SMALL_MIN {
        return Err(TensileError::SmallStrain { specimen, count });
    }
    let strain = curve.iter().map(|p| p.stretch - 1.0).fold(0.0, f64::max);
    if strain < STRAIN_MIN { Err(TensileError::TooShort { specimen, strain }) } else { Ok(()) }
}

/// The points at small strain, as strain and stress.
fn small(points: &[TensilePoint]) -> impl Iterator<Item = (f64, f64)> {
    points.iter().map(|p| (p.stretch - 1.0, p.stress)).filter(|(e, _)| (0.0..=SMALL_STRAIN * (1.0 + 1e-9)).contains(e))
}

/// The cubic through the origin.
fn small_strain(points: &[TensilePoint]) -> Option<Least> {
    let points: Vec<_> = small(points).collect();
    let scale = points.iter().map(|p| p.1.abs()).fold(1.0, f64::max);
    let force = |x: &[f64], e: f64| (x[0] + (x[1] + x[2] * e) * e) * e;
    let residuals = |x: &[f64]| Some(points.iter().map(|&(e, s)| force(x, e) - s).collect());
    least_squares(&[0.0; 3], &[scale, scale, 10.0 * scale], residuals)
}

/// `together` with the scatter of the specimens, where there are several: their points are not independent.
fn scattered(
    together: Measured,
    curves: &[Vec<TensilePoint>],
    one: &dyn Fn(&[TensilePoint]) -> Option<Measured>,
) -> Measured {
    let values: Vec<f64> = curves.iter().filter_map(|c| one(c)).map(|m| m.value).collect();
    if curves.len() < 2 || values.len() < 2 {
        return together;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Measured { value: together.value, uncertainty: (variance / count).sqrt(), freedom: values.len() - 1 }
}

fn fitted(points: &[TensilePoint], make: Make, starts: &[Vec<f64>], mu: f64) -> Option<Least> {
    let residuals = |x: &[f64]| {
        let law = make(x)?;
        points.iter().map(|p| Some(uniaxial(&law, p.stretch).ok()? - p.stress)).collect::<Option<Vec<_>>>()
    };
    let sum = |x: &Vec<f64>| residuals(x).map_or(f64::INFINITY, |r| r.iter().map(|r| r * r).sum());
    let start = starts.iter().min_by(|a, b| sum(a).total_cmp(&sum(b)))?;
    let scale = [mu, ALPHA_SCALE];
    least_squares(start, &scale[..start.len()], residuals)
}

fn described(points: &[TensilePoint], law: Law, shear_modulus: Measured, alpha: Option<Measured>) -> LawFit {
    let square = |p: &TensilePoint| (uniaxial(&law, p.stretch).unwrap_or(f64::NAN) - p.stress).powi(2);
    let rmsd = (points.iter().map(square).sum::<f64>() / points.len() as f64).sqrt();
    LawFit { law, shear_modulus, alpha, rmsd, rmsd_share: rmsd / range(points.iter().map(|p| p.stress)) }
}

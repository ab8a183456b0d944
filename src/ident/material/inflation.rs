//! Ogden's exponent from the inflation of a bare tube.
//!
//! An incompressible tube of radii Ri, Ro that is blown up to the outer radius ro at the axial stretch L has
//!
//! ```text
//! r^2 = ro^2 - (Ro^2 - R^2) / L        stretches  R / (L r),  r / R,  L      (radial, hoop, axial)
//! P = int (s_hoop - s_radial) dr / r
//! F = pi int (2 s_axial - s_hoop - s_radial) r dr                 F: external axial force, the caps' thrust apart
//! ```
//!
//! with the Cauchy stresses s of the laws in `fem::material`, integrated through the wall by eight Gauss points. The
//! outer radius is what P is computed from, so that a pressure that falls beyond its maximum is no special case. The
//! linear law has Lame's displacements and integrates over the wall at rest.
//!
//! A reading is off in pressure and in radius. Each is weighted by both, the latter times the slope of the pressure.

use std::f64::consts::PI;

use thiserror::Error;

use super::laws::{ALPHA_SCALE, ALPHAS, LawFit, principal, range};
use crate::fem::ends::End;
use crate::fem::material::Law;
use crate::ident::Measured;
use crate::ident::least_squares::{Least, least_squares};

/// Fewest points.
pub const POINTS_MIN: usize = 8;
/// Least growth of the outer radius, as a share of it: below it all laws are the linear one.
pub const GROWTH_MIN: f64 = 0.05;
/// Largest standard uncertainty of the exponent.
pub const ALPHA_UNCERTAINTY_MAX: f64 = 1.0;
/// Gauss points of -1..1 and their weights, of the positive half.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];
/// Secants for the axial stretch, at most.
const ROUNDS: usize = 30;

/// A bare tube and its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BareTube {
    /// Inner radius at rest, m.
    pub inner_radius: f64,
    /// Wall at rest, m.
    pub wall: f64,
    /// Closed ends that are free under an external force (N, 0 for free), or held at an axial stretch (1 at rest).
    pub axial: End,
}

/// A point of the inflation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InflationPoint {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// Outer radius, m.
    pub outer_radius: f64,
}

/// How large the errors of pressure and radius are, or only their proportion: the residuals give the scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingErrors {
    /// Standard deviation of a pressure, Pa.
    pub pressure: f64,
    /// Standard deviation of a radius, m.
    pub radius: f64,
}

/// What the inflation says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InflationFit {
    /// Ogden's law.
    pub ogden: LawFit,
    /// The neo-Hookean law.
    pub neo_hookean: LawFit,
    /// The linear law.
    pub linear: LawFit,
    /// Growth of the outer radius, as a share of it.
    pub growth: f64,
    /// Points.
    pub points: usize,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InflationError {
    /// No tube.
    #[error("inner radius {inner_radius} m, wall {wall} m: both must be positive, the wall at most two inner radii")]
    Tube {
        /// Inner radius, m.
        inner_radius: f64,
        /// Wall, m.
        wall: f64,
    },
    /// No errors.
    #[error("errors of {pressure} Pa and {radius} m: neither may be negative, and one must be positive")]
    Errors {
        /// Of the pressure, Pa.
        pressure: f64,
        /// Of the radius, m.
        radius: f64,
    },
    /// No shear modulus.
    #[error("the shear modulus {0} Pa that is taken as known is not positive")]
    ShearModulus(f64),
    /// Too few points.
    #[error("an inflation needs at least {POINTS_MIN} points; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("point {0} of the inflation is not finite")]
    NotFinite(usize),
    /// Hardly inflated.
    #[error("the tube grew by {0} of its radius only; at least {GROWTH_MIN} is needed: inflate it farther")]
    TooSmall(f64),
    /// A radius at which the bore is closed, or no equilibrium.
    #[error("at point {index} the outer radius {radius} m leaves this tube no equilibrium: radii, wall, units?")]
    NoEquilibrium {
        /// Which one.
        index: usize,
        /// Outer radius, m.
        radius: f64,
    },
    /// The exponent is not known.
    #[error("alpha is {alpha} +- {uncertainty}; it must be known to {ALPHA_UNCERTAINTY_MAX}: inflate the tube farther")]
    Undetermined {
        /// Exponent.
        alpha: f64,
        /// Standard uncertainty.
        uncertainty: f64,
    },
    /// No minimum was found.
    #[error("no exponent within the law's domain fits the inflation")]
    NotConverged,
}

impl BareTube {
    /// Pressure that holds the tube at `outer_radius` (m) and its axial stretch, which is sought from `near`; `None`
    /// where there is no equilibrium.
    pub fn pressure(&self, law: &Law, outer_radius: f64, near: f64) -> Option<(f64, f64)> {
        let force = match self.axial {
            End::Held(stretch) => return Some((self.integrals(law, outer_radius, stretch)?.0, stretch)),
            End::Loaded(force) => force,
        };
        let tolerance = 1e-11 * law.shear_modulus() * PI * self.inner_radius * self.wall;
        let (mut stretch, mut slope) = (near, None);
        let (mut pressure, mut excess) = self.excess(law, outer_radius, stretch, force)?;
        for _ in 0..ROUNDS {
            if excess.abs() < tolerance {
                return Some((pressure, stretch));
            }
            // Secants after a first difference; the force rises with the stretch at every radius.
            let rise = match slope {
                Some(slope) => slope,
                None => (self.excess(law, outer_radius, stretch + 1e-6, force)?.1 - excess) / 1e-6,
            };
            if !(rise.is_finite() && rise > 0.0) {
                return None;
            }
            let step = (-excess / rise).clamp(-0.1, 0.1);
            let before = excess;
            stretch += step;
            (pressure, excess) = self.excess(law, outer_radius, stretch, force)?;
            if step.abs() < 1e-12 {
                return Some((pressure, stretch));
            }
            slope = Some((excess - before) / step);
        }
        None
    }

    /// Pressure, and how much more than `force` pulls at this stretch.
    fn excess(&self, law: &Law, outer: f64, stretch: f64, force: f64) -> Option<(f64, f64)> {
        let (pressure, pull) = self.integrals(law, outer, stretch)?;
        Some((pressure, pull - force))
    }

    /// Pressure and external axial force at an outer radius and an axial stretch.
    fn integrals(&self, law: &Law, outer: f64, stretch: f64) -> Option<(f64, f64)> {
        let (low, high) = (self.inner_radius, self.inner_radius + self.wall);
        let (mut pressure, mut force) = (0.0, 0.0);
        for (x, weight) in GAUSS.into_iter().flat_map(|(x, w)| [(-x, w), (x, w)]) {
            let rest = low + 0.5 * self.wall * (1.0 + x);
            let weight = 0.5 * self.wall * weight;
            // Cauchy stresses, radius, and its differential by the radius at rest.
            let ([radial, hoop, axial], radius, slope) = if let Law::Linear { .. } = law {
                let strain = stretch - 1.0;
                let swell = (outer - high + 0.5 * strain * high) * high / (rest * rest);
                let stretches = [1.0 - swell - 0.5 * strain, 1.0 + swell - 0.5 * strain, stretch];
                (principal(law, stretches).ok()?, rest, 1.0)
            } else {
                let radius = (outer * outer - (high * high - rest * rest) / stretch).sqrt();
                let stretches = [rest / (stretch * radius), radius / rest, stretch];
                let nominal = principal(law, stretches).ok()?;
                (std::array::from_fn(|i| nominal[i] * stretches[i]), radius, stretches[0])
            };
            pressure += weight * (hoop - radial) * slope / radius;
            force += weight * PI * (2.0 * axial - hoop - radial) * slope * radius;
        }
        (pressure.is_finite() && force.is_finite()).then_some((pressure, force))
    }

    /// The pressures at all points.
    fn pressures(&self, law: &Law, radii: &[f64]) -> Result<Vec<f64>, usize> {
        let mut near = 1.0;
        let each = |(index, &radius): (usize, &f64)| {
            let (pressure, stretch) = self.pressure(law, radius, near).ok_or(index)?;
            near = stretch;
            Ok(pressure)
        };
        radii.iter().enumerate().map(each).collect()
    }
}

/// Fits the laws to the inflation of `tube`. With `shear_modulus` given (from tensile tests) every law keeps it, only
/// alpha is fitted, and its uncertainty contains the modulus's.
pub fn fit_inflation(
    points: &[InflationPoint],
    tube: &BareTube,
    errors: &ReadingErrors,
    shear_modulus: Option<Measured>,
) -> Result<InflationFit, InflationError> {
    let growth = check(points, tube, errors, shear_modulus)?;
    let mut fit = Inflation {
        tube,
        radii: points.iter().map(|p| p.outer_radius).collect(),
        pressures: points.iter().map(|p| p.pressure).collect(),
        weights: vec![1.0; points.len()],
        known: shear_modulus,
        scale: 1.0,
    };
    // The pressure is in proportion to mu, so the neo-Hookean one is known at once.
    let shape = fit
        .model(&[1.0], Shape::NeoHookean)
        .map_err(|index| InflationError::NoEquilibrium { index, radius: points[index].outer_radius })?;
    let product: f64 = shape.iter().zip(&fit.pressures).map(|(s, p)| s * p).sum();
    fit.scale = (product / shape.iter().map(|s| s * s).sum::<f64>()).max(1.0);
    fit.weigh(Law::NeoHookean { mu: fit.modulus() }, errors);
    let first = fit.fit(Shape::Ogden, None).ok_or(InflationError::NotConverged)?;
    // Once more with the weights of the better law.
    fit.weigh(fit.law(&first.parameters, Shape::Ogden).ok_or(InflationError::NotConverged)?, errors);
    let ogden = fit.fit(Shape::Ogden, Some(&first.parameters));
    let describe = |least: Option<Least>, shape| {
        least.and_then(|least| fit.describe(&least, shape)).ok_or(InflationError::NotConverged)
    };
    let ogden = describe(ogden, Shape::Ogden)?;
    if let Some(Measured { value: alpha, uncertainty, .. }) =
        ogden.alpha.filter(|a| a.uncertainty > ALPHA_UNCERTAINTY_MAX)
    {
        return Err(InflationError::Undetermined { alpha, uncertainty });
    }
    let neo_hookean = describe(fit.fit(Shape::NeoHookean, None), Shape::NeoHookean)?;
    let linear = describe(fit.fit(Shape::Linear, None), Shape::Linear)?;
    Ok(InflationFit { ogden, neo_hookean, linear, growth, points: points.len() })
}

fn check(
    points: &[InflationPoint],
    tube: &BareTube,
    errors: &ReadingErrors,
    shear_modulus: Option<Measured>,
) -> Result<f64, InflationError> {
    let BareTube { inner_radius, wall, .. } = *tube;
    if !(inner_radius > 0.0 && wall > 0.0 && wall <= 2.0 * inner_radius && inner_radius.is_finite()) {
        return Err(InflationError::Tube { inner_radius, wall });
    }
    let ReadingErrors { pressure, radius } = *errors;
    if !(pressure >= 0.0 && radius >= 0.0 && pressure + radius > 0.0 && (pressure + radius).is_finite()) {
        return Err(InflationError::Errors { pressure, radius });
    }
    if let Some(mu) = shear_modulus.filter(|m| !(m.value > 0.0 && m.uncertainty >= 0.0 && m.value.is_finite())) {
        return Err(InflationError::ShearModulus(mu.value));
    }
    if points.len() < POINTS_MIN {
        return Err(InflationError::TooFew(points.len()));
    }
    if let Some(index) = points.iter().position(|p| !(p.pressure.is_finite() && p.outer_radius.is_finite())) {
        return Err(InflationError::NotFinite(index));
    }
    let outer = inner_radius + wall;
    let growth = points.iter().map(|p| p.outer_radius / outer - 1.0).fold(0.0, f64::max);
    if growth < GROWTH_MIN { Err(InflationError::TooSmall(growth)) } else { Ok(growth) }
}

#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Ogden,
    NeoHookean,
    Linear,
}

/// What the fits share.
struct Inflation<'a> {
    tube: &'a BareTube,
    radii: Vec<f64>,
    pressures: Vec<f64>,
    /// One over the standard deviation of each pressure.
    weights: Vec<f64>,
    known: Option<Measured>,
    /// A shear modulus to begin with, Pa.
    scale: f64,
}

impl Inflation<'_> {
    fn modulus(&self) -> f64 {
        self.known.map_or(self.scale, |m| m.value)
    }

    /// The law of the parameters: the shear modulus, then alpha.
    fn law_of(&self, x: &[f64], shape: Shape) -> Option<Law> {
        match shape {
            Shape::Ogden => Law::ogden(x[0], x[1]).ok(),
            Shape::NeoHookean => Law::neo_hookean(x[0]).ok(),
            Shape::Linear => Law::linear(x[0]).ok(),
        }
    }

    /// The law of the fitted parameters, which lack the shear modulus where that is known.
    fn law(&self, fitted: &[f64], shape: Shape) -> Option<Law> {
        let given = self.known.map(|m| m.value);
        let all: Vec<f64> = given.into_iter().chain(fitted.iter().copied()).collect();
        self.law_of(&all, shape)
    }

    fn model(&self, x: &[f64], shape: Shape) -> Result<Vec<f64>, usize> {
        self.tube.pressures(&self.law_of(x, shape).ok_or(0usize)?, &self.radii)
    }

    /// Weighs each point by its errors, the slope being that of `law`.
    fn weigh(&mut self, law: Law, errors: &ReadingErrors) {
        let h = 1e-5 * (self.tube.inner_radius + self.tube.wall);
        let moved = |by: f64| self.tube.pressures(&law, &self.radii.iter().map(|r| r + by).collect::<Vec<_>>());
        let (Ok(low), Ok(high)) = (moved(-h), moved(h)) else { return };
        let weight =
            |(low, high): (f64, f64)| (errors.pressure.hypot(errors.radius * (high - low) / (2.0 * h))).recip();
        let weights: Vec<f64> = low.into_iter().zip(high).map(weight).collect();
        if weights.iter().all(|w| w.is_finite()) {
            self.weights = weights;
        }
    }

    fn residuals(&self, law: &Law) -> Option<Vec<f64>> {
        let model = self.tube.pressures(law, &self.radii).ok()?;
        Some((0..model.len()).map(|i| self.weights[i] * (model[i] - self.pressures[i])).collect())
    }

    /// From `near`, or from the best of several beginnings.
    fn fit(&self, shape: Shape, near: Option<&[f64]>) -> Option<Least> {
        let residuals = |x: &[f64]| self.residuals(&self.law(x, shape)?);
        let modulus = self.known.is_none().then_some(self.scale);
        let start = |alpha: Option<f64>| modulus.into_iter().chain(alpha).collect::<Vec<f64>>();
        let starts = match (near, shape) {
            (Some(near), _) => vec![near.to_vec()],
            (None, Shape::Ogden) => ALPHAS.iter().map(|&alpha| start(Some(alpha))).collect(),
            (None, Shape::NeoHookean | Shape::Linear) => vec![start(None)],
        };
        let sum = |x: &Vec<f64>| residuals(x).map_or(f64::INFINITY, |r| r.iter().map(|r| r * r).sum::<f64>());
        let best = starts.iter().map(|s| (sum(s), s)).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
        let scale = start((shape == Shape::Ogden).then_some(ALPHA_SCALE));
        least_squares(best, &scale, residuals)
    }

    fn describe(&self, least: &Least, shape: Shape) -> Option<LawFit> {
        let law = self.law(&least.parameters, shape)?;
        let model = self.tube.pressures(&law, &self.radii).ok()?;
        let square = model.iter().zip(&self.pressures).map(|(m, p)| (m - p).powi(2)).sum::<f64>();
        let rmsd = (square / model.len() as f64).sqrt();
        let alpha = (shape == Shape::Ogden).then(|| {
            let own = least.measured(least.parameters.len() - 1);
            let shift = self.known.map_or(0.0, |m| m.uncertainty * self.alpha_by_modulus(&law));
            Measured { uncertainty: own.uncertainty.hypot(shift), ..own }
        });
        Some(LawFit {
            law,
            shear_modulus: self.known.unwrap_or_else(|| least.measured(0)),
            alpha,
            rmsd,
            rmsd_share: rmsd / range(self.pressures.iter().copied()),
        })
    }

    /// How the alpha that fits best moves with the known modulus, 1/Pa.
    fn alpha_by_modulus(&self, law: &Law) -> f64 {
        let (mu, alpha) = match *law {
            Law::Ogden { mu, alpha } => (mu, alpha),
            Law::NeoHookean { mu } | Law::Linear { mu } => (mu, 2.0),
        };
        let at = |mu: f64, alpha: f64| Law::ogden(mu, alpha).ok().and_then(|law| self.residuals(&law));
        let (h, g) = (1e-5 * mu, 1e-5);
        let slopes = (at(mu - h, alpha), at(mu + h, alpha), at(mu, alpha - g), at(mu, alpha + g));
        let (Some(a), Some(b), Some(c), Some(d)) = slopes else { return f64::INFINITY };
        let by_mu = |i: usize| (b[i] - a[i]) / (2.0 * h);
        let by_alpha = |i: usize| (d[i] - c[i]) / (2.0 * g);
        let sum = |f: &dyn Fn(usize) -> f64| (0..a.len()).map(f).sum::<f64>();
        -sum(&|i| by_mu(i) * by_alpha(i)) / sum(&|i| by_alpha(i).powi(2))
    }
}

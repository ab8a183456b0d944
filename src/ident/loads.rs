//! Stiffness from known loads: weights for ke, torques for kt, at one or several pressures, loading and unloading.
//!
//! At rest the spring bears what is hung on it and what the pressure does,
//!
//! ```text
//! k (y - y0) = F + b (P a(y) - m)      y: length or angle, F: known load, m: known hysteresis
//! ```
//!
//! with a(y), force or moment per pressure, from the fibre kinematics (3.1). Its scale depends on the fibres' radius
//! and winding angle (a torque on the cube of the radius), so it is not believed: the factor b is fitted where there
//! are several pressures. The hysteresis has been found by steps of pressure, in the same scale. What is read with an
//! error is y, so y is fitted by the loads,
//!
//! ```text
//! y = y0 + F/k + (b/k) (P a - m) + h d         d = +1 loading, -1 unloading, 0 at the first point of a pressure
//! ```
//!
//! linear in y0, 1/k, b/k and the half-width h of what hysteresis is left. Each pressure is fitted by itself as well,
//! with the b of all: whether k varies with the pressure is told with an uncertainty. What the pressures differ by
//! beyond their own uncertainties is in that of k: then the geometry is not quite the FREE's.

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::Measured;
use super::least_squares::inverse;

/// Fewest points.
pub const POINTS_MIN: usize = 6;
/// Fewest points that give a pressure a stiffness of its own.
pub const OWN_MIN: usize = 5;
/// Largest standard uncertainty of a stiffness, as a share of it.
pub const UNCERTAINTY_MAX: f64 = 0.5;

/// One reading at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadPoint {
    /// Known load, N or N m, positive along positive `deflection`.
    pub load: f64,
    /// Reading, m or rad.
    pub deflection: f64,
    /// Which pressure it belongs to: readings of one number were meant to be at the same.
    pub group: usize,
    /// Pressure, Pa.
    pub pressure: f64,
    /// Force or moment per pressure at this reading, N/Pa or N m/Pa.
    pub actuation: f64,
    /// Known hysteresis, N or N m, in the scale of `actuation`: what is not the spring's of what is borne.
    pub hysteresis: f64,
}

/// What loads say.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadFit {
    /// Stiffness, N/m or N m/rad.
    pub stiffness: Measured,
    /// Factor on the force or moment per pressure; none where there is one pressure only.
    pub actuation_factor: Option<Measured>,
    /// Half-width of the hysteresis that was not known, m or rad.
    pub hysteresis: Measured,
    /// Root mean square of what is left over, m or rad.
    pub residual: f64,
    /// Mean pressure (Pa) of each group that carries one, and its own stiffness.
    pub own: Vec<(f64, Measured)>,
    /// Greatest difference between those as a share of the stiffness; none of fewer than two.
    pub variation: Option<Measured>,
    /// By point: what the spring bears by the fit (N, N m), and the deflection that it gives (m, rad).
    pub fitted: Vec<(f64, f64)>,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LoadError {
    /// Too few points.
    #[error("known loads need at least {POINTS_MIN} readings; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("reading {0} is not finite")]
    NotFinite(usize),
    /// Only one way.
    #[error("at pressure number {group} the load never {never}: without both ways hysteresis passes for stiffness")]
    OneWay {
        /// Which pressure, from 1.
        group: usize,
        /// "rises" or "falls".
        never: &'static str,
    },
    /// What is sought cannot be told apart.
    #[error("the loads do not tell stiffness, hysteresis and pressure apart: more loads at every pressure")]
    Together,
    /// Loads that shorten.
    #[error("the stiffness that fits best is {0:.3e}: the readings go against the loads; are they in their order?")]
    NotPositive(f64),
    /// Drowned in the readings' errors.
    #[error(
        "the stiffness is {stiffness:.3e} +- {uncertainty:.1e}, known to no more than {UNCERTAINTY_MAX} of it: larger loads"
    )]
    Unresolved {
        /// What came out.
        stiffness: f64,
        /// Its standard uncertainty.
        uncertainty: f64,
    },
}

/// Fits `points` in the order in which they were taken.
pub fn fit_loads(points: &[LoadPoint]) -> Result<LoadFit, LoadError> {
    if points.len() < POINTS_MIN {
        return Err(LoadError::TooFew(points.len()));
    }
    let finite =
        |p: &LoadPoint| [p.load, p.deflection, p.pressure, p.actuation, p.hysteresis].iter().all(|x| x.is_finite());
    if let Some(index) = points.iter().position(|p| !finite(p)) {
        return Err(LoadError::NotFinite(index));
    }
    let directions = directions(points);
    let groups = groups(points);
    for (number, group) in groups.iter().enumerate() {
        let loads = || group.iter().map(|&i| points[i].load);
        let spread = loads().fold(f64::NEG_INFINITY, f64::max) > loads().fold(f64::INFINITY, f64::min);
        for (sign, never) in [(1.0, "rises"), (-1.0, "falls")] {
            if spread && !group.iter().any(|&i| directions[i] == sign) {
                return Err(LoadError::OneWay { group: number + 1, never });
            }
        }
    }
    let pressed = |i: usize| points[i].pressure * points[i].actuation - points[i].hysteresis;
    // y0, 1/k, h and, with several pressures, b/k.
    let scaled = usize::from(groups.len() > 1);
    let columns = DMatrix::from_fn(points.len(), 3 + scaled, |i, j| match j {
        0 => 1.0,
        // With one pressure b is one.
        1 if scaled == 0 => points[i].load + pressed(i),
        1 => points[i].load,
        2 => directions[i],
        _ => pressed(i),
    });
    let all = linear(&columns, points.iter().map(|p| p.deflection)).ok_or(LoadError::Together)?;
    let stiffness = all.stiffness()?;
    let factor = (scaled == 1).then(|| all.factor());
    let b = factor.map_or(1.0, |b| b.value);
    let borne = |i: usize| points[i].load + b * pressed(i);
    let own: Vec<_> = groups
        .iter()
        .filter_map(|group| {
            let columns = DMatrix::from_fn(group.len(), 3, |i, j| [1.0, borne(group[i]), directions[group[i]]][j]);
            let fit =
                linear(&columns, group.iter().map(|&i| points[i].deflection)).filter(|_| group.len() >= OWN_MIN)?;
            let pressure = group.iter().map(|&i| points[i].pressure).sum::<f64>() / group.len() as f64;
            Some((pressure, fit.stiffness().ok()?))
        })
        .collect();
    let fitted = (0..points.len()).map(|i| (borne(i), all.fitted[i])).collect();
    Ok(LoadFit {
        stiffness: Measured { uncertainty: stiffness.uncertainty.hypot(spread(&own, stiffness.value)), ..stiffness },
        actuation_factor: factor,
        hysteresis: all.measured(2),
        residual: all.variance.sqrt(),
        variation: variation(&own, stiffness.value),
        own,
        fitted,
    })
}

/// Whether the load rose (+1) or fell (-1) to each point; 0 at the first point of a pressure.
fn directions(points: &[LoadPoint]) -> Vec<f64> {
    let mut last = 0.0;
    let mut out = Vec::with_capacity(points.len());
    for (i, point) in points.iter().enumerate() {
        let before = i.checked_sub(1).map(|i| &points[i]).filter(|before| before.group == point.group);
        last = match before {
            None => 0.0,
            Some(before) if point.load > before.load => 1.0,
            Some(before) if point.load < before.load => -1.0,
            Some(_) => last,
        };
        out.push(last);
    }
    out
}

/// Indices by group, in the order of their first points.
fn groups(points: &[LoadPoint]) -> Vec<Vec<usize>> {
    let mut groups: Vec<(usize, Vec<usize>)> = Vec::new();
    for (i, point) in points.iter().enumerate() {
        match groups.iter_mut().find(|(name, _)| *name == point.group) {
            Some((_, members)) => members.push(i),
            None => groups.push((point.group, vec![i])),
        }
    }
    groups.into_iter().map(|(_, members)| members).collect()
}

fn variation(own: &[(f64, Measured)], stiffness: f64) -> Option<Measured> {
    let of = |a: &(f64, Measured), b: &(f64, Measured)| a.1.value.total_cmp(&b.1.value);
    let (low, high) = (own.iter().copied().min_by(of)?.1, own.iter().copied().max_by(of)?.1);
    (own.len() > 1).then(|| Measured {
        value: (high.value - low.value) / stiffness,
        uncertainty: high.uncertainty.hypot(low.uncertainty) / stiffness,
        freedom: high.freedom.min(low.freedom),
    })
}

/// What the pressures differ by beyond their own uncertainties, as a standard uncertainty: the greatest deviation is
/// the half-width of a uniform distribution.
fn spread(own: &[(f64, Measured)], stiffness: f64) -> f64 {
    let beyond = |(_, k): &(f64, Measured)| ((k.value - stiffness).powi(2) - k.uncertainty.powi(2)).max(0.0);
    (own.iter().map(beyond).fold(0.0, f64::max) / 3.0).sqrt()
}

/// A linear fit with its covariance.
struct Linear {
    solution: DVector<f64>,
    covariance: DMatrix<f64>,
    fitted: DVector<f64>,
    variance: f64,
    freedom: usize,
}

/// Fits `right` by the columns; one of zeros (no direction, no pressure) is left out, and its parameter is zero.
fn linear(columns: &DMatrix<f64>, right: impl Iterator<Item = f64>) -> Option<Linear> {
    let used: Vec<usize> = (0..columns.ncols()).filter(|&j| columns.column(j).iter().any(|x| *x != 0.0)).collect();
    let matrix = columns.select_columns(&used);
    let freedom = matrix.nrows().checked_sub(used.len()).filter(|n| *n > 0)?;
    let right = DVector::from_iterator(matrix.nrows(), right);
    let inverse = inverse(&(matrix.transpose() * &matrix))?;
    let found = &inverse * (matrix.transpose() * &right);
    let fitted = &matrix * &found;
    let variance = (&right - &fitted).norm_squared() / freedom as f64;
    let mut solution = DVector::zeros(columns.ncols());
    let mut covariance = DMatrix::zeros(columns.ncols(), columns.ncols());
    for (i, &a) in used.iter().enumerate() {
        solution[a] = found[i];
        for (j, &b) in used.iter().enumerate() {
            covariance[(a, b)] = variance * inverse[(i, j)];
        }
    }
    Some(Linear { solution, covariance, fitted, variance, freedom })
}

impl Linear {
    fn measured(&self, index: usize) -> Measured {
        let uncertainty = self.covariance[(index, index)].max(0.0).sqrt();
        Measured { value: self.solution[index], uncertainty, freedom: self.freedom }
    }

    /// 1 / (1/k).
    fn stiffness(&self) -> Result<Measured, LoadError> {
        let compliance = self.measured(1);
        let value = compliance.value.recip();
        if !(value > 0.0 && value.is_finite()) {
            return Err(LoadError::NotPositive(value));
        }
        let uncertainty = value * value * compliance.uncertainty;
        if uncertainty > UNCERTAINTY_MAX * value {
            return Err(LoadError::Unresolved { stiffness: value, uncertainty });
        }
        Ok(Measured { value, uncertainty, freedom: self.freedom })
    }

    /// b = (b/k) / (1/k), by the propagation of its covariance.
    fn factor(&self) -> Measured {
        let (compliance, product) = (self.solution[1], self.solution[3]);
        let value = product / compliance;
        let c = &self.covariance;
        let variance = c[(3, 3)] + value * value * c[(1, 1)] - 2.0 * value * c[(1, 3)];
        Measured { value, uncertainty: variance.max(0.0).sqrt() / compliance.abs(), freedom: self.freedom }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    /// Loads up and down at three pressures on a spring whose pressure acts by `factor` times what is believed.
    fn session(stiffness: f64, factor: f64, noise: f64, rng: &mut Pcg64Mcg) -> Vec<LoadPoint> {
        let loads = [0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0];
        let at = |group: usize, load: f64, random: f64| {
            let pressure = 1e4 * group as f64;
            // Believed: falls with the deflection, as the kinematics have it.
            let believed = |y: f64| -2e-4 * (1.0 + 20.0 * y);
            let y = (load - factor * 2e-4 * pressure) / (stiffness + factor * 2e-4 * 20.0 * pressure);
            let deflection = y + noise * random;
            LoadPoint { load, deflection, group, pressure, actuation: believed(deflection), hysteresis: 0.0 }
        };
        let mut points = Vec::new();
        for group in 0..3 {
            points.extend(loads.iter().map(|load| at(group, *load, StandardNormal.sample(rng))));
        }
        points
    }

    #[test]
    fn a_wrong_radius_shows_as_a_factor_and_not_in_the_stiffness() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let fit = fit_loads(&session(2000.0, 1.09, 0.0, &mut rng)).unwrap();
        // All of it is linear: rounding.
        assert!((fit.stiffness.value / 2000.0 - 1.0).abs() < 1e-9, "{fit:?}");
        assert!((fit.actuation_factor.unwrap().value - 1.09).abs() < 1e-9, "{fit:?}");
        assert!(fit.variation.unwrap().value < 1e-9 && fit.own.len() == 3 && fit.residual < 1e-12, "{fit:?}");
    }

    #[test]
    fn intervals_cover_as_often_as_they_say() {
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let (mut stiffness, mut factor) = (0, 0);
        for _ in 0..300 {
            let fit = fit_loads(&session(2000.0, 0.94, 2e-4, &mut rng)).unwrap();
            let inside = |m: Measured, truth: f64| {
                let (low, high) = m.interval();
                usize::from(low <= truth && truth <= high)
            };
            stiffness += inside(fit.stiffness, 2000.0);
            factor += inside(fit.actuation_factor.unwrap(), 0.94);
        }
        // 285 of 300 with a deviation of 3.8; the propagation is linear and the load term holds the reading's error.
        assert!((270..=298).contains(&stiffness) && (270..=298).contains(&factor), "{stiffness} {factor}");
    }

    #[test]
    fn loads_that_say_nothing_are_refused_by_name() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let good = session(2000.0, 1.0, 0.0, &mut rng);
        assert_eq!(fit_loads(&good[..5]), Err(LoadError::TooFew(5)));
        let mut bad = good.clone();
        bad[4].deflection = f64::NAN;
        assert_eq!(fit_loads(&bad), Err(LoadError::NotFinite(4)));
        let up: Vec<_> =
            good.iter().copied().filter(|p| p.group == 0).take(5).chain(good[9..].iter().copied()).collect();
        assert_eq!(fit_loads(&up), Err(LoadError::OneWay { group: 1, never: "falls" }));
        let turned: Vec<_> = good.iter().map(|p| LoadPoint { deflection: -p.deflection, ..*p }).collect();
        assert!(matches!(fit_loads(&turned), Err(LoadError::NotPositive(k)) if k < 0.0));
        let same: Vec<_> = good.iter().map(|p| LoadPoint { load: 1.0, ..*p }).collect();
        assert_eq!(fit_loads(&same), Err(LoadError::Together));
        let drowned = session(2000.0, 1.0, 2e-2, &mut rng);
        assert!(matches!(fit_loads(&drowned), Err(LoadError::Unresolved { .. } | LoadError::NotPositive(_))));
    }
}

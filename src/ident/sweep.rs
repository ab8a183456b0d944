//! Torsional stiffness and hysteresis from a slow staircase of pressure, up and down.
//!
//! At rest the moment of the pressure is borne by the spring and the Maxwell-slip elements,
//!
//! ```text
//! a(phi) P = kt phi + c + sum w_i strain_i(phi, past)         w_i >= 0
//! ```
//!
//! linear in kt, c and the weights w_i once the thresholds are chosen: the strains follow from the angles alone, in
//! their order. What was before the sweep is not known; at its first turn, at the top, every element is strained to its
//! threshold, so it is fitted from there on. c is what the springs bear at the tare: what a cycle before it has left
//! behind, and any constant moment. a(phi) is the moment per pressure of the fibre kinematics (3.1) at the axial
//! equilibrium. Non-negative least squares of ten unknowns; thresholds on a grid from [`SHORTEST`] to [`LONGEST`] of
//! the largest angle.
//!
//! The standard uncertainty of kt has two parts: that of the residuals and the columns in use, as if the residuals were
//! independent; and, because those of a model that is not quite right are not, the variation of kt between the thirds
//! of the range, as the half-width of a uniform distribution (over sqrt 3).

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

use super::Measured;
use crate::model::{
    DomainError, ELEMENTS, EquilibriumError, Free, FreeError, Hysteresis, HysteresisState, Kinematics, Law, Load,
    Lumped,
};

/// Shortest threshold, as a share of the largest angle.
pub const SHORTEST: f64 = 0.004;
/// Longest threshold, as a share of the largest angle: beyond it an element could not be told from the spring.
pub const LONGEST: f64 = 0.25;
/// Fewest points from the first turn on.
pub const POINTS_MIN: usize = 12;
/// Smallest range of angles that says anything about a stiffness, rad: twenty times the IMU's noise.
pub const RANGE_MIN: f64 = 0.0175;
/// Fewest points in a third of the range that give it a stiffness of its own.
pub const THIRD_MIN: f64 = 4.0;
/// Unknowns that may have any sign: kt and c.
const FREE: usize = 2;
/// The top is where this share of the largest angle is reached first.
const TOP: f64 = 0.99;
/// Rounds of the active set, at most: each takes an element in, and few leave again.
const ROUNDS: usize = 100;
/// How far from the given winding angle the shape's is looked for, as a share of it.
const SHAPES: f64 = 0.1;
/// How closely.
const SHAPE_RESOLUTION: f64 = 1e-5;
/// Largest standard uncertainty of a winding angle that is one, as a share of it.
const SHAPE_UNSURE: f64 = 0.02;
/// Gain by a further element, as a share of the whole, that is rounding.
const CHANGE: f64 = 1e-10;

/// One point at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestPoint {
    /// Angle, rad.
    pub angle: f64,
    /// Pressure, Pa.
    pub pressure: f64,
}

/// What a sweep says.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepFit {
    /// kt, N m/rad.
    pub stiffness: f64,
    /// Its standard uncertainty, N m/rad.
    pub stiffness_uncertainty: f64,
    /// The elements beside the spring.
    pub hysteresis: Hysteresis,
    /// Root mean square of what is left over, N m.
    pub residual: f64,
    /// Greatest relative deviation of kt in a third of the range of angles from that of the whole; `None` where fewer
    /// than [`THIRD_MIN`] points lie in a third.
    pub variation: Option<f64>,
    /// The points from the first turn on with their moments, in their order.
    pub points: Vec<MomentPoint>,
}

/// A point at rest as the fit sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentPoint {
    /// Angle, rad.
    pub angle: f64,
    /// Moment of the pressure, N m, positive in the FREE's own direction.
    pub moment: f64,
    /// What spring and hysteresis bear according to the fit, N m.
    pub fitted: f64,
    /// What is not the spring's of it, N m: the hysteresis and the constant moment.
    pub hysteresis: f64,
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SweepError {
    /// Too few points.
    #[error("a sweep needs at least {POINTS_MIN} points at rest from its first turn on; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("point {0} of the sweep is not finite")]
    NotFinite(usize),
    /// The FREE hardly turned.
    #[error("the FREE turned by {0:.4} rad only; at least {RANGE_MIN} rad are needed: sweep to a higher pressure")]
    NoExcitation(f64),
    /// It turned against the direction of its winding angle.
    #[error("the FREE turned by {0:.4} rad, against its winding angle: it is of the other hand, or its IMU's axis is")]
    OtherHand(f64),
    /// Only one way.
    #[error("the sweep never comes back: without a way down the hysteresis cannot be told from the stiffness")]
    OneWay,
    /// The stiffness that fits best is not positive.
    #[error("the stiffness that fits best is {0:.3e} N m/rad: wrong winding angle, sign or radius?")]
    NotPositive(f64),
    /// The model has no such FREE.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// An angle beyond the kinematics.
    #[error(transparent)]
    Equilibrium(#[from] EquilibriumError),
    /// An angle beyond the kinematics.
    #[error(transparent)]
    Domain(#[from] DomainError),
    /// The active set did not come to an end.
    #[error("the fit did not converge within {ROUNDS} rounds")]
    NotConverged,
}

/// Fits kt and the hysteresis of `free` (its geometry and axial parameters are taken as known) to `points` in the
/// order in which they were taken: up to the top first, from at most half of it.
pub fn fit_sweep(points: &[RestPoint], free: &Free) -> Result<SweepFit, SweepError> {
    if points.len() < POINTS_MIN {
        return Err(SweepError::TooFew(points.len()));
    }
    if let Some(index) = points.iter().position(|p| !(p.angle.is_finite() && p.pressure.is_finite())) {
        return Err(SweepError::NotFinite(index));
    }
    let own = free.direction();
    let highest = points.iter().map(|p| own * p.angle).fold(0.0, f64::max);
    let against = points.iter().map(|p| -own * p.angle).fold(0.0, f64::max);
    if against > highest.max(RANGE_MIN) {
        return Err(SweepError::OtherHand(-own * against));
    }
    if highest < RANGE_MIN {
        return Err(SweepError::NoExcitation(highest));
    }
    if points.last().is_none_or(|last| own * last.angle > 0.5 * highest) {
        return Err(SweepError::OneWay);
    }
    let top = points.iter().position(|p| own * p.angle >= TOP * highest).unwrap_or_default();
    let points = &points[top..];
    if points.len() < POINTS_MIN {
        return Err(SweepError::TooFew(points.len()));
    }
    let moments = moments(points, free)?;
    let thresholds = Hysteresis::grid(SHORTEST * highest, LONGEST * highest);
    // Positive thresholds and weights of one: nothing that could be refused.
    let unit = Hysteresis::new(thresholds, [1.0; ELEMENTS]).unwrap_or_default();
    let mut state = HysteresisState::default();
    unit.advance(&mut state, own * points[0].angle);
    let mut columns = DMatrix::zeros(points.len(), ELEMENTS + FREE);
    for (row, point) in points.iter().enumerate() {
        let x = own * point.angle;
        unit.advance(&mut state, x);
        (columns[(row, 0)], columns[(row, 1)]) = (x, 1.0);
        for (i, strain) in unit.strains(&state, x).into_iter().enumerate() {
            columns[(row, i + FREE)] = strain;
        }
    }
    let right = DVector::from_vec(moments);
    let solution = non_negative(&(columns.transpose() * &columns), &(columns.transpose() * &right), FREE)
        .ok_or(SweepError::NotConverged)?;
    let stiffness = solution[0];
    if stiffness <= 0.0 {
        return Err(SweepError::NotPositive(stiffness));
    }
    let left = &columns * &solution - &right;
    let used: Vec<usize> = (0..ELEMENTS + FREE).filter(|&j| j < FREE || solution[j] > 0.0).collect();
    let freedom = points.len().saturating_sub(used.len()).max(1) as f64;
    let variance = left.norm_squared() / freedom;
    let used = columns.select_columns(&used);
    let uncertainty = (used.transpose() * &used).try_inverse().map_or(f64::INFINITY, |c| (variance * c[(0, 0)]).sqrt());
    let weights = std::array::from_fn(|i| solution[i + FREE]);
    let fitted = &columns * &solution;
    let point = |(i, p): (usize, &RestPoint)| MomentPoint {
        angle: p.angle,
        moment: right[i],
        fitted: fitted[i],
        hysteresis: fitted[i] - stiffness * columns[(i, 0)],
    };
    let points: Vec<_> = points.iter().enumerate().map(point).collect();
    let variation = variation(&points, own, highest, stiffness);
    Ok(SweepFit {
        stiffness,
        stiffness_uncertainty: uncertainty.hypot(stiffness * variation.unwrap_or_default() / 3f64.sqrt()),
        hysteresis: Hysteresis::new(thresholds, weights).unwrap_or_default(),
        residual: variance.sqrt(),
        variation,
        points,
    })
}

/// The winding angle, rad, with which the fibres' moment has the shape over the angle that `points` show, and the fit
/// with it, whose kt then belongs to that angle. `None` where the points do not tell it from the angle of `free`:
/// within 10 % of that no shape fits best, or it is not known to 2 %.
///
/// What a FREE is made of is known to some per cent, and the shape is what a controller follows it by: a winding angle
/// off by 3 % costs 3 % of kt between the ends of the range. Its standard uncertainty is that of least squares with
/// residuals that are independent; kt's contains it.
pub fn fit_shape(points: &[RestPoint], free: &Free) -> Result<Option<(Measured, SweepFit)>, SweepError> {
    let given = fit_sweep(points, free)?;
    let at = |share: f64| fit_sweep(points, &Free { gamma: share * free.gamma, ..*free });
    let misfit = |share: f64| at(share).map_or(f64::INFINITY, |fit| fit.residual);
    let (mut low, mut high) = (1.0 - SHAPES, 1.0 + SHAPES);
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
    let (mut at_a, mut at_b) = (misfit(a), misfit(b));
    while high - low > SHAPE_RESOLUTION {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - golden * (high - low);
            at_a = misfit(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + golden * (high - low);
            at_b = misfit(b);
        }
    }
    let best = 0.5 * (low + high);
    let step = 0.1 * SHAPES;
    if (best - 1.0).abs() > SHAPES - step || misfit(best) >= given.residual {
        return Ok(None);
    }
    let (Ok(mut fit), Ok(less), Ok(more)) = (at(best), at(best - step), at(best + step)) else { return Ok(None) };
    let count = fit.points.len() as f64;
    // Second derivative of the sum of squares; its inverse, times twice the variance, is the share's.
    let curvature =
        count * (more.residual.powi(2) - 2.0 * fit.residual.powi(2) + less.residual.powi(2)) / (step * step);
    let unsure = (2.0 * fit.residual.powi(2) / curvature).sqrt();
    if curvature <= 0.0 || unsure.is_nan() || unsure > SHAPE_UNSURE {
        return Ok(None);
    }
    let slope = (more.stiffness - less.stiffness) / (2.0 * step);
    fit.stiffness_uncertainty = fit.stiffness_uncertainty.hypot(slope * unsure);
    let freedom = fit.points.len().saturating_sub(ELEMENTS + FREE + 1).max(1);
    let gamma = Measured { value: best * free.gamma, uncertainty: (unsure * free.gamma).abs(), freedom };
    Ok(Some((gamma, fit)))
}

/// How far the slope of the moment without the hysteresis in a third of the range lies from that of the whole.
fn variation(points: &[MomentPoint], own: f64, highest: f64, stiffness: f64) -> Option<f64> {
    let third = |n: f64| {
        let inside = |p: &&MomentPoint| (n..n + 1.0).contains(&(own * p.angle / highest * 3.0 * (1.0 - 1e-12)));
        let (mut count, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for p in points.iter().filter(inside) {
            let (angle, moment) = (own * p.angle, p.moment - p.hysteresis);
            count += 1.0;
            (x, y, xx, xy) = (x + angle, y + moment, xx + angle * angle, xy + angle * moment);
        }
        let (spread, together) = (count * xx - x * x, count * xy - x * y);
        (count >= THIRD_MIN && spread > 0.0).then(|| (together / spread / stiffness - 1.0).abs())
    };
    [0.0, 1.0, 2.0].into_iter().map(third).try_fold(0.0, |worst: f64, next| Some(worst.max(next?)))
}

/// Moment of the pressure at each point, N m, positive in the FREE's own direction.
fn moments(points: &[RestPoint], free: &Free) -> Result<Vec<f64>, SweepError> {
    let model = Lumped::new(*free, Law::Nonlinear(Kinematics::Exact))?;
    let moment = |p: &RestPoint| -> Result<f64, SweepError> {
        let rest = model.equilibrium_at_rotation(p.angle, Load::default())?;
        Ok(free.direction() * model.actuation(rest.extension, p.angle)?.moment * p.pressure)
    };
    points.iter().map(moment).collect()
}

/// Minimises x' G x / 2 - g' x with all but the first `free` x not negative: Lawson and Hanson's active set. `None`
/// where it does not come to an end.
pub(super) fn non_negative(gram: &DMatrix<f64>, right: &DVector<f64>, free: usize) -> Option<DVector<f64>> {
    let count = right.len();
    let scale = |i: usize| gram[(i, i)].sqrt();
    let largest = (0..count).filter(|&i| scale(i) > 0.0).map(|i| (right[i] / scale(i)).abs()).fold(0.0, f64::max);
    let mut x = DVector::zeros(count);
    // The first are always in use; a column of zeros never.
    let mut used: Vec<usize> = (0..free).collect();
    for _ in 0..ROUNDS {
        loop {
            let inner = gram.select_rows(&used).select_columns(&used);
            let target = right.select_rows(&used);
            let wanted = inner.cholesky()?.solve(&target);
            let blocks = |k: &usize| used[*k] >= free && wanted[*k] <= 0.0;
            let step =
                (0..used.len()).filter(blocks).map(|k| x[used[k]] / (x[used[k]] - wanted[k])).fold(1.0, f64::min);
            for (k, &i) in used.iter().enumerate() {
                x[i] += step * (wanted[k] - x[i]);
            }
            if step >= 1.0 && !(0..used.len()).any(|k| blocks(&k)) {
                break;
            }
            // Who came down to zero leaves; at least one has.
            let spent = |i: usize| i >= free && x[i] * scale(i) <= 1e-14 * largest;
            let left: Vec<_> = used.iter().copied().filter(|&i| !spent(i)).collect();
            (0..count).filter(|i| !left.contains(i)).for_each(|i| x[i] = 0.0);
            if left.len() == used.len() {
                return None;
            }
            used = left;
        }
        let gain = right - gram * &x;
        let relative = |i: usize| gain[i] / scale(i);
        let next = (0..count)
            .filter(|i| !used.contains(i) && scale(*i) > 0.0 && relative(*i) > CHANGE * largest)
            .max_by(|&a, &b| relative(a).total_cmp(&relative(b)));
        match next {
            Some(i) => used.push(i),
            None => return Some(x),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const PSI: f64 = 6894.757293168;

    fn truth() -> Hysteresis {
        let thresholds = [0.006, 0.013, 0.03, 0.05, 0.09, 0.14, 0.2, 0.31];
        let weights = [0.02, 0.01, 0.012, 0.0, 0.008, 0.004, 0.0, 0.002];
        Hysteresis::new(thresholds, weights).unwrap()
    }

    /// Two cycles, the first of them not down to zero, of a FREE with `stiffness` and elements that are not on the
    /// fit's grid, with `noise` (rad) in turn up and down.
    fn sweep(free: &Free, stiffness: f64, noise: f64) -> Vec<RestPoint> {
        let (hysteresis, mut state) = (truth(), HysteresisState::default());
        let model = Lumped::new(*free, Law::Nonlinear(Kinematics::Exact)).unwrap();
        let own = free.direction();
        let course = (0..=40).chain((10..40).rev()).chain(11..=40).chain((0..40).rev());
        let angles: Vec<f64> = course.map(|i| 0.03 * f64::from(i)).collect();
        let mut points = Vec::new();
        for (i, x) in angles.into_iter().enumerate() {
            hysteresis.advance(&mut state, x);
            let rest = model.equilibrium_at_rotation(own * x, Load::default()).unwrap();
            let per_pascal = own * model.actuation(rest.extension, own * x).unwrap().moment;
            let pressure = (stiffness * x + hysteresis.moment(&state, x)) / per_pascal;
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            points.push(RestPoint { angle: own * x + sign * noise, pressure });
        }
        points
    }

    #[test]
    fn stiffness_and_loop_of_l_and_r_frees_come_back() {
        for gamma in [-40f64, 40.0] {
            let free = Free { gamma: gamma.to_radians(), ..Free::paper() };
            // The stiffness is not the one that the model starts from.
            let fit = fit_sweep(&sweep(&free, 0.093, 0.0), &free).unwrap();
            // Thresholds on another grid: the loop is piecewise linear, and so is what is left over.
            assert!((fit.stiffness / 0.093 - 1.0).abs() < 0.01, "{fit:?}");
            let hysteresis = truth();
            assert!((fit.hysteresis.saturation() / hysteresis.saturation() - 1.0).abs() < 0.1, "{fit:?}");
            assert!(fit.residual < 0.02 * hysteresis.saturation(), "{fit:?}");
            assert!(fit.variation.unwrap() < 0.02, "{:?}", fit.variation);
        }
    }

    #[test]
    fn a_winding_angle_that_is_off_is_found_by_the_shape() {
        for gamma in [-40f64, 40.0] {
            let free = Free { gamma: gamma.to_radians(), ..Free::paper() };
            let points = sweep(&free, 0.093, 1e-4);
            for off in [0.95, 1.04] {
                let believed = Free { gamma: off * free.gamma, ..free };
                let (found, fit) = fit_shape(&points, &believed).unwrap().unwrap();
                assert!((found.value - free.gamma).abs() < 3.0 * found.uncertainty, "{found:?}");
                assert!((fit.stiffness - 0.093).abs() < 3.0 * fit.stiffness_uncertainty, "{fit:?}");
                assert!(found.uncertainty < 0.01 * free.gamma.abs(), "{found:?}");
                assert!(fit.residual < 0.5 * fit_sweep(&points, &believed).unwrap().residual);
            }
            // Too far off to be believed.
            assert_eq!(fit_shape(&points, &Free { gamma: 0.8 * free.gamma, ..free }).unwrap(), None);
        }
    }

    #[test]
    fn a_stiffness_that_depends_on_the_angle_is_seen() {
        let free = Free::paper();
        let mut points = sweep(&free, 0.086, 0.0);
        let highest = points.iter().map(|p| p.angle).fold(0.0, f64::max);
        // 5 % more moment at the end of the range: the slope there is 10 % more than at rest, 3 % more than on average.
        points.iter_mut().for_each(|p| p.pressure *= 1.0 + 0.05 * p.angle / highest);
        let fit = fit_sweep(&points, &free).unwrap();
        assert!((0.02..0.06).contains(&fit.variation.unwrap()), "{:?}", fit.variation);
    }

    #[test]
    fn noise_shows_in_the_uncertainty() {
        let free = Free::paper();
        let quiet = fit_sweep(&sweep(&free, 0.086, 1e-5), &free).unwrap();
        let noisy = fit_sweep(&sweep(&free, 0.086, 3e-3), &free).unwrap();
        assert!(noisy.stiffness_uncertainty > 3.0 * quiet.stiffness_uncertainty);
        assert!((noisy.stiffness - 0.086).abs() < 3.0 * noisy.stiffness_uncertainty + 0.01 * 0.086, "{noisy:?}");
    }

    #[test]
    fn what_says_nothing_is_refused_by_name() {
        let free = Free::paper();
        let good = sweep(&free, 0.086, 0.0);
        assert_eq!(fit_sweep(&good[..5], &free), Err(SweepError::TooFew(5)));
        assert_eq!(fit_sweep(&good[..41], &free), Err(SweepError::OneWay));
        let still: Vec<_> = good.iter().map(|p| RestPoint { angle: 1e-3 * p.angle, ..*p }).collect();
        assert!(matches!(fit_sweep(&still, &free), Err(SweepError::NoExcitation(_))));
        let other: Vec<_> = good.iter().map(|p| RestPoint { angle: -p.angle, ..*p }).collect();
        let turned = good.iter().map(|p| p.angle).fold(0.0, f64::max);
        assert_eq!(fit_sweep(&other, &free), Err(SweepError::OtherHand(-turned)));
        let mut broken = good.clone();
        broken[7].pressure = f64::NAN;
        assert_eq!(fit_sweep(&broken, &free), Err(SweepError::NotFinite(7)));
        let wrong: Vec<_> = good.iter().map(|p| RestPoint { pressure: -p.pressure - PSI, ..*p }).collect();
        assert!(matches!(fit_sweep(&wrong, &free), Err(SweepError::NotPositive(_))));
    }
}

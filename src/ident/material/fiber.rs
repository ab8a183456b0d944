//! EA of a fibre from force against strain: a line through the origin, after a toe where there is one.
//!
//! A twisted or slack fibre begins softly. Where two lines that meet, the first through the origin, explain the points
//! better than one by four standard deviations for each further parameter, the first is the toe and EA is the slope of
//! the second. A fibre that softens instead slips in its grips or breaks, and is refused.

use thiserror::Error;

use super::laws::range;
use crate::ident::Measured;
use crate::ident::least_squares::{Least, least_squares};

/// Fewest points, and fewest beyond a toe.
pub const POINTS_MIN: usize = 10;
/// Fewest points on either side of the end of a toe.
pub const SIDE_MIN: usize = 3;
/// Largest residual, as a share of the range of forces.
pub const RESIDUAL_MAX: f64 = 0.05;
/// Ends of a toe from which a fit begins, as shares of the largest strain.
const STARTS: [f64; 8] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.55, 0.7, 0.85];

/// A point of a fibre's tensile test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FiberPoint {
    /// Elongation over length at rest.
    pub strain: f64,
    /// Force of one fibre, N.
    pub force: f64,
}

/// The soft beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Toe {
    /// Strain at which it ends.
    pub end: Measured,
    /// Force per strain within it, N.
    pub stiffness: Measured,
    /// Strain at which the line beyond it would begin: the slack.
    pub slack: f64,
}

/// What a fibre's test says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FiberFit {
    /// EA, N per unit strain.
    pub stiffness: Measured,
    /// The toe, where there is one.
    pub toe: Option<Toe>,
    /// Root mean square of what is left over, N.
    pub residual: f64,
    /// Points.
    pub points: usize,
}

impl FiberFit {
    /// Force at `strain`, N.
    pub fn force(&self, strain: f64) -> f64 {
        match self.toe {
            None => self.stiffness.value * strain,
            Some(Toe { end, stiffness, .. }) => {
                stiffness.value * strain.min(end.value) + self.stiffness.value * (strain - end.value).max(0.0)
            }
        }
    }
}

/// Why there is no fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FiberError {
    /// Too few points.
    #[error("EA needs at least {POINTS_MIN} points; there are {0}")]
    TooFew(usize),
    /// A number that is none.
    #[error("point {0} of the fibre's test is not finite")]
    NotFinite(usize),
    /// Never pulled.
    #[error("the largest strain is {0:.4}: the fibre was not pulled")]
    NotPulled(f64),
    /// EA is not positive.
    #[error("EA is {0:.3} N per unit strain: it must be positive")]
    NotPositive(f64),
    /// Softer beyond a strain.
    #[error(
        "beyond the strain {strain:.4} the fibre has {beyond:.3} N per unit strain, before it {before:.3}: it slips or breaks"
    )]
    Yields {
        /// Where.
        strain: f64,
        /// Stiffness before, N.
        before: f64,
        /// Stiffness beyond, N.
        beyond: f64,
    },
    /// No line.
    #[error("{residual:.3} N are left over, {share:.3} of the range; at most {RESIDUAL_MAX} may be: this is no line")]
    NoLine {
        /// Residual, N.
        residual: f64,
        /// The same over the range of forces.
        share: f64,
    },
    /// No minimum was found.
    #[error("no line through the origin fits the points")]
    NotConverged,
}

/// Fits EA.
pub fn fit_fiber(points: &[FiberPoint]) -> Result<FiberFit, FiberError> {
    if points.len() < POINTS_MIN {
        return Err(FiberError::TooFew(points.len()));
    }
    if let Some(index) = points.iter().position(|p| !(p.strain.is_finite() && p.force.is_finite())) {
        return Err(FiberError::NotFinite(index));
    }
    let longest = points.iter().map(|p| p.strain).fold(f64::NEG_INFINITY, f64::max);
    if longest <= 0.0 {
        return Err(FiberError::NotPulled(longest));
    }
    let forces = range(points.iter().map(|p| p.force));
    let scale = (forces / longest).max(f64::MIN_POSITIVE);
    let line = |x: &[f64]| Some(points.iter().map(|p| x[0] * p.strain - p.force).collect());
    let plain = least_squares(&[scale], &[scale], line).ok_or(FiberError::NotConverged)?;
    let floor = 1e-9 * forces;
    let toe = two_lines(points, longest, scale).filter(|two| two.score(floor) < plain.score(floor));
    let (stiffness, residual) =
        toe.as_ref().map_or((plain.measured(0), plain.deviation()), |two| (two.measured(0), two.deviation()));
    if let Some(two) = &toe {
        let (beyond, before, strain) = (two.parameters[0], two.parameters[1], two.parameters[2]);
        if beyond < before {
            return Err(FiberError::Yields { strain, before, beyond });
        }
    }
    if stiffness.value <= 0.0 {
        return Err(FiberError::NotPositive(stiffness.value));
    }
    let share = residual / forces;
    if share > RESIDUAL_MAX {
        return Err(FiberError::NoLine { residual, share });
    }
    let toe = toe.map(|two| {
        let (end, soft) = (two.measured(2), two.measured(1));
        Toe { end, stiffness: soft, slack: end.value * (1.0 - soft.value / stiffness.value) }
    });
    Ok(FiberFit { stiffness, toe, residual, points: points.len() })
}

/// EA, the toe's stiffness and its end.
fn two_lines(points: &[FiberPoint], longest: f64, scale: f64) -> Option<Least> {
    let residuals = |x: &[f64]| {
        let (stiff, soft, end) = (x[0], x[1], x[2]);
        let below = points.iter().filter(|p| p.strain < end).count();
        let inside = end > 0.0 && below >= SIDE_MIN && points.len() - below >= SIDE_MIN;
        let force = |e: f64| soft * e.min(end) + stiff * (e - end).max(0.0);
        inside.then(|| points.iter().map(|p| force(p.strain) - p.force).collect())
    };
    let fits = STARTS.iter().filter_map(|share| {
        least_squares(&[scale, 0.5 * scale, share * longest], &[scale, scale, 0.1 * longest], residuals)
    });
    fits.min_by(|a, b| a.sum.total_cmp(&b.sum))
}

//! Which FREE to build: what free and blocked ones of many designs do under pressure, and which is best at what.
//!
//! The paper's Fig. 8 asks it of the winding angle, at a length of 175 mm: most rotation at 50 deg, most extension at
//! 80 deg, most blocked force at 20 deg, most blocked moment at 30 deg. Every design is one [`crate::fem::section`] of
//! a long FREE: the ends are not in it.

use rayon::prelude::*;

use crate::fem::ends::{Ends, Equilibrium};
use crate::fem::section::{Limit, SectionError, curve_within};
use crate::fem::tube::Tube;

/// One design under the pressures asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Design {
    /// The tube.
    pub tube: Tube,
    /// Free, by pressure; none past the limit.
    pub free: Vec<Option<Equilibrium>>,
    /// Where a free FREE's path ends, if it does within the pressures.
    pub free_limit: Option<Limit>,
    /// Blocked, by pressure; none past the limit.
    pub blocked: Vec<Option<Equilibrium>>,
    /// Where a blocked FREE's path ends, if it does within the pressures.
    pub blocked_limit: Option<Limit>,
    /// Pressure (Pa) beyond which the rubber of the blocked one may fold at the strip's end: what stands there is of
    /// rubber that has not, and so is the error ([`crate::fem::section::Curve::folds_beyond`]).
    pub folds_beyond: Option<f64>,
    /// Largest estimated relative discretisation error of both.
    pub error: f64,
}

/// What is wanted of a FREE at one pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aim {
    /// Rotation of the free end, either way.
    Rotation,
    /// Extension of the free end.
    Extension,
    /// Force on the support of a blocked end, either way.
    Force,
    /// Moment on the support of a blocked end, either way.
    Moment,
}

impl Aim {
    /// Every one.
    pub const ALL: [Aim; 4] = [Aim::Rotation, Aim::Extension, Aim::Force, Aim::Moment];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Aim::Rotation => "rotation",
            Aim::Extension => "extension",
            Aim::Force => "force",
            Aim::Moment => "moment",
        }
    }

    /// How far `design` gets at the pressure of that index: rad/m, strain, N or N m; none past its limit.
    pub fn of(self, design: &Design, index: usize) -> Option<f64> {
        let free = || design.free.get(index).copied().flatten();
        let blocked = || design.blocked.get(index).copied().flatten();
        match self {
            Aim::Rotation => free().map(|e| e.twist.abs()),
            Aim::Extension => free().map(|e| e.stretch - 1.0),
            Aim::Force => blocked().map(|e| e.force.abs()),
            Aim::Moment => blocked().map(|e| e.moment.abs()),
        }
    }
}

/// Computes `tubes` at `pressures`, Pa, increasing, to the relative discretisation error `tolerance`, on every core;
/// `done` is told of each.
///
/// # Errors
/// The first tube that is none, or whose path fails otherwise than at a limit.
pub fn designs(
    tubes: &[Tube],
    pressures: &[f64],
    tolerance: f64,
    done: impl Fn() + Sync,
) -> Result<Vec<Design>, SectionError> {
    let one = |tube: &Tube| {
        let design = design(tube, pressures, tolerance);
        done();
        design
    };
    tubes.par_iter().map(one).collect()
}

/// One design, as [`designs`].
///
/// # Errors
/// No tube, or a path that fails otherwise than at a limit.
pub fn design(tube: &Tube, pressures: &[f64], tolerance: f64) -> Result<Design, SectionError> {
    let Path { points: free, limit: free_limit, error: free_error, .. } = path(tube, pressures, Ends::FREE, tolerance)?;
    let Path { points: blocked, limit: blocked_limit, error, folds_beyond } =
        path(tube, pressures, Ends::BLOCKED, tolerance)?;
    let error = free_error.max(error);
    Ok(Design { tube: *tube, free, free_limit, blocked, blocked_limit, folds_beyond, error })
}

struct Path {
    points: Vec<Option<Equilibrium>>,
    limit: Option<Limit>,
    error: f64,
    folds_beyond: Option<f64>,
}

fn path(tube: &Tube, pressures: &[f64], ends: Ends, tolerance: f64) -> Result<Path, SectionError> {
    let curve = curve_within(tube, pressures, ends, tolerance)?;
    let (error, folds_beyond, mut limit) = (curve.error.unwrap_or(0.0), curve.folds_beyond, None);
    let mut points = Vec::with_capacity(pressures.len());
    for point in curve.points {
        points.push(match point {
            Ok(found) => Some(found),
            Err(SectionError::BeyondLimit { limit: end, .. }) => {
                limit = Some(end);
                None
            }
            Err(error) => return Err(error),
        });
    }
    Ok(Path { points, limit, error, folds_beyond })
}

/// The design that gets farthest with `aim` at the pressure of that index; none where no design has an equilibrium.
pub fn best(designs: &[Design], aim: Aim, index: usize) -> Option<&Design> {
    let reach = |d: &&Design| aim.of(d, index).filter(|x| x.is_finite());
    designs.iter().filter(|d| reach(d).is_some()).max_by(|a, b| {
        let (a, b) = (reach(a).unwrap_or(f64::NEG_INFINITY), reach(b).unwrap_or(f64::NEG_INFINITY));
        a.total_cmp(&b)
    })
}

/// Where the extension of a free FREE changes its sign at the pressure of that index, in the parameter `of` of the
/// designs, by linear interpolation between neighbours.
pub fn neutral(designs: &[Design], index: usize, of: impl Fn(&Design) -> f64) -> Option<f64> {
    designs.windows(2).find_map(|pair| {
        let (a, b) = (Aim::Extension.of(&pair[0], index)?, Aim::Extension.of(&pair[1], index)?);
        (a != b && a * b <= 0.0).then(|| of(&pair[0]) + (of(&pair[1]) - of(&pair[0])) * a / (a - b))
    })
}

//! Discretisation error: estimated against a finer mesh, and a mesh chosen for a wanted error.
//!
//! [`Mesh::level`] 2 n divides every element of level n in two both ways. Smooth fields would leave a sixteenth of the
//! resultants' error; the traction's jump at the strip's end leaves about a quarter. With half of it at most,
//!
//! ```text
//!     |u_n - u| <= |u_n - u_2n| + |u_2n - u| <= |u_n - u_2n| + |u_n - u| / 2
//! ```
//!
//! so twice the difference between the levels bounds the error of the coarser one. Errors grow along a curve, and are
//! related to its largest state ([`crate::fem::measure`]): the finer mesh solves the last one only, starting from the
//! coarser one's solution. A difference may vanish by accident: the estimate has a floor, which falls with the
//! element's size squared.
//!
//! **Folds.** A blocked tube's rubber folds at the strip's end, where the traction jumps, and the pressure of that is one
//! of the mesh ([`super::LimitKind::Folding`]): a finer one folds earlier, one that is blunt there not at all. What a fold
//! does is local: passed by arc length on a mesh with 5 um at the strip's end, the stable branch behind it has 0.2 %
//! (30 deg) to 0.8 % (60 deg) less force than the one before goes on to have. So where a mesh folds and a blunter one
//! does not, the blunter one's equilibrium is the answer; its error is the spread over the two meshes, but at least what
//! a fold takes, and [`Curve::folds_beyond`] says from where on that is so.

use super::fields::Fields;
use super::mesh::Grid;
use super::newton::Workspace;
use super::path::free;
use super::{Limit, LimitKind, Mesh, Points, Section, SectionError};
use crate::fem::ends::{End, Ends, Equilibrium};
use crate::fem::measure::difference;
use crate::fem::tube::Tube;

/// Finest level that is tried.
const FINEST: usize = 4;
/// Estimate over the difference from the next level.
const SAFETY: f64 = 2.0;
/// Error below which level 1 is not believed to be, whatever the difference says: it may vanish by accident. Chosen, and
/// large: of twenty seeded tubes at a moderate pressure level 1 leaves 0.005 % of free motion and 0.08 % of blocked load in
/// the median, against level 4, and twice the difference was never below 0.92 of that.
const LEAST: f64 = 5e-4;

/// Least error of an equilibrium beyond the fold of a finer mesh: what the fold may take (see the module).
const FOLDED: f64 = 1e-2;

/// A curve of equilibria and how far they are from converged ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Equilibria, or why there is none, at the pressures asked for.
    pub points: Vec<Result<Equilibrium, SectionError>>,
    /// Estimated relative error of the equilibria, as [`crate::fem::measure`] has it; none where no second mesh has any
    /// of them.
    pub error: Option<f64>,
    /// Magnitude of the pressure (Pa) up to which a finer mesh has the equilibria, too, where beyond it the rubber folds
    /// at the strip's end on some of the meshes ([`folds`]) and not on others.
    pub folds_beyond: Option<f64>,
    /// The mesh; equilibria beyond its own fold are those of [`Mesh::blunt`].
    pub mesh: Mesh,
    /// Line fibres: the answers hold for this mesh, and no finer one converges.
    pub mesh_dependent: bool,
}

impl Mesh {
    /// Graded meshes of rising density, from 1, the default. For the reference tube level 1 leaves up to 0.05 % of free
    /// motion and 0.4 % of blocked force, level 2 a third of it.
    pub fn level(level: usize) -> Mesh {
        Mesh::Graded { strip: level, growth: 4.0_f64.powf(1.0 / level as f64) }
    }

    /// Level 1 of `tube` without the ring and the column of elements next to the strip's end: too blunt for the fold.
    pub fn blunt(tube: &Tube) -> Mesh {
        let grid = Grid::new(tube, Mesh::level(1));
        let fewer = |count: usize| count.saturating_sub(1).max(1);
        let (radial, gap) = (fewer(grid.radii.len() - 1), fewer(grid.angles.len() - 1 - grid.strip_columns));
        Mesh::Counted { radial, strip: 1, gap, growth: 4.0 }
    }
}

/// Equilibria of `tube` at `pressures`, Pa, on the coarsest mesh whose estimated error is at most `tolerance`
/// (relative, 1e-4 to 0.5), or on the finest there is, with the error that it has. A mesh that folds at the strip's end
/// where a coarser one does not is not taken; where level 1 folds, the blunt mesh answers.
pub fn curve_within(tube: &Tube, pressures: &[f64], ends: Ends, tolerance: f64) -> Result<Curve, SectionError> {
    if !(1e-4..=0.5).contains(&tolerance) {
        return Err(SectionError::Tolerance(tolerance));
    }
    // Line fibres do not converge: refining would only cost.
    let mesh_dependent = tube.fiber_width == 0.0;
    // A tube that is held both ways seldom has another limit than a fold, whose search the blunt mesh spares.
    let held = matches!((ends.axial, ends.torsion), (End::Held(_), End::Held(_)));
    let mut section = Section::new(tube, Mesh::level(1))?;
    let (mut points, mut fields) = section.walk(pressures, ends, !held)?;
    let mut blunt: Option<Points> = None;
    if points.iter().any(|point| matches!(point, Err(SectionError::PathEnds { .. })) || folded(point)) {
        let others = blunt_walk(tube, pressures, ends)?;
        let covered = points.iter().zip(&others).all(|(point, other)| point.is_ok() || other.is_ok());
        if held && !covered {
            (points, fields) = section.walk(pressures, ends, true)?;
        }
        blunt = Some(others);
    }
    let (mut level, mut coarser): (usize, Option<Curve>) = (1, None);
    loop {
        if let Some(coarser) = coarser.take_if(|coarser| folds_earlier(&points, &coarser.points)) {
            return Ok(coarser);
        }
        let finer = Section::new(tube, Mesh::level(2 * level))?;
        let checked = finer.check(&section, &points, &fields, ends)?;
        let reached = checked.map_or(0.0, |(pressure, _)| pressure);
        // The finer mesh would be refused.
        let folds = reached < last(&points) && !points.iter().any(balloons);
        let mut error = checked.map(|(_, apart)| (SAFETY * apart).max(LEAST / (level * level) as f64));
        let mut folds_beyond = None;
        if (folds || blunt.is_some()) && !mesh_dependent {
            let others = match blunt.take() {
                Some(others) => others,
                None => blunt_walk(tube, pressures, ends)?,
            };
            let pairs: Vec<_> = (points.iter().flatten().zip(others.iter()))
                .filter_map(|(point, other)| Some((other.as_ref().ok()?.into(), point.into())))
                .collect();
            let spread = (!pairs.is_empty()).then(|| (SAFETY * difference(tube, ends, &pairs)).max(FOLDED));
            for (point, other) in points.iter_mut().zip(others) {
                if folded(point) || matches!(point, Err(SectionError::PathEnds { .. })) && other.is_ok() {
                    *point = other.or(*point);
                }
            }
            if reached < last(&points) {
                folds_beyond = Some(reached);
                error = error.into_iter().chain(spread).reduce(f64::max).filter(|_| spread.is_some());
            }
        }
        let curve = Curve { points, error, folds_beyond, mesh: section.mesh, mesh_dependent };
        if mesh_dependent || folds || level == FINEST || curve.error.is_none_or(|error| error <= tolerance) {
            return Ok(curve);
        }
        coarser = Some(curve);
        section = finer;
        level *= 2;
        (points, fields) = section.walk(pressures, ends, true)?;
    }
}

fn blunt_walk(tube: &Tube, pressures: &[f64], ends: Ends) -> Result<Points, SectionError> {
    Ok(Section::new(tube, Mesh::blunt(tube))?.walk(pressures, ends, false)?.0)
}

/// Where the rubber of `tube` folds on the way to `up_to`, Pa: on the blunt mesh, on level 1 and on level 2; none where it
/// does not. The pressures are properties of the meshes.
pub fn folds(tube: &Tube, ends: Ends, up_to: f64) -> Result<[(Mesh, Option<Limit>); 3], SectionError> {
    let meshes = [Mesh::blunt(tube), Mesh::level(1), Mesh::level(2)];
    let mut found = meshes.map(|mesh| (mesh, None));
    for (mesh, limit) in &mut found {
        let end = Section::new(tube, *mesh)?.limit_pressure(ends, up_to)?;
        *limit = end.filter(|limit| limit.kind == LimitKind::Folding);
    }
    Ok(found)
}

fn folded(point: &Result<Equilibrium, SectionError>) -> bool {
    matches!(point, Err(SectionError::BeyondLimit { limit, .. }) if limit.kind == LimitKind::Folding)
}

/// Whether the rubber of the finer mesh folds at the strip's end where the coarser one has an equilibrium.
fn folds_earlier(finer: &[Result<Equilibrium, SectionError>], coarser: &[Result<Equilibrium, SectionError>]) -> bool {
    finer.iter().zip(coarser).any(|(finer, coarser)| match finer {
        Err(SectionError::BeyondLimit { limit, .. }) => limit.kind == LimitKind::Folding && coarser.is_ok(),
        _ => false,
    })
}

/// Whether the pressure has a maximum before this point: a finer mesh may have it a little earlier.
fn balloons(point: &Result<Equilibrium, SectionError>) -> bool {
    matches!(point, Err(SectionError::BeyondLimit { limit, .. }) if limit.kind == LimitKind::Pressure)
}

/// Largest magnitude of a pressure that has an equilibrium.
fn last(points: &[Result<Equilibrium, SectionError>]) -> f64 {
    points.iter().flatten().map(|e| e.pressure.abs()).fold(0.0, f64::max)
}

impl Section {
    /// Magnitude of the largest pressure of `points`, of the section `coarser`, at which this finer one has the
    /// equilibrium, too, and how far the two are apart. Where the last one is not found, two thirds of the way to it
    /// are tried, and so on.
    fn check(
        &self,
        coarser: &Section,
        points: &[Result<Equilibrium, SectionError>],
        fields: &[Option<Fields>],
        ends: Ends,
    ) -> Result<Option<(f64, f64)>, SectionError> {
        let mut stable: Vec<(&Equilibrium, &Fields)> = points
            .iter()
            .zip(fields)
            .filter_map(|(point, fields)| Some((point.as_ref().ok()?, fields.as_ref()?)))
            .collect();
        // At rest every mesh is exact.
        stable.retain(|(point, _)| point.pressure != 0.0);
        stable.sort_by(|a, b| a.0.pressure.abs().total_cmp(&b.0.pressure.abs()));
        let mut workspace = Workspace::new(&self.sector);
        while let Some((coarse, fields)) = stable.last() {
            let conditions = self.conditions(coarse.pressure, ends)?;
            let start = self.sector.interpolated(&coarser.sector, fields);
            let found = workspace.solve(&self.sector, start, conditions);
            if let Some(solution) = found.filter(|found| found.stable(free(&conditions))) {
                let fine = self.outcome(&solution);
                let apart = difference(&self.tube, ends, &[((*coarse).into(), (&fine).into())]);
                return Ok(Some((coarse.pressure.abs(), apart)));
            }
            stable.truncate(2 * stable.len() / 3);
        }
        Ok(None)
    }
}

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
//! Where the finer mesh folds before ([`super::LimitKind::Folding`] depends on the mesh), it knows nothing of that
//! state, and the estimate is made farther down; the states beyond have none.

use super::fields::Fields;
use super::newton::Workspace;
use super::path::free;
use super::{LimitKind, Mesh, Section, SectionError};
use crate::fem::ends::{Ends, Equilibrium};
use crate::fem::measure::difference;
use crate::fem::tube::Tube;

/// Finest level that is tried.
const FINEST: usize = 4;
/// Estimate over the difference from the next level.
const SAFETY: f64 = 2.0;
/// Error below which level 1 is not believed to be, whatever the difference says: it may vanish by accident.
const LEAST: f64 = 5e-4;

/// A curve of equilibria and how far they are from converged ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Equilibria, or why there is none, at the pressures asked for.
    pub points: Vec<Result<Equilibrium, SectionError>>,
    /// Estimated relative error of the equilibria below `unchecked`, as [`crate::fem::measure`] has it; none where a
    /// finer mesh has none of them.
    pub error: Option<f64>,
    /// Magnitude of the pressure (Pa) beyond which the equilibria have no estimate, since a finer mesh folds before:
    /// they depend on the mesh.
    pub unchecked: Option<f64>,
    /// The mesh.
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
}

/// Equilibria of `tube` at `pressures`, Pa, on the coarsest mesh whose estimated error is at most `tolerance`
/// (relative, 1e-4 to 0.5), or on the finest there is, with the error that it has. A mesh that folds at the strip's end
/// where a coarser one does not is not taken.
pub fn curve_within(tube: &Tube, pressures: &[f64], ends: Ends, tolerance: f64) -> Result<Curve, SectionError> {
    if !(1e-4..=0.5).contains(&tolerance) {
        return Err(SectionError::Tolerance(tolerance));
    }
    // Line fibres do not converge: refining would only cost.
    let mesh_dependent = tube.fiber_width == 0.0;
    let mut section = Section::new(tube, Mesh::level(1))?;
    let mut coarser: Option<Curve> = None;
    let mut level = 1;
    loop {
        let (points, fields) = section.walk(pressures, ends)?;
        if let Some(coarser) = coarser.take_if(|coarser| folds_earlier(&points, &coarser.points)) {
            return Ok(coarser);
        }
        let finer = Section::new(tube, Mesh::level(2 * level))?;
        let checked = finer.check(&section, &points, &fields, ends, tolerance / SAFETY)?;
        // The finer mesh would be refused.
        let folds = checked.is_none_or(|(pressure, _)| pressure < last(&points)) && !points.iter().any(balloons);
        let curve = Curve {
            error: checked.map(|(_, apart)| (SAFETY * apart).max(LEAST / (level * level) as f64)),
            unchecked: unchecked(&points, checked.map(|(pressure, _)| pressure)),
            points,
            mesh: section.mesh,
            mesh_dependent,
        };
        if mesh_dependent || folds || level == FINEST || curve.error.is_none_or(|error| error <= tolerance) {
            return Ok(curve);
        }
        coarser = Some(curve);
        section = finer;
        level *= 2;
    }
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

/// `checked`, if there are equilibria beyond it.
fn unchecked(points: &[Result<Equilibrium, SectionError>], checked: Option<f64>) -> Option<f64> {
    let checked = checked.unwrap_or(0.0);
    (last(points) > checked).then_some(checked)
}

impl Section {
    /// Magnitude of the largest pressure of `points`, of the section `coarser`, at which this finer one has the
    /// equilibrium, too, and how far the two are apart. Where the last one is not found, two thirds of the way to it
    /// are tried, and so on, to where the two are no more than `wanted` apart: near its fold the finer mesh is off,
    /// too.
    fn check(
        &self,
        coarser: &Section,
        points: &[Result<Equilibrium, SectionError>],
        fields: &[Option<Fields>],
        ends: Ends,
        wanted: f64,
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
        let (mut first, mut complete) = (None, true);
        while let Some((coarse, fields)) = stable.last() {
            let conditions = self.conditions(coarse.pressure, ends)?;
            let start = self.sector.interpolated(&coarser.sector, fields);
            let found = workspace.solve(&self.sector, start, conditions);
            if let Some(solution) = found.filter(|found| found.stable(free(&conditions))) {
                let fine = self.outcome(&solution);
                let apart = difference(&self.tube, ends, &[((*coarse).into(), (&fine).into())]);
                let found = (coarse.pressure.abs(), apart);
                if complete || apart <= wanted {
                    return Ok(Some(found));
                }
                first = first.or(Some(found));
            }
            complete = false;
            stable.truncate(2 * stable.len() / 3);
        }
        Ok(first)
    }
}

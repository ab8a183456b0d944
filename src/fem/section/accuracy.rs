//! Discretisation error: estimated from two meshes, and a mesh chosen for a wanted error.
//!
//! From one level of [`Mesh::level`] to the next every length is divided further; the traction's jump at the strip's end
//! takes the smooth solution's order away, and what is left is about 2. The difference between two levels is then the
//! error of the coarser one, and more than that of the finer one, which is what is returned.

use super::{LimitKind, Mesh, Section, SectionError};
use crate::fem::ends::{Ends, Equilibrium};
use crate::fem::tube::Tube;

/// Finest level that is tried.
const FINEST: usize = 8;

/// A curve of equilibria and how far they are from converged ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Equilibria, or why there is none, at the pressures asked for.
    pub points: Vec<Result<Equilibrium, SectionError>>,
    /// Estimated relative error of each point: the largest of those of (stretch - 1, twist Ro), of (force, moment / Ro)
    /// and of the mean radius's growth, each as a vector. None past a limit, or where the coarser mesh has none.
    pub errors: Vec<Option<f64>>,
    /// The mesh.
    pub mesh: Mesh,
    /// Line fibres: the answers hold for this mesh, and no finer one converges.
    pub mesh_dependent: bool,
}

impl Curve {
    /// The largest estimated relative error.
    pub fn error(&self) -> Option<f64> {
        self.errors.iter().flatten().copied().reduce(f64::max)
    }
}

impl Mesh {
    /// Graded meshes of rising density, from 1, the default. For the reference tube level 1 leaves 0.03 % of free motion and
    /// 0.4 % of blocked force (1 % at 80 deg), level 2 about a third of it; wide strips need level 2.
    pub fn level(level: usize) -> Mesh {
        Mesh::Graded { strip: level, growth: 4.0_f64.powf(1.0 / level as f64) }
    }
}

/// Equilibria of `tube` at `pressures`, Pa, on the coarsest mesh whose estimated error is at most `tolerance`
/// (relative, 1e-4 to 0.5), or on the finest there is, with the error that it has. A mesh that folds at the strip's end where
/// a coarser one does not (folding depends on the mesh) is not taken.
pub fn curve_within(tube: &Tube, pressures: &[f64], ends: Ends, tolerance: f64) -> Result<Curve, SectionError> {
    if !(1e-4..=0.5).contains(&tolerance) {
        return Err(SectionError::Tolerance(tolerance));
    }
    // Line fibres do not converge: refining would only cost.
    let mesh_dependent = tube.fiber_width == 0.0;
    let mut coarse = Section::new(tube, Mesh::level(1))?.curve(pressures, ends)?;
    let mut level = 2;
    loop {
        let mesh = Mesh::level(level);
        let points = Section::new(tube, mesh)?.curve(pressures, ends)?;
        let errors: Vec<Option<f64>> = (points.iter().zip(&coarse))
            .map(|(fine, coarse)| Some(difference(tube, fine.as_ref().ok()?, coarse.as_ref().ok()?)))
            .collect();
        // Where the finer mesh folds at the strip's end, it knows less than the coarser: the fold is the mesh's own.
        if points.iter().zip(&coarse).any(|(fine, coarse)| folds(fine) && coarse.is_ok()) {
            return Ok(Curve { points: coarse, errors, mesh: Mesh::level(level - 1), mesh_dependent });
        }
        let curve = Curve { points, errors, mesh, mesh_dependent };
        if mesh_dependent || level == FINEST || curve.error().is_none_or(|error| error <= tolerance) {
            return Ok(curve);
        }
        coarse = curve.points;
        level += 1;
    }
}

/// Whether the rubber has folded at the strip's end before the pressure asked for.
fn folds(point: &Result<Equilibrium, SectionError>) -> bool {
    matches!(point, Err(SectionError::BeyondLimit { limit, .. }) if limit.kind == LimitKind::Folding)
}

/// Relative difference of two equilibria, see [`Curve::errors`].
fn difference(tube: &Tube, fine: &Equilibrium, coarse: &Equilibrium) -> f64 {
    let ro = tube.outer_radius();
    let groups = |e: &Equilibrium| {
        [[e.stretch - 1.0, e.twist * ro], [e.force, e.moment / ro], [e.outer_radius_mean / ro - 1.0, 0.0]]
    };
    // Below this (no load at all, say), a difference is round-off.
    let stiffness = tube.law.shear_modulus() * ro * ro;
    let floor = [1e-9, 1e-9 * stiffness, 1e-9];
    (groups(fine).iter().zip(&groups(coarse)).zip(floor))
        .map(|((a, b), floor)| {
            let change = (a[0] - b[0]).hypot(a[1] - b[1]);
            if change < floor { 0.0 } else { change / a[0].hypot(a[1]).max(floor) }
        })
        .fold(0.0, f64::max)
}

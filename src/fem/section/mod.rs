//! A long FREE as one section: helical generalised plane strain with discrete fibres, any finite strain.
//!
//! # Theory
//!
//! A long tube with n helical fibres under pressure, extension and twist keeps a continuous screw symmetry. In the
//! fibre-convected angle `psi = Theta - w Z`, `w = tan G / Ro`, a fibre is a point of the cross-section, and
//!
//! ```text
//!     x(R, Theta, Z) = Q(theta) d(R, psi) + lam Z e_z,      theta = Theta + tau Z
//! ```
//!
//! with Q a turn about the axis and d the position in the frame that turns along: at rest d = (R, 0, 0). The
//! potential per reference length, with d 2 pi / n periodic in psi,
//!
//! ```text
//!     Pi(lam, tau, d) = int Psi(F) R dR dpsi + n EA <(lf - 1)^2> / (2 cos G) - P V
//!     lf = cos G sqrt(r^2 (w + tau)^2 + lam^2),    V = 1/2 int_inner r^2 [lam theta_psi - (w + tau) z_psi] dpsi
//! ```
//!
//! is stationary in d under det F = 1, and `dPi/dlam`, `dPi/dtau` are what the ends apply. `<>` is the average over the
//! arc that a fibre of finite width covers: a line load on a solid has no answer that converges with the mesh.
//!
//! Half a turn about the radius through a fibre maps the tube onto itself and leaves lam and tau alone; the
//! equilibrium that grows from rest has that symmetry, so half a sector is solved. That nothing breaks it is checked
//! by the inertia of the opposite class of fields.
//!
//! # Elements
//!
//! Nine-node quadrilaterals in (R, psi) for d, discontinuous linear pressures, 3 x 3 Gauss points, sizes graded to the
//! strip's end; fields converge with order 3, energies and resultants faster where the solution is smooth. The
//! tangent is factorised as a band, and everything about (lam, tau, P) follows from the one factorisation.
//!
//! # Limits
//!
//! Rubber softens: the pressure of a free FREE has a maximum. A blocked FREE folds at the strip's end, where the
//! traction jumps; both end the path from rest with [`SectionError::BeyondLimit`], which names the pressure. No state
//! is returned whose second variation is not positive definite, nor one that a step has reached across a fold.
//!
//! **Forces and moments below a fold converge with the mesh, the fold's pressure does so only in part.** Of the
//! reference tube blocked, on the levels 1, 2, 4 and 8, each of which divides the elements of the one before, and on
//! the [sharp](Mesh::sharp) mesh, psi:
//!
//! | winding | 1 | 2 | 4 | 8 | sharp |
//! | --- | --- | --- | --- | --- | --- |
//! | 20 deg | 10.4 | 9.7 | 10.4 | 10.4 | 9.3 |
//! | 30 deg | 8.3 | 7.9 | 8.1 | 8.1 | 7.1 |
//! | 40 deg | 9.5 | 6.7 | 5.9 | 5.7 | 5.6 |
//! | 60 deg | 10.0 | 6.3 | 4.2 | 3.3 | 4.2 |
//! | 80 deg | 11.6 | 6.3 | 3.8 | 2.8 | 3.9 |
//!
//! Up to 40 deg it converges; from 60 deg on it goes on falling as the elements at the strip's end do: there the jump
//! of the traction turns the surface by the logarithm of the distance, without bound, and some ring of elements is
//! always small enough to fold. Meshes without small elements there hold the rubber up: on the [blunt](Mesh::blunt)
//! mesh it goes on to 10 psi at all of these angles, within 1 % of the reference. Of the reference's mesh its 2 306
//! unknowns are known, those of 6 x 24 elements a sector. Such meshes fold between 7.2 and 8.2 psi at 60 deg, over the
//! grade of their elements (the reference: 7.69), and between 6.2 and 8.5 psi at 30 deg, where the reference goes on to
//! 10: its forces bend off there between 8 and 9 psi, by half a per cent at 10.
//!
//! The path turns back at a fold in pressure and volume alike, so that no other control parameter carries on with it.
//! The tube [snaps](Section::snapped) into another equilibrium. Next to the fold that bears 0.1 to 1 % less where
//! fibres are steep and the mesh is fine (40 to 80 deg, level 4 and sharp; level 2: 1 to 5 %), 3 to 7 % less where they
//! are not (20 and 30 deg), and farther on, fold after fold, up to a fifth less at 10 psi, as seeded tubes do: by
//! amounts of the mesh, and of rubber that may pass through itself. So [`curve_within`] answers with the branch that
//! has not folded, says from where on other meshes have lost it, and [`folds`] has where, and what they bear then.

mod accuracy;
mod assembly;
mod band;
mod bending;
mod error;
mod fields;
mod mesh;
mod newton;
mod path;
mod phased;
mod reach;
mod saddle;
mod snap;
#[cfg(test)]
mod tests;

pub use accuracy::{Curve, Fold, curve_within, folds};
pub use bending::Bending;
pub use error::{Limit, LimitKind, SectionError};
pub use mesh::Mesh;

use std::f64::consts::PI;

use nalgebra::{Matrix3, Vector3};

use self::fields::{Fields, Sector};
use self::newton::{Condition, Solution, Workspace};
use super::ends::{End, Ends, Equilibrium};
use super::tube::Tube;

/// Halvings of the pressure's interval in which a broken symmetry is found.
const BISECTIONS: usize = 12;

type Points = Vec<Result<Equilibrium, SectionError>>;

/// A tube and its mesh, ready to be solved.
#[derive(Clone, Debug)]
pub struct Section {
    sector: Sector,
    mesh: Mesh,
    tube: Tube,
}

/// An equilibrium of a [`Section`], from which the next one is reached.
#[derive(Clone, Debug)]
pub struct State {
    solution: Solution,
    workspace: Workspace,
}

impl Section {
    /// The section of `tube` on `mesh`.
    pub fn new(tube: &Tube, mesh: Mesh) -> Result<Section, SectionError> {
        Ok(Section { sector: Sector::new(tube, mesh)?, mesh, tube: *tube })
    }

    /// The section with its fibres smeared into a layer all round, `radial` elements through the wall: a problem in R
    /// alone. Good for free motion (twist a few per cent too large), useless for blocked force; far cheaper.
    pub fn smeared(tube: &Tube, radial: usize) -> Result<Section, SectionError> {
        let share = 2.0 * PI * tube.outer_radius() / tube.fibers as f64;
        Section::new(&Tube { fiber_width: share, ..*tube }, Mesh::Counted { radial, strip: 1, gap: 1, growth: 1.0 })
    }

    /// The mesh.
    pub fn mesh(&self) -> Mesh {
        self.mesh
    }

    /// The tube.
    pub fn tube(&self) -> &Tube {
        &self.tube
    }

    /// Unknowns: positions and pressures of half a sector.
    pub fn unknowns(&self) -> usize {
        self.sector.even.iter().filter(|fixed| !**fixed).count() + 3 * self.sector.points.len()
    }

    /// The tube at rest.
    pub fn rest(&self) -> Result<State, SectionError> {
        let mut workspace = Workspace::new(&self.sector);
        let held = [Condition::Held(1.0), Condition::Held(0.0), Condition::Held(0.0)];
        let solution = workspace.solve(&self.sector, self.sector.rest(), held).ok_or(SectionError::Singular(0.0))?;
        Ok(State { solution, workspace })
    }

    /// Takes `state` to the gauge pressure `pressure`, Pa, and to `ends`, on the straight path in pressure, loads and
    /// held values. On an error `state` stays at the last stable equilibrium found.
    pub fn advance(&self, state: &mut State, pressure: f64, ends: Ends) -> Result<Equilibrium, SectionError> {
        self.go(state, pressure, ends, true)
    }

    /// [`Section::advance`]; without `search` a path that ends is given up early, and its limit not looked for.
    fn go(&self, state: &mut State, pressure: f64, ends: Ends, search: bool) -> Result<Equilibrium, SectionError> {
        let goal = self.conditions(pressure, ends)?;
        let before = state.solution.clone();
        let State { solution, workspace } = state;
        // Where only the pressure moves, its limit can be searched by volume.
        let ends_move = (0..2).any(|k| match goal[k] {
            Condition::Held(value) => value != solution.fields.globals[k],
            Condition::Conjugate(value) => (value - solution.conjugate[k]).abs() > 1e-7,
        });
        match path::follow(&self.sector, workspace, solution, goal, ends_move) {
            path::End::Reached => {}
            path::End::Stopped(fraction) if ends_move || !search => {
                let pressure = self.pressure_of(solution);
                return Err(SectionError::PathEnds { fraction, pressure });
            }
            path::End::Stopped(_) => {
                let target = pressure / self.tube.law.shear_modulus();
                if let Some(limit) = path::search(&self.sector, workspace, solution, goal, target) {
                    return Err(self.beyond(pressure, limit));
                }
                // Volume control has come within a step of the pressure.
                if let path::End::Stopped(_) = path::follow(&self.sector, workspace, solution, goal, true) {
                    let limit = Limit { pressure: solution.fields.globals[2], kind: LimitKind::Folding };
                    return Err(self.beyond(pressure, limit));
                }
            }
        }
        let Some(mut kind) = self.broken(state)? else { return Ok(self.equilibrium(state)) };
        // Between the state before and this one the symmetry breaks: bisection finds where.
        let mut above = pressure / self.tube.law.shear_modulus();
        let mut stable = before;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (stable.fields.globals[2] + above);
            let goal = [goal[0], goal[1], Condition::Held(middle)];
            state.solution = stable.clone();
            if let path::End::Stopped(_) =
                path::follow(&self.sector, &mut state.workspace, &mut state.solution, goal, true)
            {
                break;
            }
            match self.broken(state)? {
                None => stable = state.solution.clone(),
                Some(found) => (kind, above) = (found, middle),
            }
        }
        state.solution = stable;
        Err(self.beyond(pressure, Limit { pressure: above, kind }))
    }

    /// How the symmetry of the equilibrium at `state`, just solved, breaks, if it does.
    fn broken(&self, state: &mut State) -> Result<Option<LimitKind>, SectionError> {
        let State { solution, workspace } = state;
        if workspace.saddle.factorise(&workspace.assembly.stiffness, &self.sector.odd) != Some(0) {
            return Ok(Some(LimitKind::Asymmetric));
        }
        // Inner pressure holds a tube round; outer pressure makes it collapse.
        if solution.fields.globals[2] >= 0.0 {
            return Ok(None);
        }
        Ok(self.waves(state)?.map(LimitKind::Waves))
    }

    /// Equilibrium at the gauge pressure `pressure`, Pa (negative allowed), reached from rest.
    pub fn solve(&self, pressure: f64, ends: Ends) -> Result<Equilibrium, SectionError> {
        self.advance(&mut self.rest()?, pressure, ends)
    }

    /// Equilibria at `pressures`, Pa, each reached from the one before. Those beyond a limit get its error.
    pub fn curve(&self, pressures: &[f64], ends: Ends) -> Result<Vec<Result<Equilibrium, SectionError>>, SectionError> {
        Ok(self.walk(pressures, ends, true)?.0)
    }

    /// [`Section::curve`] with the fields of every equilibrium; without `search` the points beyond the end of a path
    /// are [`SectionError::PathEnds`], which costs a tenth.
    fn walk(&self, pressures: &[f64], ends: Ends, search: bool) -> Result<(Points, Vec<Option<Fields>>), SectionError> {
        let mut state = self.rest()?;
        let mut limits: [Option<Limit>; 2] = [None, None];
        let mut given_up: [Option<SectionError>; 2] = [None, None];
        let (mut points, mut fields) = (Vec::with_capacity(pressures.len()), Vec::with_capacity(pressures.len()));
        for &pressure in pressures {
            let side = usize::from(pressure < 0.0);
            let known = limits[side].filter(|limit| pressure.abs() >= limit.pressure.abs());
            let point = match (known, given_up[side]) {
                (Some(limit), _) => Err(SectionError::BeyondLimit { pressure, limit }),
                (None, Some(error)) => Err(error),
                (None, None) => self.go(&mut state, pressure, ends, search),
            };
            match point {
                Err(SectionError::BeyondLimit { limit, .. }) => limits[side] = Some(limit),
                Err(error) if !search => given_up[side] = Some(error),
                _ => {}
            }
            fields.push(point.is_ok().then(|| state.solution.fields.clone()));
            points.push(point);
        }
        Ok((points, fields))
    }

    /// The end of the path from rest towards `up_to`, Pa (negative searches downwards); None if it goes on to there.
    pub fn limit_pressure(&self, ends: Ends, up_to: f64) -> Result<Option<Limit>, SectionError> {
        match self.advance(&mut self.rest()?, up_to, ends) {
            Ok(_) => Ok(None),
            Err(SectionError::BeyondLimit { limit, .. }) => Ok(Some(limit)),
            Err(error) => Err(error),
        }
    }

    /// The answer at `state`.
    pub fn equilibrium(&self, state: &State) -> Equilibrium {
        self.outcome(&state.solution)
    }

    fn outcome(&self, solution: &Solution) -> Equilibrium {
        let (mu, ro, copies) = (self.tube.law.shear_modulus(), self.tube.outer_radius(), self.sector.copies);
        // Units of (stretch, twist, pressure); the energy per length is in mu Ro^2.
        let unit = Vector3::new(1.0, 1.0 / ro, mu);
        let energy = mu * ro * ro * copies;
        let conjugate = solution.conjugate.component_div(&unit) * energy;
        let tangent = Matrix3::from_fn(|i, j| solution.hessian[(i, j)] * energy / (unit[i] * unit[j]));
        let [stretch, twist, pressure] = solution.fields.globals;
        Equilibrium {
            pressure: pressure * mu,
            stretch,
            twist: twist / ro,
            force: -conjugate.x,
            moment: -conjugate.y,
            volume: -conjugate.z,
            outer_radius_mean: self.sector.mean_outer_radius(&solution.fields) * ro,
            outer_radius_at_fiber: self.sector.radius_at(&solution.fields, self.sector.rings() - 1) * ro,
            tangent,
        }
    }

    /// The potential `Pi` at `state`, J per reference metre, gas included.
    pub fn potential(&self, state: &State) -> f64 {
        let (mu, ro) = (self.tube.law.shear_modulus(), self.tube.outer_radius());
        state.solution.energy * self.sector.copies * mu * ro * ro
    }

    fn pressure_of(&self, solution: &Solution) -> f64 {
        solution.fields.globals[2] * self.tube.law.shear_modulus()
    }

    fn beyond(&self, pressure: f64, limit: Limit) -> SectionError {
        let limit = Limit { pressure: limit.pressure * self.tube.law.shear_modulus(), ..limit };
        SectionError::BeyondLimit { pressure, limit }
    }

    fn conditions(&self, pressure: f64, ends: Ends) -> Result<[Condition; 3], SectionError> {
        if !pressure.is_finite() {
            return Err(SectionError::Pressure(pressure));
        }
        let (mu, ro, copies) = (self.tube.law.shear_modulus(), self.tube.outer_radius(), self.sector.copies);
        let condition = |end: End, held: f64, load: f64| match end {
            End::Held(value) => (value.is_finite(), Condition::Held(value * held)),
            End::Loaded(value) => (value.is_finite(), Condition::Conjugate(value * load)),
        };
        let load = 1.0 / (mu * ro * ro * copies);
        let (axial_finite, axial) = condition(ends.axial, 1.0, load);
        let (torsion_finite, torsion) = condition(ends.torsion, ro, load / ro);
        let positive = !matches!(ends.axial, End::Held(stretch) if stretch <= 0.0);
        if axial_finite && torsion_finite && positive {
            Ok([axial, torsion, Condition::Held(pressure / mu)])
        } else {
            Err(SectionError::Ends(ends))
        }
    }
}

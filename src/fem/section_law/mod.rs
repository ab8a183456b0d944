//! What a rod is made of, taken from the section with its discrete fibres: the two meet here.
//!
//! The potential psi0 of a straight piece at held stretch and twist under pressure is what a [`Section`] minimises; a
//! [`Table`] of it over all that the FREEs of a module can reach is the rod's law, exact for straight rods of any
//! finite strain. Bending and shear are the second variation about such states ([`Section::bending`]), as polynomials
//! of stretch, twist and pressure. Pressure enters through these potentials and nowhere else.
//!
//! A FREE and its mirror image share one table, kept for the right-handed one.

mod bytes;
mod sample;

pub use bytes::BytesError;

use std::sync::Arc;

use nalgebra::Vector2;
use rayon::prelude::*;
use thiserror::Error;

use self::sample::{Probe, Row};
use super::ends::{End, Ends, Equilibrium};
use super::linear::LinearSection;
use super::rod::{Axis, Grid, Law, Profile, Straight, Table, TableError};
use super::section::{Mesh, Section, SectionError};
use super::tube::{Tube, TubeError};

/// Points of the grid along twist and pressure, and along the stretch to either side of rest.
const POINTS: [usize; 2] = [9, 9];
const BESIDE: usize = 3;
/// Halvings of the grid's spacing along the stretch until a tube at rest bears to be pulled by two of it.
const HALVINGS: i32 = 2;

/// Half of the grid's range of stretches, and what is added to it per stretch under the highest pressure, which is no
/// linear function of the pressure.
const REACH: f64 = 0.05;
const BEND: f64 = 0.25;

/// Share of the states at rest that a law has at a pressure that it reaches.
const REACHED: f64 = 0.9;

/// Closed, free to stretch, held from turning.
const UNTWISTED: Ends = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };

/// What a law is wanted for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// The tube, of either hand.
    pub tube: Tube,
    /// The section's mesh.
    pub mesh: Mesh,
    /// Highest gauge pressure, Pa; the lowest is 0.
    pub pressure: f64,
    /// Largest twist either way, rad per reference metre.
    pub twist: f64,
}

/// Why there is no law.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SectionLawError {
    /// Pressure or twist out of range.
    #[error("{what} of a law is {value}: {rule}")]
    Range {
        /// What.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The rule.
        rule: &'static str,
    },
    /// No tube.
    #[error(transparent)]
    Tube(#[from] TubeError),
    /// The section.
    #[error(transparent)]
    Section(#[from] SectionError),
    /// The table.
    #[error(transparent)]
    Table(#[from] TableError),
}

/// The law of a tube's section.
#[derive(Clone, Debug)]
pub struct SectionLaw {
    request: Request,
    table: Arc<Table>,
    /// EI, GA and q of the right-handed tube, see [`Law`].
    lateral: [Profile; 3],
    errors: Errors,
}

/// How far a law may be from the section's, and the section from a converged one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Largest error of interpolation in the middles of some cells: of the stretch that a given load makes.
    pub stretch: f64,
    /// The same of the twist, rad/m.
    pub twist: f64,
    /// States between the grid's points that were compared.
    pub states: usize,
    /// The mesh's relative error of what a blocked tube does at half of the pressure, or at a quarter or an eighth
    /// where one of the meshes compared folds before; infinite where it has folded by then, too.
    pub mesh: f64,
    /// Largest relative error of EI in those states. A section that is about to give way sideways has hardly an EI
    /// left, and falls to it too steeply for a polynomial.
    pub bending: f64,
    /// The one that nine of ten of them do not exceed.
    pub mostly: f64,
}

impl Request {
    /// Checks everything; the tube becomes the right-handed one of its pair.
    fn validated(self) -> Result<Request, SectionLawError> {
        let range = |what, value, rule| Err(SectionLawError::Range { what, value, rule });
        let tube = self.tube.validated()?;
        if !(self.pressure > 0.0 && self.pressure.is_finite()) {
            return range("the highest pressure (Pa)", self.pressure, "must be positive and finite");
        }
        if !(self.twist > 0.0 && self.twist.is_finite()) {
            return range("the largest twist (rad/m)", self.twist, "must be positive and finite");
        }
        Ok(Request { tube: Tube { gamma: tube.gamma.abs(), ..tube }, ..self })
    }
}

/// The grid of `request`: about the states that a section held from turning, but free to stretch, has under pressure,
/// since that is what the others of a module make of a FREE.
fn grid(request: &Request, section: &Section) -> Result<Grid, SectionLawError> {
    let stiffness = LinearSection::new(&request.tube)?.stiffness;
    let mut state = section.rest()?;
    // Its stretch at the highest pressure, or at half of it, or at a quarter.
    let mut slope = 0.0;
    for share in [0.25, 0.5, 1.0] {
        let pressure = share * request.pressure;
        let Some(found) = section.reach(&mut state, pressure, UNTWISTED)? else { break };
        slope = (found.stretch - 1.0) / pressure;
    }
    let reach = REACH + BEND * (slope * request.pressure).abs();
    let [twist, pressure] = POINTS;
    let (mut spacing, mut steps) = (reach / BESIDE as f64, BESIDE);
    for _ in 0..HALVINGS {
        // Steep fibres sink into a tube that is pulled by some per cent; a cell that reaches beyond is lost.
        let pulled = Ends { axial: End::Held(1.0 + 2.0 * spacing), torsion: End::Held(0.0) };
        if section.reach(&mut section.rest()?, 0.0, pulled)?.is_some() {
            break;
        }
        (spacing, steps) = (0.5 * spacing, 2 * steps);
    }
    Ok(Grid {
        stretch: Axis { from: 1.0 - reach, to: 1.0 + reach, points: 2 * steps + 1 },
        twist: Axis { from: -request.twist, to: request.twist, points: twist },
        pressure: Axis { from: 0.0, to: request.pressure, points: pressure },
        skew: [-stiffness[(0, 1)] / stiffness[(0, 0)], slope],
    })
}

impl SectionLaw {
    /// Solves the section on the grid of `request`.
    ///
    /// # Errors
    /// Where the tube or the ranges are none, or no cell of the grid has accepted states.
    pub fn build(request: &Request) -> Result<SectionLaw, SectionLawError> {
        let request = request.validated()?;
        let section = Section::new(&request.tube, request.mesh)?;
        let grid = grid(&request, &section)?;
        let rows: Vec<Row> = (0..grid.twist.points)
            .into_par_iter()
            .map(|j| Row::sample(&section, &grid, j))
            .collect::<Result<_, _>>()?;
        let mut states = vec![None; grid.points()];
        for (j, row) in rows.iter().enumerate() {
            for (i, k, jet) in &row.states {
                states[grid.index([*i, j, *k])] = Some(*jet);
            }
        }
        let table = Table::new(grid, &states)?;
        let linear = LinearSection::new(&request.tube)?;
        let samples: Vec<_> = rows.iter().flat_map(|row| &row.lateral).copied().collect();
        let lateral = Profile::fitted(&grid, &samples).ok_or(TableError::Empty)?;
        let mut errors = Errors { mesh: mesh_error(&request, &section)?, ..Errors::default() };
        let probes = || rows.iter().flat_map(|row| &row.probes);
        let mut off: Vec<f64> = probes().map(|probe| (lateral[0].at(probe.at) / probe.bending - 1.0).abs()).collect();
        off.sort_by(f64::total_cmp);
        errors.bending = off.last().copied().unwrap_or(f64::INFINITY);
        errors.mostly = off.get(9 * off.len() / 10).copied().unwrap_or(f64::INFINITY);
        for Probe { at: [stretch, twist, pressure], jet, .. } in probes() {
            let Ok(found) = table.jet(*stretch, *twist, *pressure) else { continue };
            let off = motion(&linear, &(found.gradient - jet.gradient).xy()).abs();
            errors.stretch = errors.stretch.max(off.x);
            errors.twist = errors.twist.max(off.y);
            errors.states += 1;
        }
        Ok(SectionLaw { request, table: Arc::new(table), lateral, errors })
    }

    /// Whether this law answers `request`, of either hand.
    pub fn serves(&self, request: &Request) -> bool {
        request.validated().is_ok_and(|request| request == self.request)
    }

    /// The law of a rod of the winding angle `gamma`, whose sign alone counts.
    pub fn law(&self, gamma: f64) -> Law {
        let [bending, shear, coupling] = self.lateral;
        Law { straight: Straight::Table(self.table.clone()), bending, shear, coupling, mirrored: gamma < 0.0 }
    }

    /// psi0.
    pub fn table(&self) -> &Table {
        &self.table
    }

    /// The law of `request` that `law` makes or keeps, or, where its rubber has folded at `pressure` Pa and does so less on
    /// the [blunt](Mesh::blunt) mesh, that mesh's: as the section itself answers beyond a fold.
    ///
    /// # Errors
    /// As `law`.
    pub fn reaching<E>(
        request: &Request,
        pressure: f64,
        mut law: impl FnMut(&Request) -> Result<SectionLaw, E>,
    ) -> Result<SectionLaw, E> {
        let usual = law(request)?;
        if usual.reaches(pressure) {
            return Ok(usual);
        }
        let blunt = law(&Request { mesh: Mesh::blunt(&request.tube), ..*request })?;
        let farther = blunt.table.coverage_at(pressure) > usual.table.coverage_at(pressure);
        Ok(if farther { blunt } else { usual })
    }

    /// Whether it has most of the states at `pressure` Pa that it has at rest. Where it has not, the rubber has folded.
    pub fn reaches(&self, pressure: f64) -> bool {
        self.table.coverage_at(pressure) >= REACHED * self.table.coverage_at(0.0)
    }

    /// How far it may be off.
    pub fn errors(&self) -> Errors {
        self.errors
    }
}

/// (stretch, twist rad/m) that `load` (N, N m) makes of the tube at rest.
fn motion(linear: &LinearSection, load: &Vector2<f64>) -> Vector2<f64> {
    linear.stiffness.lu().solve(load).unwrap_or(Vector2::repeat(f64::INFINITY))
}

/// See [`Errors::mesh`].
fn mesh_error(request: &Request, section: &Section) -> Result<f64, SectionLawError> {
    // Blunt meshes are refined where they are blunt.
    let blunt = request.mesh == Mesh::blunt(&request.tube);
    let fine = Section::new(&request.tube, if blunt { Mesh::level(2) } else { request.mesh.refined() })?;
    let linear = LinearSection::new(&request.tube)?;
    let of = |e: &Equilibrium| {
        let [stretch, twist] = motion(&linear, &Vector2::new(e.force, e.moment)).into();
        Vector2::new(stretch, twist * request.tube.outer_radius())
    };
    for share in [0.5, 0.25, 0.125] {
        let blocked = |section: &Section| section.reach(&mut section.rest()?, share * request.pressure, Ends::BLOCKED);
        if let (Some(coarse), Some(fine)) = (blocked(section)?, blocked(&fine)?) {
            return Ok((of(&coarse) - of(&fine)).norm() / of(&fine).norm());
        }
    }
    Ok(f64::INFINITY)
}

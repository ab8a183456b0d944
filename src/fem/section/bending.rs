//! Bending, shear and their coupling of the pressurised tube, and its stability against leaving the round.
//!
//! With curvature kap and shear strain gam per reference length, in fixed directions, the potential per reference
//! length grows by
//!
//! ```text
//!     EI |kap|^2 / 2 + GA |gam|^2 / 2 + C kap . gam
//! ```
//!
//! the minimum over all fields that go once round the section, at the state's stretch, twist and pressure (dead
//! pressure stiffness `-P V''` included). The axis is the section's mean position, and its turn is the mean turn
//! weighted with the distance from the axis: gam is the angle between the axis and that turn. The tube's chirality
//! makes C; for a mirror-symmetric tube it vanishes.

use nalgebra::{Matrix2, Vector2};

use super::fields::{Fields, Sector};
use super::phased::Phased;
use super::saddle::{EXACT, Saddle};
use super::{Section, SectionError, State};

/// Second derivatives of the potential per reference length by curvature and shear strain (per reference length).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bending {
    /// EI at vanishing shear strain, N m2.
    pub bending: f64,
    /// GA at vanishing curvature, N.
    pub shear: f64,
    /// C, N m; its sign follows the handedness.
    pub coupling: f64,
}

impl Bending {
    /// EI of a tube that is bent by a moment alone: the shear strain follows freely, `EI - C^2 / GA`. N m2.
    pub fn pure_bending(&self) -> f64 {
        self.bending - self.coupling * self.coupling / self.shear
    }
}

impl Section {
    /// Bending and shear stiffness at `state`.
    pub fn bending(&self, state: &State) -> Result<Bending, SectionError> {
        let fields = &state.solution.fields;
        let form = Phased::new(&self.sector, fields, 1)?;
        let matrix = condense(&self.sector, &form).ok_or(SectionError::Singular(self.pressure_of(&state.solution)))?;
        // A quarter of the form is the energy of half a sector; EI is twice the energy at unit curvature.
        let (mu, ro) = (self.tube.law.shear_modulus(), self.tube.outer_radius());
        let unit = 0.5 * self.sector.copies * mu * ro * ro;
        Ok(Bending {
            bending: matrix[(0, 0)] * unit * ro * ro,
            shear: matrix[(1, 1)] * unit,
            coupling: matrix[(0, 1)] * unit * ro,
        })
    }

    /// Smallest number of waves round the circumference, 2 to half the fibres, in which the section would leave the
    /// round at `state` (every section alike); None if it is stable against all of them. Two fibres have none.
    pub fn waves(&self, state: &State) -> Result<Option<usize>, SectionError> {
        waves(&self.sector, &state.solution.fields)
    }
}

pub(super) fn waves(sector: &Sector, fields: &Fields) -> Result<Option<usize>, SectionError> {
    let fibers = sector.copies as usize / 2;
    let mut saddle = Saddle::new(sector, 6);
    let fixed = Phased::fixed(sector);
    // Long waves give way first: more than four round only at walls thinner than are accepted.
    for order in 2..=(fibers / 2).min(4) {
        let form = Phased::new(sector, fields, order)?;
        if saddle.factorise(&form.stiffness, &fixed) != Some(0) {
            return Ok(Some(order));
        }
    }
    Ok(None)
}

/// The form in (curvature, shear strain), minimised over the fields without mean translation and turn.
fn condense(sector: &Sector, form: &Phased) -> Option<Matrix2<f64>> {
    let mut fixed = Phased::fixed(sector);
    // The translation costs nothing: one node holds it, and it is put right afterwards.
    fixed[0] = true;
    let mut saddle = Saddle::new(sector, 6);
    saddle.factorise(&form.stiffness, &fixed)?;
    let zero = [0.0; 6];
    let solve = |right: &[f64], strain: Option<usize>| {
        let constraint = |index: usize| strain.map_or(zero, |k| form.constraint_coupling[index][k]);
        saddle.solve(sector, &form.gradient, &fixed, right, constraint, EXACT)
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let translated = |f: &[f64]| f.chunks_exact(6).map(|node| node[0] + node[4]).sum::<f64>();
    let area = translated(&form.translation);
    let of_translation = solve(&form.translation, None);
    let of_rotation = solve(&form.rotation, None);
    let turn_by_turn = dot(&form.rotation, &of_rotation.position);

    let mut fields = Vec::with_capacity(2);
    for strain in 0..2 {
        let right = &form.coupling[strain];
        let mut x = solve(right, Some(strain));
        // Forces that hold the mean position, and the mean turn.
        let holding = -translated(right) / area;
        x.add(&of_translation, holding);
        let turning = -dot(&form.rotation, &x.position) / turn_by_turn;
        x.add(&of_rotation, turning);
        x.scale(-1.0);
        let shift = -dot(&form.translation, &x.position) / area;
        for node in x.position.chunks_exact_mut(6) {
            node[0] += shift;
            node[4] += shift;
        }
        fields.push(x);
    }
    let matrix = Matrix2::from_fn(|i, j| {
        let multipliers: f64 =
            (form.constraint_coupling.iter().zip(&fields[j].multiplier)).map(|(c, q)| dot(&c[i], q)).sum();
        form.macroscopic[i][j] + dot(&form.coupling[i], &fields[j].position) + multipliers
    });
    let symmetric = (matrix + matrix.transpose()) * 0.5;
    (symmetric * Vector2::new(1.0, 1.0)).iter().all(|x| x.is_finite()).then_some(symmetric)
}

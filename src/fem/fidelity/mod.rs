//! Which model a scene needs: the same question to every tier, and the cheapest one that answers it well enough.
//!
//! A [`Scene`] is one straight FREE at pressures, free or blocked. Its tiers, from cheap to dear:
//!
//! | tier | what it is | what it leaves out |
//! | --- | --- | --- |
//! | linear | closed-form section law ([`super::linear`]) | finite strain, discrete fibres, end effects |
//! | nonlinear | lumped equations with inextensible fibres and the law's ke and kt | the same but the fibres' turning |
//! | section | helical generalised plane strain ([`super::section`]) | end effects |
//! | solid | three-dimensional ([`super::solid`]) | |
//!
//! Two errors are told apart. The **discretisation error** is what the mesh of the tier leaves: estimated from a second
//! mesh, zero of a closed form. The **model error** is what the tier leaves out, estimated against the next one up that
//! has it: linear and nonlinear against the section, the section against the solid: of a coarse one the ends are taken
//! alone, in which most of its mesh's error cancels. Estimates are multiplied by the table's factors, which make bounds
//! of them.
//!
//! How far the estimates are from the truth is measured on seeded scenes ([`suite`]), which also give the table by
//! which cheap tiers are taken without asking a dearer one ([`certified`]).
//!
//! Errors are relative, over the scene's pressures together, in the one measure that [`super::measure`] derives. Where
//! one tier has an equilibrium and the other has none, the error is infinite.

pub mod certified;
mod choice;
mod error;
mod joined;
mod module;
pub mod suite;
mod tiers;

pub use choice::{Choice, Considered, choose};
pub use error::FidelityError;
pub use module::{SolidAnswers, dead_length, module_mesh, rods_discretisation_error, rods_model_error, solid_answers};
pub use tiers::{ask, model_error};

use super::ends::Ends;
use super::measure::{self, Outcome};
use super::solid::Station;
use super::tube::Tube;

/// A tier of the ladder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fidelity {
    /// Closed-form linear section law.
    Linear,
    /// Lumped equations with the fibres' kinematics.
    Nonlinear,
    /// Section with discrete fibres.
    Section,
    /// Three-dimensional solid.
    Solid,
}

impl Fidelity {
    /// Name on the command line and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Fidelity::Linear => "linear",
            Fidelity::Nonlinear => "nonlinear",
            Fidelity::Section => "section",
            Fidelity::Solid => "solid",
        }
    }
}

/// How the end of a single FREE is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Closed and free to move.
    Free,
    /// Closed and kept where it was at rest.
    Blocked,
}

impl Hold {
    /// As the solvers take it.
    pub fn ends(self) -> Ends {
        match self {
            Hold::Free => Ends::FREE,
            Hold::Blocked => Ends::BLOCKED,
        }
    }
}

/// One straight FREE at some pressures. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The tube.
    pub tube: Tube,
    /// Its length at rest, m.
    pub length: f64,
    /// How its end is held.
    pub hold: Hold,
    /// Gauge pressures, Pa, negative allowed.
    pub pressures: Vec<f64>,
}

/// A state at rest. SI units; twist and stretch are means over the reference length, force and moment are what the
/// FREE does to its distal support.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// rad/m.
    pub twist: f64,
    /// 1 at rest.
    pub stretch: f64,
    /// Outer radius averaged over the reference circumference (of a solid: at mid-length), m.
    pub outer_radius_mean: f64,
    /// Outer radius in the middle of a fibre, m; none where the tier does not tell it apart.
    pub outer_radius_at_fiber: Option<f64>,
    /// N.
    pub force: f64,
    /// N m.
    pub moment: f64,
}

/// One pressure of an answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// The equilibrium; none past a limit.
    pub rest: Option<Rest>,
}

/// Where the path of stable equilibria from rest ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Limit {
    /// Gauge pressure, Pa.
    pub pressure: f64,
    /// What happens there.
    pub reason: String,
}

/// What a tier says of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// The tier.
    pub fidelity: Fidelity,
    /// One for each pressure of the scene, in its order.
    pub points: Vec<Point>,
    /// The limit towards the highest pressure, or, where no pressure is positive, the lowest.
    pub limit: Option<Limit>,
    /// Estimated relative error of the tier's discretisation.
    pub discretisation_error: f64,
    /// The sections from base to tip at the farthest pressure reached; none where the tier knows no ends.
    pub profile: Vec<Station>,
}

/// Relative difference of `points` from `reference`, as [`measure::difference`] has it; infinite where one has an
/// equilibrium and the other has none, and where nothing is left to compare.
pub fn difference(points: &[Point], reference: &[Point], scene: &Scene) -> f64 {
    if points.iter().zip(reference).any(|(a, b)| a.rest.is_some() != b.rest.is_some()) {
        return f64::INFINITY;
    }
    let both = points.iter().zip(reference).filter_map(|(a, b)| Some((a.rest?.into(), b.rest?.into())));
    let both: Vec<_> = both.collect();
    if both.is_empty() && !scene.pressures.is_empty() {
        return f64::INFINITY;
    }
    measure::difference(&scene.tube, scene.hold.ends(), &both)
}

impl Answer {
    /// Whether it has any equilibrium but that at rest.
    fn moves(&self) -> bool {
        self.points.iter().any(|point| point.rest.is_some() && point.pressure != 0.0)
    }
}

impl From<Rest> for Outcome {
    fn from(rest: Rest) -> Outcome {
        let Rest { stretch, twist, force, moment, .. } = rest;
        Outcome { stretch, twist, force, moment }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(pressure: f64, rest: Option<(f64, f64)>) -> Point {
        let rest = rest.map(|(stretch, twist)| Rest {
            twist,
            stretch,
            outer_radius_mean: 5e-3,
            outer_radius_at_fiber: None,
            force: 0.0,
            moment: 0.0,
        });
        Point { pressure, rest }
    }

    #[test]
    fn a_difference_is_relative_to_the_largest_motion_and_infinite_where_one_has_no_equilibrium() {
        let tube = Tube::reference(0.7);
        let radius = tube.outer_radius();
        let scene = Scene { tube, length: 0.13, hold: Hold::Free, pressures: vec![1e4, 2e4] };
        let reference = [point(1e4, Some((1.1, 0.0))), point(2e4, Some((1.2, 0.0)))];
        let off = [point(1e4, Some((1.1, 0.02 / radius))), point(2e4, Some((1.2, 0.0)))];
        assert!((difference(&off, &reference, &scene) - 0.1).abs() < 1e-12);
        assert_eq!(difference(&reference, &reference, &scene), 0.0);
        let ended = [off[0], point(2e4, None)];
        assert_eq!(difference(&ended, &reference, &scene), f64::INFINITY);
        // Where both end before, nothing is known of either.
        let none = [point(1e4, None), point(2e4, None)];
        assert_eq!(difference(&none, &none, &scene), f64::INFINITY);
        let nothing = [point(0.0, Some((1.0, 0.0)))];
        assert_eq!(difference(&nothing, &nothing, &scene), 0.0);
    }
}

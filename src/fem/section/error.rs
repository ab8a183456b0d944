//! What a section answers where there is no equilibrium to give.

use thiserror::Error;

use super::mesh::Mesh;
use crate::fem::ends::Ends;
use crate::fem::tube::TubeError;
use crate::units::PASCAL_PER_PSI;

/// Why a path of equilibria ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LimitKind {
    /// The pressure has a maximum (or minimum) along the path: the tube balloons, or its force or moment gives way.
    Pressure,
    /// The rubber folds at the strip's end at held stretch and twist. Local, and dependent on the mesh: the traction
    /// jumps at the strip's end, so a finer mesh folds earlier, down to a third of the pressure (see the module and
    /// [`super::folds`]).
    Folding,
    /// Fields that break the symmetry about the fibre grow.
    Asymmetric,
    /// The section leaves the round: fields that go `n` times round the circumference grow.
    Waves(usize),
}

impl std::fmt::Display for LimitKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            LimitKind::Pressure => write!(f, "limit point of the pressure"),
            LimitKind::Folding => write!(f, "the rubber folds at the strip's end"),
            LimitKind::Asymmetric => write!(f, "the section turns asymmetric about its fibres"),
            LimitKind::Waves(n) => write!(f, "the section buckles with {n} waves round the circumference"),
        }
    }
}

/// Last pressure of a path of stable equilibria.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Gauge pressure, Pa: an extremum for [`LimitKind::Pressure`] and [`LimitKind::Folding`], otherwise where the
    /// symmetry breaks.
    pub pressure: f64,
    /// What happens there.
    pub kind: LimitKind,
}

/// What a section refuses.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SectionError {
    /// No tube.
    #[error(transparent)]
    Tube(#[from] TubeError),
    /// No mesh.
    #[error(
        "{0:?}: counted: radial 1 to 32, strip and gap 1 to 64, growth 1 to 8; graded: strip 1 to 16, growth 1.05 to 8"
    )]
    Mesh(Mesh),
    /// The wanted error is out of range.
    #[error("wanted relative error {0}: must be between 1e-4 and 0.5")]
    Tolerance(f64),
    /// The pressure is not a finite number.
    #[error("pressure {0} Pa: must be finite")]
    Pressure(f64),
    /// A load is not finite, or a held stretch not positive.
    #[error("{0:?}: loads and twists must be finite, a held stretch positive")]
    Ends(Ends),
    /// There is no stable equilibrium at this pressure on the path from rest.
    #[error(
        "no stable equilibrium at {:.4} psi: {} at {:.4} psi; stay below it",
        .pressure / PASCAL_PER_PSI, .limit.kind, .limit.pressure / PASCAL_PER_PSI
    )]
    BeyondLimit {
        /// Pressure asked for, Pa.
        pressure: f64,
        /// Where and how the path from rest ends.
        limit: Limit,
    },
    /// The path, along which held ends or loads move, too, ends before its goal.
    #[error(
        "no stable equilibrium beyond {:.1} % of the way from the state before (at {:.4} psi): go there in smaller \
         steps, or on another path", .fraction * 100.0, .pressure / PASCAL_PER_PSI
    )]
    PathEnds {
        /// Part of the way that was gone, 0 to 1.
        fraction: f64,
        /// Pressure there, Pa.
        pressure: f64,
    },
    /// The rubber was turned inside out.
    #[error("the rubber is turned inside out")]
    Inverted,
    /// The second variation is singular: bending has no answer at this state.
    #[error("the second variation is singular at {:.4} psi: the state is a critical one", .0 / PASCAL_PER_PSI)]
    Singular(f64),
}

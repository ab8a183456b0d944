//! Rods side by side, clamped at their bases, under one rigid plate.
//!
//! Unknowns are the plate's pose, each rod's strains and the wrench at its tip. All twists and wrenches are taken in
//! the fixed frame about its origin, so that rods in parallel simply add up: with each rod condensed to its tip
//! ([`crate::fem::rod`]),
//!
//! ```text
//!     K eta = W_ext - sum(W) - ...,     K = sum(K_rod) - (brackets of the wrenches) - dW_ext
//! ```
//!
//! is one 6 x 6 system for the plate's twist eta, whose solution gives every rod's change of strains and wrench. One
//! elimination gives the state's sensitivities to each pressure and the plate's compliance.
//!
//! **Stability** is the inertia of the whole unreduced tangent: negative pivots met when eliminating the rods, beyond
//! those of the constraints, plus negative eigenvalues of K. Both are counted, so that two eigenvalues that cross zero
//! together (the module's symmetry makes them) are seen where a determinant's sign sees nothing. A dead moment has no
//! potential; then the symmetric part of K is counted.
//!
//! **No wrong branch.** From a converged state, Newton goes to the next loads only in steps whose corrections fall at
//! least by half from one to the next, which is where Newton's method is that of the branch it started from; longer
//! ways are cut. Where they become arbitrarily short there is a limit point, and the error says how far it came.
//! [`Path`] goes around it, by arc length.
//!
//! A [`ModuleScene`] is a module as it is built, with FREEs for rods; [`answer()`] is what the rods say of it.

mod answer;
mod clearance;
mod newton;
mod path;
mod scene;
mod state;

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

pub use answer::{Answer, Limit, Pose, Reason, answer};
pub(crate) use clearance::{Centreline, least_clearance};
pub use path::{Critical, Kind, Path, Point};
pub use scene::{Free, Hand, Layout, LayoutError, ModuleScene, NAMES, SceneError};
pub use state::{State, Wrench};

use super::rod::{Basis, DualMatrix, LawError, Resolution, Rod, RodError};

/// A rod and where it stands.
#[derive(Clone, Debug)]
pub struct Mount {
    /// Centre of the clamped base, m; the rod rises along z.
    pub base: Vector3<f64>,
    /// The rod.
    pub rod: Rod,
}

/// What acts on a module.
#[derive(Clone, Debug, PartialEq)]
pub struct Loads {
    /// Gauge pressure of each rod, Pa.
    pub pressures: Vec<f64>,
    /// Dead force at the plate's centre, N.
    pub force: Vector3<f64>,
    /// Dead moment on the plate, N m.
    pub moment: Vector3<f64>,
    /// Acceleration of gravity, m/s2 (z points from base to plate: a hanging module has +9.81). It acts on the plate.
    pub gravity: Vector3<f64>,
}

impl ModuleError {
    /// Whether it is a rod's law that ends, and not the module.
    pub fn is_beyond_law(&self) -> bool {
        matches!(self, ModuleError::Rod { cause: RodError::Law(LawError::OutsideTable { .. }), .. })
    }
}

/// Rods under a plate.
#[derive(Clone, Debug)]
pub struct Module {
    mounts: Vec<Mount>,
    plate_mass: f64,
    resolution: Resolution,
    basis: Basis,
    rest: Vector3<f64>,
    /// Cross-section of each rod's cavity at rest, m2.
    bores: Vec<f64>,
}

/// Why a module has no answer.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ModuleError {
    /// No rods, or one of no length, or masses that are none.
    #[error("{what} is {value}: {rule}")]
    Invalid {
        /// What.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The rule.
        rule: &'static str,
    },
    /// Another number of pressures than of rods.
    #[error("{pressures} pressures for {rods} rods: give one for each")]
    Pressures {
        /// Given.
        pressures: usize,
        /// Needed.
        rods: usize,
    },
    /// A rod's law or integration refuses.
    #[error("FREE {}: {cause}", named(*.index))]
    Rod {
        /// Which one, from 0.
        index: usize,
        /// Why.
        cause: RodError,
    },
    /// The equilibrium cannot be followed to these loads.
    #[error(
        "no equilibrium at these loads: its branch was followed over {:.3} % of the way and ends there{}",
        100.0 * .fraction, .cause.as_ref().map(|c| format!(" ({c})")).unwrap_or_default()
    )]
    Ends {
        /// Share of the way from the start to the loads, 0 to 1.
        fraction: f64,
        /// What stopped it, if not a limit point.
        cause: Option<Box<ModuleError>>,
    },
    /// Two rods touch, which the model does not describe.
    #[error(
        "FREEs {} and {} touch ({:.2} mm into each other): the model ends here; space them wider or lower the pressure",
        named(.rods[0]), named(.rods[1]), -1e3 * .clearance
    )]
    Contact {
        /// Which ones.
        rods: [usize; 2],
        /// Negative, m.
        clearance: f64,
    },
}

/// The letter of FREE `index`; of a module of more than four its number.
fn named(index: usize) -> String {
    NAMES.get(index).map_or_else(|| (index + 1).to_string(), |name| (*name).to_owned())
}

impl Loads {
    /// Nothing but these pressures, Pa.
    pub fn pressures(pressures: impl Into<Vec<f64>>) -> Loads {
        let zero = Vector3::zeros();
        Loads { pressures: pressures.into(), force: zero, moment: zero, gravity: zero }
    }

    /// `self + fraction (to - self)`; any fraction.
    pub fn towards(&self, to: &Loads, fraction: f64) -> Loads {
        let between = |a: &Vector3<f64>, b: &Vector3<f64>| a + (b - a) * fraction;
        Loads {
            pressures: self.pressures.iter().zip(&to.pressures).map(|(a, b)| a + (b - a) * fraction).collect(),
            force: between(&self.force, &to.force),
            moment: between(&self.moment, &to.moment),
            gravity: between(&self.gravity, &to.gravity),
        }
    }
}

/// The bases A, B, C, D of a square of side `spacing` m: A at (+, +), then counter-clockwise.
pub fn square(spacing: f64) -> [Vector3<f64>; 4] {
    [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(x, y)| Vector3::new(x, y, 0.0) * (0.5 * spacing))
}

impl Module {
    /// `mounts` under a plate of `plate_mass` kg, whose centre lies on the z axis at the height of the highest tip.
    pub fn new(mounts: Vec<Mount>, plate_mass: f64, resolution: Resolution) -> Result<Module, ModuleError> {
        let invalid = |what, value, rule| Err(ModuleError::Invalid { what, value, rule });
        if mounts.is_empty() {
            return invalid("the number of rods", 0.0, "at least one is needed");
        }
        for Mount { base, rod } in &mounts {
            if !(rod.length > 0.0 && rod.length.is_finite()) {
                return invalid("a rod's length (m)", rod.length, "must be positive and finite");
            }
            if !(rod.outer_radius >= 0.0 && rod.outer_radius.is_finite()) {
                return invalid("a rod's outer radius (m)", rod.outer_radius, "must be finite and not negative");
            }
            let turn = rod.rest_curvature.norm() * rod.length;
            if turn.is_nan() || turn > 3.0 {
                return invalid("a rod's turn at rest (rad)", turn, "must be at most 3");
            }
            if let Some(x) = base.iter().find(|x| !x.is_finite()) {
                return invalid("a base's coordinate (m)", *x, "must be finite");
            }
        }
        if !(plate_mass >= 0.0 && plate_mass.is_finite()) {
            return invalid("the plate's mass (kg)", plate_mass, "must be finite and not negative");
        }
        if !resolution.valid() {
            let rule = "at most 17, and below twice the number of steps (1 to 512)";
            return invalid("the strains' degree", resolution.degree as f64, rule);
        }
        let height = mounts.iter().map(|m| m.base.z + m.rod.length).fold(f64::NEG_INFINITY, f64::max);
        let rest = Vector3::new(0.0, 0.0, height);
        let bores: Result<Vec<f64>, ModuleError> = (mounts.iter().enumerate())
            .map(|(index, Mount { rod, .. })| match rod.law.jet(1.0, 0.0, 0.0) {
                Ok(jet) => Ok(-jet.gradient.z),
                Err(law) => Err(ModuleError::Rod { index, cause: law.into() }),
            })
            .collect();
        Ok(Module { mounts, plate_mass, resolution, basis: Basis::new(resolution), rest, bores: bores? })
    }

    /// The same with the plate's centre at `height` m at rest: what lies between a rod's tip and the plate is rigid.
    pub fn with_plate_at(mut self, height: f64) -> Module {
        self.rest.z = height;
        self
    }

    /// The rods.
    pub fn mounts(&self) -> &[Mount] {
        &self.mounts
    }

    /// Plate's centre at rest, m.
    pub fn rest(&self) -> Vector3<f64> {
        self.rest
    }

    /// The length that errors and clearances are measured by: the first rod's, m.
    pub fn length(&self) -> f64 {
        self.mounts[0].rod.length
    }

    /// The same with another resolution.
    pub fn with_resolution(&self, resolution: Resolution) -> Result<Module, ModuleError> {
        Ok(Module::new(self.mounts.clone(), self.plate_mass, resolution)?.with_plate_at(self.rest.z))
    }

    /// The same with rods whose bending stiffness is `factor` times theirs.
    pub fn with_bending(&self, factor: f64) -> Module {
        let mut other = self.clone();
        for Mount { rod, .. } in &mut other.mounts {
            rod.law.bending = rod.law.bending.scaled(factor);
        }
        other
    }

    /// What the plate's pose does to rod `index`'s tip: the tip's target pose.
    fn target(&self, plate: &DualMatrix, index: usize) -> DualMatrix {
        *plate * self.offset(index)
    }

    /// Where rod `index` is fixed to the plate.
    fn offset(&self, index: usize) -> DualMatrix {
        let Mount { base, rod } = &self.mounts[index];
        let offset = base + Vector3::new(0.0, 0.0, rod.length) - self.rest;
        DualMatrix::pose(nalgebra::Matrix3::identity(), &offset)
    }

    fn base(&self, index: usize) -> DualMatrix {
        DualMatrix::pose(nalgebra::Matrix3::identity(), &self.mounts[index].base)
    }
}

/// The rotation of a pose.
fn quaternion(pose: &DualMatrix) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(pose.re))
}

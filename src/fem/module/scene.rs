//! A module as it is built: FREEs, their places, the plate, what acts on it.

use std::str::FromStr;

use nalgebra::{Vector2, Vector3};
use thiserror::Error;

use super::{Loads, Module, ModuleError, Mount, square};
use crate::fem::rod::{Law, Resolution, Rod};
use crate::fem::section::Mesh;
use crate::fem::section_law::{Request, SectionLaw, SectionLawError};
use crate::fem::tube::Tube;

/// Length of the reference module's FREEs, m.
const REFERENCE_LENGTH: f64 = 0.13;
/// Distance of neighbouring axes of the reference module, m: the paper does not state it.
const REFERENCE_SPACING: f64 = 0.02;
/// The FREEs' names.
pub const NAMES: [&str; 4] = ["A", "B", "C", "D"];
/// Turn of the plate that a law covers, rad: neighbouring tubes touch before, at about 1.8.
const TURN: f64 = 2.6;

/// Handedness of a FREE.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hand {
    /// Winding angle positive: turns negative under pressure.
    Right,
    /// Its mirror image.
    Left,
}

/// Handedness of the FREEs A, B, C, D.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout(pub [Hand; 4]);

/// What is no layout.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("layout `{0}`: must be four letters R or L, the handedness of A, B, C, D (for example RLRL)")]
pub struct LayoutError(String);

/// A FREE of a module. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Free {
    /// The tube; the sign of its winding angle is its handedness.
    pub tube: Tube,
    /// Length at rest from base to plate, m.
    pub length: f64,
    /// The part of the length, half at each end, that the ends keep from moving, m: the end correction of this type of
    /// FREE, 0 unless identified; negative where ends move more than the middle.
    pub dead_length: f64,
    /// Curvature at rest about x and y, rad/m: no FREE is quite straight.
    pub rest_curvature: Vector2<f64>,
}

/// Four FREEs under a plate and what acts on it. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleScene {
    /// A at (+, +), then counter-clockwise B, C, D.
    pub frees: [Free; 4],
    /// Distance of neighbouring axes, m.
    pub spacing: f64,
    /// Mass of the plate and its payload, kg; its centre is the plate's.
    pub plate_mass: f64,
    /// Dead force at the plate's centre, N.
    pub force: Vector3<f64>,
    /// Dead moment on the plate, N m.
    pub moment: Vector3<f64>,
    /// Acceleration of gravity, m/s2; z points from base to plate, so a hanging module has +9.81.
    pub gravity: Vector3<f64>,
}

/// Why a scene is no module.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SceneError {
    /// The tubes overlap at rest.
    #[error(
        "spacing {:.2} mm: neighbouring tubes of outer radius {:.2} and {:.2} mm overlap; at least {:.2} mm",
        1e3 * .spacing, 1e3 * .radii[0], 1e3 * .radii[1], 1e3 * (.radii[0] + .radii[1])
    )]
    Spacing {
        /// m.
        spacing: f64,
        /// Of the two neighbours, m.
        radii: [f64; 2],
    },
    /// A dead length that leaves no FREE.
    #[error("dead length {dead_length} m of a FREE of {length} m: must be below half of the length, either way")]
    DeadLength {
        /// m.
        dead_length: f64,
        /// m.
        length: f64,
    },
    /// A FREE too short to be a rod.
    #[error("length {length} m: must be at least four outer radii, {least} m, and finite")]
    Length {
        /// m.
        length: f64,
        /// m.
        least: f64,
    },
    /// A FREE's law.
    #[error("FREE {}: {cause}", NAMES[*.free])]
    Law {
        /// Which one, 0 to 3.
        free: usize,
        /// Why.
        cause: SectionLawError,
    },
    /// The module.
    #[error(transparent)]
    Module(#[from] ModuleError),
}

impl Hand {
    /// `gamma` with this hand's sign.
    pub fn signed(self, gamma: f64) -> f64 {
        match self {
            Hand::Right => gamma.abs(),
            Hand::Left => -gamma.abs(),
        }
    }
}

impl Layout {
    /// Equal handedness on the diagonals.
    pub const RLRL: Layout = Layout([Hand::Right, Hand::Left, Hand::Right, Hand::Left]);
}

impl FromStr for Layout {
    type Err = LayoutError;

    fn from_str(text: &str) -> Result<Layout, LayoutError> {
        let error = || LayoutError(text.into());
        let hands: Option<Vec<Hand>> = (text.chars())
            .map(|c| match c {
                'R' => Some(Hand::Right),
                'L' => Some(Hand::Left),
                _ => None,
            })
            .collect();
        hands.ok_or_else(error)?.try_into().map(Layout).map_err(|_| error())
    }
}

impl ModuleScene {
    /// Four FREEs of `tube`, whose winding angle's magnitude counts, and `length` m in `layout`, `spacing` m apart; a
    /// massless plate, no loads, no gravity.
    pub fn new(tube: &Tube, length: f64, layout: Layout, spacing: f64) -> ModuleScene {
        let free = |hand: Hand| Free {
            tube: Tube { gamma: hand.signed(tube.gamma), ..*tube },
            length,
            dead_length: 0.0,
            rest_curvature: Vector2::zeros(),
        };
        let zero = Vector3::zeros();
        ModuleScene { frees: layout.0.map(free), spacing, plate_mass: 0.0, force: zero, moment: zero, gravity: zero }
    }

    /// The reference module: reference FREEs of the winding angle `gamma` rad, 130 mm long, RLRL, 20 mm apart.
    pub fn reference(gamma: f64) -> ModuleScene {
        ModuleScene::new(&Tube::reference(gamma), REFERENCE_LENGTH, Layout::RLRL, REFERENCE_SPACING)
    }

    /// Checks what the laws and the module do not check.
    pub fn validated(&self) -> Result<(), SceneError> {
        for (i, free) in self.frees.iter().enumerate() {
            let law = |cause: SectionLawError| SceneError::Law { free: i, cause };
            let tube = free.tube.validated().map_err(|error| law(error.into()))?;
            let (length, dead_length) = (free.length, free.dead_length);
            let least = 4.0 * tube.outer_radius();
            if !(length >= least && length.is_finite()) {
                return Err(SceneError::Length { length, least });
            }
            if !dead_length.is_finite() || dead_length.abs() >= 0.5 * length {
                return Err(SceneError::DeadLength { dead_length, length });
            }
            let radii = [tube.outer_radius(), self.frees[(i + 1) % 4].tube.outer_radius()];
            if !(self.spacing >= radii[0] + radii[1] && self.spacing.is_finite()) {
                return Err(SceneError::Spacing { spacing: self.spacing, radii });
            }
        }
        Ok(())
    }

    /// What FREE `index`'s law must cover for gauge pressures up to `pressure` Pa: twists up to where neighbours touch.
    pub fn request(&self, index: usize, mesh: Mesh, pressure: f64) -> Request {
        let Free { tube, length, dead_length, .. } = self.frees[index];
        Request { tube, mesh, pressure, twist: TURN / (length - dead_length) }
    }

    /// The module whose FREEs' laws `law` gives, once for each that differs from those before but for its hand.
    ///
    /// # Errors
    /// Where the scene is none, or a law is refused.
    pub fn module(
        &self,
        mesh: Mesh,
        pressure: f64,
        resolution: Resolution,
        mut law: impl FnMut(&Request) -> Result<SectionLaw, SectionLawError>,
    ) -> Result<Module, SceneError> {
        self.validated()?;
        let mut known: Vec<SectionLaw> = Vec::new();
        let mut laws = Vec::with_capacity(4);
        for free in 0..4 {
            let request = self.request(free, mesh, pressure);
            let found = match known.iter().find(|k| k.serves(&request)) {
                Some(found) => found,
                None => {
                    known.push(law(&request).map_err(|cause| SceneError::Law { free, cause })?);
                    &known[known.len() - 1]
                }
            };
            laws.push(found.law(self.frees[free].tube.gamma));
        }
        Ok(self.assemble(laws, resolution)?)
    }

    /// The module of FREEs of other laws than the section's.
    ///
    /// # Errors
    /// Where the scene is none.
    pub fn with_laws(&self, laws: [Law; 4], resolution: Resolution) -> Result<Module, SceneError> {
        self.validated()?;
        Ok(self.assemble(laws, resolution)?)
    }

    fn assemble(&self, laws: impl IntoIterator<Item = Law>, resolution: Resolution) -> Result<Module, ModuleError> {
        let mounts = self.frees.iter().zip(square(self.spacing)).zip(laws).map(|((free, corner), law)| {
            let outer_radius = free.tube.outer_radius();
            let (length, rest_curvature) = (free.length - free.dead_length, free.rest_curvature);
            let base = corner + Vector3::new(0.0, 0.0, 0.5 * free.dead_length);
            Mount { base, rod: Rod { length, law, rest_curvature, outer_radius } }
        });
        let height = self.frees.iter().map(|free| free.length).fold(0.0, f64::max);
        Ok(Module::new(mounts.collect(), self.plate_mass, resolution)?.with_plate_at(height))
    }

    /// The scene's loads at the gauge pressures of A, B, C, D, Pa.
    pub fn loads(&self, pressures: [f64; 4]) -> Loads {
        Loads { pressures: pressures.to_vec(), force: self.force, moment: self.moment, gravity: self.gravity }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layout_is_four_letters() {
        use Hand::{Left, Right};
        assert_eq!("RLRL".parse(), Ok(Layout::RLRL));
        assert_eq!("RRRL".parse(), Ok(Layout([Right, Right, Right, Left])));
        for wrong in ["", "RLR", "RLRLR", "rlrl", "RLRX"] {
            assert_eq!(wrong.parse::<Layout>(), Err(LayoutError(wrong.into())));
        }
    }

    #[test]
    fn what_is_no_scene_is_refused_by_name() {
        let scene = ModuleScene::reference(1.0);
        assert_eq!(scene.validated(), Ok(()));
        let touching = ModuleScene { spacing: 0.0111, ..scene.clone() };
        assert!(matches!(touching.validated(), Err(SceneError::Spacing { .. })));
        let mut scene = ModuleScene::reference(1.0);
        scene.frees[2].dead_length = 0.07;
        assert!(matches!(scene.validated(), Err(SceneError::DeadLength { .. })));
        scene.frees[2] = Free { length: 0.02, dead_length: 0.0, ..scene.frees[2] };
        assert!(matches!(scene.validated(), Err(SceneError::Length { .. })));
        scene.frees[2] = Free { tube: Tube { gamma: 0.0, ..scene.frees[2].tube }, length: 0.13, ..scene.frees[2] };
        assert!(matches!(scene.validated(), Err(SceneError::Law { free: 2, .. })));
    }
}

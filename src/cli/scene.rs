//! The module that a command computes: four FREEs of the flags under a plate.

use std::str::FromStr;

use anyhow::anyhow;
use nalgebra::Vector3;

use super::list::List;
use super::tube::TubeArgs;
use super::{Context, Failure};
use crate::config::{Cache, Rig};
use crate::fem::module::{Layout, Module, ModuleScene, SceneError};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::fem::section_law::{Errors, SectionLaw, SectionLawError};
use crate::model::GRAVITY;
use crate::units::{Acceleration, Angle, Force, Length, Mass, PASCAL_PER_PSI, Pressure};

/// Laws reach at least up to here, psi, and beyond to whole psi, so that most questions share one.
const RANGE: f64 = 10.0;
/// Distance of neighbouring axes where neither flags nor rig say it, m: the paper does not state it.
const SPACING: f64 = 0.02;

/// Flags that describe a module; its FREEs are alike but for their hands.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "The module")]
pub struct SceneArgs {
    #[command(flatten)]
    tube: TubeArgs,
    /// Distance of neighbouring FREEs, centre to centre [default: of rig.toml's module, else 20 mm]
    #[arg(long)]
    spacing: Option<Length>,
    /// Hands of A, B, C, D, R or L each: A at (+, +), then counter-clockwise about z; --gamma is the magnitude
    #[arg(long, default_value = "RLRL")]
    layout: Layout,
    /// Dead force on the plate's centre
    #[arg(long, value_name = "X,Y,Z", default_value = "0N,0N,0N", allow_hyphen_values = true)]
    force: List<Force, 3>,
    /// Gravity on the plate: hanging (towards +z), standing, none, or an acceleration such as 0m/s2,9.81m/s2,0m/s2
    #[arg(long, value_name = "HOW", default_value = "hanging", allow_hyphen_values = true)]
    gravity: Gravity,
    /// Mass of the plate and what it carries [default: of rig.toml's module, else 0 g]
    #[arg(long)]
    plate_mass: Option<Mass>,
}

/// Acceleration of gravity, m/s2.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Gravity(Vector3<f64>);

impl FromStr for Gravity {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let along = match text {
            "hanging" => 1.0,
            "standing" => -1.0,
            "none" => 0.0,
            text => {
                let List(xyz) = text.parse::<List<Acceleration, 3>>().map_err(|error| {
                    format!("{error}; or write one of: hanging (gravity towards +z), standing, none")
                })?;
                return Ok(Gravity(Vector3::from(xyz.map(Acceleration::si))));
            }
        };
        Ok(Gravity(Vector3::z() * (along * GRAVITY)))
    }
}

/// A module and how far its FREEs' laws may be from their section's.
pub struct Built {
    /// The module.
    pub module: Module,
    /// The largest of its laws.
    pub law_errors: Errors,
}

impl SceneArgs {
    /// The one module of the flags.
    pub fn scene(&self, context: &Context) -> Result<ModuleScene, Failure> {
        self.magnitudes()?;
        let (tube, length) = self.tube.tube(context)?;
        self.checked(ModuleScene::new(&tube, length, self.layout, SPACING), context)
    }

    /// A module for each winding angle of the flags.
    pub fn scenes(&self, context: &Context) -> Result<Vec<ModuleScene>, Failure> {
        self.magnitudes()?;
        let (tubes, length) = self.tube.tubes(context)?;
        let of = |tube| self.checked(ModuleScene::new(tube, length, self.layout, SPACING), context);
        tubes.iter().map(of).collect()
    }

    /// Fastest change of the pressure of the FREE of rig.toml, Pa/s.
    pub fn slew(&self, context: &Context) -> Result<f64, Failure> {
        self.tube.slew(context)
    }

    fn magnitudes(&self) -> Result<(), Failure> {
        match self.tube.gammas().iter().find(|gamma| gamma.si() < 0.0) {
            None => Ok(()),
            Some(gamma) => {
                let error = anyhow!("--gamma {gamma}: must be positive, since --layout has the hands of A, B, C, D");
                let magnitude = Angle::radians(-gamma.si()).to_string().replace(' ', "");
                let remedy = format!("write `--gamma {magnitude}`, and `--layout LRLR` for the mirror image of RLRL");
                Err(Failure::usage(error).remedy(remedy))
            }
        }
    }

    /// `scene` with all else that the flags say.
    fn checked(&self, scene: ModuleScene, context: &Context) -> Result<ModuleScene, Failure> {
        let rig = Rig::load(&context.rig)?.module;
        let plate_mass = match self.plate_mass {
            Some(mass) if mass.si() < 0.0 => {
                let error = anyhow!("--plate-mass {mass}: must not be negative");
                return Err(Failure::usage(error).remedy("give the mass of the plate with what it carries"));
            }
            given => given.map_or(rig.as_ref().map_or(0.0, |module| module.plate_mass), Mass::si),
        };
        let scene = ModuleScene {
            spacing: self.spacing.map_or(rig.as_ref().map_or(SPACING, |module| module.spacing), Length::si),
            plate_mass,
            force: Vector3::from(self.force.0.map(Force::si)),
            gravity: self.gravity.0,
            ..scene
        };
        scene.validated().map_err(refused)?;
        Ok(scene)
    }
}

/// The rods of `scene` for gauge pressures up to `highest` Pa, with laws from the cache or tabulated.
pub fn build(scene: &ModuleScene, highest: f64, context: &Context) -> Result<Built, Failure> {
    // What is a whole number of psi but for rounding stays it.
    let range = (highest / PASCAL_PER_PSI - 1e-9).ceil().max(RANGE);
    let gamma = scene.frees[0].tube.gamma.abs().to_degrees();
    context.note(format!(
        "law of the FREE of {gamma:.1} deg up to {range:.0} psi: kept from an earlier time, or tabulated now, which takes seconds"
    ));
    let cache = Cache::usual();
    let (mut law_errors, mut blunted) = (Errors::default(), false);
    let module = scene.module(Mesh::default(), Pressure::psi(range).si(), Resolution::DEFAULT, |request| {
        let law = SectionLaw::reaching(request, highest, |request| cache.section_law(request))?;
        blunted |= !law.serves(request);
        let found = law.errors();
        law_errors.stretch = law_errors.stretch.max(found.stretch);
        law_errors.twist = law_errors.twist.max(found.twist);
        law_errors.mesh = law_errors.mesh.max(found.mesh);
        law_errors.bending = law_errors.bending.max(found.bending);
        law_errors.mostly = law_errors.mostly.max(found.mostly);
        Ok(law)
    });
    if blunted {
        context.note(format!(
            "on the usual mesh the rubber folds at the fibres' edges below {:.2}; the law is of a blunter mesh, whose \
             rubber has not folded",
            Pressure::pascals(highest)
        ));
    }
    Ok(Built { module: module.map_err(refused)?, law_errors })
}

fn refused(error: SceneError) -> Failure {
    let remedy = match &error {
        SceneError::Spacing { .. } => "give a larger --spacing, or thinner FREEs",
        SceneError::Length { .. } | SceneError::DeadLength { .. } => "give a larger --length",
        SceneError::Law { cause: SectionLawError::Tube(_), .. } => "give other dimensions of the FREE",
        SceneError::Law { .. } => {
            return Failure::failed(error).remedy("ask for lower pressures, or for another FREE");
        }
        SceneError::Module(error) if error.is_beyond_law() => {
            "ask for lower pressures: the law has the highest one and eighths of it, and this FREE has no equilibria there"
        }
        SceneError::Module(_) => "give other values of the module's flags",
    };
    Failure::usage(error).remedy(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_is_a_word_or_an_acceleration_with_its_unit() {
        let of = |text: &str| text.parse::<Gravity>().map(|g| g.0);
        assert_eq!(of("hanging"), Ok(Vector3::new(0.0, 0.0, GRAVITY)));
        assert_eq!(of("standing"), Ok(Vector3::new(0.0, 0.0, -GRAVITY)));
        assert_eq!(of("-1m/s2,0m/s2,2000mm/s2"), Ok(Vector3::new(-1.0, 0.0, 2.0)));
        for wrong in ["up", "0,0,9.81", "0m/s2,9.81m/s2"] {
            let error = of(wrong).unwrap_err();
            assert!(error.contains("hanging"), "{error}");
        }
    }
}

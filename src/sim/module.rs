//! The simulated module: which FREEs its plate sits on, and how far they are from what they are meant to be.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::BenchConfig;
use super::plant::SCATTER_CUT;
use super::plate::{Plate, Swing};
use crate::fem::module::{ModuleScene, SceneError};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::fem::section_law::{Request, SectionLaw, SectionLawError};

/// What a FREE's winding angle is off by for a scatter of one, rad: a winding machine's degree for 5 %.
const ANGLE: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// FREEs under a plate.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleSim {
    /// Indices of A, B, C, D.
    pub frees: [usize; 4],
    /// The nominal module.
    pub scene: ModuleScene,
    /// Damping ratio of the plate's modes, above 0 and below 1.
    pub damping: f64,
    /// What hangs on the plate beyond its mass, kg, and nobody has said.
    pub payload: f64,
}

impl ModuleSim {
    /// The module that is really there, with its payload: wall and rubber of each FREE are off by its scatter, drawn
    /// from the bench's seed, and the winding angle by a degree where they are by 5 %. Lengths and places are measured
    /// when a module is built, and are right.
    pub fn true_scene(&self, bench: &BenchConfig) -> ModuleScene {
        let mut scene = self.scene.clone();
        scene.plate_mass += self.payload;
        for (free, &index) in scene.frees.iter_mut().zip(&self.frees) {
            let scatter = bench.plants.get(index).map_or(0.0, |plant| plant.scatter);
            let mut rng = Pcg64::seed_from_u64(bench.seed.wrapping_mul(2003).wrapping_add(index as u64));
            let mut off = || {
                let x: f64 = StandardNormal.sample(&mut rng);
                1.0 + scatter * x.clamp(-SCATTER_CUT, SCATTER_CUT)
            };
            let tube = &mut free.tube;
            tube.gamma += ANGLE * (off() - 1.0);
            tube.wall *= off();
            tube.law = tube.law.with_shear_modulus(tube.law.shear_modulus() * off());
        }
        scene
    }

    /// Its plate at rest without pressure; the FREEs' laws, by `law`, reach up to `pressure`, Pa.
    ///
    /// # Errors
    /// Where the module is none, or does not stand without pressure.
    pub fn plate(
        &self,
        bench: &BenchConfig,
        pressure: f64,
        law: impl FnMut(&Request) -> Result<SectionLaw, SectionLawError>,
    ) -> Result<Plate, SceneError> {
        let scene = self.true_scene(bench);
        let module = scene.module(Mesh::default(), pressure, Resolution::DEFAULT, law)?;
        let width = scene.frees.iter().map(|free| free.tube.outer_radius()).fold(0.0, f64::max);
        let swing = Swing { mass: scene.plate_mass, side: scene.spacing + 2.0 * width, damping: self.damping };
        Ok(Plate::new(module, scene.loads([0.0; 4]), swing)?)
    }
}

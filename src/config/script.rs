//! The answers that a person would give during a calibration, in a file.
//!
//! ```toml
//! ready = ["stiffness"]          # what has been prepared as the question says
//! weights = [                    # stiffness: hung on the end one after another, up and down
//!     { mass_g = 0 }, { mass_g = 500, pressure_psi = 2, length_mm = 131.2 },
//! ]
//! torques = [{ moment_mnm = 20, pressure_psi = 0, angle_deg = 13.1 }]
//! gauge_psi = [0, 1.02]          # regulator: what the gauge reads at every step of the staircase
//! added_inertia_kg_m2 = [3e-5]   # inertias that are added to the end, one after the other, for `damping`
//! ```
//!
//! and `[material]`, the files of a material calibration ([`super::material`]).

use std::path::Path;

use super::experiment::read_text;
use super::loads::{KnownLoad, read_torques, read_weights};
use super::material::{Material, read_material};
use super::problem::ConfigError;
use super::reader::{Section, Source};

/// What can be ready.
const STEPS: [&str; 4] = ["imu", "regulator", "stiffness", "damping"];

/// The answers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    ready: Vec<String>,
    /// Weights on the end, in their order.
    pub weights: Vec<KnownLoad>,
    /// Torques on the end, in their order.
    pub torques: Vec<KnownLoad>,
    /// Readings of a gauge, Pa, one at each step of a regulator's staircase.
    pub gauge: Option<Vec<f64>>,
    /// Tests of the material.
    pub material: Option<Material>,
    /// Inertias that are added to the end, one after the other, kg m2.
    pub added_inertia: Vec<f64>,
}

impl Script {
    /// Reads the file `path`.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = read_text(path)?;
        let source = Source::new(path, &text);
        let mut tables = Vec::new();
        let script = source.parse().map(|table| {
            let mut root = Section::root(&source, &table);
            let ready = root.texts("ready");
            for step in ready.iter().filter(|step| !STEPS.contains(&step.as_str())) {
                let remedy = format!("write some of: {}", STEPS.join(", "));
                root.reject("ready", format!("there is no calibration `{step}`"), remedy);
            }
            root.expect("material");
            let base = path.parent().unwrap_or(Path::new(""));
            Self {
                ready,
                weights: read_weights(&mut root),
                torques: read_torques(&mut root),
                gauge: root.numbers("gauge_psi", -1.0..=150.0),
                added_inertia: root.numbers("added_inertia_kg_m2", 1e-9..=1.0).unwrap_or_default(),
                material: root.has("material").then(|| read_material(root.section("material"), base, &mut tables)),
            }
        });
        let mut problems = source.into_problems();
        problems.extend(tables);
        match script {
            Some(script) if problems.is_empty() => Ok(script),
            _ => Err(ConfigError { problems }),
        }
    }

    /// Whether `step` has been prepared.
    pub fn is_ready(&self, step: &str) -> bool {
        self.ready.iter().any(|ready| ready == step)
    }
}

//! The answers that a person would give during a calibration, in a file.
//!
//! ```toml
//! ready = ["stiffness"]          # what has been prepared as the question says
//! added_inertia_kg_m2 = [3e-5]   # inertias that are added to the end, one after the other, for `damping`
//! ```

use std::path::Path;

use super::experiment::read_text;
use super::problem::ConfigError;
use super::reader::{Section, Source};

/// What can be ready.
const STEPS: [&str; 4] = ["imu", "regulator", "stiffness", "damping"];

/// The answers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    ready: Vec<String>,
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
        let script = source.parse().map(|table| {
            let mut root = Section::root(&source, &table);
            let ready = root.texts("ready");
            for step in ready.iter().filter(|step| !STEPS.contains(&step.as_str())) {
                let remedy = format!("write some of: {}", STEPS.join(", "));
                root.reject("ready", format!("there is no calibration `{step}`"), remedy);
            }
            let added_inertia = root.numbers("added_inertia_kg_m2", 1e-9..=1.0).unwrap_or_default();
            Self { ready, added_inertia }
        });
        match (script, source.into_problems()) {
            (Some(script), problems) if problems.is_empty() => Ok(script),
            (_, problems) => Err(ConfigError { problems }),
        }
    }

    /// Whether `step` has been prepared.
    pub fn is_ready(&self, step: &str) -> bool {
        self.ready.iter().any(|ready| ready == step)
    }
}

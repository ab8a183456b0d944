//! The answers that a person would give during a calibration, in a file.
//!
//! ```toml
//! ready = ["stiffness"]          # what has been prepared as the question says
//! ```

use std::path::Path;

use super::experiment::read_text;
use super::problem::ConfigError;
use super::reader::{Section, Source};

/// What can be ready.
const STEPS: [&str; 2] = ["regulator", "stiffness"];

/// The answers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Script {
    ready: Vec<String>,
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
            Self { ready }
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

//! What can be read of a wrong rig.toml: enough to take the pressure away, never to make one.
//!
//! A rig that runs may have its file edited into a wrong one, and must still be vented when its daemon has ended. Zero
//! is safe to send to whatever the file names; only what the file *fails* to name is lost. So the parts that a vent
//! does not need (limits, gains, IMU, loop, record) are replaced by stand-ins, and a problem in the others keeps the
//! vent from being called verified.

use std::path::Path;

use super::build::build;
use super::load::{Files, base, read_description};
use super::problem::{ConfigError, Problem};
use super::reader::{Section, Source};
use super::rig::{Backend, Rig};
use super::sections::read_rig;
use crate::control::{ControllerKind, FreeControl, Gains, Limits};
use crate::model::Free;
use crate::signal::MAX_FREES;
use crate::units::PASCAL_PER_PSI as PSI;

/// Stands for a full scale that cannot be read, Pa.
const FULL_SCALE: f64 = 15.0 * PSI;
/// Stands for the pressure below which a FREE counts as vented, Pa.
const ZERO: f64 = 0.2 * PSI;
/// Keys of a FREE that its vent does not need.
const OF_NO_USE: [&str; 9] =
    ["calibration", "limits", "gains", "controller", "derivative_on", "feedforward_percent", "imu", "knob", "sim"];

/// A rig to be vented and nothing else.
#[derive(Debug)]
pub struct Salvage {
    /// The rig.
    pub rig: Rig,
    /// What is wrong with its files.
    pub error: ConfigError,
}

impl Salvage {
    /// Reads of `path` what can be read.
    ///
    /// # Errors
    /// Where that is no FREE.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let file = read_description(path)?;
        let mut files = Files::default();
        let source = Source::new(&file.path, &file.text);
        let table = source.parse_as_far_as_possible();
        let mut raw = read_rig(Section::root(&source, &table), &base(path), &mut files);
        let (read, mut more) = files.into_parts();
        let mut problems = source.into_problems();
        problems.append(&mut more);
        let error = ConfigError { problems };
        if raw.frees.is_empty() {
            return Err(error);
        }
        raw.frees.truncate(MAX_FREES);
        raw.module = None;
        if error.problems.iter().any(|problem| problem.key == "backend") {
            // A simulated rig needs no vent.
            raw.backend = Backend::Linux;
        }
        let mut rig = build(raw, read);
        rig.control.require_realtime = false;
        rig.control.frees.iter_mut().for_each(only_to_vent);
        for plant in &mut rig.bench.plants {
            plant.nominal = Free::paper();
            plant.regulator.full_scale = positive(plant.regulator.full_scale, FULL_SCALE);
        }
        for unit in rig.wiring.serial.iter_mut().flat_map(|line| &mut line.units) {
            unit.full_scale = positive(unit.full_scale, FULL_SCALE);
        }
        Ok(Self { rig, error })
    }

    /// Whether everything that a vent needs was read without a problem: only then can it be verified.
    pub fn is_whole(&self) -> bool {
        !self.error.problems.iter().any(|problem| self.concerns_the_vent(problem))
    }

    fn concerns_the_vent(&self, problem: &Problem) -> bool {
        // A calibration has a say in what a pressure is, none in what zero is.
        if self.rig.files.iter().any(|file| file.path == problem.file) {
            return false;
        }
        let mut parts = problem.key.split('.');
        match parts.next().unwrap_or_default() {
            "loop" | "safety" | "record" | "socket" | "sim" | "module" => false,
            "free" => {
                let key = parts.nth(1).unwrap_or_default();
                !OF_NO_USE.contains(&key) || parts.next() == Some("zero_pressure_psi")
            }
            _ => true,
        }
    }
}

fn positive(value: f64, otherwise: f64) -> f64 {
    if value.is_finite() && value > 0.0 { value } else { otherwise }
}

/// Stand-ins for all that commands a pressure.
fn only_to_vent(free: &mut FreeControl) {
    let full_scale = positive(free.regulator.full_scale, FULL_SCALE);
    free.regulator.full_scale = full_scale;
    free.regulator.fastest_fill = positive(free.regulator.fastest_fill, full_scale);
    free.limits = Limits {
        pressure_max: 0.25 * full_scale,
        pressure_warn: 0.5 * full_scale,
        pressure_hard: full_scale,
        pressure_zero: positive(free.limits.pressure_zero, ZERO),
        slew: full_scale / 0.1,
        angle_soft: (-1e3, 1e3),
        angle_hard: (-1e3, 1e3),
        tracking_error: (f64::INFINITY, 0.0),
    };
    free.free = Free::paper();
    free.imu = None;
    free.gains = Gains::default();
    free.feedforward = 0.0;
    free.controller = ControllerKind::Nothing;
}

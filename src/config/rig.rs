//! A rig as the floors below take it: checked, joined with its calibrations, and built.

use std::path::PathBuf;
use std::time::Duration;

use super::calibration::Calibration;
use super::knob::{Knob, Temperatures};
use super::load::SourceFile;
use super::module::ModuleConfig;
use crate::control::ControlConfig;
use crate::fem::module::ModuleScene;
use crate::hardware::wiring::Wiring;
use crate::sim::BenchConfig;

/// Where the devices are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// Simulated chips and plant behind the real drivers: everything that comes from it says SIMULATED.
    Sim,
    /// Devices on Linux buses.
    Linux,
}

impl Backend {
    /// Name in rig.toml.
    pub const fn name(self) -> &'static str {
        match self {
            Backend::Sim => "sim",
            Backend::Linux => "linux",
        }
    }
}

/// How the real-time thread runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopConfig {
    /// Period of the tick.
    pub period: Duration,
    /// `SCHED_FIFO` priority, 1 to 98.
    pub priority: u8,
    /// CPU that the thread is bound to.
    pub cpu: Option<usize>,
    /// Refuse to arm without real-time rights.
    pub require_realtime: bool,
}

/// What is recorded, and shown while it happens.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordConfig {
    /// Folder of the runs.
    pub directory: PathBuf,
    /// Most that the runs may take together, bytes: the oldest are removed; `None` where none ever is.
    pub most: Option<u64>,
    /// Least that must be free on the disk for a run to begin, bytes.
    pub free: u64,
    /// Serve the live view on loopback.
    pub live_view: bool,
    /// Port of the live view's page, on loopback.
    pub page_port: u16,
    /// Port of the live view's data, on loopback.
    pub data_port: u16,
    /// Most that the live view holds for viewers that come late, bytes.
    pub memory_limit: u64,
}

/// The control socket.
#[derive(Clone, Debug, PartialEq)]
pub struct SocketConfig {
    /// The Unix socket.
    pub path: PathBuf,
    /// Group whose members may control the rig, besides the daemon's own user.
    pub group: Option<String>,
}

/// A rig, checked and built. Its FREEs have the same order everywhere.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The rig's name.
    pub name: String,
    /// Where the devices are.
    pub backend: Backend,
    /// The real-time thread.
    pub realtime: LoopConfig,
    /// Controller, limits and life cycle.
    pub control: ControlConfig,
    /// Buses and devices.
    pub wiring: Wiring,
    /// The simulated rig.
    pub bench: BenchConfig,
    /// Runs and the live view.
    pub record: RecordConfig,
    /// The control socket.
    pub socket: SocketConfig,
    /// Folder of the calibration files.
    pub calibration_directory: PathBuf,
    /// Four FREEs under one plate, where the rig has that.
    pub module: Option<ModuleConfig>,
    /// By FREE: the knob that it turns, where it turns one.
    pub knobs: Vec<Option<Knob>>,
    /// By FREE: its calibration.
    pub calibrations: Vec<Calibration>,
    /// Every file that it was built from, as it was then; rig.toml is the first.
    pub files: Vec<SourceFile>,
}

impl Rig {
    /// Index of the FREE called `name`.
    pub fn free(&self, name: &str) -> Option<usize> {
        self.control.frees.iter().position(|free| free.name == name)
    }

    /// The module that the calibrations of its FREEs describe; none where the rig has none.
    pub fn module_scene(&self) -> Option<ModuleScene> {
        Some(self.module.as_ref()?.scene(|index| &self.calibrations[index]))
    }

    /// The highest pressure that any FREE of the module is ever to see, Pa: the hard limit; zero without a module.
    pub fn highest_pressure(&self) -> f64 {
        let frees = self.module.iter().flat_map(|module| module.frees);
        frees.filter_map(|index| Some(self.control.frees.get(index)?.limits.pressure_hard)).fold(0.0, f64::max)
    }

    /// What temperatures the knob of the FREE `index` sets; none where it turns none, or that is not known.
    pub fn temperatures(&self, index: usize) -> Option<&Temperatures> {
        self.knobs.get(index)?.as_ref()?.temperatures.as_ref()
    }

    /// The file that `calibration` was read from: FREEs may share one.
    pub fn calibration_file(&self, calibration: &Calibration) -> Option<&SourceFile> {
        let name = format!("{}.toml", calibration.name);
        self.files.iter().skip(1).find(|file| file.path.file_name().is_some_and(|f| *f == *name))
    }

    /// Names of the FREEs.
    pub fn free_names(&self) -> impl Iterator<Item = &str> {
        self.control.frees.iter().map(|free| free.name.as_str())
    }

    /// Whether everything that comes from this rig has to say SIMULATED.
    pub fn is_simulated(&self) -> bool {
        self.backend == Backend::Sim
    }
}

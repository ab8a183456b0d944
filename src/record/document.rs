//! The start and the stop document of a run: what `run.toml` says.
//!
//! The start document is written before the first sample, the stop document when the run has ended; a run
//! without a stop document was killed and is *incomplete*. Keys carry their units. The documents are a file
//! format of their own, apart from the types of the floors below, so that those may change.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::free_document::FreeDocument;
use super::module::{ModuleDocument, WhiskDocument};
use crate::control::ControlConfig;
use crate::signal::Quantity;
use crate::trajectory::Program;

/// Version of the format of a run folder.
pub const FORMAT: u32 = 1;

/// The whole of `run.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunDocument {
    /// [`FORMAT`] of the program that wrote it.
    pub format: u32,
    /// What was to be run.
    pub start: StartDocument,
    /// How it ended; absent in a run that was killed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop: Option<StopDocument>,
}

/// What kind of experiment a run is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunKind {
    /// Steps of the reference.
    #[default]
    Step,
    /// A reference over time.
    Trajectory,
    /// Quasi-static pressure up and down.
    Sweep,
    /// Whisking by a module.
    Whisk,
    /// Set by hand.
    Set,
    /// Identification.
    Calibrate,
}

impl RunKind {
    /// Stable name, as in the run's id and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            RunKind::Step => "step",
            RunKind::Trajectory => "trajectory",
            RunKind::Sweep => "sweep",
            RunKind::Whisk => "whisk",
            RunKind::Set => "set",
            RunKind::Calibrate => "calibrate",
        }
    }
}

/// Where the devices are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// Simulated chips and plant: everything from such a run says SIMULATED.
    #[default]
    Sim,
    /// Devices on Linux buses.
    Linux,
}

/// One run out of several of the same experiment (`--repeat`).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repetition {
    /// Id of the first run of the group.
    pub group: String,
    /// Which one this is, from 1.
    pub index: u32,
    /// How many were asked for.
    pub of: u32,
}

/// Whether the loop had its real-time rights.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealtimeDocument {
    /// Real-time scheduling and locked memory were granted.
    pub granted: bool,
    /// What was granted or refused, in words.
    #[serde(default)]
    pub detail: String,
}

/// What is known when a run begins.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StartDocument {
    /// The run's id; filled in by [`Recorder::create`](super::Recorder::create).
    #[serde(default)]
    pub id: String,
    /// When it began, RFC 3339 with the zone; filled in by [`Recorder::create`](super::Recorder::create).
    #[serde(default)]
    pub started: String,
    /// Kind of experiment.
    pub kind: RunKind,
    /// What a person calls it ("paper step").
    #[serde(default)]
    pub title: String,
    /// Name of the FREE it is about; empty where it is about all of them.
    #[serde(default)]
    pub subject: String,
    /// What the user had to say (`--note`).
    #[serde(default)]
    pub note: String,
    /// Where the devices are.
    pub backend: Backend,
    /// On the stepped clock rather than in real time.
    #[serde(default)]
    pub stepped: bool,
    /// Seed of the simulated rig.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Period of the tick, s.
    pub tick_period_s: f64,
    /// SHA-256 of the text of rig.toml, hexadecimal.
    #[serde(default)]
    pub rig_sha256: String,
    /// Version of freerig.
    #[serde(default = "version")]
    pub freerig_version: String,
    /// Version of the kernel; filled in by [`Recorder::create`](super::Recorder::create) where empty.
    #[serde(default)]
    pub kernel: String,
    /// Name of the machine; filled in by [`Recorder::create`](super::Recorder::create) where empty.
    #[serde(default)]
    pub host: String,
    /// Whether the loop had its real-time rights.
    #[serde(default)]
    pub realtime: RealtimeDocument,
    /// One of several of the same experiment.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repetition: Option<Repetition>,
    /// What was asked; by hand there is no program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Program>,
    /// The plan of a whisk.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub whisk: Option<WhiskDocument>,
    /// Four of the FREEs under one plate, where the rig has that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub module: Option<ModuleDocument>,
    /// The FREEs under control, in the order of rig.toml.
    pub frees: Vec<FreeDocument>,
}

fn version() -> String {
    env!("CARGO_PKG_VERSION").into()
}

impl StartDocument {
    /// The document of an experiment of `kind` on a rig built from `config`; everything else at its default,
    /// to be filled in by the caller.
    pub fn new(kind: RunKind, config: &ControlConfig) -> Self {
        Self {
            kind,
            tick_period_s: config.period.as_secs_f64(),
            freerig_version: version(),
            frees: config.frees.iter().map(FreeDocument::new).collect(),
            ..Self::default()
        }
    }

    /// Whether the run is on the sim backend.
    pub fn simulated(&self) -> bool {
        self.backend == Backend::Sim
    }

    /// Index of the FREE that the run is about, where it is about one.
    pub fn subject_index(&self) -> Option<usize> {
        self.frees.iter().position(|f| f.name == self.subject)
    }

    /// What a person calls the run.
    pub fn name(&self) -> &str {
        if self.title.is_empty() { self.kind.name() } else { &self.title }
    }

    /// Under which gains the FREE `name` ran: their name, or else their values; `open loop` where its pressure was
    /// asked, empty where there is no such FREE.
    pub fn gains_name(&self, name: &str) -> String {
        let Some(index) = self.frees.iter().position(|f| f.name == name) else { return String::new() };
        let axis = self.program.as_ref().and_then(|p| p.axes.get(index)?.as_ref());
        if axis.is_some_and(|a| a.quantity == Quantity::Pressure) {
            return "open loop".into();
        }
        let FreeDocument { preset, gains: g, model_leads, .. } = &self.frees[index];
        let (p, i, d) = (g.proportional_pa_per_rad, g.integral_pa_per_rad_s, g.derivative_pa_s_per_rad);
        let gains = if preset.is_empty() { format!("Kp {p:.0}, Ki {i:.0}, Kd {d:.0}") } else { preset.clone() };
        if *model_leads { format!("model, {gains}") } else { gains }
    }
}

/// How a run ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RunResult {
    /// To the end of what was asked.
    #[default]
    Done,
    /// It could not be carried out.
    Failed,
    /// Stopped by the user, or with the program.
    Aborted,
    /// Ended by a fault of the rig.
    Fault,
}

impl RunResult {
    /// Stable name, as in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            RunResult::Done => "done",
            RunResult::Failed => "failed",
            RunResult::Aborted => "aborted",
            RunResult::Fault => "fault",
        }
    }
}

/// Tracking errors of one FREE while the program ran.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorDocument {
    /// Name of the FREE.
    pub free: String,
    /// Root of the mean square, rad.
    pub rms_rad: f64,
    /// Greatest magnitude, rad.
    pub peak_rad: f64,
    /// Mean over the last 0.1 s, rad.
    pub final_rad: f64,
}

/// One entry of the first-errors black box: the condition at the first time a fault was seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FaultDocument {
    /// Stable number.
    pub code: u8,
    /// Stable name.
    pub name: String,
    /// FREE it is about; absent for the whole rig.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub free: Option<String>,
    /// Tick at which it was first seen.
    pub tick: u64,
    /// Time since the run's start, s.
    pub t_s: f64,
    /// Whether it was latched.
    #[serde(default)]
    pub latched: bool,
    /// What was seen and what may be done about it, in words.
    #[serde(default)]
    pub message: String,
}

/// What the rig was like at one moment; the lists are by FREE.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MomentDocument {
    /// Time since the run's start, s.
    pub t_s: f64,
    /// Where the life cycle stood.
    pub state: String,
    /// Measured pressure, Pa; not a number where it is not measured.
    pub pressure_pa: Vec<f64>,
    /// Age of that reading, s.
    pub pressure_age_s: Vec<f64>,
    /// Command, Pa.
    pub command_pa: Vec<f64>,
    /// Estimated angle, rad.
    pub angle_rad: Vec<f64>,
    /// Age of what it rests on, s.
    pub angle_age_s: Vec<f64>,
}

/// How the loop ran.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopDocument {
    /// Ticks recorded.
    pub ticks: u64,
    /// Periods skipped because of overruns.
    pub deadline_misses: u64,
    /// From the deadline to the wake-up, median, microseconds.
    pub latency_p50_us: f64,
    /// 99th percentile.
    pub latency_p99_us: f64,
    /// Greatest.
    pub latency_max_us: f64,
    /// Execution time of a tick, median, microseconds.
    pub execution_p50_us: f64,
    /// 99th percentile.
    pub execution_p99_us: f64,
    /// Greatest.
    pub execution_max_us: f64,
}

/// What is known when a run has ended. The caller gives `result`, `message`, `lost_records` and, where it
/// knows more than the records do, `faults`; [`Recorder::finish`](super::Recorder::finish) fills in the rest.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StopDocument {
    /// How it ended.
    pub result: RunResult,
    /// Why, in words, where it is not simply done.
    #[serde(default)]
    pub message: String,
    /// When it ended, RFC 3339 with the zone.
    #[serde(default)]
    pub ended: String,
    /// Time from the first record to the last, s.
    #[serde(default)]
    pub duration_s: f64,
    /// Records written.
    #[serde(default)]
    pub records: u64,
    /// Records that the ring had no room for.
    #[serde(default)]
    pub lost_records: u64,
    /// Why `run.rrd` is not complete (`samples.arrows` is); empty where it is.
    #[serde(default)]
    pub rerun_error: String,
    /// Names of the limits that were in force at some time.
    #[serde(default)]
    pub limits_seen: Vec<String>,
    /// How the loop ran.
    #[serde(default, rename = "loop")]
    pub loop_statistics: LoopDocument,
    /// First-errors black box, in the order of appearance.
    #[serde(default)]
    pub faults: Vec<FaultDocument>,
    /// The rig around those times: 0.1 s before and after each, every 10 ms.
    #[serde(default)]
    pub around: Vec<MomentDocument>,
    /// Tracking errors of the FREEs that were given an angle.
    #[serde(default)]
    pub errors: Vec<ErrorDocument>,
}

/// SHA-256 of `text`, hexadecimal.
pub fn sha256(text: &[u8]) -> String {
    use std::fmt::Write;
    Sha256::digest(text).iter().fold(String::with_capacity(64), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    })
}

#[cfg(test)]
mod tests {
    use super::super::LimitsDocument;
    use super::*;

    use crate::trajectory::{Segment, Sequence, Shape};

    #[test]
    fn the_documents_survive_toml() {
        let free = FreeDocument {
            name: "paper".into(),
            limits: LimitsDocument { tracking_error_rad: f64::INFINITY, ..LimitsDocument::default() },
            ..FreeDocument::default()
        };
        let segments = [Segment::new(0.0, Shape::Step, 0.7, 3.0), Segment::new(0.7, Shape::Cubic, 0.1, 1.5)];
        let program = Program::angle(0, Sequence::new(segments).unwrap()).unwrap();
        let document = RunDocument {
            format: FORMAT,
            start: StartDocument {
                note: "first \"try\"\nwith a new FREE".into(),
                seed: Some(7),
                frees: vec![free],
                program: Some(program),
                repetition: Some(Repetition { group: "g".into(), index: 1, of: 3 }),
                ..StartDocument::default()
            },
            stop: Some(StopDocument {
                faults: vec![FaultDocument::default()],
                around: vec![MomentDocument { pressure_pa: vec![7e4, f64::INFINITY], ..MomentDocument::default() }],
                errors: vec![ErrorDocument::default()],
                ..StopDocument::default()
            }),
        };
        let text = toml::to_string(&document).unwrap();
        assert_eq!(toml::from_str::<RunDocument>(&text).unwrap(), document, "{text}");
    }

    #[test]
    fn sha256_is_the_standard_one() {
        assert_eq!(sha256(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}

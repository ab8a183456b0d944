//! What the daemon tells: where the rig stands, what runs, what came of it, what happened.

use serde::{Deserialize, Serialize};

use crate::hardware::DeviceStatistics;
use crate::hardware::serial_line::LineStatistics;
use crate::rt;
use crate::signal::FaultCode;

/// Where the rig stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Version of the daemon.
    pub version: String,
    /// Name of the rig.
    pub rig: String,
    /// Whether the devices are simulated.
    pub simulated: bool,
    /// State of the life cycle, by its stable name ([`crate::signal::State::name`]).
    pub state: String,
    /// Time since the daemon's start, s.
    pub uptime_s: f64,
    /// Faults, latched or active.
    pub faults: Vec<Fault>,
    /// The FREEs, in the order of rig.toml.
    pub frees: Vec<FreeStatus>,
    /// The real-time loop.
    #[serde(rename = "loop")]
    pub tick: LoopStatus,
    /// The run in progress.
    pub run: Option<Run>,
    /// Where the live view is to be seen; `null` where there is none.
    pub live_view: Option<String>,
}

impl Status {
    /// Whether a fault is latched: the rig needs `freerig clear`.
    pub fn is_faulted(&self) -> bool {
        self.faults.iter().any(|f| f.latched)
    }
}

/// A fault that is latched, or whose condition holds.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// Stable number.
    pub code: u8,
    /// Stable name.
    pub name: String,
    /// Name of the FREE it is about; `null` where it is about the rig.
    pub free: Option<String>,
    /// Whether it is latched: it stays until it is cleared.
    pub latched: bool,
    /// Whether its condition holds now.
    pub active: bool,
    /// What to do about it.
    pub remedy: String,
}

impl Fault {
    /// The fault `code` of the FREE or of the rig.
    pub fn new(code: FaultCode, free: Option<&str>, latched: bool, active: bool, remedy: &str) -> Self {
        Self {
            code: code as u8,
            name: code.name().into(),
            free: free.map(Into::into),
            latched,
            active,
            remedy: remedy.into(),
        }
    }
}

/// One FREE.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FreeStatus {
    /// Name in rig.toml.
    pub name: String,
    /// Estimated end rotation, rad; `null` without a reading.
    pub angle_rad: Option<f64>,
    /// What its knob sets at that angle, degrees Celsius; `null` without a knob, or where that is not known.
    #[serde(default)]
    pub temperature_degc: Option<f64>,
    /// Estimated rate, rad/s.
    pub rate_rad_s: Option<f64>,
    /// Measured pressure, Pa; `null` where it is not measured.
    pub pressure_pa: Option<f64>,
    /// Commanded pressure, Pa.
    pub command_pa: f64,
    /// Whether the command is zero and a fresh reading says that the pressure is gone; `null` where it is not measured.
    pub vented: Option<bool>,
    /// Reference of the angle, rad; `null` where the angle is not controlled.
    pub reference_rad: Option<f64>,
    /// Reference of the pressure, Pa; `null` where the pressure is not asked for.
    pub reference_pa: Option<f64>,
    /// Limits in force, by their stable names; they explain, they do not latch.
    pub limits: Vec<String>,
    /// How often it has been under pressure, as [`crate::daemon::cycles`] counts; `null` where that is not known.
    #[serde(default)]
    pub pressure_cycles: Option<u64>,
    /// Its IMU; `null` where it has none.
    pub imu: Option<DeviceStatus>,
    /// Its regulator.
    pub regulator: DeviceStatus,
    /// The sensor of its pressure; `null` where its regulator measures that, or nothing does.
    #[serde(default)]
    pub sensor: Option<DeviceStatus>,
}

impl FreeStatus {
    /// Its devices, IMU first.
    pub fn devices(&self) -> impl Iterator<Item = &DeviceStatus> {
        self.imu.iter().chain([&self.regulator]).chain(&self.sensor)
    }
}

/// The serial line of a regulator, with everything on it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LineStatus {
    /// Commands sent.
    pub transactions: u64,
    /// Replies that did not come in time.
    pub timeouts: u64,
    /// Replies that came after they had been given up, and were not used.
    pub late_frames: u64,
    /// Replies that could not be understood.
    pub malformed: u64,
    /// Commands that a unit rejected.
    pub rejected: u64,
    /// Accepted set-points that were not the ones sent.
    pub echo_mismatches: u64,
    /// Status tokens that this program does not know.
    pub unknown_tokens: u64,
    /// Times the line was opened again.
    pub reconnects: u64,
}

impl From<&LineStatistics> for LineStatus {
    fn from(line: &LineStatistics) -> Self {
        Self {
            transactions: line.transactions.get(),
            timeouts: line.timeouts.get(),
            late_frames: line.late_frames.get(),
            malformed: line.malformed.get(),
            rejected: line.rejected.get(),
            echo_mismatches: line.echo_mismatches.get(),
            unknown_tokens: line.unknown_tokens.get(),
            reconnects: line.reconnects.get(),
        }
    }
}

/// One device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DeviceStatus {
    /// Model, bus and address.
    pub device: String,
    /// What its latest reading is worth: `absent`, `good`, `implausible`, `restarting`, `unmeasured`, `lost`.
    pub health: String,
    /// Age of its latest reading, s.
    pub age_s: Option<f64>,
    /// Readings that were good.
    pub reads: u64,
    /// Readings that brought nothing new.
    pub repeats: u64,
    /// Exchanges that failed after their retries.
    pub errors: u64,
    /// Exchanges that were tried again.
    pub retries: u64,
    /// Readings that could not be.
    pub implausible: u64,
    /// Resets that nobody asked for.
    pub resets: u64,
    /// Times its reset line was pulled.
    #[serde(default)]
    pub pulls: u64,
    /// Times its bus was opened again.
    pub reopens: u64,
    /// Times it was set up.
    pub connects: u64,
    /// Times it was given up as lost.
    pub losses: u64,
    /// The latest failure.
    pub last_error: Option<String>,
    /// Its serial line; `null` where it has none.
    #[serde(default)]
    pub line: Option<LineStatus>,
}

impl DeviceStatus {
    /// What `statistics` have counted, with the `health` and the age of the latest reading.
    pub fn new(statistics: &DeviceStatistics, health: &str, age_s: Option<f64>) -> Self {
        Self {
            device: statistics.device.to_string(),
            health: health.into(),
            age_s,
            reads: statistics.reads.get(),
            repeats: statistics.repeats.get(),
            errors: statistics.errors.get(),
            retries: statistics.retries.get(),
            implausible: statistics.implausible.get(),
            resets: statistics.resets.get(),
            pulls: statistics.pulls.get(),
            reopens: statistics.reopens.get(),
            connects: statistics.connects.get(),
            losses: statistics.losses.get(),
            last_error: statistics.last_error().map(|e| e.to_string()),
            line: None,
        }
    }
}

/// The real-time loop.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopStatus {
    /// Configured period, s.
    pub period_s: f64,
    /// Ticks done per second of the loop's time: below `1 / period_s` where periods were skipped.
    pub rate_hz: f64,
    /// Ticks done.
    pub ticks: u64,
    /// Periods skipped.
    pub skipped: u64,
    /// From the deadline to the wake-up.
    pub latency: Durations,
    /// Execution time of a tick.
    pub execution: Durations,
    /// Whether the thread has its real-time rights: SCHED_FIFO and locked memory.
    pub realtime: bool,
    /// The rights that were refused, each with its remedy.
    pub refused: Vec<String>,
}

impl LoopStatus {
    /// What `statistics` have counted of the thread with `rights`.
    pub fn new(period: std::time::Duration, statistics: &rt::Statistics, rights: &rt::Rights) -> Self {
        let (ticks, skipped) = (statistics.ticks(), statistics.skipped());
        let share = if ticks == 0 { 0.0 } else { ticks as f64 / (ticks + skipped) as f64 };
        Self {
            period_s: period.as_secs_f64(),
            rate_hz: share / period.as_secs_f64(),
            ticks,
            skipped,
            latency: Durations::new(&statistics.latency.snapshot()),
            execution: Durations::new(&statistics.execution.snapshot()),
            realtime: rights.realtime(),
            refused: rights.refusals().map(ToString::to_string).collect(),
        }
    }
}

/// A distribution of durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Durations {
    /// Median, s.
    pub p50_s: Option<f64>,
    /// 99th percentile, s.
    pub p99_s: Option<f64>,
    /// Largest, s.
    pub max_s: Option<f64>,
}

impl Durations {
    /// The percentiles of `counted`; all `null` where nothing was counted.
    pub fn new(counted: &rt::Snapshot) -> Self {
        let seconds = |percent| counted.percentile(percent).map(|ns| ns as f64 * 1e-9);
        Self {
            p50_s: seconds(50.0),
            p99_s: seconds(99.0),
            max_s: (counted.count() > 0).then(|| counted.max() as f64 * 1e-9),
        }
    }
}

/// A run in progress.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Name of its folder under runs/.
    pub id: String,
    /// Its folder.
    pub folder: String,
    /// What it does: `step`, `trajectory`, `sweep`, ...
    pub kind: String,
    /// The experiment's name.
    pub name: String,
    /// Whether it stops when its client is gone.
    pub attended: bool,
    /// Which repetition is running, from 1.
    pub repeat: u32,
    /// How many repetitions there are.
    pub repeats: u32,
    /// Time since its start, s.
    pub elapsed_s: f64,
    /// How long it will take, s.
    pub duration_s: f64,
    /// How much of it is done, 0..=1.
    pub progress: f64,
    /// In a few words, what it is doing.
    pub phase: String,
}

/// How a run ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Name of its folder under runs/.
    pub id: String,
    /// Its folder.
    pub folder: String,
    /// Whether the devices were simulated.
    pub simulated: bool,
    /// `done`, `aborted`, `fault` or `failed`, as in run.toml; `incomplete` where it was cut off.
    pub outcome: String,
    /// Why, where it did not complete.
    pub reason: Option<String>,
    /// Figures by FREE.
    pub frees: Vec<FreeResult>,
    /// How far a module's plate was from where it was wanted, where that was asked.
    #[serde(default)]
    pub tip: Option<TipResult>,
}

/// How far the centre of a module's plate was from where it was wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TipResult {
    /// Root mean square of the distance of the estimated centre, m.
    pub rms_error_m: f64,
    /// Largest, m.
    pub peak_error_m: f64,
    /// Root mean square of the distance of the simulated rig's true centre, m; `null` on hardware.
    pub true_rms_error_m: Option<f64>,
    /// Largest, m.
    pub true_peak_error_m: Option<f64>,
}

/// Figures of one FREE over a run; its error is reference minus angle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FreeResult {
    /// Name in rig.toml.
    pub name: String,
    /// Root mean square of the angle's error, rad; `null` where the angle was not controlled.
    pub rms_error_rad: Option<f64>,
    /// Largest, rad.
    pub peak_error_rad: Option<f64>,
    /// At the end, rad.
    pub final_error_rad: Option<f64>,
    /// RMS of angle minus the model's prediction, rad; `null` where there is none.
    pub model_rmsd_rad: Option<f64>,
    /// Greatest difference of the angle between the ways up and down, rad; in a sweep only.
    pub hysteresis_rad: Option<f64>,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// When, RFC 3339.
    pub time: String,
    /// What.
    #[serde(flatten)]
    pub what: Happening,
}

impl Event {
    /// `what` happened now.
    pub fn now(what: Happening) -> Self {
        Self { time: jiff::Timestamp::now().to_string(), what }
    }
}

/// What an [`Event`] says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Happening {
    /// The life cycle moved on.
    State {
        /// Stable name of the state before.
        from: String,
        /// Stable name of the state after.
        to: String,
    },
    /// A fault was latched, or its condition began or ended.
    Fault(Fault),
    /// A run began.
    RunStarted(Run),
    /// A run ended.
    RunFinished(RunResult),
    /// Something that a person should know.
    Warning {
        /// What.
        text: String,
        /// What to do about it.
        remedy: String,
    },
    /// This reader was too slow: events are missing here.
    Missed {
        /// How many.
        events: u64,
    },
}

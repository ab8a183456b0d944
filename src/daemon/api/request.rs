//! What a client asks, and the answer.

use serde::{Deserialize, Serialize};

use super::Run;
use crate::hardware::wiring::ImuProfile;
use crate::sim::Hand;

/// What a client asks of the supervisor.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Arm.
    Arm(Arm),
    /// Take the pressures down and disarm.
    Disarm,
    /// Clear the latched faults, the emergency stop among them, if their causes are gone.
    Clear,
    /// Set one value by hand.
    Set(Set),
    /// Start an experiment.
    Start(Start),
    /// Stop the experiment; the pressures hold.
    Stop,
    /// Read the calibration profile of an IMU.
    Profile(ProfileOf),
}

/// Arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Arm {
    /// Arm even where the stability margin of the gains is below the stated one.
    pub accept_margin: bool,
}

/// Set one value by hand, within the limits. Exactly one of the values is given.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Set {
    /// Name of the FREE.
    pub free: String,
    /// Pressure, Pa.
    #[serde(default)]
    pub pressure_pa: Option<f64>,
    /// Angle, rad.
    #[serde(default)]
    pub angle_rad: Option<f64>,
    /// What the FREE's knob is to set, degrees Celsius.
    #[serde(default)]
    pub temperature_degc: Option<f64>,
}

/// Start an experiment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// What it is: `step`, `trajectory`, `sweep`, ...
    pub kind: String,
    /// Text of the experiment file (TOML).
    pub experiment: String,
    /// Where the text comes from, for messages.
    #[serde(default)]
    pub source: Option<String>,
    /// Name of the FREE, where it is not the file's.
    #[serde(default)]
    pub free: Option<String>,
    /// How many times, at least once; the file's own number where it is `null`.
    #[serde(default)]
    pub repeat: Option<u32>,
    /// A note for the record.
    #[serde(default)]
    pub note: Option<String>,
    /// What a person does to the FREE meanwhile, for identification; on the simulated bench its hand does it.
    #[serde(default)]
    pub hand: Option<Hand>,
    /// Go on without the client.
    #[serde(default)]
    pub detach: bool,
    /// Run a module's plan as it stands, without following its path.
    #[serde(default)]
    pub open_loop: bool,
    /// Run even where the stability margin of the experiment's own gains is below the stated one.
    #[serde(default)]
    pub accept_margin: bool,
}

/// Where an external tracker sees the plate of the module that follows a path: in the module's frame, from the middle
/// of the bases, z towards the plate. The latest counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// The plate's centre, m.
    pub position_m: [f64; 3],
    /// The plate's rotation from rest, unit quaternion; `null` where the tracker does not see it.
    #[serde(default)]
    pub quaternion_wxyz: Option<[f64; 4]>,
    /// How long before the request it was seen, s.
    #[serde(default)]
    pub age_s: f64,
    /// Standard deviation of each coordinate of the position, m.
    pub deviation_m: f64,
}

/// Read the calibration profile that an IMU has found; only of a disarmed rig.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileOf {
    /// Name of the FREE.
    pub free: String,
}

/// The calibration profile of one BNO055, byte by byte.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Profile {
    /// The sensor's own unique number.
    pub sensor_id: [u8; 16],
    /// Registers 0x55 to 0x6A.
    pub registers: [u8; 22],
}

impl From<ImuProfile> for Profile {
    fn from(profile: ImuProfile) -> Self {
        Self { sensor_id: profile.unique_id, registers: profile.registers }
    }
}

impl From<Profile> for ImuProfile {
    fn from(profile: Profile) -> Self {
        Self { unique_id: profile.sensor_id, registers: profile.registers }
    }
}

/// Says that the client that runs an experiment is still there.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heartbeat {
    /// [`Run::id`] of the experiment.
    pub run: String,
}

/// What came of a request that was done.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Response {
    /// What was done, in a sentence.
    pub message: String,
    /// The run that was started.
    pub run: Option<Run>,
    /// The profile that was read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<Profile>,
}

impl Response {
    /// Done, and nothing more to say than `message`.
    pub fn done(message: impl Into<String>) -> Self {
        Self { message: message.into(), ..Self::default() }
    }
}

/// Why a request was not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// The request makes no sense (400).
    Usage,
    /// The client may not do this (403).
    Denied,
    /// There is no such thing (404).
    NotFound,
    /// The rig's state does not allow it (409).
    Refused,
    /// A fault of the rig stands against it (409).
    Fault,
    /// The daemon is busy, or did not answer in time (503).
    Busy,
    /// The daemon failed (500).
    Failed,
}

/// A request that was not done: what is wrong, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, Deserialize)]
#[error("{error}")]
pub struct Problem {
    /// Which kind.
    pub kind: ProblemKind,
    /// What is wrong.
    pub error: String,
    /// What to do about it.
    pub remedy: String,
}

impl Problem {
    /// A problem of the given kind.
    pub fn new(kind: ProblemKind, error: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { kind, error: error.into(), remedy: remedy.into() }
    }
}

//! Why the rig did not do what was asked.

use std::path::PathBuf;

use thiserror::Error;

use super::api::{Problem, ProblemKind};
use crate::control::fault;
use crate::signal::{FaultCode, FaultSet, Refusal};

/// What can go wrong between a request and its end.
#[derive(Debug, Error)]
pub enum DaemonError {
    /// The tick refused.
    #[error("refused{}: {}{}", about(.subject), .refusal.code.message(), .refusal.fault.map(|f| format!(" ({})", f.name())).unwrap_or_default())]
    Refused {
        /// What and why.
        refusal: Refusal,
        /// Name of the FREE, where it is about one.
        subject: Option<String>,
    },
    /// A fault of the rig ended it.
    #[error("fault: {}", names(*.0))]
    Fault(FaultSet),
    /// The gains' stability margin is below the stated one.
    #[error("{0}")]
    Margin(String),
    /// A calibration does not fit the rig.
    #[error("{0}")]
    Calibration(String),
    /// The rig did not get there in time.
    #[error("the rig did not reach {wanted} within {seconds:.1} s; it stands in {state}")]
    Timeout {
        /// State waited for.
        wanted: &'static str,
        /// How long, s.
        seconds: f64,
        /// State it is in.
        state: &'static str,
    },
    /// The devices were not set up in time.
    #[error("the rig did not leave boot within {seconds:.1} s; it waits for{devices}")]
    Boot {
        /// How long, s.
        seconds: f64,
        /// A line for each device that is waited for: its name, and why.
        devices: String,
    },
    /// Somebody else ended it.
    #[error("{0}")]
    Interrupted(&'static str),
    /// The pressures could not be seen to be gone.
    #[error("the vent is not verified: {0}")]
    NotVented(String),
    /// Another process owns the rig.
    #[error("another freerig owns this rig: it holds {}", .0.display())]
    Owned(PathBuf),
    /// The loop has ended.
    #[error("the control loop has ended: {0}")]
    LoopEnded(String),
    /// More requests than the loop can take.
    #[error("too many requests wait for the control loop")]
    Busy,
    /// The experiment and the rig do not fit.
    #[error("{0}")]
    Unfit(String),
    /// Building the rig failed.
    #[error("{0}")]
    Rig(String),
    /// Recording failed.
    #[error(transparent)]
    Record(#[from] crate::record::RecordError),
    /// A device could not be opened.
    #[error(transparent)]
    Hardware(#[from] crate::hardware::HardwareError),
    /// The controller could not be built.
    #[error(transparent)]
    Control(#[from] crate::control::ControlError),
    /// The real-time thread failed.
    #[error(transparent)]
    Realtime(#[from] crate::rt::Error),
    /// A file or a thread of the system's.
    #[error("{what}: {error}")]
    Io {
        /// What was tried.
        what: String,
        /// Why it failed.
        error: std::io::Error,
    },
}

fn about(subject: &Option<String>) -> String {
    subject.as_ref().map(|s| format!(" ({s})")).unwrap_or_default()
}

/// The names of `faults`, separated by commas.
pub fn names(faults: FaultSet) -> String {
    faults.iter().map(|f| f.name()).collect::<Vec<_>>().join(", ")
}

impl DaemonError {
    /// What to do about it.
    pub fn remedy(&self) -> String {
        match self {
            DaemonError::Refused { refusal, .. } => match refusal.fault {
                Some(code) => fault::row(code).remedy.into(),
                None => refusal.code.remedy().into(),
            },
            DaemonError::Fault(faults) => {
                let mut remedies: Vec<_> = faults.iter().map(|f| fault::row(f).remedy).collect();
                if !remedies.iter().any(|remedy| remedy.contains("freerig clear")) {
                    remedies.push("Then `freerig clear`.");
                }
                remedies.join(" ")
            }
            DaemonError::Margin(_) => {
                "Choose gains with a margin on this rig, a shorter period, or accept it: --accept-margin.".into()
            }
            DaemonError::Calibration(_) => {
                "Put back what was changed. To measure again, remove the value's [conditions.KEY] from the calibration file \
                 first: then nothing says what it holds for."
                    .into()
            }
            DaemonError::Timeout { .. } => {
                "`freerig status` says what the rig waits for, without a daemon `freerig doctor`.".into()
            }
            DaemonError::Boot { .. } => "`freerig doctor` talks to every device and says what is missing.".into(),
            DaemonError::Interrupted(_) => "`freerig status` shows where the rig stands.".into(),
            DaemonError::NotVented(_) => fault::row(FaultCode::VentFailed).remedy.into(),
            DaemonError::Owned(_) => {
                "If it is the daemon: `freerig status` shows what it does, `freerig estop` vents at once, `freerig disarm` \
                 takes the pressures down. Stop it before another one takes the rig."
                    .into()
            }
            DaemonError::LoopEnded(_) => "Restart the daemon; its log says why the loop ended.".into(),
            DaemonError::Busy => "Try again in a moment.".into(),
            DaemonError::Unfit(_) => "Check the experiment's FREE and quantities against rig.toml.".into(),
            DaemonError::Rig(_) => "`freerig config check` and `freerig doctor` look closer.".into(),
            DaemonError::Record(_) => "Check the space and the permissions of the runs directory.".into(),
            DaemonError::Hardware(_) => "`freerig doctor` talks to every device and says what is missing.".into(),
            DaemonError::Control(_) => "`freerig config check` names the value.".into(),
            DaemonError::Realtime(_) | DaemonError::Io { .. } => "`freerig doctor` looks for the cause.".into(),
        }
    }

    /// Whether it is a fault of the rig (exit status 3).
    pub fn is_rig_fault(&self) -> bool {
        matches!(self, DaemonError::Fault(_) | DaemonError::NotVented(_))
            || matches!(self, DaemonError::Refused { refusal, .. } if refusal.fault.is_some())
    }
}

impl From<&DaemonError> for Problem {
    fn from(error: &DaemonError) -> Self {
        let kind = match error {
            _ if error.is_rig_fault() => ProblemKind::Fault,
            DaemonError::Refused { .. }
            | DaemonError::Margin(_)
            | DaemonError::Calibration(_)
            | DaemonError::Timeout { .. }
            | DaemonError::Boot { .. }
            | DaemonError::Interrupted(_)
            | DaemonError::Unfit(_)
            | DaemonError::Owned(_) => ProblemKind::Refused,
            DaemonError::Busy => ProblemKind::Busy,
            _ => ProblemKind::Failed,
        };
        Problem::new(kind, error.to_string(), error.remedy())
    }
}

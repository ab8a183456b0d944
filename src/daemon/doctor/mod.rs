//! `freerig doctor`: what keeps this machine from running the rig, each thing with its remedy.
//!
//! Nothing is changed but that the rig's lock is taken for a moment, and no pressure is commanded but zero, which is
//! every unit's first frame. While somebody owns the rig, the devices are left to them. On the sim backend the same
//! drivers ask the simulated chips, and every line about a device says SIMULATED.

mod devices;
mod files;
mod kernel;

use std::fmt;
use std::time::Duration;

use crate::clock::Clock;
use crate::config::{ConfigError, Rig};
use crate::daemon::{DaemonError, RigLock};

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// As it should be.
    Ok,
    /// The rig runs, but not as well as it could.
    Warn,
    /// The rig does not run like this.
    Fail,
}

impl Level {
    /// One word.
    pub const fn name(self) -> &'static str {
        match self {
            Level::Ok => "ok",
            Level::Warn => "warn",
            Level::Fail => "fail",
        }
    }
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at, in a few words: `governor`.
    pub subject: String,
    /// How bad it is.
    pub level: Level,
    /// What was found.
    pub found: String,
    /// What to do; none where all is well.
    pub remedy: Option<String>,
}

impl Finding {
    /// All is well.
    pub fn ok(subject: impl Into<String>, found: impl Into<String>) -> Self {
        Self { subject: subject.into(), level: Level::Ok, found: found.into(), remedy: None }
    }

    /// It could be better.
    pub fn warn(subject: impl Into<String>, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { level: Level::Warn, remedy: Some(remedy.into()), ..Self::ok(subject, found) }
    }

    /// It does not work like this.
    pub fn fail(subject: impl Into<String>, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { level: Level::Fail, ..Self::warn(subject, found, remedy) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<4}  {}: {}", self.level.name(), self.subject, self.found)?;
        match &self.remedy {
            Some(remedy) => write!(f, "\n      remedy: {remedy}"),
            None => Ok(()),
        }
    }
}

/// What may be done beside looking.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Treatment {
    /// Program the EEPROM of every DAC that would start with pressure, so that it starts at zero.
    pub program_dac: bool,
}

/// Looks at everything, and tells each finding as soon as it is there. Without a clean `rig` only the machine is
/// looked at. Takes some seconds, most of them for the IMUs' reset.
pub fn examine(rig: &Result<Rig, ConfigError>, treatment: Treatment, tell: &mut dyn FnMut(Finding)) {
    tell(configuration(rig));
    let rig = rig.as_ref().ok();
    kernel::look(rig.map(|rig| &rig.realtime), tell);
    let Some(rig) = rig else { return };
    files::look(rig, tell);
    // While a daemon lives, the buses are its own; nor may one start while they are looked at.
    match RigLock::take(rig, Duration::ZERO) {
        Ok(_lock) => devices::look(rig, treatment, &Clock::Live, tell),
        Err(DaemonError::Owned(_)) => {
            tell(Finding::ok(
                "devices",
                "left to the daemon or the command that owns the rig (`freerig status` tells)",
            ));
        }
        Err(error) => tell(Finding::fail("devices", error.to_string(), error.remedy())),
    }
}

fn configuration(rig: &Result<Rig, ConfigError>) -> Finding {
    match rig {
        Ok(rig) => Finding::ok(
            "configuration",
            format!(
                "{} FREE{}, backend {}",
                rig.control.frees.len(),
                if rig.control.frees.len() == 1 { "" } else { "s" },
                if rig.is_simulated() { "sim (SIMULATED)" } else { rig.backend.name() }
            ),
        ),
        Err(error) => {
            let count = error.problems.len();
            let first = error.problems.first().map(ToString::to_string).unwrap_or_default();
            // The problem's remedy stands on lines of its own.
            let first = first.lines().next().unwrap_or_default();
            Finding::fail(
                "configuration",
                format!("{count} problem{}; the first: {first}", if count == 1 { "" } else { "s" }),
                "`freerig config check` lists them all; without a clean configuration only the machine is looked at",
            )
        }
    }
}

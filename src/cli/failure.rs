//! How a command ends when it does not end well.

use std::fmt;
use std::process::ExitCode;

use crate::config::ConfigError;
use crate::daemon::DaemonError;
use crate::daemon::api::ProblemKind;
use crate::daemon::client::ClientError;

/// Exit status of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// The command failed.
    Failed = 1,
    /// Bad usage or bad configuration: nothing was done.
    Usage = 2,
    /// A fault of the rig: latched, or a vent that could not be verified.
    Fault = 3,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        ExitCode::from(exit as u8)
    }
}

/// What went wrong, the exit status that says so, and what to do about it.
///
/// Any error becomes a failure with status 1 through `?`, a [`ConfigError`] one with status 2.
#[derive(Debug)]
pub struct Failure {
    /// Exit status.
    pub exit: Exit,
    /// What went wrong, with its causes.
    pub error: anyhow::Error,
    /// What the user can do about it.
    pub remedy: Option<String>,
}

impl Failure {
    /// The command failed (status 1).
    pub fn failed(error: impl Into<anyhow::Error>) -> Self {
        Self { exit: Exit::Failed, error: error.into(), remedy: None }
    }

    /// Bad usage or configuration (status 2).
    pub fn usage(error: impl Into<anyhow::Error>) -> Self {
        Self { exit: Exit::Usage, error: error.into(), remedy: None }
    }

    /// A fault of the rig (status 3).
    pub fn fault(error: impl Into<anyhow::Error>) -> Self {
        Self { exit: Exit::Fault, error: error.into(), remedy: None }
    }

    /// What the daemon's procedures say: a fault of the rig has status 3, a refusal or a failure 1.
    pub fn rig(error: DaemonError) -> Self {
        let exit = if error.is_rig_fault() { Exit::Fault } else { Exit::Failed };
        let remedy = error.remedy();
        Self { exit, error: error.into(), remedy: Some(remedy) }
    }

    /// What the control socket's client says.
    pub fn client(error: ClientError) -> Self {
        let exit = match &error {
            ClientError::Problem(problem) if problem.kind == ProblemKind::Fault => Exit::Fault,
            ClientError::Problem(problem) if problem.kind == ProblemKind::Usage => Exit::Usage,
            _ => Exit::Failed,
        };
        let remedy = error.remedy().to_owned();
        Self { exit, error: error.into(), remedy: Some(remedy) }
    }

    /// Adds what the user can do about it.
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let error = error.into();
        let exit = if error.downcast_ref::<ConfigError>().is_some() { Exit::Usage } else { Exit::Failed };
        Self { exit, error, remedy: None }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "error: {:#}", self.error)?;
        match &self.remedy {
            Some(remedy) => write!(f, "\nremedy: {remedy}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_prints_its_causes_and_its_remedy() {
        let error = anyhow::anyhow!("no reply within 200 ms").context("/dev/ttyUSB0, unit A");
        let failure = Failure::fault(error).remedy("check the cable");
        assert_eq!(failure.to_string(), "error: /dev/ttyUSB0, unit A: no reply within 200 ms\nremedy: check the cable");
        assert_eq!(failure.exit as u8, 3);
    }

    #[test]
    fn a_bad_configuration_is_status_2_even_under_context() {
        let failure: Failure = anyhow::Error::new(ConfigError::default()).context("while arming").into();
        assert_eq!(failure.exit, Exit::Usage);
        let failure: Failure = std::io::Error::other("disk").into();
        assert_eq!(failure.exit, Exit::Failed);
    }
}

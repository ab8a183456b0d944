//! What can hang on a serial line, as its owner sees it: something that is told a set-point and answers.

use std::sync::Arc;

use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};

use super::alicat::{AlicatError, Unit};
use super::pwm::{PwmError, PwmOutput};
use super::serial_line::{Line, LineError};
use super::{HardwareError, Identity};
use crate::signal::{Command, PressureSample};

/// A device on the line. To add one is to add a variant here.
#[derive(Clone, Debug)]
pub(super) enum SerialUnit {
    Alicat(Unit),
    Pwm(PwmOutput),
}

/// Why an exchange with a device brought nothing.
#[derive(Clone, Debug, Error, PartialEq)]
pub(super) enum UnitError {
    #[error(transparent)]
    Alicat(#[from] AlicatError),
    #[error(transparent)]
    Pwm(#[from] PwmError),
}

impl UnitError {
    /// What is wrong with the line, where that is what is wrong.
    pub(super) const fn line(&self) -> Option<&LineError> {
        match self {
            Self::Alicat(error) => error.line(),
            Self::Pwm(error) => error.line(),
        }
    }

    /// The failure with the device's name, and what to do.
    pub(super) fn at(&self, device: &Arc<str>) -> HardwareError {
        match self {
            Self::Alicat(error) => error.at(device),
            Self::Pwm(error) => error.at(device),
        }
    }
}

impl SerialUnit {
    /// Model, id and line.
    pub(super) fn device(&self) -> &Arc<str> {
        match self {
            Self::Alicat(unit) => unit.device(),
            Self::Pwm(output) => output.device(),
        }
    }

    /// Who answers.
    pub(super) fn identity(&self) -> Identity {
        match self {
            Self::Alicat(unit) => unit.identity(),
            Self::Pwm(output) => output.identity(),
        }
    }

    /// What `command` asks of it, Pa: within its full scale, zero under a vent, zero for what is no number.
    pub(super) fn target(&self, command: &Command) -> f64 {
        let (free, full_scale) = match self {
            Self::Alicat(unit) => (unit.wiring().free, unit.wiring().full_scale),
            // Its duty ends at its own full scale.
            Self::Pwm(output) => (output.wiring().channel.free, f64::INFINITY),
        };
        let wanted = command.pressure.get(free).copied().unwrap_or(0.0);
        if command.vent || wanted.is_nan() { 0.0 } else { wanted.clamp(0.0, full_scale) }
    }

    /// Whether a set-point may go to it: not to a gauge.
    pub(super) fn is_regulator(&self) -> bool {
        !matches!(self, Self::Alicat(unit) if unit.wiring().gauge)
    }

    /// Whether it has to be asked now and then whether it obeys.
    pub(super) fn is_doubtful(&self) -> bool {
        matches!(self, Self::Alicat(unit) if unit.is_analog())
    }

    /// Asks whether it obeys.
    pub(super) async fn check<S>(&mut self, line: &mut Line<S>) -> Result<(), UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        match self {
            Self::Alicat(unit) => Ok(unit.on(line).check_source().await?),
            Self::Pwm(_) => Ok(()),
        }
    }

    /// Commands zero before anything is known about it; an answer does not matter yet.
    pub(super) async fn zero_blindly<S>(&mut self, line: &mut Line<S>) -> Result<(), UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        match self {
            Self::Alicat(unit) => Ok(unit.on(line).zero_blindly().await?),
            Self::Pwm(output) => Ok(output.on(line).zero_blindly().await?),
        }
    }

    /// Sends zero and waits for nothing.
    pub(super) async fn shout_zero<S>(&mut self, line: &mut Line<S>) -> Result<(), UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        match self {
            Self::Alicat(unit) => Ok(unit.on(line).shout_zero().await?),
            Self::Pwm(output) => Ok(output.on(line).shout_zero().await?),
        }
    }

    /// Commands zero, and finds out whether it is what it should be and safely set up.
    pub(super) async fn identify<S>(&mut self, line: &mut Line<S>) -> Result<PressureSample, UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        match self {
            Self::Alicat(unit) => Ok(unit.on(line).identify().await?),
            Self::Pwm(output) => Ok(output.on(line).identify().await?),
        }
    }

    /// Commands `setpoint`, Pa, and hears what it says: one exchange.
    pub(super) async fn write<S>(&mut self, line: &mut Line<S>, setpoint: f64) -> Result<PressureSample, UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        match self {
            Self::Alicat(unit) => Ok(unit.on(line).write(setpoint).await?),
            Self::Pwm(output) => Ok(output.on(line).write(setpoint).await?),
        }
    }
}

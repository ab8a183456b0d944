//! Driver of Alicat pressure controllers over their ASCII protocol.
//!
//! One exchange writes the set-point and reads the frame, in which the unit says which set-point it has
//! *accepted*: it is compared with the one sent, every time. What stays checked only when connecting is where the
//! unit takes its set-point from: from the factory that is its analogue input, and it then ignores the line.

use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};

use super::alicat_frame::{Columns, Frame, FrameError, ManifestError, register};
use super::serial_line::{Escaped, Line, LineError};
use super::wiring::UnitWiring;
use super::{HardwareError, Identity, PressureRegulator};
use crate::clock::Time;
use crate::signal::{PressureSample, RegulatorHealth, RegulatorStatus};

/// The unit resolves its set-point into so many steps of the full scale.
const SETPOINT_STEPS: f64 = 64_000.0;
/// Register 20 holds the set-point's source; below this value it is the serial line.
const ANALOG_SOURCE: u32 = 16_384;
/// A list of lines is complete when nothing has come for this long.
const LIST_PAUSE: Duration = Duration::from_millis(60);
/// Two scales that differ by less than this (relative) are the same one, rounded differently.
const SCALE_TOLERANCE: f64 = 1e-3;

/// How the unit is asked where it takes its set-point from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SourceQuery {
    /// Register 20, `A$$R20`, answered `A   020 = 00512`.
    #[default]
    Register,
    /// The command of newer firmware, `ALSS`, answered `A S` or `A U` (line) or `A A` (analogue).
    Command,
    /// Not at all; the echo of every set-point still shows whether the unit obeys.
    Unchecked,
}

/// Why an exchange with a unit brought no reading.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AlicatError {
    /// The line.
    #[error(transparent)]
    Line(#[from] LineError),
    /// The reply.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The list of the columns.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The unit counts in another unit of pressure than rig.toml says.
    #[error("the unit's frames are in {unit}, rig.toml says {configured} Pa per unit")]
    Scale {
        /// As the unit writes it.
        unit: String,
        /// What is configured, Pa.
        configured: f64,
    },
    /// A set-point that no unit may be sent.
    #[error("the set-point {0} Pa is not within 0..={1} Pa")]
    Setpoint(f64, f64),
    /// A tare under pressure would move the zero.
    #[error("tare refused at {0} Pa: vent first")]
    NotVented(f64),
    /// The reply does not answer the question.
    #[error("{0} is no answer to {1}")]
    Unexpected(Escaped, &'static str),
}

impl AlicatError {
    /// What is wrong with the line, where that is what is wrong.
    pub const fn line(&self) -> Option<&LineError> {
        if let Self::Line(error) = self { Some(error) } else { None }
    }

    /// The failure with the device's name, and what to do.
    pub fn at(&self, device: &Arc<str>) -> HardwareError {
        let (device, detail) = (device.clone(), self.to_string());
        match self {
            Self::Line(error) => error.at(&device),
            Self::Frame(_) | Self::Unexpected(..) => HardwareError::Malformed { device, detail },
            Self::Manifest(_) | Self::Scale { .. } => HardwareError::Unsafe {
                device,
                reason: detail,
                remedy: "Set the unit's data frame and engineering units, or correct rig.toml".to_owned(),
            },
            Self::Setpoint(..) | Self::NotVented(_) => {
                HardwareError::Unsafe { device, reason: detail, remedy: "Vent the rig and try again".to_owned() }
            }
        }
    }
}

/// What is known about one unit.
#[derive(Clone, Debug)]
pub struct Unit {
    wiring: UnitWiring,
    device: Arc<str>,
    source: SourceQuery,
    columns: Columns,
    analog: bool,
    sequence: u32,
    /// The unknown tokens last warned about.
    unknown: String,
}

impl Unit {
    /// A unit on the line called `line`; none if its id is not a letter from A to Z: any other byte could turn a
    /// set-point into another command.
    pub fn new(wiring: UnitWiring, line: &str) -> Option<Self> {
        let id = char::from(wiring.id);
        wiring.id.is_ascii_uppercase().then(|| Self {
            wiring,
            device: format!("Alicat unit {id} on {line}").into(),
            source: SourceQuery::default(),
            columns: Columns::default(),
            analog: false,
            sequence: 0,
            unknown: String::new(),
        })
    }

    /// The same unit, asked for its set-point's source in another way.
    pub fn with_source_query(mut self, source: SourceQuery) -> Self {
        self.source = source;
        self
    }

    /// Model, id and line.
    pub fn device(&self) -> &Arc<str> {
        &self.device
    }

    /// Who answers.
    pub fn identity(&self) -> Identity {
        Identity { device: self.device.to_string(), ..Identity::default() }
    }

    /// How it is wired.
    pub fn wiring(&self) -> &UnitWiring {
        &self.wiring
    }

    /// Whether it takes its set-point from its analogue input.
    pub fn is_analog(&self) -> bool {
        self.analog
    }

    /// The unit with the line it hangs on, for exchanges.
    pub fn on<'l, S>(&'l mut self, line: &'l mut Line<S>) -> Alicat<'l, S> {
        Alicat { unit: self, line }
    }

    /// A command to this unit.
    fn command(&self, text: &str) -> Vec<u8> {
        let mut bytes = vec![self.wiring.id];
        bytes.extend_from_slice(text.as_bytes());
        bytes
    }

    /// The set-point's text: fine enough for a hundred-thousandth of the full scale, never in exponents.
    fn setpoint_text(&self, setpoint: f64) -> Result<String, AlicatError> {
        let full_scale = self.wiring.full_scale;
        if !(0.0..=full_scale).contains(&setpoint) {
            return Err(AlicatError::Setpoint(setpoint, full_scale));
        }
        let places = (5.0 - (full_scale / self.wiring.pascals_per_unit).log10()).ceil().clamp(2.0, 8.0);
        // Adding zero turns a negative zero into a plain one.
        let value = setpoint / self.wiring.pascals_per_unit + 0.0;
        Ok(format!("S{value:.*}", places as usize))
    }

    fn sample(&mut self, frame: &Frame, time: Time) -> PressureSample {
        let scale = self.wiring.pascals_per_unit;
        self.sequence = self.sequence.wrapping_add(1);
        let analog = if self.analog { RegulatorStatus::ANALOG_SOURCE } else { RegulatorStatus::default() };
        PressureSample {
            time,
            sequence: self.sequence,
            pressure: frame.pressure * scale,
            setpoint: frame.setpoint * scale,
            status: frame.status.with(analog),
            health: RegulatorHealth::Good,
        }
    }
}

/// One unit together with the line it hangs on.
#[derive(Debug)]
pub struct Alicat<'l, S> {
    unit: &'l mut Unit,
    line: &'l mut Line<S>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Alicat<'_, S> {
    /// Commands zero before anything is known about the unit. What it answers, even `?`, does not matter yet. On
    /// a line that babbles zero is sent all the same, and the error says that nothing could be heard.
    /// A gauge is told nothing.
    pub async fn zero_blindly(&mut self) -> Result<(), AlicatError> {
        if self.unit.wiring.gauge {
            return Ok(());
        }
        let command = self.unit.command(&self.unit.setpoint_text(0.0)?);
        match self.line.transact(&command).await {
            Ok(_) => Ok(()),
            Err(error) => {
                if error == LineError::Babble {
                    self.line.shout(&command).await?;
                }
                Err(error.into())
            }
        }
    }

    /// Sends zero and waits for nothing.
    pub async fn shout_zero(&mut self) -> Result<(), AlicatError> {
        if self.unit.wiring.gauge {
            return Ok(());
        }
        let command = self.unit.command(&self.unit.setpoint_text(0.0)?);
        Ok(self.line.shout(&command).await?)
    }

    /// Commands zero, then finds out what the unit's frames hold and where it takes its set-point from; of a gauge the
    /// frames only.
    pub async fn identify(&mut self) -> Result<PressureSample, AlicatError> {
        match self.zero_blindly().await {
            Err(error) if error.line() != Some(&LineError::OutOfStep) => return Err(error),
            _ => {}
        }
        let lines = self.line.transact_lines(&self.unit.command("??D*"), LIST_PAUSE).await?;
        self.unit.columns = Columns::from_manifest(&lines, self.unit.wiring.id)?.unwrap_or_else(|| {
            tracing::warn!(
                "{} does not list its columns: that it counts in {} Pa, as rig.toml says, cannot be verified",
                self.unit.device,
                self.unit.wiring.pascals_per_unit
            );
            if self.unit.wiring.gauge { Columns::gauge() } else { Columns::default() }
        });
        let configured = self.unit.wiring.pascals_per_unit;
        if let Some(scale) = self.unit.columns.pascals_per_unit()
            && (scale / configured - 1.0).abs() > SCALE_TOLERANCE
        {
            return Err(AlicatError::Scale { unit: self.unit.columns.unit().to_owned(), configured });
        }
        if self.unit.wiring.gauge {
            return self.poll().await;
        }
        if !self.unit.columns.has_setpoint() {
            return Err(ManifestError::Missing("set-point").into());
        }
        self.check_source().await?;
        self.write(0.0).await
    }

    /// Asks where the unit takes its set-point from; the answer marks every reading from now on.
    pub async fn check_source(&mut self) -> Result<(), AlicatError> {
        let id = self.unit.wiring.id;
        let command = match self.unit.source {
            SourceQuery::Register => self.unit.command("$$R20"),
            SourceQuery::Command => self.unit.command("LSS"),
            SourceQuery::Unchecked => return Ok(()),
        };
        let reply = self.line.transact(&command).await?;
        let analog = match self.unit.source {
            SourceQuery::Register => register(reply, id).map(|value| value >= ANALOG_SOURCE),
            _ => match reply.strip_prefix(&[id]).map(<[u8]>::trim_ascii) {
                Some(b"A") => Some(true),
                Some(b"S" | b"U") => Some(false),
                _ => None,
            },
        };
        match analog {
            Some(analog) => {
                if analog && !self.unit.analog {
                    tracing::warn!(
                        "{} takes its set-point from its analogue input and ignores the line; set its set-point \
                         source to serial in its menu",
                        self.unit.device
                    );
                }
                self.unit.analog = analog;
                Ok(())
            }
            None => {
                let error = AlicatError::Unexpected(reply.into(), "the question for the set-point's source");
                self.malformed().await?;
                Err(error)
            }
        }
    }

    /// Writes `setpoint` (Pa, within the full scale) and reads the frame in one exchange; of a gauge it only reads.
    ///
    /// The reading carries [`RegulatorStatus::ECHO_MISMATCH`] where the unit has accepted another set-point, and
    /// [`RegulatorStatus::REJECTED`] where it answered `?`; the pressure then comes from a poll.
    pub async fn write(&mut self, setpoint: f64) -> Result<PressureSample, AlicatError> {
        if self.unit.wiring.gauge {
            return self.poll().await;
        }
        let command = self.unit.command(&self.unit.setpoint_text(setpoint)?);
        let (sample, frame) = match self.frame(&command).await {
            Ok(read) => read,
            Err(AlicatError::Frame(FrameError::Rejected)) => {
                let mut sample = self.poll().await?;
                sample.status = sample.status.with(RegulatorStatus::REJECTED);
                return Ok(sample);
            }
            Err(error) => return Err(error),
        };
        let scale = self.unit.wiring.pascals_per_unit;
        // The unit may round or truncate to its own steps, and the frame to its last decimal place.
        let tolerance = frame.resolution * scale + self.unit.wiring.full_scale / SETPOINT_STEPS;
        if (sample.setpoint - setpoint).abs() <= tolerance {
            return Ok(sample);
        }
        self.line.statistics().echo_mismatches.increment();
        self.line.doubt();
        Ok(PressureSample { status: sample.status.with(RegulatorStatus::ECHO_MISMATCH), ..sample })
    }

    /// Reads the frame and commands nothing.
    pub async fn poll(&mut self) -> Result<PressureSample, AlicatError> {
        self.frame(&self.unit.command("")).await.map(|read| read.0)
    }

    /// Holds the valve closed; the frames then say HLD.
    pub async fn hold_closed(&mut self) -> Result<PressureSample, AlicatError> {
        self.frame(&self.unit.command("HC")).await.map(|read| read.0)
    }

    /// Exhausts (units with an exhaust valve); the frames then say EXH.
    pub async fn exhaust(&mut self) -> Result<PressureSample, AlicatError> {
        self.frame(&self.unit.command("E")).await.map(|read| read.0)
    }

    /// Ends a hold or an exhaust.
    pub async fn cancel(&mut self) -> Result<PressureSample, AlicatError> {
        self.frame(&self.unit.command("C")).await.map(|read| read.0)
    }

    /// Makes the present pressure the zero; refused unless it is within `vented` (Pa) of zero already.
    pub async fn tare(&mut self, vented: f64) -> Result<PressureSample, AlicatError> {
        let pressure = self.poll().await?.pressure;
        if pressure.abs() <= vented {
            self.frame(&self.unit.command("P")).await.map(|read| read.0)
        } else {
            Err(AlicatError::NotVented(pressure))
        }
    }

    /// One exchange that is answered with a data frame.
    async fn frame(&mut self, command: &[u8]) -> Result<(PressureSample, Frame), AlicatError> {
        let reply = self.line.transact(command).await?;
        match self.unit.columns.parse(reply, self.unit.wiring.id) {
            Ok(frame) => {
                let sample = self.unit.sample(&frame, self.line.clock().now());
                self.note_unknown(&frame.unknown);
                Ok((sample, frame))
            }
            Err(FrameError::Rejected) => {
                self.line.statistics().rejected.increment();
                Err(FrameError::Rejected.into())
            }
            Err(error) => {
                self.malformed().await?;
                Err(error.into())
            }
        }
    }

    async fn malformed(&mut self) -> Result<(), AlicatError> {
        self.line.statistics().malformed.increment();
        Ok(self.line.resynchronise().await?)
    }

    fn note_unknown(&mut self, unknown: &str) {
        if unknown.is_empty() {
            return;
        }
        self.line.statistics().unknown_tokens.increment();
        if unknown != self.unit.unknown {
            tracing::warn!("{} reports `{unknown}`, which freerig does not know", self.unit.device);
            self.unit.unknown = unknown.to_owned();
        }
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> PressureRegulator for Alicat<'_, S> {
    async fn connect(&mut self) -> Result<Identity, HardwareError> {
        self.identify().await.map_err(|error| error.at(&self.unit.device))?;
        Ok(self.unit.identity())
    }

    async fn exchange(&mut self, setpoint: f64) -> Result<PressureSample, HardwareError> {
        self.write(setpoint).await.map_err(|error| error.at(&self.unit.device))
    }
}

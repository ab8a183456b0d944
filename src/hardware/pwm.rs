//! Driver of analogue regulators behind the PWM outputs of a microcontroller on a serial line.
//!
//! The regulator takes a voltage: the output's duty, low-passed. The microcontroller is told the duty and keeps it
//! until it has heard nothing for its own *watchdog*'s time; then the output is at zero. Each output has an id, as an
//! Alicat unit has, and answers only for itself. One exchange is one line each way, ASCII, ended by CR:
//!
//! | | |
//! | --- | --- |
//! | `A07 0800*D3` | output A, exchange 07 (00 to 99): duty 800 of 4095 |
//! | `A07 0800=*84` | its answer: the duty now in force, and how things stood before: `=` as told, `R` it has been reset since, `W` its watchdog had taken it to zero |
//! | `A08 V*B8` | what are you? |
//! | `A08 PWM1 0250*A6` | version 1 of this protocol, a watchdog of 250 ms |
//!
//! Behind the star stands the CRC of all before it: eight bits, x^8 + x^2 + x + 1, from zero, most significant bit
//! first. A line with a wrong CRC, a duty above 4095 or another id is not answered. The exchange's number makes a late
//! answer known as such. Nothing is measured: a pressure sensor is a device of its own.

use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};

use super::mcp4728::{CODE_MAX, code_of, pressure_of};
use super::serial_line::{Escaped, Line, LineError};
use super::wiring::PwmWiring;
use super::{HardwareError, Identity, PressureRegulator};
use crate::signal::{PressureSample, RegulatorHealth, RegulatorStatus};

/// What answers to the question for its kind.
const VERSION: &str = "PWM1";
/// Numbers of exchanges before they begin anew.
const SEQUENCES: u8 = 100;
/// A watchdog that is shorter would bark at a line of many units; one that is longer is none.
const WATCHDOG: std::ops::RangeInclusive<Duration> = Duration::from_millis(100)..=Duration::from_millis(1000);

/// The line `text` of exchange `sequence` with output `id`, without its CR.
pub fn frame(id: u8, sequence: u8, text: &str) -> String {
    let body = format!("{}{sequence:02} {text}", char::from(id));
    format!("{body}*{:02X}", crc(body.as_bytes()))
}

/// Id, sequence and text of a line without its CR; none of what is no whole line.
pub fn unframe(line: &[u8]) -> Option<(u8, u8, &str)> {
    let (body, check) = std::str::from_utf8(line).ok()?.rsplit_once('*')?;
    if check != format!("{:02X}", crc(body.as_bytes())) {
        return None;
    }
    let (head, text) = body.split_once(' ')?;
    let (id, sequence) = head.split_at_checked(1)?;
    Some((id.as_bytes()[0], digits(sequence, 2)?.try_into().ok()?, text))
}

/// The number that `text` is, if it is so many decimal digits.
pub fn digits(text: &str, count: usize) -> Option<u16> {
    (text.len() == count && text.bytes().all(|c| c.is_ascii_digit())).then(|| text.parse().ok()).flatten()
}

fn crc(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x07 })
    })
}

/// Why an exchange brought nothing.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PwmError {
    /// The line.
    #[error(transparent)]
    Line(#[from] LineError),
    /// A line that is damaged, or not of this protocol.
    #[error("{0} is no answer of output {id}", id = char::from(*.1))]
    Malformed(Escaped, u8),
    /// An answer to an earlier exchange.
    #[error("exchange {asked:02} was answered with number {answered:02}")]
    Sequence {
        /// The number sent.
        asked: u8,
        /// The number that came.
        answered: u8,
    },
    /// Without a watchdog the pressure would outlast a computer that stands still.
    #[error("its watchdog acts after {} ms, and has to after {} to {} ms", .0.as_millis(), WATCHDOG.start().as_millis(), WATCHDOG.end().as_millis())]
    Watchdog(Duration),
}

impl PwmError {
    /// What is wrong with the line, where that is what is wrong.
    pub const fn line(&self) -> Option<&LineError> {
        if let Self::Line(error) = self { Some(error) } else { None }
    }

    /// The failure with the device's name, and what to do.
    pub fn at(&self, device: &Arc<str>) -> HardwareError {
        match self {
            Self::Line(error) => error.at(device),
            Self::Malformed(..) | Self::Sequence { .. } => {
                HardwareError::Malformed { device: device.clone(), detail: self.to_string() }
            }
            Self::Watchdog(_) => HardwareError::Unsafe {
                device: device.clone(),
                reason: self.to_string(),
                remedy: "Set WATCHDOG_MS in its firmware".to_owned(),
            },
        }
    }
}

/// What is known about one output.
#[derive(Clone, Debug)]
pub struct PwmOutput {
    wiring: PwmWiring,
    device: Arc<str>,
    /// Number of the latest exchange.
    exchange: u8,
    /// Samples so far.
    sequence: u32,
}

impl PwmOutput {
    /// An output on the line called `line`; none if its id is not a letter from A to Z.
    pub fn new(wiring: PwmWiring, line: &str) -> Option<Self> {
        let device = format!("PWM output {} on {line}", char::from(wiring.id)).into();
        wiring.id.is_ascii_uppercase().then_some(Self { wiring, device, exchange: 0, sequence: 0 })
    }

    /// Kind, id and line.
    pub fn device(&self) -> &Arc<str> {
        &self.device
    }

    /// Who answers.
    pub fn identity(&self) -> Identity {
        Identity { device: self.device.to_string(), firmware: VERSION.to_owned(), ..Identity::default() }
    }

    /// How it is wired.
    pub fn wiring(&self) -> &PwmWiring {
        &self.wiring
    }

    /// The output with the line it hangs on, for exchanges.
    pub fn on<'l, S>(&'l mut self, line: &'l mut Line<S>) -> Pwm<'l, S> {
        Pwm { output: self, line }
    }

    /// The next exchange's line.
    fn command(&mut self, text: &str) -> String {
        self.exchange = (self.exchange + 1) % SEQUENCES;
        frame(self.wiring.id, self.exchange, text)
    }
}

/// One output together with its line.
#[derive(Debug)]
pub struct Pwm<'l, S> {
    output: &'l mut PwmOutput,
    line: &'l mut Line<S>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Pwm<'_, S> {
    /// Commands zero, whatever comes of it. On a line that babbles zero is sent all the same, and the error says that
    /// nothing could be heard.
    pub async fn zero_blindly(&mut self) -> Result<(), PwmError> {
        let command = self.output.command("0000");
        match self.line.transact(command.as_bytes()).await {
            Ok(_) => Ok(()),
            Err(error) => {
                if error == LineError::Babble {
                    self.shout_zero().await?;
                }
                Err(error.into())
            }
        }
    }

    /// Sends zero and waits for nothing.
    pub async fn shout_zero(&mut self) -> Result<(), PwmError> {
        let command = self.output.command("0000");
        Ok(self.line.shout(command.as_bytes()).await?)
    }

    /// Commands zero, then finds out whether this protocol is spoken, and whether there is a watchdog.
    pub async fn identify(&mut self) -> Result<PressureSample, PwmError> {
        match self.zero_blindly().await {
            Err(error) if error.line() != Some(&LineError::OutOfStep) => return Err(error),
            _ => {}
        }
        let watchdog = self.ask("V", |text| digits(text.strip_prefix(VERSION)?.strip_prefix(' ')?, 4)).await?;
        let watchdog = Duration::from_millis(watchdog.into());
        if !WATCHDOG.contains(&watchdog) {
            return Err(PwmError::Watchdog(watchdog));
        }
        self.write(0.0).await
    }

    /// Commands the duty for `setpoint` (Pa, by the measured map) and hears which one is in force.
    ///
    /// The sample carries [`RegulatorStatus::ECHO_MISMATCH`] where that is another one, and where the output had left
    /// the one before behind the computer's back, by a reset or by its watchdog.
    pub async fn write(&mut self, setpoint: f64) -> Result<PressureSample, PwmError> {
        let map = self.output.wiring.channel;
        let asked = code_of(map, setpoint);
        let (code, state) = self
            .ask(&format!("{asked:04}"), |text| {
                let (code, state) = text.split_at_checked(4)?;
                Some((digits(code, 4).filter(|code| *code <= CODE_MAX)?, state.parse::<char>().ok()?))
            })
            .await?;
        self.output.sequence = self.output.sequence.wrapping_add(1);
        let status = if code == asked && state == '=' {
            RegulatorStatus::default()
        } else {
            self.line.statistics().echo_mismatches.increment();
            RegulatorStatus::ECHO_MISMATCH
        };
        Ok(PressureSample {
            time: self.line.clock().now(),
            sequence: self.output.sequence,
            pressure: f64::NAN,
            setpoint: pressure_of(map, code),
            status,
            health: RegulatorHealth::Unmeasured,
        })
    }

    /// One exchange; what `understand` makes of the answer's text.
    async fn ask<T>(&mut self, text: &str, understand: impl Fn(&str) -> Option<T>) -> Result<T, PwmError> {
        let (id, command) = (self.output.wiring.id, self.output.command(text));
        let asked = self.output.exchange;
        let reply = self.line.transact(command.as_bytes()).await?;
        let understood = unframe(reply)
            .filter(|(from, ..)| *from == id)
            .and_then(|(_, answered, text)| (answered != asked).then_some(Err(answered)).or(understand(text).map(Ok)));
        match understood {
            Some(Ok(answer)) => Ok(answer),
            Some(Err(answered)) => {
                self.line.statistics().late_frames.increment();
                self.line.doubt();
                Err(PwmError::Sequence { asked, answered })
            }
            None => {
                let error = PwmError::Malformed(reply.into(), id);
                self.line.statistics().malformed.increment();
                self.line.resynchronise().await?;
                Err(error)
            }
        }
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> PressureRegulator for Pwm<'_, S> {
    async fn connect(&mut self) -> Result<Identity, HardwareError> {
        self.identify().await.map_err(|error| error.at(&self.output.device))?;
        Ok(self.output.identity())
    }

    async fn exchange(&mut self, setpoint: f64) -> Result<PressureSample, HardwareError> {
        self.write(setpoint).await.map_err(|error| error.at(&self.output.device))
    }
}

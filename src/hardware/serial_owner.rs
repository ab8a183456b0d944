//! The owner of one serial line: polls its units in turn, commands zero first, recovers by itself.
//!
//! A turn is one exchange with one unit: it writes the latest command's set-point and reads the pressure. Units
//! whose pressure is to be taken away come first. A command that has grown older than the rig's limit counts as
//! zero. The ladder of recovery: try again (the line drains itself), open the line again, then say
//! [`RegulatorHealth::Lost`] and keep trying. The first frame a unit hears after any of it is the set-point zero.
//! A line that babbles is lost as a whole, and zero is sent into the noise. A panic on the way is an error like a
//! dead line: it is opened again, and zero goes first.
//!
//! [`SerialOwner::run`] is one future. Live it has a thread and a runtime of its own ([`super::serial`]); on the
//! stepped clock a scheduler polls it until it is idle.

use std::any::Any;
use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures_util::FutureExt;
use tokio::io::{AsyncRead, AsyncWrite};
use triple_buffer::{Input, Output};

use super::alicat::Unit;
use super::pwm::PwmOutput;
use super::serial_line::{Line, LineError, LineStatistics};
use super::serial_unit::{SerialUnit, UnitError};
use super::wiring::SerialWiring;
use super::{DeviceStatistics, HardwareError};
use crate::clock::{Clock, Time};
use crate::signal::{Command, PressureSample, RegulatorHealth};

/// Failures in a row after which a unit is lost.
const LOST_AFTER: u32 = 3;
/// How often a lost unit is tried.
const PROBE_PERIOD: Duration = Duration::from_millis(500);
/// How often a line that cannot be opened is tried.
const REOPEN_PERIOD: Duration = Duration::from_millis(200);
/// How often a unit that may not obey (an Alicat in analogue mode) is asked whether it does.
const CHECK_PERIOD: Duration = Duration::from_secs(2);

/// What has happened on a line and to its units since the start.
#[derive(Debug)]
pub struct SerialStatistics {
    /// The line.
    pub line: Arc<LineStatistics>,
    /// Its units, in the order of the wiring: Alicat units, then PWM outputs.
    pub units: Vec<Arc<DeviceStatistics>>,
}

/// How a unit stands.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Link {
    /// To be identified.
    Unknown,
    /// Identified and answering.
    Up,
    /// Given up, and tried again at this time.
    Lost(Time),
}

#[derive(Debug)]
struct Slot {
    unit: SerialUnit,
    link: Link,
    failures: u32,
    /// Turn in which it was served last.
    served: u64,
    sample: PressureSample,
    check_at: Time,
    publish: Input<PressureSample>,
    statistics: Arc<DeviceStatistics>,
}

/// Why a line is no longer served.
enum End {
    Stopped,
    Dead(LineError),
    /// Nobody can be heard; zero has been sent to everybody.
    Babble(LineError),
    AllLost,
}

/// The owner of one serial line.
#[derive(Debug)]
pub struct SerialOwner<F> {
    clock: Clock,
    name: Arc<str>,
    baud: u32,
    command_timeout: Duration,
    open: F,
    command: Output<Command>,
    slots: Vec<Slot>,
    turn: u64,
    stop: Arc<AtomicBool>,
    statistics: Arc<SerialStatistics>,
}

impl<F, Fut, S> SerialOwner<F>
where
    F: FnMut() -> Fut,
    Fut: Future<Output = Result<S, HardwareError>>,
    S: AsyncRead + AsyncWrite + Unpin,
{
    /// An owner that opens its line with `open`, now and whenever it has to be opened again; takes its commands
    /// from `command`, publishes into `samples` (one for each unit of the wiring, Alicat units first, then PWM
    /// outputs), and ends with the set-points at zero when `stop` is set.
    pub fn new(
        wiring: &SerialWiring,
        clock: Clock,
        command_timeout: Duration,
        open: F,
        command: Output<Command>,
        samples: Vec<Input<PressureSample>>,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, HardwareError> {
        let name: Arc<str> = wiring.device.display().to_string().into();
        let refuse = |reason: String, remedy: &str| HardwareError::Unsafe {
            device: format!("serial line {} ({name})", wiring.name).into(),
            reason,
            remedy: remedy.to_owned(),
        };
        let alicats = wiring.units.iter().map(|w| (w.id, Unit::new(*w, &name).map(SerialUnit::Alicat)));
        let outputs = wiring.pwms.iter().map(|w| (w.id, PwmOutput::new(*w, &name).map(SerialUnit::Pwm)));
        let units: Vec<_> = alicats.chain(outputs).collect();
        if samples.len() != units.len() {
            let reason = format!("{} units are wired to {} slots", units.len(), samples.len());
            return Err(refuse(reason, "Give every unit one slot"));
        }
        let mut slots = Vec::with_capacity(samples.len());
        for ((id, unit), publish) in units.into_iter().zip(samples) {
            let Some(unit) = unit else {
                let reason = format!("`{}` is no unit id", id.escape_ascii());
                return Err(refuse(reason, "Use one of the letters A to Z"));
            };
            let statistics = Arc::new(DeviceStatistics::new(unit.device().clone()));
            slots.push(Slot {
                unit,
                link: Link::Unknown,
                failures: 0,
                served: 0,
                sample: PressureSample { pressure: f64::NAN, setpoint: f64::NAN, ..PressureSample::default() },
                check_at: Time::ZERO,
                publish,
                statistics,
            });
        }
        let statistics = Arc::new(SerialStatistics {
            line: Arc::default(),
            units: slots.iter().map(|s| s.statistics.clone()).collect(),
        });
        let baud = wiring.baud;
        Ok(Self { clock, name, baud, command_timeout, open, command, slots, turn: 0, stop, statistics })
    }

    /// What is counted; it goes on counting while the owner runs.
    pub fn statistics(&self) -> Arc<SerialStatistics> {
        self.statistics.clone()
    }

    /// Serves the line until told to stop.
    pub async fn run(mut self) {
        let mut opened = false;
        while !self.stopped() {
            match (self.open)().await {
                Ok(stream) => {
                    if std::mem::replace(&mut opened, true) {
                        self.statistics.line.reconnects.increment();
                        self.slots.iter().for_each(|s| s.statistics.reopens.increment());
                    }
                    let mut line = Line::new(stream, self.clock.clone(), self.baud, self.statistics.line.clone());
                    let since = self.clock.now();
                    let served = AssertUnwindSafe(self.serve(&mut line)).catch_unwind().await;
                    match served.unwrap_or_else(|panic| End::Dead(LineError::Io(told(&*panic)))) {
                        End::Stopped => return,
                        // Unplugged: the next attempt to open it says whether it is there.
                        End::Dead(error) => {
                            tracing::warn!("serial line {}: {error}; opening it again", self.name);
                            if self.clock.now().since(since) > REOPEN_PERIOD {
                                continue;
                            }
                            self.lose_all(&error.at(&self.name));
                        }
                        End::Babble(error) => {
                            tracing::warn!("serial line {}: {error}; zero was sent to every unit", self.name);
                            self.lose_all(&error.at(&self.name));
                        }
                        End::AllLost => {}
                    }
                }
                Err(error) => self.lose_all(&error),
            }
            self.clock.sleep(REOPEN_PERIOD).await;
        }
    }

    async fn serve(&mut self, line: &mut Line<S>) -> End {
        for slot in &mut self.slots {
            match slot.link {
                Link::Up => slot.link = Link::Unknown,
                Link::Lost(_) => slot.link = Link::Lost(self.clock.now()),
                Link::Unknown => {}
            }
        }
        // The first frame of every unit is zero, before anything is asked.
        for i in 0..self.slots.len() {
            if let Err(error) = self.slots[i].unit.zero_blindly(line).await
                && let Some(dead) = error.line().filter(|e| e.is_dead())
            {
                return End::Dead(dead.clone());
            }
        }
        loop {
            if self.stopped() {
                return self.leave(line).await;
            }
            let now = self.clock.now();
            let command = self.latest(now);
            let Some(i) = self.choose(now, &command) else {
                if self.slots.iter().all(|s| matches!(s.link, Link::Lost(_))) {
                    return End::AllLost;
                }
                self.clock.sleep(REOPEN_PERIOD).await;
                continue;
            };
            self.turn += 1;
            let turn = self.turn;
            let slot = &mut self.slots[i];
            slot.served = turn;
            if let Err(error) = slot.turn(line, &command, now).await {
                match error.line() {
                    Some(dead) if dead.is_dead() => return End::Dead(dead.clone()),
                    Some(LineError::Babble) => return self.shout(line).await,
                    _ => self.slots[i].failed(&error, self.clock.now()),
                }
            }
        }
    }

    /// The latest command; zero everywhere if it is too old.
    fn latest(&mut self, now: Time) -> Command {
        let command = *self.command.read();
        let fresh = now.since(command.time) <= self.command_timeout;
        if fresh { command } else { Command { time: command.time, ..Command::default() } }
    }

    /// Whose turn it is: first those whose pressure is to be taken away, then in turn; none if all are lost and
    /// not due for a trial.
    fn choose(&self, now: Time, command: &Command) -> Option<usize> {
        let due = |s: &Slot| !matches!(s.link, Link::Lost(at) if now < at);
        let slots = self.slots.iter().enumerate().filter(|(_, s)| due(s));
        slots
            .min_by_key(|(_, s)| {
                let urgent = s.link == Link::Up
                    && s.unit.is_regulator()
                    && s.unit.target(command) == 0.0
                    && s.sample.setpoint != 0.0
                    // A unit that does not obey must not keep the others waiting.
                    && s.served != self.turn;
                (!urgent, s.served)
            })
            .map(|(i, _)| i)
    }

    /// Sends zero to every unit: one that babbles keeps the others from being heard, not from hearing.
    async fn shout(&mut self, line: &mut Line<S>) -> End {
        for slot in &mut self.slots {
            if let Err(error) = slot.unit.shout_zero(line).await {
                return End::Dead(error.line().cloned().unwrap_or(LineError::Babble));
            }
        }
        End::Babble(LineError::Babble)
    }

    /// Commands zero once more on the way out.
    async fn leave(&mut self, line: &mut Line<S>) -> End {
        for slot in &mut self.slots {
            // The set-point is out, whatever comes of the reply.
            let _ = slot.unit.zero_blindly(line).await;
        }
        End::Stopped
    }

    fn lose_all(&mut self, error: &HardwareError) {
        let now = self.clock.now();
        for slot in &mut self.slots {
            slot.statistics.note_error(error);
            slot.lose(now);
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// What a panic said.
fn told(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("the owner panicked: {}", text.unwrap_or("without a message"))
}

impl Slot {
    /// One exchange.
    async fn turn<S>(&mut self, line: &mut Line<S>, command: &Command, now: Time) -> Result<(), UnitError>
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        let sample = if self.link == Link::Up {
            if self.unit.is_doubtful() && now >= self.check_at {
                self.check_at = now + CHECK_PERIOD;
                self.unit.check(line).await?;
            }
            self.unit.write(line, self.unit.target(command)).await?
        } else {
            let sample = self.unit.identify(line).await?;
            self.statistics.note_connected(self.unit.identity());
            self.check_at = now + CHECK_PERIOD;
            self.link = Link::Up;
            sample
        };
        self.failures = 0;
        self.statistics.reads.increment();
        self.sample = sample;
        self.publish.write(sample);
        Ok(())
    }

    fn failed(&mut self, error: &UnitError, now: Time) {
        self.statistics.retries.increment();
        if error.line() == Some(&LineError::OutOfStep) {
            return;
        }
        self.failures += 1;
        if self.failures >= LOST_AFTER || matches!(self.link, Link::Lost(_)) {
            self.statistics.note_error(&error.at(self.unit.device()));
            self.lose(now + PROBE_PERIOD);
        }
    }

    fn lose(&mut self, probe: Time) {
        if !matches!(self.link, Link::Lost(_)) {
            self.statistics.losses.increment();
            self.sample.health = RegulatorHealth::Lost;
            self.publish.write(self.sample);
        }
        self.link = Link::Lost(probe);
    }
}

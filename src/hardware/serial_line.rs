//! One request, one reply: transactions on a serial line whose devices speak only when asked.
//!
//! A device answers with a line that ends in CR, and what it does with a command that comes before is undefined.
//! So the line waits for the reply, and between transactions for 3.5 idle characters. The danger is the *late*
//! reply, the one that arrives after its transaction was given up: taken for the answer to the next command, it
//! would put every reading one step behind. After a timeout the line is therefore drained until it is quiet; if
//! the missing reply turns up, the unit is in step again. If it does not, it may still be on its way: then the
//! unit's next reply is not used, for it may be the missing one, and its own would follow as much later as its
//! command was later: so long the line must stay quiet before it is in step. Other units tell their replies from a
//! late one by its id, the first byte of every command and reply. Replies do not overtake each other; delays up to
//! `MAX_QUIET` are outlasted. What this cannot tell apart, two replies in a row that are late by different times,
//! shows in the echo of the set-point: [`Line::doubt`] lets the next command wait for what may still be coming.

use std::fmt;
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use futures_util::future::{Either, poll_fn, select};
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt, ReadBuf};

use super::{Counter, HardwareError};
use crate::clock::{Clock, Time};

/// Bits on the wire for one byte: start, eight data, stop.
const BITS_PER_BYTE: u32 = 10;
/// The longest reply that is waited for, bytes: a frame with every column and token.
const LONGEST_REPLY: u32 = 64;
/// What device, adapter and operating system may take beyond the bytes themselves.
const LATENCY: Duration = Duration::from_millis(25);
/// First quiet time after a failure; an adapter hands its bytes on within 16 ms.
const QUIET: Duration = Duration::from_millis(20);
/// Longest quiet time.
const MAX_QUIET: Duration = Duration::from_millis(640);
/// A line that is not quiet for so long, or brings more than [`BUFFER`] bytes that nobody asked for (0.27 s at
/// 19200 Bd: well below the time in which a vent has to be over), is babbling.
const BABBLE: Duration = Duration::from_secs(2);
/// The longest list that is waited for, bytes.
const LONGEST_LIST: usize = 1024;
/// Replies longer than this are noise.
const BUFFER: usize = 512;

/// What has happened on a line since the start.
#[derive(Debug, Default)]
pub struct LineStatistics {
    /// Commands sent.
    pub transactions: Counter,
    /// Replies that did not come in time.
    pub timeouts: Counter,
    /// Lines that arrived when none was expected: replies to commands that had been given up.
    pub late_frames: Counter,
    /// Replies that could not be understood.
    pub malformed: Counter,
    /// Commands that a unit rejected.
    pub rejected: Counter,
    /// Accepted set-points that were not the ones sent.
    pub echo_mismatches: Counter,
    /// Status tokens that this program does not know.
    pub unknown_tokens: Counter,
    /// Times the line was opened again.
    pub reconnects: Counter,
}

/// Why a transaction brought no reply.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum LineError {
    /// Nothing, or no complete line, in time.
    #[error("no reply within {0:?}")]
    TimedOut(Duration),
    /// A reply came, but after an earlier timeout it could have been the earlier command's: not used.
    #[error("the unit was out of step; this reply served to bring it back")]
    OutOfStep,
    /// Bytes keep coming and never make a line, or never stop.
    #[error("the line babbles")]
    Babble,
    /// The other end is gone.
    #[error("the line is unplugged")]
    Unplugged,
    /// The system refuses to read or write.
    #[error("{0}")]
    Io(String),
}

impl LineError {
    /// Whether only opening the line again can help.
    pub const fn is_dead(&self) -> bool {
        matches!(self, Self::Unplugged | Self::Io(_))
    }

    /// The failure with the name of the device that was asked, and what to do.
    pub fn at(&self, device: &Arc<str>) -> HardwareError {
        let (device, detail) = (device.clone(), self.to_string());
        match self {
            Self::TimedOut(_) | Self::OutOfStep => HardwareError::NoAnswer { device, detail },
            Self::Babble | Self::Unplugged | Self::Io(_) => HardwareError::Transfer { device, detail },
        }
    }
}

impl From<io::Error> for LineError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe | io::ErrorKind::UnexpectedEof | io::ErrorKind::WriteZero => Self::Unplugged,
            _ => Self::Io(error.to_string()),
        }
    }
}

/// Bytes from a line, printed with everything unprintable escaped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Escaped(Box<[u8]>);

impl From<&[u8]> for Escaped {
    fn from(bytes: &[u8]) -> Self {
        Self(bytes.into())
    }
}

impl fmt::Display for Escaped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}`", self.0.escape_ascii())
    }
}

/// A serial line with devices that speak when asked.
#[derive(Debug)]
pub struct Line<S> {
    stream: S,
    clock: Clock,
    byte_time: Duration,
    buffer: Vec<u8>,
    /// When the last byte went over the line, as far as is known.
    last_byte: Time,
    /// The latest reply, without its CR.
    reply: Vec<u8>,
    /// By unit: how many replies may still be on their way.
    owed: [u8; 26],
    /// When the first command that is still unanswered was sent.
    doubt_since: Time,
    /// The latest reply was not the one to its command.
    doubted: bool,
    /// Failures since the last reply that was used.
    failures: u32,
    statistics: Arc<LineStatistics>,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Line<S> {
    /// A line of `baud` over `stream`.
    pub fn new(stream: S, clock: Clock, baud: u32, statistics: Arc<LineStatistics>) -> Self {
        let byte_time = Duration::from_secs(1) * BITS_PER_BYTE / baud.max(1);
        let last_byte = clock.now();
        let (buffer, reply) = (Vec::new(), Vec::new());
        Self {
            stream,
            clock,
            byte_time,
            buffer,
            last_byte,
            reply,
            owed: [0; 26],
            doubt_since: last_byte,
            doubted: false,
            failures: 0,
            statistics,
        }
    }

    /// The clock that the line goes by.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// What has happened so far.
    pub fn statistics(&self) -> &Arc<LineStatistics> {
        &self.statistics
    }

    /// Sends `command` (CR is added) and returns the reply without its CR.
    pub async fn transact(&mut self, command: &[u8]) -> Result<&[u8], LineError> {
        let asked = unit(command);
        let patience = self.byte_time * LONGEST_REPLY + LATENCY;
        self.send(command).await?;
        let sent = self.last_byte;
        let deadline = sent + patience;
        loop {
            if self.take_line() {
                let sender = unit(&self.reply);
                if sender == asked || sender.is_none_or(|other| self.owed[other] == 0) {
                    break;
                }
                self.drop_line();
            } else if self.buffer.len() > BUFFER {
                self.resynchronise().await?;
                return Err(LineError::Babble);
            } else if self.receive(deadline).await? == 0 {
                self.statistics.timeouts.increment();
                if self.owed.iter().all(|&n| n == 0) {
                    self.doubt_since = sent;
                }
                if let Some(unit) = asked {
                    self.owed[unit] = self.owed[unit].saturating_add(1);
                }
                self.resynchronise().await?;
                return Err(LineError::TimedOut(patience));
            }
        }
        if let Some(unit) = asked
            && self.owed[unit] > 0
        {
            let behind = sent.since(self.doubt_since) + QUIET;
            self.drain(behind.min(MAX_QUIET)).await?;
            self.owed[unit] = 0;
            return Err(LineError::OutOfStep);
        }
        self.failures = 0;
        Ok(&self.reply)
    }

    /// Sends `command` and returns every line of an answer that ends when the line falls silent for `pause`;
    /// empty if nothing comes.
    pub async fn transact_lines(&mut self, command: &[u8], pause: Duration) -> Result<Vec<Vec<u8>>, LineError> {
        self.send(command).await?;
        let first = self.last_byte + self.byte_time * LONGEST_REPLY + LATENCY;
        let mut deadline = first;
        while self.receive(deadline).await? > 0 {
            deadline = first.max(self.clock.now() + pause);
            if self.buffer.len() > LONGEST_LIST {
                return Err(LineError::Babble);
            }
        }
        let mut lines: Vec<Vec<u8>> = self.buffer.split(|&c| c == b'\r').map(<[u8]>::to_vec).collect();
        lines.retain(|line| !line.trim_ascii().is_empty());
        self.buffer.clear();
        if let Some(unit) = unit(command) {
            self.owed[unit] = 0;
        }
        Ok(lines)
    }

    /// To be called when a reply made no sense: whatever else is coming is awaited and dropped.
    pub async fn resynchronise(&mut self) -> Result<(), LineError> {
        self.failures = self.failures.saturating_add(1);
        self.drain(self.quiet()).await
    }

    /// To be called when a reply made sense, but was not the one to its command: before the next command goes out,
    /// whatever else is coming is awaited and dropped.
    pub fn doubt(&mut self) {
        self.doubted = true;
    }

    /// Reads and drops until nothing has come for `quiet`.
    async fn drain(&mut self, quiet: Duration) -> Result<(), LineError> {
        let until = self.clock.now() + BABBLE;
        let mut dropped = 0;
        loop {
            self.drop_lines();
            match self.receive(self.clock.now() + quiet).await? {
                0 => return Ok(()),
                bytes => dropped += bytes,
            }
            if dropped > BUFFER || self.clock.now() > until {
                return Err(LineError::Babble);
            }
        }
    }

    /// Moves the first complete line from the buffer to `reply`; false if there is none.
    fn take_line(&mut self) -> bool {
        let Some(end) = self.buffer.iter().position(|&c| c == b'\r') else { return false };
        self.reply.clear();
        self.reply.extend(self.buffer.drain(..=end));
        self.reply.pop();
        true
    }

    /// Counts the line just taken as late.
    fn drop_line(&mut self) {
        self.statistics.late_frames.increment();
        if let Some(unit) = unit(&self.reply) {
            self.owed[unit] = self.owed[unit].saturating_sub(1);
        }
    }

    /// Drops the complete lines that have come unasked: they are late replies.
    fn drop_lines(&mut self) {
        while self.take_line() {
            self.drop_line();
        }
        if self.buffer.len() > BUFFER {
            self.buffer.clear();
        }
    }

    fn quiet(&self) -> Duration {
        (QUIET * 2u32.saturating_pow(self.failures.saturating_sub(1).min(16))).min(MAX_QUIET)
    }

    /// Waits for the idle time, drops what nobody asked for, and sends `command` with its CR.
    async fn send(&mut self, command: &[u8]) -> Result<(), LineError> {
        let idle = self.byte_time * 7 / 2;
        let until = self.clock.now() + BABBLE;
        if std::mem::take(&mut self.doubted) {
            self.drain(QUIET).await?;
        }
        let mut dropped = 0;
        // Whatever comes in the idle time is late; then the idle time begins anew.
        loop {
            match self.receive(self.last_byte + idle).await? {
                0 => break,
                bytes => dropped += bytes,
            }
            self.drop_lines();
            if dropped > BUFFER || self.clock.now() >= until {
                return Err(LineError::Babble);
            }
        }
        self.drop_lines();
        self.buffer.clear();
        self.shout(command).await
    }

    /// Sends `command` with its CR into whatever is on the line, and waits for nothing: for zero, when a unit
    /// babbles. The units hear the computer on a wire of its own.
    pub async fn shout(&mut self, command: &[u8]) -> Result<(), LineError> {
        let mut bytes = Vec::with_capacity(command.len() + 1);
        bytes.extend_from_slice(command);
        bytes.push(b'\r');
        self.statistics.transactions.increment();
        let on_wire = self.byte_time * bytes.len() as u32;
        let deadline = self.clock.now() + on_wire + LATENCY;
        match select(pin!(self.stream.write_all(&bytes)), pin!(self.clock.sleep_until(deadline))).await {
            Either::Left((result, _)) => result?,
            Either::Right(_) => return Err(LineError::Io("the line takes no more bytes".to_owned())),
        }
        self.last_byte = self.clock.now() + on_wire;
        Ok(())
    }

    /// Appends what arrives to the buffer, and says how many bytes; none if nothing has come by `deadline`.
    async fn receive(&mut self, deadline: Time) -> Result<usize, LineError> {
        let mut sleep = pin!(self.clock.sleep_until(deadline));
        let (stream, buffer) = (&mut self.stream, &mut self.buffer);
        let received = poll_fn(|cx| {
            let mut bytes = [0; 128];
            let mut read = ReadBuf::new(&mut bytes);
            match Pin::new(&mut *stream).poll_read(cx, &mut read) {
                Poll::Ready(Ok(())) if read.filled().is_empty() => Poll::Ready(Err(LineError::Unplugged)),
                Poll::Ready(Ok(())) => {
                    buffer.extend_from_slice(read.filled());
                    Poll::Ready(Ok(read.filled().len()))
                }
                Poll::Ready(Err(error)) => Poll::Ready(Err(error.into())),
                Poll::Pending => sleep.as_mut().poll(cx).map(|()| Ok(0)),
            }
        })
        .await?;
        if received > 0 {
            self.last_byte = self.clock.now();
        }
        Ok(received)
    }
}

/// Index of the unit whose id a command or reply begins with; none for what begins with no id.
fn unit(line: &[u8]) -> Option<usize> {
    line.first().filter(|c| c.is_ascii_uppercase()).map(|c| usize::from(c - b'A'))
}

//! A simulated serial line with Alicat units and PWM outputs on it: byte times, framing, the rules of when one may
//! speak.
//!
//! [`SerialLine`] is reactive: it is given bytes with the time of their coming, and asked what it has to send.
//! Two fronts put it before the real driver: [`MemoryStream`] on any clock, the stepped one above all, and
//! [`super::Pty`], a real pseudo-terminal.

use std::collections::VecDeque;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use super::{AlicatChip, Misbehaviour, Mischief, PwmChip};
use crate::clock::{Clock, Sleep, Time};

/// Bits on the wire for one byte.
const BITS_PER_BYTE: u32 = 10;
/// From the end of a command to the begin of its reply.
const LATENCY: Duration = Duration::from_micros(150);
/// A serial adapter hands over what has come in portions of at most so many bytes.
const PORTION: usize = 32;
/// How much of a unit's babble waits for somebody to read it.
const BABBLE_MEMORY: Duration = Duration::from_millis(50);
/// Longer commands are noise.
const LONGEST_COMMAND: usize = 64;

/// What hangs on the line.
pub enum SerialChip {
    /// An Alicat unit.
    Alicat(AlicatChip),
    /// A PWM output.
    Pwm(PwmChip),
}

impl From<AlicatChip> for SerialChip {
    fn from(chip: AlicatChip) -> Self {
        Self::Alicat(chip)
    }
}

impl From<PwmChip> for SerialChip {
    fn from(chip: PwmChip) -> Self {
        Self::Pwm(chip)
    }
}

impl SerialChip {
    fn id(&self) -> u8 {
        match self {
            Self::Alicat(chip) => chip.id(),
            Self::Pwm(chip) => chip.id(),
        }
    }

    fn power_off(&mut self, now: Time) {
        match self {
            Self::Alicat(chip) => chip.power_off(),
            Self::Pwm(chip) => chip.power_off(now),
        }
    }

    fn power_on(&mut self, now: Time) {
        match self {
            Self::Alicat(chip) => chip.power_on(now),
            Self::Pwm(chip) => chip.power_on(now),
        }
    }

    fn freeze(&mut self, frozen: bool, now: Time) {
        match self {
            Self::Alicat(chip) => chip.freeze(frozen, now),
            Self::Pwm(chip) => chip.freeze(frozen),
        }
    }

    /// What it answers to a command (without id and CR), with its CRs; nothing where it does not answer.
    fn command(&mut self, command: &[u8], now: Time) -> Vec<u8> {
        match self {
            Self::Alicat(chip) => chip.command(command, now),
            Self::Pwm(chip) => chip.command(command, now),
        }
    }
}

struct Seat {
    chip: SerialChip,
    mischief: Mischief,
}

/// A complete command, to be carried out at its time.
struct Pending {
    at: Time,
    command: Vec<u8>,
    /// It came before the previous reply was over: what the units make of it is undefined.
    collided: bool,
}

/// The line and the units on it.
pub struct SerialLine {
    byte_time: Duration,
    seats: Vec<Seat>,
    rng: Pcg64,
    plugged: bool,
    /// Counts how often it has been plugged in: what was opened before is dead.
    plugs: u32,
    command: Vec<u8>,
    command_began: Time,
    /// End of the last byte that came in.
    heard_until: Time,
    /// End of the last byte sent.
    spoke_until: Time,
    pending: VecDeque<Pending>,
    /// What is sent, by the time when it has arrived.
    sending: VecDeque<(Time, Vec<u8>)>,
    /// Id of a unit that has begun to send random bytes and does not stop.
    babbler: Option<u8>,
    listeners: Vec<Arc<Mutex<Vec<Vec<u8>>>>>,
}

impl SerialLine {
    /// A line of `baud` without units, plugged in. The seed is for the garbage.
    pub fn new(baud: u32, seed: u64) -> Self {
        Self {
            byte_time: Duration::from_secs(1) * BITS_PER_BYTE / baud.max(1),
            seats: Vec::new(),
            rng: Pcg64::seed_from_u64(seed),
            plugged: true,
            plugs: 0,
            command: Vec::new(),
            command_began: Time::ZERO,
            heard_until: Time::ZERO,
            spoke_until: Time::ZERO,
            pending: VecDeque::new(),
            sending: VecDeque::new(),
            babbler: None,
            listeners: Vec::new(),
        }
    }

    /// Connects a unit; the handle makes it misbehave.
    pub fn attach(&mut self, chip: impl Into<SerialChip>) -> Mischief {
        let mischief = Mischief::default();
        self.seats.push(Seat { chip: chip.into(), mischief: mischief.clone() });
        mischief
    }

    /// The Alicat unit with this id.
    pub fn unit(&mut self, id: u8) -> Option<&mut AlicatChip> {
        let chip = self.seats.iter_mut().map(|s| &mut s.chip).find(|c| c.id() == id)?;
        if let SerialChip::Alicat(unit) = chip { Some(unit) } else { None }
    }

    /// The PWM output with this id.
    pub fn output(&mut self, id: u8) -> Option<&mut PwmChip> {
        let chip = self.seats.iter_mut().map(|s| &mut s.chip).find(|c| c.id() == id)?;
        if let SerialChip::Pwm(output) = chip { Some(output) } else { None }
    }

    /// Pulls the plug (the units keep their power), or plugs it in again; what was under way is lost.
    pub fn plug(&mut self, plugged: bool) {
        if plugged && !self.plugged {
            self.plugs += 1;
        }
        self.plugged = plugged;
        self.command.clear();
        self.pending.clear();
        self.sending.clear();
    }

    /// Ends a unit's babble, by power off and on.
    pub fn hush(&mut self) {
        let Some(babbler) = self.babbler.take() else { return };
        let (now, seats) = (self.spoke_until, self.seats.iter_mut());
        seats.filter(|s| s.chip.id() == babbler).for_each(|s| s.chip.power_off(now));
    }

    /// Every complete command that arrives at the units from now on, without its CR; grows until it is emptied.
    pub fn eavesdrop(&mut self) -> Arc<Mutex<Vec<Vec<u8>>>> {
        let heard = Arc::<Mutex<Vec<Vec<u8>>>>::default();
        self.listeners.push(Arc::clone(&heard));
        heard
    }

    /// Whether it is plugged in.
    pub fn is_plugged(&self) -> bool {
        self.plugged
    }

    /// Takes bytes that the computer sends from `at` on.
    pub fn receive(&mut self, bytes: &[u8], at: Time) {
        self.run_until(at);
        for &byte in bytes {
            let began = at.max(self.heard_until);
            self.heard_until = began + self.byte_time;
            if self.command.is_empty() {
                self.command_began = began;
            }
            if byte != b'\r' {
                self.command.push(byte);
                self.command.truncate(LONGEST_COMMAND);
                continue;
            }
            let command = std::mem::take(&mut self.command);
            for listener in &self.listeners {
                listener.lock().unwrap_or_else(PoisonError::into_inner).push(command.clone());
            }
            // Commands have a wire of their own: a unit that babbles keeps the others from being heard, not from
            // hearing.
            if self.babbler.is_some() {
                self.pending.push_back(Pending { at: self.heard_until + LATENCY, command, collided: false });
                continue;
            }
            let collided = self.command_began < self.spoke_until || !self.pending.is_empty();
            let too_soon = self.command_began < self.spoke_until + self.byte_time * 7 / 2;
            if collided || !too_soon || self.spoke_until == Time::ZERO {
                self.pending.push_back(Pending { at: self.heard_until + LATENCY, command, collided });
            }
        }
    }

    /// When there is something to be done or to be taken next.
    pub fn next_ready(&self) -> Option<Time> {
        let command = self.pending.front().map(|p| p.at);
        let bytes = self.sending.front().map(|s| s.0);
        let babble = self.babbler.map(|_| self.spoke_until);
        command.into_iter().chain(bytes).chain(babble).min()
    }

    /// Takes at most `most` of the bytes that have arrived by `now`.
    pub fn take(&mut self, now: Time, most: usize) -> Vec<u8> {
        self.run_until(now);
        let mut taken = Vec::new();
        while let Some((at, bytes)) = self.sending.front_mut()
            && *at <= now
            && taken.len() < most
        {
            let count = bytes.len().min(most - taken.len());
            taken.extend(bytes.drain(..count));
            if bytes.is_empty() {
                self.sending.pop_front();
            }
        }
        taken
    }

    fn run_until(&mut self, now: Time) {
        while self.pending.front().is_some_and(|p| p.at <= now) {
            if let Some(pending) = self.pending.pop_front() {
                self.carry_out(pending);
            }
        }
        while self.babbler.is_some() && self.spoke_until <= now {
            // What nobody listened to is gone.
            let at = self.spoke_until.max(now - BABBLE_MEMORY);
            let noise = self.noise(PORTION / 2);
            self.send(noise, at, Duration::ZERO);
        }
    }

    fn carry_out(&mut self, Pending { at, command, collided }: Pending) {
        if collided {
            let noise = self.noise(12);
            return self.send(noise, at, Duration::ZERO);
        }
        let Some((&id, rest)) = command.split_first() else { return };
        let babbler = self.babbler;
        if babbler == Some(id) {
            return;
        }
        // Nobody answers to an id that is not there.
        let Some(seat) = self.seats.iter_mut().find(|s| s.chip.id() == id) else { return };
        let chip = &mut seat.chip;
        let how = seat.mischief.take();
        chip.freeze(how == Misbehaviour::Stuck, at);
        let mut delay = Duration::ZERO;
        let mut reply = match how {
            Misbehaviour::Silent => {
                chip.power_off(at);
                return;
            }
            Misbehaviour::Nak => b"?\r".to_vec(),
            Misbehaviour::Reset => {
                chip.power_on(at);
                chip.command(rest, at)
            }
            Misbehaviour::Babble => {
                self.babbler = Some(id);
                self.spoke_until = at;
                return;
            }
            _ => chip.command(rest, at),
        };
        if babbler.is_some() || reply.is_empty() {
            return;
        }
        match how {
            // The adapter keeps the reply back: the unit itself has spoken and listens again.
            Misbehaviour::Late(by) => delay = by,
            Misbehaviour::WrongId => reply[0] = if id == b'Z' { b'A' } else { id + 1 },
            Misbehaviour::Truncated => reply.truncate(reply.len() / 2),
            Misbehaviour::BitFlip => {
                let i = self.rng.random_range(0..reply.len());
                reply[i] ^= 0x80;
            }
            Misbehaviour::Garbage => {
                reply = self.noise(reply.len());
                reply.push(b'\r');
            }
            _ => {}
        }
        self.send(reply, at, delay);
    }

    /// Random bytes, none of them a CR.
    fn noise(&mut self, length: usize) -> Vec<u8> {
        (0..length).map(|_| self.rng.random::<u8>()).map(|c| if c == b'\r' { 0 } else { c }).collect()
    }

    /// Sends from `at` on; the computer gets it later by `delay`, and never before what was sent earlier.
    fn send(&mut self, reply: Vec<u8>, at: Time, delay: Duration) {
        let mut until = at;
        for portion in reply.chunks(PORTION) {
            until = until + self.byte_time * portion.len() as u32;
            let arrival = self.sending.back().map_or(until + delay, |s| s.0.max(until + delay));
            self.sending.push_back((arrival, portion.to_vec()));
        }
        self.spoke_until = self.spoke_until.max(until);
    }
}

/// The computer's end of a simulated line, on any clock.
pub struct MemoryStream {
    line: Arc<Mutex<SerialLine>>,
    clock: Clock,
    plugs: u32,
    /// Kept, so that a runtime's timer stays registered.
    wait: Option<Pin<Box<Sleep>>>,
}

impl MemoryStream {
    /// Opens the line; an error if it is not plugged in.
    pub fn open(line: &Arc<Mutex<SerialLine>>, clock: Clock) -> io::Result<Self> {
        let state = line.lock().unwrap_or_else(PoisonError::into_inner);
        if !state.plugged {
            return Err(io::ErrorKind::NotFound.into());
        }
        Ok(Self { line: line.clone(), clock, plugs: state.plugs, wait: None })
    }
}

impl AsyncRead for MemoryStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = &mut *self;
        loop {
            let now = this.clock.now();
            let mut line = this.line.lock().unwrap_or_else(PoisonError::into_inner);
            if !line.plugged || line.plugs != this.plugs {
                return Poll::Ready(Ok(()));
            }
            let bytes = line.take(now, buf.remaining());
            if !bytes.is_empty() {
                buf.put_slice(&bytes);
                return Poll::Ready(Ok(()));
            }
            let Some(next) = line.next_ready() else { return Poll::Pending };
            let wait = this.wait.insert(Box::pin(this.clock.sleep_until(next)));
            if wait.as_mut().poll(cx).is_pending() {
                return Poll::Pending;
            }
        }
    }
}

impl AsyncWrite for MemoryStream {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let now = self.clock.now();
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        if !line.plugged || line.plugs != self.plugs {
            return Poll::Ready(Err(rustix::io::Errno::IO.into()));
        }
        line.receive(bytes, now);
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

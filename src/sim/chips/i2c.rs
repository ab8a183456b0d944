//! A simulated I2C bus: chips by address behind the real bus trait, on the bus owner's own clock.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::{Misbehaviour, Mischief};
use crate::clock::{Clock, Time};

/// Address of the general call, which every chip hears.
const GENERAL_CALL: u8 = 0x00;
/// All ones: nobody's, and nine clocks with the data line let go.
const NOBODY: u8 = 0x7F;

/// A chip's refusal to acknowledge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nak;

/// A chip on a simulated bus.
pub trait I2cChip: Send {
    /// Takes the bytes written to it from `now` on (the address byte is over).
    fn write(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak>;

    /// Fills `bytes`, asked for from `now` on.
    fn read(&mut self, now: Time, bytes: &mut [u8]) -> Result<(), Nak>;

    /// Hears a general call; chips that have no use for it do not acknowledge.
    fn general_call(&mut self, now: Time, bytes: &[u8]) -> Result<(), Nak> {
        let _ = (now, bytes);
        Err(Nak)
    }

    /// The bench has been on for a while when the program finds it: the state after power-on, start-up time over.
    fn attached(&mut self, now: Time) {
        self.power_on(now);
    }

    /// Power comes (back): everything volatile is lost.
    fn power_on(&mut self, now: Time);

    /// The readings freeze at what they are `now`, or run again.
    fn freeze(&mut self, now: Time, frozen: bool);
}

/// Error of a simulated bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimI2cError(ErrorKind);

impl Error for SimI2cError {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

impl fmt::Display for SimI2cError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl std::error::Error for SimI2cError {}

struct Seat {
    address: u8,
    chip: Box<dyn I2cChip>,
    mischief: Mischief,
    /// Unplugged until the next exchange that finds it plugged in again.
    away: bool,
}

struct Wires {
    seats: Vec<Seat>,
    /// A device holds the data line, until it has been clocked to the end of its byte.
    held: bool,
    /// For garbage and flipped bits only.
    noise: Pcg64,
}

/// A handle on a simulated bus; clones share wires and clock. Every transfer moves the clock by its own duration
/// (9 bits a byte): stepped it runs ahead, live it sleeps.
#[derive(Clone)]
pub struct SimI2c {
    wires: Arc<Mutex<Wires>>,
    clock: Clock,
    bit: Duration,
}

impl SimI2c {
    /// An empty bus at `frequency` Hz (100 000 or 400 000) on `clock`, which must be a clone of the one of the
    /// bus owner: its transfers block that owner.
    pub fn new(clock: Clock, frequency: u32) -> Self {
        let wires = Wires { seats: Vec::new(), held: false, noise: Pcg64::seed_from_u64(0x12c) };
        let bit = Duration::from_nanos(1_000_000_000 / u64::from(frequency.max(1)));
        Self { wires: Arc::new(Mutex::new(wires)), clock, bit }
    }

    /// Puts `chip` on the bus, powered a while ago, and returns the handle by which it is made to misbehave.
    pub fn attach(&self, address: u8, mut chip: impl I2cChip + 'static) -> Mischief {
        chip.attached(self.clock.now());
        let mischief = Mischief::default();
        let seat = Seat { address, chip: Box::new(chip), mischief: mischief.clone(), away: false };
        self.wires.lock().unwrap_or_else(PoisonError::into_inner).seats.push(seat);
        mischief
    }

    /// A device that was interrupted in an answer holds the data line: no transfer gets through until somebody clocks
    /// it to the end of its byte, with an address that nobody has.
    pub fn hold(&self) {
        self.wires.lock().unwrap_or_else(PoisonError::into_inner).held = true;
    }

    /// Pulls the reset line of the chip at `address`: it starts from nothing, even where it hung.
    pub fn pull_reset(&self, address: u8) {
        let now = self.clock.now();
        let mut wires = self.wires.lock().unwrap_or_else(PoisonError::into_inner);
        for seat in wires.seats.iter_mut().filter(|seat| seat.address == address) {
            seat.mischief.unhang();
            seat.chip.power_on(now);
        }
    }

    /// Duration of `bytes` bytes with their acknowledge bits.
    fn bytes(&self, bytes: usize) -> Duration {
        self.bit * 9 * u32::try_from(bytes).unwrap_or(u32::MAX)
    }
}

impl ErrorType for SimI2c {
    type Error = SimI2cError;
}

impl I2c for SimI2c {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), SimI2cError> {
        let mut wires = self.wires.lock().unwrap_or_else(PoisonError::into_inner);
        let Wires { seats, held, noise } = &mut *wires;
        // Start and stop conditions count one bit each.
        let mut now = self.clock.now() + self.bit;
        if std::mem::take(held) && address != NOBODY {
            *held = true;
            drop(wires);
            self.clock.block_until(now + self.bytes(1));
            return Err(SimI2cError(ErrorKind::ArbitrationLoss));
        }
        let result = if address == GENERAL_CALL {
            let mut heard = false;
            for operation in operations.iter_mut() {
                if let Operation::Write(bytes) = operation {
                    now = now + self.bytes(1 + bytes.len());
                    for seat in seats.iter_mut().filter(|s| !s.away) {
                        heard |= seat.chip.general_call(now, bytes).is_ok();
                    }
                }
            }
            if heard { Ok(()) } else { Err(NoAcknowledgeSource::Address) }
        } else {
            match seats.iter_mut().find(|s| s.address == address) {
                Some(seat) => seat.exchange(&mut now, operations, noise, |n| self.bytes(n)),
                None => {
                    now = now + self.bytes(1);
                    Err(NoAcknowledgeSource::Address)
                }
            }
        };
        drop(wires);
        self.clock.block_until(now + self.bit);
        result.map_err(|source| SimI2cError(ErrorKind::NoAcknowledge(source)))
    }
}

impl Seat {
    /// One transaction with this chip from `now` on, which moves along.
    fn exchange(
        &mut self,
        now: &mut Time,
        operations: &mut [Operation<'_>],
        noise: &mut Pcg64,
        bytes: impl Fn(usize) -> Duration,
    ) -> Result<(), NoAcknowledgeSource> {
        let how = self.mischief.take();
        if matches!(how, Misbehaviour::Silent | Misbehaviour::Nak | Misbehaviour::Hung) {
            self.away |= how == Misbehaviour::Silent;
            *now = *now + bytes(1);
            return Err(NoAcknowledgeSource::Address);
        }
        if self.away || how == Misbehaviour::Reset {
            self.away = false;
            self.chip.power_on(*now);
        }
        self.chip.freeze(*now, how == Misbehaviour::Stuck);
        for operation in operations {
            *now = *now + bytes(1);
            if let Misbehaviour::Late(late) = how {
                *now = *now + late;
            }
            match operation {
                Operation::Write(sent) => {
                    self.chip.write(*now, sent).map_err(|Nak| NoAcknowledgeSource::Address)?;
                    *now = *now + bytes(sent.len());
                }
                Operation::Read(answer) => {
                    self.chip.read(*now, answer).map_err(|Nak| NoAcknowledgeSource::Address)?;
                    *now = *now + bytes(answer.len());
                    match how {
                        Misbehaviour::Garbage => noise.fill(&mut **answer),
                        Misbehaviour::BitFlip if !answer.is_empty() => {
                            let at = noise.random_range(0..answer.len());
                            answer[at] ^= 0x80;
                        }
                        _ => {}
                    }
                }
            }
        }
        Ok(())
    }
}

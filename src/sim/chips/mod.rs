//! Simulated chips, at register and byte level: the real drivers talk to them over the real bus traits.
//!
//! A test or a procedure holds a [`Mischief`] of each chip, and makes it misbehave while everything runs.

mod ads1115;
mod alicat;
mod bno055;
mod i2c;
mod line;
mod mcp4728;
mod pty;
mod pwm;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

pub use ads1115::{Ads1115Chip, VoltageSource};
pub use alicat::AlicatChip;
pub use bno055::{Bno055Chip, Bno055Sim, Motion, Orientation};
pub use i2c::{I2cChip, Nak, SimI2c, SimI2cError};
pub use line::{MemoryStream, SerialChip, SerialLine};
pub use mcp4728::{DacRegister, Mcp4728Chip, VoltageSink};
pub use pty::{Promote, Pty};
pub use pwm::PwmChip;

/// Ways in which a chip can go wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Misbehaviour {
    /// It does not.
    #[default]
    None,
    /// Refuses: the I2C address is not acknowledged; a unit on a serial line answers `?`. State is kept.
    Nak,
    /// Loses its power for a moment before the exchange and starts from nothing, as after a brown-out.
    Reset,
    /// Hangs: does not acknowledge until its reset line is pulled ([`SimI2c::pull_reset`]) or its power is cut.
    Hung,
    /// Answers with random bytes.
    Garbage,
    /// The most significant bit of one byte of the answer is flipped.
    BitFlip,
    /// Answers late by this much (I2C: stretches the clock).
    Late(Duration),
    /// Unplugged: no answer at all. Afterwards it starts from nothing, as after [`Misbehaviour::Reset`].
    Silent,
    /// Answers, but always with the readings of the moment it got stuck; a PWM output with its latest answer.
    Stuck,
    /// Answers with another unit's id (serial; elsewhere as [`Misbehaviour::Garbage`]).
    WrongId,
    /// The answer breaks off in the middle (serial; elsewhere as [`Misbehaviour::Garbage`]).
    Truncated,
    /// Sends random bytes from now on and never stops ([`SerialLine::hush`]; elsewhere as [`Misbehaviour::Garbage`]).
    Babble,
}

#[derive(Debug, Default)]
struct Plan {
    always: Misbehaviour,
    next: Misbehaviour,
    left: u32,
}

/// Handle by which a chip is told to misbehave; clones speak to the same chip.
#[derive(Clone, Debug, Default)]
pub struct Mischief(Arc<Mutex<Plan>>);

impl Mischief {
    /// Misbehaves in every exchange from now on, until told otherwise.
    pub fn always(&self, how: Misbehaviour) {
        self.plan(|p| p.always = how);
    }

    /// Misbehaves in the next `count` exchanges.
    pub fn next(&self, count: u32, how: Misbehaviour) {
        self.plan(|p| (p.next, p.left) = (how, count));
    }

    /// Behaves from now on.
    pub fn stop(&self) {
        self.plan(|p| *p = Plan::default());
    }

    /// Its reset has been pulled: what hung runs again.
    fn unhang(&self) {
        self.plan(|p| {
            if p.always == Misbehaviour::Hung {
                *p = Plan::default();
            }
        });
    }

    /// The chip's side: what to do in this exchange.
    pub fn take(&self) -> Misbehaviour {
        self.plan(|p| {
            if p.left == 0 {
                return p.always;
            }
            p.left -= 1;
            p.next
        })
    }

    fn plan<R>(&self, f: impl FnOnce(&mut Plan) -> R) -> R {
        f(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mischief_is_for_a_while_or_for_ever() {
        let chip = Mischief::default();
        let hand = chip.clone();
        assert_eq!(chip.take(), Misbehaviour::None);
        hand.always(Misbehaviour::Stuck);
        hand.next(2, Misbehaviour::Nak);
        assert_eq!(
            [chip.take(), chip.take(), chip.take()],
            [Misbehaviour::Nak, Misbehaviour::Nak, Misbehaviour::Stuck]
        );
        hand.stop();
        assert_eq!(chip.take(), Misbehaviour::None);
    }
}

//! The dump valve and its owner.
//!
//! The valve is normally open: without power it exhausts. Its owner keeps it closed only while the tick's
//! command is fresh and no vent is commanded.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use triple_buffer::Output;

use super::HardwareError;
use crate::clock::{Clock, Time};
use crate::signal::Command;

/// How often the owner looks at the command.
const PERIOD: Duration = Duration::from_millis(5);

/// A valve that exhausts every FREE of the rig at once.
pub trait DumpValve {
    /// Opens (exhausts) or closes the valve.
    ///
    /// # Errors
    /// If the output cannot be driven; the valve's position is then unknown.
    fn set(&mut self, open: bool) -> Result<(), HardwareError>;

    /// Says that the valve is to stay closed: called in every cycle in which it is.
    ///
    /// # Errors
    /// If the output cannot be driven; the valve then opens by itself, where its heartbeat is wired.
    fn beat(&mut self) -> Result<(), HardwareError>;
}

/// Drives a dump valve from the tick's command.
pub struct ValveOwner<V: DumpValve> {
    valve: V,
    commands: Output<Command>,
    clock: Clock,
    timeout: Duration,
    open: Option<bool>,
    /// The latest failure has been told.
    told: bool,
    due: Time,
}

impl<V: DumpValve> ValveOwner<V> {
    /// An owner of `valve` that opens it when the command grows older than `timeout`.
    pub fn new(valve: V, commands: Output<Command>, clock: Clock, timeout: Duration) -> Self {
        let due = clock.now();
        Self { valve, commands, clock, timeout, open: None, told: false, due }
    }

    /// When the next [`ValveOwner::cycle`] is due.
    pub fn next_due(&self) -> Time {
        self.due
    }

    /// Looks at the command and moves the valve if it has to.
    pub fn cycle(&mut self) {
        let now = self.clock.now();
        self.due = now + PERIOD;
        let command = *self.commands.read();
        let open = command.vent || now.since(command.time) > self.timeout;
        let moved = if self.open == Some(open) { Ok(()) } else { self.valve.set(open) };
        match moved.and_then(|()| if open { Ok(()) } else { self.valve.beat() }) {
            Ok(()) => (self.open, self.told) = (Some(open), false),
            // Tried again at the next cycle.
            Err(error) => {
                if !std::mem::replace(&mut self.told, true) {
                    tracing::error!(%error, open, "the dump valve could not be driven");
                }
                self.open = None;
            }
        }
    }

    /// Cycles until `stop`.
    pub fn run(mut self, stop: &AtomicBool) {
        while !stop.load(Ordering::Acquire) {
            self.cycle();
            self.clock.block_until(self.due);
        }
    }
}

/// An owner that ends, even by a panic, leaves the valve open.
impl<V: DumpValve> Drop for ValveOwner<V> {
    fn drop(&mut self) {
        if let Err(error) = self.valve.set(true) {
            tracing::error!(%error, "the dump valve could not be opened at the end");
        }
    }
}

//! Digital lines: the coil of the dump valve with its heartbeat, the emergency stop's contact, and the supply's
//! pressure switch.
//!
//! | line | high | low |
//! | --- | --- | --- |
//! | dump valve | the coil has its current: closed | open: it exhausts |
//! | heartbeat | changes in every cycle in which the valve is to stay closed | |
//! | emergency stop | the contact is closed: released | pressed, or its wire is broken |
//! | supply | the pressure switch is closed: enough | too low, or its wire is broken |
//! | an IMU's reset | it runs | it is reset |
//!
//! Every line is safe without power and without this program. The heartbeat is for a retriggerable one-shot in series
//! with the coil: if it stands still, whatever the program or the output stage believes, the valve opens.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use embedded_hal::digital::{InputPin, OutputPin};
use linux_embedded_hal::CdevPin;
use linux_embedded_hal::gpio_cdev::{Chip, LineRequestFlags};

use super::{DumpValve, HardwareError};
use crate::clock::{Clock, Time};

/// How often a contact is looked at.
pub const LOOK: Duration = Duration::from_millis(2);
/// Looks in a row that must agree: a relay nearby is no emergency.
const LOOKS: u32 = 2;
/// How often a line that cannot be opened is tried.
const RETRY: Duration = Duration::from_millis(500);

/// Opens a line, now and whenever it has to be opened again.
pub type OpenPin<P> = Box<dyn FnMut() -> Result<P, HardwareError> + Send>;

/// Opens `line` of the chip at `chip` (`/dev/gpiochipN`) as an output, low.
///
/// # Errors
/// [`HardwareError::Open`].
pub fn output(chip: &Path, line: u32) -> Result<CdevPin, HardwareError> {
    request(chip, line, LineRequestFlags::OUTPUT)
}

/// Opens `line` of the chip at `chip` as an input.
///
/// # Errors
/// [`HardwareError::Open`].
pub fn input(chip: &Path, line: u32) -> Result<CdevPin, HardwareError> {
    request(chip, line, LineRequestFlags::INPUT)
}

fn request(chip: &Path, line: u32, flags: LineRequestFlags) -> Result<CdevPin, HardwareError> {
    let device: Arc<str> = format!("line {line} of {}", chip.display()).into();
    let pin = Chip::new(chip)
        .and_then(|mut chip| chip.get_line(line))
        .and_then(|line| line.request(flags, 0, "freerig").map(|handle| (line, handle)));
    let failed = |reason: String| HardwareError::Open {
        device: device.clone(),
        reason,
        remedy: "Correct `[gpio]` in rig.toml (gpioinfo lists the lines), end the program that holds the line, or add \
                 the user that runs freerig to the group of the file (`gpio`)"
            .into(),
    };
    let (_, handle) = pin.map_err(|error| failed(error.to_string()))?;
    CdevPin::new(handle).map_err(|error| failed(format!("{error:?}")))
}

/// A pin that is opened when it is first needed, and again after it has failed.
struct Lazy<P> {
    open: OpenPin<P>,
    pin: Option<P>,
    /// Not before this time.
    retry: Time,
    clock: Clock,
}

impl<P> Lazy<P> {
    fn new(open: OpenPin<P>, clock: Clock) -> Self {
        Self { open, pin: None, retry: Time::ZERO, clock }
    }

    fn with<T, E: std::fmt::Debug>(
        &mut self,
        what: &'static str,
        act: impl FnOnce(&mut P) -> Result<T, E>,
    ) -> Result<T, HardwareError> {
        let device: Arc<str> = what.into();
        let now = self.clock.now();
        let pin = match &mut self.pin {
            Some(pin) => pin,
            None if now < self.retry => {
                return Err(HardwareError::NoAnswer { device, detail: "its line is not open".into() });
            }
            none => {
                self.retry = now + RETRY;
                none.insert((self.open)()?)
            }
        };
        act(pin).map_err(|error| {
            self.pin = None;
            HardwareError::Transfer { device, detail: format!("{error:?}") }
        })
    }
}

/// Pulls a device's reset line (low), or lets go of it (high).
pub type ResetLine = Box<dyn FnMut(bool) -> Result<(), HardwareError> + Send>;

/// The reset line behind `open`, which is opened when it is first pulled: until then the device's own pull-up holds it.
pub fn reset_line<P: OutputPin + Send + 'static>(open: OpenPin<P>, clock: &Clock) -> ResetLine {
    let mut line = Lazy::new(open, clock.clone());
    Box::new(move |pull| line.with("IMU's reset line", |pin| if pull { pin.set_low() } else { pin.set_high() }))
}

/// The dump valve behind a digital line, and its heartbeat where one is wired.
pub struct GpioValve<P> {
    coil: Lazy<P>,
    heartbeat: Option<Lazy<P>>,
    high: bool,
}

impl<P: OutputPin> GpioValve<P> {
    /// A valve whose lines are opened when they are first needed.
    pub fn new(coil: OpenPin<P>, heartbeat: Option<OpenPin<P>>, clock: &Clock) -> Self {
        let heartbeat = heartbeat.map(|open| Lazy::new(open, clock.clone()));
        Self { coil: Lazy::new(coil, clock.clone()), heartbeat, high: false }
    }
}

impl<P: OutputPin> DumpValve for GpioValve<P> {
    fn set(&mut self, open: bool) -> Result<(), HardwareError> {
        self.coil.with("dump valve", |pin| if open { pin.set_low() } else { pin.set_high() })
    }

    fn beat(&mut self) -> Result<(), HardwareError> {
        let Some(heartbeat) = &mut self.heartbeat else { return Ok(()) };
        self.high = !self.high;
        let high = self.high;
        heartbeat.with("dump valve's heartbeat", |pin| if high { pin.set_high() } else { pin.set_low() })
    }
}

/// Which contact is watched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// The emergency stop's.
    Stop,
    /// The supply's pressure switch.
    Supply,
}

impl Contact {
    const fn name(self) -> &'static str {
        match self {
            Contact::Stop => "emergency stop's input",
            Contact::Supply => "supply's pressure switch",
        }
    }

    const fn opens(self) -> &'static str {
        match self {
            Contact::Stop => "emergency stop at its input: pressed, or its wire is broken",
            Contact::Supply => "the supply's pressure switch says low, or its wire is broken",
        }
    }
}

/// Watches a contact. What cannot be read counts as open: pressed, or low.
pub struct ContactWatch<P> {
    contact: Contact,
    pin: Lazy<P>,
    open: Arc<AtomicBool>,
    clock: Clock,
    due: Time,
    /// What the latest looks in a row have shown, and how many.
    seen: (bool, u32),
}

impl<P: InputPin> ContactWatch<P> {
    /// A watch that tells `flag` whether the contact is open; its line is opened when it is first needed. Until it has
    /// been read it counts as open.
    pub fn new(contact: Contact, line: OpenPin<P>, flag: Arc<AtomicBool>, clock: Clock) -> Self {
        flag.store(true, Ordering::Release);
        let due = clock.now();
        Self { contact, pin: Lazy::new(line, clock.clone()), open: flag, clock, due, seen: (true, LOOKS) }
    }

    /// When the next [`ContactWatch::cycle`] is due.
    pub fn next_due(&self) -> Time {
        self.due
    }

    /// Looks at the contact.
    pub fn cycle(&mut self) {
        self.due = self.clock.now() + LOOK;
        let open = self.pin.with(self.contact.name(), |pin| pin.is_low()).unwrap_or(true);
        self.seen = if self.seen.0 == open { (open, self.seen.1.saturating_add(1)) } else { (open, 1) };
        if self.seen.1 >= LOOKS && self.open.swap(open, Ordering::AcqRel) != open {
            match open {
                true => tracing::warn!("{}", self.contact.opens()),
                false => tracing::info!("{}: closed", self.contact.name()),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_is_not_there_says_what_to_do_and_counts_as_pressed() {
        let error = output(Path::new("/nonexistent/gpiochip0"), 17).err().expect("no such chip").to_string();
        assert!(error.contains("line 17 of /nonexistent/gpiochip0") && error.contains("gpioinfo"), "{error}");
        let pressed = Arc::new(AtomicBool::new(false));
        let open: OpenPin<CdevPin> = Box::new(|| input(Path::new("/nonexistent/gpiochip0"), 22));
        let mut watch = ContactWatch::new(Contact::Stop, open, Arc::clone(&pressed), Clock::Live);
        watch.cycle();
        watch.cycle();
        assert!(pressed.load(Ordering::Acquire));
    }
}

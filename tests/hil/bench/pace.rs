//! The emulated machine's time, which chips and plant follow: it is asked for its power-management timer.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use freerig::clock::{Stepper, Time};

/// Between two questions: each of them takes the emulator from its work.
pub const STEP: Duration = Duration::from_millis(5);
/// Frequency of the timer, Hz, and its range (ACPI specification, 4.8.3.3).
const FREQUENCY: u64 = 3_579_545;
const RANGE: u64 = 1 << 24;
/// "I/O port read" of the 32 bits where the emulated chipset has the timer.
const QUESTION: &[u8] = br#"{"execute":"human-monitor-command","arguments":{"command-line":"i /xw 0x608"}}"#;

/// What moves the bench's time; clones move the same one.
#[derive(Clone)]
pub struct Pace(Arc<Mutex<Machine>>);

struct Machine {
    monitor: PathBuf,
    connection: Option<BufReader<UnixStream>>,
    /// What the timer said last, and what it has counted since the start.
    last: Option<u64>,
    counted: u64,
    stepper: Stepper,
    asked: Instant,
}

impl Pace {
    /// Follows the machine whose monitor listens at the socket `monitor`.
    pub fn new(monitor: &Path, stepper: Stepper) -> Self {
        let machine = Machine {
            monitor: monitor.into(),
            connection: None,
            last: None,
            counted: 0,
            stepper,
            asked: Instant::now(),
        };
        let pace = Self(Arc::new(Mutex::new(machine)));
        spawn({
            let pace = pace.clone();
            move || loop {
                pace.now();
                sleep(STEP);
            }
        });
        pace
    }

    /// Moves the time to the machine's; a machine that does not answer, before its start and after its end, has this
    /// one's.
    pub fn now(&self) {
        let mut machine = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let passed = machine.asked.elapsed();
        machine.asked += passed;
        match machine.ask() {
            Some(timer) => {
                let last = machine.last.replace(timer).unwrap_or(timer);
                machine.counted += (timer + RANGE - last) % RANGE;
            }
            None => {
                (machine.connection, machine.last) = (None, None);
                machine.counted += (passed.as_secs_f64() * FREQUENCY as f64) as u64;
            }
        }
        let nanoseconds = u128::from(machine.counted) * 1_000_000_000 / u128::from(FREQUENCY);
        machine.stepper.advance_to(Time::from_nanos(nanoseconds as u64));
    }
}

impl Machine {
    fn ask(&mut self) -> Option<u64> {
        let connection = match &mut self.connection {
            Some(connection) => connection,
            None => {
                let mut stream = UnixStream::connect(&self.monitor).ok()?;
                stream.write_all(br#"{"execute":"qmp_capabilities"}"#).ok()?;
                self.connection.insert(BufReader::new(stream))
            }
        };
        connection.get_mut().write_all(QUESTION).ok()?;
        // Greetings and events come in between.
        loop {
            let mut line = String::new();
            if connection.read_line(&mut line).ok()? == 0 {
                return None;
            }
            let Some((_, value)) = line.split_once("= 0x") else { continue };
            let end = value.find(|c: char| !c.is_ascii_hexdigit())?;
            return u64::from_str_radix(&value[..end], 16).ok().map(|timer| timer % RANGE);
        }
    }
}

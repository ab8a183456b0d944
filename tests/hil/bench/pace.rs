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
/// Reads the 32 bits at the port where the emulated chipset has the timer, in the words of QEMU's test protocol, which
/// takes far less of the emulator than its monitor's.
const QUESTION: &[u8] = b"inl 0x608\n";

/// What moves the bench's time; clones move the same one.
#[derive(Clone)]
pub struct Pace(Arc<Mutex<Machine>>);

struct Machine {
    socket: PathBuf,
    connection: Option<BufReader<UnixStream>>,
    /// What the timer said last, and what it has counted since the start.
    last: Option<u64>,
    counted: u64,
    stepper: Stepper,
    asked: Instant,
}

impl Pace {
    /// Follows the machine whose emulator can be asked for it at `socket`.
    pub fn new(socket: &Path, stepper: Stepper) -> Self {
        let machine =
            Machine { socket: socket.into(), connection: None, last: None, counted: 0, stepper, asked: Instant::now() };
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
            None => self.connection.insert(BufReader::new(UnixStream::connect(&self.socket).ok()?)),
        };
        connection.get_mut().write_all(QUESTION).ok()?;
        let mut line = String::new();
        connection.read_line(&mut line).ok()?;
        let timer = u64::from_str_radix(line.trim_end().strip_prefix("OK 0x")?, 16).ok()?;
        Some(timer % RANGE)
    }
}

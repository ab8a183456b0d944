//! A simulated PWM output of a microcontroller, with the analogue regulator behind it: what it answers to the bytes of
//! a command.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::clock::Time;
use crate::hardware::mcp4728::CODE_MAX;
use crate::hardware::pwm::{digits, frame, unframe};
use crate::sim::{AnalogueSim, Plant};

/// One output.
#[derive(Clone, Debug)]
pub struct PwmChip {
    id: u8,
    free: usize,
    input: AnalogueSim,
    plant: Arc<Mutex<Plant>>,
    /// Duty in force, of 4095.
    code: u16,
    /// When it was last told a duty.
    told: Time,
    /// How things stood before the next command.
    state: char,
    /// The latest answer; sent again and again while it is stuck.
    answer: Vec<u8>,
    stuck: bool,
    /// No power: it starts anew.
    dark: bool,
    /// How long it keeps a duty without being told it again.
    pub watchdog: Duration,
}

impl PwmChip {
    /// The output `id` with a watchdog of 250 ms, just reset; `input` is what stands behind it, and feeds the plant's
    /// FREE `free`.
    pub fn new(id: u8, free: usize, input: AnalogueSim, plant: Arc<Mutex<Plant>>) -> Self {
        Self {
            id,
            free,
            input,
            plant,
            code: 0,
            told: Time::ZERO,
            state: 'R',
            answer: Vec::new(),
            stuck: false,
            dark: false,
            watchdog: Duration::from_millis(250),
        }
    }

    /// Its id.
    pub fn id(&self) -> u8 {
        self.id
    }

    /// The duty in force at `now`, of 4095.
    pub fn code(&mut self, now: Time) -> u16 {
        self.look_after(now);
        self.code
    }

    /// The power fails, and the output falls to zero.
    pub(super) fn power_off(&mut self, now: Time) {
        self.dark = true;
        self.put(0, now);
    }

    /// The power comes back.
    pub(super) fn power_on(&mut self, now: Time) {
        self.dark = false;
        self.put(0, now);
        self.state = 'R';
    }

    /// Its program hangs: it answers what it answered last, and takes nothing; or it runs again.
    pub(super) fn freeze(&mut self, stuck: bool) {
        self.stuck = stuck;
    }

    /// Carries out a command (without id and CR) and returns the answer with its CR; nothing to what it does not
    /// understand.
    pub fn command(&mut self, command: &[u8], now: Time) -> Vec<u8> {
        if self.dark {
            self.power_on(now);
        }
        if self.stuck {
            return self.answer.clone();
        }
        let line = [&[self.id], command].concat();
        let Some((_, sequence, text)) = unframe(&line) else { return Vec::new() };
        self.look_after(now);
        let text = match digits(text, 4) {
            _ if text == "V" => format!("PWM1 {:04}", self.watchdog.as_millis()),
            Some(code) if code <= CODE_MAX => {
                self.put(code, now);
                format!("{code:04}{}", std::mem::replace(&mut self.state, '='))
            }
            _ => return Vec::new(),
        };
        self.answer = format!("{}\r", frame(self.id, sequence, &text)).into_bytes();
        self.answer.clone()
    }

    /// The watchdog, in its own account; the plant has its own.
    fn look_after(&mut self, now: Time) {
        if self.code > 0 && now.since(self.told) > self.watchdog {
            (self.code, self.state) = (0, 'W');
        }
    }

    fn put(&mut self, code: u16, now: Time) {
        (self.code, self.told) = (code, now);
        let pascals = ((f64::from(code) - self.input.zero_code) * self.input.pascals_per_code).max(0.0);
        let mut plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        plant.set_setpoint(self.free, pascals, now);
        plant.lapse_at(self.free, now + self.watchdog);
    }
}

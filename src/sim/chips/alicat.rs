//! A simulated Alicat pressure controller, or gauge: what it answers to the bytes of a command.

use std::sync::{Arc, Mutex, PoisonError};

use crate::clock::Time;
use crate::hardware::wiring::UnitWiring;
use crate::sim::{Plant, PlantFault, Valve};
use crate::units::PASCAL_PER_PSI;

/// The set-point is resolved into so many steps of the full scale.
const STEPS: f64 = 64_000.0;
/// Digits of a number in a frame, before and after the point together.
const DIGITS: usize = 5;
/// Above this share of the full scale the pressure sensor is over its range.
const OVER_RANGE: f64 = 1.05;
/// Register 20 with the set-point from the line, and from the analogue input.
const REGISTER_20: (u32, u32) = (512, 16_384);

/// One unit.
#[derive(Clone, Debug)]
pub struct AlicatChip {
    wiring: UnitWiring,
    plant: Arc<Mutex<Plant>>,
    /// Accepted set-point, Pa.
    setpoint: f64,
    /// Zero of the pressure sensor, Pa.
    tare: f64,
    held: bool,
    exhausting: bool,
    /// Reading at which the sensor is stuck, Pa.
    frozen: Option<f64>,
    /// Answered nothing last time: it had no power, and starts anew.
    dark: bool,
    /// The set-point comes from the analogue input (which is at zero), as from the factory.
    pub analog: bool,
    /// Whether it lists its columns (`??D*`); older firmware does not.
    pub lists_columns: bool,
    /// Tokens that it appends to its frames beside those of its state.
    pub tokens: String,
}

impl AlicatChip {
    /// A unit set up for the serial line, at set-point zero, feeding the plant's FREE `wiring.free`.
    pub fn new(wiring: UnitWiring, plant: Arc<Mutex<Plant>>) -> Self {
        Self {
            wiring,
            plant,
            setpoint: 0.0,
            tare: 0.0,
            held: false,
            exhausting: false,
            frozen: None,
            dark: false,
            analog: false,
            lists_columns: true,
            tokens: String::new(),
        }
    }

    /// Its id.
    pub fn id(&self) -> u8 {
        self.wiring.id
    }

    /// Set-point that it has accepted, Pa.
    pub fn setpoint(&self) -> f64 {
        self.setpoint
    }

    /// The power fails; the pressure stays with the last set-point until it comes back.
    pub(super) fn power_off(&mut self) {
        self.dark = true;
    }

    /// The power comes back: set-point zero, nothing held.
    pub(super) fn power_on(&mut self, now: Time) {
        self.dark = false;
        if self.wiring.gauge {
            return;
        }
        self.cancel(now);
        self.accept(0.0, now);
    }

    /// The sensor's reading freezes at what it is `now`, or runs again.
    pub(super) fn freeze(&mut self, frozen: bool, now: Time) {
        self.frozen = if frozen { Some(self.frozen.unwrap_or_else(|| self.measure(now))) } else { None };
    }

    /// Carries out a command (without id and CR) and returns the answer with its CRs.
    pub fn command(&mut self, command: &[u8], now: Time) -> Vec<u8> {
        if self.dark {
            self.power_on(now);
        }
        if self.analog && self.setpoint != 0.0 {
            self.accept(0.0, now);
        }
        let id = char::from(self.wiring.id);
        let text = std::str::from_utf8(command).unwrap_or("\u{fffd}");
        let answer = match text {
            "" => self.frame(now),
            "??D*" if self.lists_columns => return self.columns().into_bytes(),
            "$$R20" | "R20" => {
                let value = if self.analog { REGISTER_20.1 } else { REGISTER_20.0 };
                format!("{id}   020 = {value:05}")
            }
            "LSS" => format!("{id} {}", if self.analog { 'A' } else { 'S' }),
            _ if self.wiring.gauge && text != "P" => "?".to_owned(),
            "HC" => {
                self.held = true;
                self.valve(Valve::Stuck, now);
                self.frame(now)
            }
            "E" => {
                self.exhausting = true;
                self.feed(0.0, now);
                self.frame(now)
            }
            "C" => {
                self.cancel(now);
                self.frame(now)
            }
            "P" => {
                self.tare = self.plant(|p, free| p.reading(free, now));
                self.frame(now)
            }
            _ => match self.asked(text) {
                Some(pascals) => {
                    if !self.analog {
                        self.accept(pascals, now);
                    }
                    self.frame(now)
                }
                None => "?".to_owned(),
            },
        };
        format!("{answer}\r").into_bytes()
    }

    /// The set-point in a command, Pa: `S5.0000` in the unit's own unit, or digits alone in steps of the full
    /// scale; none for anything else, and beyond the full scale.
    fn asked(&self, text: &str) -> Option<f64> {
        let is_number = |s: &str| s.bytes().all(|c| c.is_ascii_digit() || matches!(c, b'.' | b'-' | b'+'));
        let pascals = match text.strip_prefix('S') {
            Some(number) if is_number(number) => number.parse::<f64>().ok()? * self.wiring.pascals_per_unit,
            None if text.bytes().all(|c| c.is_ascii_digit()) => {
                text.parse::<f64>().ok()? * self.wiring.full_scale / STEPS
            }
            _ => return None,
        };
        let tolerance = 0.5 * self.wiring.full_scale / STEPS;
        (-tolerance..=self.wiring.full_scale + tolerance).contains(&pascals).then_some(pascals)
    }

    fn accept(&mut self, pascals: f64, now: Time) {
        let step = self.wiring.full_scale / STEPS;
        self.setpoint = (pascals / step).round() * step;
        if !self.exhausting {
            self.feed(self.setpoint, now);
        }
    }

    fn cancel(&mut self, now: Time) {
        if std::mem::take(&mut self.held) {
            self.valve(Valve::Working, now);
        }
        if std::mem::take(&mut self.exhausting) {
            self.feed(self.setpoint, now);
        }
    }

    fn feed(&self, pascals: f64, now: Time) {
        self.plant(|p, free| p.set_setpoint(free, pascals, now));
    }

    fn valve(&self, valve: Valve, now: Time) {
        self.plant(|p, free| p.inject(PlantFault::Valve(free, valve), now));
    }

    fn measure(&self, now: Time) -> f64 {
        self.plant(|p, free| p.reading(free, now)) - self.tare
    }

    fn frame(&mut self, now: Time) -> String {
        let pressure = self.frozen.unwrap_or_else(|| self.measure(now));
        let over = pressure > OVER_RANGE * self.wiring.full_scale;
        let mut frame = format!(
            "{} {}",
            char::from(self.wiring.id),
            self.number(pressure.min(OVER_RANGE * self.wiring.full_scale)),
        );
        if !self.wiring.gauge {
            frame.push(' ');
            frame.push_str(&self.number(self.setpoint));
        }
        let states = [(over, "POV"), (self.held, "HLD"), (self.exhausting, "EXH"), (true, self.tokens.as_str())];
        for (_, token) in states.iter().filter(|s| s.0 && !s.1.is_empty()) {
            frame.push(' ');
            frame.push_str(token);
        }
        frame
    }

    /// Decimal places of a number in a frame.
    fn places(&self) -> usize {
        let whole = (self.wiring.full_scale / self.wiring.pascals_per_unit).max(1.0).log10() as usize + 1;
        DIGITS.saturating_sub(whole)
    }

    fn number(&self, pascals: f64) -> String {
        let value = pascals / self.wiring.pascals_per_unit;
        format!("{value:+0width$.places$}", width = DIGITS + 2, places = self.places())
    }

    fn columns(&self) -> String {
        let id = char::from(self.wiring.id);
        let (code, unit) = match self.wiring.pascals_per_unit {
            x if (x / PASCAL_PER_PSI - 1.0).abs() < 1e-6 => ("010", "PSIG"),
            1e3 => ("006", "kPaG"),
            1e5 => ("008", "barG"),
            1e2 => ("007", "mbarG"),
            _ => ("002", "PaG"),
        };
        let places = self.places();
        let row = |n: u32, statistic: u32, name: &str| {
            format!("{id} D{n:02} {statistic:03} {name:<26} s decimal     7/{places} {code} {places:02} {unit}\r")
        };
        let token = |n: u32, statistic: u32, name: &str, token: &str| {
            format!("{id} D{n:02} {statistic:03} {name:<26} string          3 {token}\r")
        };
        [
            format!("{id} D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________\r"),
            format!("{id} D01 700 {:<26} string          1\r", "Unit ID"),
            row(2, 6, "Gauge Press"),
            if self.wiring.gauge { String::new() } else { row(3, 34, "Gauge Press Setpt") },
            token(4, 701, "*Error", "ADC"),
            token(5, 702, "*Status", "POV"),
            token(6, 702, "*Status", "EXH"),
            token(7, 702, "*Status", "HLD"),
        ]
        .concat()
    }

    fn plant<R>(&self, f: impl FnOnce(&mut Plant, usize) -> R) -> R {
        f(&mut self.plant.lock().unwrap_or_else(PoisonError::into_inner), self.wiring.free)
    }
}

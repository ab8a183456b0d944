//! calibration/NAME.toml: what is known about one FREE, and how it is known. The program writes it, never a person
//! who has a better way.
//!
//! Every value is an inline table: `value` in the unit of the key's name, `standard_uncertainty` (same unit),
//! `method`, `residual` of the fit (same unit as what was fitted), `date`, `run` that it came from, and
//! `prediction` of the finite-element model (same unit as the value). Only `value` and `method` are required. A value
//! that was measured on the simulated FREE has `simulated_nominal` beside it, the value that the simulated FREE is
//! scattered around: it does not change with what is measured on it. No such value is accepted for a real FREE.
//!
//! ```toml
//! schema = 1
//! name = "paper"
//!
//! [lumped]
//! torsional_stiffness_nm_per_rad = { value = 0.086, standard_uncertainty = 0.002, method = "least squares" }
//!
//! [gains.mine]
//! proportional_pa_per_rad = 11600.0
//! integral_pa_per_rad_s = 2.0e5
//! ```
//!
//! [`SCHEMA`] lists every key with its unit, range and meaning; the README's table is held to it by a test.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use super::atomic;
use super::conditions::{Conditions, read_conditions};
use super::gains;
use super::key;
use super::problem::{ConfigError, Problem};
use super::reader::{Section, Source};
pub use super::schema::{Key, SCHEMA, SCHEMA_VERSION, keys};
use crate::control::Gains;
use crate::hardware::wiring::ImuProfile;
use crate::model::{ELEMENTS, Free, Hysteresis};

/// One value and how it is known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entry {
    /// The value, in the unit of its key.
    pub value: f64,
    /// Its standard uncertainty, in the same unit.
    pub standard_uncertainty: Option<f64>,
    /// How it was found: "given by ...", "least squares over ...".
    pub method: String,
    /// Root mean square of what the fit leaves over, in the unit of what was fitted.
    pub residual: Option<f64>,
    /// Date of it, `YYYY-MM-DD`.
    pub date: Option<String>,
    /// Id of the run that it came from.
    pub run: Option<String>,
    /// What the finite-element model predicts, in the unit of the key.
    pub prediction: Option<f64>,
    /// Where the value was measured on the simulated FREE: what that one is scattered around, in the unit of the key.
    pub simulated_nominal: Option<f64>,
}

/// The calibration of one FREE.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Its name: the file's, without `.toml`.
    pub name: String,
    /// Where the FREE and its values come from, in words.
    pub note: String,
    /// Calibration profile of the FREE's BNO055.
    pub imu_profile: Option<ImuProfile>,
    /// Torsional hysteresis.
    pub hysteresis: Option<Hysteresis>,
    entries: BTreeMap<&'static str, Entry>,
    conditions: BTreeMap<&'static str, Conditions>,
    gains: BTreeMap<String, Gains>,
}

impl Calibration {
    /// Reads the file `path`, or says everything that is wrong with it.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        match std::fs::read_to_string(path) {
            Ok(text) => Self::parse(path, &text).map_err(|problems| ConfigError { problems }),
            Err(error) => Err(ConfigError {
                problems: vec![Problem {
                    file: path.to_owned(),
                    line: None,
                    key: String::new(),
                    value: String::new(),
                    rule: format!("cannot read the calibration: {error}"),
                    remedy: "write the file, or name one that exists".into(),
                }],
            }),
        }
    }

    /// Reads `text`, the contents of the file `path`.
    pub(super) fn parse(path: &Path, text: &str) -> Result<Self, Vec<Problem>> {
        let source = Source::new(path, text);
        let calibration = source.parse().map(|table| read(Section::root(&source, &table)));
        match (calibration, source.into_problems()) {
            (Some(calibration), problems) if problems.is_empty() => Ok(calibration),
            (_, problems) => Err(problems),
        }
    }

    /// The entry of `key`.
    pub fn entry(&self, key: &Key) -> Option<&Entry> {
        self.entries.get(key.name)
    }

    /// The value of `key` in SI.
    pub fn value(&self, key: &Key) -> Option<f64> {
        self.entry(key).map(|entry| entry.value * key::scale(key.name))
    }

    /// Replaces the entry of `key`; what the old one held for goes with it.
    pub fn set(&mut self, key: &Key, entry: Entry) {
        self.entries.insert(key.name, entry);
        self.conditions.remove(key.name);
    }

    /// Says what the value of `key` holds for.
    pub fn set_conditions(&mut self, key: &Key, conditions: Conditions) {
        self.conditions.insert(key.name, conditions);
    }

    /// What values hold for, with the keys' names and the values' entries.
    pub fn conditions(&self) -> impl Iterator<Item = (&'static str, &Entry, &Conditions)> {
        self.conditions.iter().filter_map(|(name, conditions)| Some((*name, self.entries.get(name)?, conditions)))
    }

    /// The gains `name`: the FREE's own, else the preset.
    pub fn gains(&self, name: &str) -> Option<Gains> {
        self.gains.get(name).copied().or_else(|| gains::preset(name))
    }

    /// Stores gains under `name`.
    pub fn set_gains(&mut self, name: impl Into<String>, gains: Gains) {
        self.gains.insert(name.into(), gains);
    }

    /// Names of all gains that [`Calibration::gains`] knows, the FREE's own first.
    pub fn gain_names(&self) -> impl Iterator<Item = &str> {
        let presets = gains::PRESETS.iter().map(|preset| preset.0);
        self.gains.keys().map(String::as_str).chain(presets.filter(|name| !self.gains.contains_key(*name)))
    }

    /// The FREE as the lumped model takes it.
    ///
    /// A calibration that has been read has every value that is required; one that was put together by hand and
    /// lacks one gives a FREE with values that are not numbers.
    pub fn free(&self) -> Free {
        let free = free_of(|key| self.value(key));
        Free { gamma: self.value(&keys::EFFECTIVE_ANGLE).unwrap_or(free.gamma), ..free }
    }

    /// What the simulated FREE is scattered around: as [`Calibration::free`], without what was measured on it.
    pub fn simulated_nominal(&self) -> Free {
        free_of(|key| self.nominal_value(key))
    }

    /// The value of `key` in SI that the simulated FREE is scattered around.
    pub fn nominal_value(&self, key: &Key) -> Option<f64> {
        self.entry(key).map(|entry| entry.simulated_nominal.unwrap_or(entry.value) * key::scale(key.name))
    }

    /// Keys whose values were measured on a simulated FREE.
    pub fn simulated_keys(&self) -> impl Iterator<Item = &'static str> {
        self.entries.iter().filter(|(_, entry)| entry.simulated_nominal.is_some()).map(|(name, _)| *name)
    }

    /// Writes `directory`/NAME.toml as one step that cannot be seen half done, and answers its path.
    pub fn write(&self, directory: &Path) -> io::Result<PathBuf> {
        let path = directory.join(format!("{}.toml", self.name));
        atomic::write(&path, self.to_toml().as_bytes())?;
        Ok(path)
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        let mut text = String::from("# Written by freerig; the README describes the schema.\n");
        let mut line = |line: String| {
            text.push_str(&line);
            text.push('\n');
        };
        line(format!("schema = {SCHEMA_VERSION}"));
        line(format!("name = {}", quoted(&self.name)));
        if !self.note.is_empty() {
            line(format!("note = {}", quoted(&self.note)));
        }
        let mut section = "";
        for key in SCHEMA {
            let entry = self.entry(key);
            let profile = self.imu_profile.filter(|_| key.section == "imu");
            if section != key.section && (entry.is_some() || profile.is_some()) {
                section = key.section;
                line(format!("\n[{section}]"));
                if let Some(profile) = profile {
                    line(format!("sensor_id = \"{}\"", hex(&profile.unique_id)));
                    line(format!("profile = \"{}\"", hex(&profile.registers)));
                }
            }
            if let Some(entry) = entry {
                line(format!("{} = {}", key.name, inline(entry)));
            }
        }
        for (name, conditions) in &self.conditions {
            line(format!("\n[conditions.{name}]"));
            conditions.lines().for_each(&mut line);
        }
        if let Some(hysteresis) = &self.hysteresis {
            line("\n[hysteresis]".into());
            line(format!("thresholds_deg = {:?}", hysteresis.thresholds().map(f64::to_degrees)));
            line(format!("weights_nm_per_rad = {:?}", hysteresis.weights()));
        }
        for (name, gains) in &self.gains {
            line(format!("\n[gains.{}]", quoted(name)));
            for (key, value) in [
                ("proportional_pa_per_rad", gains.proportional),
                ("integral_pa_per_rad_s", gains.integral),
                ("derivative_pa_s_per_rad", gains.derivative),
                ("derivative_filter_hz", gains.derivative_filter),
            ] {
                line(format!("{key} = {value:?}"));
            }
        }
        text
    }
}

/// The FREE of the values in SI; one that is missing is not a number.
fn free_of(value: impl Fn(&Key) -> Option<f64>) -> Free {
    let value = |key: &Key| value(key).unwrap_or(f64::NAN);
    Free {
        gamma: value(&keys::WINDING_ANGLE),
        length: value(&keys::LENGTH),
        radius: value(&keys::FIBER_RADIUS),
        mass: value(&keys::END_MASS),
        inertia: value(&keys::END_INERTIA),
        axial_stiffness: value(&keys::AXIAL_STIFFNESS),
        torsional_stiffness: value(&keys::TORSIONAL_STIFFNESS),
        axial_damping: value(&keys::AXIAL_DAMPING),
        torsional_damping: value(&keys::TORSIONAL_DAMPING),
    }
}

fn read(mut root: Section<'_>) -> Calibration {
    root.integer("schema", None, SCHEMA_VERSION..=SCHEMA_VERSION);
    let mut calibration = Calibration {
        name: root.text("name", "paper"),
        note: root.optional_lines("note").unwrap_or_default(),
        ..Calibration::default()
    };
    for name in ["geometry", "material", "lumped", "regulator", "imu"] {
        let mut section = root.section(name);
        for key in SCHEMA.iter().filter(|key| key.section == name) {
            if let Some(entry) = read_entry(&mut section, key) {
                calibration.set(key, entry);
            }
        }
        if name == "imu" {
            calibration.imu_profile = read_profile(&mut section);
        }
    }
    let angles = [&keys::WINDING_ANGLE, &keys::EFFECTIVE_ANGLE].map(|key| calibration.value(key));
    if let [Some(wound), Some(effective)] = angles
        && wound * effective <= 0.0
    {
        // A controller that believes the other hand drives the FREE away from its reference.
        root.reject(
            keys::EFFECTIVE_ANGLE.name,
            "must have the sign of `winding_angle_deg`",
            "remove it, and measure the stiffness again",
        );
    }
    if root.has("hysteresis") {
        calibration.hysteresis = read_hysteresis(root.section("hysteresis"));
    }
    root.expect("hysteresis");
    for (name, section) in root.named("conditions") {
        match read_conditions(&name, section, &calibration) {
            Some((key, conditions)) => calibration.set_conditions(key, conditions),
            None => {
                let rule = format!("there is no value `{name}` that [conditions.{name}] could hold for");
                root.reject("conditions", rule, "remove the table");
            }
        }
    }
    for (name, mut section) in root.named("gains") {
        let gains = Gains {
            proportional: section.number("proportional_pa_per_rad", None, 0.0..=1e9),
            integral: section.number("integral_pa_per_rad_s", 0.0, 0.0..=1e12),
            derivative: section.number("derivative_pa_s_per_rad", 0.0, 0.0..=1e9),
            derivative_filter: section.number("derivative_filter_hz", 0.0, 0.0..=1e4),
        };
        calibration.set_gains(name, gains);
    }
    calibration
}

fn read_entry(section: &mut Section<'_>, key: &Key) -> Option<Entry> {
    if !section.has(key.name) {
        if key.required {
            section.require(key.name, key.meaning);
        } else {
            section.expect(key.name);
        }
        return None;
    }
    let mut table = section.section(key.name);
    if !table.is_present() {
        return None;
    }
    let any = || f64::NEG_INFINITY..=f64::INFINITY;
    let range: RangeInclusive<f64> = key.range.0..=key.range.1;
    let entry = Entry {
        value: table.number("value", None, range.clone()),
        standard_uncertainty: table.optional_number("standard_uncertainty", 0.0..=f64::INFINITY),
        method: table.text("method", "given by the paper"),
        residual: table.optional_number("residual", 0.0..=f64::INFINITY),
        date: table.optional_text("date"),
        run: table.optional_text("run"),
        prediction: table.optional_number("prediction", any()),
        simulated_nominal: table.optional_number("simulated_nominal", range),
    };
    if key.name == keys::WINDING_ANGLE.name && entry.value.abs() < 1.0 {
        // Without an angle the kinematics have no answer.
        table.reject("value", "must be at least 1 deg away from the axis", "write the angle with its sign");
    }
    if let Some(date) = &entry.date
        && date.parse::<jiff::civil::Date>().is_err()
    {
        table.reject("date", "must be a date", "write it as \"2026-01-31\"");
    }
    Some(entry)
}

fn read_hysteresis(mut section: Section<'_>) -> Option<Hysteresis> {
    let mut eight = |key: &'static str, range: RangeInclusive<f64>| -> Option<[f64; ELEMENTS]> {
        if !section.has(key) {
            section.require(key, "eight numbers, one for each element");
        }
        let numbers = section.numbers(key, range)?;
        let eight = <[f64; ELEMENTS]>::try_from(numbers).ok();
        if eight.is_none() {
            let remedy = "measure the hysteresis again, or remove the whole table";
            section.reject(key, format!("must be {ELEMENTS} numbers"), remedy);
        }
        eight
    };
    let thresholds = eight("thresholds_deg", 1e-6..=1e4);
    let weights = eight("weights_nm_per_rad", 0.0..=1e4);
    // Within these ranges nothing is left that it could refuse.
    Hysteresis::new(thresholds?, weights?).ok()
}

fn read_profile(section: &mut Section<'_>) -> Option<ImuProfile> {
    let registers = read_bytes(section, "profile");
    let unique_id = read_bytes(section, "sensor_id");
    match (registers, unique_id) {
        (Some(registers), Some(unique_id)) => Some(ImuProfile { unique_id, registers }),
        (None, None) => None,
        (registers, _) => {
            let (here, missing) = if registers.is_some() { ("profile", "sensor_id") } else { ("sensor_id", "profile") };
            if !section.has(missing) {
                let rule = format!("needs `{missing}` beside it: a profile fits one sensor only");
                section.reject(here, rule, "save the sensor's profile again, or remove both keys");
            }
            None
        }
    }
}

/// `N` bytes in hexadecimal.
pub(super) fn read_bytes<const N: usize>(section: &mut Section<'_>, key: &'static str) -> Option<[u8; N]> {
    let text = section.optional_text(key)?;
    let bytes = unhex(&text);
    if bytes.is_none() {
        let rule = format!("must be {} hexadecimal digits", 2 * N);
        section.reject(key, rule, "save the sensor's profile again, or remove it");
    }
    bytes
}

fn inline(entry: &Entry) -> String {
    let mut text = format!("{{ value = {:?}", entry.value);
    let number = |text: &mut String, name: &str, value: Option<f64>| {
        if let Some(value) = value {
            // Writing to a String cannot fail.
            let _ = write!(text, ", {name} = {value:?}");
        }
    };
    let word = |text: &mut String, name: &str, value: Option<&String>| {
        if let Some(value) = value {
            let _ = write!(text, ", {name} = {}", quoted(value));
        }
    };
    number(&mut text, "standard_uncertainty", entry.standard_uncertainty);
    word(&mut text, "method", Some(&entry.method));
    number(&mut text, "residual", entry.residual);
    word(&mut text, "date", entry.date.as_ref());
    word(&mut text, "run", entry.run.as_ref());
    number(&mut text, "prediction", entry.prediction);
    number(&mut text, "simulated_nominal", entry.simulated_nominal);
    text.push_str(" }");
    text
}

/// `text` as a TOML basic string, which may be a value or a key.
pub(super) fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted.push_str(&format!("\\u{:04X}", u32::from(c))),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digits: Option<Vec<u8>> = text.chars().map(|c| c.to_digit(16).and_then(|d| u8::try_from(d).ok())).collect();
    let digits = digits.filter(|digits| digits.len() == 2 * N)?;
    let bytes: Vec<u8> = digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
    bytes.try_into().ok()
}

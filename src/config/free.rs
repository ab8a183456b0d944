//! One `[[free]]` of rig.toml: its wiring, its limits, and what its simulated twin is like.

use std::time::Duration;

use super::calibration::{Calibration, keys};
use super::gains;
use super::knob::{RawKnob, read_knob};
use super::limits::{PRESSURE_CEILING, read_limits};
use super::load::Library;
use super::reader::Section;
use super::rig::Backend;
use super::sections::{RawI2c, RawSerial, duration};
use crate::control::{DerivativeOn, Gains, Limits};
use crate::units::PASCAL_PER_PSI;

/// One `[[free]]`.
#[derive(Debug)]
pub(super) struct RawFree {
    pub(super) name: String,
    /// A stand-in where there is no such calibration, or a wrong one: the problem has been noted.
    pub(super) calibration: Calibration,
    pub(super) gains: Gains,
    pub(super) derivative_on: DerivativeOn,
    /// 0 none, 1 all of it.
    pub(super) feedforward: f64,
    /// Whether the FREE's model leads.
    pub(super) model: bool,
    pub(super) imu: Option<RawImu>,
    pub(super) regulator: RawRegulator,
    /// What measures the pressure of a regulator that does not.
    pub(super) sensor: Option<RawSensor>,
    pub(super) limits: Limits,
    pub(super) knob: Option<RawKnob>,
    pub(super) twin: RawTwin,
}

/// `[free.imu]`.
#[derive(Debug)]
pub(super) struct RawImu {
    pub(super) bus: String,
    pub(super) address: u8,
    pub(super) axis: [f64; 3],
    pub(super) period: Duration,
    /// Digital line of its reset pin.
    pub(super) reset: Option<u32>,
}

/// `[free.regulator]`.
#[derive(Debug)]
pub(super) struct RawRegulator {
    pub(super) full_scale: f64,
    pub(super) connection: Connection,
}

/// Kinds of regulators.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Alicat,
    Dac,
    Pwm,
}

/// How a regulator is reached.
#[derive(Debug)]
pub(super) enum Connection {
    /// Not told, or wrongly: the problem has been noted.
    Unknown,
    /// An Alicat unit on a serial line.
    Alicat { line: String, id: u8, pascals_per_unit: f64 },
    /// An analogue regulator behind a channel of an MCP4728.
    Dac { bus: String, address: u8, channel: usize },
    /// An analogue regulator behind a PWM output of a microcontroller on a serial line.
    Pwm { line: String, id: u8 },
}

/// `[free.pressure_sensor]`.
#[derive(Debug)]
pub(super) struct RawSensor {
    pub(super) full_scale: f64,
    pub(super) connection: SensorConnection,
}

/// How a pressure sensor is reached.
#[derive(Debug)]
pub(super) enum SensorConnection {
    /// Not told, or wrongly: the problem has been noted.
    Unknown,
    /// An Alicat unit that is told nothing.
    Alicat { line: String, id: u8, pascals_per_unit: f64 },
    /// A channel of an ADS1115: V without pressure, and at full scale.
    Adc { bus: String, address: u8, channel: usize, volts: (f64, f64) },
}

impl RawFree {
    /// Full scale of whatever measures its pressure, or is told it, Pa.
    pub(super) fn full_scale(&self) -> f64 {
        self.sensor.as_ref().map_or(self.regulator.full_scale, |sensor| sensor.full_scale)
    }

    /// The serial lines that its regulator and its sensor hang on, with their ids there.
    pub(super) fn units(&self) -> impl Iterator<Item = (&str, u8)> {
        let regulator = match &self.regulator.connection {
            Connection::Alicat { line, id, .. } | Connection::Pwm { line, id } => Some((line.as_str(), *id)),
            Connection::Dac { .. } | Connection::Unknown => None,
        };
        regulator.into_iter().chain(self.gauge())
    }

    /// The serial line of the Alicat gauge that measures its pressure, with the gauge's id.
    pub(super) fn gauge(&self) -> Option<(&str, u8)> {
        match &self.sensor.as_ref()?.connection {
            SensorConnection::Alicat { line, id, .. } => Some((line, *id)),
            _ => None,
        }
    }
}

/// `[free.sim]`: the simulated twin.
#[derive(Debug)]
pub(super) struct RawTwin {
    pub(super) scatter: f64,
    pub(super) hysteresis: f64,
    pub(super) load_moment: f64,
    pub(super) lag: Duration,
    pub(super) dead_time: Duration,
    pub(super) slew: f64,
    pub(super) noise: f64,
    /// Channel of the DAC that its tube really hangs on, where it is not the regulator's.
    pub(super) dac_channel: Option<usize>,
}

/// Codes of a DAC.
const CODES: f64 = 4095.0;
/// Least difference between a pressure sensor's voltages without pressure and at full scale, V.
const LEAST_SPAN: f64 = 0.5;
/// Channels of a DAC by their letters.
const CHANNELS: [(&str, usize); 4] = [("A", 0), ("B", 1), ("C", 2), ("D", 3)];

/// Reads one FREE; the `earlier` ones may not share its name or its devices.
pub(super) fn read_free(
    mut section: Section<'_>,
    i2c: &[RawI2c],
    serial: &[RawSerial],
    earlier: &[RawFree],
    library: &mut Library<'_>,
    backend: Backend,
) -> RawFree {
    let name = section.text("name", "paper");
    if !name.is_empty() {
        section.rename(format!("free.{name}"));
    }
    check_name(&section, &name, earlier);
    let calibration = read_calibration(&mut section, &name, library);
    let simulated: Vec<_> = calibration.iter().flat_map(Calibration::simulated_keys).collect();
    if backend == Backend::Linux && !simulated.is_empty() {
        let rule = format!("holds values that were measured on a simulated FREE: {}", simulated.join(", "));
        section.reject("calibration", rule, "measure them on the FREE itself (`freerig calibrate`), or remove them");
    }
    let gains = read_gains(&mut section, calibration.as_ref());
    let looks_at = [("measurement", DerivativeOn::Measurement), ("error", DerivativeOn::Error)];
    let derivative_on = section.choice("derivative_on", Some(DerivativeOn::default()), &looks_at).unwrap_or_default();
    let feedforward = section.number("feedforward_percent", 0.0, 0.0..=100.0);
    let controllers = [("pid", false), ("model", true)];
    let model = section.choice("controller", Some(false), &controllers).unwrap_or_default();
    if model && section.has("feedforward_percent") {
        let remedy = "remove it, or set `controller = \"pid\"`";
        section.reject("feedforward_percent", "is the PID's: the model feeds all of it forward", remedy);
    }
    let imu = section.has("imu").then(|| read_imu(section.section("imu"), i2c, earlier));
    let regulator = read_regulator(section.section("regulator"), i2c, serial, earlier);
    if let (Connection::Dac { .. } | Connection::Pwm { .. }, Some(calibration)) = (&regulator.connection, &calibration)
        && calibration.value(&keys::ZERO_CODE).zip(calibration.value(&keys::PRESSURE_PER_CODE)).is_none()
    {
        section.reject(
            "regulator",
            format!("the calibration `{}` has no [regulator] zero_code and span_pa_per_code", calibration.name),
            format!(
                "write nominal ones into its [regulator], for example `zero_code = {{ value = 0.0, method = \"nominal\" \
                 }}` and `span_pa_per_code = {{ value = {:.1}, method = \"nominal\" }}`; then measure them: `freerig \
                 calibrate regulator`",
                regulator.full_scale / CODES
            ),
        );
    }
    let sensor = read_sensor(&mut section, &regulator, i2c, serial, earlier);
    let measured = sensor.as_ref().map_or(regulator.full_scale, |sensor| sensor.full_scale.min(regulator.full_scale));
    let limits = read_limits(section.section("limits"), measured);
    let twin = read_twin(section.section("sim"));
    let calibration = calibration.unwrap_or_default();
    let own = calibration.free().direction();
    let knob = section.has("knob").then(|| read_knob(section.section("knob"), own, &limits));
    if knob.is_none() {
        section.expect("knob");
    }
    RawFree { name, calibration, gains, derivative_on, feedforward, model, imu, regulator, sensor, limits, knob, twin }
}

fn read_calibration(section: &mut Section<'_>, name: &str, library: &mut Library<'_>) -> Option<Calibration> {
    let key = "calibration";
    let wanted = section.optional_text(key).unwrap_or_else(|| name.to_owned());
    if wanted.is_empty() {
        return None;
    }
    match library.calibration(&wanted) {
        Ok(calibration) => Some(calibration),
        Err(missing) => {
            let remedy = match missing.known.as_slice() {
                [] => "write the file, or correct `calibration_directory`".into(),
                known => format!("write one of {}, or correct `calibration_directory`", known.join(", ")),
            };
            section.reject(key, format!("cannot read {}: {}", missing.path.display(), missing.reason), remedy);
            None
        }
    }
}

fn read_gains(section: &mut Section<'_>, calibration: Option<&Calibration>) -> Gains {
    let name = section.optional_text("gains").unwrap_or_else(|| gains::DEFAULT.into());
    // Without its calibration nothing can be said about the gains it may hold.
    let Some(calibration) = calibration else { return Gains::default() };
    calibration.gains(&name).unwrap_or_else(|| {
        let known = calibration.gain_names().collect::<Vec<_>>().join(", ");
        section.reject("gains", format!("there are no gains `{name}`"), format!("write one of: {known}"));
        Gains::default()
    })
}

fn check_name(section: &Section<'_>, name: &str, earlier: &[RawFree]) {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if !name.is_empty() && (name.len() > 32 || !name.chars().all(plain)) {
        section.reject(
            "name",
            "must be at most 32 lower-case letters, digits, `-` and `_`",
            "write a name like \"left-1\": it becomes a file name and a command line argument",
        );
    }
    if !name.is_empty() && earlier.iter().any(|free| free.name == name) {
        section.reject("name", "another FREE has this name", "give every FREE a name of its own");
    }
}

pub(super) fn read_imu(mut section: Section<'_>, i2c: &[RawI2c], earlier: &[RawFree]) -> RawImu {
    let bus = read_bus(&mut section, "bus", i2c.iter().map(|bus| bus.name.as_str()), "i2c");
    let address = section.address(0x28, 0x28..=0x29);
    let taken = earlier
        .iter()
        .find(|free| free.imu.as_ref().is_some_and(|imu| !bus.is_empty() && imu.bus == bus && imu.address == address));
    if let Some(other) = taken {
        let rule = format!("FREE `{}` has the IMU at {address:#04x} of `{bus}` already", other.name);
        section.reject("address", rule, "wire the second IMU's ADR pin high (0x29) or put it on another bus");
    }
    let axis = match section.numbers("axis", -1.0..=1.0).as_deref() {
        None => [0.0, 0.0, 1.0],
        Some(&[x, y, z]) if (x * x + y * y + z * z - 1.0).abs() < 1e-3 => unit([x, y, z]),
        Some(_) => {
            section.reject("axis", "must be a unit vector of three numbers", "write for example `axis = [0, 0, 1]`");
            [0.0, 0.0, 1.0]
        }
    };
    let period = duration(section.number("period_ms", 10.0, 5.0..=100.0));
    section.expect("reset_line");
    let reset = section.has("reset_line").then(|| section.integer("reset_line", 0, 0..=1023) as u32);
    RawImu { bus, address, axis, period, reset }
}

/// A written unit vector has a few digits only; its length is made exact.
fn unit([x, y, z]: [f64; 3]) -> [f64; 3] {
    let norm = (x * x + y * y + z * z).sqrt();
    [x / norm, y / norm, z / norm]
}

fn read_regulator(mut section: Section<'_>, i2c: &[RawI2c], serial: &[RawSerial], earlier: &[RawFree]) -> RawRegulator {
    let kinds = [("alicat", Some(Kind::Alicat)), ("mcp4728", Some(Kind::Dac)), ("pwm", Some(Kind::Pwm))];
    let kind = section.choice("kind", None, &kinds).flatten();
    let full_scale = section.number("full_scale_psi", None, 0.5..=PRESSURE_CEILING);
    let connection = match kind {
        Some(Kind::Alicat) => {
            let (line, id, pascals_per_unit) = read_unit(&mut section, serial, earlier);
            Connection::Alicat { line, id, pascals_per_unit }
        }
        Some(Kind::Dac) => read_dac(&mut section, i2c, earlier),
        Some(Kind::Pwm) => {
            let (line, id) = read_id(&mut section, serial, earlier);
            Connection::Pwm { line, id }
        }
        None => {
            // What else stands in the table belongs to one of the kinds; without one, nothing can be said of it.
            section.accept_rest();
            Connection::Unknown
        }
    };
    RawRegulator { full_scale, connection }
}

/// Line, id and unit of pressure of an Alicat unit.
fn read_unit(section: &mut Section<'_>, serial: &[RawSerial], earlier: &[RawFree]) -> (String, u8, f64) {
    let (line, id) = read_id(section, serial, earlier);
    let units = [("psi", PASCAL_PER_PSI), ("kPa", 1e3), ("bar", 1e5), ("mbar", 100.0), ("Pa", 1.0)];
    let pascals_per_unit = section.choice("displays", Some(PASCAL_PER_PSI), &units).unwrap_or(PASCAL_PER_PSI);
    (line, id, pascals_per_unit)
}

/// Line and id of whatever answers on a serial line.
fn read_id(section: &mut Section<'_>, serial: &[RawSerial], earlier: &[RawFree]) -> (String, u8) {
    let line = read_bus(section, "line", serial.iter().map(|line| line.name.as_str()), "serial");
    let text = section.optional_text("unit").unwrap_or_else(|| "A".into());
    let id = match text.as_bytes() {
        &[id @ b'A'..=b'Z'] => id,
        _ => {
            let remedy = "write the id that the unit's front panel shows, or the microcontroller's firmware knows";
            section.reject("unit", "must be one letter from A to Z", remedy);
            // What is wrong has been said. What can be read is vented all the same, as far as it can be.
            return (line, b'A');
        }
    };
    let taken = earlier.iter().find(|free| !line.is_empty() && free.units().any(|unit| unit == (line.as_str(), id)));
    if let Some(other) = taken {
        let rule = format!("FREE `{}` has unit {} of line `{line}` already", other.name, char::from(id));
        section.reject("unit", rule, "give the second unit another id on its front panel, and write it here");
    }
    (line, id)
}

/// `[free.pressure_sensor]`, where there is one.
fn read_sensor(
    section: &mut Section<'_>,
    regulator: &RawRegulator,
    i2c: &[RawI2c],
    serial: &[RawSerial],
    earlier: &[RawFree],
) -> Option<RawSensor> {
    const KEY: &str = "pressure_sensor";
    section.expect(KEY);
    if !section.has(KEY) {
        return None;
    }
    let mut own = section.section(KEY);
    let kind = own.choice("kind", None, &[("alicat", Some(true)), ("ads1115", Some(false))]).flatten();
    let full_scale = own.number("full_scale_psi", None, 0.5..=PRESSURE_CEILING);
    let connection = match kind {
        Some(true) => {
            let (line, id, pascals_per_unit) = read_unit(&mut own, serial, earlier);
            SensorConnection::Alicat { line, id, pascals_per_unit }
        }
        Some(false) => read_adc(&mut own, i2c, earlier),
        None => {
            own.accept_rest();
            SensorConnection::Unknown
        }
    };
    drop(own);
    if let Connection::Alicat { .. } = regulator.connection {
        section.reject(KEY, "an Alicat regulator measures its pressure itself", "remove it");
        return None;
    }
    Some(RawSensor { full_scale, connection })
}

fn read_adc(section: &mut Section<'_>, i2c: &[RawI2c], earlier: &[RawFree]) -> SensorConnection {
    let bus = read_bus(section, "bus", i2c.iter().map(|bus| bus.name.as_str()), "i2c");
    let address = section.address(0x48, 0x48..=0x4B);
    let channel = section.integer("channel", None, 0..=3) as usize;
    let zero = section.number("zero_v", 0.5, 0.0..=5.0);
    let full = section.number("full_v", 4.5, 0.0..=5.0);
    if full - zero < LEAST_SPAN {
        let rule = format!("must be at least {LEAST_SPAN} above zero_v");
        section.reject("full_v", rule, "write the voltages of the sensor's data sheet, for example 0.5 and 4.5");
    }
    let same = |free: &RawFree| match free.sensor.as_ref().map(|sensor| &sensor.connection) {
        Some(SensorConnection::Adc { bus: b, address: a, channel: c, .. }) => {
            *b == bus && *a == address && *c == channel
        }
        _ => false,
    };
    if let Some(other) = earlier.iter().find(|free| same(free)) {
        let rule = format!("FREE `{}` has channel {channel} of the ADC at {address:#04x} already", other.name);
        section.reject("channel", rule, "wire the sensor to a channel of its own, and write it here");
    }
    SensorConnection::Adc { bus, address, channel, volts: (zero, full) }
}

fn read_dac(section: &mut Section<'_>, i2c: &[RawI2c], earlier: &[RawFree]) -> Connection {
    let bus = read_bus(section, "bus", i2c.iter().map(|bus| bus.name.as_str()), "i2c");
    let address = section.address(0x60, 0x60..=0x67);
    let channel = section.choice("channel", None, &CHANNELS).unwrap_or(0);
    let taken = earlier.iter().find(|free| match &free.regulator.connection {
        Connection::Dac { bus: b, address: a, channel: c } => *b == bus && *a == address && *c == channel,
        _ => false,
    });
    if let Some(other) = taken {
        let letter = CHANNELS[channel].0;
        let rule =
            format!("FREE `{}` has channel {letter} of the DAC at {address:#04x} of `{bus}` already", other.name);
        section.reject("channel", rule, "wire the regulator to a channel of its own, and write it here");
    }
    Connection::Dac { bus, address, channel }
}

/// The name of a bus, which must be one of `known`.
fn read_bus<'n>(
    section: &mut Section<'_>,
    key: &'static str,
    known: impl Iterator<Item = &'n str>,
    table: &str,
) -> String {
    let known: Vec<&str> = known.collect();
    let name = section.text(key, known.first().copied().unwrap_or("main"));
    if !name.is_empty() && !known.contains(&name.as_str()) {
        let remedy = if known.is_empty() {
            format!("add `[{table}.{name}]` with its device")
        } else {
            format!("add `[{table}.{name}]` with its device, or write one of: {}", known.join(", "))
        };
        section.reject(key, format!("there is no `[{table}.{name}]`"), remedy);
    }
    name
}

fn optional_channel(section: &mut Section<'_>) -> Option<usize> {
    section.expect("dac_channel");
    section.has("dac_channel").then(|| section.choice("dac_channel", Some(0), &CHANNELS)).flatten()
}

fn read_twin(mut section: Section<'_>) -> RawTwin {
    RawTwin {
        scatter: section.number("scatter_percent", 3.0, 0.0..=20.0),
        hysteresis: section.number("hysteresis_percent", 5.0, 0.0..=50.0),
        load_moment: section.number("load_moment_mnm", 0.0, -1000.0..=1000.0),
        lag: duration(section.number("regulator_lag_ms", 60.0, 0.0..=2000.0)),
        dead_time: duration(section.number("regulator_dead_time_ms", 15.0, 0.0..=500.0)),
        slew: section.number("regulator_slew_psi_per_s", 30.0, 0.1..=1000.0),
        noise: section.number("pressure_noise_psi", 0.01, 0.0..=5.0),
        dac_channel: optional_channel(&mut section),
    }
}

//! rig.toml as it is read: its sections, every value in SI, nothing joined yet. Keys, defaults and ranges stand
//! here and nowhere else; `rig.toml` at the top of the repository is the commented example.
//!
//! Relative paths of the calibration directory and of the socket are relative to rig.toml's own directory, that
//! of the runs to the working directory.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::build::round_of;
use super::free::{RawFree, RawImu, read_free};
use super::load::{Files, Library};
use super::module::{RawModule, read_module};
use super::reader::Section;
use super::rig::{Backend, LoopConfig, RecordConfig, SocketConfig};
use crate::hardware::wiring::GpioWiring;
use crate::signal::MAX_FREES;

/// The whole of rig.toml.
#[derive(Debug)]
pub(super) struct RawRig {
    pub(super) name: String,
    pub(super) backend: Backend,
    pub(super) calibration_directory: PathBuf,
    pub(super) realtime: LoopConfig,
    pub(super) safety: RawSafety,
    pub(super) record: RecordConfig,
    pub(super) socket: SocketConfig,
    pub(super) i2c: Vec<RawI2c>,
    pub(super) serial: Vec<RawSerial>,
    pub(super) gpio: Option<GpioWiring>,
    pub(super) sim: RawSim,
    pub(super) frees: Vec<RawFree>,
    pub(super) module: Option<RawModule>,
}

/// `[safety]`.
#[derive(Debug)]
pub(super) struct RawSafety {
    pub(super) vent_time: Duration,
    pub(super) ramp_time: Duration,
    pub(super) command_timeout: Duration,
}

/// `[i2c.NAME]`.
#[derive(Debug)]
pub(super) struct RawI2c {
    pub(super) name: String,
    pub(super) device: PathBuf,
}

/// `[serial.NAME]`.
#[derive(Debug)]
pub(super) struct RawSerial {
    pub(super) name: String,
    pub(super) device: PathBuf,
    pub(super) baud: u32,
}

/// `[sim]`.
#[derive(Debug)]
pub(super) struct RawSim {
    pub(super) seed: u64,
    pub(super) dump_valve: bool,
    pub(super) imu_delay: Duration,
    pub(super) imu_noise: f64,
    pub(super) imu_rate_noise: f64,
}

/// Line rates that the Alicat series use, and a microcontroller can.
const BAUDS: [u32; 6] = [9600, 19200, 38400, 57600, 115_200, 230_400];
/// Longest path of the control socket, bytes: the kernel takes 107, and `.estop.new` has to fit behind it.
const SOCKET_PATH_MAX: usize = 97;

/// Reads the whole of rig.toml; `base` is its directory.
pub(super) fn read_rig(mut root: Section<'_>, base: &Path, files: &mut Files) -> RawRig {
    let backends = [("sim", Backend::Sim), ("linux", Backend::Linux)];
    let i2c = read_i2c(&mut root);
    let serial = read_serial(&mut root);
    let calibration_directory = base.join(root.path("calibration_directory", "calibration"));
    let backend = root.choice("backend", Some(Backend::Sim), &backends).unwrap_or(Backend::Sim);
    let frees = read_frees(&mut root, &i2c, &serial, &mut Library::new(&calibration_directory, files), backend);
    let module = read_module(&mut root, &i2c, &frees);
    let gpio = root.has("gpio").then(|| read_gpio(root.section("gpio")));
    root.expect("gpio");
    check_resets(&root, gpio.as_ref(), &frees, module.as_ref());
    let safety = read_safety(root.section("safety"), &frees);
    check_lines(&mut root, &serial, &frees, safety.command_timeout);
    RawRig {
        name: root.optional_text("name").unwrap_or_else(|| "bench".into()),
        backend,
        realtime: read_loop(root.section("loop")),
        safety,
        record: read_record(root.section("record")),
        socket: read_socket(root.section("socket"), base),
        gpio,
        sim: read_sim(root.section("sim")),
        frees,
        module,
        calibration_directory,
        i2c,
        serial,
    }
}

impl RawRig {
    /// The IMU that measures the FREE `index`: its own, or the one on its module's plate.
    pub(super) fn imu(&self, index: usize) -> Option<&RawImu> {
        self.frees.get(index)?.imu.as_ref().or_else(|| {
            let module = self.module.as_ref().filter(|_| self.in_module(index))?;
            module.imu.as_ref()
        })
    }

    /// Whether the end of the FREE `index` is on a module's plate.
    pub(super) fn in_module(&self, index: usize) -> bool {
        self.module.as_ref().is_some_and(|module| module.config.frees.contains(&index))
    }
}

fn read_loop(mut section: Section<'_>) -> LoopConfig {
    LoopConfig {
        period: Duration::from_secs_f64(1.0 / section.number("rate_hz", 500.0, 50.0..=4000.0)),
        priority: section.integer("priority", 80, 1..=98) as u8,
        cpu: section.has("cpu").then(|| section.integer("cpu", 0, 0..=1023) as usize),
        require_realtime: section.flag("require_realtime", false),
    }
}

fn read_safety(mut section: Section<'_>, frees: &[RawFree]) -> RawSafety {
    let safety = RawSafety {
        vent_time: duration(section.number("vent_time_s", 1.5, 0.1..=30.0)),
        ramp_time: duration(section.number("ramp_time_s", 3.0, 0.1..=60.0)),
        command_timeout: duration(section.number("command_timeout_ms", 100.0, 10.0..=1000.0)),
    };
    for RawFree { name, limits, .. } in frees {
        let (ramp, needed) = (safety.ramp_time.as_secs_f64(), limits.pressure_max / limits.slew);
        // What cannot be compared has been noted already.
        if needed > ramp {
            let rule = format!("is {ramp:.1} s, and `{name}` takes {needed:.1} s from its highest pressure to zero");
            section.reject("ramp_time_s", rule, format!("raise slew_psi_per_s of `{name}`, or write a longer time"));
        }
    }
    safety
}

/// Every unit on a line has to hear of a stop in time: within the time in which the owner of the line gives up on the
/// loop.
fn check_lines(root: &mut Section<'_>, serial: &[RawSerial], frees: &[RawFree], timeout: Duration) {
    for (name, mut section) in root.named("serial") {
        section.accept_rest();
        let units = frees.iter().flat_map(RawFree::units).filter(|(line, _)| *line == name).count();
        let baud = serial.iter().find(|line| line.name == name);
        let Some(baud) = baud.map(|line| line.baud).filter(|baud| BAUDS.contains(baud)) else { continue };
        let in_time = |baud: u32| round_of(units, baud) <= timeout.as_secs_f64();
        if units > 0 && !in_time(baud) {
            let ms = |seconds: f64| 1e3 * seconds;
            let rule = format!(
                "serves {units} units in {:.0} ms, and each has to hear of a stop within command_timeout_ms = {:.0}",
                ms(round_of(units, baud)),
                ms(timeout.as_secs_f64())
            );
            let remedy = match BAUDS.into_iter().find(|baud| in_time(*baud)) {
                Some(fast) => format!(
                    "set the line and its units to at least {fast} ({:.0} ms), or move units to another line",
                    ms(round_of(units, fast))
                ),
                None => "write a longer command_timeout_ms, or move units to another line".into(),
            };
            section.reject("baud_bd", rule, remedy);
        }
    }
}

fn read_record(mut section: Section<'_>) -> RecordConfig {
    let record = RecordConfig {
        directory: section.path("directory", "runs"),
        most: section.has("runs_mib").then(|| section.number("runs_mib", 0.0, 1.0..=1e9) as u64),
        free: section.number("free_mib", 100.0, 0.0..=1e9) as u64,
        live_view: section.flag("live_view", true),
        page_port: section.integer("page_port", 9090, 1024..=65535) as u16,
        data_port: section.integer("data_port", 9876, 1024..=65535) as u16,
        memory_limit: section.number("memory_limit_mib", 512.0, 16.0..=65536.0) as u64,
    };
    if record.page_port == record.data_port {
        section.reject("page_port", "must differ from `data_port`", "give the page another port, for example 9090");
    }
    record
}

/// Reads the section of the control socket; `base` is the directory of rig.toml.
pub(super) fn read_socket(mut section: Section<'_>, base: &Path) -> SocketConfig {
    let path = base.join(section.path("path", "runs/control.sock"));
    if path.as_os_str().len() > SOCKET_PATH_MAX {
        let rule = format!("a socket's path has at most {SOCKET_PATH_MAX} bytes, this one {}", path.as_os_str().len());
        section.reject(
            "path",
            rule,
            "write a shorter absolute path, for example `path = \"/run/freerig/control.sock\"`",
        );
    }
    SocketConfig { path, group: section.optional_text("group") }
}

fn read_gpio(mut section: Section<'_>) -> GpioWiring {
    let chip = section.path("chip", "/dev/gpiochip0");
    let mut line = |key| {
        section.expect(key);
        section.has(key).then(|| section.integer(key, 0, 0..=1023) as u32)
    };
    let (dump_valve, heartbeat, estop, supply) = (line("dump_valve"), line("heartbeat"), line("estop"), line("supply"));
    if heartbeat.is_some() && dump_valve.is_none() {
        section.reject(
            "heartbeat",
            "is the dump valve's, and there is none",
            "add `dump_valve` with the line of its coil",
        );
    }
    let lines = [("dump_valve", dump_valve), ("heartbeat", heartbeat), ("estop", estop), ("supply", supply)];
    for (i, (key, line)) in lines.iter().enumerate() {
        if line.is_some() && lines[..i].iter().any(|(_, other)| other == line) {
            let remedy = "give every line a number of its own (gpioinfo lists them)";
            section.reject(key, "another line has this number", remedy);
        }
    }
    GpioWiring { chip, dump_valve, heartbeat, estop, supply }
}

/// The IMUs' reset lines are lines of `[gpio]`, and nobody else's.
fn check_resets(root: &Section<'_>, gpio: Option<&GpioWiring>, frees: &[RawFree], module: Option<&RawModule>) {
    let imus = frees.iter().filter_map(|free| free.imu.as_ref()).chain(module.and_then(|module| module.imu.as_ref()));
    let mut taken: Vec<u32> = gpio
        .into_iter()
        .flat_map(|gpio| [gpio.dump_valve, gpio.heartbeat, gpio.estop, gpio.supply])
        .flatten()
        .collect();
    for line in imus.filter_map(|imu| imu.reset) {
        if gpio.is_none() {
            let rule = format!("an IMU has `reset_line = {line}`, and there is no `[gpio]`");
            root.reject("gpio", rule, "add `[gpio]` with the chip that the line belongs to");
        }
        if taken.contains(&line) {
            let rule = format!("line {line} is there twice, once as the `reset_line` of an IMU");
            root.reject("gpio", rule, "give every line a number of its own (gpioinfo lists them)");
        }
        taken.push(line);
    }
}

fn read_sim(mut section: Section<'_>) -> RawSim {
    RawSim {
        seed: section.integer("seed", 1, 0..=i64::MAX) as u64,
        dump_valve: section.flag("dump_valve", true),
        imu_delay: duration(section.number("imu_delay_ms", 15.0, 0.0..=200.0)),
        imu_noise: section.number("imu_noise_deg", 0.05, 0.0..=10.0),
        imu_rate_noise: section.number("imu_rate_noise_deg_per_s", 0.1, 0.0..=100.0),
    }
}

fn read_i2c(root: &mut Section<'_>) -> Vec<RawI2c> {
    let mut buses: Vec<RawI2c> = Vec::new();
    for (name, mut section) in root.named("i2c") {
        let device = PathBuf::from(section.text("device", "/dev/i2c-1"));
        if let Some(other) = buses.iter().find(|bus| bus.device == device) {
            reject_device(&section, &other.name);
        }
        buses.push(RawI2c { name, device });
    }
    buses
}

fn read_serial(root: &mut Section<'_>) -> Vec<RawSerial> {
    let mut lines: Vec<RawSerial> = Vec::new();
    for (name, mut section) in root.named("serial") {
        let device = PathBuf::from(section.text("device", "/dev/serial/by-id/usb-FTDI_..."));
        if let Some(other) = lines.iter().find(|line| line.device == device) {
            reject_device(&section, &other.name);
        }
        let baud = section.integer("baud_bd", 19200, 0..=4_000_000) as u32;
        if !BAUDS.contains(&baud) {
            let rule = format!("must be one of {BAUDS:?}");
            section.reject("baud_bd", rule, "write the rate that the unit's front panel shows; 19200 from the factory");
        }
        lines.push(RawSerial { name, device, baud });
    }
    lines
}

fn reject_device(section: &Section<'_>, other: &str) {
    let rule = format!("`{other}` has the same device file");
    section.reject("device", rule, "one owner per bus: keep one of the two, or correct the device file");
}

fn read_frees(
    root: &mut Section<'_>,
    i2c: &[RawI2c],
    serial: &[RawSerial],
    library: &mut Library<'_>,
    backend: Backend,
) -> Vec<RawFree> {
    let sections = root.sections("free");
    if sections.is_empty() && !root.has("free") {
        root.reject("free", "a rig has at least one FREE", "add a `[[free]]` with its name, imu, regulator and limits");
    }
    if sections.len() > MAX_FREES {
        let rule = format!("a rig has at most {MAX_FREES} FREEs, this one {}", sections.len());
        root.reject("free", rule, "move the others to a rig of their own");
    }
    let mut frees = Vec::new();
    for section in sections {
        let free = read_free(section, i2c, serial, &frees, library, backend);
        frees.push(free);
    }
    frees
}

/// A duration of `seconds`; zero where it is none (the problem has been noted).
pub(super) fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

//! Buses, serial lines and what hangs on them, asked by the drivers that the daemon uses.

use std::fs;
use std::path::Path;

use embedded_hal::i2c::I2c;

use super::{Finding, Treatment};
use crate::clock::Clock;
use crate::config::Rig;
use crate::daemon::join::axes;
use crate::hardware::ads1115::Ads1115;
use crate::hardware::alicat::Unit;
use crate::hardware::bno055::Bno055;
use crate::hardware::mcp4728::Mcp4728;
use crate::hardware::pwm::PwmOutput;
use crate::hardware::serial_line::Line;
use crate::hardware::wiring::{I2cWiring, ImuWiring, SerialWiring, UnitWiring};
use crate::hardware::{HardwareError, Imu, i2c, serial};
use crate::signal::RegulatorStatus;
use crate::sim::SimRig;
use crate::units::Pressure;

/// What a unit that is all right does not report.
const TROUBLE: RegulatorStatus = RegulatorStatus::PRESSURE_OVER_RANGE
    .with(RegulatorStatus::CONVERTER_FAILED)
    .with(RegulatorStatus::OVERPRESSURE_LIMIT)
    .with(RegulatorStatus::HELD)
    .with(RegulatorStatus::EXHAUSTING)
    .with(RegulatorStatus::ECHO_MISMATCH)
    .with(RegulatorStatus::REJECTED);
/// How often the id of every IMU is read: the error rate of its bus.
const ID_READS: u32 = 100;

pub(super) fn look(rig: &Rig, treatment: Treatment, clock: &Clock, tell: &mut dyn FnMut(Finding)) {
    let sim = rig.is_simulated().then(|| SimRig::new(&rig.bench, &rig.wiring, &axes(rig), clock));
    for (index, wiring) in rig.wiring.i2c.iter().enumerate() {
        match sim.as_ref().and_then(|sim| sim.i2c(index)) {
            Some((bus, clock)) => {
                let mut mark = simulated(tell);
                mark(Finding::ok(subject("I2C bus", &wiring.name), "in memory"));
                Bus { wiring, clock, open: || Ok(bus.clone()), treatment }.look(&mut mark);
            }
            None => {
                let subject = subject("I2C bus", &wiring.name);
                match i2c::open(&wiring.device) {
                    Ok(_) => {
                        tell(Finding::ok(subject, wiring.device.display().to_string()));
                        let open = || i2c::open(&wiring.device);
                        Bus { wiring, clock: clock.fork(), open, treatment }.look(tell);
                    }
                    Err(error) => tell(failure(subject, &error)),
                }
            }
        }
    }
    for (index, wiring) in rig.wiring.serial.iter().enumerate() {
        match &sim {
            Some(sim) => simulated_line(sim, index, wiring, clock, &mut simulated(tell)),
            None => serial_line(&wiring.device.display().to_string(), wiring, clock, tell),
        }
    }
}

/// Every finding says that nobody has looked at a real device.
fn simulated(tell: &mut dyn FnMut(Finding)) -> impl FnMut(Finding) {
    |finding| tell(Finding { found: format!("SIMULATED: {}", finding.found), ..finding })
}

fn subject(kind: &str, name: &str) -> String {
    format!("{kind} {name}")
}

/// One I2C bus that can be opened.
struct Bus<'w, O> {
    wiring: &'w I2cWiring,
    clock: Clock,
    open: O,
    treatment: Treatment,
}

impl<I: I2c, O: FnMut() -> Result<I, HardwareError>> Bus<'_, O> {
    fn look(mut self, tell: &mut dyn FnMut(Finding)) {
        for dac in &self.wiring.dacs {
            let subject = format!("MCP4728 at {:#04x}", dac.address);
            match self.dac(dac.address) {
                Ok(found) => tell(Finding::ok(subject, found)),
                Err(error) => tell(failure(subject, &error)),
            }
        }
        for adc in &self.wiring.adcs {
            let subject = format!("ADS1115 at {:#04x}", adc.address);
            match self.adc(adc.address) {
                Ok(found) => tell(Finding::ok(subject, found)),
                Err(error) => tell(failure(subject, &error)),
            }
        }
        for imu in &self.wiring.imus {
            let subject = format!("BNO055 at {:#04x}", imu.address);
            match self.imu(imu) {
                Ok((found, 0)) => tell(Finding::ok(subject, found)),
                Ok((found, errors)) => tell(Finding::warn(
                    subject,
                    format!("{found}; {errors} of {ID_READS} readings of its id failed or were wrong"),
                    "shorten the cable, slow the bus down; on a Raspberry Pi use software I2C (dtoverlay=i2c-gpio)",
                )),
                Err(error) => tell(failure(subject, &error)),
            }
        }
    }

    fn dac(&mut self, address: u8) -> Result<String, HardwareError> {
        let mut driver = Mcp4728::new((self.open)()?, self.clock.clone(), &self.wiring.name, address);
        let mut treated = "";
        if self.treatment.program_dac && driver.status()?.iter().any(|channel| !channel.starts_safe()) {
            driver.program_safe_eeprom()?;
            treated = "; programmed just now";
        }
        let identity = driver.connect()?;
        Ok(format!("{identity}, at zero, and starts at zero when power comes{treated}"))
    }

    fn adc(&mut self, address: u8) -> Result<String, HardwareError> {
        let identity = Ads1115::new((self.open)()?, &self.wiring.name, address).connect()?;
        Ok(format!("{identity}, thresholds as after power-on"))
    }

    /// Who it is, and how many readings of its id failed.
    fn imu(&mut self, wiring: &ImuWiring) -> Result<(String, u32), HardwareError> {
        let bus = (self.open)()?;
        let mut driver = Bno055::new(bus, self.clock.clone(), &self.wiring.name, wiring.address, wiring.profile);
        let identity = driver.connect()?;
        let profile = if wiring.profile.is_some() { "restored" } else { "none saved" };
        Ok((format!("{identity}; calibration profile: {profile}"), driver.probe_errors(ID_READS)))
    }
}

fn simulated_line(sim: &SimRig, index: usize, wiring: &SerialWiring, clock: &Clock, tell: &mut dyn FnMut(Finding)) {
    let plugged = tempfile::tempdir()
        .and_then(|folder| Ok((sim.pty(index, &folder.path().join("line"), std::sync::Arc::new(|| ()))?, folder)));
    match plugged {
        Ok((pty, _folder)) => {
            let wiring = SerialWiring { device: pty.path().to_owned(), ..wiring.clone() };
            serial_line("a pseudo-terminal", &wiring, clock, tell);
        }
        Err(error) => tell(Finding::fail(
            subject("serial line", &wiring.name),
            format!("no pseudo-terminal: {error}"),
            "mount /dev/pts and make the folder for temporary files writable",
        )),
    }
}

fn serial_line(shown: &str, wiring: &SerialWiring, clock: &Clock, tell: &mut dyn FnMut(Finding)) {
    let subject = subject("serial line", &wiring.name);
    match tokio::runtime::Builder::new_current_thread().enable_all().build() {
        Ok(runtime) => runtime.block_on(ask_units(subject, shown, wiring, clock, tell)),
        Err(error) => tell(Finding::fail(subject, error.to_string(), "free file descriptors (`ulimit -n`)")),
    }
}

async fn ask_units(subject: String, shown: &str, wiring: &SerialWiring, clock: &Clock, tell: &mut dyn FnMut(Finding)) {
    let stream = match serial::open(wiring) {
        Ok(stream) => stream,
        Err(error) => return tell(failure(subject, &error)),
    };
    let opened = format!("{shown} at {} Bd", wiring.baud);
    tell(match latency_timer(&wiring.device) {
        Some(milliseconds @ 2..) => Finding::warn(
            subject,
            format!("{opened}; its adapter holds bytes back for {milliseconds} ms"),
            "set its latency_timer to 1 with a udev rule (systemd/70-freerig.rules)",
        ),
        Some(_) => Finding::ok(subject, format!("{opened}, latency timer 1 ms")),
        None => Finding::ok(subject, opened),
    });
    let mut line = Line::new(stream, clock.fork(), wiring.baud, Default::default());
    for unit in &wiring.units {
        let name = format!("Alicat unit {}", char::from(unit.id));
        tell(match ask(unit, &wiring.name, &mut line).await {
            Ok((found, None)) => Finding::ok(name, found),
            Ok((found, Some(remedy))) => Finding::fail(name, found, remedy),
            Err(error) => failure(name, &error),
        });
    }
    for pwm in &wiring.pwms {
        let Some(mut output) = PwmOutput::new(*pwm, &wiring.name) else { continue };
        let subject = format!("PWM output {}", char::from(pwm.id));
        tell(match output.on(&mut line).identify().await {
            Ok(sample) if sample.status.intersects(TROUBLE) => Finding::fail(
                subject,
                "it does not stay at the duty that it is told",
                "look at its supply (does it reset?) and at its firmware",
            ),
            Ok(_) => Finding::ok(subject, format!("{}, duty zero", output.identity())),
            Err(error) => failure(subject, &error.at(output.device())),
        });
    }
}

/// What the unit says, and what is to be done about it.
async fn ask<S>(
    wiring: &UnitWiring,
    line_name: &str,
    line: &mut Line<S>,
) -> Result<(String, Option<&'static str>), HardwareError>
where
    S: tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin,
{
    let Some(mut unit) = Unit::new(*wiring, line_name) else {
        return Ok(("its id is not a letter from A to Z".into(), Some("correct `unit` in rig.toml")));
    };
    let sample = unit.on(line).identify().await.map_err(|error| error.at(unit.device()))?;
    let role = if wiring.gauge { "a gauge" } else { "set-point zero" };
    let found = format!("{:.2}, {role}", Pressure::pascals(sample.pressure));
    let remedy = if unit.is_analog() {
        Some("it takes its set-point from its analogue input: set the source to serial in its menu")
    } else if sample.status.intersects(TROUBLE) {
        Some("it reports a fault, a hold, or does not accept zero: look at its display, power it off and on")
    } else {
        None
    };
    Ok((found, remedy))
}

/// The adapter's latency timer, ms, where it has one (FTDI).
fn latency_timer(device: &Path) -> Option<u32> {
    let device = fs::canonicalize(device).ok()?;
    let name = device.file_name()?.to_str()?;
    fs::read_to_string(format!("/sys/bus/usb-serial/devices/{name}/latency_timer")).ok()?.trim().parse().ok()
}

/// A failure with its remedy apart.
fn failure(subject: String, error: &HardwareError) -> Finding {
    let (found, remedy) = match error {
        HardwareError::Open { device, reason, remedy } => (format!("{device}: {reason}"), remedy.clone()),
        HardwareError::Unsafe { device, reason, remedy } => (format!("{device}: {reason}"), remedy.clone()),
        other => {
            let text = other.to_string();
            let (found, remedy) = text.rsplit_once("; ").unwrap_or((&text, "check its cable and its power"));
            (found.to_owned(), remedy.to_owned())
        }
    };
    Finding::fail(subject, found, remedy)
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    fn rig() -> Rig {
        Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean")
    }

    fn findings(rig: &Rig) -> Vec<Finding> {
        let mut findings = Vec::new();
        look(rig, Treatment::default(), &Clock::Live, &mut |finding| findings.push(finding));
        findings
    }

    #[test]
    fn the_simulated_devices_answer_the_real_drivers_and_say_that_they_are_simulated() {
        let findings = findings(&rig());
        assert_eq!(findings.len(), 4, "bus, IMU, line, unit: {findings:?}");
        for finding in &findings {
            assert_eq!(finding.level, Level::Ok, "{finding}");
            assert!(finding.found.starts_with("SIMULATED: "), "{finding}");
        }
    }

    #[test]
    fn devices_that_are_not_there_fail_with_a_remedy_each() {
        let mut rig = rig();
        rig.backend = crate::config::Backend::Linux;
        rig.wiring.i2c[0].device = "/nonexistent/i2c-1".into();
        rig.wiring.serial[0].device = "/nonexistent/ttyUSB0".into();
        let findings = findings(&rig);
        assert_eq!(findings.len(), 2, "{findings:?}");
        for finding in &findings {
            assert!(finding.level == Level::Fail && finding.found.contains("/nonexistent/"), "{finding}");
            assert!(finding.remedy.is_some(), "{finding}");
        }
    }
}

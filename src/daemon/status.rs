//! Where the rig stands, for the socket.

use super::api::{DeviceStatus, FreeStatus, LoopStatus, Status};
use super::{Live, is_free_vented};
use crate::clock::Time;
use crate::config::Rig;
use crate::hardware::DeviceStatistics;
use crate::hardware::serial_line::LineStatistics;
use crate::signal::{FreeTick, ImuHealth, LimitSet, Quantity, RegulatorHealth, TickRecord};

/// The status of `rig` in `record`; faults, run and uptime are the supervisor's to add.
pub(super) fn status(rig: &Rig, live: &Live, record: &TickRecord) -> Status {
    let frees = rig.control.frees.iter().zip(record.frees()).zip(live.devices());
    Status {
        version: env!("CARGO_PKG_VERSION").into(),
        rig: rig.name.clone(),
        simulated: rig.is_simulated(),
        state: record.state.name().into(),
        frees: frees
            .enumerate()
            .map(|(index, ((free, tick), devices))| FreeStatus {
                imu: devices.imu.as_deref().map(|imu| {
                    let sample = &tick.imu;
                    device(imu, imu_health(sample.health), sample.time, record.time)
                }),
                regulator: devices.regulator.as_deref().map_or_else(DeviceStatus::default, |regulator| {
                    let line = if devices.sensor.is_none() { devices.line.as_deref() } else { None };
                    pressure_device(regulator, line, tick, record.time)
                }),
                sensor: devices
                    .sensor
                    .as_deref()
                    .map(|sensor| pressure_device(sensor, devices.line.as_deref(), tick, record.time)),
                vented: free.regulator.measures.then(|| is_free_vented(record.time, tick, free)),
                temperature_degc: rig
                    .temperatures(index)
                    .filter(|_| tick.estimate.valid)
                    .map(|knob| knob.at(tick.estimate.angle)),
                ..free_status(&free.name, tick)
            })
            .collect(),
        tick: match live.rights() {
            Some(rights) => LoopStatus::new(rig.control.period, &live.statistics(), rights),
            None => LoopStatus::default(),
        },
        ..Status::default()
    }
}

fn free_status(name: &str, tick: &FreeTick) -> FreeStatus {
    let (reference, estimate) = (&tick.reference, &tick.estimate);
    let asked = |quantity| (reference.quantity == quantity).then_some(reference.position);
    FreeStatus {
        name: name.into(),
        angle_rad: estimate.valid.then_some(estimate.angle),
        rate_rad_s: estimate.valid.then_some(estimate.rate),
        pressure_pa: tick.pressure.pressure.is_finite().then_some(tick.pressure.pressure),
        command_pa: tick.command,
        reference_rad: asked(Quantity::Angle),
        reference_pa: asked(Quantity::Pressure),
        limits: LimitSet::NAMES
            .iter()
            .filter(|(limit, _)| tick.limits.contains(*limit))
            .map(|(_, name)| (*name).into())
            .collect(),
        ..FreeStatus::default()
    }
}

/// A device whose latest reading is of the time `read`; the epoch where there was none.
fn device(statistics: &DeviceStatistics, health: &str, read: Time, now: Time) -> DeviceStatus {
    DeviceStatus::new(statistics, health, (read > Time::ZERO).then(|| now.since(read).as_secs_f64()))
}

/// A regulator or a sensor of its own, with the serial `line` that it hangs on.
fn pressure_device(
    statistics: &DeviceStatistics,
    line: Option<&LineStatistics>,
    tick: &FreeTick,
    now: Time,
) -> DeviceStatus {
    let sample = &tick.pressure;
    let status = device(statistics, regulator_health(sample.health), sample.time, now);
    DeviceStatus { line: line.map(Into::into), ..status }
}

fn imu_health(health: ImuHealth) -> &'static str {
    match health {
        ImuHealth::Absent => "absent",
        ImuHealth::Good => "good",
        ImuHealth::Implausible => "implausible",
        ImuHealth::Restarting => "restarting",
        ImuHealth::Lost => "lost",
    }
}

fn regulator_health(health: RegulatorHealth) -> &'static str {
    match health {
        RegulatorHealth::Absent => "absent",
        RegulatorHealth::Good => "good",
        RegulatorHealth::Unmeasured => "unmeasured",
        RegulatorHealth::Lost => "lost",
    }
}

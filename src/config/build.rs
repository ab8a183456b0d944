//! From what has been read to what the floors below take.

use std::time::Duration;

use super::calibration::{Calibration, keys};
use super::free::{Connection, RawFree, RawSensor, SensorConnection};
use super::load::SourceFile;
use super::rig::{Backend, Rig};
use super::sections::{RawRig, duration};
use crate::control::{ControlConfig, ControllerKind, FreeControl, ImuChannel, ModelSpec, RegulatorChannel};
use crate::hardware::i2c_owner::ADC_TURN;
use crate::hardware::wiring::{
    AdcChannel, AdcWiring, DacChannel, DacWiring, I2cWiring, ImuWiring, PwmWiring, SerialWiring, UnitWiring, Wiring,
};
use crate::sim::{AnalogueSim, BenchConfig, ImuSim, ModuleSim, PlantSim, RegulatorSim};

/// Characters of one transaction with an Alicat unit: `AS5.0000\r`, its reply `A +050.42 +050.42\r`, and the 3.5
/// idle characters that the unit needs before the next.
const TRANSACTION_CHARACTERS: f64 = COMMAND_CHARACTERS + 18.0;
/// From the taking of a command until the unit knows it: the idle characters and the set-point.
const COMMAND_CHARACTERS: f64 = 3.5 + 9.0;
/// The same of a PWM output, `A07 0800*D3\r`; a whole exchange with one takes no longer than one with an Alicat unit.
const PWM_COMMAND_CHARACTERS: f64 = 3.5 + 12.0;
/// Bits of one character on the line (8N1).
const BITS_PER_CHARACTER: f64 = 10.0;
/// Period at which a DAC's channels are written.
const DAC_PERIOD: Duration = Duration::from_millis(10);
/// What is assumed of a regulator that has not been calibrated: lag, dead time (s) and fastest rise (Pa/s).
const NOMINAL_LAG: f64 = 0.060;
const NOMINAL_DEAD_TIME: f64 = 0.015;
const NOMINAL_FILL: f64 = 30.0 * crate::units::PASCAL_PER_PSI;
/// What is assumed of an IMU's fusion delay, s.
const NOMINAL_IMU_DELAY: f64 = 0.015;

/// Builds the rig; `raw` has been found to be without problems.
pub(super) fn build(raw: RawRig, files: Vec<SourceFile>) -> Rig {
    Rig {
        control: control(&raw),
        wiring: wiring(&raw),
        bench: bench(&raw),
        module: raw.module.as_ref().map(|module| module.config.clone()),
        name: raw.name,
        backend: raw.backend,
        realtime: raw.realtime,
        record: raw.record,
        socket: raw.socket,
        calibration_directory: raw.calibration_directory,
        knobs: raw.frees.iter().map(|free| Some(free.knob.as_ref()?.knob.clone())).collect(),
        calibrations: raw.frees.into_iter().map(|free| free.calibration).collect(),
        files,
    }
}

fn control(raw: &RawRig) -> ControlConfig {
    ControlConfig {
        period: raw.realtime.period,
        vent_time: raw.safety.vent_time,
        ramp_time: raw.safety.ramp_time,
        command_timeout: raw.safety.command_timeout,
        require_realtime: raw.realtime.require_realtime,
        dump_valve: match raw.backend {
            Backend::Sim => raw.sim.dump_valve,
            Backend::Linux => raw.gpio.as_ref().is_some_and(|gpio| gpio.dump_valve.is_some()),
        },
        frees: raw.frees.iter().enumerate().map(|(index, free)| free_control(raw, index, free)).collect(),
    }
}

fn free_control(raw: &RawRig, index: usize, free: &RawFree) -> FreeControl {
    let mut control = FreeControl {
        name: free.name.clone(),
        free: free.calibration.free(),
        controller: match free.model {
            _ if raw.in_module(index) => ControllerKind::Nothing,
            true => ControllerKind::Model(ModelSpec::default()),
            false => ControllerKind::Pid,
        },
        gains: free.gains,
        derivative_on: free.derivative_on,
        feedforward: free.feedforward,
        limits: free.limits,
        imu: raw.imu(index).map(|imu| ImuChannel { axis: imu.axis, period: imu.period, delay: Duration::ZERO }),
        regulator: RegulatorChannel {
            period: regulator_period(raw, free),
            lag: Duration::ZERO,
            dead_time: Duration::ZERO,
            fastest_fill: 0.0,
            full_scale: free.full_scale(),
            measures: matches!(free.regulator.connection, Connection::Alicat { .. }) || free.sensor.is_some(),
        },
    };
    take(&mut control, &free.calibration, transport(raw, free));
    control
}

/// Takes over what `known` says; `transport` is the time of a command on its line, s.
fn take(control: &mut FreeControl, known: &Calibration, transport: f64) {
    control.free = known.free();
    if let ControllerKind::Model(model) = &mut control.controller {
        model.hysteresis = known.hysteresis.unwrap_or_default();
    }
    if let Some(imu) = &mut control.imu {
        imu.delay = duration(known.value(&keys::IMU_DELAY).unwrap_or(NOMINAL_IMU_DELAY));
    }
    let regulator = &mut control.regulator;
    regulator.lag = duration(known.value(&keys::REGULATOR_LAG).unwrap_or(NOMINAL_LAG));
    regulator.dead_time = duration(transport + dead_time(known));
    regulator.fastest_fill = known.value(&keys::FASTEST_FILL).unwrap_or(NOMINAL_FILL);
}

fn dead_time(known: &Calibration) -> f64 {
    known.value(&keys::REGULATOR_DEAD_TIME).unwrap_or(NOMINAL_DEAD_TIME)
}

/// From the taking of a command to its arrival, s.
fn transport_of(control: &FreeControl, known: &Calibration) -> f64 {
    (control.regulator.dead_time.as_secs_f64() - dead_time(known)).max(0.0)
}

impl Rig {
    /// Time of a command on its way to the regulator of the FREE `index`, s; zero where there is no such FREE.
    pub fn transport(&self, index: usize) -> f64 {
        self.control.frees.get(index).zip(self.calibrations.get(index)).map_or(0.0, |(c, k)| transport_of(c, k))
    }

    /// Time of a reading on its way back, s; zero where there is no such FREE.
    pub fn reply(&self, index: usize) -> f64 {
        let line = self.wiring.serial.iter().find(|line| line.units.iter().any(|unit| unit.free == index));
        line.map_or(0.0, |line| {
            (TRANSACTION_CHARACTERS - COMMAND_CHARACTERS) * BITS_PER_CHARACTER / f64::from(line.baud)
        })
    }

    /// Has the FREE `index` controlled by what `calibration` says; the simulated FREE stays what it is. Gains that the
    /// rig names stay, too.
    pub fn adopt(&mut self, index: usize, calibration: Calibration) {
        let (Some(control), Some(known)) = (self.control.frees.get_mut(index), self.calibrations.get_mut(index)) else {
            return;
        };
        let transport = transport_of(control, known);
        take(control, &calibration, transport);
        *known = calibration;
    }
}

/// Period at which the FREE's pressure is measured and its regulator told, the slower of the two: every unit on its
/// lines, and every channel of its ADC, comes in between.
fn regulator_period(raw: &RawRig, free: &RawFree) -> Duration {
    let on = |line: &str| raw.frees.iter().flat_map(RawFree::units).filter(|(of, _)| *of == line).count();
    let lines = free.units().map(|(line, _)| duration(round_of(on(line), baud(raw, line))));
    let adc = adc_of(free).map(|(bus, address, ..)| {
        let on = |other: &(&str, u8, usize, (f64, f64))| other.0 == bus && other.1 == address;
        ADC_TURN * raw.frees.iter().filter_map(adc_of).filter(on).count() as u32
    });
    let dac = matches!(free.regulator.connection, Connection::Dac { .. }).then_some(DAC_PERIOD);
    lines.chain(adc).chain(dac).max().unwrap_or(DAC_PERIOD)
}

/// Bus, address, channel and voltages of the ADC that measures the FREE's pressure.
fn adc_of(free: &RawFree) -> Option<(&str, u8, usize, (f64, f64))> {
    match &free.sensor.as_ref()?.connection {
        SensorConnection::Adc { bus, address, channel, volts } => Some((bus, *address, *channel, *volts)),
        _ => None,
    }
}

/// From the taking of a command to its arrival, s.
fn transport(raw: &RawRig, free: &RawFree) -> f64 {
    match &free.regulator.connection {
        Connection::Alicat { line, .. } => COMMAND_CHARACTERS * character(raw, line),
        Connection::Pwm { line, .. } => PWM_COMMAND_CHARACTERS * character(raw, line),
        // A few bytes at 100 kHz or more.
        Connection::Dac { .. } | Connection::Unknown => 0.0,
    }
}

/// Time of one character on a line, s.
fn character(raw: &RawRig, line: &str) -> f64 {
    BITS_PER_CHARACTER / f64::from(baud(raw, line))
}

fn baud(raw: &RawRig, line: &str) -> u32 {
    raw.serial.iter().find(|serial| serial.name == *line).map_or(19200, |serial| serial.baud)
}

/// Time in which each of so many `units` on a line of `baud` is served once, s.
pub(super) fn round_of(units: usize, baud: u32) -> f64 {
    units as f64 * TRANSACTION_CHARACTERS * BITS_PER_CHARACTER / f64::from(baud)
}

fn wiring(raw: &RawRig) -> Wiring {
    Wiring {
        i2c: raw
            .i2c
            .iter()
            .map(|bus| I2cWiring {
                name: bus.name.clone(),
                device: bus.device.clone(),
                imus: imus(raw, &bus.name),
                dacs: dacs(raw, &bus.name),
                adcs: adcs(raw, &bus.name),
            })
            .collect(),
        serial: raw
            .serial
            .iter()
            .map(|line| SerialWiring {
                name: line.name.clone(),
                device: line.device.clone(),
                baud: line.baud,
                units: units(raw, &line.name),
                pwms: pwms(raw, &line.name),
            })
            .collect(),
        gpio: raw.gpio.clone(),
        command_timeout: raw.safety.command_timeout,
    }
}

fn imus(raw: &RawRig, bus: &str) -> Vec<ImuWiring> {
    let mut imus: Vec<ImuWiring> = Vec::new();
    for (index, free) in raw.frees.iter().enumerate() {
        let Some(imu) = raw.imu(index).filter(|imu| imu.bus == bus) else { continue };
        match imus.iter_mut().find(|other| other.address == imu.address) {
            // That of a module's plate.
            Some(shared) => shared.frees.push(index),
            None => imus.push(ImuWiring {
                frees: vec![index],
                address: imu.address,
                period: imu.period,
                reset: imu.reset,
                profile: free.calibration.imu_profile,
            }),
        }
    }
    imus
}

fn dacs(raw: &RawRig, bus: &str) -> Vec<DacWiring> {
    let mut dacs: Vec<DacWiring> = Vec::new();
    for (index, free) in raw.frees.iter().enumerate() {
        let Connection::Dac { bus: of, address, channel } = &free.regulator.connection else { continue };
        if of != bus {
            continue;
        }
        let at = dacs.iter().position(|dac| dac.address == *address).unwrap_or_else(|| {
            dacs.push(DacWiring { address: *address, channels: [None; 4] });
            dacs.len() - 1
        });
        dacs[at].channels[*channel] = Some(dac_channel(index, &free.calibration));
    }
    dacs
}

fn adcs(raw: &RawRig, bus: &str) -> Vec<AdcWiring> {
    let mut adcs: Vec<AdcWiring> = Vec::new();
    for (index, free) in raw.frees.iter().enumerate() {
        let Some((_, address, channel, (zero, full))) = adc_of(free).filter(|(of, ..)| *of == bus) else { continue };
        let at = adcs.iter().position(|adc| adc.address == address).unwrap_or_else(|| {
            adcs.push(AdcWiring { address, channels: [None; 4] });
            adcs.len() - 1
        });
        let pascals_per_volt = free.full_scale() / (full - zero);
        adcs[at].channels[channel] = Some(AdcChannel { free: index, zero_volts: zero, pascals_per_volt });
    }
    adcs
}

fn pwms(raw: &RawRig, line: &str) -> Vec<PwmWiring> {
    let output = |(index, free): (usize, &RawFree)| match &free.regulator.connection {
        Connection::Pwm { line: of, id } if of == line => {
            Some(PwmWiring { id: *id, channel: dac_channel(index, &free.calibration) })
        }
        _ => None,
    };
    raw.frees.iter().enumerate().filter_map(output).collect()
}

/// What is not known has been noted: such a channel is told zero only.
fn dac_channel(free: usize, known: &Calibration) -> DacChannel {
    DacChannel {
        free,
        zero_code: known.value(&keys::ZERO_CODE).unwrap_or_default(),
        pascals_per_code: known.value(&keys::PRESSURE_PER_CODE).unwrap_or_default(),
    }
}

/// What the simulated analogue regulator is scattered around; its tube hangs where `[free.sim]` says.
fn analogue(free: &RawFree) -> Option<AnalogueSim> {
    let channel = match free.regulator.connection {
        Connection::Dac { channel, .. } => free.twin.dac_channel.unwrap_or(channel),
        Connection::Pwm { .. } => 0,
        Connection::Alicat { .. } | Connection::Unknown => return None,
    };
    Some(AnalogueSim {
        channel,
        zero_code: free.calibration.nominal_value(&keys::ZERO_CODE)?,
        pascals_per_code: free.calibration.nominal_value(&keys::PRESSURE_PER_CODE)?,
    })
}

fn units(raw: &RawRig, line: &str) -> Vec<UnitWiring> {
    let frees = raw.frees.iter().enumerate();
    frees
        .filter_map(|(index, free)| {
            let (of, id, pascals_per_unit, gauge) = match (&free.regulator.connection, &free.sensor) {
                (Connection::Alicat { line, id, pascals_per_unit }, _) => (line, *id, *pascals_per_unit, false),
                (_, Some(RawSensor { connection: SensorConnection::Alicat { line, id, pascals_per_unit }, .. })) => {
                    (line, *id, *pascals_per_unit, true)
                }
                _ => return None,
            };
            let full_scale = free.full_scale();
            (of == line).then_some(UnitWiring { free: index, gauge, id, full_scale, pascals_per_unit })
        })
        .collect()
}

fn bench(raw: &RawRig) -> BenchConfig {
    BenchConfig {
        seed: raw.sim.seed,
        plants: raw
            .frees
            .iter()
            .map(|free| PlantSim {
                nominal: free.calibration.simulated_nominal(),
                scatter: free.twin.scatter,
                hysteresis: free.twin.hysteresis,
                load_moment: free.twin.load_moment,
                knob: free.knob.as_ref().map(|knob| knob.sim),
                regulator: RegulatorSim {
                    lag: free.twin.lag,
                    dead_time: free.twin.dead_time,
                    slew: free.twin.slew,
                    noise: free.twin.noise,
                    full_scale: free.regulator.full_scale,
                },
                analogue: analogue(free),
            })
            .collect(),
        module: raw.module.as_ref().map(|module| ModuleSim {
            frees: module.config.frees,
            scene: module.config.scene(|index| &raw.frees[index].calibration),
            damping: module.config.damping,
            payload: module.config.payload,
        }),
        imu: ImuSim { delay: raw.sim.imu_delay, noise: raw.sim.imu_noise, rate_noise: raw.sim.imu_rate_noise },
        dump_valve: raw.sim.dump_valve,
        one_shot: raw.gpio.as_ref().is_some_and(|gpio| gpio.heartbeat.is_some()),
    }
}

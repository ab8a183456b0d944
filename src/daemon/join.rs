//! Joins tick, pump and bus owners by their slots and rings.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rtrb::{Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

use super::tick::{Switches, Tick};
use super::{DaemonError, Pump};
use crate::clock::Clock;
use crate::config::{Cache, Rig};
use crate::control::{Controller, Request};
use crate::hardware::I2cPorts;
use crate::signal::{Command, ImuSample, MAX_FREES, PressureSample, Trim};
use crate::sim::{Plant, SimRig};

/// Records that the ring holds: 8 s at 500 Hz, so that a stall of the recorder loses none.
const RECORDS: usize = 4096;
/// Requests that may wait for the tick, one of which it takes at a time.
const REQUESTS: usize = 16;
/// Programs that may wait to be freed: two for every request.
const RETIRED: usize = 4 * REQUESTS;
/// A regulator that measures nothing is silent after so many periods without a word of it.
const SILENT_PERIODS: u32 = 3;

/// The ends of every slot and ring, to be handed out.
pub struct Joints {
    /// For the loop.
    pub tick: Tick,
    /// For everybody who wants to know.
    pub pump: Pump,
    /// For the supervisor.
    pub requests: Producer<Request>,
    /// For whoever follows a path with a module.
    pub trim: Input<Trim>,
    /// Switches that the tick reads.
    pub switches: Arc<Switches>,
    /// By I2C bus of the wiring.
    pub i2c: Vec<I2cPorts>,
    /// By serial line of the wiring: the command, and a slot for each unit, then for each PWM output.
    pub serial: Vec<(Output<Command>, Vec<Input<PressureSample>>)>,
    /// For the owner of the dump valve, where one is fitted.
    pub valve: Option<Output<Command>>,
}

/// By FREE: its axis in its sensor's frame.
pub(super) fn axes(rig: &Rig) -> Vec<[f64; 3]> {
    rig.control.frees.iter().map(|f| f.imu.map_or([0.0, 0.0, 1.0], |imu| imu.axis)).collect()
}

/// The simulated rig of `rig` on `clock`, with the module's plate on its FREEs where it has one.
///
/// # Errors
/// Where the module is none, or does not stand without pressure.
pub fn simulated(rig: &Rig, clock: &Clock) -> Result<SimRig, DaemonError> {
    let sim = SimRig::new(&rig.bench, &rig.wiring, &axes(rig), clock);
    if let Some(module) = &rig.bench.module {
        let cache = Cache::usual();
        let plate = module
            .plate(&rig.bench, rig.highest_pressure(), |request| cache.section_law(request))
            .map_err(|error| DaemonError::Rig(format!("the simulated module: {error}")))?;
        sim.plant().lock().unwrap_or_else(PoisonError::into_inner).mount(module.frees.to_vec(), plate);
    }
    Ok(sim)
}

/// Makes the joints of `rig`; `plant` is the simulated one, asked for the truth; `switches` brings the emergency
/// stop and the heartbeat of whoever is in command.
///
/// # Errors
/// If the controller cannot be built.
pub fn join(rig: &Rig, plant: Option<Arc<Mutex<Plant>>>, switches: Switches) -> Result<Joints, DaemonError> {
    let switches = Arc::new(switches);
    let mut commands = Vec::new();
    let mut command = || {
        let (input, output) = triple_buffer(&Command::default());
        commands.push(input);
        output
    };
    let mut imu: [Option<Output<ImuSample>>; MAX_FREES] = Default::default();
    let mut pressure: [Option<Output<PressureSample>>; MAX_FREES] = Default::default();
    let mut sensor: [Option<Output<PressureSample>>; MAX_FREES] = Default::default();
    let slot_in = |slots: &mut [Option<Output<PressureSample>>; MAX_FREES], free: usize| {
        let (input, output) = triple_buffer(&PressureSample { pressure: f64::NAN, ..PressureSample::default() });
        if let Some(slot) = slots.get_mut(free) {
            *slot = Some(output);
        }
        input
    };
    let mut i2c = Vec::new();
    for bus in &rig.wiring.i2c {
        let mut ports = I2cPorts { command: command(), imu: Vec::new(), pressure: Vec::new(), sensor: Vec::new() };
        for &free in bus.imus.iter().flat_map(|i| &i.frees) {
            let (input, output) = triple_buffer(&ImuSample::default());
            if let Some(slot) = imu.get_mut(free) {
                *slot = Some(output);
            }
            ports.imu.push((free, input));
        }
        for channel in bus.dacs.iter().flat_map(|d| d.channels.iter().flatten()) {
            ports.pressure.push((channel.free, slot_in(&mut pressure, channel.free)));
        }
        for channel in bus.adcs.iter().flat_map(|a| a.channels.iter().flatten()) {
            ports.sensor.push((channel.free, slot_in(&mut sensor, channel.free)));
        }
        i2c.push(ports);
    }
    let serial = rig
        .wiring
        .serial
        .iter()
        .map(|line| {
            let mut slots = Vec::new();
            for unit in &line.units {
                slots.push(slot_in(if unit.gauge { &mut sensor } else { &mut pressure }, unit.free));
            }
            slots.extend(line.pwms.iter().map(|pwm| slot_in(&mut pressure, pwm.channel.free)));
            (command(), slots)
        })
        .collect();
    let valve = rig.control.dump_valve.then(&mut command);
    let (trim_in, trim_out) = triple_buffer(&Trim::default());
    let (record_in, record_out) = RingBuffer::new(RECORDS);
    let (request_in, request_out) = RingBuffer::new(REQUESTS);
    let (retired_in, retired_out) = RingBuffer::new(RETIRED);
    let mut patience = [Duration::ZERO; MAX_FREES];
    for (patience, free) in patience.iter_mut().zip(&rig.control.frees) {
        *patience = SILENT_PERIODS * free.regulator.period;
    }
    let tick = Tick {
        controller: Controller::new(&rig.control)?,
        imu,
        pressure,
        sensor,
        patience,
        commands,
        trim: trim_out,
        requests: request_out,
        records: record_in,
        retired: retired_in,
        switches: Arc::clone(&switches),
    };
    let pump = Pump::new(record_out, retired_out, Arc::clone(&switches), plant);
    Ok(Joints { tick, pump, requests: request_in, trim: trim_in, switches, i2c, serial, valve })
}

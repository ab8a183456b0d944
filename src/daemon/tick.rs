//! One tick of the rig: slots in, controller, slots out. The real-time thread and the stepped scheduler run
//! this same code. Nothing here allocates, locks, logs or waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rtrb::{Consumer, Producer};
use triple_buffer::{Input, Output};

use super::handle::LastHeard;
use crate::control::{Controller, Request, TickInput};
use crate::rt::Timing;
use crate::signal::{Command, ImuSample, MAX_FREES, PressureSample, TickRecord};
use crate::trajectory::Program;

/// Switches that other threads throw and the tick reads.
#[derive(Debug, Default)]
pub struct Switches {
    /// The emergency stop; stays set until faults are cleared.
    pub estop: Arc<AtomicBool>,
    /// A configuration file differs from what was loaded.
    pub config_changed: AtomicBool,
    /// Whether the real-time thread got its rights.
    pub realtime: AtomicBool,
    /// Latest heartbeat of the client that runs the program.
    pub heartbeat: Arc<LastHeard>,
    /// Records that found the ring full.
    pub lost_records: AtomicU64,
}

/// The tick with its ends of all slots and rings.
pub struct Tick {
    pub(super) controller: Controller,
    pub(super) imu: [Option<Output<ImuSample>>; MAX_FREES],
    pub(super) pressure: [Option<Output<PressureSample>>; MAX_FREES],
    pub(super) commands: Vec<Input<Command>>,
    pub(super) requests: Consumer<Request>,
    pub(super) records: Producer<TickRecord>,
    pub(super) retired: Producer<Arc<Program>>,
    pub(super) switches: Arc<Switches>,
}

impl Tick {
    /// Runs one tick.
    pub fn run(&mut self, timing: &Timing) {
        let input = self.input(timing);
        let record = self.controller.tick(&input);
        let command = Controller::command(&record);
        for slot in &mut self.commands {
            slot.write(command);
        }
        if let Some(program) = self.controller.take_retired() {
            // The ring holds more than can be under way; were it full all the same, the program would be freed here.
            let _ = self.retired.push(program);
        }
        if self.records.push(record).is_err() {
            self.switches.lost_records.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn input(&mut self, timing: &Timing) -> TickInput {
        let mut input = TickInput {
            tick: timing.tick,
            time: timing.deadline,
            latency_ns: timing.latency_ns,
            execution_ns: timing.execution_ns,
            skipped: timing.skipped,
            imu: [ImuSample::default(); MAX_FREES],
            pressure: [PressureSample::default(); MAX_FREES],
            request: self.requests.pop().ok(),
            estop: self.switches.estop.load(Ordering::Acquire),
            realtime: self.switches.realtime.load(Ordering::Relaxed),
            config_changed: self.switches.config_changed.load(Ordering::Relaxed),
            heartbeat: self.switches.heartbeat.get(),
        };
        for (sample, slot) in input.imu.iter_mut().zip(&mut self.imu) {
            if let Some(slot) = slot {
                *sample = *slot.read();
            }
        }
        for (sample, slot) in input.pressure.iter_mut().zip(&mut self.pressure) {
            if let Some(slot) = slot {
                *sample = *slot.read();
            }
        }
        input
    }
}

//! Replay: the controller fed with a recorded run's inputs gives the recorded commands again, bit for bit.
//!
//! A record holds every input of its tick, but for what a request carries: the program and the gains stand in the
//! run's start document and are given here. The first record is the seed, a tick in which no program ran
//! ([`Controller::resume`]); debounces start anew there, so a replay is exact if none was counting then.

use std::sync::Arc;

use super::{ControlConfig, ControlError, Controller, Gains, Request, TickInput};
use crate::signal::{ImuSample, MAX_FREES, PressureSample, RequestKind, TickRecord};
use crate::trajectory::Program;

/// What the requests of the recorded run carried.
#[derive(Clone, Debug, Default)]
pub struct Carried {
    /// What every start request started.
    pub program: Arc<Program>,
    /// It was watched by a client.
    pub attended: bool,
    /// It excited for identification.
    pub identify: bool,
    /// Gains that were asked for, in order, each with the index of its FREE.
    pub gains: Vec<(usize, Gains)>,
}

/// A controller that is fed with records.
#[derive(Clone, Debug)]
pub struct Replay {
    controller: Controller,
    carried: Carried,
    next_gains: usize,
}

impl Replay {
    /// A replay that goes on after `seed`. `None` in the result: the seed's state cannot be resumed.
    pub fn new(config: &ControlConfig, seed: &TickRecord, carried: Carried) -> Result<Option<Self>, ControlError> {
        let mut controller = Controller::new(config)?;
        let resumed = controller.resume(seed);
        Ok(resumed.then_some(Self { controller, carried, next_gains: 0 }))
    }

    /// What the controller makes of the inputs of `recorded`.
    pub fn tick(&mut self, recorded: &TickRecord) -> TickRecord {
        drop(self.controller.take_retired());
        let request = match recorded.request {
            RequestKind::None => None,
            RequestKind::Arm => Some(Request::Arm),
            RequestKind::Disarm => Some(Request::Disarm),
            RequestKind::Clear => Some(Request::Clear),
            RequestKind::Stop => Some(Request::Stop),
            RequestKind::Start => Some(Request::Start {
                program: self.carried.program.clone(),
                attended: self.carried.attended,
                identify: self.carried.identify,
            }),
            RequestKind::Gains => {
                let gains = self.carried.gains.get(self.next_gains);
                self.next_gains += 1;
                gains.map(|&(free, gains)| Request::Gains { free, gains })
            }
        };
        self.controller.tick(&input(recorded, request))
    }

    /// Replays `records` and returns the index of the first whose commands come out otherwise, to the bit.
    pub fn first_difference<'a>(&mut self, records: impl IntoIterator<Item = &'a TickRecord>) -> Option<usize> {
        records.into_iter().position(|recorded| {
            let (then, now) = (Controller::command(recorded), Controller::command(&self.tick(recorded)));
            then.vent != now.vent || then.pressure.map(f64::to_bits) != now.pressure.map(f64::to_bits)
        })
    }
}

/// The input of a recorded tick.
pub fn input(recorded: &TickRecord, request: Option<Request>) -> TickInput {
    let mut imu = [ImuSample::default(); MAX_FREES];
    let mut pressure = [PressureSample::default(); MAX_FREES];
    for (index, free) in recorded.frees().iter().enumerate() {
        imu[index] = free.imu;
        pressure[index] = free.pressure;
    }
    TickInput {
        tick: recorded.tick,
        time: recorded.time,
        latency_ns: recorded.latency_ns,
        execution_ns: recorded.execution_ns,
        skipped: recorded.skipped,
        imu,
        pressure,
        request,
        estop: recorded.estop,
        realtime: recorded.realtime,
        config_changed: recorded.config_changed,
        supply_low: recorded.supply_low,
        heartbeat: recorded.heartbeat,
        trim: recorded.trim,
    }
}

//! The controller of a rig: one tick in, one record out.
//!
//! In every tick: readings -> estimates -> interlocks -> life cycle -> references -> commands -> record. Whatever
//! comes in, every command is a number within 0..=p_max, and within the slew limit of the one before unless the
//! rig vents. After a stall in which the bus owners took the pressures away by themselves the one before is zero.

use std::sync::Arc;
use std::time::Duration;

use super::channel::{Channel, Wish};
use super::check::{ControlError, check};
use super::estimator::{Estimator, Reading};
use super::fault::Reaction;
use super::forward::{Forward, derivative_on};
use super::interlocks::{
    FreeInterlocks, HEARTBEAT_MAX, LateTicks, STALL_MAX, SUPPLY_DEBOUNCE, Seen, Vented, Verdict, reached,
};
use super::lifecycle::{Faulting, Mode, Phase, Sight};
use super::pid::Pid;
use super::trim::trimmed;
use super::{ControlConfig, Gains, Request, TickInput};
use crate::clock::Time;
use crate::signal::{
    Command, Estimate, FaultCode, FreeTick, MAX_FREES, Quantity, Refusal, RefusalCode, RequestKind, State, TickRecord,
};
use crate::trajectory::Program;

/// Longest time that one tick integrates over, in periods: after a longer stall the command moves on from where it
/// stood.
const LONGEST_STEP: f64 = 10.0;

/// What became of one FREE in this tick, before the command.
#[derive(Clone, Copy, Default)]
struct Judged {
    estimate: Estimate,
    reading: Reading,
    verdict: Verdict,
}

/// Controller, estimators, interlocks and life cycle of a rig.
#[derive(Clone, Debug)]
pub struct Controller {
    period: Duration,
    vent_time: Duration,
    ramp_time: Duration,
    command_timeout: Duration,
    require_realtime: bool,
    dump_valve: bool,
    channels: Vec<Channel>,
    phase: Phase,
    late: LateTicks,
    supply_low: Option<Time>,
    last: Option<Time>,
    retired: Option<Arc<Program>>,
}

impl Controller {
    /// A controller in Boot: commands zero.
    pub fn new(config: &ControlConfig) -> Result<Self, ControlError> {
        let count = config.frees.len();
        if count == 0 || count > MAX_FREES {
            return Err(ControlError::FreeCount(count));
        }
        for (what, duration) in
            [("period", config.period), ("vent_time", config.vent_time), ("ramp_time", config.ramp_time)]
        {
            if duration.is_zero() {
                return Err(ControlError::Duration(what));
            }
        }
        let tick = config.period.as_secs_f64();
        let channels = config
            .frees
            .iter()
            .map(|free| {
                check(free, config.ramp_time.as_secs_f64())?;
                Ok(Channel {
                    limits: free.limits,
                    pid: Pid::new(free.gains, derivative_on(free), free.free.direction()),
                    forward: Forward::new(free, tick)?,
                    estimator: free.imu.map(|imu| Estimator::new(&imu, tick)),
                    interlocks: FreeInterlocks::new(free),
                    command: 0.0,
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            period: config.period,
            vent_time: config.vent_time,
            ramp_time: config.ramp_time,
            command_timeout: config.command_timeout,
            require_realtime: config.require_realtime,
            dump_valve: config.dump_valve,
            channels,
            phase: Phase::Boot,
            late: LateTicks::default(),
            supply_low: None,
            last: None,
            retired: None,
        })
    }

    /// Where the life cycle stands.
    pub fn state(&self) -> State {
        self.phase.state()
    }

    /// The gains in force of a FREE.
    pub fn gains(&self, free: usize) -> Option<Gains> {
        self.channels.get(free).map(|c| c.pid.gains())
    }

    /// A program that is over, to be dropped by a thread that may: until it is taken no other one starts.
    pub fn take_retired(&mut self) -> Option<Arc<Program>> {
        self.retired.take()
    }

    /// What a record tells the bus owners.
    pub fn command(record: &TickRecord) -> Command {
        let mut pressure = [0.0; MAX_FREES];
        for (out, free) in pressure.iter_mut().zip(record.frees()) {
            *out = free.command;
        }
        Command { time: record.time, pressure, vent: record.vent }
    }

    /// Goes on after a recorded tick in which no program ran: Boot, Disarmed, or Armed(Hold). Debounces start anew.
    /// Returns false, and does nothing, for a record of any other state.
    pub fn resume(&mut self, record: &TickRecord) -> bool {
        self.phase = match record.state {
            State::Boot => Phase::Boot,
            State::Disarmed => Phase::Disarmed,
            State::Hold => Phase::Armed(Mode::Hold),
            _ => return false,
        };
        self.last = Some(record.time);
        self.late = LateTicks::after(record.skipped);
        for (channel, recorded) in self.channels.iter_mut().zip(record.frees()) {
            channel.command = recorded.command;
            channel.pid.resume(recorded.terms);
            channel.interlocks.resume(recorded, record.time);
            if let Some(estimator) = &mut channel.estimator {
                estimator.resume(recorded.estimate, record.time);
            }
        }
        true
    }

    /// One tick. Allocates nothing, and drops nothing that would have to be freed: a program that is over comes out
    /// of [`Controller::take_retired`], and a refused one stays with the caller, in `input`.
    pub fn tick(&mut self, input: &TickInput) -> TickRecord {
        let now = input.time;
        let period = self.period.as_secs_f64();
        let gap = self.last.map_or(period, |last| now.seconds_since(last));
        let dt = gap.clamp(0.0, LONGEST_STEP * period);
        let stall = if gap > 1.5 * period { (gap - period).min(STALL_MAX) } else { 0.0 };
        if self.last.is_some_and(|last| now.since(last) > self.command_timeout) {
            // The bus owners have commanded zero by themselves: from there it goes on.
            self.channels.iter_mut().for_each(|channel| channel.command = 0.0);
        }
        self.last = Some(now);

        let rig = self.judge_rig(input);
        let judged = self.judge(input, dt, stall);
        let verdict = judged.iter().fold(rig, |all, free| all.merge(free.verdict));
        let commands = self.commands();
        let waiting_for = self.waiting_for(input, &judged);
        let sight = Sight {
            now,
            vent_time: self.vent_time,
            ramp_time: self.ramp_time,
            dump_valve: self.dump_valve,
            request: input.request.as_ref(),
            estop: input.estop,
            verdict,
            complete: self.channels.iter().all(|c| c.interlocks.complete(now)),
            vented: self.vented(),
            against_arming: self.against_arming(input),
            waiting_for,
            against_program: self.against_program(input),
            commands: &commands,
        };
        let before = self.phase.state();
        let tares = self.tares();
        let step = std::mem::replace(&mut self.phase, Phase::Boot).advance(&sight);
        self.phase = step.phase;
        if step.retired.is_some() {
            self.retired = step.retired;
        }
        if before == State::Arming && self.phase.state() == State::Hold {
            for (channel, tare) in self.channels.iter_mut().zip(tares) {
                if let (Some(estimator), Some(tare)) = (&mut channel.estimator, tare) {
                    estimator.tare(tare);
                }
            }
        }
        let mut refusal = step.refusal;
        if let Some(Request::Gains { free, gains }) = &input.request
            && refusal == Refusal::NONE
        {
            refusal = self.set_gains(*free, *gains, &judged, now);
        }
        let entered = before == State::Hold && self.phase.run().is_some();
        let mut record = self.drive(input, entered, &judged, dt);
        record.faults = rig.faults;
        record.refusal = refusal;
        record
    }

    /// Estimates and interlocks.
    fn judge(&mut self, input: &TickInput, dt: f64, stall: f64) -> [Judged; MAX_FREES] {
        let now = input.time;
        let state = self.phase.state();
        let armed = state.is_armed();
        // A session goes from the tare to the end of its ramp or vent; beyond it nobody relies on the angle's zero.
        let session = !matches!(state, State::Boot | State::Disarmed | State::Arming | State::Faulted);
        let mut judged = [Judged::default(); MAX_FREES];
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let reading = match &mut channel.estimator {
                Some(estimator) => estimator.step(&input.imu[index], now, dt, session),
                None => Reading::None,
            };
            let estimate = channel.estimator.as_ref().map(Estimator::estimate).unwrap_or_default();
            let reference = self.phase.run().map(|run| run.program.reference(index, run.time(now)));
            let verdict = channel.interlocks.step(&Seen {
                now,
                dt,
                stall,
                imu: &input.imu[index],
                reading,
                estimate: &estimate,
                pressure: &input.pressure[index],
                command: channel.command,
                reference: &reference.unwrap_or_default(),
                armed,
                session,
            });
            judged[index] = Judged { estimate, reading, verdict };
        }
        judged
    }

    /// The rig-wide rows of the matrix.
    fn judge_rig(&mut self, input: &TickInput) -> Verdict {
        let mut verdict = Verdict::default();
        let period = u64::try_from(self.period.as_nanos()).unwrap_or(u64::MAX);
        self.late.step(input.latency_ns, input.execution_ns, input.skipped, period);
        if self.late.reaction() > Reaction::None {
            verdict.add(FaultCode::Deadline, self.late.reaction());
        }
        if let Some(run) = self.phase.run()
            && run.attended
            && reached(input.time.seconds_since(input.heartbeat.max(run.start)), HEARTBEAT_MAX)
        {
            verdict.add(FaultCode::ClientLost, Reaction::Ramp);
        }
        self.supply_low = input.supply_low.then(|| self.supply_low.unwrap_or(input.time));
        if self.supply_low.is_some_and(|since| reached(input.time.seconds_since(since), SUPPLY_DEBOUNCE)) {
            verdict.add(FaultCode::SupplyLow, Reaction::Ramp);
        }
        if input.config_changed {
            verdict.add(FaultCode::ConfigChanged, Reaction::Warn);
        }
        if self.require_realtime && !input.realtime {
            verdict.add(FaultCode::RealtimeLost, Reaction::Warn);
        }
        if input.estop {
            verdict.add(FaultCode::EmergencyStop, Reaction::Vent);
        }
        verdict
    }

    fn commands(&self) -> [f64; MAX_FREES] {
        let mut commands = [0.0; MAX_FREES];
        for (out, channel) in commands.iter_mut().zip(&self.channels) {
            *out = channel.command;
        }
        commands
    }

    /// The least vented FREE.
    fn vented(&self) -> Vented {
        let any = |v: Vented| self.channels.iter().any(|c| c.interlocks.vented() == v);
        if any(Vented::No) {
            Vented::No
        } else if any(Vented::Unknown) {
            Vented::Unknown
        } else {
            Vented::Yes
        }
    }

    fn against_arming(&self, input: &TickInput) -> Option<Refusal> {
        if input.config_changed {
            Some(refusal(RefusalCode::ConfigChanged, None))
        } else if self.require_realtime && !input.realtime {
            Some(refusal(RefusalCode::NotRealtime, None))
        } else {
            None
        }
    }

    fn against_program(&self, input: &TickInput) -> Option<Refusal> {
        let Some(Request::Start { program, .. }) = &input.request else { return None };
        if self.retired.is_some() {
            return Some(refusal(RefusalCode::Busy, None));
        }
        if input.config_changed {
            return Some(refusal(RefusalCode::ConfigChanged, None));
        }
        if !(program.duration.is_finite() && program.duration > 0.0) {
            return Some(refusal(RefusalCode::BadProgram, None));
        }
        for (index, axis) in program.axes.iter().enumerate() {
            let Some(axis) = axis else { continue };
            let fits = match (self.channels.get(index), axis.quantity) {
                (Some(channel), Quantity::Angle) => channel.estimator.is_some(),
                (Some(_), _) => true,
                (None, _) => false,
            };
            if !fits {
                return Some(refusal(RefusalCode::BadProgram, Some(index)));
            }
        }
        None
    }

    /// What arming waits for still; on the way, takes up good readings for the tare.
    fn waiting_for(&mut self, input: &TickInput, judged: &[Judged; MAX_FREES]) -> Option<Refusal> {
        let now = input.time;
        let mut first = None;
        for (index, channel) in self.channels.iter().enumerate() {
            let interlocks = &channel.interlocks;
            let calibrated = (input.imu[index].calibration >> 4) & 3 == 3;
            let measured = channel.estimator.is_some();
            let code = if !interlocks.pressure_fresh(now) {
                RefusalCode::NoPressure
            } else if interlocks.vented() != Vented::Yes {
                RefusalCode::NotVented
            } else if !interlocks.imu_fresh(now) {
                RefusalCode::NoImu
            } else if measured && !calibrated {
                RefusalCode::NotCalibrated
            } else if measured && let Phase::Arming(arming) = &mut self.phase {
                if judged[index].reading == Reading::Accepted {
                    arming.tare[index].add(&input.imu[index]);
                }
                if arming.tare[index].orientation().is_some() { RefusalCode::None } else { RefusalCode::NotStill }
            } else {
                RefusalCode::None
            };
            if code != RefusalCode::None {
                first = first.or(Some(refusal(code, Some(index))));
            }
        }
        first
    }

    /// The tares that arming has come to.
    fn tares(&self) -> [Option<[f64; 4]>; MAX_FREES] {
        match &self.phase {
            Phase::Arming(arming) => arming.tare.map(|mean| mean.orientation()),
            _ => [None; MAX_FREES],
        }
    }

    /// Commands of this tick, and the record of it.
    fn drive(&mut self, input: &TickInput, entered: bool, judged: &[Judged; MAX_FREES], dt: f64) -> TickRecord {
        let now = input.time;
        let mut record = TickRecord {
            tick: input.tick,
            time: now,
            latency_ns: input.latency_ns,
            execution_ns: input.execution_ns,
            skipped: input.skipped,
            state: self.phase.state(),
            request: input.request.as_ref().map(Request::kind).unwrap_or_default(),
            estop: input.estop,
            realtime: input.realtime,
            config_changed: input.config_changed,
            heartbeat: input.heartbeat,
            trim: input.trim,
            program_time: self.phase.run().map_or(f64::NAN, |run| run.time(now)),
            latched: self.phase.latched(),
            vent: self.phase.vent(),
            free_count: self.channels.len() as u8,
            ..TickRecord::default()
        };
        for (index, channel) in self.channels.iter_mut().enumerate() {
            let estimate = judged[index].estimate;
            let reference = self.phase.run().map(|run| run.program.reference(index, run.time(now))).unwrap_or_default();
            if entered && let Some(run) = self.phase.run() {
                channel.engage(&run.program.reference(index, -1.0), &estimate);
            }
            let wish = match &self.phase {
                Phase::Armed(Mode::Hold) => Wish::Keep,
                Phase::Faulting(Faulting::Hold) => Wish::Freeze,
                Phase::Armed(Mode::Run(run)) => {
                    let ahead = channel.forward.lead().map(|lead| run.program.reference(index, run.time(now) + lead));
                    Wish::Follow(trimmed(reference, &input.trim, index, now), ahead.unwrap_or(reference))
                }
                Phase::RampDown(ramp) | Phase::Faulting(Faulting::Ramp(ramp, _)) => {
                    Wish::Pressure(ramp.from[index] * ramp.level(now, self.ramp_time))
                }
                _ => Wish::Zero,
            };
            let (wanted, limits) = channel.drive(wish, &estimate, dt);
            record.frees[index] = FreeTick {
                imu: input.imu[index],
                pressure: input.pressure[index],
                reference,
                estimate,
                terms: channel.pid.terms(),
                wanted,
                command: channel.command,
                limits,
                faults: judged[index].verdict.faults,
            };
        }
        record
    }

    fn set_gains(&mut self, free: usize, gains: Gains, judged: &[Judged; MAX_FREES], now: Time) -> Refusal {
        let reference = self.phase.run().map(|run| run.program.reference(free, run.time(now)));
        match (self.channels.get_mut(free), gains.problem()) {
            (Some(channel), None) => {
                let estimate = judged[free].estimate;
                match reference {
                    Some(r) if r.quantity == Quantity::Angle => {
                        let r = channel.forward.compared_with(r);
                        channel.pid.set_gains(gains, &r, &estimate, channel.limits.pressure_max);
                    }
                    _ => channel.pid.replace_gains(gains),
                }
                Refusal::NONE
            }
            (Some(_), Some(_)) => refusal(RefusalCode::BadGains, Some(free)),
            (None, _) => refusal(RefusalCode::BadGains, None),
        }
    }
}

impl Request {
    /// Its stable number, for the record.
    pub fn kind(&self) -> RequestKind {
        match self {
            Request::Arm => RequestKind::Arm,
            Request::Disarm => RequestKind::Disarm,
            Request::Clear => RequestKind::Clear,
            Request::Start { .. } => RequestKind::Start,
            Request::Stop => RequestKind::Stop,
            Request::Gains { .. } => RequestKind::Gains,
        }
    }
}

fn refusal(code: RefusalCode, free: Option<usize>) -> Refusal {
    Refusal { code, free: free.map_or(Refusal::RIG, |f| f as u8), fault: None }
}

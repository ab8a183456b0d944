//! The life cycle of a rig: what it may do, and what makes it stop.
//!
//! ```text
//!            complete                 arm                          tared
//!   Boot ---------------> Disarmed -----------------> Arming ----------------> Armed(Hold)
//!                          ^  ^  ^                      |                       |  ^   |  ^
//!                          |  |  +--- give up, disarm --+                 start |  |   |  |
//!                          |  |                                                 v  |   |  |
//!                          |  |  vented                        disarm   Armed(Track|  |  |
//!                          |  +---------- RampDown <-------------------    Identify)  |  |
//!                          |                 |                 stop, end ----------+  |  |
//!                          |                 |                                        |  |
//!                          |                 |       hold fault (from any Armed)      |  |
//!                          |                 |            +---------------------------+  |
//!                          |                 |            v          sample back in time |
//!                          |                 |        Faulting(hold) --------------------+
//!                          |                 |            | goes on
//!                          |     ramp fault  v            v
//!                          |   (from any Armed, too) Faulting(ramp) --- vent fault ---> Faulting(vent)
//!                          |                              | vented, or vent_failed         |
//!                          |           clear              v                                |
//!                          +------------------------- Faulted <----------------------------+
//!
//!   vent fault:  Armed, RampDown, Faulting(hold), Faulting(ramp) -> Faulting(vent)
//!   overpressure: Boot, Disarmed, Arming -> Faulting(vent)    not vented in time: RampDown -> Faulting(vent)
//!   emergency stop: from anywhere -> Faulted
//! ```
//!
//! | edge | when |
//! | --- | --- |
//! | *complete* | every device of every FREE gives readings |
//! | *arm* | requested, and nothing speaks against it: no fault but warnings, files unchanged, rights there |
//! | *give up* | a fault, or the conditions of arming not met within [`ARMING_TIME`]; the refusal names the first |
//! | *tared* | all vented, gyros calibrated, at rest, and every tare is the mean of enough readings |
//! | *start* | requested from Hold, with a program that fits the rig |
//! | *stop*, *end* | requested, or the program is over: the pressures hold |
//! | *disarm* | requested: the pressures go down within the ramp time |
//! | *hold fault* | a fault whose reaction is hold; the program is given up, pressures and integrators stand |
//! | *sample back in time* | its condition is gone before it asks for a ramp |
//! | *ramp fault*, *vent fault* | a fault with that reaction; it latches |
//! | *clear* | requested, no cause holds any more, the emergency stop is released, the rig is vented |
//!
//! Safe is the state at start: commands are zero in every state but Armed, RampDown, Faulting(hold) and
//! Faulting(ramp), and the dump valve is open in Faulting(vent) and Faulted.

use std::sync::Arc;
use std::time::Duration;

use crate::clock::Time;
use crate::signal::{FaultCode, FaultSet, MAX_FREES, Refusal, RefusalCode, State};
use crate::trajectory::Program;

use super::Request;
use super::fault::Reaction;
use super::interlocks::{Vented, Verdict};
use super::tare::TareMean;

/// Longest time for the checks of arming and the tare, s: a gyro needs some seconds of rest to calibrate.
pub const ARMING_TIME: f64 = 5.0;

/// A program under way.
#[derive(Clone, Debug)]
pub struct Run {
    /// What is asked.
    pub program: Arc<Program>,
    /// When it began.
    pub start: Time,
    /// Loss of the client's heartbeat stops it.
    pub attended: bool,
    /// It excites for identification.
    pub identify: bool,
}

impl Run {
    /// Time since the start, s.
    pub fn time(&self, now: Time) -> f64 {
        now.seconds_since(self.start)
    }
}

/// Pressures on their way to zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    /// When it began.
    pub start: Time,
    /// Commands at its beginning, Pa.
    pub from: [f64; MAX_FREES],
}

impl Ramp {
    /// Share of the first commands that is left, 1..=0.
    pub fn level(&self, now: Time, duration: Duration) -> f64 {
        let total = duration.as_secs_f64();
        let left = 1.0 - now.seconds_since(self.start) / total;
        if left > 0.0 { left.min(1.0) } else { 0.0 }
    }

    /// When it ends: at once if there is nothing to take down.
    fn end(&self, duration: Duration) -> Time {
        if self.from.iter().all(|&p| p <= 0.0) { self.start } else { self.start + duration }
    }
}

/// A vent under way or done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Venting {
    /// When it began, or when the pressure was last seen below p_zero.
    pub since: Time,
    /// The pressure has been seen below p_zero.
    pub verified: bool,
}

/// Checks and tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arming {
    /// When it began.
    pub since: Time,
    /// By FREE, readings so far.
    pub tare: [TareMean; MAX_FREES],
}

/// What an armed rig does.
#[derive(Clone, Debug)]
pub enum Mode {
    /// The pressures stand.
    Hold,
    /// A program runs.
    Run(Run),
}

/// A reaction under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Faulting {
    /// Pressures and integrators stand, waiting for the sample.
    Hold,
    /// The pressures go down.
    Ramp(Ramp, FaultSet),
    /// Zero, and the dump valve open.
    Vent(Venting, FaultSet),
}

/// Where the life cycle stands. What belongs to a state lives inside it.
#[derive(Clone, Debug)]
pub enum Phase {
    /// Before the first complete set of readings.
    Boot,
    /// Connected, not armed.
    Disarmed,
    /// Checks and tare.
    Arming(Arming),
    /// Armed.
    Armed(Mode),
    /// On the way to Disarmed.
    RampDown(Ramp),
    /// A fault's reaction is under way.
    Faulting(Faulting),
    /// Vented, the faults latched.
    Faulted(Venting, FaultSet),
}

/// What the life cycle looks at in one tick.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// Nominal time of the tick.
    pub now: Time,
    /// Longest time from a vent to p < p_zero.
    pub vent_time: Duration,
    /// Duration of a ramp.
    pub ramp_time: Duration,
    /// Whether a dump valve vents what cannot be reached.
    pub dump_valve: bool,
    /// What is asked.
    pub request: Option<&'a Request>,
    /// The emergency stop.
    pub estop: bool,
    /// The interlocks' verdict on the rig.
    pub verdict: Verdict,
    /// Every device has been heard of, and is still being heard.
    pub complete: bool,
    /// The least vented FREE.
    pub vented: Vented,
    /// What speaks against arming right away, apart from faults.
    pub against_arming: Option<Refusal>,
    /// What the checks of arming still wait for.
    pub waiting_for: Option<Refusal>,
    /// What speaks against the program that is to be started.
    pub against_program: Option<Refusal>,
    /// Commands of the tick before, Pa.
    pub commands: &'a [f64; MAX_FREES],
}

/// What a tick made of the life cycle.
#[derive(Clone, Debug)]
pub struct Step {
    /// Where it stands now.
    pub phase: Phase,
    /// What was refused.
    pub refusal: Refusal,
    /// A program that is not needed any more, for another thread to drop.
    pub retired: Option<Arc<Program>>,
}

impl Phase {
    /// The state, for the record.
    pub fn state(&self) -> State {
        match self {
            Phase::Boot => State::Boot,
            Phase::Disarmed => State::Disarmed,
            Phase::Arming(_) => State::Arming,
            Phase::Armed(Mode::Hold) => State::Hold,
            Phase::Armed(Mode::Run(run)) if run.identify => State::Identify,
            Phase::Armed(Mode::Run(_)) => State::Track,
            Phase::RampDown(_) => State::RampDown,
            Phase::Faulting(_) => State::Faulting,
            Phase::Faulted(..) => State::Faulted,
        }
    }

    /// The latched faults.
    pub fn latched(&self) -> FaultSet {
        match self {
            Phase::Faulting(Faulting::Ramp(_, latched) | Faulting::Vent(_, latched)) | Phase::Faulted(_, latched) => {
                *latched
            }
            _ => FaultSet::NONE,
        }
    }

    /// Whether the dump valve is to be open.
    pub fn vent(&self) -> bool {
        matches!(self, Phase::Faulting(Faulting::Vent(..)) | Phase::Faulted(..))
    }

    /// The program under way.
    pub fn run(&self) -> Option<&Run> {
        match self {
            Phase::Armed(Mode::Run(run)) => Some(run),
            _ => None,
        }
    }

    /// One tick: the edges of the diagram, the emergency stop first, then faults, then requests, then time.
    pub fn advance(self, sight: &Sight) -> Step {
        let state = self.state();
        let phase = self.latch(sight);
        let (phase, retired) = if sight.estop { phase.stopped(sight) } else { phase.react(sight) };
        // A reaction in this very tick leaves no room for a request; the end of a hold does.
        let free_to_act = (phase.state() == state || phase.state() == State::Hold) && !sight.estop;
        let mut step = Step { phase, refusal: Refusal::NONE, retired };
        if let Some(request) = sight.request {
            step = if free_to_act { step.ask(request, sight) } else { step.refuse(busy_with_fault(sight)) };
        }
        step.pass(sight)
    }

    /// Adds faults that came up while others are latched already.
    fn latch(mut self, sight: &Sight) -> Phase {
        if let Phase::Faulting(Faulting::Ramp(_, latched) | Faulting::Vent(_, latched)) | Phase::Faulted(_, latched) =
            &mut self
        {
            *latched = latched.union(sight.verdict.latching);
        }
        self
    }

    /// *emergency stop*: from anywhere.
    fn stopped(self, sight: &Sight) -> (Phase, Option<Arc<Program>>) {
        let mut latched = self.latched().union(sight.verdict.latching);
        latched.insert(FaultCode::EmergencyStop);
        match self {
            Phase::Faulted(venting, _) => (Phase::Faulted(venting, latched), None),
            Phase::Faulting(Faulting::Vent(venting, _)) => (Phase::Faulted(venting, latched), None),
            other => (Phase::Faulted(Venting { since: sight.now, verified: false }, latched), other.program()),
        }
    }

    /// The edges that faults open.
    fn react(self, sight: &Sight) -> (Phase, Option<Arc<Program>>) {
        let Verdict { reaction, latching, .. } = sight.verdict;
        let vent = || Faulting::Vent(Venting { since: sight.now, verified: false }, latching);
        let ramp = Ramp { start: sight.now, from: *sight.commands };
        let overpressure =
            latching.contains(FaultCode::OverpressureHard) || latching.contains(FaultCode::OverpressureSoft);
        match (self, reaction) {
            (Phase::Boot | Phase::Disarmed | Phase::Arming(_), _) if overpressure => (Phase::Faulting(vent()), None),
            (armed @ Phase::Armed(_), Reaction::Vent) => (Phase::Faulting(vent()), armed.program()),
            (armed @ Phase::Armed(_), Reaction::Ramp) => {
                (Phase::Faulting(Faulting::Ramp(ramp, latching)), armed.program())
            }
            (armed @ Phase::Armed(_), Reaction::Hold) => (Phase::Faulting(Faulting::Hold), armed.program()),
            (Phase::RampDown(_) | Phase::Faulting(Faulting::Hold), Reaction::Vent) => (Phase::Faulting(vent()), None),
            (Phase::RampDown(ramp), Reaction::Ramp) => (Phase::Faulting(Faulting::Ramp(ramp, latching)), None),
            (Phase::Faulting(Faulting::Hold), Reaction::Ramp) => {
                (Phase::Faulting(Faulting::Ramp(ramp, latching)), None)
            }
            (Phase::Faulting(Faulting::Hold), Reaction::None | Reaction::Warn) => (Phase::Armed(Mode::Hold), None),
            (Phase::Faulting(Faulting::Ramp(_, latched)), Reaction::Vent) => {
                let venting = Venting { since: sight.now, verified: false };
                (Phase::Faulting(Faulting::Vent(venting, latched)), None)
            }
            (phase, _) => (phase, None),
        }
    }

    /// The program inside, on leaving.
    fn program(self) -> Option<Arc<Program>> {
        match self {
            Phase::Armed(Mode::Run(run)) => Some(run.program),
            _ => None,
        }
    }
}

impl Step {
    fn refuse(mut self, refusal: Refusal) -> Step {
        self.refusal = refusal;
        self
    }

    fn to(mut self, phase: Phase) -> Step {
        let left = std::mem::replace(&mut self.phase, phase);
        self.retired = self.retired.or(left.program());
        self
    }

    /// The edges that requests open.
    fn ask(self, request: &Request, sight: &Sight) -> Step {
        let wrong = rig(RefusalCode::WrongState);
        match (request, &self.phase) {
            (Request::Gains { .. }, _) => self,
            (Request::Arm, Phase::Boot) => self.refuse(sight.waiting_for.unwrap_or(wrong)),
            (Request::Arm, Phase::Disarmed) => match sight.against_arming.or(blocking(&sight.verdict)) {
                Some(refusal) => self.refuse(refusal),
                None => self.to(Phase::Arming(Arming { since: sight.now, tare: Default::default() })),
            },
            (Request::Disarm, Phase::Boot | Phase::Disarmed | Phase::RampDown(_)) => self,
            (Request::Disarm, Phase::Arming(_)) => self.to(Phase::Disarmed),
            (Request::Disarm, Phase::Armed(_) | Phase::Faulting(Faulting::Hold)) => {
                self.to(Phase::RampDown(Ramp { start: sight.now, from: *sight.commands }))
            }
            (Request::Start { program, attended, identify }, Phase::Armed(Mode::Hold)) => match sight.against_program {
                Some(refusal) => self.refuse(refusal),
                None => {
                    let run =
                        Run { program: program.clone(), start: sight.now, attended: *attended, identify: *identify };
                    self.to(Phase::Armed(Mode::Run(run)))
                }
            },
            (Request::Stop, Phase::Armed(_)) => self.to(Phase::Armed(Mode::Hold)),
            (Request::Clear, Phase::Faulted(..)) => match against_clearing(sight) {
                Some(refusal) => self.refuse(refusal),
                None => self.to(Phase::Disarmed),
            },
            _ => self.refuse(wrong),
        }
    }

    /// The edges that time and readings open.
    fn pass(mut self, sight: &Sight) -> Step {
        let now = sight.now;
        let unvented = match sight.vented {
            Vented::Yes => false,
            Vented::No => true,
            // A dump valve vents what cannot be measured any more.
            Vented::Unknown => !sight.dump_valve,
        };
        let late = |since: Time| now.since(since) >= sight.vent_time;
        match &mut self.phase {
            Phase::Boot if sight.complete => self.phase = Phase::Disarmed,
            Phase::Arming(arming) => {
                if let Some(refusal) = blocking(&sight.verdict) {
                    return self.to(Phase::Disarmed).refuse(refusal);
                }
                match sight.waiting_for {
                    // The readings of this tick are the first that a new arming sees.
                    _ if arming.since == now => {}
                    None => self.phase = Phase::Armed(Mode::Hold),
                    Some(refusal) if now.seconds_since(arming.since) >= ARMING_TIME => {
                        return self.to(Phase::Disarmed).refuse(refusal);
                    }
                    Some(_) => {}
                }
            }
            Phase::Armed(Mode::Run(run)) if run.time(now) >= run.program.duration => {
                return self.to(Phase::Armed(Mode::Hold));
            }
            Phase::RampDown(ramp) => {
                let end = ramp.end(sight.ramp_time);
                let down = sight.commands.iter().all(|&p| p <= 0.0);
                if now >= end && down && sight.vented == Vented::Yes {
                    self.phase = Phase::Disarmed;
                } else if now >= end && late(end) {
                    let venting = Venting { since: now, verified: false };
                    self.phase = Phase::Faulting(Faulting::Vent(venting, only(FaultCode::VentFailed)));
                }
            }
            Phase::Faulting(Faulting::Ramp(ramp, latched)) => {
                let end = ramp.end(sight.ramp_time);
                let verified = sight.vented == Vented::Yes;
                if now >= end && (verified || late(end)) {
                    if unvented {
                        latched.insert(FaultCode::VentFailed);
                    }
                    self.phase = Phase::Faulted(Venting { since: now, verified }, *latched);
                }
            }
            // A vent shows for one tick at least, even of a FREE that is empty already.
            Phase::Faulting(Faulting::Vent(venting, latched)) if venting.since != now => {
                let verified = sight.vented == Vented::Yes;
                if verified || late(venting.since) {
                    if unvented {
                        latched.insert(FaultCode::VentFailed);
                    }
                    self.phase = Phase::Faulted(Venting { since: now, verified }, *latched);
                }
            }
            Phase::Faulted(venting, latched) => match sight.vented {
                Vented::Yes => *venting = Venting { since: now, verified: true },
                Vented::Unknown if venting.verified => {}
                _ if unvented && late(venting.since) => latched.insert(FaultCode::VentFailed),
                _ => {}
            },
            _ => {}
        }
        self
    }
}

fn rig(code: RefusalCode) -> Refusal {
    Refusal { code, ..Refusal::NONE }
}

fn only(code: FaultCode) -> FaultSet {
    let mut set = FaultSet::NONE;
    set.insert(code);
    set
}

/// The fault that stands against arming: any whose reaction is more than a warning.
fn blocking(verdict: &Verdict) -> Option<Refusal> {
    (verdict.reaction >= Reaction::Hold).then(|| fault_present(verdict.blocking.iter().next()))
}

fn fault_present(fault: Option<FaultCode>) -> Refusal {
    Refusal { code: RefusalCode::FaultPresent, free: Refusal::RIG, fault }
}

fn busy_with_fault(sight: &Sight) -> Refusal {
    if sight.estop { rig(RefusalCode::EmergencyStop) } else { fault_present(sight.verdict.blocking.iter().next()) }
}

fn against_clearing(sight: &Sight) -> Option<Refusal> {
    if let Some(fault) = sight.verdict.latching.iter().next() {
        return Some(fault_present(Some(fault)));
    }
    match sight.vented {
        Vented::Yes => None,
        Vented::No => Some(rig(RefusalCode::NotVented)),
        Vented::Unknown => Some(rig(RefusalCode::NoPressure)),
    }
}

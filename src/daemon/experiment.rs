//! Experiments on an armed rig, live or stepped: record, start, watch, finish, take the pressures down again.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::cycles::Counter;
use super::error::DaemonError;
use super::follow::{self, Follower, Guide};
use super::procedure::{LOOK, Refusals, refused};
use super::{Bench, Change, PoseDesk, margin};
use crate::config::experiment::{Experiment, Kind};
use crate::config::{Rig, SourceFile, Whisk};
use crate::control::{Gains, Request};
use crate::record::{
    Backend, LiveFeed, ModuleDocument, Quota, RealtimeDocument, RecordOptions, Recorder, Repetition, Run, RunKind,
    RunResult, StartDocument, StopDocument, TubeDocument, WhiskDocument, sha256, write_report,
};
use crate::signal::{FaultCode, FaultSet, FreeTick, Quantity, RequestKind, State, TickRecord, Trim};
use crate::sim::Hand;
use crate::trajectory::{Axis, Program, Segment, Sequence, Shape};

/// Beyond the ramp and vent times, how long a fault's reaction is recorded.
const AFTERMATH: Duration = Duration::from_secs(3);
/// Records of a batch, at least: its cost hardly depends on what is in it, and a slow loop often has a slow processor.
const FEWEST: u32 = 25;
/// After the way back to zero pressure, how long the FREEs are given to come to rest, s.
const REST: f64 = 1.0;

/// Whose presence the experiment depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attendance {
    /// Nobody's (`--detach`).
    Detached,
    /// The procedure's own: it runs where the client runs.
    Here,
    /// A client's, who is heard over the control socket.
    Remote,
}

/// What to run.
#[derive(Clone, Debug)]
pub struct Job {
    /// Kind of experiment.
    pub kind: RunKind,
    /// What a person calls it.
    pub title: String,
    /// Index of the FREE it is about.
    pub subject: usize,
    /// What is asked of every FREE.
    pub program: Arc<Program>,
    /// Other gains for the subject than the rig's, with their name.
    pub gains: Option<(String, Gains)>,
    /// The user's note.
    pub note: String,
    /// How many times, at least once.
    pub repeats: u32,
    /// Whose presence it depends on.
    pub attendance: Attendance,
    /// Gains with a margin below the stated one have been accepted.
    pub accept_margin: bool,
    /// What a person does to the subject meanwhile, for identification; on the simulated bench its hand.
    pub hand: Option<Hand>,
    /// On the stepped clock.
    pub stepped: bool,
    /// The plan of a whisk.
    pub whisk: Option<Whisk>,
    /// Run the plan of a whisk as it stands, even where it could be followed in closed loop.
    pub open_loop: bool,
    /// Where an external tracker's poses of the plate come in.
    pub poses: Arc<PoseDesk>,
    /// Take the pressures down after each run; by hand they stay.
    pub and_back: bool,
    /// Where the live view is fed, if it is to show the runs.
    pub live: Option<LiveFeed>,
    /// Set by whoever stops the job: no further program is started. The one under way is the stopper's to end.
    pub stop: Arc<AtomicBool>,
}

impl Job {
    /// The job of an experiment.
    pub fn new(experiment: Experiment, attendance: Attendance) -> Self {
        let kind = match experiment.kind {
            Kind::Step => RunKind::Step,
            Kind::Trajectory => RunKind::Trajectory,
            Kind::Sweep => RunKind::Sweep,
            Kind::Whisk => RunKind::Whisk,
        };
        Self {
            kind,
            title: experiment.name,
            subject: experiment.subject,
            program: Arc::new(experiment.program),
            gains: experiment.gains,
            note: experiment.note,
            repeats: experiment.repeat.max(1),
            attendance,
            accept_margin: false,
            hand: None,
            stepped: false,
            whisk: experiment.whisk,
            open_loop: false,
            poses: Arc::default(),
            and_back: true,
            live: None,
            stop: Arc::default(),
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }
}

/// What a job is doing.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// In a few words.
    pub phase: &'static str,
    /// Id and folder of the run under way.
    pub run: (&'a str, &'a Path),
    /// Which repetition, from 1.
    pub repeat: u32,
    /// Time since the program's start, s; of the report, how much of the program it has gone through.
    pub elapsed: f64,
    /// Duration of the program, s; zero where none is under way.
    pub duration: f64,
    /// The latest record.
    pub record: &'a TickRecord,
}

/// Runs `job` on an armed `bench` as often as it says; returns its runs. A run that a fault, a refusal or the user
/// ended is the last, and stands in the list with its result.
///
/// # Errors
/// Where the gains have no margin, or the record cannot be written.
pub fn run<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    job: &Job,
    watch: &mut dyn FnMut(&Progress<'_>),
) -> Result<Vec<Run>, DaemonError> {
    let own = rig.control.frees.get(job.subject).map(|f| f.gains);
    if let Some((_, gains)) = job.gains {
        if !job.accept_margin {
            margin::check_gains(&rig.control, job.subject, gains)?;
        }
        bench.request(Request::Gains { free: job.subject, gains })?;
    }
    let runs = repeat(bench, rig, job, watch);
    // However it ended, the next one begins with the rig's own gains.
    if let (Some(gains), Some(_)) = (own, &job.gains) {
        bench.request(Request::Gains { free: job.subject, gains })?;
    }
    runs
}

fn repeat<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    job: &Job,
    watch: &mut dyn FnMut(&Progress<'_>),
) -> Result<Vec<Run>, DaemonError> {
    let family = follow::family(rig, job)?;
    let guide = family.as_ref().map(|family| Guide::new(rig, job, family)).transpose()?;
    let mut runs: Vec<Run> = Vec::new();
    let mut cycles = Counter::new(rig);
    for repeat in 1..=job.repeats {
        let repetition = (job.repeats > 1).then(|| Repetition {
            group: runs.first().map(|r| r.id().to_owned()).unwrap_or_default(),
            index: repeat,
            of: job.repeats,
        });
        let run = once(bench, rig, job, guide.as_ref(), (repeat, repetition), &mut cycles, watch)?;
        let done = run.stop().is_some_and(|s| s.result == RunResult::Done);
        runs.push(run);
        if !done || job.is_stopped() {
            break;
        }
    }
    // The reports of the earlier ones know nothing yet of the later ones, and show their scatter.
    if let [earlier @ .., _] = runs.as_slice() {
        earlier.iter().for_each(|run| report(run, &mut |_| {}));
    }
    Ok(runs)
}

/// Makes the report of `run`. The run itself is safe on the disk; without a report it still is a run.
fn report(run: &Run, watch: &mut dyn FnMut(f64)) {
    if let Err(error) = write_report(run, watch) {
        tracing::warn!(%error, run = run.id(), "the report could not be made");
    }
}

fn once<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    job: &Job,
    guide: Option<&Guide<'_>>,
    (repeat, repetition): (u32, Option<Repetition>),
    cycles: &mut Counter,
    watch: &mut dyn FnMut(&Progress<'_>),
) -> Result<Run, DaemonError> {
    let mut options = RecordOptions { truth: rig.is_simulated(), live: job.live.clone(), ..RecordOptions::default() };
    options.batch = options.batch.max(FEWEST * rig.control.period);
    let quota = Quota { most: rig.record.most, free: rig.record.free };
    for removed in quota.make_room(&rig.record.directory)? {
        tracing::info!(run = removed, "removed, the oldest: the runs take more than [record] runs_mib allows");
    }
    let recorder = Recorder::create(&rig.record.directory, document(bench, rig, job, repetition), options)?;
    let (id, folder) = (recorder.id().to_owned(), recorder.folder().to_owned());
    let mut follower = guide.map(|guide| Follower::new(rig, job, guide, &folder)).transpose()?;
    let mut at = |phase, elapsed, duration, record: &TickRecord| {
        watch(&Progress { phase, run: (&id, &folder), repeat, elapsed, duration, record });
    };
    let mut tell = |phase, duration, record: &TickRecord| {
        let elapsed = if record.program_time.is_finite() { record.program_time } else { 0.0 };
        at(phase, elapsed, duration, record);
    };
    let lost_before = bench.with_pump(|p| p.lost_records());
    bench.attach(recorder);
    // A replay goes on after a record in which nothing runs.
    let result = bench.pass(LOOK).and_then(|()| {
        if let Some(hand) = &job.hand {
            bench.pluck(job.subject, hand, Duration::try_from_secs_f64(job.program.duration).unwrap_or_default());
        }
        let driven = Driven { program: &job.program, attendance: job.attendance, identify: job.hand.is_some() };
        drive(bench, rig, &driven, follower.as_mut(), &mut |record| {
            cycles.see(record);
            tell("running", job.program.duration, record);
        })
    });
    drop(follower);
    cycles.flush();
    let recorder = bench.detach();
    let lost_records = bench.with_pump(|p| p.lost_records()) - lost_before;
    let (result, message) = match &result {
        Ok(RunResult::Done) => (RunResult::Done, String::new()),
        Ok(result) => (*result, "stopped before its end".into()),
        // Who ends the program takes the pressures away by the emergency stop.
        Err(DaemonError::Fault(faults)) if job.is_stopped() && *faults == FaultSet::only(FaultCode::EmergencyStop) => {
            (RunResult::Aborted, "stopped before its end".into())
        }
        Err(error) => {
            let result = if error.is_rig_fault() { RunResult::Fault } else { RunResult::Failed };
            (result, format!("{error}. {}", error.remedy()))
        }
    };
    let taken = || DaemonError::Unfit("another procedure took the recording away".into());
    let stop = StopDocument { result, message, lost_records, ..StopDocument::default() };
    let run = recorder.and_then(|r| r.ok_or_else(taken)).and_then(|recorder| Ok(recorder.finish(stop)?));
    // What cannot be recorded is over as well.
    let over = result == RunResult::Done || (run.is_err() && bench.latest().state == State::Hold);
    let back = if over && job.and_back && !job.is_stopped() {
        back_to_zero(&bench.latest(), rig).and_then(|back| {
            let back = Arc::new(back);
            let driven = Driven { program: &back, attendance: job.attendance, identify: false };
            drive(bench, rig, &driven, None, &mut |record| {
                cycles.see(record);
                tell("taking the pressures down", back.duration, record);
            })
        })
    } else {
        Ok(result)
    };
    let run = run?;
    back?;
    let (latest, duration) = (bench.latest(), job.program.duration);
    report(&run, &mut |share| at("writing the report", share * duration, duration, &latest));
    Ok(run)
}

/// A program on its way.
struct Driven<'a> {
    program: &'a Arc<Program>,
    attendance: Attendance,
    identify: bool,
}

/// Starts a program, to identify something or not, and watches it to its end: its own, or that of the recording, for
/// nothing goes on that leaves no trace. `follower` leads a module's plate meanwhile.
fn drive<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    driven: &Driven<'_>,
    follower: Option<&mut Follower<'_>>,
    watch: &mut dyn FnMut(&TickRecord),
) -> Result<RunResult, DaemonError> {
    let ended = attend(bench, rig, driven, follower, watch);
    // Nothing of this program's is added to the next one's.
    bench.trim(Trim::default());
    ended
}

fn attend<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    &Driven { program, attendance, identify }: &Driven<'_>,
    mut follower: Option<&mut Follower<'_>>,
    watch: &mut dyn FnMut(&TickRecord),
) -> Result<RunResult, DaemonError> {
    let attended = attendance != Attendance::Detached;
    let mut refusals = Refusals::of(bench, RequestKind::Start);
    let mut heard = bench.with_pump(|p| p.changes_so_far());
    if attendance == Attendance::Here {
        bench.heartbeat();
    }
    bench.request(Request::Start { program: Arc::clone(program), attended, identify })?;
    let mut ended = None;
    let mut given_up = false;
    loop {
        bench.pass(LOOK)?;
        if attendance == Attendance::Here {
            bench.heartbeat();
        }
        if let Some(refusal) = refusals.next(bench) {
            return Err(refused(refusal, rig));
        }
        let latest = bench.latest();
        if let Some(trim) = follower.as_mut().and_then(|follower| follower.turn(&latest)) {
            bench.trim(trim);
        }
        watch(&latest);
        if !given_up && bench.with_pump(|p| p.recording_failed()) && latest.state.is_armed() {
            bench.request(Request::Stop)?;
            given_up = true;
        }
        ended = ended.or(bench.with_pump(|p| p.changes(&mut heard).find_map(end_of_program)));
        match (ended, latest.state) {
            (Some(RunResult::Done), _) => return Ok(RunResult::Done),
            (_, State::Faulting) if latest.latched.is_empty() => {}
            (_, State::Faulting | State::Faulted) => return Err(aftermath(bench, rig, latest.latched)?),
            (Some(result), _) => return Ok(result),
            (None, _) => {}
        }
    }
}

/// How the program has ended, if this change is its end. The tick's own record of it tells, and not where the program
/// was when this thread last came to look: on a loaded machine that may be long before.
fn end_of_program((record, change): (TickRecord, Change)) -> Option<RunResult> {
    match change {
        Change::State { from: State::Track | State::Identify, to: State::Hold }
            if record.request != RequestKind::Stop =>
        {
            Some(RunResult::Done)
        }
        Change::State { from: State::Track | State::Identify, .. } => Some(RunResult::Aborted),
        _ => None,
    }
}

/// Lets the reaction to a latched fault run to its end.
fn aftermath<B: Bench>(bench: &mut B, rig: &Rig, latched: FaultSet) -> Result<DaemonError, DaemonError> {
    let end = bench.now() + rig.control.ramp_time + rig.control.vent_time + AFTERMATH;
    while bench.latest().state == State::Faulting && bench.now() < end {
        bench.pass(LOOK)?;
    }
    Ok(DaemonError::Fault(latched.union(bench.latest().latched)))
}

/// From the present commands to zero within the ramp time, and a rest.
fn back_to_zero(record: &TickRecord, rig: &Rig) -> Result<Program, DaemonError> {
    let ramp = rig.control.ramp_time.as_secs_f64();
    let axis = |(free, tick): (usize, &FreeTick)| {
        pressure_axis(&[(ramp, tick.command, 0.0), (REST, 0.0, 0.0)]).map(|axis| (free, axis))
    };
    let axes: Vec<_> = record.frees().iter().enumerate().map(axis).collect::<Result<_, _>>()?;
    Program::new(axes).map_err(|e| DaemonError::Unfit(e.to_string()))
}

/// A pressure axis of linear pieces: (duration in s, from and to in Pa).
pub(super) fn pressure_axis(pieces: &[(f64, f64, f64)]) -> Result<Axis, DaemonError> {
    let segment = |&(duration, from, to): &(f64, f64, f64)| Segment { duration, from, to, shape: Shape::Linear };
    let segments: Vec<_> = pieces.iter().map(segment).collect();
    let sequence = Sequence::new(segments).map_err(|e| DaemonError::Unfit(e.to_string()))?;
    Ok(Axis { quantity: Quantity::Pressure, sequence })
}

fn document<B: Bench>(bench: &mut B, rig: &Rig, job: &Job, repetition: Option<Repetition>) -> StartDocument {
    let mut start = StartDocument::new(job.kind, &rig.control);
    start.title = job.title.clone();
    start.note = job.note.clone();
    start.subject = rig.control.frees.get(job.subject).map(|f| f.name.clone()).unwrap_or_default();
    start.backend = if rig.is_simulated() { Backend::Sim } else { Backend::Linux };
    start.stepped = job.stepped;
    start.seed = rig.is_simulated().then_some(rig.bench.seed);
    start.repetition = repetition;
    start.program = Some((*job.program).clone());
    start.whisk = job.whisk.as_ref().map(|whisk| WhiskDocument::of(whisk, follow::path(rig, job).is_some()));
    start.module = ModuleDocument::of(rig);
    start.rig_sha256 = rig.files.first().map(|f| sha256(f.text.as_bytes())).unwrap_or_default();
    start.realtime = RealtimeDocument {
        granted: bench.latest().realtime && !job.stepped,
        detail: if job.stepped { "stepped clock".into() } else { String::new() },
    };
    for (index, free) in start.frees.iter_mut().enumerate() {
        free.temperatures = rig.temperatures(index).map(Into::into);
    }
    for ((free, control), calibration) in start.frees.iter_mut().zip(&rig.control.frees).zip(&rig.calibrations) {
        let name = calibration.gain_names().find(|name| calibration.gains(name) == Some(control.gains));
        free.preset = name.unwrap_or_default().to_owned();
        free.calibration_sha256 = rig.calibration_file(calibration).map(SourceFile::sha256).unwrap_or_default();
        free.hysteresis = calibration.hysteresis.map(Into::into);
        free.tube = TubeDocument::of(&calibration.tube().0);
    }
    if let (Some((name, gains)), Some(free)) = (&job.gains, start.frees.get_mut(job.subject)) {
        free.preset = name.clone();
        free.gains = (*gains).into();
    }
    start
}

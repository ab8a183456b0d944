//! The supervisor: owns the running rig, answers what the socket asks, tells what happens, and ends it safely.
//!
//! It looks at the rig every [`LOOK`] and never waits for anything: what takes its time (arming, clearing, a run)
//! is [`Work`] in a thread of its own, one at a time, and whoever asks for more meanwhile is told so. Stopping and
//! disarming need no turn; the emergency stop does not even need the supervisor.

mod requests;

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval, timeout};

use super::api::{self, Event, Happening, Problem, ProblemKind, Response};
use super::news::News;
use super::status::status;
use super::work::{Answer, Report, Work};
use super::{Bench, DaemonError, Desk, Live, LiveBench, Switches, cycles, is_free_vented, names, notify};
use crate::clock::Time;
use crate::config::Rig;
use crate::record::LiveView;
use crate::signal::{State, TickRecord};
use crate::units::Pressure;

/// How often the supervisor looks at the rig.
const LOOK: Duration = Duration::from_millis(50);
/// How often the status is published where nothing happens.
const STATUS_PERIOD: Duration = Duration::from_millis(100);
/// How often the configuration files are compared with what was loaded.
const FILES_PERIOD: Duration = Duration::from_secs(1);
/// How often the counted pressure cycles are read again.
const CYCLES_PERIOD: Duration = Duration::from_secs(2);
/// Beyond the vent time, how long a stop waits for the pressures and for the record's end.
const LEAVING: Duration = Duration::from_secs(10);

/// Why the supervisor no longer serves the rig as it was loaded.
enum End {
    /// It is to stop, or its loop has ended.
    Stop(Result<(), DaemonError>),
    /// The calibrations have changed: serve `rig`, and then arm.
    Renewal {
        /// The rig with the new ones.
        rig: Box<Rig>,
        /// What was asked.
        arm: api::Arm,
        /// Who waits for it.
        answer: Answer,
    },
}

/// The supervisor of one rig.
pub struct Supervisor {
    rig: Arc<Rig>,
    live: Live,
    bench: LiveBench,
    view: Option<LiveView>,
    desk: Desk,
    begun: Time,
    published: Time,
    news: News,
    work: Option<Work>,
    run: Option<api::Run>,
    reports: mpsc::UnboundedSender<Report>,
    reported: mpsc::UnboundedReceiver<Report>,
    /// What systemd was told last.
    told: String,
    /// Records lost so far.
    lost: u64,
    /// By FREE: its pressure cycles, and when they were read.
    cycles: (Vec<u64>, Time),
}

impl Supervisor {
    /// Starts the rig, disarmed and vented; `view` shows its runs.
    ///
    /// # Errors
    /// As [`Live::start`].
    pub fn start(rig: Rig, desk: Desk, view: Option<LiveView>) -> Result<Self, DaemonError> {
        let switches =
            Switches { estop: Arc::clone(&desk.estop), heartbeat: Arc::clone(&desk.heartbeat), ..Switches::default() };
        let live = Live::start(&rig, switches)?;
        let bench = live.bench();
        let (reports, reported) = mpsc::unbounded_channel();
        let begun = bench.now();
        Ok(Self {
            cycles: (cycles::counted(&rig), begun),
            rig: Arc::new(rig),
            live,
            bench,
            view,
            desk,
            begun,
            published: Time::ZERO,
            news: News::new(),
            work: None,
            run: None,
            reports,
            reported,
            told: String::new(),
            lost: 0,
        })
    }

    /// The running rig.
    pub fn live(&self) -> &Live {
        &self.live
    }

    /// Serves until `stop`, then stops what runs, commands zero, verifies the vent, and releases the devices.
    ///
    /// # Errors
    /// [`DaemonError::NotVented`], or the loop's own end.
    pub async fn serve(mut self, stop: impl Future<Output = ()>) -> Result<(), DaemonError> {
        let mut stop = std::pin::pin!(stop);
        let ended = loop {
            match self.watch(stop.as_mut()).await {
                End::Stop(ended) => break ended,
                End::Renewal { rig, arm, answer } => {
                    self = self.renewed(*rig).await?;
                    self.take(api::Request::Arm(arm), answer);
                }
            }
        };
        notify::stopping();
        self.leave().await.and(ended)
    }

    /// Serves until there is a reason not to.
    async fn watch(&mut self, mut stop: Pin<&mut impl Future<Output = ()>>) -> End {
        let files = watch_files(Arc::clone(&self.rig), self.live.switches());
        let _watchdog = notify::Watchdog::start(self.live.statistics());
        let mut look = interval(LOOK);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let end = loop {
            tokio::select! {
                biased;
                () = &mut stop => break End::Stop(Ok(())),
                Some((request, answer)) = self.desk.requests.recv() => match request {
                    api::Request::Arm(arm) => match self.renewal() {
                        Ok(None) => self.take(api::Request::Arm(arm), answer),
                        Ok(Some(rig)) => break End::Renewal { rig: Box::new(rig), arm, answer },
                        Err(problem) => {
                            // Whoever asked may be gone.
                            let _ = answer.send(Err(problem));
                        }
                    },
                    request => self.take(request, answer),
                },
                Some(report) = self.reported.recv() => self.hear(report),
                _ = look.tick() => {
                    self.turn();
                    if !self.live.is_running() {
                        break End::Stop(Err(DaemonError::LoopEnded("its thread is gone".into())));
                    }
                }
            }
        };
        files.abort();
        end
    }

    /// The rig with the calibrations as they are now, where they differ from what was loaded and nothing else does:
    /// a calibration that has just been measured is to be used, a changed rig.toml is to be noticed.
    fn renewal(&mut self) -> Result<Option<Rig>, Problem> {
        let idle = self.work.is_none() && self.bench.latest().state == State::Disarmed;
        let description = self.rig.files.first().filter(|file| idle && !file.has_changed());
        match description {
            Some(file) if !self.rig.changed_files().is_empty() => Rig::load(&file.path).map(Some).map_err(|error| {
                let remedy = "correct the calibration, or put the old one back; then arm again";
                Problem::new(ProblemKind::Usage, error.to_string(), remedy)
            }),
            _ => Ok(None),
        }
    }

    /// The rig, disarmed and vented as it is, stopped and started again as `rig`.
    async fn renewed(self, rig: Rig) -> Result<Self, DaemonError> {
        tracing::info!("taking up the changed calibration");
        let Self { live, desk, view, begun, .. } = self;
        let start = move || {
            // The loop ends first; the bus owners then command zero and open the dump valve.
            drop(live);
            Self::start(rig, desk, view)
        };
        let started = tokio::task::spawn_blocking(start).await;
        let started = started.unwrap_or_else(|panic| Err(DaemonError::LoopEnded(panic.to_string())))?;
        Ok(Self { begun, ..started })
    }

    /// One look at the rig.
    fn turn(&mut self) {
        let quiet = !self.listen();
        if self.work.as_ref().is_some_and(Work::is_over) && self.reported.is_empty() {
            self.ended(Err(DaemonError::Interrupted("the daemon's own thread has failed")));
        }
        if !quiet || self.bench.now().since(self.published) >= STATUS_PERIOD {
            self.publish();
        }
    }

    /// Tells what the loop has done since the last time; whether there was anything.
    fn listen(&mut self) -> bool {
        let happenings = self.news.turn(&mut self.bench, &self.rig);
        let lost = self.bench.with_pump(|p| p.lost_records());
        if lost > self.lost {
            let text = format!("{} records were lost: the recorder could not keep up", lost - self.lost);
            let remedy = "the run says so in its stop document; find out what keeps the disk or the processor busy";
            self.tell(Happening::Warning { text, remedy: remedy.into() });
            self.lost = lost;
        }
        let any = !happenings.is_empty();
        for what in happenings {
            self.tell(what);
        }
        any
    }

    fn publish(&mut self) {
        let record = self.bench.latest();
        let mut status = status(&self.rig, &self.live, &record);
        status.uptime_s = self.bench.now().seconds_since(self.begun);
        status.faults = self.news.faults(&self.rig);
        status.run = self.run.clone();
        if self.bench.now().since(self.cycles.1) >= CYCLES_PERIOD {
            self.cycles = (cycles::counted(&self.rig), self.bench.now());
        }
        for (free, count) in status.frees.iter_mut().zip(&self.cycles.0) {
            free.pressure_cycles = Some(*count);
        }
        status.live_view = self.view.as_ref().map(LiveView::url);
        self.published = self.bench.now();
        let told = self.in_a_line(&record);
        if told != self.told {
            notify::status(&told);
            self.told = told;
        }
        self.desk.status.send_replace(status);
    }

    /// What `systemctl status` shows.
    fn in_a_line(&self, record: &TickRecord) -> String {
        let mut line = String::from(if self.rig.is_simulated() { "SIMULATED, " } else { "" });
        line += record.state.name();
        if !record.latched.is_empty() {
            line += &format!(": {}", names(record.latched));
        }
        if let Some(run) = &self.run {
            line += &format!(", {} ({})", run.id, run.phase);
        }
        line
    }

    /// Logs what happened and sends it to whoever listens.
    fn tell(&self, what: Happening) {
        match &what {
            Happening::State { from, to } => tracing::info!(state = to, "{from} -> {to}"),
            Happening::Fault(f) if !f.active && !f.latched => {
                tracing::info!(fault = f.name, free = f.free, "{}: no longer", f.name)
            }
            Happening::Fault(f) => {
                let about = f.free.as_ref().map(|free| format!(" ({free})")).unwrap_or_default();
                match f.latched {
                    true => {
                        tracing::error!(fault = f.name, free = f.free, "fault {}{about}, latched: {}", f.name, f.remedy)
                    }
                    false => tracing::warn!(fault = f.name, free = f.free, "{}{about}: {}", f.name, f.remedy),
                }
            }
            Happening::RunStarted(run) => tracing::info!(run = run.id, "run {} has begun: {}", run.id, run.name),
            Happening::RunFinished(run) => {
                tracing::info!(
                    run = run.id,
                    outcome = run.outcome,
                    "run {}: {}{}",
                    run.id,
                    run.outcome,
                    run.reason.as_ref().map_or(String::new(), |r| format!(": {r}"))
                );
            }
            Happening::Warning { text, remedy } => tracing::warn!("{text}: {remedy}"),
            Happening::Missed { .. } => {}
        }
        // Nobody listening is no error.
        let _ = self.desk.events.send(Event::now(what));
    }

    /// What work reports.
    fn hear(&mut self, report: Report) {
        self.listen();
        match report {
            Report::Running(run) => {
                let news = self.run.as_ref().is_none_or(|before| before.id != run.id);
                let phase = self.run.as_ref().is_none_or(|before| before.phase != run.phase);
                self.run = Some(run.clone());
                // Published before it is answered, so that the client's first heartbeat finds it.
                if phase || news {
                    self.publish();
                }
                if news {
                    self.tell(Happening::RunStarted(run.clone()));
                }
                if let Some(answer) = self.work.as_mut().and_then(|work| work.answer.take()) {
                    let message = format!("{} has begun", run.id);
                    let _ = answer.send(Ok(Response { run: Some(run), ..Response::done(message) }));
                }
            }
            Report::Finished(result) => self.tell(Happening::RunFinished(result)),
            Report::Ended(ended) => self.ended(ended),
            Report::Disarmed(done, answer) => {
                self.publish();
                let done = done.map(|()| Response::done("disarmed; the pressures are down"));
                let _ = answer.send(done.map_err(|error| Problem::from(&error)));
            }
        }
    }

    fn ended(&mut self, ended: Result<String, DaemonError>) {
        self.run = None;
        if let (Err(error), Some(work)) = (&ended, &self.work) {
            tracing::warn!("{}: {error}", work.what);
        }
        let ended = ended.map(Response::done).map_err(|error| Problem::from(&error));
        self.publish();
        if let Some(answer) = self.work.take().and_then(|work| work.answer) {
            // A client that did not wait for it can look at the status.
            let _ = answer.send(ended);
        }
    }

    /// Stops what runs, commands zero at once, verifies, releases.
    async fn leave(mut self) -> Result<(), DaemonError> {
        if let Some(work) = &self.work {
            work.stop();
        }
        // The loop's own way to zero that needs nobody's turn.
        self.desk.estop.store(true, Ordering::Release);
        tracing::info!("stopping: pressures to zero, then the vent is verified");
        self.answer_the_rest();
        if let Some(work) = self.work.take() {
            let patience = self.rig.control.vent_time + LEAVING;
            if timeout(patience, work.over()).await.is_err() {
                tracing::warn!("the run's record could not be ended in time; it is incomplete");
            }
        }
        while let Ok(report) = self.reported.try_recv() {
            if let Report::Finished(result) = report {
                self.tell(Happening::RunFinished(result));
            }
        }
        let Self { rig, live, mut bench, .. } = self;
        let rig_here = Arc::clone(&rig);
        let stopped = tokio::task::spawn_blocking(move || live.stop(&rig_here)).await;
        let stopped = stopped.unwrap_or_else(|panic| Err(DaemonError::LoopEnded(panic.to_string())));
        let vented = match &stopped {
            Ok(vented) => *vented,
            Err(error) => {
                tracing::error!("{error}");
                false
            }
        };
        match vented {
            true => {
                tracing::info!("vented and verified");
                Ok(())
            }
            false => Err(DaemonError::NotVented(unvented(&bench.latest(), &rig))),
        }
    }
}

/// What is not vented, in words.
pub(super) fn unvented(record: &TickRecord, rig: &Rig) -> String {
    let frees = record.frees().iter().zip(&rig.control.frees);
    let full = frees.filter(|(tick, free)| !is_free_vented(record.time, tick, free));
    let full: Vec<_> = full
        .map(|(tick, free)| match tick.pressure.pressure {
            p if p.is_finite() => format!("{} was last seen at {:.2}", free.name, Pressure::pascals(p)),
            _ => format!("the pressure of {} is not known", free.name),
        })
        .collect();
    if full.is_empty() { "no reading verifies it".into() } else { full.join(", ") }
}

/// Tells the tick whether a configuration file differs from what was loaded.
fn watch_files(rig: Arc<Rig>, switches: Arc<Switches>) -> JoinHandle<()> {
    tokio::spawn(async move {
        let mut look = interval(FILES_PERIOD);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            look.tick().await;
            let here = Arc::clone(&rig);
            let changed = tokio::task::spawn_blocking(move || !here.changed_files().is_empty()).await;
            switches.config_changed.store(changed.unwrap_or(false), Ordering::Relaxed);
        }
    })
}

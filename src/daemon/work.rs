//! Work that takes its time, in a thread of its own: what it reports, and how it is ended.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use super::api::{self, Problem, Response, RunResult};
use super::experiment::{self, Attendance, Job, Progress};
use super::{DaemonError, LiveBench};
use crate::config::Rig;
use crate::record;

/// Where the answer to a request goes.
pub(super) type Answer = oneshot::Sender<Result<Response, Problem>>;

/// What work tells the supervisor.
#[derive(Debug)]
pub(super) enum Report {
    /// A run is under way.
    Running(api::Run),
    /// A run has ended.
    Finished(RunResult),
    /// All is done, or why it is not.
    Ended(Result<String, DaemonError>),
    /// The pressures are down, or why they are not, and who wants to know: disarming is nobody's turn.
    Disarmed(Result<(), DaemonError>, Answer),
}

/// Work under way.
#[derive(Debug)]
pub(super) struct Work {
    /// What it is, for whoever has to wait for it.
    pub what: String,
    /// Who waits for its first result.
    pub answer: Option<Answer>,
    /// Keeps it from starting anything further.
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Work {
    /// Has `body` do `what`; how it ends is reported.
    pub fn start(
        what: String,
        answer: Answer,
        stop: Arc<AtomicBool>,
        reports: mpsc::UnboundedSender<Report>,
        body: impl FnOnce(&mpsc::UnboundedSender<Report>) -> Result<String, DaemonError> + Send + 'static,
    ) -> Self {
        let thread = tokio::task::spawn_blocking(move || {
            let ended = body(&reports);
            // Without a supervisor nobody wants to know.
            let _ = reports.send(Report::Ended(ended));
        });
        Self { what, answer: Some(answer), stop, thread }
    }

    /// Nothing further is to be started.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }

    /// Whether its thread has ended, by a panic if there was no report of it.
    pub fn is_over(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for its end.
    pub async fn over(self) {
        // A panic has been told by the panic hook.
        let _ = self.thread.await;
    }
}

/// Carries out `job` and reports every run of it.
pub(super) fn carry_out(
    mut bench: LiveBench,
    rig: &Rig,
    job: &Job,
    reports: &mpsc::UnboundedSender<Report>,
) -> Result<String, DaemonError> {
    let mut current: Option<PathBuf> = None;
    let outcome = experiment::run(&mut bench, rig, job, &mut |progress| {
        let (_, folder) = progress.run;
        if current.as_deref().is_some_and(|before| before != folder)
            && let Some(before) = current.take()
        {
            let _ = reports.send(Report::Finished(result(&before, None)));
        }
        current.get_or_insert_with(|| folder.to_owned());
        let _ = reports.send(Report::Running(running(job, progress)));
    });
    if let Some(last) = current {
        let _ = reports.send(Report::Finished(result(&last, outcome.as_ref().err())));
    }
    outcome.map(|runs| format!("{} {} {}", runs.len(), if runs.len() == 1 { "run of" } else { "runs of" }, job.title))
}

fn running(job: &Job, progress: &Progress<'_>) -> api::Run {
    let (id, folder) = progress.run;
    let share = if progress.duration > 0.0 { progress.elapsed / progress.duration } else { 1.0 };
    api::Run {
        id: id.into(),
        folder: folder.display().to_string(),
        kind: job.kind.name().into(),
        name: job.title.clone(),
        attended: job.attendance != Attendance::Detached,
        repeat: progress.repeat,
        repeats: job.repeats,
        elapsed_s: progress.elapsed,
        duration_s: progress.duration,
        progress: share.clamp(0.0, 1.0),
        phase: progress.phase.into(),
    }
}

/// What came of the run in `folder`; `error` is what went wrong after its end.
fn result(folder: &Path, error: Option<&DaemonError>) -> RunResult {
    let read = record::Run::open(folder).and_then(|run| RunResult::of(&run));
    let mut result = read.unwrap_or_else(|unreadable| {
        tracing::error!(error = %unreadable, folder = %folder.display(), "the run cannot be read");
        RunResult {
            id: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            folder: folder.display().to_string(),
            outcome: "incomplete".into(),
            reason: Some(unreadable.to_string()),
            ..RunResult::default()
        }
    });
    match (error, result.outcome.as_str()) {
        (Some(error), "done") => {
            result.outcome = if error.is_rig_fault() { "fault" } else { "failed" }.into();
            result.reason = Some(format!("after its end: {error}. {}", error.remedy()));
        }
        // Its record ends early, and only the daemon knows why.
        (Some(error), "incomplete") => result.reason = Some(format!("{error}. {}", error.remedy())),
        _ => {}
    }
    result
}

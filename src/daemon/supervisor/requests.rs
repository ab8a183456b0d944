//! What the socket asks of the supervisor: what needs a turn gets one, or is told who has it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::Supervisor;
use crate::config::experiment::Experiment;
use crate::config::{Rig, is_plain};
use crate::control::Request;
use crate::daemon::api::{self, Problem, ProblemKind, Response, Start};
use crate::daemon::experiment::{Attendance, Job};
use crate::daemon::work::{Answer, Report, Work, carry_out};
use crate::daemon::{Bench, DaemonError, LiveBench, byhand, procedure, validity};
use crate::record::LiveView;
use crate::signal::{FaultCode, RefusalCode, State, TickRecord};

impl Supervisor {
    /// What the socket asks.
    pub(super) fn take(&mut self, request: api::Request, answer: Answer) {
        let refused = match request {
            api::Request::Arm(arm) => match self.bench.latest().state {
                state if state.is_armed() => Ok(Response::done("the rig is armed already")),
                _ => {
                    return self.procedure("arming", answer, move |bench, rig| {
                        procedure::arm(bench, rig, arm.accept_margin)?;
                        let warnings = validity::of(rig).warnings;
                        Ok(warnings.iter().fold("armed".into(), |text, warning| format!("{text}\nwarning: {warning}")))
                    });
                }
            },
            api::Request::Clear => match self.bench.latest() {
                latest if latest.latched.is_empty() => nothing_to_clear(self.desk.estop.load(Ordering::Acquire)),
                latest => {
                    // Only a stop that has been seen is taken back.
                    if latest.latched.contains(FaultCode::EmergencyStop) && self.work.is_none() {
                        self.desk.estop.store(false, Ordering::Release);
                    }
                    return self.procedure("clearing", answer, |bench, rig| {
                        procedure::clear(bench, rig).map(|()| "cleared; the rig is disarmed".into())
                    });
                }
            },
            api::Request::Disarm => match self.bench.latest() {
                latest if latest.state == State::Faulted => Err(Problem::from(&DaemonError::Fault(latest.latched))),
                _ => return self.disarm(answer),
            },
            api::Request::Stop => self.stop(),
            api::Request::Profile(of) => return self.profile(&of.free, answer),
            api::Request::Set(set) => match byhand::job(&set, &self.rig, &self.bench.latest()) {
                Ok(job) => return self.job(job, answer),
                Err(problem) => Err(problem),
            },
            api::Request::Start(start) => match self.prepare(&start) {
                Ok(job) => return self.job(job, answer),
                Err(problem) => Err(problem),
            },
        };
        let _ = answer.send(refused);
    }

    fn busy(&self) -> Result<(), Problem> {
        match &self.work {
            None => Ok(()),
            Some(work) => Err(Problem::new(
                ProblemKind::Busy,
                format!("the rig is busy {}", work.what),
                "wait for it (`freerig status --watch`), or end it: `freerig disarm` takes the pressures down",
            )),
        }
    }

    /// Starts a procedure, if nothing else is under way.
    fn procedure(
        &mut self,
        what: &str,
        answer: Answer,
        body: impl FnOnce(&mut LiveBench, &Rig) -> Result<String, DaemonError> + Send + 'static,
    ) {
        if let Err(problem) = self.busy() {
            let _ = answer.send(Err(problem));
            return;
        }
        let (mut bench, rig) = (self.bench.clone(), Arc::clone(&self.rig));
        let body = move |_: &_| body(&mut bench, &rig);
        self.work = Some(Work::start(what.into(), answer, Arc::default(), self.reports.clone(), body));
    }

    /// Starts a job, if the rig is armed and nothing else is under way.
    fn job(&mut self, mut job: Job, answer: Answer) {
        if let Err(problem) = self.busy().and_then(|()| armed(&self.bench.latest())) {
            let _ = answer.send(Err(problem));
            return;
        }
        job.live = self.view.as_ref().map(LiveView::feed);
        let (bench, rig, stop) = (self.bench.clone(), Arc::clone(&self.rig), Arc::clone(&job.stop));
        let what = format!("with a {}, \"{}\"", job.kind.name(), job.title);
        let body = move |reports: &_| carry_out(bench, &rig, &job, reports);
        self.work = Some(Work::start(what, answer, stop, self.reports.clone(), body));
    }

    /// The job that `start` asks for.
    fn prepare(&self, start: &Start) -> Result<Job, Problem> {
        let said = start.note.iter().chain(&start.source);
        if said.into_iter().any(|text| !is_plain(text)) {
            let error = "a note, or the name of an experiment's file, must not contain control characters";
            return Err(Problem::new(ProblemKind::Usage, error, "write plain text"));
        }
        let path = Path::new(start.source.as_deref().unwrap_or("experiment.toml"));
        let experiment = Experiment::parse(path, &start.experiment, &self.rig, start.free.as_deref())
            .map_err(|error| Problem::new(ProblemKind::Usage, error.to_string(), "correct the experiment's file"))?;
        if experiment.kind.name() != start.kind {
            let error = format!("{} is a {}, not a {}", path.display(), experiment.kind.name(), start.kind);
            return Err(Problem::new(ProblemKind::Usage, error, format!("`freerig {}`", experiment.kind.name())));
        }
        let attendance = if start.detach { Attendance::Detached } else { Attendance::Remote };
        let mut job = Job { accept_margin: start.accept_margin, ..Job::new(experiment, attendance) };
        job.repeats = start.repeat.unwrap_or(job.repeats).max(1);
        job.note = start.note.clone().unwrap_or(job.note);
        job.hand = start.hand.clone();
        job.open_loop = start.open_loop;
        job.poses = Arc::clone(&self.desk.poses);
        Ok(job)
    }

    /// Takes the pressures down, whatever is under way.
    fn disarm(&mut self, answer: Answer) {
        if let Some(work) = &self.work {
            work.stop();
        }
        let (mut bench, rig) = (self.bench.clone(), Arc::clone(&self.rig));
        let reports = self.reports.clone();
        tokio::task::spawn_blocking(move || {
            let done = procedure::disarm(&mut bench, &rig);
            // Without a supervisor the rig is vented, and the client told that the daemon is gone.
            let _ = reports.send(Report::Disarmed(done, answer));
        });
    }

    /// Reads the calibration profile of the IMU of the FREE `name`.
    fn profile(&self, name: &str, answer: Answer) {
        let free = self.rig.free(name).ok_or_else(|| {
            let names: Vec<_> = self.rig.free_names().collect();
            let error = format!("there is no FREE called `{name}`");
            Problem::new(ProblemKind::Usage, error, format!("this rig has: {}", names.join(", ")))
        });
        let free = match self.busy().and(free) {
            Ok(free) => free,
            Err(problem) => {
                let _ = answer.send(Err(problem));
                return;
            }
        };
        let (mut bench, rig) = (self.bench.clone(), Arc::clone(&self.rig));
        tokio::task::spawn_blocking(move || {
            let done = procedure::read_profile(&mut bench, &rig, free);
            let done =
                done.map(|profile| Response { profile: Some(profile.into()), ..Response::done("the profile is read") });
            let _ = answer.send(done.map_err(|error| Problem::from(&error)));
        });
    }

    /// Ends the run under way; the pressures hold.
    fn stop(&mut self) -> Result<Response, Problem> {
        let Some(work) = self.work.as_ref().filter(|_| self.run.is_some()) else {
            let remedy = "`freerig disarm` takes the pressures down";
            return Err(Problem::new(ProblemKind::Refused, "no experiment is running", remedy));
        };
        work.stop();
        if self.bench.latest().state.is_armed() {
            self.bench.request(Request::Stop).map_err(|error| Problem::from(&error))?;
        }
        Ok(Response::done("stopped; the pressures hold"))
    }

    /// Requests that came too late.
    pub(super) fn answer_the_rest(&mut self) {
        self.desk.requests.close();
        while let Ok((_, answer)) = self.desk.requests.try_recv() {
            let problem = Problem::new(ProblemKind::Refused, "the daemon is stopping", "start it again");
            let _ = answer.send(Err(problem));
        }
    }
}

/// The answer to a clear where nothing is latched: a stop that is set already will be by the next tick.
fn nothing_to_clear(estop: bool) -> Result<Response, Problem> {
    match estop {
        false => Ok(Response::done("no fault is latched")),
        true => Err(Problem::new(
            ProblemKind::Refused,
            "the emergency stop has just been set, and the rig has not taken it up yet",
            "wait until `freerig status` says `faulted`, then `freerig clear` again",
        )),
    }
}

/// Whether a program may start.
fn armed(record: &TickRecord) -> Result<(), Problem> {
    let refused = |error: &str, remedy: &str| Err(Problem::new(ProblemKind::Refused, error, remedy));
    match record.state {
        State::Hold if record.config_changed => {
            refused(RefusalCode::ConfigChanged.message(), RefusalCode::ConfigChanged.remedy())
        }
        State::Hold => Ok(()),
        State::Disarmed => refused("the rig is not armed", "`freerig arm`, then try again"),
        State::Faulting | State::Faulted => Err(Problem::from(&DaemonError::Fault(record.latched))),
        state => refused(
            &format!("the rig is not ready: it stands in {}", state.name()),
            "`freerig status` shows what it does; try again when it holds",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_that_no_tick_has_seen_is_not_said_to_be_clear() {
        assert!(nothing_to_clear(false).is_ok());
        let problem = nothing_to_clear(true).unwrap_err();
        assert!(problem.error.contains("emergency stop") && problem.remedy.contains("`freerig clear`"), "{problem:?}");
    }
}

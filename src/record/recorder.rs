//! Records a run: samples first, then rerun's file, then the live view.
//!
//! Batches are cut by the records' own time, so that a live and a stepped run make the same files. The samples
//! are the record; `run.rrd` and the live view are made from the same batches and may fail without harming it
//! (the failure is returned at the end and stands in the stop document), while a failure to write samples is
//! returned at once.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use hdrhistogram::Histogram;

use super::columns::{BatchBuilder, limit_names};
use super::document::{FaultDocument, LoopDocument, MomentDocument, StartDocument, StopDocument};
use super::live::LiveFeed;
use super::metrics;
use super::rerun_sink::RerunFile;
use super::run::{Run, now};
use super::samples::SampleWriter;
use super::{RecordError, Result};
use crate::clock::Time;
use crate::control::fault::row;
use crate::signal::{FaultCode, FaultSet, FreeTick, TickRecord, Truth};

/// How to record.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Whether the simulated rig's truth is recorded beside.
    pub truth: bool,
    /// Whether `run.rrd` is written for rerun's viewer.
    pub rrd: bool,
    /// Where the live view is fed, if it is to show this run.
    pub live: Option<LiveFeed>,
    /// Length of a batch.
    pub batch: Duration,
}

impl Default for RecordOptions {
    fn default() -> Self {
        Self { truth: false, rrd: true, live: None, batch: Duration::from_millis(100) }
    }
}

/// A run while it is recorded.
pub struct Recorder {
    run: Run,
    batch: BatchBuilder,
    batch_length: Duration,
    batch_start: Time,
    samples: SampleWriter,
    rerun: Option<RerunFile>,
    rerun_error: String,
    live: Option<(LiveFeed, Arc<StartDocument>)>,
    truth: bool,
    watch: Watch,
    /// Samples could not be written: what is in the file is whole, and nothing more goes into it.
    broken: bool,
}

impl Recorder {
    /// Makes the folder of a new run in `runs` and its files.
    ///
    /// # Errors
    /// Where they cannot be made.
    pub fn create(runs: &Path, start: StartDocument, options: RecordOptions) -> Result<Self> {
        let run = Run::create(runs, start)?;
        let batch = BatchBuilder::new(&run.names(), options.truth);
        let samples = SampleWriter::create(&run.folder, batch.schema())?;
        let rerun = match options.rrd {
            true => Some(RerunFile::create(&run.folder, run.start(), options.truth)?),
            false => None,
        };
        Ok(Self {
            batch,
            batch_length: options.batch,
            batch_start: Time::ZERO,
            samples,
            rerun,
            rerun_error: String::new(),
            live: options.live.map(|feed| (feed, Arc::new(run.start().clone()))),
            truth: options.truth,
            watch: Watch::new()?,
            broken: false,
            run,
        })
    }

    /// The run's id.
    pub fn id(&self) -> &str {
        self.run.id()
    }

    /// The run's folder.
    pub fn folder(&self) -> &Path {
        &self.run.folder
    }

    /// Records so far.
    pub fn records(&self) -> u64 {
        self.watch.statistics.ticks
    }

    /// Appends a record. `truth` has an entry for every FREE, where the rig is simulated.
    ///
    /// # Errors
    /// Where the samples cannot be written any more (the disk is full), once: the run goes on unrecorded, or ends, as
    /// the caller decides.
    pub fn push(&mut self, record: &TickRecord, truth: Option<&[Truth]>) -> Result<()> {
        if self.broken {
            return Ok(());
        }
        if self.batch.rows() == 0 {
            self.batch_start = record.time;
        } else if record.time.since(self.batch_start) >= self.batch_length {
            self.cut()?;
            self.batch_start = record.time;
        }
        let t = self.watch.see(record, &self.run);
        self.batch.push(t, record, truth);
        Ok(())
    }

    fn cut(&mut self) -> Result<()> {
        let batch = self.batch.take().map_err(RecordError::samples(&self.run.folder))?;
        if let Err(error) = self.samples.write(&batch) {
            self.broken = true;
            return Err(error);
        }
        if let Some(rerun) = &mut self.rerun
            && let Err(error) = rerun.send(batch.clone())
        {
            tracing::error!(run = self.run.id(), %error, "run.rrd ends here; the samples go on");
            self.rerun_error = error.to_string();
            self.rerun = None;
        }
        if let Some((feed, start)) = &self.live {
            feed.offer(start, self.truth, batch);
        }
        Ok(())
    }

    /// Writes what is left and the stop document, completed by what the records have shown.
    ///
    /// # Errors
    /// Where it cannot be written, or records could not be before; the run is then incomplete.
    pub fn finish(mut self, stop: StopDocument) -> Result<Run> {
        if self.broken {
            return Err(RecordError::Broken { path: self.run.folder });
        }
        if self.batch.rows() > 0 {
            self.cut()?;
        }
        self.samples.finish()?;
        if let Some(rerun) = self.rerun.take()
            && let Err(error) = rerun.finish()
        {
            tracing::error!(run = self.run.id(), %error, "run.rrd is not complete; the samples are");
            self.rerun_error = error.to_string();
        }
        let mut run = self.run;
        // The errors are a convenience (`freerig runs`); the samples have them.
        let errors = metrics::errors(&run).unwrap_or_default();
        let stop = StopDocument { rerun_error: self.rerun_error, errors, ..self.watch.complete(stop) };
        run.document.stop = Some(stop);
        run.write_document()?;
        Ok(run)
    }
}

/// What the recorder notes about the records that pass by.
struct Watch {
    first: Option<Time>,
    last: Time,
    skipped_before: u64,
    statistics: LoopDocument,
    latency: Histogram<u64>,
    execution: Histogram<u64>,
    limits: u8,
    rig_faults: FaultSet,
    free_faults: Vec<FaultSet>,
    faults: Vec<FaultDocument>,
    moments: Moments,
    latched: FaultSet,
}

/// The rig around the first faults: what comes after them is mostly their consequence.
#[derive(Default)]
struct Moments {
    /// The latest ones, for the fault that may come.
    recent: VecDeque<MomentDocument>,
    kept: Vec<MomentDocument>,
    /// Until when they are kept, s.
    until: Option<f64>,
    /// When the latest one was taken, s.
    taken: Option<f64>,
}

impl Moments {
    /// Between two moments, s.
    const APART: f64 = 0.01;
    /// Before and after a fault, s.
    const AROUND: f64 = 0.1;
    /// Most that are kept.
    const MOST: usize = 200;

    fn see(&mut self, record: &TickRecord, t: f64, fault: bool) {
        // A nanosecond of rounding is no reason to miss a tick.
        let due = self.taken.is_none_or(|taken| t - taken >= Self::APART - 1e-9);
        if !(due || fault) || self.kept.len() >= Self::MOST {
            return;
        }
        self.taken = Some(t);
        self.recent.push_back(moment(record, t));
        while self.recent.front().is_some_and(|first| first.t_s < t - Self::AROUND - 1e-9) {
            self.recent.pop_front();
        }
        if fault {
            self.until = Some(t + Self::AROUND + 1e-9);
        }
        if self.until.is_some_and(|until| t <= until) {
            self.kept.extend(self.recent.drain(..));
        }
    }
}

fn moment(record: &TickRecord, t: f64) -> MomentDocument {
    let each = |pick: fn(&TickRecord, &FreeTick) -> f64| record.frees().iter().map(|free| pick(record, free)).collect();
    MomentDocument {
        t_s: t,
        state: record.state.name().into(),
        pressure_pa: each(|_, free| free.pressure.pressure),
        pressure_age_s: each(|record, free| record.time.seconds_since(free.pressure.time)),
        command_pa: each(|_, free| free.command),
        angle_rad: each(|_, free| free.estimate.angle),
        angle_age_s: each(|_, free| free.estimate.age),
    }
}

/// Longest time that the histograms hold apart, ns; two significant digits below it.
const LONGEST_NS: u64 = 100_000_000_000;

fn histogram() -> Result<Histogram<u64>> {
    Ok(Histogram::new_with_bounds(1, LONGEST_NS, 2)?)
}

impl Watch {
    fn new() -> Result<Self> {
        Ok(Self {
            first: None,
            last: Time::ZERO,
            skipped_before: 0,
            statistics: LoopDocument::default(),
            latency: histogram()?,
            execution: histogram()?,
            limits: 0,
            rig_faults: FaultSet::NONE,
            free_faults: Vec::new(),
            faults: Vec::new(),
            moments: Moments::default(),
            latched: FaultSet::NONE,
        })
    }

    /// Notes `record`; its time since the run's start, s.
    fn see(&mut self, record: &TickRecord, run: &Run) -> f64 {
        let first = *self.first.get_or_insert_with(|| {
            self.skipped_before = record.skipped;
            self.free_faults = vec![FaultSet::NONE; run.start().frees.len()];
            record.time
        });
        let t = record.time.seconds_since(first);
        self.last = record.time;
        self.statistics.ticks += 1;
        self.statistics.deadline_misses = record.skipped.saturating_sub(self.skipped_before);
        self.latency.saturating_record(u64::from(record.latency_ns).max(1));
        if record.execution_ns > 0 {
            self.execution.saturating_record(record.execution_ns.into());
        }
        self.latched = self.latched.union(record.latched);
        let known = self.faults.len();
        let new = FaultSet(record.faults.0 & !self.rig_faults.0);
        self.rig_faults = self.rig_faults.union(new);
        new.iter().for_each(|code| self.faults.push(fault(code, None, record, t)));
        for (i, free) in record.frees().iter().enumerate().take(self.free_faults.len()) {
            self.limits |= free.limits.0;
            let new = FaultSet(free.faults.0 & !self.free_faults[i].0);
            self.free_faults[i] = self.free_faults[i].union(new);
            let name = &run.start().frees[i].name;
            new.iter().for_each(|code| self.faults.push(fault(code, Some(name), record, t)));
        }
        self.moments.see(record, t, self.faults.len() > known);
        t
    }

    /// `stop` with everything that the records have shown.
    fn complete(mut self, mut stop: StopDocument) -> StopDocument {
        let micros = |h: &Histogram<u64>, q: f64| h.value_at_quantile(q) as f64 * 1e-3;
        stop.ended = now();
        stop.duration_s = self.first.map_or(0.0, |first| self.last.seconds_since(first));
        stop.records = self.statistics.ticks;
        stop.around = std::mem::take(&mut self.moments.kept);
        stop.limits_seen = limit_names(self.limits).map(str::to_owned).collect();
        stop.loop_statistics = LoopDocument {
            latency_p50_us: micros(&self.latency, 0.5),
            latency_p99_us: micros(&self.latency, 0.99),
            latency_max_us: self.latency.max() as f64 * 1e-3,
            execution_p50_us: micros(&self.execution, 0.5),
            execution_p99_us: micros(&self.execution, 0.99),
            execution_max_us: self.execution.max() as f64 * 1e-3,
            ..self.statistics
        };
        // What the caller knows more about comes first and is not repeated.
        for mut fault in self.faults.drain(..) {
            if !stop.faults.iter().any(|f| f.code == fault.code && f.free == fault.free) {
                fault.latched = self.latched.iter().any(|c| c as u8 == fault.code);
                stop.faults.push(fault);
            }
        }
        stop
    }
}

fn fault(code: FaultCode, free: Option<&String>, record: &TickRecord, t: f64) -> FaultDocument {
    FaultDocument {
        code: code as u8,
        name: code.name().into(),
        free: free.cloned(),
        tick: record.tick,
        t_s: t,
        latched: false,
        message: format!("{}. {}", row(code).condition, row(code).remedy),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_faults_stand_with_what_was_around_them() {
        let runs = tempfile::tempdir().unwrap();
        let options = RecordOptions { rrd: false, ..Default::default() };
        let start = StartDocument { frees: vec![Default::default()], ..StartDocument::default() };
        let mut recorder = Recorder::create(runs.path(), start, options).unwrap();
        for tick in 0..1000u64 {
            let mut record = TickRecord { tick, time: Time::from_nanos(tick * 2_000_000), ..TickRecord::default() };
            record.free_count = 1;
            record.frees[0].command = tick as f64;
            // Stale from 0.504 s on, and much later lost.
            if tick >= 252 {
                record.frees[0].faults.insert(FaultCode::PressureStale);
            }
            if tick >= 700 {
                record.frees[0].faults.insert(FaultCode::BusLost);
            }
            recorder.push(&record, None).unwrap();
        }
        let run = recorder.finish(StopDocument::default()).unwrap();
        let stop = Run::open(&run.folder).unwrap().stop().unwrap().clone();
        let seen: Vec<_> = stop.faults.iter().map(|f| (f.name.as_str(), f.tick)).collect();
        assert_eq!(seen, [("pressure_stale", 252), ("bus_lost", 700)]);
        let (first, second): (Vec<_>, Vec<_>) = stop.around.iter().partition(|moment| moment.t_s < 1.0);
        for (moments, fault) in [(first, stop.faults[0].t_s), (second, stop.faults[1].t_s)] {
            let times: Vec<_> = moments.iter().map(|m| m.t_s).collect();
            assert!(times.contains(&fault) && times.windows(2).all(|w| w[1] > w[0]), "{times:?}");
            assert!(times[0] <= fault - 0.09 && times[times.len() - 1] >= fault + 0.09, "{times:?}");
            assert!((20..=22).contains(&times.len()), "{times:?}");
            assert!(moments.iter().all(|m| m.command_pa == [(m.t_s * 500.0).round()]));
        }
    }

    #[test]
    fn a_full_disk_is_said_once_and_leaves_what_was_written() {
        let runs = tempfile::tempdir().unwrap();
        let mut recorder =
            Recorder::create(runs.path(), StartDocument::default(), RecordOptions { rrd: false, ..Default::default() })
                .unwrap();
        let folder = recorder.folder().to_owned();
        let push = |recorder: &mut Recorder, ticks: std::ops::Range<u64>| -> Vec<RecordError> {
            let record = |tick| TickRecord { tick, time: Time::from_nanos(tick * 2_000_000), ..TickRecord::default() };
            ticks.filter_map(|tick| recorder.push(&record(tick), None).err()).collect()
        };
        assert!(push(&mut recorder, 0..120).is_empty());
        recorder.samples.fill_the_disk();
        let errors = push(&mut recorder, 120..500);
        assert_eq!(errors.len(), 1);
        assert!(errors[0].to_string().contains("the disk is full"), "{}", errors[0]);
        assert!(matches!(recorder.finish(StopDocument::default()), Err(RecordError::Broken { .. })));
        let run = Run::open(&folder).unwrap();
        assert_eq!((run.is_complete(), run.records().unwrap().count()), (false, 100));
    }
}

//! Records a run: samples first, then rerun's file, then the live view.
//!
//! Batches are cut by the records' own time, so that a live and a stepped run make the same files. The samples
//! are the record; `run.rrd` and the live view are made from the same batches and may fail without harming it
//! (the failure is returned at the end and stands in the stop document), while a failure to write samples is
//! returned at once.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use hdrhistogram::Histogram;

use super::columns::{BatchBuilder, limit_names};
use super::document::{FaultDocument, LoopDocument, StartDocument, StopDocument};
use super::live::LiveFeed;
use super::metrics;
use super::rerun_sink::RerunFile;
use super::run::{Run, now};
use super::samples::SampleWriter;
use super::{RecordError, Result};
use crate::clock::Time;
use crate::control::fault::row;
use crate::signal::{FaultCode, FaultSet, TickRecord, Truth};

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
            && let Err(error) = rerun.send(&batch)
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
    latched: FaultSet,
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
        t
    }

    /// `stop` with everything that the records have shown.
    fn complete(mut self, mut stop: StopDocument) -> StopDocument {
        let micros = |h: &Histogram<u64>, q: f64| h.value_at_quantile(q) as f64 * 1e-3;
        stop.ended = now();
        stop.duration_s = self.first.map_or(0.0, |first| self.last.seconds_since(first));
        stop.records = self.statistics.ticks;
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

//! The near end of the loop's rings: drains the records, keeps the latest, notes what changed, feeds the
//! recorder, and frees the programs that the tick has done with.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use rtrb::Consumer;

use super::tick::Switches;
use crate::record::{RecordError, Recorder};
use crate::signal::{FaultSet, MAX_FREES, Refusal, RefusalCode, State, TickRecord, Truth};
use crate::sim::Plant;
use crate::trajectory::Program;

/// Most changes kept for a reader; older ones are dropped (they stand in the records).
const CHANGES_KEPT: usize = 256;

/// Something worth telling a person.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// The life cycle went on.
    State {
        /// Where it was.
        from: State,
        /// Where it is.
        to: State,
    },
    /// Faults latched that were not before.
    Latched(FaultSet),
    /// The tick refused a request.
    Refused(Refusal),
}

/// Drains the loop's rings.
pub struct Pump {
    records: Consumer<TickRecord>,
    retired: Consumer<Arc<Program>>,
    switches: Arc<Switches>,
    plant: Option<Arc<Mutex<Plant>>>,
    recorder: Option<Recorder>,
    failure: Option<RecordError>,
    latest: TickRecord,
    changes: VecDeque<(TickRecord, Change)>,
    /// Changes seen since the start.
    seen: u64,
}

impl Pump {
    pub(super) fn new(
        records: Consumer<TickRecord>,
        retired: Consumer<Arc<Program>>,
        switches: Arc<Switches>,
        plant: Option<Arc<Mutex<Plant>>>,
    ) -> Self {
        Self {
            records,
            retired,
            switches,
            plant,
            recorder: None,
            failure: None,
            latest: TickRecord::default(),
            changes: VecDeque::new(),
            seen: 0,
        }
    }

    /// Takes everything that waits in the rings.
    pub fn turn(&mut self) {
        while let Ok(record) = self.records.pop() {
            self.take(record);
        }
        while self.retired.pop().is_ok() {}
    }

    fn take(&mut self, record: TickRecord) {
        let before = self.latest;
        if record.state != before.state {
            self.note(record, Change::State { from: before.state, to: record.state });
        }
        let new = FaultSet(record.latched.0 & !before.latched.0);
        if !new.is_empty() {
            self.note(record, Change::Latched(new));
        }
        if record.refusal.code != RefusalCode::None {
            self.note(record, Change::Refused(record.refusal));
        }
        self.latest = record;
        if let Some(recorder) = &mut self.recorder {
            let truth = self.plant.as_ref().map(|plant| truth(plant, &record));
            let free_count = usize::from(record.free_count).min(MAX_FREES);
            if let Err(error) = recorder.push(&record, truth.as_ref().map(|t| &t[..free_count])) {
                tracing::error!(%error, "the recording has ended early");
                self.failure.get_or_insert(error);
            }
        }
    }

    fn note(&mut self, record: TickRecord, change: Change) {
        if self.changes.len() == CHANGES_KEPT {
            self.changes.pop_front();
        }
        self.changes.push_back((record, change));
        self.seen += 1;
    }

    /// The latest record.
    pub fn latest(&self) -> &TickRecord {
        &self.latest
    }

    /// How many changes there have been since the start: where a new reader begins.
    pub fn changes_so_far(&self) -> u64 {
        self.seen
    }

    /// What changed since `heard`, oldest first, with the record in which it did; `heard` moves on. A reader that
    /// comes too late misses the oldest.
    pub fn changes(&self, heard: &mut u64) -> impl Iterator<Item = (TickRecord, Change)> {
        let fresh = usize::try_from(self.seen.saturating_sub(*heard)).unwrap_or(usize::MAX);
        *heard = self.seen;
        self.changes.iter().skip(self.changes.len().saturating_sub(fresh)).copied()
    }

    /// Records that found the ring full, since the start.
    pub fn lost_records(&self) -> u64 {
        self.switches.lost_records.load(Ordering::Relaxed)
    }

    /// Records everything from here on.
    pub fn attach(&mut self, recorder: Recorder) {
        self.failure = None;
        self.recorder = Some(recorder);
    }

    /// Whether the recording has ended before its time: the disk is full.
    pub fn recording_failed(&self) -> bool {
        self.failure.is_some()
    }

    /// Ends the recording; beside the recorder, the error that ended it before its time.
    pub fn detach(&mut self) -> (Option<Recorder>, Option<RecordError>) {
        (self.recorder.take(), self.failure.take())
    }
}

/// What the simulated FREEs really did at the time of `record`.
fn truth(plant: &Mutex<Plant>, record: &TickRecord) -> [Truth; MAX_FREES] {
    let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
    let mut truth = [Truth::default(); MAX_FREES];
    for (free, truth) in truth.iter_mut().enumerate().take(usize::from(record.free_count)) {
        *truth = plant.truth(free, record.time);
    }
    truth
}

//! What a run has recorded, as reports, metrics and comparisons want it: one walk through its samples, in bounded
//! memory however long the run.
//!
//! Of a long run only every so many-th record is kept, for plots and for what is read off them. The errors, the range
//! that they are told in and the highest pressure are those of every record.

use super::columns::column_name;
use super::drive::Drive;
use super::run::Run;
use super::samples::Table;
use super::signals::Signals;
use super::tally::Tally;
use super::{RecordError, Result};
use crate::signal::Quantity;

/// Most records that are kept: of a longer run every second, every fourth and so on.
const MOST: usize = 1 << 19;
/// A reading of the pressure that is older counts as none, s: four periods of the slowest line there is.
const STALE: f64 = 0.256;

/// The columns of a FREE that are read.
const OWN: [&str; 12] = [
    "reference_rad",
    "reference_pa",
    "angle_rad",
    "estimate_valid",
    "true_angle_rad",
    "pressure_pa",
    "command_pa",
    "p_pa",
    "i_pa",
    "d_pa",
    "ff_pa",
    "pressure_time_ns",
];

/// What a run has recorded.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// Of the FREEs of which something was asked; of all of them where nothing was.
    pub frees: Vec<Signals>,
    /// How many records there are.
    pub records: u64,
    /// Every which of them is kept in the signals.
    pub every: u64,
    /// Periods skipped because of overruns.
    pub deadline_misses: u64,
}

impl Recorded {
    /// What `run` has recorded; `watch` is told how much of it has been read, 0 to 1.
    ///
    /// # Errors
    /// Where the samples cannot be read or hold no record of a FREE of the run.
    pub fn of(run: &Run, watch: &mut dyn FnMut(f64)) -> Result<Self> {
        Self::of_at_most(run, MOST, watch)
    }

    fn of_at_most(run: &Run, most: usize, watch: &mut dyn FnMut(f64)) -> Result<Self> {
        let names = run.names();
        let mut columns: Vec<String> = ["t_s", "time_ns", "program_time_s", "skipped"].map(String::from).into();
        columns.extend(names.iter().flat_map(|name| OWN.map(|own| column_name(name, own))));
        let mut tables = run.tables(&columns)?;
        let mut walk = Walk { every: 1, most, skipped: None, ..Walk::default() };
        let mut frees: Vec<Gathered> = names.iter().map(|name| Gathered::new(run, name)).collect();
        while let Some(table) = tables.next() {
            walk.through(&table?, &mut frees);
            watch(tables.share());
        }
        if let Some(missing) = frees.iter().find(|free| free.signals.angle.is_empty()) {
            let reason = format!("it holds no record of the FREE `{}`", missing.signals.name);
            return Err(RecordError::NoSamples { path: run.folder.clone(), reason });
        }
        let mut frees: Vec<Signals> = frees.into_iter().map(|free| free.end(&walk)).collect();
        if frees.iter().any(|s| s.quantity != Quantity::None) {
            frees.retain(|s| s.quantity != Quantity::None);
        }
        let (first, last) = walk.skipped.unwrap_or_default();
        let deadline_misses = (last - first).max(0.0) as u64;
        Ok(Self { frees, records: walk.records as u64, every: walk.every as u64, deadline_misses })
    }

    /// What is left out of a long run, in words.
    pub fn remark(&self) -> Option<String> {
        let (first, averaged) = (self.frees.first()?, self.frees.iter().map(|s| s.drive.averaged).max()?);
        let apart = first.t.get(1)? - first.t.first()?;
        let kept = (self.every > 1).then(|| {
            format!(
                "A long run, {} records: plots and moves are of every {}th, {apart:.3} s apart; RMS, peak and final error, \
                 the range and the highest pressure are of all.",
                self.records, self.every
            )
        });
        let model = (averaged > 1).then(|| format!("The model follows means of {averaged} readings of the pressure."));
        let text: Vec<String> = kept.into_iter().chain(model).collect();
        (!text.is_empty()).then(|| text.join(" "))
    }
}

/// Where the walk is.
#[derive(Default)]
struct Walk {
    records: usize,
    every: usize,
    most: usize,
    /// First and last record of the program.
    program: Option<(usize, usize)>,
    /// Where time is counted from, s: the program's start, before it the first record.
    zero: f64,
    /// Periods skipped before the first and before the last record.
    skipped: Option<(f64, f64)>,
}

impl Walk {
    fn through(&mut self, table: &Table, frees: &mut [Gathered]) {
        let (times, nanoseconds, program) = (table.get("t_s"), table.get("time_ns"), table.get("program_time_s"));
        let columns: Vec<[&[f64]; OWN.len()]> =
            frees.iter().map(|free| OWN.map(|own| table.get(&column_name(&free.signals.name, own)))).collect();
        for row in 0..table.len() {
            let at = |column: &[f64]| column.get(row).copied().unwrap_or(f64::NAN);
            let (t, now) = (at(times), at(program));
            let index = self.records;
            if index == 0 {
                self.zero = t;
            }
            if now.is_finite() {
                if self.program.is_none() {
                    self.zero = t - now;
                }
                let first = self.program.map_or(index, |(first, _)| first);
                self.program = Some((first, index));
            }
            for (free, columns) in frees.iter_mut().zip(&columns) {
                let record = Row { t, zero: self.zero, nanoseconds: at(nanoseconds), own: columns.map(at) };
                free.see(&record, now.is_finite(), index == self.program.map_or(usize::MAX, |(first, _)| first));
                if index.is_multiple_of(self.every) {
                    free.keep(&record);
                }
            }
            self.records += 1;
        }
        if let (Some(first), Some(last)) = (table.get("skipped").first(), table.get("skipped").last()) {
            self.skipped = Some((self.skipped.map_or(*first, |(first, _)| first), *last));
        }
        while self.records.div_ceil(self.every) > self.most {
            self.every *= 2;
            frees.iter_mut().for_each(Gathered::halve);
        }
    }
}

/// One record of a FREE.
struct Row {
    t: f64,
    zero: f64,
    nanoseconds: f64,
    own: [f64; OWN.len()],
}

impl Row {
    /// How long before the record the pressure was read, s. Whole nanoseconds of a year are beyond 53 bits; the
    /// difference of two near ones is not.
    fn age(&self) -> f64 {
        (self.nanoseconds - self.own[11]) * 1e-9
    }

    fn angle(&self) -> f64 {
        if self.own[3] == 0.0 { f64::NAN } else { self.own[2] }
    }

    fn pressure(&self) -> f64 {
        if self.age() > STALE { f64::NAN } else { self.own[5] }
    }
}

/// What is gathered of a FREE on the way.
struct Gathered {
    signals: Signals,
    /// Up to the program's latest record, and since.
    seen: (Seen, Seen),
    measured: Drive,
    commanded: Drive,
}

impl Gathered {
    fn new(run: &Run, name: &str) -> Self {
        let seen = Default::default();
        Self { signals: Signals::named(run, name), seen, measured: Drive::default(), commanded: Drive::default() }
    }

    /// What every record leaves behind; whether the program runs, and has begun with this one.
    fn see(&mut self, row: &Row, running: bool, first: bool) {
        let (sure, since) = &mut self.seen;
        if first {
            *since = Seen::default();
        }
        if running {
            sure.append(since);
        }
        if running { sure } else { since }.add(row);
        let pressure = row.pressure();
        if pressure.is_finite() {
            let highest = &mut self.signals.highest_pressure;
            *highest = Some(highest.map_or(pressure, |highest| highest.max(pressure)));
        }
        self.measured.add(row.t - row.age(), pressure);
        if self.measured.is_empty() {
            self.commanded.add(row.t, row.own[6]);
        }
    }

    /// What the kept ones leave behind besides.
    fn keep(&mut self, row: &Row) {
        let [reference, reference_pressure, _, _, truth, _, command, p, i, d, ff, _] = row.own;
        let signals = &mut self.signals;
        signals.t.push(row.t);
        signals.reference.push(reference);
        signals.reference_pressure.push(reference_pressure);
        signals.angle.push(row.angle());
        signals.true_angle.push(truth);
        signals.pressure.push(row.pressure());
        signals.command.push(command);
        signals.terms.iter_mut().zip([p, i, d, ff]).for_each(|(all, value)| all.push(value));
    }

    fn halve(&mut self) {
        for column in self.signals.columns() {
            let mut index = 0;
            column.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
    }

    fn end(self, walk: &Walk) -> Signals {
        let Self { mut signals, seen: (mut seen, mut since), measured, commanded } = self;
        if walk.program.is_none() {
            seen.append(&mut since);
        }
        (signals.error, signals.true_error) = (seen.error.metrics(), seen.true_error.metrics());
        signals.measured = !measured.is_empty();
        signals.drive = if signals.measured { measured } else { commanded };
        signals.drive.end(walk.zero);
        signals.t.iter_mut().for_each(|t| *t -= walk.zero);
        let (first, last) = walk.program.unwrap_or((0, walk.records.saturating_sub(1)));
        signals.window = first.div_ceil(walk.every)..last / walk.every + 1;
        let asked = |values: &[f64]| values[signals.window.clone()].iter().any(|v| v.is_finite());
        signals.quantity = if asked(&signals.reference) {
            Quantity::Angle
        } else if asked(&signals.reference_pressure) {
            Quantity::Pressure
        } else {
            Quantity::None
        };
        let range = if signals.quantity == Quantity::Angle { seen.reference } else { seen.angle };
        signals.range = range.map(|(low, high)| high - low);
        signals
    }
}

/// What every record leaves behind of the angle.
#[derive(Default)]
struct Seen {
    error: Tally,
    true_error: Tally,
    /// Least and greatest, rad.
    reference: Option<(f64, f64)>,
    angle: Option<(f64, f64)>,
}

impl Seen {
    fn add(&mut self, row: &Row) {
        let (t, reference, angle) = (row.t - row.zero, row.own[0], row.angle());
        self.error.add(t, reference - angle);
        self.true_error.add(t, reference - row.own[4]);
        for (extremes, value) in [(&mut self.reference, reference), (&mut self.angle, angle)] {
            if value.is_finite() {
                widen(extremes, (value, value));
            }
        }
    }

    /// Adds all that `later` has seen, and empties it.
    fn append(&mut self, later: &mut Seen) {
        let Seen { mut error, mut true_error, reference, angle } = std::mem::take(later);
        self.error.append(&mut error);
        self.true_error.append(&mut true_error);
        for (extremes, more) in [(&mut self.reference, reference), (&mut self.angle, angle)] {
            if let Some(more) = more {
                widen(extremes, more);
            }
        }
    }
}

fn widen(extremes: &mut Option<(f64, f64)>, (low, high): (f64, f64)) {
    *extremes = Some(extremes.map_or((low, high), |(least, most)| (least.min(low), most.max(high))));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Time;
    use crate::record::{FreeDocument, RecordOptions, Recorder, StartDocument, StopDocument};
    use crate::signal::{TickRecord, Truth};

    /// A run of 1000 records, 2 ms apart; the program runs from the 100th to the 899th. The reference is 1, the angle
    /// goes from 0 to 1 over the program and is no estimate at its 300th record; its true value is 0.5 but for one
    /// record.
    fn recorded(asked: Quantity) -> (tempfile::TempDir, Run) {
        let runs = tempfile::tempdir().unwrap();
        let free = FreeDocument { name: "paper".into(), ..FreeDocument::default() };
        let start = StartDocument { frees: vec![free], ..StartDocument::default() };
        let options = RecordOptions { rrd: false, truth: true, ..Default::default() };
        let mut recorder = Recorder::create(runs.path(), start, options).unwrap();
        for tick in 0..1000u64 {
            let mut record = TickRecord { tick, time: Time::from_nanos(tick * 2_000_000), ..TickRecord::default() };
            let now = tick as f64 * 2e-3 - 0.2;
            record.program_time = if (100..900).contains(&tick) { now } else { f64::NAN };
            record.skipped = 7 + tick / 100;
            record.free_count = 1;
            let free = &mut record.frees[0];
            free.reference.quantity = asked;
            free.reference.position = 1.0;
            (free.estimate.angle, free.estimate.valid) = (now / 1.6, tick != 400);
            free.pressure.pressure = if tick == 501 { 2e4 } else { 1e4 };
            // A unit that is read every fourth tick.
            free.pressure.time = Time::from_nanos((tick / 4) * 8_000_000);
            let angle = if tick == 777 { -3.0 } else { 0.5 };
            recorder.push(&record, Some(&[Truth { angle, ..Truth::default() }])).unwrap();
        }
        let run = recorder.finish(StopDocument::default()).unwrap();
        (runs, run)
    }

    #[test]
    fn a_run_that_is_thinned_has_the_errors_and_the_highest_pressure_of_all_its_records() {
        let (_runs, run) = recorded(Quantity::Angle);
        let whole = Recorded::of(&run, &mut |_| {}).unwrap();
        let mut shares = Vec::new();
        let thin = Recorded::of_at_most(&run, 100, &mut |share| shares.push(share)).unwrap();
        assert_eq!((whole.records, whole.every, whole.deadline_misses), (1000, 1, 9));
        assert_eq!((thin.records, thin.every, thin.deadline_misses), (1000, 16, 9));
        assert!(shares.is_sorted() && shares.last() == Some(&1.0), "{shares:?}");
        let (all, few) = (&whole.frees[0], &thin.frees[0]);
        assert_eq!((all.t.len(), all.window.clone()), (1000, 100..900));
        // The multiples of 16 up to 992; of the program from 112 to 896.
        assert_eq!((few.t.len(), few.window.clone()), (63, 7..57));
        assert_eq!((all.t[100], few.t[0]), (0.0, all.t[0]));
        for (kept, i) in few.t.iter().zip(0..) {
            assert_eq!(*kept, all.t[16 * i]);
            assert!(few.angle[i] == all.angle[16 * i] || all.angle[16 * i].is_nan());
        }
        assert_eq!(
            (all.error, all.true_error, all.highest_pressure),
            (few.error, few.true_error, few.highest_pressure)
        );
        assert_eq!(all.highest_pressure, Some(2e4));
        assert_eq!(all.true_error.unwrap().peak_rad, 4.0);
        // Of 1 - i / 800 over i = 0 .. 799: the sum of squares by the formula, without the one that is no estimate.
        let n = 800.0;
        let squares: f64 = (1.0 + n) * (1.0 + 2.0 * n) / (6.0 * n) - (1.0f64 - 300.0 / n).powi(2);
        let error = all.error.unwrap();
        assert!((error.rms_rad - (squares / 799.0).sqrt()).abs() < 1e-12, "{error:?}");
        assert_eq!(error.peak_rad, 1.0);
        // The last 51 records: 1 - i / 800 over i = 749 .. 799.
        assert!((error.final_rad - 26.0 / n).abs() < 1e-12, "{error:?}");
        let remark = thin.remark().unwrap();
        assert!(whole.remark().is_none() && remark.contains("1000 records") && remark.contains("0.032 s"), "{remark}");
        // The reference stands; of an angle that follows a pressure, the first and the last record of the program.
        assert_eq!((all.range, few.range), (Some(0.0), Some(0.0)));
        let (_runs, run) = recorded(Quantity::Pressure);
        for most in [1000, 100] {
            let range = Recorded::of_at_most(&run, most, &mut |_| {}).unwrap().frees[0].range.unwrap();
            assert!((range - 799.0 / n).abs() < 1e-12, "{most}: {range}");
        }
        // The model is driven by the readings, not by the records, in both.
        assert_eq!((all.drive.t.len(), all.drive.averaged, few.drive.t.len()), (250, 1, 250));
        assert!(all.measured && all.quantity == Quantity::Angle && few.quantity == Quantity::Angle);
    }
}

//! A histogram of durations that one thread writes and any thread reads, without locks or allocations.

use std::sync::atomic::{AtomicU64, Ordering};

/// Buckets of one octave: a bucket is at most 1/64 (1.6 %) of its value wide.
const PER_OCTAVE: u64 = 64;
/// Values from this one on share the last bucket, ns (69 s).
const CEILING: u64 = 1 << 36;
/// Values below [`PER_OCTAVE`] one by one, then 30 octaves.
const BUCKETS: usize = 31 * PER_OCTAVE as usize;

/// Index of the bucket that holds `value`.
fn index(value: u64) -> usize {
    let value = value.min(CEILING - 1);
    let shift = (u64::BITS - 1).saturating_sub(value.leading_zeros()).saturating_sub(PER_OCTAVE.trailing_zeros());
    (u64::from(shift) * PER_OCTAVE + (value >> shift)) as usize
}

/// Highest value of bucket `index`.
fn highest(index: usize) -> u64 {
    let index = index as u64;
    let shift = (index / PER_OCTAVE).saturating_sub(1);
    ((index - shift * PER_OCTAVE + 1) << shift) - 1
}

/// Counts of durations in ns, by logarithmic buckets at most 1.6 % wide.
#[derive(Debug)]
pub struct Histogram {
    counts: Box<[AtomicU64]>,
    sum: AtomicU64,
    max: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self::new()
    }
}

impl Histogram {
    /// An empty histogram; the only place that allocates.
    pub fn new() -> Self {
        Self {
            counts: (0..BUCKETS).map(|_| AtomicU64::new(0)).collect(),
            sum: AtomicU64::new(0),
            max: AtomicU64::new(0),
        }
    }

    /// Counts one duration of `nanoseconds`.
    pub fn record(&self, nanoseconds: u64) {
        if let Some(count) = self.counts.get(index(nanoseconds)) {
            count.fetch_add(1, Ordering::Relaxed);
        }
        self.sum.fetch_add(nanoseconds, Ordering::Relaxed);
        self.max.fetch_max(nanoseconds, Ordering::Relaxed);
    }

    /// What has been counted so far; a value recorded meanwhile may or may not be in it.
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            counts: self.counts.iter().map(|c| c.load(Ordering::Relaxed)).collect(),
            sum: self.sum.load(Ordering::Relaxed),
            max: self.max.load(Ordering::Relaxed),
        }
    }

    /// [`Snapshot::percentile`] of everything counted so far.
    pub fn percentile(&self, percent: f64) -> Option<u64> {
        self.snapshot().percentile(percent)
    }

    /// Largest duration so far, ns, exact; 0 where there is none.
    pub fn max(&self) -> u64 {
        self.max.load(Ordering::Relaxed)
    }
}

/// The counts of a [`Histogram`] at one moment, or between two.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Snapshot {
    counts: Vec<u64>,
    sum: u64,
    max: u64,
}

impl Snapshot {
    /// What was counted after `earlier`. The maximum is then known only to its bucket (1.6 %), and said high.
    pub fn since(&self, earlier: &Snapshot) -> Snapshot {
        let before = |i: usize| earlier.counts.get(i).copied().unwrap_or(0);
        let counts: Vec<u64> = self.counts.iter().enumerate().map(|(i, &c)| c.saturating_sub(before(i))).collect();
        let last = counts.iter().rposition(|&c| c > 0).map_or(0, highest);
        Snapshot { max: last.min(self.max), sum: self.sum.saturating_sub(earlier.sum), counts }
    }

    /// What was counted here and in `other` together.
    pub fn and(&self, other: &Snapshot) -> Snapshot {
        let here = |i: usize, snapshot: &Snapshot| snapshot.counts.get(i).copied().unwrap_or(0);
        let buckets = self.counts.len().max(other.counts.len());
        Snapshot {
            counts: (0..buckets).map(|i| here(i, self) + here(i, other)).collect(),
            sum: self.sum.saturating_add(other.sum),
            max: self.max.max(other.max),
        }
    }

    /// How many durations were counted.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Largest duration, ns; 0 where there is none.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// Mean duration, ns.
    pub fn mean(&self) -> Option<f64> {
        let count = self.count();
        (count > 0).then(|| self.sum as f64 / count as f64)
    }

    /// The duration, ns, that `percent` (0..=100) of the counted ones do not exceed: never too low, at most
    /// 1.6 % too high. `None` where nothing has been counted.
    pub fn percentile(&self, percent: f64) -> Option<u64> {
        let count = self.count();
        let rank = ((percent.clamp(0.0, 100.0) / 100.0 * count as f64).ceil() as u64).max(1);
        let mut seen = 0;
        let found = self.counts.iter().position(|&c| {
            seen += c;
            seen >= rank
        })?;
        // The last bucket has no upper end of its own.
        Some(if found + 1 == BUCKETS { self.max } else { highest(found).min(self.max) })
    }

    /// How many durations lie within `from..to`, ns; the edges are rounded to the buckets'.
    pub fn count_between(&self, from: u64, to: u64) -> u64 {
        if to <= from {
            return 0;
        }
        let end = if to >= CEILING { BUCKETS } else { index(to) };
        self.counts.get(index(from)..end).map_or(0, |c| c.iter().sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket_and_the_bucket_is_narrow() {
        let mut edge = 0;
        for i in 0..BUCKETS {
            assert_eq!(index(highest(i)), i);
            assert_eq!(index(edge), i, "the buckets leave no gap at {edge}");
            assert!((highest(i) - edge) as f64 <= edge as f64 / 64.0);
            edge = highest(i) + 1;
        }
        assert_eq!(edge, CEILING);
        assert_eq!(index(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn percentiles_are_the_sorted_values_to_the_width_of_a_bucket() {
        let histogram = Histogram::new();
        assert_eq!(histogram.percentile(50.0), None);
        // A deterministic spread over five decades.
        let mut values: Vec<u64> =
            (0..10_000u64).map(|i| 100 + i.wrapping_mul(2_654_435_761) % (1 << (8 + i % 20))).collect();
        values.iter().for_each(|&v| histogram.record(v));
        values.sort_unstable();
        for percent in [0.0, 1.0, 50.0, 99.0, 99.9, 100.0] {
            let rank = ((percent / 100.0 * values.len() as f64).ceil() as usize).max(1);
            let (exact, got) = (values[rank - 1], histogram.percentile(percent).unwrap());
            assert!(got >= exact && got as f64 <= exact as f64 * 65.0 / 64.0, "{percent} %: {got} for {exact}");
        }
        assert_eq!(histogram.max(), *values.last().unwrap());
        let mean = values.iter().sum::<u64>() as f64 / values.len() as f64;
        assert!((histogram.snapshot().mean().unwrap() - mean).abs() < 1e-6 * mean);
    }

    #[test]
    fn a_later_snapshot_without_an_earlier_one_is_what_happened_between() {
        let histogram = Histogram::new();
        histogram.record(1_000_000);
        let earlier = histogram.snapshot();
        (0..10).for_each(|_| histogram.record(20_000));
        let between = histogram.snapshot().since(&earlier);
        assert_eq!((between.count(), between.mean()), (10, Some(20_000.0)));
        assert!((20_000..=20_313).contains(&between.max()), "{}", between.max());
        assert_eq!(between.count_between(0, 30_000), 10);
        assert_eq!(between.count_between(30_000, u64::MAX), 0);
        let together = between.and(&earlier);
        assert_eq!((together.count(), together.mean(), together.max()), (11, histogram.snapshot().mean(), 1_000_000));
        assert_eq!(together.and(&Snapshot::default()), together);
    }

    #[test]
    fn a_duration_beyond_the_ceiling_is_counted_and_its_maximum_is_exact() {
        let histogram = Histogram::new();
        histogram.record(u64::from(u32::MAX) * 1000);
        assert_eq!(histogram.percentile(99.0), Some(u64::from(u32::MAX) * 1000));
    }
}

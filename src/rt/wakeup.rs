//! What waking up costs on this machine: the loop alone, and cyclictest (rt-tests) beside it as the yardstick.
//!
//! A machine's latency changes by the minute, on a virtual one by more than what is to be compared. So the loop and
//! cyclictest run in turn, in pairs of changing order, with the same period, policy and priority, and what counts is
//! the median of the pairs' ratios.

use std::io;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use thiserror::Error;

use super::histogram::{Histogram, Snapshot};
use super::periodic::{self, Realtime, spawn};
use super::rights::Rights;

/// How often the waiting thread looks at what it waits for.
const LOOK: Duration = Duration::from_millis(50);
/// Latencies that cyclictest counts one by one, us; it counts those beyond together.
const LONGEST_COUNTED_US: u64 = 100_000;

/// Wake-up latencies of the loop.
#[derive(Clone, Debug)]
pub struct Wakeups {
    /// From the deadline to the wake-up.
    pub latency: Snapshot,
    /// Periods that were skipped.
    pub skipped: u64,
    /// What the thread was granted.
    pub rights: Rights,
}

/// Why there is nothing to compare with.
#[derive(Debug, Error)]
pub enum CyclictestError {
    /// It is not installed.
    #[error("cyclictest is not installed (on Debian: apt-get install rt-tests)")]
    Missing,
    /// It could not be started, or its end not waited for.
    #[error("cyclictest could not be run: {0}")]
    Io(#[from] io::Error),
    /// It ended with an error.
    #[error("cyclictest failed: {0}")]
    Failed(String),
    /// It printed no histogram.
    #[error("cyclictest printed no histogram that can be read")]
    Unreadable,
}

/// The loop's latencies and cyclictest's, taken one after the other.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The loop's.
    pub own: Snapshot,
    /// cyclictest's.
    pub cyclictest: Snapshot,
}

impl Pair {
    /// The loop's percentile over cyclictest's: below one where the loop wakes earlier. `None` where one of them
    /// has counted nothing.
    pub fn ratio(&self, percent: f64) -> Option<f64> {
        Some(self.own.percentile(percent)? as f64 / self.cyclictest.percentile(percent)?.max(1) as f64)
    }
}

/// The median of the pairs' ratios at `percent`; `None` without a pair.
pub fn median_ratio(pairs: &[Pair], percent: f64) -> Option<f64> {
    let mut ratios: Vec<f64> = pairs.iter().filter_map(|pair| pair.ratio(percent)).collect();
    ratios.sort_by(f64::total_cmp);
    let middle = ratios.len() / 2;
    if ratios.len() % 2 == 1 {
        ratios.get(middle).copied()
    } else {
        Some(0.5 * (ratios.get(middle.checked_sub(1)?)? + ratios.get(middle)?))
    }
}

/// Runs the loop with an empty tick for `duration`. `watch` is told now and then what has passed.
///
/// # Errors
///
/// Those of [`spawn`], and a panic of the loop.
pub fn measure(
    config: Realtime,
    duration: Duration,
    watch: &mut dyn FnMut(Duration),
) -> Result<Wakeups, periodic::Error> {
    let handle = spawn(config, |_| ())?;
    wait(duration, watch, || !handle.is_running());
    let (statistics, rights) = (handle.statistics(), handle.rights().clone());
    handle.join()?;
    Ok(Wakeups { latency: statistics.latency.snapshot(), skipped: statistics.skipped(), rights })
}

/// What [`compare`] has found.
#[derive(Debug)]
pub struct Comparison {
    /// The loop, all its turns together.
    pub own: Wakeups,
    /// The pairs, or why there are none.
    pub pairs: Result<Vec<Pair>, CyclictestError>,
}

/// Runs the loop `pairs` times (at least once) for `turn`, and cyclictest as often in between, in changing order.
/// Where cyclictest cannot be run, the loop is measured all the same. `watch` is told who runs and what has passed of
/// the turn.
///
/// # Errors
///
/// Those of [`measure`].
pub fn compare(
    config: Realtime,
    pairs: u32,
    turn: Duration,
    watch: &mut dyn FnMut(&'static str, Duration),
) -> Result<Comparison, periodic::Error> {
    // The first pair begins with the loop, which finds out whether there are real-time rights.
    let own_turn = |watch: &mut dyn FnMut(&'static str, Duration)| measure(config, turn, &mut |t| watch("loop", t));
    let mut own = own_turn(watch)?;
    let mut first = Some(own.latency.clone());
    let (fifo, mut taken, mut failure) = (own.rights.fifo.is_ok(), Vec::new(), None);
    for pair in 0..pairs.max(1) {
        let mut latest = first.take();
        if pair % 2 == 0 && latest.is_none() {
            latest = Some(own.add(own_turn(watch)?));
        }
        let mut theirs = None;
        if failure.is_none() {
            match cyclictest(config, fifo, turn, &mut |t| watch("cyclictest", t)) {
                Ok(latency) => theirs = Some(latency),
                Err(error) => failure = Some(error),
            }
        }
        let latest = match latest {
            Some(latest) => latest,
            None => own.add(own_turn(watch)?),
        };
        taken.extend(theirs.map(|cyclictest| Pair { own: latest, cyclictest }));
    }
    Ok(Comparison { own, pairs: failure.map_or(Ok(taken), Err) })
}

impl Wakeups {
    /// Adds a later turn; returns its latencies alone.
    fn add(&mut self, turn: Wakeups) -> Snapshot {
        self.latency = self.latency.and(&turn.latency);
        self.skipped += turn.skipped;
        turn.latency
    }
}

/// Runs cyclictest for `duration` with one thread as `config` has it; `fifo` says whether the loop itself got its
/// priority, without which cyclictest stays on the ordinary scheduler as well. Where `config` names no CPU,
/// cyclictest binds its thread to the first one all the same, and cannot be told otherwise.
///
/// # Errors
///
/// [`CyclictestError`].
fn cyclictest(
    config: Realtime,
    fifo: bool,
    duration: Duration,
    watch: &mut dyn FnMut(Duration),
) -> Result<Snapshot, CyclictestError> {
    let period = config.period.as_micros().max(1);
    let mut command = Command::new("cyclictest");
    command.args(["--quiet", "--threads=1"]);
    command.arg(format!("--interval={period}"));
    command.arg(format!("--loops={}", (duration.as_micros() / period).max(1)));
    command.arg(format!("--histogram={LONGEST_COUNTED_US}"));
    match config.priority.filter(|_| fifo) {
        Some(priority) => command.args(["--policy=fifo".into(), format!("--priority={priority}")]),
        None => command.arg("--policy=other"),
    };
    if config.lock_memory && fifo {
        command.arg("--mlockall");
    }
    if let Some(cpu) = config.cpu {
        command.arg(format!("--affinity={cpu}"));
    }
    // Its output outgrows a pipe that nobody reads.
    let reader = std::thread::spawn(move || command.output());
    wait(Duration::MAX, watch, || reader.is_finished());
    let output = match reader.join() {
        Ok(Ok(output)) => output,
        Ok(Err(error)) if error.kind() == io::ErrorKind::NotFound => return Err(CyclictestError::Missing),
        Ok(Err(error)) => return Err(error.into()),
        Err(_) => return Err(CyclictestError::Failed("the thread that waited for it panicked".into())),
    };
    read(&output)
}

fn wait(duration: Duration, watch: &mut dyn FnMut(Duration), over: impl Fn() -> bool) {
    let begun = Instant::now();
    while begun.elapsed() < duration && !over() {
        watch(begun.elapsed().min(duration));
        std::thread::sleep(LOOK.min(duration.saturating_sub(begun.elapsed())));
    }
}

fn read(output: &Output) -> Result<Snapshot, CyclictestError> {
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = said.lines().find(|line| !line.trim().is_empty()).unwrap_or("without a message");
        return Err(CyclictestError::Failed(format!("{} ({})", said.trim(), output.status)));
    }
    parse(&String::from_utf8_lossy(&output.stdout)).ok_or(CyclictestError::Unreadable)
}

/// Lines `microseconds count`, and the number of those that lie beyond; comments begin with `#`.
fn parse(text: &str) -> Option<Snapshot> {
    let histogram = Histogram::new();
    let mut total: u64 = 0;
    let mut count = |nanoseconds, count: u64| {
        (0..count).for_each(|_| histogram.record(nanoseconds));
        total = total.saturating_add(count);
    };
    for line in text.lines() {
        if let Some(beyond) = line.strip_prefix("# Histogram Overflows:") {
            count(LONGEST_COUNTED_US * 1000, beyond.trim().parse().ok()?);
        } else if let Some((latency, times)) = line.split_once([' ', '\t'])
            && let (Ok(latency), Ok(times)) = (latency.parse::<u64>(), times.trim().parse())
        {
            // It cuts to whole microseconds: what it calls 20 us was 20.5 us in the mean.
            count(latency * 1000 + 500, times);
        }
    }
    (total > 0).then(|| histogram.snapshot())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(values: &[u64]) -> Snapshot {
        let histogram = Histogram::new();
        values.iter().for_each(|&value| histogram.record(value));
        histogram.snapshot()
    }

    #[test]
    fn cyclictests_histogram_is_read_with_what_lies_beyond_it() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000019 000000\n000020 000097\n000400 000002\n\
                    # Total: 000000099\n# Max Latencies: 123456\n# Histogram Overflows: 00001\n# Thread 0: 17\n";
        let read = parse(text).unwrap();
        assert_eq!(read.count(), 100);
        assert!((20_500..=20_900).contains(&read.percentile(50.0).unwrap()));
        assert!((400_500..=407_000).contains(&read.percentile(99.0).unwrap()));
        assert_eq!(read.max(), 100_000_000);
        for text in ["", "# Histogram\n# Total: 0\n# Histogram Overflows: 00000\n", "usage: cyclictest [options]\n"] {
            assert!(parse(text).is_none(), "{text}");
        }
    }

    #[test]
    fn one_disturbed_pair_does_not_move_the_median() {
        let pair = |own: u64, other: u64| Pair { own: counted(&[own]), cyclictest: counted(&[other]) };
        // Powers of two have buckets of their own.
        let pairs = [pair(1 << 20, 1 << 20), pair(1 << 30, 1 << 20), pair(1 << 20, 1 << 20)];
        assert_eq!(median_ratio(&pairs, 50.0), Some(1.0));
        assert_eq!(median_ratio(&pairs[1..], 99.0), Some(512.5));
        assert_eq!(median_ratio(&[], 50.0), None);
        let nothing = Pair { own: counted(&[]), cyclictest: counted(&[1]) };
        assert_eq!(nothing.ratio(50.0), None);
    }

    #[test]
    fn the_loop_is_measured_for_as_long_as_asked() {
        let config = Realtime { period: Duration::from_millis(2), priority: None, cpu: None, lock_memory: false };
        let mut last = Duration::ZERO;
        let wakeups = measure(config, Duration::from_millis(60), &mut |passed| last = passed).unwrap();
        assert!(wakeups.latency.count() + wakeups.skipped >= 20, "{wakeups:?}");
        assert!(!wakeups.rights.realtime() && last <= Duration::from_millis(60));
    }
}

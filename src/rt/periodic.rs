//! The periodic thread itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::io::Errno;
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use thiserror::Error;

use super::histogram::Histogram;
use super::rights::{self, Rights};
use super::schedule::Schedule;
use crate::clock::{Clock, Time};

/// How a periodic thread runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Realtime {
    /// Period, 10 us..=10 s.
    pub period: Duration,
    /// SCHED_FIFO priority, 1..=99; `None` stays on the ordinary scheduler.
    pub priority: Option<u8>,
    /// The CPU to run on; `None` leaves it to the scheduler.
    pub cpu: Option<usize>,
    /// Lock the memory of the process.
    pub lock_memory: bool,
}

/// Why a periodic thread could not start, or how it ended.
#[derive(Debug, Error)]
pub enum Error {
    /// The period is out of range.
    #[error("a period of {0:?} is outside 10 us..=10 s")]
    Period(Duration),
    /// The system gave no thread.
    #[error("the real-time thread could not be started: {0}")]
    Spawn(#[from] std::io::Error),
    /// The closure panicked; the thread has ended.
    #[error("the real-time thread panicked: {0}")]
    Panicked(String),
}

/// What the closure is told in each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Periods from the start of the loop to this tick, skipped ones included.
    pub tick: u64,
    /// The tick's nominal time: the latest deadline that has passed.
    pub deadline: Time,
    /// When the thread woke.
    pub woke: Time,
    /// From the deadline that was slept for to the wake-up, ns; longer than a period where periods were skipped.
    pub latency_ns: u32,
    /// Execution time of the previous tick, ns; 0 in the first.
    pub execution_ns: u32,
    /// Periods skipped so far, because the thread woke or finished too late.
    pub skipped: u64,
}

/// The books of a periodic thread, readable from every thread at any time.
#[derive(Debug, Default)]
pub struct Statistics {
    ticks: AtomicU64,
    skipped: AtomicU64,
    /// From the deadline that was slept for to the wake-up, ns.
    pub latency: Histogram,
    /// Execution time of the closure, ns.
    pub execution: Histogram,
}

impl Statistics {
    /// Ticks finished so far: the heartbeat that a watchdog looks for.
    pub fn ticks(&self) -> u64 {
        self.ticks.load(Ordering::Relaxed)
    }

    /// Periods skipped so far.
    pub fn skipped(&self) -> u64 {
        self.skipped.load(Ordering::Relaxed)
    }
}

/// A running periodic thread. Dropping it stops the thread and waits for its end.
#[derive(Debug)]
pub struct Handle {
    stop: Arc<AtomicBool>,
    statistics: Arc<Statistics>,
    rights: Rights,
    thread: Option<JoinHandle<()>>,
}

impl Handle {
    /// What the thread was granted.
    pub fn rights(&self) -> &Rights {
        &self.rights
    }

    /// The thread's books.
    pub fn statistics(&self) -> Arc<Statistics> {
        Arc::clone(&self.statistics)
    }

    /// Whether the thread still runs; it ends when it is stopped and when its closure panics.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    /// Asks the thread to end after the present tick; does not wait.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Stops the thread and waits for its end, at most a period and a tick.
    ///
    /// # Errors
    ///
    /// [`Error::Panicked`] where the closure panicked, then or earlier.
    pub fn join(mut self) -> Result<(), Error> {
        self.stop_and_wait()
    }

    fn stop_and_wait(&mut self) -> Result<(), Error> {
        self.stop();
        self.thread.take().map_or(Ok(()), wait)
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // Whoever wants to know how the thread ended calls `join`.
        self.stop_and_wait().ok();
    }
}

/// Starts a thread that calls `tick` once a period, the first time one period from now, and returns when the
/// thread has its rights or their refusal. The closure must not block, allocate, lock or log.
///
/// # Errors
///
/// [`Error::Period`] and [`Error::Spawn`]; a refused right is not an error but stands in [`Handle::rights`].
pub fn spawn(config: Realtime, tick: impl FnMut(&Timing) + Send + 'static) -> Result<Handle, Error> {
    if !(Duration::from_micros(10)..=Duration::from_secs(10)).contains(&config.period) {
        return Err(Error::Period(config.period));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let statistics = Arc::new(Statistics::default());
    let (granted, rights) = mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("freerig-tick".into()).spawn({
        let (stop, statistics) = (Arc::clone(&stop), Arc::clone(&statistics));
        move || {
            let awake = rights::stay_awake();
            let rights = Rights {
                locked: rights::lock(config.lock_memory),
                pinned: rights::pin(config.cpu),
                fifo: rights::fifo(config.priority),
                awake: awake.as_ref().map(|_| ()).map_err(Clone::clone),
            };
            touch_stack();
            // Nobody listens only if the starting thread is gone, and then the stop flag is set.
            granted.send(rights).ok();
            drop(granted);
            run(config.period, &stop, &statistics, tick);
        }
    })?;
    match rights.recv() {
        Ok(rights) => Ok(Handle { stop, statistics, rights, thread: Some(thread) }),
        Err(_) => Err(wait(thread).err().unwrap_or(Error::Panicked("before its first tick".into()))),
    }
}

/// Waits for the end of the thread; a panic becomes an error with its message.
fn wait(thread: JoinHandle<()>) -> Result<(), Error> {
    thread.join().map_err(|panic| {
        let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
        Error::Panicked(text.unwrap_or_else(|| "without a message".into()))
    })
}

/// Calls `tick` once a period in the calling thread, with whatever rights that has, until `stop` is set: what
/// [`spawn`] runs in its thread. Allocates nothing.
pub fn run(period: Duration, stop: &AtomicBool, statistics: &Statistics, mut tick: impl FnMut(&Timing)) {
    let clock = Clock::Live;
    let mut schedule = Schedule::new(clock.now() + period, period);
    let mut execution_ns = 0;
    loop {
        sleep_until(schedule.deadline());
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let woke = clock.now();
        let wake = schedule.wake(woke);
        let latency_ns = nanoseconds(wake.latency);
        statistics.latency.record(latency_ns.into());
        tick(&Timing {
            tick: wake.tick,
            deadline: wake.deadline,
            woke,
            latency_ns,
            execution_ns,
            skipped: wake.skipped,
        });
        let done = clock.now();
        execution_ns = nanoseconds(done.since(woke));
        statistics.execution.record(execution_ns.into());
        statistics.skipped.store(wake.skipped, Ordering::Relaxed);
        statistics.ticks.fetch_add(1, Ordering::Relaxed);
        schedule.finish(done);
    }
}

/// Saturates at 4.29 s.
fn nanoseconds(duration: Duration) -> u32 {
    u32::try_from(duration.as_nanos()).unwrap_or(u32::MAX)
}

/// Sleeps until `time` on `CLOCK_MONOTONIC`, through signals.
fn sleep_until(time: Time) {
    let nanos = time.as_nanos();
    let request = Timespec { tv_sec: (nanos / 1_000_000_000) as i64, tv_nsec: (nanos % 1_000_000_000) as _ };
    while clock_nanosleep_absolute(ClockId::Monotonic, &request) == Err(Errno::INTR) {}
}

/// Touches the stack that ticks will use, so that its pages are there (and locked) before the first of them.
#[inline(never)]
fn touch_stack() {
    std::hint::black_box(&mut [0u8; 128 * 1024]);
}

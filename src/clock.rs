//! Time: one clock for drivers, tick and record, live or stepped.
//!
//! Live, it is `CLOCK_MONOTONIC`. Stepped, one scheduler moves it: an asynchronous [`Clock::sleep_until`] waits
//! for the scheduler, while a *blocking* [`Clock::block_until`] (a blocking driver's delay, a blocking bus
//! transfer) runs its own [`Clock::fork`] ahead of the others, and the scheduler resumes that driver when
//! everybody else has caught up with it.

use std::collections::BTreeSet;
use std::future::Future;
use std::ops::{Add, Sub};
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use embedded_hal::delay::DelayNs;

/// A point in time: nanoseconds since the clock's own epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(u64);

impl Time {
    /// The clock's epoch.
    pub const ZERO: Time = Time(0);

    /// The time `nanoseconds` after the epoch.
    pub const fn from_nanos(nanoseconds: u64) -> Self {
        Time(nanoseconds)
    }

    /// Nanoseconds since the epoch.
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Time since `earlier`; zero if `earlier` is later than this.
    pub const fn since(self, earlier: Time) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Seconds from `earlier` to this time, negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Time) -> f64 {
        if self.0 >= earlier.0 { (self.0 - earlier.0) as f64 * 1e-9 } else { (earlier.0 - self.0) as f64 * -1e-9 }
    }
}

impl Add<Duration> for Time {
    type Output = Time;
    /// Saturates at the end of time (584 years).
    fn add(self, d: Duration) -> Time {
        Time(self.0.saturating_add(d.as_nanos().min(u64::MAX as u128) as u64))
    }
}

impl Sub<Duration> for Time {
    type Output = Time;
    /// Saturates at the epoch.
    fn sub(self, d: Duration) -> Time {
        Time(self.0.saturating_sub(d.as_nanos().min(u64::MAX as u128) as u64))
    }
}

/// The scheduler's side of a stepped clock.
#[derive(Clone, Debug, Default)]
pub struct Stepper {
    now: Arc<AtomicU64>,
    timers: Arc<Mutex<BTreeSet<u64>>>,
}

impl Stepper {
    /// A stepped clock at its epoch.
    pub fn new() -> Self {
        Self::default()
    }

    /// A handle for a driver, a chip or a procedure.
    pub fn clock(&self) -> Clock {
        Clock::Stepped(Stepped { stepper: self.clone(), ahead: Arc::default() })
    }

    /// The scheduler's time.
    pub fn now(&self) -> Time {
        Time(self.now.load(Ordering::Relaxed))
    }

    /// Moves the time forward to `time` (never backwards) and forgets the timers that have come due.
    pub fn advance_to(&self, time: Time) {
        let now = self.now.fetch_max(time.0, Ordering::Relaxed).max(time.0);
        let mut timers = self.timers.lock().unwrap_or_else(PoisonError::into_inner);
        while timers.first().is_some_and(|&t| t <= now) {
            timers.pop_first();
        }
    }

    /// The earliest time at which a sleeping future wants to be polled again.
    pub fn next_timer(&self) -> Option<Time> {
        self.timers.lock().unwrap_or_else(PoisonError::into_inner).first().map(|&t| Time(t))
    }
}

/// A handle on a stepped clock: shared time, and how far this handle's owner has run ahead of it.
#[derive(Clone, Debug)]
pub struct Stepped {
    stepper: Stepper,
    ahead: Arc<AtomicU64>,
}

/// Where drivers take their time from.
#[derive(Clone, Debug)]
pub enum Clock {
    /// `CLOCK_MONOTONIC`.
    Live,
    /// Simulated time, moved by a [`Stepper`].
    Stepped(Stepped),
}

impl Clock {
    /// The present time; on a stepped clock that of this handle, which blocking waits may have moved ahead.
    pub fn now(&self) -> Time {
        match self {
            Clock::Live => {
                let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
                Time(t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64)
            }
            Clock::Stepped(s) => Time(s.stepper.now().0.max(s.ahead.load(Ordering::Relaxed))),
        }
    }

    /// Whether simulated time is moved by a scheduler.
    pub fn is_stepped(&self) -> bool {
        matches!(self, Clock::Stepped(_))
    }

    /// A handle of its own for another owner: clones share how far they have run ahead, forks do not.
    pub fn fork(&self) -> Clock {
        match self {
            Clock::Live => Clock::Live,
            Clock::Stepped(s) => s.stepper.clock(),
        }
    }

    /// Blocks the calling thread until `time`; stepped, moves this handle ahead and returns at once.
    pub fn block_until(&self, time: Time) {
        match self {
            Clock::Live => {
                while let left = time.since(self.now())
                    && !left.is_zero()
                {
                    std::thread::sleep(left);
                }
            }
            Clock::Stepped(s) => {
                s.ahead.fetch_max(time.0, Ordering::Relaxed);
            }
        }
    }

    /// Resolves at `time`.
    pub fn sleep_until(&self, time: Time) -> Sleep {
        match self {
            Clock::Live => Sleep::Live(Box::pin(tokio::time::sleep(time.since(self.now())))),
            Clock::Stepped(s) => Sleep::Stepped { stepper: s.stepper.clone(), time },
        }
    }

    /// Resolves `duration` from now.
    pub fn sleep(&self, duration: Duration) -> Sleep {
        self.sleep_until(self.now() + duration)
    }
}

/// What [`Clock::sleep_until`] returns.
#[derive(Debug)]
pub enum Sleep {
    /// A timer of the runtime of the calling thread.
    Live(Pin<Box<tokio::time::Sleep>>),
    /// Waits for the scheduler, which polls everything after each move of the time.
    Stepped {
        /// The clock to wait on.
        stepper: Stepper,
        /// When to resolve.
        time: Time,
    },
}

impl Future for Sleep {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<()> {
        match &mut *self {
            Sleep::Live(sleep) => sleep.as_mut().poll(cx),
            Sleep::Stepped { stepper, time } => {
                if stepper.now() >= *time {
                    return Poll::Ready(());
                }
                stepper.timers.lock().unwrap_or_else(PoisonError::into_inner).insert(time.0);
                Poll::Pending
            }
        }
    }
}

/// For blocking drivers such as `bno055`.
impl DelayNs for Clock {
    fn delay_ns(&mut self, ns: u32) {
        self.block_until(self.now() + Duration::from_nanos(ns.into()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blocking_wait_runs_only_its_own_fork_ahead() {
        let stepper = Stepper::new();
        let (mut driver, other) = (stepper.clock(), stepper.clock());
        driver.delay_ms(650);
        assert_eq!(driver.now(), Time::from_nanos(650_000_000));
        assert_eq!(driver.fork().now(), Time::ZERO);
        assert_eq!(other.now(), Time::ZERO);
        stepper.advance_to(Time::from_nanos(700_000_000));
        assert_eq!(driver.now(), other.now());
    }

    #[test]
    fn a_sleeping_future_tells_the_scheduler_when_to_come_back() {
        let stepper = Stepper::new();
        let clock = stepper.clock();
        let mut sleep = Box::pin(clock.sleep(Duration::from_millis(5)));
        let mut cx = Context::from_waker(std::task::Waker::noop());
        assert!(sleep.as_mut().poll(&mut cx).is_pending());
        assert_eq!(stepper.next_timer(), Some(Time::from_nanos(5_000_000)));
        stepper.advance_to(Time::from_nanos(5_000_000));
        assert_eq!(stepper.next_timer(), None);
        assert!(sleep.as_mut().poll(&mut cx).is_ready());
    }

    #[test]
    fn live_time_moves() {
        let clock = Clock::Live;
        let t = clock.now();
        clock.block_until(t + Duration::from_millis(2));
        assert!(clock.now().since(t) >= Duration::from_millis(2));
    }
}

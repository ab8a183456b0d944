//! Deadlines and skipped periods: the accounting of the periodic thread, apart from any clock.

use std::time::Duration;

use crate::clock::Time;

/// The deadlines `start + n period`, and how many of them were skipped.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    start: Time,
    period: Duration,
    next: u64,
    skipped: u64,
}

/// What one wake-up means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// Periods from the start to `deadline`.
    pub tick: u64,
    /// The latest deadline that has passed.
    pub deadline: Time,
    /// From the deadline that was slept for to the wake-up.
    pub latency: Duration,
    /// Periods skipped since the start.
    pub skipped: u64,
}

impl Schedule {
    /// Deadlines every `period` (not zero) from `start` on.
    pub fn new(start: Time, period: Duration) -> Self {
        Self { start, period, next: 0, skipped: 0 }
    }

    /// The deadline to sleep for.
    pub fn deadline(&self) -> Time {
        self.at(self.next)
    }

    /// Takes account of a wake-up at `woke`: deadlines that passed unserved are skipped.
    pub fn wake(&mut self, woke: Time) -> Wake {
        let latency = woke.since(self.deadline());
        self.skip_to(self.passed(woke).max(self.next));
        Wake { tick: self.next, deadline: self.deadline(), latency, skipped: self.skipped }
    }

    /// Takes account of a tick that was finished at `done`: the next deadline is the first that lies ahead.
    pub fn finish(&mut self, done: Time) {
        self.next += 1;
        if self.deadline() <= done {
            self.skip_to(self.passed(done) + 1);
        }
    }

    fn at(&self, tick: u64) -> Time {
        let period = self.period.as_nanos().min(u128::from(u64::MAX)) as u64;
        self.start + Duration::from_nanos(period.saturating_mul(tick))
    }

    /// Index of the latest deadline at or before `time`.
    fn passed(&self, time: Time) -> u64 {
        (time.since(self.start).as_nanos() / self.period.as_nanos().max(1)) as u64
    }

    fn skip_to(&mut self, tick: u64) {
        self.skipped += tick - self.next;
        self.next = tick;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(f64) -> Time = |ms| Time::from_nanos((ms * 1e6) as u64);

    fn two_ms() -> Schedule {
        Schedule::new(MS(100.0), Duration::from_millis(2))
    }

    #[test]
    fn on_time_nothing_is_skipped_and_the_phase_is_kept() {
        let mut schedule = two_ms();
        for n in 0..1000 {
            let deadline = MS(100.0 + 2.0 * f64::from(n));
            assert_eq!(schedule.deadline(), deadline);
            let wake = schedule.wake(deadline + Duration::from_micros(30));
            assert_eq!(wake.tick, n as u64);
            assert_eq!((wake.deadline, wake.latency, wake.skipped), (deadline, Duration::from_micros(30), 0));
            schedule.finish(deadline + Duration::from_micros(1900));
        }
    }

    #[test]
    fn a_stall_skips_whole_periods_shows_in_full_and_leaves_no_backlog() {
        let mut schedule = two_ms();
        let wake = schedule.wake(MS(109.5));
        assert_eq!(wake, Wake { tick: 4, deadline: MS(108.0), latency: Duration::from_micros(9500), skipped: 4 });
        schedule.finish(MS(109.6));
        assert_eq!(schedule.deadline(), MS(110.0));
        let wake = schedule.wake(MS(110.0));
        assert_eq!(wake, Wake { tick: 5, deadline: MS(110.0), latency: Duration::ZERO, skipped: 4 });
    }

    #[test]
    fn a_tick_that_takes_too_long_costs_the_periods_it_took_and_no_latency() {
        let mut schedule = two_ms();
        schedule.wake(MS(100.0));
        schedule.finish(MS(105.0));
        assert_eq!(schedule.deadline(), MS(106.0));
        let wake = schedule.wake(MS(106.0));
        assert_eq!((wake.tick, wake.latency, wake.skipped), (3, Duration::ZERO, 2));
    }

    #[test]
    fn served_and_skipped_periods_add_up_to_the_time_that_went_by() {
        let mut schedule = two_ms();
        let (mut time, mut served) = (MS(100.0), 0u64);
        for n in 0..5000u64 {
            time = time.max(schedule.deadline()) + Duration::from_micros(n * 7919 % 5000);
            let wake = schedule.wake(time);
            assert_eq!(wake.tick, served + wake.skipped);
            assert!(time.since(wake.deadline) < Duration::from_millis(2));
            served += 1;
            time = time + Duration::from_micros(n * 104_729 % 3000);
            schedule.finish(time);
        }
    }
}

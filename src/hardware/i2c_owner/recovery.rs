//! The recovery ladder: how long a device may fail before what is tried.
//!
//! | after | what |
//! | --- | --- |
//! | at once | two retries in the same turn, unless the failure itself took long (a stuck bus blocks) |
//! | 50 ms | the bus is opened anew, once, and nine clocks free a data line that somebody holds |
//! | 150 ms | the device is set up anew; an IMU's reset line is pulled first, where it is wired |
//! | 150 ms (DAC, ADC), 1 s (IMU) | it is lost, and says so; twice a second the whole ladder is tried again |
//!
//! Nothing here waits: between the rungs the bus belongs to the other devices. The first rungs are slower than
//! the shortest interlock, on purpose: readings grow stale in the tick long before, and a connector that comes
//! back in time costs a hold, not a vent. A BNO055 that has been reset answers nothing for 650 ms: that is not a
//! loss yet. A DAC has no such excuse, and pressure hangs on it.

use std::time::Duration;

use crate::clock::{Clock, Time};
use crate::hardware::HardwareError;
use crate::hardware::statistics::DeviceStatistics;

const REOPEN_AFTER: Duration = Duration::from_millis(50);
const RESTART_AFTER: Duration = Duration::from_millis(150);
/// A DAC that has failed for this long is lost.
pub(super) const DAC_LOST_AFTER: Duration = RESTART_AFTER;
/// An ADC that has failed for this long is lost.
pub(super) const ADC_LOST_AFTER: Duration = RESTART_AFTER;
/// An IMU that has failed for this long is lost.
pub const IMU_LOST_AFTER: Duration = Duration::from_secs(1);
/// Pace of the attempts to get a lost device back.
pub(super) const LOST_PACE: Duration = Duration::from_millis(500);
/// Pace of the attempts to set up a device that is not lost yet.
pub(super) const SETUP_PACE: Duration = Duration::from_millis(50);
/// A failure that takes longer is not tried again in the same turn.
const SLOW: Duration = Duration::from_millis(20);
const RETRIES: u32 = 2;

/// What to do about a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rung {
    /// Nothing but going on.
    Continue,
    /// Open the bus anew.
    Reopen,
    /// Set the device up anew.
    Restart,
    /// Open the bus and set the device up, at a slow pace, and say that it is lost.
    Lost,
}

/// Where one device stands on the ladder.
#[derive(Debug)]
pub(super) struct Recovery {
    lost_after: Duration,
    since: Option<Time>,
    reached: Duration,
    lost: bool,
}

impl Recovery {
    /// A device without a failure, lost once it has failed for `lost_after`.
    pub fn new(lost_after: Duration) -> Self {
        Self { lost_after, since: None, reached: Duration::ZERO, lost: false }
    }

    /// The device works.
    pub fn succeeded(&mut self) {
        *self = Self::new(self.lost_after);
    }

    /// The device failed at `now`, and was last known to work at `good`: what is due?
    pub fn failed(&mut self, good: Time, now: Time) -> Rung {
        let elapsed = now.since(*self.since.get_or_insert(good));
        let mut climb = |rung: Duration, to: Rung| {
            (self.reached < rung && elapsed >= rung).then(|| {
                self.reached = rung;
                to
            })
        };
        if elapsed >= self.lost_after {
            self.lost = true;
            return Rung::Lost;
        }
        climb(RESTART_AFTER, Rung::Restart).or_else(|| climb(REOPEN_AFTER, Rung::Reopen)).unwrap_or(Rung::Continue)
    }

    /// Whether the end of the ladder has been reached.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Time from `now` to the next attempt to set the device up; the last one before it is lost comes in time.
    pub fn pace(&self, now: Time) -> Duration {
        match self.since {
            _ if self.lost => LOST_PACE,
            Some(since) => SETUP_PACE.min((since + self.lost_after).since(now)),
            None => SETUP_PACE,
        }
    }
}

/// Tries `exchange` up to three times at once; counts retries and the final failure.
pub(super) fn with_retries<T>(
    clock: &Clock,
    statistics: &DeviceStatistics,
    mut exchange: impl FnMut() -> Result<T, HardwareError>,
) -> Result<T, HardwareError> {
    let mut left = RETRIES;
    loop {
        let begun = clock.now();
        match exchange() {
            Err(error) if left > 0 && error.is_transient() && clock.now().since(begun) < SLOW => {
                left -= 1;
                statistics.retries.increment();
            }
            Err(error) => {
                statistics.note_error(&error);
                return Err(error);
            }
            ok => return ok,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rung_is_climbed_once_and_the_last_one_holds() {
        let at = |ms: u64| Time::from_nanos(1_000_000_000 + ms * 1_000_000);
        let mut ladder = Recovery::new(Duration::from_millis(500));
        let rungs: Vec<_> = [0, 40, 50, 60, 149, 150, 160, 499].map(|ms| ladder.failed(at(0), at(ms))).into();
        use Rung::{Continue, Reopen, Restart};
        assert_eq!(rungs, [Continue, Continue, Reopen, Continue, Continue, Restart, Continue, Continue]);
        assert!(!ladder.is_lost());
        assert_eq!(ladder.pace(at(499)), Duration::from_millis(1));
        assert_eq!([ladder.failed(at(0), at(500)), ladder.failed(at(0), at(1000))], [Rung::Lost; 2]);
        assert!(ladder.is_lost());
        ladder.succeeded();
        assert_eq!(ladder.failed(at(2000), at(2000)), Continue);
    }
}

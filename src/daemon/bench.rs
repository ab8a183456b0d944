//! What a procedure needs of the rig, be it live or stepped.

use std::sync::Arc;
use std::time::Duration;

use crate::clock::Time;
use crate::control::Request;
use crate::hardware::{DeviceStatistics, ProfileDesk};
use crate::record::Recorder;
use crate::signal::{TickRecord, Trim};
use crate::sim::Hand;

use super::{DaemonError, Pump};

/// A rig whose loop runs. Procedures (experiments, calibrations) are written against this, once for both clocks.
pub trait Bench {
    /// The rig's time.
    fn now(&self) -> Time;

    /// Hands `request` to the next tick that takes one.
    ///
    /// # Errors
    /// If too many requests wait already, or the loop has ended.
    fn request(&mut self, request: Request) -> Result<(), DaemonError>;

    /// Adds `trim` to the pressures of the module's plan under way, in place of the one before.
    fn trim(&mut self, trim: Trim);

    /// Lets `duration` pass.
    ///
    /// # Errors
    /// If the loop has ended.
    fn pass(&mut self, duration: Duration) -> Result<(), DaemonError>;

    /// Tells the loop that the client that watches the program is there.
    fn heartbeat(&mut self);

    /// Looks into what the loop reports.
    fn with_pump<R>(&mut self, look: impl FnOnce(&mut Pump) -> R) -> R
    where
        Self: Sized;

    /// Where the calibration profile of the IMU of the FREE `free` is asked for; `None` where it has none.
    fn profile(&self, _free: usize) -> Option<Arc<ProfileDesk>> {
        None
    }

    /// What has happened to each device so far, where that is counted.
    fn devices(&self) -> Vec<Arc<DeviceStatistics>> {
        Vec::new()
    }

    /// Has the simulated bench's hand do to the FREE `free` what `hand` says, for `duration` from now on. At a real
    /// bench a person does it.
    fn pluck(&mut self, _free: usize, _hand: &Hand, _duration: Duration) {}

    /// The latest record.
    fn latest(&mut self) -> TickRecord;

    /// Records everything from here on.
    fn attach(&mut self, recorder: Recorder);

    /// Ends the recording.
    ///
    /// # Errors
    /// The error that ended it before.
    fn detach(&mut self) -> Result<Option<Recorder>, DaemonError>;
}

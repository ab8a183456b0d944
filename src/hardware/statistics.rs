//! What the bus owners count, for `status` and the run's record.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::{HardwareError, Identity};

/// A counter that the bus owner's thread writes and anybody reads.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Counts one more.
    pub fn increment(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// What has been counted so far.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What has happened to one device since the start.
#[derive(Debug, Default)]
pub struct DeviceStatistics {
    /// Model, bus and address.
    pub device: Arc<str>,
    /// Readings that were good.
    pub reads: Counter,
    /// Readings that brought nothing new (the sensor's frame had not changed).
    pub repeats: Counter,
    /// Exchanges that failed for good, after their retries.
    pub errors: Counter,
    /// Exchanges that were tried again.
    pub retries: Counter,
    /// Readings that could not be.
    pub implausible: Counter,
    /// Resets that were found (and not asked for).
    pub resets: Counter,
    /// Times its reset line was pulled.
    pub pulls: Counter,
    /// Times the bus was opened again.
    pub reopens: Counter,
    /// Times the device was set up successfully; the first one counts.
    pub connects: Counter,
    /// Times the device was given up as lost.
    pub losses: Counter,
    identity: Mutex<Option<Identity>>,
    last_error: Mutex<Option<HardwareError>>,
}

impl DeviceStatistics {
    /// Nothing counted yet for `device`.
    pub fn new(device: Arc<str>) -> Self {
        Self { device, ..Self::default() }
    }

    /// The latest failure; none if there has been none since the device was last set up.
    pub fn last_error(&self) -> Option<HardwareError> {
        self.last_error.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Who answers; none before the first connection.
    pub fn identity(&self) -> Option<Identity> {
        self.identity.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Notes a failure. Never waits: if somebody is just reading, the counters have to do.
    pub fn note_error(&self, error: &HardwareError) {
        self.errors.increment();
        if let Ok(mut last) = self.last_error.try_lock()
            && last.as_ref() != Some(error)
        {
            *last = Some(error.clone());
        }
    }

    /// Notes that the device was set up.
    pub fn note_connected(&self, identity: Identity) {
        self.connects.increment();
        if let Ok(mut slot) = self.identity.try_lock() {
            *slot = Some(identity);
        }
        if let Ok(mut last) = self.last_error.try_lock() {
            *last = None;
        }
    }
}

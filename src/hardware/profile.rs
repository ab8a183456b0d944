//! Where somebody asks for an IMU's calibration profile, and its bus owner answers.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use super::HardwareError;
use super::wiring::ImuProfile;

/// One IMU's counter: whoever asks waits for nobody, and neither does the owner.
#[derive(Debug, Default)]
pub struct ProfileDesk {
    asked: AtomicBool,
    answer: Mutex<Option<Result<ImuProfile, HardwareError>>>,
}

impl ProfileDesk {
    /// Asks for the profile. It stops the readings for about 50 ms: only while the rig is disarmed.
    pub fn ask(&self) {
        self.lock().take();
        self.asked.store(true, Ordering::Release);
    }

    /// The answer, once it is there.
    pub fn take(&self) -> Option<Result<ImuProfile, HardwareError>> {
        self.lock().take()
    }

    /// The owner's side: whether somebody asks. Said once.
    pub(super) fn is_asked(&self) -> bool {
        self.asked.swap(false, Ordering::AcqRel)
    }

    /// The owner's side: the answer.
    pub(super) fn answer(&self, answer: Result<ImuProfile, HardwareError>) {
        *self.lock() = Some(answer);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<Result<ImuProfile, HardwareError>>> {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

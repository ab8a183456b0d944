//! What every pressure regulator driver offers to its bus owner.

use super::{HardwareError, Identity};
use crate::signal::PressureSample;

/// A regulator that feeds one FREE. Asynchronous, because serial regulators answer late; a driver that talks
/// over a blocking bus returns futures that are ready at once.
#[allow(async_fn_in_trait)] // Owners poll their regulators on their own thread: no `Send` bound is wanted.
pub trait PressureRegulator {
    /// Finds the unit, checks that it is the one meant and safely set up, and commands zero as its first frame.
    async fn connect(&mut self) -> Result<Identity, HardwareError>;

    /// Commands `setpoint`, Pa gauge, and returns what the unit says: one exchange.
    async fn exchange(&mut self, setpoint: f64) -> Result<PressureSample, HardwareError>;
}

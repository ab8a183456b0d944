//! Venting without a daemon: open the buses, command zero on every path, look until the pressure is gone.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::api::Status;
use super::status::status;
use super::{Bench, DaemonError, Live, Switches, is_vented};
use crate::config::Rig;

/// Beyond the vent time, how long opening the buses and finding the devices may take.
const CONNECTING: Duration = Duration::from_secs(5);
/// How often the pressures are looked at.
const LOOK: Duration = Duration::from_millis(20);

/// Vents `rig` by the way of the emergency stop, with the same loop, owners and drivers as the daemon; whoever calls
/// owns the rig ([`super::RigLock`]). Returns whether the vent is verified, and the last status.
///
/// # Errors
/// As [`Live::start`], and the loop's own end.
pub fn vent(rig: &Rig) -> Result<(bool, Status), DaemonError> {
    let switches = Switches { estop: Arc::new(AtomicBool::new(true)), ..Switches::default() };
    let live = Live::start(rig, switches)?;
    let mut bench = live.bench();
    let end = bench.now() + rig.control.vent_time + CONNECTING;
    while bench.now() < end && !is_vented(&bench.latest(), rig) {
        bench.pass(LOOK)?;
    }
    let seen = status(rig, &live, &bench.latest());
    Ok((live.stop(rig)?, seen))
}

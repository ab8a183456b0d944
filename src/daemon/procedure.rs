//! Steps that every procedure takes: arm, disarm, wait for a state, hear a refusal.

use std::time::Duration;

use super::error::DaemonError;
use super::{Bench, Change, margin, validity};
use crate::clock::Time;
use crate::config::Rig;
use crate::control::Request;
use crate::hardware::wiring::ImuProfile;
use crate::hardware::{DeviceStatistics, HardwareError};
use crate::signal::{Refusal, RefusalCode, RequestKind, State, TickRecord};

/// How often a procedure looks at the rig.
pub const LOOK: Duration = Duration::from_millis(20);
/// Longest time that the devices' set-up may take.
const BOOT: Duration = Duration::from_secs(8);
/// A device that is refused for this long is so until a person does something about it.
const REFUSED: Duration = Duration::from_millis(500);
/// Longest time that self-test, vent check and tare may take.
const ARMING: Duration = Duration::from_secs(10);
/// Longest time that a sensor's profile may take to be read.
const PROFILE: Duration = Duration::from_secs(2);
/// Beyond the ramp and vent times, how long disarming may take.
const SETTLING: Duration = Duration::from_secs(3);

/// Hears what the tick refuses from its making on.
pub struct Refusals {
    heard: u64,
    kind: RequestKind,
}

impl Refusals {
    /// Those of requests of one kind, and those that no request of the same tick has brought about (an arming that
    /// is given up). Everything refused so far is somebody else's affair, and so are other requests.
    pub fn of<B: Bench>(bench: &mut B, kind: RequestKind) -> Self {
        Self { heard: bench.with_pump(|p| p.changes_so_far()), kind }
    }

    /// The next refusal.
    pub fn next<B: Bench>(&mut self, bench: &mut B) -> Option<Refusal> {
        let Self { heard, kind } = self;
        bench.with_pump(|p| {
            p.changes(heard).find_map(|(record, change)| match change {
                Change::Refused(refusal) if record.request == *kind || record.request == RequestKind::None => {
                    Some(refusal)
                }
                _ => None,
            })
        })
    }
}

/// The error that says what the tick refused.
pub fn refused(refusal: Refusal, rig: &Rig) -> DaemonError {
    let subject = rig.control.frees.get(usize::from(refusal.free)).map(|f| f.name.clone());
    DaemonError::Refused { refusal, subject }
}

/// Checks that the calibrations fit the rig, and the margins of its gains (unless they are accepted as they are), arms,
/// and waits until it holds.
///
/// # Errors
/// A calibration that does not fit, a margin below the stated one, a refusal, a fault, or the time.
pub fn arm<B: Bench>(bench: &mut B, rig: &Rig, accept_margin: bool) -> Result<(), DaemonError> {
    let validity = validity::of(rig);
    for warning in &validity.warnings {
        tracing::warn!("{warning}");
    }
    if !validity.refusals.is_empty() {
        return Err(DaemonError::Calibration(validity.refusals.join("; ")));
    }
    if !accept_margin {
        margin::check(&rig.control)?;
    }
    // The devices are set up while the rig boots.
    let mut refusals = Refusals::of(bench, RequestKind::Arm);
    boot(bench, rig, &mut refusals)?;
    bench.request(Request::Arm)?;
    let mut arming = false;
    reach(bench, rig, ARMING, "hold", &mut refusals, |r| {
        let given_up = arming && matches!(r.state, State::Disarmed | State::RampDown);
        arming |= r.state == State::Arming;
        r.state.is_armed() || given_up
    })?;
    match bench.latest().state {
        state if state.is_armed() => Ok(()),
        _ => Err(DaemonError::Interrupted("disarmed while it was arming")),
    }
}

/// Waits until the devices are set up.
///
/// # Errors
/// The reason of a device that is refused, a refusal, a fault, or the time with what every device says.
fn boot<B: Bench>(bench: &mut B, rig: &Rig, refusals: &mut Refusals) -> Result<(), DaemonError> {
    let devices = bench.devices();
    let mut refused: Option<(Time, HardwareError)> = None;
    let booted = reach(bench, rig, BOOT, "disarmed", refusals, |r| {
        let now = devices.iter().filter_map(|d| d.last_error()).find(HardwareError::is_refusal);
        refused = now.map(|error| (refused.as_ref().map_or(r.time, |(since, _)| *since), error));
        r.state != State::Boot || refused.as_ref().is_some_and(|(since, _)| r.time.since(*since) >= REFUSED)
    });
    match (booted, refused) {
        (Ok(()), Some((_, error))) if bench.latest().state == State::Boot => Err(error.into()),
        (Err(DaemonError::Timeout { seconds, state: "boot", .. }), _) => {
            let why = |device: &DeviceStatistics| match device.last_error() {
                Some(error) => Some(error.to_string()),
                None => (device.connects.get() == 0).then(|| "no answer yet".to_owned()),
            };
            let lines = devices.iter().filter_map(|device| Some(format!("\n  {}: {}", device.device, why(device)?)));
            Err(DaemonError::Boot { seconds, devices: lines.collect() })
        }
        (booted, _) => booted,
    }
}

/// Takes the pressures down and waits until the rig is disarmed.
///
/// # Errors
/// A fault on the way, or the time.
pub fn disarm<B: Bench>(bench: &mut B, rig: &Rig) -> Result<(), DaemonError> {
    let mut refusals = Refusals::of(bench, RequestKind::Disarm);
    bench.request(Request::Disarm)?;
    let longest = rig.control.ramp_time + rig.control.vent_time + SETTLING;
    reach(bench, rig, longest, "disarmed", &mut refusals, |r| r.state == State::Disarmed)
}

/// Reads the calibration profile that the IMU of the FREE `free` has found, from a disarmed rig: the readings stop for
/// about 50 ms.
///
/// # Errors
/// A rig that is not disarmed, a FREE without an IMU, an IMU that does not answer, or the time.
pub fn read_profile<B: Bench>(bench: &mut B, rig: &Rig, free: usize) -> Result<ImuProfile, DaemonError> {
    if bench.latest().state != State::Disarmed {
        return Err(refused(Refusal { code: RefusalCode::WrongState, ..Refusal::NONE }, rig));
    }
    let desk = bench.profile(free).ok_or_else(|| DaemonError::Unfit("the FREE has no IMU".into()))?;
    desk.ask();
    let end = bench.now() + PROFILE;
    while bench.now() < end {
        bench.pass(LOOK)?;
        if let Some(answer) = desk.take() {
            return Ok(answer?);
        }
    }
    let state = bench.latest().state.name();
    Err(DaemonError::Timeout { wanted: "a reading of the sensor's profile", seconds: PROFILE.as_secs_f64(), state })
}

/// Clears the latched faults and waits until the rig is disarmed.
///
/// # Errors
/// The refusal that names the fault whose condition still holds, or the time.
pub fn clear<B: Bench>(bench: &mut B, rig: &Rig) -> Result<(), DaemonError> {
    let mut refusals = Refusals::of(bench, RequestKind::Clear);
    bench.request(Request::Clear)?;
    let end = bench.now() + SETTLING;
    while bench.now() < end {
        bench.pass(LOOK)?;
        if let Some(refusal) = refusals.next(bench) {
            return Err(refused(refusal, rig));
        }
        if bench.latest().state == State::Disarmed {
            return Ok(());
        }
    }
    Err(DaemonError::Timeout {
        wanted: "disarmed",
        seconds: SETTLING.as_secs_f64(),
        state: bench.latest().state.name(),
    })
}

/// Lets time pass until the latest record fits.
///
/// # Errors
/// A refusal, a latched fault, or the time.
pub fn reach<B: Bench>(
    bench: &mut B,
    rig: &Rig,
    longest: Duration,
    wanted: &'static str,
    refusals: &mut Refusals,
    mut fits: impl FnMut(&TickRecord) -> bool,
) -> Result<(), DaemonError> {
    let end = bench.now() + longest;
    loop {
        bench.pass(LOOK)?;
        if let Some(refusal) = refusals.next(bench) {
            return Err(refused(refusal, rig));
        }
        let latest = bench.latest();
        if !latest.latched.is_empty() {
            return Err(DaemonError::Fault(latest.latched));
        }
        if fits(&latest) {
            return Ok(());
        }
        if bench.now() >= end {
            return Err(DaemonError::Timeout { wanted, seconds: longest.as_secs_f64(), state: latest.state.name() });
        }
    }
}

//! `freerig calibrate imu`.

use std::time::Duration;

use jiff::Zoned;

use super::{How, attend, confirm, failure, measure, prepare, tell};
use crate::cli::{Context, Failure};
use crate::config::Rig;
use crate::daemon::calibration::{Finding, imu};
use crate::daemon::{Bench, Stepped, procedure};
use crate::hardware::wiring::ImuProfile;
use crate::record::Run;

/// The gyro is left alone for so long before its profile is read, on the stepped clock.
const REST: Duration = Duration::from_secs(6);

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (rig, index) = prepare(how, context)?;
    let (finding, run) = find(how, &rig, index, context)?;
    tell(&finding, &rig, index, &run, context)
}

/// Leaves the rig disarmed.
pub(super) fn find(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<(Finding, Run), Failure> {
    let instruction = "The FREE hangs free and still, its IMU on its end. It will be left alone for twenty seconds, then a \
                       gentle pressure turns it once; nobody touches it.";
    confirm(how, rig, "imu", instruction, context)?;
    let text = imu::still_experiment(rig, index).map_err(failure)?;
    let still = measure(how, rig, index, &text, context)?;
    // What is too noisy is not worth a turn.
    imu::still(rig, index, &still).map_err(failure)?;
    let text = imu::turning_experiment(rig, index).map_err(failure)?;
    let turning = measure(how, rig, index, &text, context)?;
    let today = Zoned::now().date().to_string();
    let mut finding = imu::evaluate(rig, index, (&still, &turning), &today).map_err(failure)?;
    finding.calibration.imu_profile = Some(profile(how, rig, index)?);
    Ok((finding, turning))
}

/// The calibration profile that the sensor has found.
fn profile(how: &How, rig: &Rig, index: usize) -> Result<ImuProfile, Failure> {
    if !how.stepped {
        attend::disarm(&rig.socket.path)?;
        return attend::profile(&rig.socket.path, &rig.control.frees[index].name);
    }
    let mut bench = Stepped::new(rig).map_err(Failure::rig)?;
    bench.pass(REST).map_err(Failure::rig)?;
    procedure::read_profile(&mut bench, rig, index).map_err(Failure::rig)
}

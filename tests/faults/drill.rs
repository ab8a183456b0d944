//! What the drill of `freerig bench --faults` has found: one repetition in fifty.

use std::path::Path;

use freerig::config::Rig;
use freerig::daemon::drill::{cases, trial};
use freerig::signal::FaultCode;

#[test]
fn a_free_that_bursts_is_vented_for_its_pressure_even_where_it_snaps_back_faster_than_the_gyro_can_tell() {
    let rig = Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("rig.toml")).unwrap();
    let cases = cases(&rig);
    let burst = cases.iter().find(|case| case.code == FaultCode::PressureNotFollowing).unwrap();
    // This one's end turns back from 309 degrees at up to 57 rad/s; the gyro's range is 35.
    let trial = trial(&rig, burst, 41).unwrap();
    assert!(!trial.other, "another fault came first: {trial:?}");
}

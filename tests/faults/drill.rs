//! The drill of `freerig bench --faults`: few repetitions of every case here, many there.

use std::path::Path;

use freerig::config::Rig;
use freerig::control::fault::MATRIX;
use freerig::daemon::drill::{Outcome, cases, trial};
use freerig::signal::FaultCode;

fn rig() -> Rig {
    Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("rig.toml")).unwrap()
}

#[test]
fn every_row_of_the_matrix_is_drilled_and_within_its_limits() {
    let rig = rig();
    let cases = cases(&rig);
    for row in &MATRIX {
        assert!(cases.iter().any(|case| case.code == row.code), "{} is not drilled", row.code.name());
    }
    for case in &cases {
        let trials: Vec<_> = (0..2).map(|seed| trial(&rig, case, seed).unwrap()).collect();
        let outcome = Outcome::of(&rig, case, &trials);
        assert!(!outcome.failed, "{}, {}: {outcome:?}", case.code.name(), case.how);
    }
}

#[test]
fn a_free_that_bursts_is_vented_for_its_pressure_even_where_it_snaps_back_faster_than_the_gyro_can_tell() {
    let rig = rig();
    let cases = cases(&rig);
    let burst = cases.iter().find(|case| case.code == FaultCode::PressureNotFollowing).unwrap();
    // This one's end turns back from 309 degrees at up to 57 rad/s; the gyro's range is 35.
    let trial = trial(&rig, burst, 41).unwrap();
    assert!(!trial.other, "another fault came first: {trial:?}");
}

//! The whole rig on the stepped clock: real drivers, simulated chips, the real controller around a plant that
//! differs from its model.

use std::path::Path;
use std::time::Duration;

use freerig::config::Rig;
use freerig::config::experiment::{Experiment, Kind};
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Bench, Stepped, procedure};
use freerig::record::RunResult;
use freerig::signal::State;

fn rig(runs: &Path) -> Rig {
    let mut rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean");
    rig.record.directory = runs.to_owned();
    rig
}

#[test]
fn a_simulated_rig_boots_arms_and_disarms() {
    let folder = tempfile::tempdir().unwrap();
    let rig = rig(folder.path());
    let mut bench = Stepped::new(&rig).unwrap();
    procedure::arm(&mut bench, &rig, true).unwrap();
    assert_eq!(bench.latest().state, State::Hold);
    procedure::disarm(&mut bench, &rig).unwrap();
    assert_eq!(bench.latest().state, State::Disarmed);
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let once = || {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig(folder.path());
        let mut bench = Stepped::new(&rig).unwrap();
        procedure::arm(&mut bench, &rig, true).unwrap();
        let (name, text) = Kind::Trajectory.default_file().unwrap();
        let experiment = Experiment::parse(Path::new(name), text, &rig, None).unwrap();
        let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Here) };
        let runs = run(&mut bench, &rig, &job, &mut |_| {}).unwrap();
        assert_eq!(runs[0].stop().unwrap().result, RunResult::Done, "{:?}", runs[0].stop());
        bench.pass(Duration::from_millis(100)).unwrap();
        runs[0].records().unwrap().map(|r| format!("{r:?}")).collect::<Vec<_>>()
    };
    let (first, second) = (once(), once());
    assert!(first.len() > 4000, "{}", first.len());
    assert!(first == second);
}

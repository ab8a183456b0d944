//! Record and replay: the controller, fed with the inputs in a recorded run's samples, gives the recorded commands bit
//! for bit.

use std::path::Path;
use std::time::Duration;

use freerig::config::Rig;
use freerig::config::experiment::{Experiment, Kind};
use freerig::control::replay::{Carried, Replay};
use freerig::daemon::experiment::{Attendance, Job, Progress, run};
use freerig::daemon::{Bench, Stepped, procedure};
use freerig::record::Run;
use freerig::signal::{State, TickRecord};
use freerig::sim::chips::Misbehaviour;

fn rig(runs: &Path) -> Rig {
    let mut rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean");
    rig.record.directory = runs.to_owned();
    rig
}

/// One experiment of `kind` on the stepped rig; with `trouble` the IMU is unplugged after a second.
fn record(rig: &Rig, kind: Kind, trouble: bool) -> Run {
    let mut bench = Stepped::new(rig).unwrap();
    procedure::arm(&mut bench, rig, true).unwrap();
    let imu = bench.sim().imu(0).expect("the rig has an IMU").clone();
    let mut watch = |progress: &Progress<'_>| {
        if trouble && progress.elapsed > 1.0 {
            imu.always(Misbehaviour::Silent);
        }
    };
    let (name, text) = kind.default_file().unwrap();
    let experiment = Experiment::parse(Path::new(name), text, rig, None).unwrap();
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Here) };
    let run = run(&mut bench, rig, &job, &mut watch).unwrap().remove(0);
    bench.pass(Duration::from_millis(100)).unwrap();
    run
}

/// The records of the run's file, and a controller that goes on after the first of them.
fn replay(rig: &Rig, run: &Run) -> (Vec<TickRecord>, Replay) {
    // Opened anew: nothing but what stands in the folder.
    let run = Run::open(&run.folder).unwrap();
    let records: Vec<TickRecord> = run.records().unwrap().map(|(record, _)| record).collect();
    let program = run.start().program.clone().expect("an experiment has a program");
    let carried = Carried { program: program.into(), attended: true, ..Carried::default() };
    let replay = Replay::new(&rig.control, &records[0], carried).unwrap().expect("a run begins while nothing runs");
    (records, replay)
}

#[test]
fn a_recorded_run_is_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let rig = rig(folder.path());
    for kind in [Kind::Trajectory, Kind::Step] {
        let run = record(&rig, kind, false);
        let (records, mut replay) = replay(&rig, &run);
        assert!(records.len() > 4000 && records.iter().any(|r| r.frees[0].command > 1e4), "{}", records.len());
        assert_eq!(replay.first_difference(&records[1..]), None, "{kind:?}");
    }
}

#[test]
fn a_run_that_ended_in_a_fault_is_replayed_bit_for_bit_and_the_replay_is_not_blind() {
    let folder = tempfile::tempdir().unwrap();
    let rig = rig(folder.path());
    let run = record(&rig, Kind::Trajectory, true);
    let (mut records, mut again) = replay(&rig, &run);
    assert_eq!(records.last().map(|r| r.state), Some(State::Faulted), "{:?}", run.stop());
    assert_eq!(again.first_difference(&records[1..]), None);
    // Another bit in one input, and the commands come out otherwise.
    let (_, mut again) = replay(&rig, &run);
    records[301].estop = true;
    assert_eq!(again.first_difference(&records[1..]), Some(300));
}

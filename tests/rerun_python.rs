//! `run.rrd` as rerun's own Python package of the pinned version reads it: paths, timelines, values, blueprint; and
//! what is left of it after a kill. Skipped, with a message, where the package is not installed.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use freerig::record::{RRD_NAME, RecordOptions, Recorder, Run, RunKind, StopDocument};
use freerig::signal::TickRecord;
use freerig::trajectory::Program;
use serde_json::Value;

#[path = "record/fixture.rs"]
mod fixture;

/// The version that Cargo.toml pins.
const VERSION: &str = "0.36.3";
const CHECK: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/record/rerun_check.py");
/// Where the child of the kill test records.
const CHILD: &str = "FREERIG_TEST_RECORD_INTO";

/// Whether the package is there, and says so where it is not.
fn installed() -> bool {
    let found = Command::new("python3").args(["-c", "import rerun; print(rerun.__version__)"]).output();
    let found = found.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    if found != VERSION {
        println!(
            "skipped: Python package rerun-sdk {VERSION} is not installed (pip install rerun-sdk=={VERSION}), but `{found}`"
        );
    }
    found == VERSION
}

fn read(path: &Path) -> Value {
    let output = Command::new("python3").arg(CHECK).arg(path).stderr(Stdio::inherit()).output().unwrap();
    assert!(output.status.success());
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_python_package_reads_a_run() {
    if !installed() {
        return;
    }
    let runs = tempfile::tempdir().unwrap();
    let program = Program::angle(0, freerig::trajectory::paper_steps().unwrap()).unwrap();
    let recorder = fixture::run(runs.path(), fixture::start(RunKind::Step, &["paper"]), &program, 1, None);
    let run = recorder.finish(StopDocument::default()).unwrap();
    let found = read(&run.folder.join(RRD_NAME));
    assert_eq!(found["applications"], serde_json::json!(["freerig"]));
    assert_eq!(found["recordings"], serde_json::json!([run.id()]));
    assert_eq!(found["timelines"], serde_json::json!(["t", "tick"]));
    assert_eq!(found["timeline_shown"], "t");

    // Every record, at its time, with its value in the units of the bench.
    let table = run.table(&["t_s".into(), "paper.angle_rad".into()]).unwrap();
    let angle = &found["entities"]["/frees/paper/angle/estimate"];
    let values: Vec<f64> = angle["values"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert_eq!(values.len(), table.len());
    for (read, recorded) in values.iter().zip(table.get("paper.angle_rad")) {
        assert!((read - recorded.to_degrees()).abs() < 1e-9);
    }
    assert!((angle["last_s"].as_f64().unwrap() - table.get("t_s").last().unwrap()).abs() < 1e-6);
    for (entity, component) in [
        ("/frees/paper/angle/reference", "Scalars:scalars"),
        ("/frees/paper/error", "Scalars:scalars"),
        ("/frees/paper/pressure/command", "Scalars:scalars"),
        ("/frees/paper/pressure/measured", "SeriesLines:names"),
        ("/frees/paper/terms/i", "Scalars:scalars"),
        ("/loop/latency", "Scalars:scalars"),
        ("/rig/paper/tube", "Transform3D:scale"),
        ("/rig/paper/tip", "Transform3D:quaternion"),
        ("/rig/paper/fibers", "LineStrips3D:strips"),
        ("/states/life_cycle", "StateChange:state"),
        ("/states/paper_faults", "StateChange:state"),
        ("/events", "TextLog:text"),
        ("/document", "TextDocument:text"),
    ] {
        let components = found["entities"][entity]["components"].as_array();
        assert!(components.is_some_and(|c| c.contains(&component.into())), "{entity}: {components:?}");
    }

    // The blueprint's views look at what there is.
    let views = found["views"].as_array().unwrap();
    for (name, origin) in [
        ("angle [deg]", "/frees/paper/angle"),
        ("error [deg]", "/frees/paper/error"),
        ("pressure [psi]", "/frees/paper/pressure"),
        ("terms [psi]", "/frees/paper/terms"),
        ("states, faults, limits", "/states"),
        ("loop [us]", "/loop"),
        ("FREE", "/rig"),
    ] {
        assert!(views.contains(&serde_json::json!([name, origin])), "{name}: {views:?}");
        let entities = found["entities"].as_object().unwrap();
        assert!(entities.keys().any(|e| e.starts_with(origin)), "{origin}");
    }
}

/// Not a test of its own: the process that the next one kills. Records at 500 Hz for ever.
#[test]
#[ignore = "the child of the test of a killed recorder"]
fn child() {
    let Some(runs) = std::env::var_os(CHILD) else { return };
    let start = fixture::start(RunKind::Step, &["paper"]);
    let mut recorder = Recorder::create(Path::new(&runs), start, RecordOptions::default()).unwrap();
    let begun = Instant::now();
    for tick in 0.. {
        let time = Duration::from_nanos(tick * fixture::PERIOD_NS);
        sleep(time.saturating_sub(begun.elapsed()));
        let time = freerig::clock::Time::from_nanos(tick * fixture::PERIOD_NS);
        let mut record = TickRecord { tick, time, free_count: 1, ..TickRecord::default() };
        record.frees[0].estimate.angle = tick as f64;
        record.frees[0].estimate.valid = true;
        recorder.push(&record, None).unwrap();
    }
}

#[test]
fn a_recorder_that_is_killed_leaves_a_file_that_opens_up_to_the_last_flush() {
    let runs = tempfile::tempdir().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--ignored"])
        .env(CHILD, runs.path())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // Until two seconds are in the samples, so that the machine's speed does not matter.
    let end = Instant::now() + Duration::from_secs(60);
    let run = loop {
        sleep(Duration::from_millis(100));
        let run = Run::list(runs.path()).unwrap().pop().and_then(Result::ok);
        match run.filter(|run| run.records().is_ok_and(|r| r.count() >= 1000)) {
            Some(run) => break run,
            None => assert!(Instant::now() < end, "nothing was recorded"),
        }
    };
    // SIGKILL: no destructor, no flush.
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(Run::open(&run.folder).unwrap().result_name(), "incomplete");
    let records: Vec<_> = run.records().unwrap().map(|(r, _)| r).collect();
    assert!(records.len() >= 1000 && records.len() % 50 == 0, "{}", records.len());
    assert!(records.iter().enumerate().all(|(i, r)| r.tick == i as u64));
    assert!(fs::metadata(run.folder.join(RRD_NAME)).unwrap().len() > 0);
    freerig::record::write_report(&run, &mut |_| {}).unwrap();

    if !installed() {
        return;
    }
    let found = read(&run.folder.join(RRD_NAME));
    let angle = &found["entities"]["/frees/paper/angle/estimate"];
    let values = angle["values"].as_array().unwrap();
    assert!(values.iter().enumerate().all(|(i, v)| (v.as_f64().unwrap() - (i as f64).to_degrees()).abs() < 1e-6));
    // rerun flushes every 200 ms; a busy machine is given a second.
    let last = angle["last_s"].as_f64().unwrap();
    assert!(last > records.len() as f64 * 0.002 - 1.0, "{last} s of {} records", records.len());
    assert_eq!(found["timeline_shown"], "t");
}

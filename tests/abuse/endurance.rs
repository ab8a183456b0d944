//! Long times on the stepped clock: memory does not grow with them.
//!
//! Half an hour here; a day by `tests/abuse/day`, through the program.

use std::path::Path;

use freerig::config::Rig;
use freerig::config::experiment::Experiment;
use freerig::daemon::experiment::{Attendance, Job, Progress, run};
use freerig::daemon::{Stepped, procedure};

/// Resident memory of this process, MiB.
fn resident() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|line| line.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

/// A run without an end takes what it needs in its first minutes, MiB more than that is growth.
const GROWTH: f64 = 16.0;

#[test]
fn half_a_simulated_hour_of_recording_takes_no_more_memory_than_its_first_minutes() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).unwrap();
    rig.record.directory = folder.path().to_owned();
    rig.control.period = std::time::Duration::from_millis(20);
    let text = "kind = \"sweep\"\npressures_psi = [1, 4, 2, 5, 3, 1, 4, 2, 5, 3]\nmove_s = 5\nhold_s = 175\nand_back = false\n";
    let experiment = Experiment::parse(Path::new("hour.toml"), text, &rig, None).unwrap();
    let mut bench = Stepped::new(&rig).unwrap();
    procedure::arm(&mut bench, &rig, true).unwrap();
    let job = Job { accept_margin: true, stepped: true, and_back: false, ..Job::new(experiment, Attendance::Here) };
    // By minute of the run.
    let mut memory = Vec::new();
    let mut watch = |progress: &Progress<'_>| {
        if progress.phase == "running" && progress.elapsed >= 60.0 * memory.len() as f64 {
            memory.push(resident());
        }
    };
    let runs = run(&mut bench, &rig, &job, &mut watch).unwrap();
    eprintln!("MiB by minute: {memory:.1?}");
    assert_eq!(memory.len(), 30);
    let stop = runs[0].stop().unwrap();
    assert_eq!((stop.lost_records, stop.records / 1000), (0, 90), "{stop:?}");
    let (settled, last) = (memory[10], memory[29]);
    assert!(last - settled < GROWTH, "{settled:.1} MiB after ten minutes, {last:.1} after thirty");
}

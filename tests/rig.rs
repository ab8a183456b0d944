//! The whole rig on the stepped clock: real drivers, simulated chips, the real controller around a plant that
//! differs from its model.

use std::path::Path;
use std::time::Duration;

use freerig::clock::Time;
use freerig::config::Rig;
use freerig::config::experiment::{Experiment, Kind};
use freerig::control::Request;
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Bench, DaemonError, Pump, Stepped, procedure};
use freerig::hardware::wiring::ImuProfile;
use freerig::record::{Recorder, RunResult};
use freerig::signal::{State, TickRecord, Trim};

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

#[test]
fn an_imu_that_its_saved_profile_does_not_belong_to_is_told_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = rig(folder.path());
    let profile = ImuProfile { unique_id: [7; 16], registers: [0; 22] };
    rig.wiring.i2c[0].imus[0].profile = Some(profile);
    let mut bench = Stepped::new(&rig).unwrap();
    let error = procedure::arm(&mut bench, &rig, true).unwrap_err();
    assert!(bench.now() < Time::ZERO + Duration::from_secs(3), "{:?}", bench.now());
    let text = error.to_string();
    for part in ["BNO055 at 0x28", "profile belongs to sensor 0707", "but this is sensor", "Put the former sensor back"]
    {
        assert!(text.contains(part), "{text}");
    }
}

/// A bench on a machine with so much to do that its procedures come to look every 0.7 s only.
struct Seldom(Stepped);

impl Bench for Seldom {
    fn now(&self) -> Time {
        self.0.now()
    }
    fn request(&mut self, request: Request) -> Result<(), DaemonError> {
        self.0.request(request)
    }
    fn trim(&mut self, trim: Trim) {
        self.0.trim(trim);
    }
    fn pass(&mut self, duration: Duration) -> Result<(), DaemonError> {
        self.0.pass(duration.max(Duration::from_millis(700)))
    }
    fn heartbeat(&mut self) {
        self.0.heartbeat();
    }
    fn with_pump<R>(&mut self, look: impl FnOnce(&mut Pump) -> R) -> R {
        self.0.with_pump(look)
    }
    fn latest(&mut self) -> TickRecord {
        self.0.latest()
    }
    fn attach(&mut self, recorder: Recorder) {
        self.0.attach(recorder);
    }
    fn detach(&mut self) -> Result<Option<Recorder>, DaemonError> {
        self.0.detach()
    }
}

#[test]
fn a_run_is_done_however_late_its_end_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let rig = rig(folder.path());
    let mut bench = Seldom(Stepped::new(&rig).unwrap());
    procedure::arm(&mut bench, &rig, true).unwrap();
    let text = "kind = \"trajectory\"\nangles_deg = [10]\nmove_s = 0.5\nhold_s = 0.1\n";
    let experiment = Experiment::parse(Path::new("short.toml"), text, &rig, None).unwrap();
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Detached) };
    let runs = run(&mut bench, &rig, &job, &mut |_| {}).unwrap();
    assert_eq!(runs[0].stop().unwrap().result, RunResult::Done, "{:?}", runs[0].stop());
}

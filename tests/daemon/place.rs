//! The program in a folder of its own: its commands, its daemon, its log.
#![allow(dead_code, reason = "two test programs use it, neither all of it")]

use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use freerig::config::Rig;
use freerig::daemon::api::Status;
use freerig::daemon::client::Client;
use tempfile::TempDir;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_freerig");
/// Far beyond anything that is waited for here.
pub const LONG: Duration = Duration::from_secs(60);
/// Attempts on a machine that stalls.
pub const ATTEMPTS: usize = 4;
/// Faults that a stalled machine brings about, in the daemon's log or in the failure.
pub const STALLS: [&str; 5] = ["pressure_stale", "imu_stale", "imu_implausible", "deadline", "pressure_not_following"];

/// A rig of its own in a folder of its own.
pub struct Place {
    pub folder: TempDir,
}

impl Place {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(here.join("rig.toml")).unwrap();
        let text = text.replace("rate_hz = 500", "rate_hz = 100").replace("live_view = true", "live_view = false");
        std::fs::write(folder.path().join("rig.toml"), text).unwrap();
        std::fs::create_dir(folder.path().join("calibration")).unwrap();
        std::fs::copy(here.join("calibration/paper.toml"), folder.path().join("calibration/paper.toml")).unwrap();
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn rig(&self) -> Rig {
        let mut rig = Rig::load(&self.path("rig.toml")).unwrap();
        rig.record.directory = self.path("runs");
        rig
    }

    pub fn client(&self) -> Client {
        Client::new(&self.path("runs/control.sock"))
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(self.path("log")).unwrap_or_default()
    }

    /// One command to its end.
    pub fn command(&self, arguments: &[&str]) -> Output {
        Command::new(PROGRAM).args(arguments).current_dir(self.folder.path()).stdin(Stdio::null()).output().unwrap()
    }

    /// A command that must end with `status`; what it printed on both.
    #[track_caller]
    pub fn expect(&self, arguments: &[&str], status: i32) -> String {
        let output = self.command(arguments);
        let text = [output.stdout, output.stderr].concat();
        let text = String::from_utf8(text).unwrap();
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {text}\n{}", self.log());
        text
    }

    #[track_caller]
    pub fn status(&self) -> Status {
        let output = self.command(&["status", "--json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// Waits for a status.
    #[track_caller]
    pub fn until(&self, what: &str, wanted: impl Fn(&Status) -> bool) -> Status {
        let end = Instant::now() + LONG;
        loop {
            let status = self.status();
            if wanted(&status) {
                return status;
            }
            assert!(Instant::now() < end, "not {what}: {status:?}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Changes rig.toml.
    pub fn rewrite(&self, change: impl Fn(String) -> String) {
        let path = self.path("rig.toml");
        std::fs::write(&path, change(std::fs::read_to_string(&path).unwrap())).unwrap();
    }

    /// Starts the daemon and waits until the rig is disarmed.
    pub fn daemon(&self) -> Daemon {
        let daemon = self.booting(&[]);
        self.until("disarmed", |status| status.state == "disarmed");
        daemon
    }

    /// Starts the daemon with some environment and waits until it answers.
    pub fn booting(&self, environment: &[(&str, &str)]) -> Daemon {
        let mut command = Command::new(PROGRAM);
        command.arg("run").envs(environment.iter().copied());
        self.answering(command)
    }

    /// Starts `command`, which becomes the daemon.
    pub fn spawned(&self, mut command: Command) -> Daemon {
        let log = File::options().create(true).append(true).open(self.path("log")).unwrap();
        command.current_dir(self.folder.path()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        Daemon(command.spawn().unwrap())
    }

    /// Starts `command`, which becomes the daemon, and waits until it answers.
    pub fn answering(&self, command: Command) -> Daemon {
        let mut daemon = self.spawned(command);
        let end = Instant::now() + LONG;
        while self.command(&["status"]).status.code() != Some(0) {
            assert_eq!(daemon.0.try_wait().unwrap(), None, "{}", self.log());
            assert!(Instant::now() < end, "{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
        daemon
    }

    /// Starts a command of the program that goes on by itself.
    pub fn background(&self, arguments: &[&str]) -> Daemon {
        let mut command = Command::new(PROGRAM);
        command.args(arguments);
        self.spawned(command)
    }
}

/// A running daemon; killed where a test fails.
pub struct Daemon(pub Child);

impl Daemon {
    pub fn signal(&self, name: &str) {
        let killed = Command::new("kill").args([name, &self.0.id().to_string()]).status().unwrap();
        assert!(killed.success());
    }

    /// A figure of its memory, MiB: `VmRSS`, or `VmHWM`, the highest so far.
    pub fn memory(&self, name: &str) -> f64 {
        let text = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).unwrap();
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
    }

    /// Waits for its end; its exit status, none after a kill.
    pub fn ended(&mut self) -> Option<i32> {
        let end = Instant::now() + LONG;
        loop {
            if let Some(status) = self.0.try_wait().unwrap() {
                return status.code();
            }
            assert!(Instant::now() < end, "the daemon has not ended");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// One rig at a time: two cores are few.
pub fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs `scenario`; again where it failed because the machine stood still and the rig faulted.
pub fn attempt(scenario: impl Fn(&Place)) {
    let _alone = alone();
    for left in (0..ATTEMPTS).rev() {
        let place = Place::new();
        let Err(panic) = catch_unwind(AssertUnwindSafe(|| scenario(&place))) else { return };
        let log = place.log() + panic.downcast_ref::<String>().map_or("", String::as_str);
        let stalled = STALLS.iter().any(|fault| log.contains(fault));
        if left == 0 || !stalled {
            resume_unwind(panic);
        }
        eprintln!("the machine stalled; once more. The daemon's log:\n{log}");
    }
}

pub fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

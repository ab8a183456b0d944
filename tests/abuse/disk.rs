//! No room for the record: the run ends, the pressures go down, and the message says what to do.

use std::path::{Path, PathBuf};
use std::process::Command;

use freerig::daemon::api::Arm;
use freerig::daemon::client::Client;

use super::place::{Daemon, PROGRAM, Place, runtime};
use super::{attempt, finished, hold};

/// A command that runs `script` in a name space of mounts of its own; with rights over it that everybody has in one.
pub fn apart(script: &str) -> Command {
    let mut command = Command::new("unshare");
    if !is_root() {
        command.args(["--user", "--map-root-user"]);
    }
    command.args(["--mount", "sh", "-c", script]);
    command
}

pub fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

/// A rig whose control socket is outside its folder of runs.
fn prepare(place: &Place) {
    place.rewrite(|text| {
        let text = text.replace("free_mib = 100", "free_mib = 0").replace("rate_hz = 100", "rate_hz = 200");
        text.replace("\"runs/control.sock\"", "\"control.sock\"").replace("ramp_time_s = 3.0", "ramp_time_s = 0.5")
    });
    std::fs::create_dir(place.path("runs")).unwrap();
}

/// Records until nothing fits any more; what is said of it must have `words`.
fn until_it_is_full(place: &Place, client: &Client, words: &[&str]) -> PathBuf {
    let runtime = runtime();
    let result = runtime.block_on(async {
        client.arm(Arm { accept_margin: true }).await.unwrap();
        let mut events = client.events().await.unwrap();
        client.start(&hold()).await.unwrap();
        finished(&mut events).await.1
    });
    assert_eq!(result.outcome, "incomplete", "{result:?}");
    let reason = result.reason.expect("a reason");
    for word in words {
        assert!(reason.contains(word), "{word}: {reason}");
        assert!(place.log().contains(word), "{word}: {}", place.log());
    }
    let status = place.until("over", |status| status.run.is_none());
    assert_eq!((status.state.as_str(), status.faults.len()), ("hold", 0), "{status:?}");
    assert_eq!(status.frees[0].command_pa, 0.0, "the pressures are down");
    result.folder.into()
}

/// The next run is recorded as if nothing had been.
fn works_again(place: &Place, daemon: &mut Daemon) {
    place.expect(&["set", "pressure", "1psi"], 0);
    daemon.signal("-TERM");
    assert_eq!(daemon.ended(), Some(0), "{}", place.log());
}

#[test]
fn a_full_disk_ends_the_run_with_the_pressures_down_and_a_remedy() {
    if !apart("mount -t tmpfs tmpfs /mnt").output().is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: nothing can be mounted here");
        return;
    }
    attempt(|place| {
        prepare(place);
        let mut daemon =
            place.answering(apart(&format!("mount -t tmpfs -o size=1536k tmpfs runs && exec {PROGRAM} run")));
        let client = Client::new(&place.path("control.sock"));
        place.until("disarmed", |status| status.state == "disarmed");
        let words = ["the disk is full: delete old runs", "Check the space and the permissions of the runs directory"];
        let folder = until_it_is_full(place, &client, &words);
        // The remedy, where only the daemon sees the folder.
        let inside = format!("/proc/{}/root{}", daemon.0.id(), place.path("runs").display());
        std::fs::remove_dir_all(Path::new(&inside).join(folder.file_name().unwrap())).unwrap();
        works_again(place, &mut daemon);
    });
}

#[test]
fn a_file_that_may_not_grow_ends_the_run_and_not_the_daemon() {
    attempt(|place| {
        prepare(place);
        let mut command = Command::new("sh");
        // Blocks of 512 bytes.
        command.args(["-c", &format!("ulimit -f 800 && exec {PROGRAM} run")]);
        let mut daemon = place.answering(command);
        place.until("disarmed", |status| status.state == "disarmed");
        let words = ["files may not grow any further here: raise the limit", "Check the space"];
        until_it_is_full(place, &Client::new(&place.path("control.sock")), &words);
        works_again(place, &mut daemon);
    });
}

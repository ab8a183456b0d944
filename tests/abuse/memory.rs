//! A daemon that gets no more memory: it ends, or says so, but does not stand still; and the rig can be vented.

use std::process::Command;
use std::time::{Duration, Instant};

use freerig::daemon::api::Arm;

use super::place::{LONG, runtime};
use super::{attempt, hold};

#[test]
fn a_daemon_that_gets_no_more_memory_ends_or_answers_and_the_rig_is_vented_after_it() {
    attempt(|place| {
        let mut daemon = place.daemon();
        let client = place.client();
        runtime().block_on(client.arm(Arm { accept_margin: true })).unwrap();
        // A run takes far more than what is left now.
        let data = (daemon.memory("VmData") + 2.0) * 1024.0 * 1024.0;
        let limited = Command::new("prlimit")
            .args(["--pid", &daemon.0.id().to_string(), &format!("--data={}", data as u64)])
            .status();
        if !limited.is_ok_and(|status| status.success()) {
            eprintln!("skipped: no prlimit here");
            return;
        }
        runtime().block_on(client.start(&hold())).ok();
        let end = Instant::now() + Duration::from_secs(3);
        while Instant::now() < end && daemon.0.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(50));
        }
        let ended = daemon.0.try_wait().unwrap();
        eprintln!("with 2 MiB more than it had: {ended:?}");
        if ended.is_none() {
            // It lives: then it answers, and ends when it is told to.
            let begun = Instant::now();
            place.command(&["status"]);
            assert!(begun.elapsed() < LONG);
            daemon.signal("-TERM");
            daemon.ended();
        }
        // What the unit does when the daemon has ended, however it has.
        assert!(place.expect(&["vent"], 0).contains("paper: commanded to zero"));
        let daemon = place.daemon();
        assert_eq!(place.status().faults, []);
        drop(daemon);
    });
}

//! SIGTERM in every state of the life cycle: it ends vented, with status 0, in time.

use std::process::Command;
use std::time::{Duration, Instant};

use super::place::{Daemon, PROGRAM, Place, runtime};
use super::{attempt, hold, until};
use freerig::daemon::api::Start;

/// What systemd waits before it kills.
fn stop_time() -> Duration {
    let unit = include_str!("../../systemd/freerig.service");
    let seconds = unit.lines().find_map(|line| line.strip_prefix("TimeoutStopSec=")?.strip_suffix('s'));
    Duration::from_secs(seconds.unwrap().parse().unwrap())
}

/// Terminates `daemon`, which must end in order.
fn terminate(place: &Place, daemon: &mut Daemon, state: &str) {
    let begun = Instant::now();
    daemon.signal("-TERM");
    assert_eq!(daemon.ended(), Some(0), "{state}: {}", place.log());
    assert!(begun.elapsed() < stop_time(), "{state}: {:?}", begun.elapsed());
    assert!(place.log().contains("stopped: vented and verified"), "{state}: {}", place.log());
    assert!(!place.path("runs/control.sock").exists(), "{state}");
}

#[test]
fn from_the_first_moment_on_a_start_is_ended_in_order() {
    attempt(|place| {
        for delay in [0, 100, 300, 600] {
            let mut command = Command::new(PROGRAM);
            command.arg("run");
            let mut daemon = place.spawned(command);
            until("locked", || place.path("runs/control.sock.lock").exists());
            std::thread::sleep(Duration::from_millis(delay));
            terminate(place, &mut daemon, "start");
            std::fs::remove_file(place.path("runs/control.sock.lock")).unwrap();
        }
    });
}

#[test]
fn from_every_state_a_terminated_daemon_ends_vented() {
    for state in ["disarmed", "arming", "hold", "track", "ramp_down", "identify", "faulting", "faulted"] {
        attempt(|place| {
            let mut daemon = place.daemon();
            let client = place.client();
            let mut asked = Vec::new();
            match state {
                "disarmed" => {}
                "arming" => asked.push(place.background(&["arm", "--accept-margin"])),
                _ => {
                    place.expect(&["arm", "--accept-margin"], 0);
                }
            }
            match state {
                "ramp_down" | "track" => {
                    runtime().block_on(client.start(&hold())).unwrap();
                }
                // Nobody's heart beats: its pressure goes down as with `client_lost`.
                "faulting" => {
                    runtime().block_on(client.start(&Start { detach: false, ..hold() })).unwrap();
                }
                "identify" => asked.push(place.background(&["calibrate", "damping"])),
                _ => {}
            }
            match state {
                "ramp_down" => {
                    let command = || runtime().block_on(client.status()).unwrap().frees[0].command_pa;
                    until("under pressure", || command() > 1e3);
                    asked.push(place.background(&["disarm"]));
                }
                "faulted" => {
                    place.command(&["estop"]);
                }
                _ => {}
            }
            // Over the socket: a state that does not last is over before a command has been started.
            let runtime = runtime();
            until(state, || runtime.block_on(client.status()).unwrap().state == state);
            terminate(place, &mut daemon, state);
        });
    }
}

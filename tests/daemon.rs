//! The daemon in real time, as its users meet it: the program itself, its commands, its socket, its signals.
//!
//! Nothing here is about time: every wait is generous, and the loop runs at 100 Hz. A machine that stalls for as long
//! as a device may be silent makes the rig fault all the same, as it must; such an attempt is made again.

use std::fs::File;
use std::io::BufReader;
use std::os::unix::net::UnixDatagram;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use freerig::daemon::api::{Arm, Happening, ProblemKind, RunResult, Start, Status};
use freerig::daemon::client::ClientError;
use freerig::daemon::{Bench, Live, RigLock, Switches, procedure};
use freerig::record::{RRD_NAME, Run};
use freerig::signal::State;
use rerun::external::re_log_encoding::DecoderApp;
use rerun::log::LogMsg;

#[path = "daemon/place.rs"]
mod place;

use place::{Daemon, LONG, PROGRAM, Place, attempt, runtime};

/// A long experiment that asks for little.
const HOLD: &str = "kind = \"sweep\"\npressures_psi = [2]\nmove_s = 0.5\nhold_s = 30\nand_back = false\n";

fn start(detach: bool) -> Start {
    Start { kind: "sweep".into(), experiment: HOLD.into(), detach, ..Start::default() }
}

#[test]
fn a_person_who_aborts_a_calibration_finds_the_rig_vented_and_disarmed_and_the_old_calibration() {
    attempt(|place| {
        place.rewrite(|text| text.replace("ramp_time_s = 3.0", "ramp_time_s = 0.5"));
        let _daemon = place.daemon();
        let file = place.path("calibration/paper.toml");
        let before = std::fs::read_to_string(&file).unwrap();
        for what in ["imu", "regulator", "stiffness", "damping"] {
            place.expect(&["arm", "--accept-margin"], 0);
            let log = File::options().create(true).append(true).open(place.path("log")).unwrap();
            let mut command = Command::new(PROGRAM);
            command.args(["calibrate", what]).current_dir(place.folder.path());
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
            let mut calibration = Daemon(command.spawn().unwrap());
            place.until(what, |status| status.run.as_ref().is_some_and(|run| run.elapsed_s > 0.8));
            calibration.signal("-INT");
            assert_eq!(calibration.ended(), Some(1), "{what}: {}", place.log());
            let status = place.status();
            assert_eq!((status.state.as_str(), status.frees[0].vented), ("disarmed", Some(true)), "{what}: {status:?}");
            assert_eq!(std::fs::read_to_string(&file).unwrap(), before, "{what}");
        }
    });
}

#[test]
fn a_sensors_profile_is_read_from_a_disarmed_rig_only() {
    attempt(|place| {
        let _daemon = place.daemon();
        let client = place.client();
        runtime().block_on(async {
            client.arm(Arm { accept_margin: true }).await.unwrap();
            match client.profile("paper").await {
                Err(ClientError::Problem(problem)) => assert_eq!(problem.kind, ProblemKind::Refused, "{problem}"),
                other => panic!("{other:?}"),
            }
            client.disarm().await.unwrap();
            // The gyro has rested long enough to be armed: the sensor has found its offsets.
            let profile = client.profile("paper").await.unwrap().profile.unwrap();
            assert!(profile.sensor_id != [0; 16] && profile.registers != [0; 22]);
            match client.profile("other").await {
                Err(ClientError::Problem(problem)) => assert_eq!(problem.kind, ProblemKind::Usage, "{problem}"),
                other => panic!("{other:?}"),
            }
            // The readings are back.
            client.arm(Arm { accept_margin: true }).await.unwrap();
        });
    });
}

#[test]
fn the_commands_take_a_rig_through_its_day() {
    attempt(|place| {
        let mut daemon = place.daemon();
        let text = place.expect(&["status"], 0);
        for part in ["disarmed", "SIMULATED", "paper", "BNO055", "Alicat"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(place.expect(&["set", "pressure", "1psi"], 1).contains("not armed"));
        place.expect(&["arm", "--accept-margin"], 0);
        let text = place.expect(&["set", "pressure", "2psi", "--free", "paper"], 0);
        assert!(text.contains("SIMULATED paper") && text.contains("commanded 2.00 psi"), "{text}");
        assert!(place.expect(&["set", "pressure", "40psi"], 2).contains("0 to 10.00 psi"));
        assert!(place.expect(&["set", "pressure", "1psi", "--free", "other"], 2).contains("this rig has: paper"));
        let status = place.status();
        assert_eq!((status.state.as_str(), status.run), ("hold", None));
        assert_eq!(status.frees[0].vented, Some(false));
        place.expect(&["disarm"], 0);
        assert_eq!(place.status().frees[0].vented, Some(true));

        place.expect(&["arm", "--accept-margin"], 0);
        place.expect(&["set", "pressure", "2psi"], 0);
        assert!(place.expect(&["estop"], 0).contains("vented: paper at"));
        for command in ["arm", "disarm"] {
            assert!(place.expect(&[command], 3).contains("emergency_stop"));
        }
        assert!(place.expect(&["status"], 0).contains("fault, latched: emergency_stop"));
        place.expect(&["clear"], 0);
        place.expect(&["arm", "--accept-margin"], 0);

        daemon.signal("-USR1");
        place.until("faulted", |status| status.state == "faulted" && status.faults[0].name == "emergency_stop");
        place.expect(&["clear"], 0);
        place.expect(&["arm", "--accept-margin"], 0);
        place.expect(&["set", "pressure", "2psi"], 0);
        daemon.signal("-TERM");
        assert_eq!(daemon.ended(), Some(0), "{}", place.log());
        assert!(place.log().contains("stopped: vented and verified"), "{}", place.log());
        assert!(!place.path("runs/control.sock").exists() && !place.path("runs/control.sock.estop").exists());
        for run in Run::list(&place.path("runs")).unwrap() {
            assert_eq!(run.unwrap().result_name(), "done");
        }
    });
}

#[test]
fn a_rig_has_one_owner() {
    attempt(|place| {
        let _daemon = place.daemon();
        for command in ["run", "vent"] {
            let text = place.expect(&[command], 1);
            assert!(text.contains("another freerig owns this rig") && text.contains("freerig estop"), "{text}");
        }
        assert_eq!(place.status().state, "disarmed", "the owner was not disturbed");
    });
}

#[test]
fn without_a_daemon_vent_vents_and_the_commands_say_what_is_missing() {
    attempt(|place| {
        let text = place.expect(&["vent"], 0);
        assert!(text.contains("SIMULATED") && text.contains("paper: vented"), "{text}");
        let output = place.command(&["vent", "--json"]);
        let value: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&value["vented"], &value["simulated"]), (&true.into(), &true.into()), "{value}");
        for command in ["status", "arm", "disarm", "clear", "estop"] {
            let text = place.expect(&[command], 1);
            assert!(text.contains("no freerig daemon runs here") && text.contains("freerig run"), "{text}");
        }
    });
}

#[test]
fn bad_usage_and_bad_configuration_have_status_2_and_start_nothing() {
    let place = Place::new();
    place.expect(&["set", "pressure", "3"], 2);
    place.expect(&["status", "--rig", "nowhere.toml"], 2);
    place.rewrite(|text| text.replace("vent_time_s = 1.5", "vent_time_s = -1").replace("seed = 1", "sead = 1"));
    for command in ["run", "vent"] {
        let text = place.expect(&[command], 2);
        assert!(text.contains("vent_time_s") && text.contains("sead") && text.contains("remedy"), "{text}");
    }
    assert!(!place.path("runs/control.sock.lock").exists());
    // Who wants to stop a running rig is not kept from it by a mistake in a file.
    assert!(place.expect(&["estop"], 1).contains("no freerig daemon runs here"));
}

#[test]
fn an_attended_run_ends_with_its_client_and_a_detached_one_does_not() {
    attempt(|place| {
        let _daemon = place.daemon();
        place.expect(&["arm", "--accept-margin"], 0);
        let client = place.client();
        let run = runtime().block_on(client.start(&start(true))).unwrap().run.unwrap();
        assert!(!run.attended);
        // Nobody says anything for longer than a client may be silent.
        let status = place.until("further", |status| status.run.as_ref().is_some_and(|run| run.elapsed_s > 2.5));
        assert_eq!(status.state, "track");
        place.expect(&["disarm"], 0);
        place.until("over", |status| status.run.is_none());
        assert_eq!(Run::open(&place.path(&run.folder)).unwrap().result_name(), "aborted");

        place.expect(&["arm", "--accept-margin"], 0);
        let run = runtime().block_on(async {
            let run = client.start(&start(false)).await.unwrap().run.unwrap();
            assert!(run.attended);
            let end = Instant::now() + Duration::from_secs(3);
            while Instant::now() < end {
                client.heartbeat(&run.id).await.unwrap();
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
            run
        });
        assert_eq!(place.status().state, "track", "a client that is heard keeps it going");
        let status = place.until("faulted", |status| status.state == "faulted");
        assert_eq!(status.faults[0].name, "client_lost");
        assert_eq!(status.frees[0].command_pa, 0.0);
        place.until("over", |status| status.run.is_none());
        let run = Run::open(&place.path(&run.folder)).unwrap();
        assert_eq!(run.result_name(), "fault");
        assert!(run.stop().unwrap().message.contains("client_lost"), "{:?}", run.stop());
    });
}

#[test]
fn one_thing_at_a_time_and_a_stop_at_any_time() {
    attempt(|place| {
        let _daemon = place.daemon();
        let client = place.client();
        let runtime = runtime();
        let refused = |result: Result<_, ClientError>| match result {
            Err(ClientError::Problem(problem)) => problem,
            other => panic!("{other:?}"),
        };
        let problem = refused(runtime.block_on(client.start(&start(true))));
        assert_eq!((problem.kind, problem.error.as_str()), (ProblemKind::Refused, "the rig is not armed"));
        assert_eq!(refused(runtime.block_on(client.stop())).error, "no experiment is running");
        let nonsense = Start { experiment: "kind = \"sweep\"\npressures_psi = [99]\nsped = 1".into(), ..start(true) };
        let problem = refused(runtime.block_on(client.start(&nonsense)));
        assert!(problem.error.contains("99") && problem.error.contains("sped"), "{problem:?}");
        assert_eq!(Run::list(&place.path("runs")).unwrap().len(), 0, "what is refused leaves no run");

        runtime.block_on(client.arm(Arm { accept_margin: true })).unwrap();
        let finished: RunResult = runtime.block_on(async {
            let mut events = client.events().await.unwrap();
            let run = client.start(&start(true)).await.unwrap().run.unwrap();
            assert_eq!(client.status().await.unwrap().run.unwrap().id, run.id);
            let problem = refused(client.start(&start(true)).await);
            assert_eq!(problem.kind, ProblemKind::Busy, "{problem:?}");
            client.stop().await.unwrap();
            let mut begun = false;
            loop {
                match events.next().await.unwrap().unwrap().what {
                    Happening::RunStarted(started) => begun = started.id == run.id,
                    Happening::RunFinished(result) if result.id == run.id => {
                        assert!(begun);
                        return result;
                    }
                    _ => {}
                }
            }
        });
        assert_eq!(finished.outcome, "aborted");
        assert_eq!(place.until("over", |status| status.run.is_none()).state, "hold", "the pressures hold");
        runtime.block_on(client.start(&start(true))).unwrap();
        place.expect(&["estop"], 0);
        place.until("over", |status| status.run.is_none() && status.state == "faulted");
    });
}

#[test]
fn a_killed_daemon_leaves_a_readable_run_and_the_next_one_starts_disarmed_and_vented() {
    attempt(|place| {
        let mut daemon = place.daemon();
        place.expect(&["arm", "--accept-margin"], 0);
        let run = runtime().block_on(place.client().start(&start(true))).unwrap().run.unwrap();
        place.until("further", |status| status.run.as_ref().is_some_and(|run| run.elapsed_s > 1.5));
        daemon.signal("-KILL");
        assert_eq!(daemon.ended(), None);

        let folder = place.path(&run.folder);
        let killed = Run::open(&folder).unwrap();
        assert_eq!((killed.result_name(), killed.is_complete()), ("incomplete", false));
        let (last, _) = killed.records().unwrap().last().unwrap();
        let last = last.program_time;
        assert!(last > 1.0, "{last} s of 1.5 s are there");
        let file = BufReader::new(File::open(folder.join(RRD_NAME)).unwrap());
        let messages: Vec<_> = DecoderApp::decode_lazy(file).map_while(Result::ok).collect();
        assert!(matches!(messages.first(), Some(LogMsg::SetStoreInfo(_))), "run.rrd does not open");
        assert!(messages.len() > 20, "{} messages", messages.len());

        let daemon = place.daemon();
        let status = place.until("vented", |status| status.frees[0].vented == Some(true));
        assert_eq!((status.state.as_str(), status.faults.len(), status.run), ("disarmed", 0, None));
        drop(daemon);
        let runs = Run::list(&place.path("runs")).unwrap();
        assert_eq!(runs.len(), 1, "nothing is lost, nothing is made up");
    });
}

#[test]
fn a_changed_file_is_a_warning_and_refuses_to_arm() {
    attempt(|place| {
        let _daemon = place.daemon();
        place.rewrite(|text| text + "# changed\n");
        let warned = |status: &Status| status.faults.iter().any(|fault| fault.name == "config_changed");
        let status = place.until("warned", warned);
        assert!(!status.is_faulted());
        let text = place.expect(&["arm", "--accept-margin"], 1);
        assert!(text.contains("a configuration file differs"), "{text}");
        place.rewrite(|text| text.replace("# changed\n", ""));
        place.until("calm", |status| !warned(status));
        place.expect(&["arm", "--accept-margin"], 0);
        place.rewrite(|text| text + "# changed\n");
        place.until("warned", warned);
        assert!(place.expect(&["set", "pressure", "1psi"], 1).contains("a configuration file differs"));
    });
}

#[test]
fn a_changed_calibration_is_taken_up_when_the_rig_is_armed_and_a_wrong_one_refused() {
    attempt(|place| {
        let _daemon = place.daemon();
        place.until("disarmed", |status| status.state == "disarmed");
        let file = place.path("calibration/paper.toml");
        let before = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, before.replace("value = 0.086,", "value = -1.0,")).unwrap();
        let text = place.expect(&["arm", "--accept-margin"], 2);
        assert!(text.contains("torsional_stiffness_nm_per_rad") && text.contains("-1"), "{text}");
        assert_eq!(place.status().state, "disarmed");
        std::fs::write(&file, before.replace("value = 0.086,", "value = 0.2, simulated_nominal = 0.086,")).unwrap();
        place.expect(&["arm", "--accept-margin"], 0);
        // What is loaded now is what is there: nothing stands in the way.
        place.expect(&["set", "pressure", "1psi"], 0);
        assert!(place.log().contains("taking up the changed calibration"));
        // While armed, a change is none of the loop's business until it is armed again.
        std::fs::write(&file, &before).unwrap();
        let warned = |status: &Status| status.faults.iter().any(|fault| fault.name == "config_changed");
        place.until("warned", warned);
        assert!(place.expect(&["set", "pressure", "1psi"], 1).contains("a configuration file differs"));
        place.expect(&["disarm"], 0);
        place.expect(&["arm", "--accept-margin"], 0);
    });
}

#[test]
fn devices_that_are_not_there_keep_it_from_arming_and_the_vent_from_being_verified() {
    attempt(|place| {
        place.rewrite(|text| {
            let text =
                text.replace("backend = \"sim\"", "backend = \"linux\"").replace("/dev/i2c-1", "/nonexistent/i2c");
            text.replace("/dev/serial/by-id/usb-FTDI_FT232R_USB_UART-if00-port0", "/nonexistent/tty")
        });
        let text = place.expect(&["vent"], 3);
        assert!(text.contains("paper: NOT verified") && text.contains("/nonexistent/tty"), "{text}");
        assert!(text.contains("remedy") && !text.contains("SIMULATED"), "{text}");
        let mut daemon = place.booting(&[]);
        assert_eq!(place.status().state, "boot");
        let text = place.expect(&["arm", "--accept-margin"], 1);
        assert!(text.contains("/nonexistent/i2c") && text.contains("/nonexistent/tty"), "{text}");
        place.expect(&["estop"], 3);
        daemon.signal("-TERM");
        assert_eq!(daemon.ended(), Some(3));
        assert!(place.log().contains("the pressure of paper is not known"), "{}", place.log());
    });
}

#[test]
fn a_terminated_daemon_has_seen_the_pressure_go_before_it_ends() {
    for state in ["disarmed", "arming", "hold", "track", "ramp_down"] {
        attempt(|place| {
            let mut daemon = place.daemon();
            let mut asked = Vec::new();
            match state {
                "disarmed" => {}
                "arming" => asked.push(place.background(&["arm", "--accept-margin"])),
                _ => {
                    place.expect(&["arm", "--accept-margin"], 0);
                    place.expect(&["set", "pressure", "2psi"], 0);
                }
            }
            match state {
                "track" => {
                    runtime().block_on(place.client().start(&start(true))).unwrap();
                }
                "ramp_down" => asked.push(place.background(&["disarm"])),
                _ => {}
            }
            place.until(state, |status| status.state == state);
            daemon.signal("-TERM");
            assert_eq!(daemon.ended(), Some(0), "{state}: {}", place.log());
            assert!(place.log().contains("stopped: vented and verified"), "{state}: {}", place.log());
        });
    }
}

#[test]
fn systemd_is_told_when_it_is_ready_that_it_lives_what_it_does_and_that_it_stops() {
    attempt(|place| {
        let path = place.path("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(LONG)).unwrap();
        let heard = |wanted: &[&str]| {
            let mut missing = wanted.to_vec();
            while !missing.is_empty() {
                let mut buffer = [0; 4096];
                let length = socket.recv(&mut buffer).unwrap_or_else(|error| panic!("{missing:?}: {error}"));
                let text = String::from_utf8_lossy(&buffer[..length]).into_owned();
                missing.retain(|part| !text.contains(part));
            }
        };
        let environment = [("NOTIFY_SOCKET", path.to_str().unwrap()), ("WATCHDOG_USEC", "1000000")];
        let mut daemon = place.booting(&environment);
        heard(&["READY=1", "STATUS=SIMULATED, disarmed", "WATCHDOG=1"]);
        place.expect(&["estop"], 0);
        heard(&["STATUS=SIMULATED, faulted: emergency_stop", "WATCHDOG=1"]);
        daemon.signal("-INT");
        heard(&["STOPPING=1"]);
        assert_eq!(daemon.ended(), Some(0), "{}", place.log());
    });
}

#[test]
fn a_live_rig_boots_arms_disarms_and_stops_vented() {
    attempt(|place| {
        let rig = place.rig();
        let _owner = RigLock::take(&rig, Duration::ZERO).unwrap();
        let live = Live::start(&rig, Switches::default()).unwrap();
        let mut bench = live.bench();
        procedure::arm(&mut bench, &rig, true).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(bench.latest().state, State::Hold);
        procedure::disarm(&mut bench, &rig).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(bench.latest().state, State::Disarmed);
        assert!(live.stop(&rig).unwrap(), "vented");
    });
}

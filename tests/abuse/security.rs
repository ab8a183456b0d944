//! Who may control the rig, where it listens, and what a request cannot reach.

use std::collections::BTreeSet;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use freerig::daemon::api::{Arm, ProblemKind, Set, Start};
use freerig::daemon::client::ClientError;
use freerig::record::Run;

use super::disk::is_root;
use super::place::{PROGRAM, Place, runtime};
use super::{HOLD, attempt, hold};

/// Nobody in particular.
const STRANGER: u32 = 65_534;
/// A group that every system has and that the stranger is no member of.
const GROUP: (&str, u32) = ("daemon", 1);

/// Runs a command as the stranger with `group` as its only one; its exit status, and what it printed.
fn stranger(place: &Place, group: u32, arguments: &[&str]) -> (Option<i32>, String) {
    let mut command = Command::new(PROGRAM);
    // As root, this leaves no other group.
    command.args(arguments).current_dir(place.folder.path()).uid(STRANGER).gid(group);
    let output = command.output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

fn allow(path: &Path, mode: u32) {
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
}

#[test]
fn another_user_is_refused_by_file_and_by_credentials_and_a_member_of_the_group_is_not() {
    let may_run = Command::new(PROGRAM).arg("--version").uid(STRANGER).gid(STRANGER).output();
    if !is_root() || !may_run.is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: only root can be somebody else, who may run the program");
        return;
    }
    attempt(|place| {
        place.rewrite(|text| text.replace("# group = \"freerig\"", &format!("group = \"{}\"", GROUP.0)));
        let _daemon = place.daemon();
        for folder in ["", "runs", "calibration"] {
            allow(&place.path(folder), 0o755);
        }
        let sockets = ["runs/control.sock", "runs/control.sock.estop"].map(|name| place.path(name));
        for socket in &sockets {
            let file = std::fs::metadata(socket).unwrap();
            assert_eq!((file.mode() & 0o777, file.gid()), (0o660, GROUP.1), "{}", socket.display());
        }
        // The file keeps them out, the emergency stop's as well.
        for command in ["status", "arm", "estop"] {
            let (status, text) = stranger(place, STRANGER, &[command]);
            assert!(status == Some(1) && text.contains("you may not open the control socket"), "{command}: {text}");
            assert!(text.contains("become a member of the group"), "{command}: {text}");
        }
        let (status, text) = stranger(place, GROUP.1, &["status"]);
        assert_eq!(status, Some(0), "{text}");
        // Where the file does not, the credentials of the connection do.
        allow(&sockets[0], 0o666);
        for command in ["status", "arm", "disarm", "clear"] {
            let (status, text) = stranger(place, STRANGER, &[command]);
            assert!(status == Some(1) && text.contains(&format!("id {STRANGER} may not control this rig")), "{text}");
        }
        let (status, text) = stranger(place, GROUP.1, &["arm", "--accept-margin"]);
        assert_eq!(status, Some(0), "{text}");
        let status = place.status();
        assert_eq!((status.state.as_str(), status.faults.len()), ("hold", 0), "nobody else has reached it");
        assert!(place.log().contains("turned away"), "{}", place.log());
    });
}

/// Inodes of the sockets that the process `id` has open.
fn sockets(id: u32) -> BTreeSet<String> {
    let files = std::fs::read_dir(format!("/proc/{id}/fd")).unwrap();
    let target = |file: std::io::Result<std::fs::DirEntry>| std::fs::read_link(file.ok()?.path()).ok();
    let names = files.filter_map(target).map(|path| path.display().to_string());
    names.filter_map(|name| Some(name.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned())).collect()
}

#[test]
fn the_daemon_listens_on_loopback_and_nowhere_else() {
    attempt(|place| {
        // Ports that nobody else has at the moment.
        let free = || std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let (page, data) = (free(), free());
        place.rewrite(|text| {
            let text = text.replace("live_view = false", "live_view = true");
            text.replace("page_port = 9090", &format!("page_port = {page}"))
                .replace("data_port = 9876", &format!("data_port = {data}"))
        });
        let daemon = place.daemon();
        let own = sockets(daemon.0.id());
        let mut listening = Vec::new();
        for table in ["tcp", "tcp6", "udp", "udp6"] {
            let text = std::fs::read_to_string(format!("/proc/net/{table}")).unwrap_or_default();
            for line in text.lines().skip(1) {
                let columns: Vec<_> = line.split_whitespace().collect();
                // State 0A: listening; 07: a UDP socket that takes from everywhere.
                if matches!(columns[3], "0A" | "07") && own.contains(columns[9]) {
                    listening.push(columns[1].to_owned());
                }
            }
        }
        assert!(listening.iter().any(|address| address.ends_with(&format!(":{page:04X}"))), "{listening:?}");
        assert!(listening.iter().any(|address| address.ends_with(&format!(":{data:04X}"))), "{listening:?}");
        // 127.0.0.1, as the kernel writes it.
        assert!(listening.iter().all(|address| address.starts_with("0100007F:")), "{listening:?}");
    });
}

/// Every file below `folder`, as it is called there.
fn tree(folder: &Path) -> BTreeSet<PathBuf> {
    let mut found = BTreeSet::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() && !path.is_symlink() {
                folders.push(path.clone());
            }
            found.insert(path.strip_prefix(folder).unwrap().to_owned());
        }
    }
    found
}

#[test]
fn no_name_in_a_request_becomes_a_path() {
    attempt(|place| {
        // What would be reached: beside the runs, in their folder, and above.
        std::fs::write(place.path("secret.toml"), "secret = \"never told\"").unwrap();
        let _daemon = place.daemon();
        let client = place.client();
        let runtime = runtime();
        let refused = |answer: Result<_, ClientError>| match answer {
            Err(ClientError::Problem(problem)) => {
                assert!(!format!("{problem:?}").contains("never told"), "{problem:?}");
                problem
            }
            other => panic!("{other:?}"),
        };
        runtime.block_on(async {
            client.arm(Arm { accept_margin: true }).await.unwrap();
            for name in [
                "../secret",
                "../secret.toml",
                "/etc/passwd",
                "..",
                ".",
                "",
                "calibration/paper",
                "paper\0",
                "paper/../paper",
            ] {
                let free = Some(name.to_owned());
                let problem = refused(client.start(&Start { free, ..hold() }).await);
                assert_eq!(problem.kind, ProblemKind::Usage, "{problem}");
                let set = Set { free: name.into(), pressure_pa: Some(1.0), angle_rad: None };
                assert!(refused(client.set(&set).await).error.contains("there is no FREE called"));
                assert!(refused(client.profile(name).await).error.contains("there is no FREE called"));
                assert_eq!(refused(client.heartbeat(name).await).kind, ProblemKind::NotFound);
                let kind = refused(client.start(&Start { kind: name.into(), ..hold() }).await).kind;
                assert_eq!(kind, ProblemKind::Usage);
                let experiment = format!("{HOLD}gains = {name:?}\n").replace("\\0", "\\u0000");
                let problem = refused(client.start(&Start { experiment, ..hold() }).await);
                assert_eq!(problem.kind, ProblemKind::Usage, "{problem}");
            }
            // What is only told may be called anything, and is only told.
            for name in ["../../escaped", "/tmp/escaped", "escaped<script>alert(1)</script>"] {
                let experiment = format!("{}name = {name:?}\n", HOLD.replace("hold_s = 600", "hold_s = 0.1"));
                let source = Some(format!("{name}.toml"));
                let start = Start { experiment, source, note: Some(name.into()), ..hold() };
                let mut events = client.events().await.unwrap();
                client.start(&start).await.unwrap();
                let (_, result) = super::finished(&mut events).await;
                assert_eq!(result.outcome, "done", "{result:?}");
                place_is_free(&client).await;
            }
            // What would move a terminal's cursor, or begin a line of the log, is no name.
            for name in ["\\u001b[2J", "one\\ntwo", "\\u0000", "\\r"] {
                let experiment = format!("{HOLD}name = \"{name}\"\n");
                let problem = refused(client.start(&Start { experiment, ..hold() }).await);
                assert!(problem.error.contains("control characters"), "{problem}");
                let note = serde_json::from_str(&format!("\"{name}\"")).unwrap();
                let problem = client.start(&Start { note: Some(note), experiment: "kind = 1".into(), ..hold() }).await;
                assert_eq!(refused(problem).kind, ProblemKind::Usage);
            }
        });
        let ids: Vec<_> = Run::list(&place.path("runs")).unwrap().into_iter().map(|run| run.unwrap()).collect();
        assert_eq!(ids.len(), 3);
        for path in tree(place.folder.path()) {
            assert!(!path.display().to_string().contains("escaped"), "{}", path.display());
        }
        for run in ids {
            assert!(run.id().ends_with("-sweep-paper") && run.start().title.contains("escaped"), "{}", run.id());
            let report = std::fs::read_to_string(run.folder.join("report.html")).unwrap();
            assert!(report.contains("escaped") && !report.contains("<script"), "{}", run.id());
        }
        assert_eq!(tree(&place.path("calibration")), BTreeSet::from(["paper.toml".into()]));
    });
}

async fn place_is_free(client: &freerig::daemon::client::Client) {
    while client.status().await.unwrap().run.is_some() {
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    }
}

#[test]
fn no_unsafe_code_is_allowed_in_the_program_its_tests_and_its_examples() {
    // The compiler refuses it, and `forbid` cannot be taken back further down.
    let manifest: toml::Table = include_str!("../../Cargo.toml").parse().unwrap();
    assert_eq!(manifest["lints"]["rust"]["unsafe_code"].as_str(), Some("forbid"));
    let crates = [include_str!("../../src/lib.rs"), include_str!("../../src/main.rs")];
    assert!(crates.iter().all(|text| text.contains("#![forbid(unsafe_code)]")));
}

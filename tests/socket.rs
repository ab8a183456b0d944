//! The control socket with a stand-in for the supervisor: what clients may do, and what they cannot break.

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use freerig::clock::Time;
use freerig::daemon::api::{Arm, Event, Happening, Problem, ProblemKind, Request, Response, Run, Set, Start, Status};
use freerig::daemon::client::{Client, ClientError};
use freerig::daemon::{Access, Desk, Server, SocketError, desk, estop_path};
use tempfile::TempDir;

struct Bench {
    desk: Desk,
    server: Server,
    client: Client,
    path: PathBuf,
    folder: TempDir,
}

/// A server whose supervisor is the test itself.
fn bench() -> Bench {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let (desk, handle) = desk(Status { state: "disarmed".into(), simulated: true, ..Default::default() });
    let server = Server::open(&path, Access::new(None).unwrap(), handle).unwrap();
    Bench { desk, server, client: Client::new(&path), path, folder }
}

/// Waits until `condition` holds; gives up after 30 s, far beyond anything that is waited for here.
async fn until(condition: impl Fn() -> bool) {
    for _ in 0..6000 {
        if condition() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    panic!("it has not come to pass");
}

/// One raw exchange, for what the client would never send.
fn exchange(path: &Path, request: &[u8]) -> String {
    let mut stream = UnixStream::connect(path).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8(answer).unwrap()
}

async fn post(path: &Path, route: &str, body: impl Into<Vec<u8>>) -> (u16, Problem) {
    let (path, body) = (path.to_owned(), body.into());
    let head =
        format!("POST {route} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {}\r\n\r\n", body.len());
    let request = [head.into_bytes(), body].concat();
    let answer = tokio::task::spawn_blocking(move || exchange(&path, &request)).await.unwrap();
    let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
    let body = answer.split_once("\r\n\r\n").unwrap().1;
    (status, serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {answer}")))
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_reach_the_supervisor_and_its_answers_come_back() {
    let Bench { mut desk, server, client, folder: _folder, .. } = bench();
    let supervisor = tokio::spawn(async move {
        let mut seen = Vec::new();
        while let Some((request, answer)) = desk.requests.recv().await {
            let reply = match &request {
                Request::Arm(Arm { accept_margin: false }) => {
                    Err(Problem::new(ProblemKind::Refused, "the margin is too small", "--accept-margin"))
                }
                Request::Start(start) => Ok(Response {
                    message: "started".into(),
                    run: Some(Run { id: "1".into(), kind: start.kind.clone(), ..Default::default() }),
                    ..Response::default()
                }),
                other => Ok(Response::done(format!("{other:?}"))),
            };
            answer.send(reply).unwrap();
            seen.push(request);
        }
        seen
    });

    match client.arm(Arm::default()).await {
        Err(error @ ClientError::Problem(Problem { kind: ProblemKind::Refused, .. })) => {
            assert_eq!((error.to_string().as_str(), error.remedy()), ("the margin is too small", "--accept-margin"));
        }
        other => panic!("{other:?}"),
    }
    client.arm(Arm { accept_margin: true }).await.unwrap();
    let set = Set { free: "paper".into(), pressure_pa: Some(7.0), angle_rad: None };
    client.set(&set).await.unwrap();
    let start = Start { kind: "step".into(), ..Default::default() };
    assert_eq!(client.start(&start).await.unwrap().run.unwrap().kind, "step");
    client.stop().await.unwrap();
    client.disarm().await.unwrap();
    client.clear().await.unwrap();
    server.stop().await;

    let expected = [
        Request::Arm(Arm::default()),
        Request::Arm(Arm { accept_margin: true }),
        Request::Set(set),
        Request::Start(start),
        Request::Stop,
        Request::Disarm,
        Request::Clear,
    ];
    assert_eq!(supervisor.await.unwrap(), expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn status_and_events_are_streamed() {
    let Bench { desk, server, client, folder: _folder, .. } = bench();
    assert_eq!(client.status().await.unwrap().state, "disarmed");
    let mut states = client.watch().await.unwrap();
    assert_eq!(states.next().await.unwrap().unwrap().state, "disarmed", "a watcher begins with the present");
    desk.status.send_modify(|status| status.state = "arming".into());
    assert_eq!(states.next().await.unwrap().unwrap().state, "arming");

    let mut events = client.events().await.unwrap();
    let event = Event::now(Happening::State { from: "arming".into(), to: "hold".into() });
    desk.events.send(event.clone()).unwrap();
    assert_eq!(events.next().await.unwrap(), Some(event));

    server.stop().await;
    assert!(matches!(events.next().await, Ok(None)), "the streams end with the server");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_heartbeat_counts_only_for_the_run_in_progress() {
    let Bench { desk, client, server: _server, folder: _folder, .. } = bench();
    match client.heartbeat("1").await {
        Err(ClientError::Problem(Problem { kind: ProblemKind::NotFound, .. })) => {}
        other => panic!("{other:?}"),
    }
    assert_eq!(desk.heartbeat.get(), Time::ZERO);
    desk.status.send_modify(|status| status.run = Some(Run { id: "1".into(), ..Default::default() }));
    client.heartbeat("1").await.unwrap();
    assert!(desk.heartbeat.get() > Time::ZERO);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sockets_belong_to_owner_and_group_only_and_go_with_the_server() {
    let Bench { server, path, folder: _folder, .. } = bench();
    for socket in [&path, &estop_path(&path)] {
        assert_eq!(std::fs::metadata(socket).unwrap().permissions().mode() & 0o777, 0o660, "{}", socket.display());
    }
    server.stop().await;
    assert!(!path.exists() && !estop_path(&path).exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_too_large_or_malformed_is_refused_with_a_reason_and_does_not_reach_the_supervisor() {
    let Bench { mut desk, path, server: _server, client, folder: _folder, .. } = bench();
    for (route, body, status, reason) in [
        ("/v1/set", vec![b' '; 65 * 1024], 400, "larger than 64 KiB"),
        ("/v1/set", b"{\"free\": \"paper\", ".to_vec(), 400, "EOF"),
        ("/v1/set", b"\xff\xfe".to_vec(), 400, "line 1 column 1"),
        ("/v1/set", b"{}".to_vec(), 400, "missing field `free`"),
        ("/v1/set", br#"{"free": "paper"}"#.to_vec(), 400, "exactly one"),
        ("/v1/set", br#"{"free": "paper", "pressure_pa": 1, "angle_rad": 1}"#.to_vec(), 400, "exactly one"),
        ("/v1/arm", br#"{"force": true}"#.to_vec(), 400, "unknown field `force`"),
        ("/v1/fire", Vec::new(), 404, "nothing at this address"),
        ("/v1/status", Vec::new(), 400, "another method"),
    ] {
        let (got, problem) = post(&path, route, body).await;
        assert_eq!(got, status, "{problem:?}");
        assert!(problem.error.contains(reason), "{problem:?}");
        assert!(!problem.remedy.is_empty());
    }
    let answer = tokio::task::spawn_blocking(move || exchange(&path, b"\0\0 no HTTP at all \r\n\r\n")).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 400"), "{answer}");
    assert!(desk.requests.try_recv().is_err());
    client.status().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_thousand_malformed_and_oversized_requests_reach_nobody_and_cost_nothing() {
    let Bench { mut desk, path, server: _server, client, folder: _folder, .. } = bench();
    let open_files = || std::fs::read_dir("/proc/self/fd").unwrap().count();
    let before = open_files();
    let fill = |length: usize| "x".repeat(length);
    let requests = [
        String::new(),
        "\r\n\r\n".into(),
        "\0\x01\x02 not HTTP\r\n\r\n".into(),
        "GET /v1/status HTTP/9.9\r\nhost: x\r\n\r\n".into(),
        "POST /v1/arm HTTP/1.1\r\nhost: x\r\ncontent-length: -1\r\n\r\n".into(),
        "POST /v1/arm HTTP/1.1\r\nhost: x\r\ncontent-length: 99999999999999999999\r\n\r\n".into(),
        "POST /v1/arm HTTP/1.1\r\nhost: x\r\ntransfer-encoding: chunked\r\n\r\nzz\r\n".into(),
        // Announced, and never sent.
        "POST /v1/set HTTP/1.1\r\nhost: x\r\ncontent-length: 1000\r\n\r\n{".into(),
        format!("POST /v1/set HTTP/1.1\r\nhost: x\r\ncontent-length: 3000000\r\n\r\n{}", fill(200_000)),
        format!("GET /{} HTTP/1.1\r\nhost: x\r\n\r\n", fill(500_000)),
        format!("GET /v1/status HTTP/1.1\r\nhost: x\r\n{}\r\n", "a: b\r\n".repeat(10_000)),
        // As deep as a body may be long.
        format!("POST /v1/set HTTP/1.1\r\nhost: x\r\ncontent-length: 60000\r\n\r\n{}", "[".repeat(60_000)),
    ];
    let flood = move |begin: usize| {
        for index in begin..begin + 2500 {
            let mut stream = UnixStream::connect(&path).unwrap();
            // Refused, or cut off, while it is still being sent.
            stream.write_all(requests[index % requests.len()].as_bytes()).ok();
            // Every other one does not even wait for what it is told.
            if index % 2 == 0 {
                stream.shutdown(std::net::Shutdown::Write).ok();
                stream.read_to_end(&mut Vec::new()).ok();
            }
        }
    };
    let floods: Vec<_> = (0..4)
        .map(|part| {
            tokio::task::spawn_blocking({
                let flood = flood.clone();
                move || flood(part * 2500)
            })
        })
        .collect();
    for part in floods {
        part.await.unwrap();
    }
    assert_eq!(client.status().await.unwrap().state, "disarmed");
    assert!(desk.requests.try_recv().is_err(), "nothing of it has reached the supervisor");
    until(|| open_files() <= before + 2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_emergency_stop_passes_stuck_requests_and_a_full_house() {
    let Bench { desk, client, path, server: _server, folder: _folder, .. } = bench();
    // The supervisor takes nothing: the queue fills up, the rest is told so.
    let asking: Vec<_> = (0..20)
        .map(|_| {
            let client = client.clone();
            tokio::spawn(async move { client.arm(Arm::default()).await })
        })
        .collect();
    until(|| desk.requests.len() == 16).await;
    // Idle connections take every seat that is left, and more.
    let crowd: Vec<_> = (0..80).map(|_| UnixStream::connect(&path).unwrap()).collect();

    assert!(!desk.estop.load(Ordering::SeqCst));
    let answer = tokio::task::spawn_blocking(move || client.estop()).await.unwrap().unwrap();
    assert!(desk.estop.load(Ordering::SeqCst), "{answer:?}");

    drop(crowd);
    drop(desk);
    let mut busy = 0;
    for answer in asking {
        match answer.await.unwrap() {
            Err(ClientError::Problem(problem)) if problem.kind == ProblemKind::Busy => busy += 1,
            Err(ClientError::Problem(problem)) => assert_eq!(problem.kind, ProblemKind::Failed),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(busy, 4, "twenty asked, sixteen may wait");
}

#[tokio::test(flavor = "multi_thread")]
async fn connecting_is_the_stop_whatever_is_sent() {
    for bytes in [&b""[..], b"\0garbage", &[b'x'; 100_000]] {
        let Bench { desk, path, server: _server, folder: _folder, .. } = bench();
        tokio::task::spawn_blocking(move || {
            let mut stream = UnixStream::connect(estop_path(&path)).unwrap();
            // The answer may come, and the connection close, before everything is sent.
            stream.write_all(bytes).ok();
        })
        .await
        .unwrap();
        until(|| desk.estop.load(Ordering::SeqCst)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_that_takes_nothing_is_dropped_and_disturbs_nobody() {
    let Bench { desk, client, path, server: _server, folder: _folder, .. } = bench();
    let mut slow = UnixStream::connect(&path).unwrap();
    slow.write_all(b"GET /v1/events HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
    until(|| desk.events.receiver_count() > 0).await;
    let mut quick = client.events().await.unwrap();
    let text = "x".repeat(64 * 1024);
    for _ in 0..40 {
        desk.events.send(Event::now(Happening::Warning { text: text.clone(), remedy: String::new() })).unwrap();
        // Far more than a socket's buffers hold; a reader that reads gets all of it.
        assert!(matches!(quick.next().await, Ok(Some(Event { what: Happening::Warning { .. }, .. }))));
        client.status().await.unwrap();
    }
    until(|| desk.events.receiver_count() == 1).await;
    let received = tokio::task::spawn_blocking(move || {
        let mut bytes = Vec::new();
        slow.read_to_end(&mut bytes).map(|_| bytes.len()).unwrap_or(bytes.len())
    });
    assert!(received.await.unwrap() < 40 * text.len(), "the slow one was cut off");
    client.status().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stale_socket_is_replaced_a_live_one_and_another_file_are_not() {
    let Bench { server, path, client, folder: _folder, .. } = bench();
    let open = |path: &Path| Server::open(path, Access::new(None).unwrap(), desk(Status::default()).1);
    assert!(matches!(open(&path), Err(SocketError::InUse(_))));
    client.status().await.unwrap();
    server.stop().await;

    // What a killed daemon leaves behind: the files, and nobody who listens.
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    drop(std::os::unix::net::UnixListener::bind(estop_path(&path)).unwrap());
    assert!(matches!(client.status().await, Err(ClientError::NoDaemon(_))));
    let server = open(&path).unwrap();
    client.status().await.unwrap();
    server.stop().await;

    std::fs::write(&path, "precious").unwrap();
    assert!(matches!(open(&path), Err(SocketError::InTheWay(_))));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
}

#[tokio::test]
async fn without_a_daemon_the_client_says_so_and_what_to_do() {
    let client = Client::new(Path::new("/nonexistent/control.sock"));
    for error in [client.status().await.unwrap_err(), client.estop().unwrap_err()] {
        assert!(matches!(error, ClientError::NoDaemon(_)));
        assert!(error.to_string().contains("no freerig daemon runs here"), "{error}");
        assert!(error.remedy().contains("freerig run"), "{}", error.remedy());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_for_nothing_or_for_more_than_one_thing_keeps_no_seat() {
    let Bench { client, path, server: _server, folder: _folder, .. } = bench();
    // More than there are seats: silent ones, and ones that never end their request's head.
    let mut crowd: Vec<_> = (0..80).map(|_| UnixStream::connect(&path).unwrap()).collect();
    for (index, stream) in crowd.iter_mut().enumerate() {
        stream.write_all([&b""[..], b"\r\n\r\n\n\n", b"GET /v1/status HTTP/1.1\r\nhost: x\r\n"][index % 3]).unwrap();
    }
    // Twice the five seconds that each may take, for two houses full of them.
    let answer = tokio::time::timeout(Duration::from_secs(20), client.status()).await;
    assert_eq!(answer.expect("the house is full for ever").unwrap().state, "disarmed");
    drop(crowd);
    let twice = b"GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n".repeat(2);
    let answer = tokio::task::spawn_blocking(move || exchange(&path, &twice)).await.unwrap();
    assert_eq!(answer.matches("HTTP/1.1 200").count(), 1, "{answer}");
}

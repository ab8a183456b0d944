//! The live view while a run is recorded: its page and its policy, a frozen tab, and a record that none of it harms.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use freerig::record::{LiveOptions, LiveView, Run, RunKind, StopDocument};
use freerig::trajectory::Program;

#[path = "record/fixture.rs"]
mod fixture;

/// One request to the page's port; head and body of the answer.
fn get(port: u16, path: &str, host: &str) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    (String::from_utf8_lossy(&answer[..end]).to_lowercase(), answer[end + 4..].to_vec())
}

fn port(url: &str) -> u16 {
    url.trim_start_matches("rerun+").trim_start_matches("http://127.0.0.1:").split('/').next().unwrap().parse().unwrap()
}

/// A viewer that asks for the stream as the browser's does (gRPC-web over HTTP/1.1).
fn viewer(port: u16) -> TcpStream {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let body = [0u8; 5];
    let head = format!(
        "POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\
         Content-Type: application/grpc-web+proto\r\nX-Grpc-Web: 1\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(&body).unwrap();
    stream
}

fn record(runs: &std::path::Path, view: &LiveView, seed: u64) -> Run {
    let program = Program::angle(0, freerig::trajectory::paper_trajectory().unwrap()).unwrap();
    let start = fixture::start(RunKind::Trajectory, &["paper"]);
    fixture::run(runs, start, &program, seed, Some(view.feed())).finish(StopDocument::default()).unwrap()
}

#[test]
fn the_page_is_served_while_a_run_is_recorded_and_refers_to_nothing_outside() {
    let runs = tempfile::tempdir().unwrap();
    let view = LiveView::start(&LiveOptions { page_port: 0, data_port: 0, ..LiveOptions::default() }).unwrap();
    let (page, data) = (port(&view.url()), port(&view.data_url()));
    let recording = AtomicBool::new(true);
    thread::scope(|scope| {
        let recorder = scope.spawn(|| {
            let run = record(runs.path(), &view, 1);
            recording.store(false, Ordering::Release);
            run
        });
        let (head, _) = get(page, "/", "127.0.0.1");
        assert!(head.starts_with("http/1.1 307"), "{head}");
        assert!(head.contains(&format!("location: /?url=rerun%2bhttp%3a%2f%2f127.0.0.1%3a{data}%2fproxy")), "{head}");
        let (head, body) = get(page, "/?url=x", &format!("localhost:{page}"));
        assert!(head.starts_with("http/1.1 200"), "{head}");
        let policy = head.lines().find(|l| l.starts_with("content-security-policy")).unwrap().to_owned();
        assert!(policy.contains("default-src 'none'") && policy.contains(&format!("http://127.0.0.1:{data} ")));
        let body = String::from_utf8(body).unwrap();
        for outside in ["src=\"http", "href=\"http", "src=\"//", "href=\"//", "fonts.g"] {
            assert!(!body.contains(outside), "{outside}");
        }
        for file in ["/re_viewer.js", "/re_viewer_bg.wasm"] {
            let (head, body) = get(page, file, "127.0.0.1");
            assert!(head.starts_with("http/1.1 200") && body.len() > 10_000, "{file}: {head}");
        }
        // A page from elsewhere whose name has been pointed here.
        assert!(get(page, "/", "evil.example").0.starts_with("http/1.1 403"));

        // A viewer sees the run while it is recorded, or soon after.
        let mut stream = viewer(data);
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let (mut seen, mut buffer) = (Vec::new(), vec![0; 1 << 16]);
        let wanted = b"/frees/paper/angle/estimate";
        while !seen.windows(wanted.len()).any(|w| w == wanted) {
            let n = stream.read(&mut buffer).unwrap();
            assert!(n > 0, "the stream ended");
            seen.extend_from_slice(&buffer[..n]);
        }
        let run = recorder.join().unwrap();
        assert!(run.is_complete() && run.stop().unwrap().rerun_error.is_empty());
    });
}

/// Addresses, in the kernel's notation, at which somebody listens on `port`.
fn listening(port: u16) -> Vec<String> {
    let wanted = format!("{port:04X}");
    let mut found = Vec::new();
    for table in ["/proc/self/net/tcp", "/proc/self/net/tcp6"] {
        for line in std::fs::read_to_string(table).unwrap_or_default().lines().skip(1) {
            let columns: Vec<_> = line.split_whitespace().collect();
            // State 0A: listening.
            if let Some((address, _)) = columns[1].split_once(':').filter(|(_, p)| *p == wanted && columns[3] == "0A") {
                found.push(address.to_owned());
            }
        }
    }
    // The table is no snapshot: a row may be told twice when sockets come or go between two reads of it.
    found.sort();
    found.dedup();
    found
}

#[test]
fn page_and_data_are_served_on_loopback_only() {
    let view = LiveView::start(&LiveOptions { page_port: 0, data_port: 0, ..LiveOptions::default() }).unwrap();
    for port in [port(&view.url()), port(&view.data_url())] {
        assert_eq!(listening(port), ["0100007F"], "127.0.0.1 and nothing else: port {port}");
    }
}

#[test]
fn a_frozen_tab_is_cut_off_and_harms_neither_the_record_nor_the_end() {
    let runs = tempfile::tempdir().unwrap();
    let view = LiveView::start(&LiveOptions { page_port: 0, data_port: 0, ..LiveOptions::default() }).unwrap();
    let mut frozen = viewer(port(&view.data_url()));
    // More than the sockets between can hold (some megabytes), and longer than the relay's patience of 5 s.
    let begun = Instant::now();
    for seed in 0.. {
        let run = record(runs.path(), &view, seed);
        assert!(run.is_complete() && run.stop().unwrap().rerun_error.is_empty());
        assert_eq!(run.records().unwrap().count() as u64, run.stop().unwrap().records);
        if begun.elapsed() > Duration::from_secs(12) {
            break;
        }
    }
    // What was on its way when it was cut, and then the end: a viewer that is served waits for more.
    frozen.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let mut buffer = vec![0; 1 << 16];
    let mut taken = 0;
    let end = loop {
        match frozen.read(&mut buffer) {
            Ok(0) => break Ok(()),
            Ok(n) => taken += n,
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    assert!(end.is_ok(), "still served after {taken} bytes: {end:?}");
    drop(view);
}

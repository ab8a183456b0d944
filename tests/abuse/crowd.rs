//! Many clients at once, clients that never read, and clients that send nonsense, while a run goes on.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use freerig::daemon::api::{Arm, Problem};
use freerig::record::Run;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::place::{LONG, runtime};
use super::{attempt, finished, hold, until};

const WATCHERS: usize = 8;
const MUTE: usize = 4;
/// What the daemon's memory may grow by under all of it, MiB.
const GROWTH: f64 = 24.0;

#[test]
fn eight_watchers_and_four_who_never_read_leave_a_run_and_each_other_alone() {
    attempt(|place| {
        let daemon = place.daemon();
        let client = place.client();
        let runtime = runtime();
        runtime.block_on(client.arm(Arm { accept_margin: true })).unwrap();
        let id = runtime.block_on(client.start(&hold())).unwrap().run.unwrap().id;
        let mute: Vec<_> = (0..MUTE)
            .map(|_| {
                let mut stream = UnixStream::connect(place.path("runs/control.sock")).unwrap();
                stream.write_all(b"GET /v1/status/stream HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
                stream
            })
            .collect();
        let watchers: Vec<_> = (0..WATCHERS)
            .map(|_| {
                let (client, id) = (client.clone(), id.clone());
                runtime.spawn(async move {
                    let mut states = client.watch().await.unwrap();
                    let mut elapsed = Vec::new();
                    while let Some(status) = states.next().await.unwrap() {
                        match status.run {
                            // Before the program and after it there is no time of its own.
                            Some(run) if run.id == id && run.elapsed_s == 0.0 => {}
                            Some(run) if run.id == id => elapsed.push((run.elapsed_s, Instant::now())),
                            _ => break,
                        }
                    }
                    elapsed
                })
            })
            .collect();
        let dropped = || place.log().matches("takes nothing: dropped").count();
        let before = daemon.memory("VmRSS");
        until("dropped, all of them", || dropped() == MUTE);
        let grown = daemon.memory("VmRSS") - before;
        assert!(grown < GROWTH, "{grown} MiB for {MUTE} clients that do not read");
        // Far less than a watcher gets by then: what the sockets and the server hold for one of them.
        for mut stream in mute {
            let mut taken = Vec::new();
            stream.read_to_end(&mut taken).ok();
            assert!(taken.len() < 2 << 20, "{} bytes were kept for it", taken.len());
        }
        let mut events = runtime.block_on(client.events()).unwrap();
        runtime.block_on(client.stop()).unwrap();
        let (_, result) = runtime.block_on(finished(&mut events));
        assert_eq!((result.id.as_str(), result.outcome.as_str()), (id.as_str(), "aborted"));
        for watcher in watchers {
            let elapsed = runtime.block_on(watcher).unwrap();
            let (first, last) = (elapsed[0], *elapsed.last().unwrap());
            assert!(elapsed.windows(2).all(|pair| pair[1].0 >= pair[0].0), "the run goes on for everybody");
            // Told ten times a second; half of that leaves room for a busy machine.
            let seconds = (last.1 - first.1).as_secs_f64();
            assert!(elapsed.len() as f64 > 5.0 * seconds, "{} lines in {seconds} s", elapsed.len());
        }
        let run = Run::open(&place.path("runs").join(&id)).unwrap();
        let stop = run.stop().unwrap();
        assert_eq!((stop.lost_records, run.records().unwrap().count() as u64), (0, stop.records));
        assert_eq!(place.status().state, "hold", "{}", place.log());
    });
}

/// Requests that the daemon cannot do: what is sent, and a word of what it is told; none where it may just be cut off.
fn nonsense(random: &mut Pcg64Mcg) -> (Vec<u8>, Option<&'static str>) {
    let junk: String = (0..random.random_range(1..40)).map(|_| random.random_range(' '..='~')).collect();
    let quoted = serde_json::to_string(&junk).unwrap();
    let post = |route: &str, body: String| {
        let head = format!("POST /v1/{route} HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len());
        [head.into_bytes(), body.into_bytes()].concat()
    };
    let get = |route: &str| format!("GET /{route} HTTP/1.1\r\nhost: x\r\n\r\n").into_bytes();
    match random.random_range(0..16) {
        0 => (post("set", format!("{{\"free\": {quoted}")), Some("EOF")),
        1 => (post("set", format!("{{\"free\": {quoted}, \"pressure_pa\": 1e999}}")), Some("out of range")),
        2 => (post("set", format!("{{\"free\": {quoted}, \"pressure_pa\": {quoted}}}")), Some("invalid type")),
        3 => (post("set", format!("{{\"free\": {quoted}}}")), Some("exactly one")),
        4 => (post("set", "{\"free\": \"paper\", \"pressure_pa\": -1e300}".into()), Some("outside 0 to")),
        5 => (post("arm", format!("{{{quoted}: true}}")), Some("unknown field")),
        6 => (post("arm", format!("[{quoted}]")), Some("invalid")),
        7 => (post("start", "[".repeat(random.random_range(1..60_000))), Some("not what this address takes")),
        8 => {
            let start = serde_json::json!({ "kind": "step", "experiment": junk });
            (post("start", start.to_string()), Some("remedy"))
        }
        9 => {
            let start = serde_json::json!({ "kind": junk, "experiment": super::HOLD });
            (post("start", start.to_string()), Some("is a sweep, not a"))
        }
        10 => (post("heartbeat", format!("{{\"run\": {quoted}}}")), Some("is not in progress")),
        11 => (post("profile", format!("{{\"free\": {quoted}}}")), Some("there is no FREE called")),
        12 => (post("set", "x".repeat(random.random_range(66_000..300_000))), Some("larger than 64 KiB")),
        13 => (get(&"../".repeat(random.random_range(1..200))), Some("nothing at this address")),
        14 => (get("v1/arm"), Some("another method")),
        _ => (format!("{junk}\r\n\r\n").into_bytes(), None),
    }
}

/// Sends `count` of them, and looks at what they are told.
fn flood(socket: &Path, seed: u64, count: usize) -> JoinHandle<()> {
    let socket = socket.to_owned();
    std::thread::spawn(move || {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        for _ in 0..count {
            let (request, reason) = nonsense(&mut random);
            let mut stream = UnixStream::connect(&socket).unwrap();
            stream.set_read_timeout(Some(LONG)).unwrap();
            // Refused, or cut off, while it is still being sent.
            stream.write_all(&request).ok();
            if reason.is_none() {
                // Whoever ends the connection gets no answer.
                stream.shutdown(std::net::Shutdown::Write).ok();
            }
            let mut answer = Vec::new();
            let read = stream.read_to_end(&mut answer);
            let answer = String::from_utf8_lossy(&answer);
            let Some(reason) = reason else { continue };
            // What is too large is refused before all of it is read, and the answer may be lost with the rest.
            if read.is_err() && answer.is_empty() && request.len() > 64 * 1024 {
                continue;
            }
            let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{reason}: {read:?}: {answer}"));
            assert!(head.starts_with("HTTP/1.1 4"), "{head}");
            let problem: Problem = serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {body}"));
            assert!(problem.error.contains(reason), "{reason}: {problem:?}");
            assert!(!problem.remedy.is_empty(), "{problem:?}");
        }
    })
}

#[test]
fn ten_thousand_requests_of_nonsense_are_told_what_is_wrong_and_leave_the_daemon_as_it_is() {
    attempt(|place| {
        let daemon = place.daemon();
        let socket = place.path("runs/control.sock");
        // The first ones find allocations that stay.
        flood(&socket, 0, 500).join().unwrap();
        let before = daemon.memory("VmRSS");
        let begun = Instant::now();
        let parts: Vec<_> = (1..=4).map(|seed| flood(&socket, seed, 2375)).collect();
        parts.into_iter().for_each(|part| part.join().unwrap());
        let grown = daemon.memory("VmRSS") - before;
        eprintln!("9500 requests in {:.1} s, {grown:+.1} MiB", begun.elapsed().as_secs_f64());
        assert!(grown < GROWTH, "{grown} MiB");
        let status = place.status();
        assert_eq!((status.state.as_str(), status.faults.len()), ("disarmed", 0), "{}", place.log());
        place.expect(&["arm", "--accept-margin"], 0);
        assert_eq!(Run::list(&place.path("runs")).unwrap().len(), 0);
        std::thread::sleep(Duration::from_millis(100));
        assert!(!place.log().contains("panicked"), "{}", place.log());
    });
}

//! What comes over the control socket: bodies that read back as they were written, and bytes that are no HTTP.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use freerig::daemon::api::{Arm, Heartbeat, Problem, ProfileOf, Response, Set, Start, Status};
use freerig::daemon::client::Client;
use freerig::daemon::{Access, Server, desk};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::super::place::LONG;
use super::{feed, files};

const WORDS: [&str; 16] = [
    "null",
    "true",
    "{}",
    "[]",
    "\"free\": ",
    "\"pressure_pa\": 1",
    "\\u0000",
    "\\ud800",
    "\r\n",
    "\r\n\r\n",
    "content-length: 9\r\n",
    "transfer-encoding: chunked\r\n",
    "expect: 100-continue\r\n",
    "HTTP/1.0",
    "HEAD",
    "/v1/status/stream",
];

/// What is read as a `T` is written and read as the same.
fn reads_back<T: Serialize + DeserializeOwned + PartialEq + std::fmt::Debug>(bytes: &[u8]) -> bool {
    let Ok(read) = serde_json::from_slice::<T>(bytes) else { return false };
    let written = serde_json::to_vec(&read).unwrap();
    assert_eq!(serde_json::from_slice::<T>(&written).unwrap(), read);
    true
}

#[test]
fn whatever_a_body_says_is_refused_or_reads_back() {
    let accepted = feed(files(&["tests/abuse/corpus/bodies"]), &WORDS, 30_000, |bytes| {
        // Not `||`: each of them is to see it.
        reads_back::<Arm>(bytes)
            | reads_back::<Set>(bytes)
            | reads_back::<Start>(bytes)
            | reads_back::<ProfileOf>(bytes)
            | reads_back::<Heartbeat>(bytes)
            | reads_back::<Status>(bytes)
    });
    assert!(accepted > 1000, "only {accepted} are accepted: the mutations are too wild to say anything");
}

#[test]
fn whatever_bytes_come_they_are_answered_or_cut_off_and_the_next_client_is_served() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let (mut desk, handle) = desk(Status { state: "disarmed".into(), ..Status::default() });
    let server = {
        let _inside = runtime.enter();
        Server::open(&path, Access::new(None).unwrap(), handle).unwrap()
    };
    // Does whatever is asked.
    let supervisor = runtime.spawn(async move {
        while let Some((request, answer)) = desk.requests.recv().await {
            let _ = answer.send(Ok(Response::done(format!("{request:?}"))));
        }
    });
    let client = Client::new(&path);
    let accepted = feed(files(&["tests/abuse/corpus/requests"]), &WORDS, 1500, |bytes| {
        let mut stream = UnixStream::connect(&path).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        stream.write_all(bytes).ok();
        stream.shutdown(std::net::Shutdown::Write).ok();
        let mut answer = Vec::new();
        stream.take(1 << 20).read_to_end(&mut answer).ok();
        let answer = String::from_utf8_lossy(&answer);
        let Some((head, body)) = answer.split_once("\r\n\r\n") else {
            assert!(answer.is_empty(), "half an answer: {answer}");
            return false;
        };
        // A client of HTTP/1.0 is answered in it.
        assert!(head.starts_with("HTTP/1."), "{head}");
        if head.split(' ').nth(1) == Some("200") {
            return true;
        }
        // What is no HTTP is told so by its number alone.
        if !body.is_empty() && head.contains("application/json") {
            let problem: Problem = serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {body}"));
            assert!(!problem.error.is_empty() && !problem.remedy.is_empty());
        }
        false
    });
    assert!(accepted > 50, "only {accepted} are accepted: the mutations are too wild to say anything");
    assert_eq!(runtime.block_on(client.status()).unwrap().state, "disarmed");
    runtime.block_on(server.stop());
    supervisor.abort();
    runtime.shutdown_timeout(Duration::from_secs(1));
}

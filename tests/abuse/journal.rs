//! What goes into the journal, with its fields.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::attempt;
use super::disk::apart;
use super::place::PROGRAM;

/// The fields of one message: `NAME=value`, or the name, a line's end, and the value by its length.
fn fields(mut bytes: &[u8]) -> BTreeMap<String, String> {
    let mut fields = BTreeMap::new();
    while let Some(end) = bytes.iter().position(|&b| b == b'\n') {
        let (line, rest) = (&bytes[..end], &bytes[end + 1..]);
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        match line.iter().position(|&b| b == b'=') {
            Some(equals) => {
                fields.insert(text(&line[..equals]), text(&line[equals + 1..]));
                bytes = rest;
            }
            None => {
                let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
                fields.insert(text(line), text(&rest[8..8 + length]));
                bytes = &rest[8 + length + 1..];
            }
        }
    }
    fields
}

#[test]
fn the_journal_has_state_run_outcome_and_fault_as_fields() {
    if !apart("mount -t tmpfs tmpfs /mnt").output().is_ok_and(|output| output.status.success()) {
        eprintln!("skipped: nothing can be mounted here");
        return;
    }
    attempt(|place| {
        let folder = place.path("run/systemd/journal");
        std::fs::create_dir_all(&folder).unwrap();
        let journal = UnixDatagram::bind(folder.join("socket")).unwrap();
        journal.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        let ended = Arc::new(AtomicBool::new(false));
        // Who logs waits for whoever reads the journal.
        let reader = std::thread::spawn({
            let ended = Arc::clone(&ended);
            move || {
                let (mut messages, mut buffer) = (Vec::new(), vec![0; 1 << 16]);
                loop {
                    let over = ended.load(Ordering::Acquire);
                    match journal.recv(&mut buffer) {
                        Ok(length) => messages.push(fields(&buffer[..length])),
                        Err(_) if over => return messages,
                        Err(_) => {}
                    }
                }
            }
        });
        // systemd says so where stderr is the journal's.
        let log = File::options().create(true).append(true).open(place.path("log")).unwrap().metadata().unwrap();
        let run = place.path("run");
        let mut command = apart(&format!("mount --bind {} /run && exec {PROGRAM} run", run.display()));
        command.env("JOURNAL_STREAM", format!("{}:{}", log.dev(), log.ino()));
        let mut daemon = place.answering(command);
        place.until("disarmed", |status| status.state == "disarmed");
        place.expect(&["arm", "--accept-margin"], 0);
        place.expect(&["set", "pressure", "1psi"], 0);
        place.expect(&["estop"], 0);
        daemon.signal("-TERM");
        assert_eq!(daemon.ended(), Some(0), "{}", place.log());
        ended.store(true, Ordering::Release);
        let messages = reader.join().unwrap();
        let with = |wanted: &[(&str, &str)]| {
            let has = |message: &&BTreeMap<_, _>, (name, value): &(&str, &str)| {
                message.get(*name).is_some_and(|found: &String| found.contains(value))
            };
            let found = messages.iter().find(|message| wanted.iter().all(|field| has(message, field)));
            assert!(found.is_some(), "{wanted:?} in {messages:#?}");
        };
        with(&[("FREERIG_STATE", "hold"), ("MESSAGE", "-> hold"), ("PRIORITY", "5")]);
        with(&[("FREERIG_RUN", "-set-paper"), ("MESSAGE", "has begun")]);
        with(&[("FREERIG_RUN", "-set-paper"), ("FREERIG_OUTCOME", "done")]);
        with(&[("FREERIG_FAULT", "emergency_stop"), ("PRIORITY", "3"), ("MESSAGE", "freerig clear")]);
        with(&[("MESSAGE", "vented and verified"), ("SYSLOG_IDENTIFIER", "freerig")]);
    });
}

//! The wall clock is set while a run goes on: nothing but the times of day that are told takes notice.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use freerig::clock::Clock;
use freerig::daemon::api::{Arm, Happening};
use freerig::record::Run;

use super::place::runtime;
use super::{attempt, finished, hold};

/// Builds the library that moves the wall clock of the program which it is loaded into.
fn shim(folder: &Path) -> std::path::PathBuf {
    let library = folder.join("wall_clock.so");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/abuse/wall_clock.c");
    // The compiler that rustc links with.
    let built = Command::new("cc").args(["-shared", "-fPIC", "-o"]).arg(&library).arg(source).status().unwrap();
    assert!(built.success());
    library
}

#[test]
fn a_wall_clock_that_is_set_disturbs_neither_the_loop_nor_the_record() {
    attempt(|place| {
        let ahead = |seconds: i64| std::fs::write(place.path("ahead"), seconds.to_string()).unwrap();
        ahead(0);
        let (library, file) = (shim(place.folder.path()), place.path("ahead"));
        let environment = [("LD_PRELOAD", library.to_str().unwrap()), ("WALL_CLOCK", file.to_str().unwrap())];
        let daemon = place.booting(&environment);
        place.until("disarmed", |status| status.state == "disarmed");
        let client = place.client();
        let runtime = runtime();
        const DAY: i64 = 86_400;
        let (begun, ended, result, elapsed) = runtime.block_on(async {
            client.arm(Arm { accept_margin: true }).await.unwrap();
            let mut events = client.events().await.unwrap();
            // Before the run's own beginning, of which the answer may come late.
            let start = Instant::now();
            client.start(&hold()).await.unwrap();
            let begun = loop {
                let event = events.next().await.unwrap().unwrap();
                if matches!(event.what, Happening::RunStarted(_)) {
                    break event.time;
                }
            };
            for seconds in [2 * DAY, -10 * DAY, 3600, -1, 400 * DAY] {
                ahead(seconds);
                tokio::time::sleep(Duration::from_millis(700)).await;
            }
            client.stop().await.unwrap();
            let (ended, result) = finished(&mut events).await;
            (begun, ended, result, start.elapsed())
        });
        let [begun, ended]: [jiff::Timestamp; 2] = [begun, ended].map(|time| time.parse().unwrap());
        assert!(ended.duration_since(begun).as_secs() > 399 * DAY, "the clock was set: {begun}, {ended}");
        assert_eq!(result.outcome, "aborted", "{result:?}");

        let run = Run::open(&place.path("runs").join(&result.id)).unwrap();
        let records: Vec<_> = run.records().unwrap().map(|(record, _)| record).collect();
        for pair in records.windows(2) {
            let (periods, time) = (pair[1].tick - pair[0].tick, pair[1].time.since(pair[0].time));
            assert_eq!(time, Duration::from_millis(10) * periods as u32, "one period a tick, at tick {}", pair[1].tick);
            assert_eq!(periods, 1 + pair[1].skipped - pair[0].skipped);
        }
        let stop = run.stop().unwrap();
        assert!(stop.duration_s <= elapsed.as_secs_f64() && stop.duration_s > 3.0, "{} s", stop.duration_s);
        assert_eq!((stop.lost_records, stop.faults.len()), (0, 0), "{:?}", stop.faults);
        let status = place.status();
        assert_eq!((status.state.as_str(), status.faults.len()), ("hold", 0), "{status:?}");
        assert!(status.uptime_s < 600.0 && Clock::Live.now().as_nanos() > 0);
        // Set back before the run that has just been recorded: the next one is one of its own.
        ahead(-DAY);
        place.expect(&["set", "pressure", "1psi"], 0);
        let ids: Vec<_> = Run::list(&place.path("runs")).unwrap().into_iter().map(|run| run.unwrap()).collect();
        assert!(ids.len() == 2 && ids.iter().all(Run::is_complete), "{}", place.log());
        drop(daemon);
    });
}

/// Where the time of day is asked for: to be told, never to be counted with. Everything else takes the time from
/// [`Clock`].
const TELLERS: [&str; 9] = [
    "src/cli/calibrate/",
    "src/cli/demo.rs",
    "src/daemon/api/status.rs",
    "src/daemon/doctor/kernel.rs",
    "src/daemon/validity.rs",
    "src/record/quota.rs",
    "src/record/run.rs",
    "src/cli/bench/",
    "src/record/bench.rs",
];

#[test]
fn the_time_of_day_is_asked_for_where_it_is_told_and_nowhere_else() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![here.join("src")];
    let mut found = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let name = path.strip_prefix(here).unwrap().to_str().unwrap();
            let text = std::fs::read_to_string(&path).unwrap_or_default();
            if ["SystemTime::now", "Zoned::now", "Timestamp::now", "ClockId::Realtime"].iter().any(|w| text.contains(w))
            {
                assert!(TELLERS.iter().any(|teller| name.starts_with(teller)), "{name} asks for the time of day");
                found += 1;
            }
        }
    }
    assert!(found >= 5, "the search finds nothing any more");
}

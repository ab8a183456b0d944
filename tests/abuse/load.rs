//! Real time with every core busy: no record is lost, and every period that was skipped is explained by what the loop
//! itself has measured.
//!
//! Twenty seconds of it always; five minutes by hand:
//! `cargo test --release --test abuse five_minutes -- --ignored --nocapture`.

use std::collections::BTreeMap;
use std::process::Command;
use std::time::{Duration, Instant};

use freerig::daemon::api::Arm;
use freerig::record::Run;
use freerig::signal::{FaultCode, FaultSet};

use super::place::{Daemon, Place, STALLS, alone, runtime};
use super::{analogue, finished, hold};

/// From here on the regulator's answer may be called stale: one and a half of its periods.
const STALE: Duration = Duration::from_millis(15);

/// Something that keeps a core busy, until it is dropped.
fn burn() -> Daemon {
    Daemon(Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap())
}

/// What the records of all runs say together.
#[derive(Debug, Default)]
struct Books {
    runs: usize,
    records: u64,
    seconds: f64,
    skipped: u64,
    stalls: u64,
    longest_ms: f64,
    outcomes: BTreeMap<String, usize>,
    faults: BTreeMap<String, usize>,
}

/// Reads `run` from its file and holds its figures to each other.
fn audit(run: &Run, books: &mut Books) {
    let records: Vec<_> = run.records().unwrap().map(|(record, _)| record).collect();
    let stop = run.stop().unwrap_or_else(|| panic!("{} has no stop document", run.id()));
    assert_eq!((stop.lost_records, stop.records), (0, records.len() as u64), "{}", run.id());
    let period = Duration::from_millis(2);
    let mut skipped = 0;
    for pair in records.windows(2) {
        let (before, now) = (&pair[0], &pair[1]);
        let lost = now.skipped - before.skipped;
        assert_eq!(now.tick - before.tick, 1 + lost, "every tick is recorded, or counted as skipped: {}", now.tick);
        assert_eq!(now.time.since(before.time), period * (1 + lost) as u32, "at tick {}", now.tick);
        // A period is skipped because the loop woke up late, or because the tick before took too long.
        let late = Duration::from_nanos(now.latency_ns.into()) + Duration::from_nanos(now.execution_ns.into());
        assert!(
            lost == 0 || late >= period * lost as u32,
            "{lost} skipped, and {late:?} measured at tick {}",
            now.tick
        );
        books.stalls += u64::from(lost > 0);
        books.longest_ms = books.longest_ms.max(f64::from(now.latency_ns) * 1e-6);
        skipped += lost;
        // Neither is there a fault without its cause in the record.
        for code in FaultSet(now.latched.0 & !before.latched.0).iter() {
            let recent: Vec<_> = records.iter().filter(|r| r.tick <= now.tick && r.tick + 100 > now.tick).collect();
            let oldest = recent.iter().map(|r| r.time.since(r.frees[0].pressure.time)).max().unwrap_or_default();
            let missed = now.skipped - recent[0].skipped;
            eprintln!("{} at tick {}: {missed} skipped, pressures up to {oldest:?} old", code.name(), now.tick);
            match code {
                FaultCode::Deadline => assert!(missed > 0 || recent.iter().any(|r| r.latency_ns > 500_000)),
                FaultCode::PressureStale => assert!(oldest >= STALE, "{oldest:?}"),
                _ => {}
            }
            *books.faults.entry(code.name().into()).or_default() += 1;
        }
    }
    assert_eq!(stop.loop_statistics.deadline_misses, skipped, "{}", run.id());
    books.runs += 1;
    books.records += stop.records;
    books.seconds += stop.duration_s;
    books.skipped += skipped;
    *books.outcomes.entry(run.result_name().into()).or_default() += 1;
}

/// Records for `duration` with every core busy.
fn under_load(duration: Duration) {
    let _alone = alone();
    let place = Place::new();
    analogue(&place);
    place.rewrite(|text| text.replace("rate_hz = 100", "rate_hz = 500"));
    let daemon = place.daemon();
    let client = place.client();
    let cores = std::thread::available_parallelism().unwrap().get();
    let load: Vec<_> = (0..cores).map(|_| burn()).collect();
    let end = Instant::now() + duration;
    let runtime = runtime();
    // A machine that stands still for longer than a device may be silent ends a run with a fault, as it must: the next
    // one goes on.
    while Instant::now() < end {
        runtime.block_on(async {
            client.clear().await.ok();
            if client.arm(Arm { accept_margin: true }).await.is_err() {
                tokio::time::sleep(Duration::from_millis(200)).await;
                return;
            }
            let mut events = client.events().await.unwrap();
            if client.start(&hold()).await.is_err() {
                return;
            }
            let run = finished(&mut events);
            if tokio::time::timeout(end.saturating_duration_since(Instant::now()), run).await.is_err() {
                client.stop().await.ok();
                finished(&mut events).await;
            }
        });
    }
    drop(load);
    let status = place.until("over", |status| status.run.is_none());
    // The rig is free before the last run's file is closed.
    let runs = || Run::list(&place.path("runs")).unwrap().into_iter().map(Result::unwrap).collect::<Vec<_>>();
    let patience = Instant::now() + Duration::from_secs(30);
    while runs().iter().any(|run| run.stop().is_none()) && Instant::now() < patience {
        std::thread::sleep(Duration::from_millis(100));
    }
    let mut books = Books::default();
    for run in runs() {
        audit(&run, &mut books);
    }
    let tick = &status.tick;
    eprintln!("{cores} cores busy, real time {}: {books:?}", tick.realtime);
    eprintln!("since the start: {} ticks, {} skipped, latency {:?}", tick.ticks, tick.skipped, tick.latency);
    assert!(books.seconds > 0.5 * duration.as_secs_f64(), "{books:?}\n{}", place.log());
    assert!(!place.log().contains("records were lost"), "{}", place.log());
    // The only ones that a busy machine may bring about.
    assert!(books.faults.keys().all(|fault| STALLS.contains(&fault.as_str()) || fault == "bus_lost"), "{books:?}");
    drop(daemon);
}

#[test]
fn twenty_seconds_with_every_core_busy_lose_no_record_and_leave_no_deadline_unexplained() {
    under_load(Duration::from_secs(20));
}

#[test]
#[ignore = "takes five minutes"]
fn five_minutes_with_every_core_busy_lose_no_record_and_leave_no_deadline_unexplained() {
    under_load(Duration::from_secs(300));
}

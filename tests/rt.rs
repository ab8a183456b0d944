//! The periodic thread: its books agree with what its closure saw, it survives nothing silently, and its own
//! machinery allocates nothing. Nothing here asserts how long anything took.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use freerig::rt::{Error, Handle, Realtime, Statistics, Timing, run, spawn};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

const ORDINARY: Realtime = Realtime { period: Duration::from_millis(2), priority: None, cpu: None, lock_memory: false };

fn wait_for(handle: &Handle, ticks: u64) {
    while handle.is_running() && handle.statistics().ticks() < ticks {
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn the_books_agree_with_what_the_closure_saw() {
    let seen = Arc::new(Mutex::new(Vec::<Timing>::with_capacity(10_000)));
    let handle = spawn(ORDINARY, {
        let seen = Arc::clone(&seen);
        move |timing| seen.lock().unwrap().push(*timing)
    })
    .unwrap();
    wait_for(&handle, 100);
    let statistics = handle.statistics();
    handle.join().unwrap();

    let seen = seen.lock().unwrap();
    let ticks = seen.len() as u64;
    assert_eq!(statistics.ticks(), ticks);
    assert_eq!(statistics.latency.snapshot().count(), ticks);
    assert_eq!(statistics.execution.snapshot().count(), ticks);
    assert_eq!(statistics.skipped(), seen.last().unwrap().skipped);
    assert_eq!(statistics.latency.max(), seen.iter().map(|t| u64::from(t.latency_ns)).max().unwrap());
    let start = seen[0].deadline.as_nanos() - 2_000_000 * seen[0].tick;
    for (served, timing) in seen.iter().enumerate() {
        assert_eq!(timing.tick, served as u64 + timing.skipped, "every period is served or counted as skipped");
        assert_eq!(timing.deadline.as_nanos(), start + 2_000_000 * timing.tick, "the phase is kept");
        assert!(timing.woke >= timing.deadline);
        assert!(u128::from(timing.latency_ns) >= timing.woke.since(timing.deadline).as_nanos());
    }
    assert!(seen.iter().skip(1).all(|t| t.execution_ns > 0), "each tick is told what its predecessor took");
}

#[test]
fn a_tick_that_overruns_costs_whole_periods_and_is_counted() {
    let handle = spawn(ORDINARY, |timing| {
        if timing.tick < 5 {
            std::thread::sleep(Duration::from_millis(21));
        }
    })
    .unwrap();
    wait_for(&handle, 20);
    let statistics = handle.statistics();
    assert!(statistics.skipped() >= 10, "21 ms in a period of 2 ms skip at least ten: {}", statistics.skipped());
    assert!(statistics.execution.max() >= 21_000_000);
    handle.join().unwrap();
}

#[test]
fn a_panic_ends_the_thread_and_its_message_reaches_whoever_joins_it() {
    let handle = spawn(ORDINARY, |timing| assert!(timing.tick < 3, "tick {} is one too many", timing.tick)).unwrap();
    wait_for(&handle, u64::MAX);
    assert!(!handle.is_running());
    assert!(handle.statistics().ticks() <= 3);
    match handle.join() {
        Err(Error::Panicked(message)) => assert!(message.contains("is one too many"), "{message}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn dropping_the_handle_stops_the_thread() {
    let count = Arc::new(AtomicU64::new(0));
    let handle = spawn(ORDINARY, {
        let count = Arc::clone(&count);
        move |_| {
            count.fetch_add(1, Ordering::Relaxed);
        }
    })
    .unwrap();
    wait_for(&handle, 3);
    drop(handle);
    assert_eq!(Arc::strong_count(&count), 1, "the closure is gone, so the thread is");
}

#[test]
fn a_refused_right_is_reported_with_its_remedy_and_the_thread_runs_all_the_same() {
    let handle = spawn(Realtime { priority: Some(100), cpu: Some(1 << 20), ..ORDINARY }, |_| ()).unwrap();
    let rights = handle.rights().clone();
    assert!(!rights.realtime());
    assert_eq!(rights.refusals().count(), 3);
    for refusal in rights.refusals() {
        let text = refusal.to_string();
        assert!(text.starts_with("no ") && text.contains("; "), "{text}");
    }
    wait_for(&handle, 3);
    handle.join().unwrap();
}

#[test]
fn a_period_that_makes_no_sense_is_refused() {
    for period in [Duration::ZERO, Duration::from_nanos(9_999), Duration::from_secs(11)] {
        let error = spawn(Realtime { period, ..ORDINARY }, |_| ()).unwrap_err();
        assert!(matches!(error, Error::Period(p) if p == period), "{error}");
    }
}

#[test]
fn neither_the_loop_nor_its_books_allocate() {
    let (statistics, stop) = (Statistics::default(), AtomicBool::new(false));
    // Any allocation in here aborts the process.
    assert_no_alloc(|| {
        run(Duration::from_millis(1), &stop, &statistics, |timing| stop.store(timing.tick >= 50, Ordering::Relaxed));
    });
    assert!(statistics.ticks() > 0 && statistics.ticks() + statistics.skipped() >= 50);
}

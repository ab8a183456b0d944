//! The loop's pace: tracking error over the tick and over processor time, single ticks, and wake-ups beside cyclictest.
//!
//! Every tick length gets gains of its own, tuned to one target, and the same calibrated FREEs with the same devices:
//! what is left of the error is the tick's. The controller's processor time is that of the recorded ticks replayed,
//! without the plant.

use std::time::{Duration, Instant};

use anyhow::anyhow;

use super::{Size, in_parallel, quantile, row, stopwatch};
use crate::cli::{Failure, Progress};
use crate::control::replay::{Carried, Replay};
use crate::control::tune::{Target, tune};
use crate::model::Free;
use crate::record::{BenchRow, BenchSuite, Timed};
use crate::rt::{self, Histogram, Realtime, Snapshot};
use crate::sim::controlled::{Controlled, calibrated, led_by_model, pid, plant};
use crate::trajectory::paper_trajectory;

const SUITE: &str = "pace";
/// Lengths of a tick, ms.
const TICKS: [u64; 5] = [1, 2, 4, 8, 16];
/// The one whose single ticks are timed, and the limit of their p99, s.
const USUAL: u64 = 2;
const LIMIT: f64 = 10e-6;
/// Range of the paper's trajectory, rad: what an error is related to.
const RANGE: f64 = 70.0 * std::f64::consts::PI / 180.0;
/// Scatter of the FREEs about the nominal one.
const SCATTER: f64 = 0.03;
/// Of so many plants of the controllers' study this takes one.
const SHARE: u64 = 20;
/// Turns of the wake-ups, and how long each is.
const PAIRS: u32 = 5;
const TURN: Duration = Duration::from_secs(1);

/// Every tick, then wake-ups.
pub(super) fn run(size: &Size<'_>) -> Result<BenchSuite, Failure> {
    let (mut rows, mut curves, mut facts) = (Vec::new(), Vec::new(), Vec::new());
    let count = (size.count / SHARE).max(1);
    let single = Histogram::new();
    for method in ["model", "tuned PID"] {
        let mut found = Vec::new();
        for ms in TICKS {
            let label = format!("{method}, tick of {ms} ms");
            let one = |seed| followed(method == "model", Duration::from_millis(ms), seed, &single);
            let all = in_parallel(&label, "plants", count, one).into_iter().collect::<Result<Vec<_>, Failure>>()?;
            let errors: Vec<f64> = all.iter().map(|f| f.0).collect();
            let time_s = all.iter().map(|f| f.1).sum::<f64>() / all.len() as f64;
            let error = quantile(&errors, 0.5).map(|rms| rms / RANGE);
            let case = format!("{count} calibrated FREEs, tick of {ms} ms, median RMS; processor time a second");
            rows.push(row(SUITE, method, case, error, Some(time_s)));
            found.extend(error.map(|error| Timed { who: label, error, time_s }));
        }
        curves.push(Timed::curve(method.into(), &found));
    }
    let ticks = single.snapshot();
    for percent in [50.0, 99.0] {
        let time = seconds(&ticks, percent);
        let case = format!("p{percent} of {} ticks, one FREE, {USUAL} ms", ticks.count());
        rows.push(BenchRow { failed: false, ..row(SUITE, "a tick", case, None, time) });
    }
    let told = seconds(&ticks, 99.0).map_or("-".into(), |p99| {
        let within = if p99 <= LIMIT { "within" } else { "NOT within" };
        format!("p99 {:.2} us, {within} {:.0} us", 1e6 * p99, 1e6 * LIMIT)
    });
    facts.push(("a tick".into(), told));
    let of_rig = &size.rig.realtime;
    let (period, priority, cpu) = (of_rig.period, Some(of_rig.priority), of_rig.cpu);
    wakeups(Realtime { period, priority, cpu, lock_memory: true }, &mut rows, &mut facts)?;
    Ok(BenchSuite {
        name: SUITE,
        title: "The loop: rate, processor time and wake-ups",
        facts,
        rows,
        caption: "RMS error of the paper's trajectory against the controller's processor time a second, over the tick",
        x_label: "log10 of ms a second",
        y_label: "log10 of the RMS error over the range",
        curves,
        ..BenchSuite::default()
    })
}

/// RMS error (rad) of one calibrated FREE, and the controller's processor time a second. Single ticks of the usual
/// length go into `single`.
fn followed(model: bool, period: Duration, seed: u64, single: &Histogram) -> Result<(f64, f64), Failure> {
    let bench = plant(Free::paper(), SCATTER, seed + 1);
    let (free, hysteresis) = calibrated(&bench, seed + 1)?;
    let (mut control, target) = match model {
        true => (led_by_model(free, hysteresis)?, Target::MODEL),
        false => (pid(free, Default::default()), Target::PID),
    };
    control.period = period;
    let one = &mut control.frees[0];
    let imu = one.imu.as_ref().ok_or_else(|| anyhow!("the bench's FREE has an IMU"))?;
    one.gains = tune(&free, &one.regulator, imu, period, &target)?.gains;
    let mut controlled = Controlled::new(&control, &bench)?;
    controlled.arm()?;
    let rest = controlled.tick(None);
    let sequence = paper_trajectory()?;
    let course = controlled.run(&sequence)?;
    let carried = Carried { program: Controlled::program(&sequence)?, ..Carried::default() };
    let replay =
        Replay::new(&control, &rest, carried)?.ok_or_else(|| anyhow!("a controller that holds can be resumed"))?;
    let (mut whole, mut ticks) = (replay.clone(), replay);
    let begun = stopwatch::thread_time();
    for record in &course.records {
        std::hint::black_box(whole.tick(record));
    }
    let time = (stopwatch::thread_time() - begun) / sequence.duration();
    if model && period == Duration::from_millis(USUAL) {
        for record in &course.records {
            let begun = Instant::now();
            std::hint::black_box(ticks.tick(record));
            single.record(begun.elapsed().as_nanos() as u64);
        }
    }
    Ok((course.errors().0.to_radians(), time))
}

/// Wake-up latency of the rig's loop, and cyclictest's in turn where it is installed.
fn wakeups(config: Realtime, rows: &mut Vec<BenchRow>, facts: &mut Vec<(String, String)>) -> Result<(), Failure> {
    let mut progress = Progress::new("wake-ups", f64::from(2 * PAIRS), "turns");
    let (mut turns, mut last) = (0.0, Duration::ZERO);
    let found = rt::compare(config, PAIRS, TURN, &mut |who, passed| {
        if passed < last {
            turns += 1.0;
        }
        last = passed;
        progress.set(turns, who);
    })?;
    let hertz = 1.0 / config.period.as_secs_f64();
    let mut tell = |method: &str, latency: &Snapshot| {
        for percent in [50.0, 99.0] {
            let case = format!("p{percent} of {} wake-ups at {hertz:.0} Hz", latency.count());
            rows.push(BenchRow { failed: false, ..row(SUITE, method, case, None, seconds(latency, percent)) });
        }
    };
    tell("wake-up of the loop", &found.own.latency);
    let rights = if found.own.rights.realtime() { "real-time rights" } else { "NO real-time rights" };
    let us = |percent| seconds(&found.own.latency, percent).map_or("-".into(), |s| format!("{:.0}", 1e6 * s));
    let mut told = format!("p50 {} us, p99 {} us, {rights}", us(50.0), us(99.0));
    match found.pairs {
        Err(error) => {
            let case = format!("not run: {error}");
            rows.push(BenchRow { failed: false, ..row(SUITE, "cyclictest", case, None, None) });
        }
        Ok(pairs) => {
            tell("cyclictest", &pairs.iter().fold(Snapshot::default(), |all, pair| all.and(&pair.cyclictest)));
            let ratio = |percent| rt::median_ratio(&pairs, percent).unwrap_or(f64::NAN);
            told += &format!(
                "; ratio to cyclictest, median of {PAIRS} turns: p50 {:.2}, p99 {:.2}",
                ratio(50.0),
                ratio(99.0)
            );
        }
    }
    facts.push((format!("wake-ups at {hertz:.0} Hz"), told));
    Ok(())
}

fn seconds(latency: &Snapshot, percent: f64) -> Option<f64> {
    latency.percentile(percent).map(|ns| 1e-9 * ns as f64)
}

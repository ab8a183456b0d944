//! `freerig latency`: what waking up costs on this machine, with the loop that the daemon runs.

use std::fmt::Write as _;
use std::time::Duration;

use anyhow::anyhow;
use serde_json::{Value, json};

use super::{Context, Failure, Progress};
use crate::config::Rig;
use crate::rt::{self, Pair, Realtime, Snapshot, Wakeups};
use crate::units::{Frequency, Seconds};

/// Edges of the printed histogram within a decade.
const EDGES: [u64; 6] = [10, 15, 20, 30, 50, 70];
/// Width of the longest bar.
const BAR: usize = 40;
/// Largest ratio to cyclictest that is no sign of trouble.
const RATIO: f64 = 1.3;

const EXAMPLES: &str = "\
Examples:
  freerig latency
  freerig latency --rate 1kHz --duration 60s
  freerig latency --pairs 0 --json

Run it while the machine does what it does in an experiment: an idle machine flatters.";

/// What `freerig latency` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Rate of the loop [default: that of rig.toml, else 500 Hz]
    #[arg(long)]
    rate: Option<Frequency>,
    /// How long the loop is measured; cyclictest takes as long again
    #[arg(long, default_value = "10s")]
    duration: Seconds,
    /// SCHED_FIFO priority [default: that of rig.toml, else 80]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=98))]
    priority: Option<u8>,
    /// CPU to run on [default: that of rig.toml, else any]
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
    /// Pairs with cyclictest, in turn, where it is installed; 0 for none
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u32).range(0..=99))]
    pairs: u32,
}

/// What was measured.
struct Measured {
    config: Realtime,
    own: Wakeups,
    /// Or why there are none.
    pairs: Result<Vec<Pair>, String>,
}

/// Measures and prints.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let config = config(&args, context)?;
    let duration = Duration::try_from_secs_f64(args.duration.si())
        .ok()
        .filter(|d| (Duration::from_millis(100)..=Duration::from_secs(24 * 3600)).contains(d))
        .ok_or_else(|| Failure::usage(anyhow!("a duration of {} is outside 100 ms to 24 h", args.duration)))?;
    let measured = measure(config, duration, args.pairs, context)?;
    for refusal in measured.own.rights.refusals() {
        context.note(format!("WARNING: {refusal}"));
    }
    if context.json { context.print_json(&summary(&measured)) } else { context.print(describe(&measured)) }
}

/// The loop of rig.toml, where there is one, with what the flags say otherwise.
fn config(args: &Args, context: &Context) -> Result<Realtime, Failure> {
    let rig = if context.rig.exists() {
        Rig::load(&context.rig).map_err(|_| {
            context.note(format!(
                "{}: not clean (`freerig config check` says why); measuring with the defaults",
                context.rig.display()
            ));
        })
    } else {
        Err(())
    };
    let of_rig = rig.ok().map(|rig| rig.realtime);
    let period = match (args.rate, &of_rig) {
        (Some(rate), _) => Duration::try_from_secs_f64(1.0 / rate.si())
            .ok()
            .filter(|p| (Duration::from_micros(100)..=Duration::from_secs(1)).contains(p))
            .ok_or_else(|| Failure::usage(anyhow!("a rate of {rate} is outside 1 Hz to 10 kHz")))?,
        (None, Some(of_rig)) => of_rig.period,
        (None, None) => Duration::from_millis(2),
    };
    let priority = args.priority.or(of_rig.as_ref().map(|r| r.priority)).unwrap_or(80);
    let cpu = args.cpu.or(of_rig.and_then(|r| r.cpu));
    Ok(Realtime { period, priority: Some(priority), cpu, lock_memory: true })
}

/// The loop in as many turns as there are pairs, each with cyclictest's.
fn measure(config: Realtime, duration: Duration, pairs: u32, context: &Context) -> Result<Measured, Failure> {
    let (hertz, seconds) = (1.0 / config.period.as_secs_f64(), duration.as_secs_f64());
    if pairs == 0 {
        context.note(format!("measuring wake-ups at {hertz:.0} Hz for {seconds:.0} s"));
        let mut progress = Progress::new("latency", seconds, "s");
        let own = rt::measure(config, duration, &mut |passed| progress.set(passed.as_secs_f64(), "loop"))?;
        return Ok(Measured { config, own, pairs: Err("not asked for".into()) });
    }
    context.note(format!(
        "measuring wake-ups at {hertz:.0} Hz for {seconds:.0} s, and for as long again with cyclictest, if installed, in \
         {pairs} turns each"
    ));
    let mut progress = Progress::new("latency", 2.0 * seconds, "s");
    let (mut before, mut last) = (Duration::ZERO, Duration::ZERO);
    let comparison = rt::compare(config, pairs, duration / pairs, &mut |who, passed| {
        if passed < last {
            before += duration / pairs;
        }
        last = passed;
        progress.set((before + passed).as_secs_f64(), who);
    })?;
    Ok(Measured { config, own: comparison.own, pairs: comparison.pairs.map_err(|error| error.to_string()) })
}

fn describe(measured: &Measured) -> String {
    let Measured { config, own: Wakeups { rights, latency, skipped }, pairs } = measured;
    let has = |granted: bool, what: &str| if granted { what.to_owned() } else { format!("NO {what}") };
    let mut text = format!(
        "{:.0} Hz, {}, {}, {}\nkernel {}\n",
        1.0 / config.period.as_secs_f64(),
        has(rights.fifo.is_ok(), &format!("SCHED_FIFO {}", config.priority.unwrap_or(0))),
        has(rights.locked.is_ok(), "locked memory"),
        config.cpu.map_or("any CPU".into(), |cpu| has(rights.pinned.is_ok(), &format!("CPU {cpu}"))),
        kernel(),
    );
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "\nfrom the deadline to the wake-up, {} ticks, {skipped} periods skipped\n  least {}   p50 {}   p99 {}   p99.9 {}   most {}   jitter (most - least) {}\n",
        latency.count(),
        microseconds(latency.percentile(0.0)),
        microseconds(latency.percentile(50.0)),
        microseconds(latency.percentile(99.0)),
        microseconds(latency.percentile(99.9)),
        microseconds(Some(latency.max())),
        microseconds(jitter(latency)),
    );
    let most = rows(latency).iter().map(|row| row.2).max().unwrap_or(0).max(1);
    let _ = writeln!(text, "{:>12} {:>12} {:>9}", "from, us", "to, us", "ticks");
    for (from, to, count) in rows(latency) {
        // What happened at all shows.
        let bar = if count == 0 {
            String::new()
        } else {
            format!(" {}", "#".repeat((count as usize * BAR).div_ceil(most as usize)))
        };
        let _ = writeln!(text, "{:>12} {:>12} {count:>9}{bar}", from as f64 / 1e3, to as f64 / 1e3);
    }
    match pairs {
        Err(reason) => {
            let _ = write!(text, "\nno comparison with cyclictest: {reason}");
        }
        Ok(pairs) => {
            let _ =
                writeln!(text, "\n{:>6} {:>12} {:>12} {:>16} {:>16}", "pair", "p50", "p99", "cyclictest p50", "p99");
            for (number, pair) in (1..).zip(pairs) {
                let us = |snapshot: &Snapshot, percent| microseconds(snapshot.percentile(percent));
                let _ = writeln!(
                    text,
                    "{number:>6} {:>12} {:>12} {:>16} {:>16}",
                    us(&pair.own, 50.0),
                    us(&pair.own, 99.0),
                    us(&pair.cyclictest, 50.0),
                    us(&pair.cyclictest, 99.0)
                );
            }
            let ratio = |percent| rt::median_ratio(pairs, percent);
            let (p50, p99) = (ratio(50.0).unwrap_or(f64::NAN), ratio(99.0).unwrap_or(f64::NAN));
            let _ = write!(
                text,
                "ratio to cyclictest{}, median of {}: p50 {p50:.2}, p99 {p99:.2} ({} {RATIO})",
                if config.cpu.is_none() { " (which binds itself to a CPU)" } else { "" },
                pairs.len(),
                if p50 <= RATIO && p99 <= RATIO { "within" } else { "NOT within" },
            );
        }
    }
    text
}

fn summary(measured: &Measured) -> Value {
    let Measured { config, own: Wakeups { rights, latency, skipped }, pairs } = measured;
    let seconds = |ns: Option<u64>| ns.map(|ns| ns as f64 * 1e-9);
    let percentiles = |snapshot: &Snapshot| json!({ "p50_s": seconds(snapshot.percentile(50.0)), "p99_s": seconds(snapshot.percentile(99.0)) });
    let histogram: Vec<_> = rows(latency)
        .iter()
        .map(|&(from, to, count)| json!({ "from_s": from as f64 * 1e-9, "to_s": to as f64 * 1e-9, "ticks": count }))
        .collect();
    let compared = pairs.as_ref().ok().map(|pairs| {
        let rows: Vec<_> = pairs
            .iter()
            .map(|pair| json!({ "loop": percentiles(&pair.own), "cyclictest": percentiles(&pair.cyclictest) }))
            .collect();
        json!({
            "pairs": rows,
            "median_ratio_p50": rt::median_ratio(pairs, 50.0),
            "median_ratio_p99": rt::median_ratio(pairs, 99.0),
        })
    });
    json!({
        "period_s": config.period.as_secs_f64(),
        "priority": rights.fifo.as_ref().ok(),
        "memory_locked": rights.locked.is_ok(),
        "cpu": rights.pinned.as_ref().ok().copied().flatten(),
        "realtime": rights.realtime(),
        "refused": rights.refusals().map(ToString::to_string).collect::<Vec<_>>(),
        "kernel": kernel(),
        "ticks": latency.count(),
        "skipped": skipped,
        "latency_min_s": seconds(latency.percentile(0.0)),
        "latency_mean_s": latency.mean().map(|ns| ns * 1e-9),
        "latency_p50_s": seconds(latency.percentile(50.0)),
        "latency_p99_s": seconds(latency.percentile(99.0)),
        "latency_p999_s": seconds(latency.percentile(99.9)),
        "latency_max_s": seconds(jitter(latency).map(|_| latency.max())),
        "jitter_s": seconds(jitter(latency)),
        "histogram": histogram,
        "cyclictest": compared,
        "cyclictest_missing": pairs.as_ref().err(),
    })
}

/// From the smallest latency to the largest, ns; the smallest to the width of its bucket.
fn jitter(latency: &Snapshot) -> Option<u64> {
    latency.percentile(0.0).map(|least| latency.max() - least)
}

/// `(from, to, count)`, ns: the histogram from the first row that counted to the last. The last edge, 70 s, lies
/// beyond what a [`Snapshot`] tells apart.
fn rows(latency: &Snapshot) -> Vec<(u64, u64, u64)> {
    let edges: Vec<u64> =
        std::iter::once(0).chain((2..10).flat_map(|power| EDGES.map(|edge| edge * 10_u64.pow(power)))).collect();
    let mut rows: Vec<_> =
        edges.windows(2).map(|edge| (edge[0], edge[1], latency.count_between(edge[0], edge[1]))).collect();
    let last = rows.iter().rposition(|row| row.2 > 0).map_or(0, |last| last + 1);
    rows.truncate(last);
    let first = rows.iter().position(|row| row.2 > 0).unwrap_or(0);
    rows.split_off(first)
}

fn microseconds(nanoseconds: Option<u64>) -> String {
    nanoseconds.map_or_else(|| "-".into(), |ns| format!("{:.1} us", ns as f64 / 1e3))
}

/// Release, and whether it is a real-time kernel.
pub(super) fn kernel() -> String {
    let uname = rustix::system::uname();
    let realtime = std::fs::read_to_string("/sys/kernel/realtime").is_ok_and(|text| text.trim() == "1");
    format!("{}, {}", uname.release().to_string_lossy(), if realtime { "PREEMPT_RT" } else { "not PREEMPT_RT" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rt::{Histogram, Rights};

    fn measured(values: &[u64], pairs: Result<Vec<Pair>, String>) -> Measured {
        let histogram = Histogram::new();
        values.iter().for_each(|&ns| histogram.record(ns));
        let config = Realtime { period: Duration::from_millis(2), priority: Some(80), cpu: None, lock_memory: true };
        let rights = Rights { fifo: Ok(80), locked: Ok(()), pinned: Ok(None), awake: Ok(()) };
        Measured { config, own: Wakeups { rights, latency: histogram.snapshot(), skipped: 3 }, pairs }
    }

    #[test]
    fn the_rows_hold_every_tick_once_and_leave_nothing_out_between() {
        let measured = measured(&[500, 17_000, 18_000, 65_000_000, 60_000_000_000], Err("x".into()));
        let rows = rows(&measured.own.latency);
        assert_eq!(rows.iter().map(|row| row.2).sum::<u64>(), 5);
        assert_eq!((rows[0].0, rows[0].2), (0, 1));
        assert!(rows.windows(2).all(|pair| pair[0].1 == pair[1].0));
        assert_eq!(rows.last().map(|row| row.1 >= 60_000_000_000), Some(true));
    }

    #[test]
    fn the_answer_says_what_was_not_measured_and_why() {
        let text = describe(&measured(&[17_000, 18_000], Err("not asked for".into())));
        assert!(text.contains("2 ticks, 3 periods skipped") && text.contains("cyclictest: not asked for"), "{text}");
        let value = summary(&measured(&[], Err("not asked for".into())));
        assert!(value["latency_p50_s"].is_null() && value["latency_max_s"].is_null() && value["cyclictest"].is_null());
        assert_eq!(value["histogram"], json!([]));
    }

    #[test]
    fn a_ratio_beyond_the_limit_is_said() {
        let pair = |own: u64| {
            let counted = |ns: u64| measured(&[ns], Ok(vec![])).own.latency;
            Pair { own: counted(own), cyclictest: counted(20_000) }
        };
        assert!(describe(&measured(&[20_000], Ok(vec![pair(20_000)]))).contains("(within 1.3)"));
        assert!(describe(&measured(&[20_000], Ok(vec![pair(40_000)]))).contains("p50 2.00, p99 2.00 (NOT within 1.3)"));
    }
}

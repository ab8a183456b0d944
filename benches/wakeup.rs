//! Wake-up latency of the loop beside cyclictest's, in seven alternated pairs at 1 kHz and priority 80: the median
//! ratios of p50 and p99 should stay within 1.3.
//!
//! criterion would time an iteration; what counts here is a distribution and its yardstick, so this prints both itself.
//! `freerig latency` measures the same at the rig's own rate, with a histogram.

use std::time::Duration;

use freerig::rt::{Realtime, Snapshot, compare, median_ratio};

const PAIRS: u32 = 7;
const TURN: Duration = Duration::from_secs(2);
const CONFIG: Realtime =
    Realtime { period: Duration::from_millis(1), priority: Some(80), cpu: None, lock_memory: true };

fn show(name: &str, latency: &Snapshot) {
    let us = |percent| latency.percentile(percent).unwrap_or(0) as f64 / 1e3;
    let (p50, p99, largest, count) = (us(50.0), us(99.0), us(100.0), latency.count());
    println!("wakeup/{name}: p50 {p50:.1} us, p99 {p99:.1} us, largest {largest:.1} us of {count}");
}

fn main() -> Result<(), freerig::rt::Error> {
    let comparison = compare(CONFIG, PAIRS, TURN, &mut |_, _| {})?;
    for refusal in comparison.own.rights.refusals() {
        println!("wakeup: {refusal}");
    }
    show("loop", &comparison.own.latency);
    match comparison.pairs {
        Err(error) => println!("wakeup: no comparison: {error}"),
        Ok(pairs) => {
            let theirs = pairs.iter().fold(Snapshot::default(), |all, pair| all.and(&pair.cyclictest));
            show("cyclictest", &theirs);
            for percent in [50.0, 99.0] {
                let ratio = median_ratio(&pairs, percent).unwrap_or(f64::NAN);
                println!("wakeup/ratio to cyclictest: p{percent} {ratio:.2}, median of {}", pairs.len());
            }
        }
    }
    Ok(())
}

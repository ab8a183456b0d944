//! The identification study of 200 FREEs, and the fit against the plain methods.

use std::time::{Duration, Instant};

use freerig::sim::identification::{CYCLES, Errors, Study, plain, trial};
use freerig::sim::ringdown::Sensing;

const FREES: u64 = 200;

#[test]
fn two_hundred_frees_within_the_limits() {
    let trials: Vec<_> = (0..FREES).map(|seed| trial(seed, &Sensing::imu(1000 + seed), CYCLES)).collect();
    let refused: Vec<_> = trials.iter().filter_map(|t| t.as_ref().err()).collect();
    let trials: Vec<_> = trials.iter().filter_map(|t| t.clone().ok()).collect();
    let study = Study::of(&trials);
    let odd = trials.iter().filter(|t| t.modes != 1 || t.more).count();
    println!("{study:#?}\nrefused {refused:?}, odd {odd}");
    assert!(refused.is_empty(), "{refused:?}");
    // The acceptance limits.
    assert!(study.median.stiffness < 3e-3 && study.median.damping < 2e-2 && study.median.frequency < 1e-3, "{study:?}");
    for coverage in [study.coverage.stiffness, study.coverage.damping, study.coverage.frequency] {
        assert!((0.90..=0.99).contains(&coverage), "{study:?}");
    }
    // One mode is the truth. A second one or a drift by chance: the evidence asked for makes it rarer than one in 20.
    assert!(odd <= 10, "{odd}");
}

/// One line of the table: median errors of the FREEs that a method could fit, how many it could not, and its time.
fn line(method: &str, cycles: f64, noise: f64, results: Vec<Option<Errors>>, time: Duration) -> Errors {
    let good: Vec<_> = results.iter().flatten().copied().collect();
    let (median, worst) = (Errors::median(&good), Errors::worst(&good));
    println!(
        "{cycles:6.0} | {noise:5.2} | {method:13} | {:9.4} | {:8.3} | {:8.4} | {:9.2} | {:7} | {:8.2}",
        100.0 * median.stiffness,
        100.0 * median.damping,
        100.0 * median.frequency,
        100.0 * worst.damping,
        results.len() - good.len(),
        1e3 * time.as_secs_f64() / results.len() as f64
    );
    median
}

#[test]
fn better_than_the_plain_methods() {
    println!("cycles | noise | method        | kt %      | ct %     | f %      | ct max %  | refused | ms/FREE");
    for (cycles, noise) in [(2.0, 0.05), (5.0, 0.05), (30.0, 0.01), (30.0, 0.05), (30.0, 0.2)] {
        let sensing = |seed| Sensing { noise: f64::to_radians(noise), ..Sensing::imu(5000 + seed) };
        let run = |method: &dyn Fn(u64) -> Option<Errors>| {
            let start = Instant::now();
            let results: Vec<_> = (0..60).map(method).collect();
            (results, start.elapsed())
        };
        let (ours, time) = run(&|seed| trial(seed, &sensing(seed), cycles).ok().map(|t| t.errors()));
        let fit = line("this fit", cycles, noise, ours, time);
        let (theirs, time) = run(&|seed| plain(seed, &sensing(seed), cycles)[0].ok());
        let decrement = line("log decrement", cycles, noise, theirs, time);
        let (theirs, time) = run(&|seed| plain(seed, &sensing(seed), cycles)[1].ok());
        let curve = line("curve fit", cycles, noise, theirs, time);
        // Against a log decrement the gain is large; a curve fit of clean data with a right model is as good as any,
        // so ours may be off by the chance of 60 FREEs.
        assert!(fit.damping < 0.5 * decrement.damping, "{cycles} {noise}");
        assert!(fit.damping < 1.15 * curve.damping && fit.stiffness < 1.15 * curve.stiffness, "{cycles} {noise}");
    }
}

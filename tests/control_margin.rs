//! The stability margin says what the loop really does.

use std::time::Duration;

use freerig::control::margin::{GAIN_MARGIN_MIN, Loop, PHASE_MARGIN_MIN_DEG};
use freerig::control::{Gains, ImuChannel, RegulatorChannel, default_gains};
use freerig::model::Free;

fn free(length: f64, torsional_stiffness: f64, torsional_damping: f64) -> Free {
    Free {
        gamma: (-40f64).to_radians(),
        length,
        radius: 0.007,
        mass: 0.028,
        inertia: 0.028 * 0.007 * 0.007,
        axial_stiffness: 10110.0,
        torsional_stiffness,
        axial_damping: 5.0,
        torsional_damping,
    }
}

fn paper() -> Free {
    free(0.11, 0.086, 0.005)
}

fn published_code() -> Free {
    free(0.12, 0.0862, 3.97e-5)
}

const PUBLISHED_TRAJECTORY: Gains =
    Gains { proportional: 17236.9, integral: 603291.5, derivative: 0.0, derivative_filter: 0.0 };

fn regulator(period: Duration, lag_ms: u64, dead: Duration) -> RegulatorChannel {
    RegulatorChannel {
        period,
        lag: Duration::from_millis(lag_ms),
        dead_time: dead,
        fastest_fill: 30.0 * 6894.757,
        full_scale: 15.0 * 6894.757,
        measures: true,
    }
}

fn imu(period: Duration, delay_ms: u64) -> ImuChannel {
    ImuChannel { axis: [0.0, 0.0, 1.0], period, delay: Duration::from_millis(delay_ms) }
}

/// No lag, no delay, every device as fast as the tick.
fn ideal(tick: Duration, dead: Duration) -> Loop {
    Loop::new(&published_code(), &PUBLISHED_TRAJECTORY, &regulator(tick, 0, dead), &imu(tick, 0), tick)
}

fn bench(free: &Free, gains: &Gains) -> Loop {
    let (regulator, imu) =
        (regulator(Duration::from_millis(16), 60, Duration::from_millis(15)), imu(Duration::from_millis(10), 15));
    Loop::new(free, gains, &regulator, &imu, Duration::from_millis(2))
}

#[test]
fn published_trajectory_is_stable_at_2_khz_without_delay_and_unstable_with_a_tick_of_it_or_at_500_hz() {
    let tick = Duration::from_micros(500);
    let margin = ideal(tick, Duration::ZERO).margin();
    assert!(margin.stable && margin.spectral_radius < 1.0 && margin.gain_margin > 1.0, "{margin:?}");
    assert!(margin.delay_margin_s < 5e-4, "{margin:?}");
    for unstable in [ideal(tick, tick), ideal(Duration::from_millis(2), Duration::ZERO)] {
        let margin = unstable.margin();
        assert!(!margin.stable && margin.spectral_radius > 1.0 && !margin.sufficient(), "{margin:?}");
        assert!(margin.problem().is_some_and(|p| p.contains("unstable") && p.contains("--accept-margin")));
    }
}

#[test]
fn the_delay_margin_is_the_delay_at_which_the_eigenvalues_leave_the_circle() {
    let tick = Duration::from_micros(500);
    let delay = ideal(tick, Duration::ZERO).margin().delay_margin_s;
    let at = |factor: f64| ideal(tick, Duration::from_secs_f64(factor * delay)).spectral_radius();
    // The frequency response leaves images out: a few per cent at a twentieth of the tick rate.
    assert!(at(0.95) < 1.0 && at(1.05) > 1.0, "{delay}: {} {}", at(0.95), at(1.05));
}

#[test]
fn eigenvalues_agree_with_the_closed_form_of_a_sampled_first_order_loop() {
    // Overdamped far beyond the tick: phi' = -phi/tau + p/tau; P control: z = e^{-T/tau} - Kp (1 - e^{-T/tau}).
    let mut slow = paper();
    slow.inertia = 1e-12;
    let tick = Duration::from_millis(2);
    let per_rad = 2.0 * std::f64::consts::PI * slow.radius.powi(3) / slow.gamma.tan().abs() / slow.torsional_stiffness;
    for kp in [0.5, 5.0, 40.0, 70.0] {
        let gains = Gains { proportional: kp / per_rad, ..Gains::default() };
        let radius =
            Loop::new(&slow, &gains, &regulator(tick, 0, Duration::ZERO), &imu(tick, 0), tick).spectral_radius();
        let decay = (-0.002f64 * 0.086 / 0.005).exp();
        let expected = (decay - kp * (1.0 - decay)).abs();
        assert!((radius - expected).abs() < 1e-5, "{kp}: {radius} {expected}");
    }
}

#[test]
fn gain_margins_by_eigenvalues_and_by_frequency_response_agree_on_the_bench() {
    let gains = default_gains(
        &paper(),
        &regulator(Duration::from_millis(16), 60, Duration::from_millis(15)),
        &imu(Duration::from_millis(10), 15),
        Duration::from_millis(2),
    );
    let this = bench(&paper(), &gains);
    let (exact, averaged) = (this.margin().gain_margin, this.frequency_margins().gain);
    println!("{gains:?} {:?} {averaged}", this.margin());
    assert!((exact / averaged - 1.0).abs() < 0.15, "{exact} {averaged}");
}

#[test]
fn freerigs_own_gains_have_their_margins_for_both_reference_frees() {
    for free in [paper(), published_code()] {
        let (regulator, imu) =
            (regulator(Duration::from_millis(16), 60, Duration::from_millis(15)), imu(Duration::from_millis(10), 15));
        let gains = default_gains(&free, &regulator, &imu, Duration::from_millis(2));
        let margin = bench(&free, &gains).margin();
        println!("{gains:?} {margin:?}");
        assert!(margin.sufficient(), "{margin:?}");
        assert!(margin.gain_margin > 1.2 * GAIN_MARGIN_MIN && margin.phase_margin_deg > 1.8 * PHASE_MARGIN_MIN_DEG);
        let crossover = (1..5000).map(|k| f64::from(k) * 0.01).find(|&w| bench(&free, &gains).response(w).norm() < 1.0);
        println!("crossover {crossover:?} rad/s");
        assert!(crossover.is_some_and(|w| w > 1.0), "{crossover:?}");
    }
}

#[test]
fn no_gain_no_crossing_no_limit() {
    let margin = bench(&paper(), &Gains { proportional: 1.0, ..Gains::default() }).margin();
    assert!(margin.stable && margin.gain_margin.is_infinite() && margin.phase_margin_deg.is_infinite(), "{margin:?}");
    assert!(margin.sufficient() && margin.problem().is_none());
}

#[test]
fn the_presets_on_the_bench() {
    // What the literature's gains, meant for an ideal plant, are worth behind a regulator's lag of 60 ms.
    let of = |proportional, integral, derivative| {
        bench(&paper(), &Gains { proportional, integral, derivative, derivative_filter: 0.0 }).margin()
    };
    let published_step = of(10_342.0, 94_803.0, 0.0);
    let published_trajectory = of(17_236.9, 603_291.5, 0.0);
    let paper_pi = of(32_000.0, 1.2e6, 0.0);
    let printed = of(32_000.0, 0.0, 1.2e6);
    let hand = of(11_600.0, 2.0e5, 0.0);
    for margin in [published_step, published_trajectory, paper_pi, printed, hand] {
        println!("{margin:?}");
    }
    assert!(published_step.sufficient());
    assert!(!paper_pi.sufficient() && !printed.stable && !published_trajectory.sufficient());
}

#[test]
fn arming_refuses_the_published_gains_where_they_diverge() {
    use freerig::config::Rig;
    use freerig::daemon::{Bench, DaemonError, Stepped, procedure};
    use freerig::signal::State;

    let folder = tempfile::tempdir().unwrap();
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml");
    let tick = Duration::from_micros(500);
    for (period, dead) in [(tick, tick), (Duration::from_millis(2), Duration::ZERO)] {
        let mut rig = Rig::load(std::path::Path::new(example)).unwrap();
        rig.record.directory = folder.path().to_owned();
        rig.control.period = period;
        let free = &mut rig.control.frees[0];
        (free.free, free.gains) = (published_code(), PUBLISHED_TRAJECTORY);
        (free.regulator, free.imu) = (regulator(period, 0, dead), Some(imu(period, 0)));
        let mut bench = Stepped::new(&rig).unwrap();
        let error = procedure::arm(&mut bench, &rig, false).unwrap_err();
        assert!(matches!(&error, DaemonError::Margin(what) if what.contains("unstable")), "{error}");
        assert_ne!(bench.latest().state, State::Hold);
    }
}

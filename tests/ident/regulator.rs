//! Identification of a regulator: the truth is integrated in small steps as the simulated valve does it, never by the
//! function that is fitted.

use freerig::ident::Measured;
use freerig::ident::regulator::*;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

const PSI: f64 = 6894.757293168;

/// A regulator and its sensor.
#[derive(Clone, Copy)]
struct Truth {
    dead_time: f64,
    lag: f64,
    rise: f64,
    fall: f64,
    noise: f64,
    quantum: f64,
    /// Time constant of a leak, s.
    leak: f64,
}

impl Truth {
    /// The acceptance rig: lag 60 ms, dead time 15 ms, slew 30 psi/s.
    const RIG: Self = Self {
        dead_time: 0.015,
        lag: 0.060,
        rise: 30.0 * PSI,
        fall: 30.0 * PSI,
        noise: 0.01 * PSI,
        quantum: 0.001 * PSI,
        leak: f64::INFINITY,
    };

    /// The pressures at `times`: forward in substeps of `dt`, with the simulated valve's formula.
    fn pressures(&self, commands: &[Command], times: &[f64], dt: f64) -> Vec<f64> {
        let share = 1.0 - (-dt / self.lag).exp();
        let (mut p, mut before, mut k, mut next) = (0.0, 0.0, 0u64, 0);
        let mut out = Vec::new();
        for &t in times {
            while (k as f64) * dt < t {
                let now = k as f64 * dt;
                while next < commands.len() && commands[next].time + self.dead_time <= now + 1e-12 {
                    next += 1;
                }
                let target = commands[next.max(1) - 1].pressure;
                before = p;
                p += ((target - p) * share).clamp(-self.fall * dt, self.rise * dt);
                p *= (-dt / self.leak).exp();
                k += 1;
            }
            let x = (t - (k as f64 - 1.0) * dt) / dt;
            out.push(before + (p - before) * x);
        }
        out
    }

    fn record(&self, commands: &[Command], period: f64, rng: &mut Pcg64Mcg) -> Vec<Reading> {
        let end = commands.last().unwrap().time + 1.0;
        let first = rng.random_range(0.0..period);
        let count = ((end - first) / period) as usize;
        // The device's period jitters by 2 % of itself.
        let times: Vec<f64> = (0..count)
            .map(|i| first + period * (i as f64 + rng.random_range(-0.02..0.02)))
            .filter(|t| *t > 0.0)
            .collect();
        let noise = Normal::new(0.0, self.noise).unwrap();
        let exact = self.pressures(commands, &times, 1e-5);
        let read = |(&time, p): (&f64, f64)| {
            let p = p + noise.sample(rng);
            Reading { time, pressure: if self.quantum > 0.0 { (p / self.quantum).round() * self.quantum } else { p } }
        };
        times.iter().zip(exact).map(read).collect()
    }
}

/// Steps of different sizes, up and down, in psi, one each 1.1 s.
fn steps(levels: &[f64]) -> Vec<Command> {
    let command = |(i, &psi): (usize, &f64)| Command {
        time: if i == 0 { 0.0 } else { 1.1 * i as f64 - 0.4 },
        pressure: psi * PSI,
    };
    levels.iter().enumerate().map(command).collect()
}

const LARGE: [f64; 9] = [0.0, 7.0, 1.0, 6.0, 0.5, 8.0, 4.0, 5.0, 0.0];
const SMALL: [f64; 9] = [0.0, 1.0, 0.2, 1.2, 0.4, 1.4, 0.3, 1.1, 0.1];

fn inside(m: &Measured, truth: f64) -> bool {
    let (low, high) = m.interval();
    low <= truth && truth <= high
}

#[test]
fn the_rigs_regulator_comes_back_from_readings_at_16_to_64_ms() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for period in [0.016, 0.032, 0.064] {
        let commands = steps(&LARGE);
        let fit = fit_steps(&commands, &Truth::RIG.record(&commands, period, &mut rng)).unwrap();
        // Bounds: a few standard uncertainties at a noise of 0.01 psi; the test of the coverage is below.
        assert!((fit.lag.value / 0.060 - 1.0).abs() < 0.02, "{period}: {fit:?}");
        assert!((fit.dead_time.value - 0.015).abs() < 1e-3, "{period}: {fit:?}");
        for slew in [fit.rise.unwrap(), fit.fall.unwrap()] {
            assert!((slew.value / (30.0 * PSI) - 1.0).abs() < 0.01, "{period}: {fit:?}");
        }
        assert!((fit.span.value - 1.0).abs() < 2e-3 && fit.zero.value.abs() < 0.01 * PSI, "{fit:?}");
        assert!((fit.residual / (0.01 * PSI) - 1.0).abs() < 0.15, "{fit:?}");
    }
}

#[test]
fn without_noise_the_exact_solution_is_the_integrated_one() {
    let truth = Truth { noise: 0.0, quantum: 0.0, rise: 20.0 * PSI, fall: 45.0 * PSI, ..Truth::RIG };
    let commands = steps(&LARGE);
    let fit = fit_steps(&commands, &truth.record(&commands, 0.025, &mut Pcg64Mcg::seed_from_u64(2))).unwrap();
    // The reference integrates in steps of 10 us: its time is 5 us uncertain, its slew's end 1e-4.
    assert!((fit.dead_time.value - 0.015).abs() < 2e-5, "{fit:?}");
    assert!((fit.lag.value / 0.060 - 1.0).abs() < 3e-4, "{fit:?}");
    assert!((fit.rise.unwrap().value / (20.0 * PSI) - 1.0).abs() < 3e-4, "{fit:?}");
    assert!((fit.fall.unwrap().value / (45.0 * PSI) - 1.0).abs() < 3e-4, "{fit:?}");
    assert!(fit.residual < 1e-3 * PSI, "{fit:?}");
}

#[test]
fn the_substep_of_the_simulated_plant_is_not_seen() {
    // The plant's own 250 us: half of it is dead time, since a command takes effect at the next grid point.
    let truth = Truth { noise: 0.0, quantum: 0.0, ..Truth::RIG };
    let commands = steps(&LARGE);
    let times: Vec<f64> = (1..500).map(|i| 0.0201 * f64::from(i)).collect();
    let pressures = truth.pressures(&commands, &times, 250e-6);
    let readings: Vec<_> = times.iter().zip(pressures).map(|(&time, pressure)| Reading { time, pressure }).collect();
    let fit = fit_steps(&commands, &readings).unwrap();
    assert!((fit.dead_time.value - 0.015).abs() < 3e-4, "{fit:?}");
    assert!((fit.lag.value / 0.060 - 1.0).abs() < 5e-3, "{fit:?}");
}

#[test]
fn small_steps_do_not_see_the_slew_limit() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let commands = steps(&SMALL);
    let fit = fit_steps(&commands, &Truth::RIG.record(&commands, 0.016, &mut rng)).unwrap();
    assert_eq!((fit.rise, fit.fall), (None, None));
    assert!((fit.lag.value / 0.060 - 1.0).abs() < 0.05, "{fit:?}");
    // Only the way up is limited here: 5 psi/s against 40.
    let slow = Truth { rise: 5.0 * PSI, fall: 40.0 * PSI, ..Truth::RIG };
    let fit = fit_steps(&commands, &slow.record(&commands, 0.016, &mut rng)).unwrap();
    assert!((fit.rise.unwrap().value / (5.0 * PSI) - 1.0).abs() < 0.02, "{fit:?}");
    assert_eq!(fit.fall, None);
}

#[test]
fn the_intervals_cover_the_truth_as_often_as_they_say() {
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    let mut covered = [0; 4];
    let mut seen = 0;
    const RUNS: usize = 200;
    for _ in 0..RUNS {
        let truth = Truth {
            dead_time: rng.random_range(0.005..0.04),
            lag: rng.random_range(0.03..0.15),
            rise: rng.random_range(12.0..25.0) * PSI,
            fall: rng.random_range(12.0..25.0) * PSI,
            noise: rng.random_range(0.01..0.05) * PSI,
            quantum: 0.01 * PSI,
            leak: f64::INFINITY,
        };
        let commands = steps(&LARGE);
        let period = rng.random_range(0.016..0.064);
        let fit = fit_steps(&commands, &truth.record(&commands, period, &mut rng)).unwrap();
        covered[0] += usize::from(inside(&fit.dead_time, truth.dead_time));
        covered[1] += usize::from(inside(&fit.lag, truth.lag));
        if let (Some(rise), Some(fall)) = (fit.rise, fit.fall) {
            seen += 1;
            covered[2] += usize::from(inside(&rise, truth.rise));
            covered[3] += usize::from(inside(&fall, truth.fall));
        }
    }
    println!("covered {covered:?} of {RUNS}, slew seen in {seen}");
    assert!(seen > RUNS * 9 / 10, "slew seen in {seen}");
    for (which, count) in covered.into_iter().enumerate() {
        let share = count as f64 / if which < 2 { RUNS as f64 } else { seen as f64 };
        assert!((0.90..=0.99).contains(&share), "parameter {which}: {share}");
    }
}

#[test]
fn step_records_that_say_nothing_are_refused_by_name() {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let commands = steps(&LARGE);
    let good = Truth::RIG.record(&commands, 0.032, &mut rng);
    assert_eq!(fit_steps(&commands, &good[..10]), Err(StepsError::TooFew(10)));
    let mut bad = good.clone();
    bad[30].pressure = f64::NAN;
    assert_eq!(fit_steps(&commands, &bad), Err(StepsError::NotFinite { kind: "reading", index: 30 }));
    let mut bad = good.clone();
    bad.swap(40, 41);
    assert_eq!(fit_steps(&commands, &bad), Err(StepsError::NotInOrder { kind: "reading", index: 41 }));
    assert_eq!(fit_steps(&commands[..2], &good), Err(StepsError::OneWay { up: 1, down: 0 }));
    let dead: Vec<_> = good.iter().map(|r| Reading { pressure: 0.05 * r.pressure, ..*r }).collect();
    assert!(matches!(fit_steps(&commands, &dead), Err(StepsError::NotFollowing(span)) if (span - 0.05).abs() < 0.01));
    let early: Vec<_> = good.iter().map(|r| Reading { time: r.time - 0.1, ..*r }).collect();
    assert!(matches!(fit_steps(&commands, &early), Err(StepsError::Acausal(by)) if (by - 0.085).abs() < 2e-3));
    // A leak that begins half-way.
    let half = good[good.len() / 2].time;
    let leaking: Vec<_> =
        good.iter().map(|r| if r.time > half { Reading { pressure: 0.8 * r.pressure, ..*r } } else { *r }).collect();
    assert!(matches!(fit_steps(&commands, &leaking), Err(StepsError::OtherLaw { .. })));
    // A lag of 2 ms looked at every 64 ms through noise.
    let quick = Truth { lag: 2e-3, noise: 0.1 * PSI, rise: 1e9, fall: 1e9, ..Truth::RIG };
    let blurred = quick.record(&commands, 0.064, &mut rng);
    let refused = fit_steps(&commands, &blurred);
    assert!(matches!(refused, Err(StepsError::Unresolved { .. } | StepsError::NotConverged)), "{refused:?}");
}

/// Up and down between 0 and 10 psi.
fn staircase(pressure: impl Fn(f64, Direction) -> f64, noise: f64, rng: &mut Pcg64Mcg) -> Vec<StairPoint> {
    let noise = Normal::new(0.0, noise).unwrap();
    let up = (0..=10).map(|i| (f64::from(i) * PSI, Direction::Rising));
    let down = (0..10).rev().map(|i| (f64::from(i) * PSI, Direction::Falling));
    let point = |(command, direction)| StairPoint {
        command,
        pressure: pressure(command, direction) + noise.sample(rng),
        direction,
    };
    up.chain(down).map(point).collect()
}

/// A loop of 2 % of the range, widest in its middle.
fn sound(command: f64, direction: Direction) -> f64 {
    let x = command / (10.0 * PSI);
    let half = 0.1 * PSI * 4.0 * x * (1.0 - x);
    0.02 * PSI + 1.003 * command + if direction == Direction::Rising { -half } else { half }
}

#[test]
fn zero_span_and_hysteresis_come_back() {
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    let rules = StaircaseRules::default();
    let fit = fit_staircase(&staircase(sound, 0.0, &mut rng), &rules).unwrap();
    assert!((fit.zero.value - 0.02 * PSI).abs() < 1e-6 * PSI && (fit.span.value - 1.003).abs() < 1e-9, "{fit:?}");
    assert!((fit.hysteresis.value - 0.2 * PSI).abs() < 1e-6 * PSI && fit.floor.is_none(), "{fit:?}");
    assert_eq!(fit.levels, 11);
    let (mut zeros, mut spans) = (0, 0);
    for _ in 0..200 {
        let fit = fit_staircase(&staircase(sound, 0.01 * PSI, &mut rng), &rules).unwrap();
        // The greatest of eleven differences, each +- 0.014 psi.
        assert!((fit.hysteresis.value - 0.2 * PSI).abs() < 0.06 * PSI, "{fit:?}");
        zeros += usize::from(inside(&fit.zero, 0.02 * PSI));
        spans += usize::from(inside(&fit.span, 1.003));
    }
    println!("zero covered {zeros}, span {spans} of 200");
    assert!((180..=198).contains(&zeros) && (180..=198).contains(&spans), "{zeros} {spans}");
}

#[test]
fn an_analogue_regulator_that_does_not_reach_zero_has_a_floor() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    // DAC codes: 0.5 psi up to code 400, then 4 psi per 1000 codes.
    let points: Vec<_> = staircase(|_, _| 0.0, 0.005 * PSI, &mut rng)
        .into_iter()
        .map(|p| {
            let code = p.command / PSI * 300.0;
            let noise = p.pressure;
            let pressure = (4.0e-3 * PSI * (code - 450.0)).max(0.0) + 0.5 * PSI + noise;
            StairPoint { command: code, pressure, ..p }
        })
        .collect();
    let rules = StaircaseRules { span: 3.5e-3 * PSI..=4.5e-3 * PSI, ..StaircaseRules::default() };
    let fit = fit_staircase(&points, &rules).unwrap();
    let floor = fit.floor.unwrap();
    assert!((floor.value - 0.5 * PSI).abs() < 0.015 * PSI, "{fit:?}");
    assert!((fit.opening - 450.0).abs() < 10.0, "{fit:?}");
    assert!((fit.span.value / (4.0e-3 * PSI) - 1.0).abs() < 5e-3, "{fit:?}");
}

#[test]
fn staircases_of_unsound_regulators_are_refused_with_value_and_rule() {
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    let rules = StaircaseRules::default();
    let mut fit =
        |pressure: &dyn Fn(f64, Direction) -> f64| fit_staircase(&staircase(pressure, 0.005 * PSI, &mut rng), &rules);
    // The simulated valve behind a leak: its settled pressure is 1 / (1 + lag / leak) of the command.
    let settled = |leak: f64| 1.0 / (1.0 + 0.06 / leak);
    let on_the_way_up = fit(&|c, d| {
        let leaking = d == Direction::Falling || c > 6.5 * PSI;
        c * if leaking { settled(1.0) } else { 1.0 }
    });
    assert!(
        matches!(on_the_way_up, Err(StaircaseError::Leak { command, share, limit, .. })
            if command == 6.0 * PSI && share > 0.03 && limit == 0.005),
        "{on_the_way_up:?}"
    );
    let on_the_way_down = fit(&|c, d| if d == Direction::Falling && c < 5.5 * PSI { c * settled(1.0) } else { c });
    assert!(matches!(on_the_way_down, Err(StaircaseError::Leak { .. })), "{on_the_way_down:?}");
    let from_the_start = fit(&|c, _| c * settled(0.5));
    assert!(matches!(from_the_start, Err(StaircaseError::Span { value, .. }) if (value - 0.893).abs() < 0.01));
    assert!(matches!(fit(&|c, _| 1.2 * c), Err(StaircaseError::Span { high, .. }) if high == 1.05));
    let bent = fit(&|c, _| c * (0.7 + 0.03 * c / PSI));
    assert!(matches!(bent, Err(StaircaseError::NotLinear { .. })), "{bent:?}");
    let sticky = fit(&|c, d| c + if d == Direction::Falling && c > 0.0 { 0.8 * PSI } else { 0.0 });
    assert!(matches!(sticky, Err(StaircaseError::Hysteresis { .. })), "{sticky:?}");
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let good = staircase(sound, 0.0, &mut rng);
    assert_eq!(fit_staircase(&good[..5], &rules), Err(StaircaseError::TooFew(5)));
    assert_eq!(fit_staircase(&good[..11], &rules), Err(StaircaseError::OneWay(PSI)));
    let mut broken = good.clone();
    broken[3].pressure = f64::INFINITY;
    assert_eq!(fit_staircase(&broken, &rules), Err(StaircaseError::NotFinite(3)));
}

/// Each channel alone, then none; `gain[pressure][channel]`.
fn trials(gain: &[&[f64]], rng: &mut Pcg64Mcg) -> Vec<Trial> {
    let channels = gain[0].len();
    let noise = Normal::new(0.0, 0.01 * PSI).unwrap();
    let mut trials = Vec::new();
    for round in 0..2 {
        for on in 0..=channels {
            let commands: Vec<f64> =
                (0..channels).map(|c| if c == on { 1000.0 + 200.0 * f64::from(round) } else { 0.0 }).collect();
            let pressure = |row: &&[f64]| row.iter().zip(&commands).map(|(g, c)| g * c * PSI / 1000.0).sum::<f64>();
            let pressures = gain.iter().map(|row| pressure(row) + 0.3 * PSI + noise.sample(rng)).collect();
            trials.push(Trial { commands, pressures });
        }
    }
    trials
}

#[test]
fn the_channel_map_is_measured() {
    let mut rng = Pcg64Mcg::seed_from_u64(10);
    let crossed = trials(
        &[&[0.0, 0.0, 3.0, 0.02], &[2.0, 0.0, 0.01, 0.0], &[0.0, 0.0, 0.0, 3.0], &[0.0, 3.0, 0.0, 0.0]],
        &mut rng,
    );
    let map = map_channels(&crossed, PSI).unwrap();
    assert_eq!(map.channels, [2, 0, 3, 1]);
    assert!((map.responses[1].value / (2.4 * PSI) - 1.0).abs() < 0.02 && map.crosstalk < 0.02, "{map:?}");
    // Two regulators on a DAC of four.
    let map = map_channels(&trials(&[&[0.0, 0.0, 0.0, 3.0], &[0.0, 3.0, 0.0, 0.0]], &mut rng), PSI).unwrap();
    assert_eq!((map.channels, map.unconnected), (vec![3, 1], vec![0, 2]));
}

#[test]
fn ambiguous_channels_are_refused_by_name() {
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    let mut map = |gain: &[&[f64]]| map_channels(&trials(gain, &mut rng), PSI);
    let dead = map(&[&[3.0, 0.0], &[0.0, 0.0]]);
    assert!(matches!(&dead, Err(ChannelError::Dead { pressure: 1, dead, .. }) if *dead == [1]), "{dead:?}");
    let shared = map(&[&[3.0, 3.0], &[0.0, 0.0]]);
    assert!(matches!(shared, Err(ChannelError::Shared { pressure: 0, .. })), "{shared:?}");
    let split = map(&[&[3.0, 0.0], &[3.0, 0.0]]);
    assert_eq!(split, Err(ChannelError::Split { channel: 0, first: 0, second: 1 }));
    let sagging = map(&[&[3.0, -0.6], &[0.0, 3.0]]);
    assert!(matches!(sagging, Err(ChannelError::Shared { pressure: 0, other: 1, share, .. }) if share < -0.15));
    let mut good = trials(&[&[3.0, 0.0], &[0.0, 3.0]], &mut rng);
    assert_eq!(map_channels(&good[..3], PSI), Err(ChannelError::TooFew { channels: 2, trials: 3 }));
    let still: Vec<_> = good.iter().map(|t| Trial { commands: vec![t.commands[0], 5.0], ..t.clone() }).collect();
    assert_eq!(map_channels(&still, PSI), Err(ChannelError::NotTried(1)));
    let both: Vec<_> = good.iter().map(|t| Trial { commands: vec![t.commands[0]; 2], ..t.clone() }).collect();
    assert_eq!(map_channels(&both, PSI), Err(ChannelError::Together));
    good[2].pressures.pop();
    assert_eq!(map_channels(&good, PSI), Err(ChannelError::Shape(2)));
    good[2].pressures.push(f64::NAN);
    assert_eq!(map_channels(&good, PSI), Err(ChannelError::NotFinite(2)));
}

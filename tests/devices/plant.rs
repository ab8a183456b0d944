//! The simulated rig's physics: bits that do not depend on who asks when, and behaviour that is what was configured.

use std::time::Duration;

use freerig::clock::Time;
use freerig::model::{Free, Kinematics, Law, Lumped};
use freerig::sim::{BenchConfig, HardStop, ImuSim, Plant, PlantFault, PlantSim, RegulatorSim, STEP, Valve};
use freerig::units::PASCAL_PER_PSI;

const PSI: f64 = PASCAL_PER_PSI;

fn at(seconds: f64) -> Time {
    Time::from_nanos((seconds * 1e9).round() as u64)
}

/// Quick regulator, no noise, no scatter, no friction, no load: each test adds what it is about.
fn sim() -> PlantSim {
    PlantSim {
        nominal: Free::published_code(),
        scatter: 0.0,
        hysteresis: 0.0,
        load_moment: 0.0,
        knob: None,
        regulator: RegulatorSim {
            lag: Duration::from_millis(60),
            dead_time: Duration::from_millis(20),
            slew: 100.0 * PSI,
            noise: 0.0,
            full_scale: 15.0 * PSI,
        },
        analogue: None,
    }
}

fn bench(plants: Vec<PlantSim>, seed: u64) -> BenchConfig {
    let imu = ImuSim { delay: Duration::ZERO, noise: 0.0, rate_noise: 0.0 };
    BenchConfig { seed, plants, module: None, imu, dump_valve: true, one_shot: false }
}

/// The plant of `config`, its dump valve closed.
fn built(config: &BenchConfig) -> Plant {
    let mut plant = Plant::new(config);
    plant.set_dump(false, Time::ZERO);
    plant
}

fn plant(sim: PlantSim) -> Plant {
    built(&bench(vec![sim], 1))
}

/// Everything a plant says about its FREEs at a time, to the bit.
fn bits(plant: &mut Plant, t: f64) -> Vec<u64> {
    let mut bits = Vec::new();
    for free in 0..plant.free_count() {
        let (truth, motion) = (plant.truth(free, at(t)), plant.orientation(free, at(t)));
        bits.extend([truth.angle, truth.extension, truth.pressure, plant.reading(free, at(t))].map(f64::to_bits));
        bits.extend(motion.quaternion.iter().chain(&motion.rate).chain(&motion.acceleration).map(|x| x.to_bits()));
    }
    bits
}

/// Something that happens to the plant at a time, s.
type Event<'a> = (f64, &'a dyn Fn(&mut Plant));

#[test]
fn the_same_bits_come_out_however_the_plant_is_asked() {
    let rough = PlantSim { scatter: 0.03, hysteresis: 0.03, load_moment: 2e-3, ..sim() };
    let rough = PlantSim { regulator: RegulatorSim { noise: 30.0, ..rough.regulator }, ..rough };
    let config = bench(vec![rough, rough], 7);
    let times = [0.9, 1.000_03, 1.7, 2.499_999, 2.5];
    // Everything told at once, in the beginning, and one question in the end.
    let mut one = built(&config);
    one.set_setpoint(0, 5.0 * PSI, at(0.1));
    one.set_setpoint(1, 7.0 * PSI, at(0.3));
    one.inject(PlantFault::Leak(1, 0.4), at(1.2));
    one.set_setpoint(0, 2.0 * PSI, at(1.3));
    one.set_dump(true, at(2.2));
    one.advance_to(at(2.5));
    let one: Vec<_> = times.iter().map(|&t| bits(&mut one, t)).collect();
    // Told when it happens, asked all the time and at odd instants.
    let mut two = built(&config);
    let mut told = 0;
    for i in 0..25_000u32 {
        let t = f64::from(i) * 1e-4;
        let events: [Event<'_>; 5] = [
            (0.1, &|p| p.set_setpoint(0, 5.0 * PSI, at(0.1))),
            (0.3, &|p| p.set_setpoint(1, 7.0 * PSI, at(0.3))),
            (1.2, &|p| p.inject(PlantFault::Leak(1, 0.4), at(1.2))),
            (1.3, &|p| p.set_setpoint(0, 2.0 * PSI, at(1.3))),
            (2.2, &|p| p.set_dump(true, at(2.2))),
        ];
        while told < events.len() && events[told].0 <= t {
            events[told].1(&mut two);
            told += 1;
        }
        if i % 3 == 0 {
            bits(&mut two, t);
        }
        // A look back in time does not disturb either.
        if i % 100 == 0 {
            bits(&mut two, (t - 0.5).max(0.0));
        }
    }
    let two: Vec<_> = times.iter().map(|&t| bits(&mut two, t)).collect();
    assert_eq!(one, two);
    // And another seed is another rig.
    let mut other = Plant::new(&BenchConfig { seed: 8, ..config });
    assert_ne!(other.true_free(0), Plant::new(&bench(vec![rough, rough], 7)).true_free(0));
    assert_ne!(bits(&mut other, 0.9), one[0]);
}

#[test]
fn dead_time_and_lag_are_what_was_configured() {
    let mut plant = plant(sim());
    let target = 2.0 * PSI;
    plant.set_setpoint(0, target, at(0.1));
    // Not a pascal before the dead time is over.
    assert_eq!(plant.pressure(0, at(0.12)), 0.0);
    let rise = |plant: &mut Plant, t: f64| plant.pressure(0, at(0.12 + t)) / target;
    // A first-order lag is stepped exactly: only rounding is left (readings fall on grid points).
    for t in [0.06, 0.12, 0.18] {
        assert!((rise(&mut plant, t) - (1.0 - (-t / 0.06f64).exp())).abs() < 1e-9, "{t}");
    }
}

#[test]
fn the_slew_limit_is_what_was_configured() {
    let slow = RegulatorSim { slew: 10.0 * PSI, ..sim().regulator };
    let mut plant = plant(PlantSim { regulator: slow, ..sim() });
    plant.set_setpoint(0, 10.0 * PSI, at(0.0));
    // The lag alone would begin with 167 psi/s: the limit rules until 0.6 psi are left.
    let rate = (plant.pressure(0, at(0.8)) - plant.pressure(0, at(0.3))) / 0.5;
    assert!((rate / (10.0 * PSI) - 1.0).abs() < 1e-9, "{rate}");
    // Beyond the full scale nothing is fed.
    plant.set_setpoint(0, 40.0 * PSI, at(2.0));
    assert!(plant.pressure(0, at(6.0)) <= 15.0 * PSI);
}

/// Width of the measured angle-pressure loop over its range of angle, on the second of two slow cycles.
fn measured_loop(sim: PlantSim) -> f64 {
    let mut plant = plant(sim);
    // Half-cycles of 5 s: 14 degrees a second, viscous lag ct/kt is 0.5 ms of that.
    let half = 5.0;
    for i in 0..4 * 500u32 {
        let t = f64::from(i) * half / 500.0;
        let phase = (t / half) % 2.0;
        plant.set_setpoint(0, 7.0 * PSI * if phase < 1.0 { phase } else { 2.0 - phase }, at(t));
    }
    let mut branches = [Vec::new(), Vec::new()];
    for i in 0..10_000u32 {
        let t = 2.0 * half + f64::from(i) * 1e-3;
        let truth = plant.truth(0, at(t));
        branches[usize::from(t >= 3.0 * half)].push((truth.pressure, truth.angle));
    }
    let angle = |branch: &[(f64, f64)], pressure: f64| {
        let x = branch.windows(2).find(|w| (w[0].0 - pressure) * (w[1].0 - pressure) <= 0.0 && w[0].0 != w[1].0)?;
        Some(x[0].1 + (x[1].1 - x[0].1) * (pressure - x[0].0) / (x[1].0 - x[0].0))
    };
    let all = || branches.iter().flatten().map(|b| b.1);
    let range = all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min);
    let width = (5..=65)
        .filter_map(|i| {
            let p = f64::from(i) * 0.1 * PSI;
            Some((angle(&branches[0], p)? - angle(&branches[1], p)?).abs())
        })
        .fold(0.0, f64::max);
    width / range
}

#[test]
fn the_hysteresis_loop_is_as_wide_as_stated() {
    for stated in [0.02, 0.05] {
        let measured = measured_loop(PlantSim { hysteresis: stated, ..sim() });
        // The cycle here is dynamic and its ends are rounded by the regulator's lag; the stated one is quasi-static.
        assert!((measured / stated - 1.0).abs() < 0.05, "stated {stated}, measured {measured}");
    }
    let none = measured_loop(sim());
    // What is left is the inertia's and damping's lag.
    assert!(none < 1e-3, "{none}");
}

#[test]
fn the_steady_state_is_the_models_static_angle_within_the_hysteresis() {
    for (hysteresis, pressures) in [(0.0, [1.0, 3.5, 7.0]), (0.04, [1.0, 3.5, 7.0])] {
        for psi in pressures {
            let mut plant = plant(PlantSim { hysteresis, scatter: 0.03, ..sim() });
            let free = *plant.true_free(0).unwrap();
            let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
            plant.set_setpoint(0, psi * PSI, at(0.0));
            let angle = plant.truth(0, at(4.0)).angle;
            let exact = model.static_angle(psi * PSI).unwrap();
            let range = model.static_angle(7.0 * PSI).unwrap();
            // Without friction the ring-down (14 /s) has left e^-56 of the step. With it, the way up from the rest
            // after a cycle lies below the springs alone by the loop's whole width, and by more where the FREE has
            // softened: at 7 psi its stiffness has fallen by a third.
            let tolerance = (1.5 * hysteresis * range).abs().max(1e-9);
            assert!((angle - exact).abs() <= tolerance, "{psi} psi, {hysteresis}: {angle} for {exact}");
            assert!(angle * free.direction() > 0.0);
        }
    }
}

#[test]
fn the_external_moment_turns_the_end() {
    let mut plant = plant(PlantSim { load_moment: 5e-3, ..sim() });
    let kt = Free::published_code().torsional_stiffness;
    assert!((plant.truth(0, at(0.0)).angle - 5e-3 / kt).abs() < 1e-9, "at rest from the beginning");
    plant.inject(PlantFault::Load(0, -5e-3), at(0.1));
    assert!((plant.truth(0, at(4.0)).angle + 5e-3 / kt).abs() < 1e-9);
}

#[test]
fn the_dump_valve_vents_whatever_the_regulator_does() {
    // Without current it is open.
    let mut dead = Plant::new(&bench(vec![sim()], 1));
    dead.set_setpoint(0, 5.0 * PSI, at(0.0));
    assert_eq!(dead.pressure(0, at(1.0)), 0.0);
    let mut plant = plant(sim());
    plant.set_setpoint(0, 5.0 * PSI, at(0.0));
    plant.inject(PlantFault::Valve(0, Valve::StuckOpen), at(1.0));
    let before = plant.pressure(0, at(1.5));
    assert!(before > 10.0 * PSI, "the stuck valve feeds");
    let full = plant.pressure(0, at(2.0));
    plant.set_dump(true, at(2.0));
    // 10 ms until it is open, then a time constant of 100 ms.
    let vented = plant.pressure(0, at(2.31)) / plant.pressure(0, at(2.01));
    assert!((vented - (-3f64).exp()).abs() < 1e-9, "{vented}");
    assert!(plant.pressure(0, at(3.0)) < 0.2 * PSI && full > 10.0 * PSI);
    // One that sticks does nothing, and neither does one that is not fitted.
    for fitted in [true, false] {
        let mut plant = built(&BenchConfig { dump_valve: fitted, ..bench(vec![sim()], 1) });
        plant.set_setpoint(0, 5.0 * PSI, at(0.0));
        plant.inject(PlantFault::DumpStuck(true), at(0.0));
        plant.set_dump(true, at(1.0));
        assert!(plant.pressure(0, at(2.0)) > 4.9 * PSI);
    }
}

#[test]
fn a_valve_sticks_a_tube_leaks_and_the_supply_fails() {
    let mut plant = plant(sim());
    plant.set_setpoint(0, 5.0 * PSI, at(0.0));
    plant.inject(PlantFault::Valve(0, Valve::Stuck), at(1.0));
    plant.set_setpoint(0, 0.0, at(1.0));
    let stuck = plant.pressure(0, at(1.2));
    assert!(stuck > 4.9 * PSI && plant.pressure(0, at(2.0)) == stuck);
    plant.inject(PlantFault::Leak(0, 0.05), at(2.0));
    assert!((plant.pressure(0, at(2.05)) / stuck - (-1f64).exp()).abs() < 1e-9);
    plant.inject(PlantFault::Leak(0, f64::INFINITY), at(2.5));
    plant.inject(PlantFault::Valve(0, Valve::Working), at(2.5));
    plant.inject(PlantFault::Supply(1.0 * PSI), at(2.5));
    plant.set_setpoint(0, 5.0 * PSI, at(2.5));
    assert!((plant.pressure(0, at(4.0)) - PSI).abs() < 1.0);
}

#[test]
fn a_run_away_ends_at_a_hard_stop_and_comes_back() {
    // 30 deg, soft: the radius grows faster than kt holds.
    let free = Free { gamma: -30f64.to_radians(), torsional_stiffness: 0.03, ..Free::published_code() };
    let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
    assert!(model.static_angle(10.0 * PSI).is_err(), "the model itself names the run-away");
    let mut plant = plant(PlantSim { nominal: free, hysteresis: 0.03, ..sim() });
    plant.set_setpoint(0, 14.0 * PSI, at(0.0));
    let truth = plant.truth(0, at(3.0));
    assert_eq!(plant.hard_stop(0), Some(HardStop::Rotation));
    assert!(truth.angle.is_finite() && truth.extension.is_finite());
    plant.set_setpoint(0, 0.0, at(3.0));
    let back = plant.truth(0, at(8.0));
    assert_eq!(plant.hard_stop(0), None);
    assert!(back.angle.abs() < 0.1 * truth.angle.abs(), "{} {}", back.angle, truth.angle);
}

#[test]
fn what_moved_a_while_ago_is_remembered_and_interpolated() {
    let mut plant = plant(sim());
    plant.set_setpoint(0, 5.0 * PSI, at(0.0));
    let then = plant.orientation(0, at(0.15));
    plant.advance_to(at(2.1));
    assert_eq!(plant.orientation(0, at(0.15)), then);
    // Between two grid points the quaternion stays a unit one, and the angle lies between theirs.
    let (a, b) = (at(0.15), at(0.15) + STEP);
    let (a, m, b) = (plant.truth(0, a), plant.truth(0, a + STEP / 2), plant.truth(0, b));
    assert!((m.angle - 0.5 * (a.angle + b.angle)).abs() < 1e-15);
    let q = plant.orientation(0, at(0.150_1)).quaternion;
    assert!((q.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-14);
}

#[test]
fn the_reading_has_the_stated_noise_and_the_pressure_none() {
    let noisy = RegulatorSim { noise: 50.0, ..sim().regulator };
    let mut plant = plant(PlantSim { regulator: noisy, ..sim() });
    let n = 8000u32;
    let readings: Vec<f64> = (0..n).map(|i| plant.reading(0, at(f64::from(i) * 250e-6))).collect();
    let mean = readings.iter().sum::<f64>() / f64::from(n);
    let deviation = (readings.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / f64::from(n)).sqrt();
    // Four standard errors of mean and deviation.
    assert!(mean.abs() < 4.0 * 50.0 / f64::from(n).sqrt(), "{mean}");
    assert!((deviation - 50.0).abs() < 4.0 * 50.0 / f64::from(2 * n).sqrt(), "{deviation}");
    assert_eq!(plant.pressure(0, at(1.0)), 0.0);
}

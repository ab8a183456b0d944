//! Damping by plucks against simulated FREEs whose truth is known: their friction has other elements than the fit's,
//! their hand is not exact, and the sensor is late, noisy, quantised and read a little after its frames.

use std::time::Duration;

use freerig::clock::Time;
use freerig::ident::Measured;
use freerig::ident::pluck::{
    Loaded, PluckError, PluckFit, Reading, Regime, Rules, evened, fit_plucks, releases, torsion_of_series,
};
use freerig::ident::ringdown::RingDownError;
use freerig::model::Free;
use freerig::sim::{BenchConfig, Hand, ImuSim, Plant, PlantSim, RegulatorSim};
use freerig::units::PASCAL_PER_PSI;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// The FREE of the published code: 40 Hz, damping ratio 0.058.
fn ringing() -> Free {
    Free {
        length: 0.12,
        axial_stiffness: 16478.0,
        torsional_stiffness: 0.0862,
        axial_damping: 0.34,
        torsional_damping: 3.97e-5,
        ..Free::paper()
    }
}

/// What a BNO055 records while `hand` plucks a FREE that is scattered around `nominal`; the true FREE.
fn record(nominal: Free, seed: u64, hysteresis: f64, angle: f64, added: f64) -> (Vec<Reading>, Free) {
    let regulator = RegulatorSim {
        lag: Duration::from_millis(60),
        dead_time: Duration::from_millis(15),
        slew: 30.0 * PASCAL_PER_PSI,
        noise: 0.01 * PASCAL_PER_PSI,
        full_scale: 15.0 * PASCAL_PER_PSI,
    };
    let (delay, noise, rate_noise) = (Duration::from_millis(15), 0.05f64.to_radians(), 0.1f64.to_radians());
    let mut plant = Plant::new(&BenchConfig {
        seed,
        plants: vec![PlantSim {
            nominal,
            scatter: 0.03,
            hysteresis,
            load_moment: 0.0,
            knob: None,
            regulator,
            analogue: None,
        }],
        module: None,
        imu: ImuSim { delay, noise, rate_noise },
        dump_valve: true,
        one_shot: false,
    });
    let truth = *plant.true_free(0).unwrap();
    let releases_s = (0..6).map(|i| 4.0 + 5.0 * f64::from(i)).collect();
    let hand = Hand { releases_s, angle_rad: angle.to_radians(), added_inertia_kg_m2: added };
    plant.pluck(0, &hand, Time::ZERO, Time::ZERO + Duration::from_secs(34));
    let mut random = Pcg64::seed_from_u64(seed + 99);
    let steps = |x: f64, step: f64| (x / step).round() * step;
    let reading = |k: u32| {
        let frame = 0.02 + 0.01002 * f64::from(k);
        let seen = plant.orientation(0, Time::ZERO + Duration::from_secs_f64(frame) - delay);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let angle = 2.0 * seen.quaternion[3].atan2(seen.quaternion[0]) + noise * normal();
        let rate = seen.rate[2] + rate_noise * normal();
        Reading {
            time: frame + 0.0015 * random.random::<f64>(),
            angle: steps(angle, 2f64.powi(-13)),
            rate: steps(rate, 1f64.to_radians() / 16.0),
        }
    };
    let readings: Vec<_> = (0..3390).map(reading).collect();
    (evened(&readings), truth)
}

fn fit(record: &[Reading], ratio: f64) -> Result<PluckFit, PluckError> {
    fit_plucks(record, &releases(record, &Rules::default())?, ratio, 20.0)
}

/// Within three standard uncertainties.
#[track_caller]
fn covers(found: Measured, truth: f64) {
    assert!(found.uncertainty > 0.0 && (found.value - truth).abs() <= 3.0 * found.uncertainty, "{found:?}, is {truth}");
}

#[test]
fn a_free_that_creeps_gives_its_damping_over_its_stiffness_with_and_without_friction() {
    for (seed, hysteresis, best) in [(1, 0.05, 0.03), (4, 0.05, 0.03), (2, 0.0, 0.001)] {
        let (record, truth) = record(Free::paper(), seed, hysteresis, 40.0, 0.0);
        let found = fit(&record, truth.inertia / truth.torsional_stiffness).unwrap();
        let Regime::Creeps { time } = found.regime else { panic!("{:?}", found.regime) };
        covers(time, truth.torsional_damping / truth.torsional_stiffness);
        assert!(time.uncertainty < best * time.value, "{time:?}");
    }
}

#[test]
fn added_inertias_give_a_ringing_free_without_friction_to_a_per_cent() {
    let mut records = Vec::new();
    let mut free = ringing();
    for (added, angle) in [(2e-5, 17.0), (6e-5, 29.0)] {
        let (record, truth) = record(ringing(), 3, 0.0, angle, added);
        let found = fit(&record, 1.6e-5).unwrap();
        let Regime::Rings { damping, stiffness, frequency } = found.regime else { panic!("{:?}", found.regime) };
        let natural = (truth.torsional_stiffness / (truth.inertia + added)).sqrt() / std::f64::consts::TAU;
        assert!((frequency / natural - 1.0).abs() < 0.05, "{frequency} {natural}");
        records.push(Loaded { added, damping, stiffness });
        free = truth;
    }
    let found = torsion_of_series(&records).unwrap();
    covers(found.inertia, free.inertia);
    covers(found.stiffness, free.torsional_stiffness);
    covers(found.damping, free.torsional_damping);
    assert!(found.damping.uncertainty < 0.01 * found.damping.value, "{found:?}");
    // A fourteenth of what was added.
    assert!(found.inertia.uncertainty < 0.05 * found.inertia.value, "{found:?}");
}

#[test]
fn friction_that_takes_most_of_the_energy_shows_in_the_uncertainty() {
    for seed in [1, 2] {
        let (record, truth) = record(ringing(), seed, 0.05, 29.0, 6e-5);
        let found = fit(&record, 1.6e-5).unwrap();
        let Regime::Rings { damping, stiffness, .. } = found.regime else { panic!("{:?}", found.regime) };
        let inertia = truth.inertia + 6e-5;
        covers(damping, truth.torsional_damping / inertia);
        covers(stiffness, truth.torsional_stiffness / inertia);
        assert!(found.slip > 0.01 && damping.uncertainty > 0.02 * damping.value, "{found:?}");
    }
}

#[test]
fn what_rings_beyond_the_sensor_is_refused_by_its_frequency() {
    let (record, truth) = record(ringing(), 1, 0.0, 5.0, 0.0);
    let natural = (truth.torsional_stiffness / truth.inertia).sqrt() / std::f64::consts::TAU;
    match fit(&record, 1.6e-5) {
        Err(PluckError::RingDown(RingDownError::BeyondSensor { frequency, .. })) => {
            assert!((frequency / natural - 1.0).abs() < 0.2, "{frequency} {natural}");
        }
        other => panic!("{other:?}"),
    }
}

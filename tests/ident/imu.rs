//! Identification of an IMU: quaternions are made with nalgebra's rotations and quantised as the chip does it.

use freerig::ident::imu::*;
use nalgebra::{Unit, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal, StandardNormal};
use rand_pcg::Pcg64Mcg;

const DEG: f64 = std::f64::consts::PI / 180.0;
/// The BNO055's quaternion: 2^-14, which is 0.007 deg of rotation.
const QUATERNION_STEP: f64 = 1.0 / 16384.0;
const ANGLE_STEP: f64 = 2.0 * QUATERNION_STEP;
const RATE_STEP: f64 = DEG / 16.0;

#[derive(Clone, Copy)]
struct Still {
    readings: usize,
    noise: f64,
    quantum: f64,
    /// rad / sqrt(s)
    walk: f64,
    drift: f64,
    rate_noise: f64,
    rate_bias: f64,
}

impl Still {
    /// The acceptance rig: 100 Hz, 0.05 deg, quantised; a minute.
    const RIG: Self = Self {
        readings: 6000,
        noise: 0.05 * DEG,
        quantum: ANGLE_STEP,
        walk: 0.0,
        drift: 0.2 * DEG / 60.0,
        rate_noise: 0.1 * DEG,
        rate_bias: 0.02 * DEG,
    };

    fn samples(&self, rng: &mut Pcg64Mcg) -> Vec<StillSample> {
        let mut normal = |sigma: f64| sigma * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, rng);
        let round = |x: f64, step: f64| if step > 0.0 { (x / step).round() * step } else { x };
        let mut wandered = 0.0;
        let sample = |i| {
            let time = 0.01 * i as f64 + normal(2e-4);
            wandered += normal(self.walk * 0.1);
            StillSample {
                time,
                angle: round(0.3 + self.drift * time + wandered + normal(self.noise), self.quantum),
                rate: round(self.rate_bias + normal(self.rate_noise), RATE_STEP),
            }
        };
        (0..self.readings).map(sample).collect()
    }
}

fn rules() -> StillRules {
    StillRules::default()
}

#[test]
fn noise_quantum_drift_and_jitter_come_back() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let fit = noise_and_drift(&Still::RIG.samples(&mut rng), &rules()).unwrap();
    let expected = (Still::RIG.noise.powi(2) + ANGLE_STEP.powi(2) / 12.0).sqrt();
    // 6000 readings: 1 % of a standard deviation; the rate's quantum adds 0.8 % of its own.
    assert!((fit.noise / expected - 1.0).abs() < 0.04, "{fit:?}");
    assert!((fit.quantum.unwrap() / ANGLE_STEP - 1.0).abs() < 1e-6, "{fit:?}");
    assert!((fit.drift.value - Still::RIG.drift).abs() < 4.0 * fit.drift.uncertainty, "{fit:?}");
    assert!((fit.rate_noise / (0.1 * DEG) - 1.0).abs() < 0.06, "{fit:?}");
    assert!((fit.rate_bias.value - 0.02 * DEG).abs() < 4.0 * fit.rate_bias.uncertainty, "{fit:?}");
    // Differences of two jittering times.
    assert!((fit.period - 0.01).abs() < 2e-5 && (fit.jitter / (2e-4 * 2f64.sqrt()) - 1.0).abs() < 0.05, "{fit:?}");
    assert_eq!((fit.missing, fit.readings), (0, 6000));
}

#[test]
fn missing_readings_are_counted_and_a_few_allowed() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let all = Still::RIG.samples(&mut rng);
    let kept: Vec<_> =
        all.iter().enumerate().filter(|(i, _)| i % 100 != 7 && !(500..520).contains(i)).map(|(_, s)| *s).collect();
    let fit = noise_and_drift(&kept, &rules()).unwrap();
    assert_eq!(fit.missing, all.len() - kept.len());
    assert!((fit.longest_gap - 0.22).abs() < 0.02, "{fit:?}");
    let half: Vec<_> = all.iter().enumerate().filter(|(i, _)| i % 10 != 3).map(|(_, s)| *s).collect();
    let refused = noise_and_drift(&half, &rules());
    assert!(matches!(refused, Err(StillError::Missing { missing: 600, limit: 0.02, .. })), "{refused:?}");
}

/// How often of 200 the intervals of the drift and of the rate's bias hold the truth.
fn coverage(still: Still, seed: u64) -> (usize, usize) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut covered = (0, 0);
    for _ in 0..200 {
        let truth = Still { drift: rng.random_range(-0.5..0.5) * DEG / 60.0, ..still };
        let fit = noise_and_drift(&truth.samples(&mut rng), &rules()).unwrap();
        let holds = |(low, high): (f64, f64), x: f64| usize::from(low <= x && x <= high);
        covered.0 += holds(fit.drift.interval(), truth.drift);
        covered.1 += holds(fit.rate_bias.interval(), truth.rate_bias);
    }
    println!("covered {covered:?} of 200");
    covered
}

#[test]
fn the_intervals_cover_the_truth_as_often_as_they_say() {
    for (still, seed) in [
        (Still { readings: 3000, ..Still::RIG }, 3),
        // A random walk of 0.02 deg per root second beside it: the drift is known ten times worse.
        (Still { readings: 3000, walk: 0.02 * DEG, ..Still::RIG }, 4),
        (Still { readings: 3000, quantum: 0.0, ..Still::RIG }, 5),
    ] {
        let (drift, bias) = coverage(still, seed);
        assert!((180..=199).contains(&drift), "{drift}");
        assert!((180..=199).contains(&bias), "{bias}");
    }
}

#[test]
fn a_sensor_that_must_not_be_used_is_refused_with_value_and_rule() {
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    let noisy = Still { noise: 0.4 * DEG, ..Still::RIG }.samples(&mut rng);
    let refused = noise_and_drift(&noisy, &rules());
    assert!(
        matches!(refused, Err(StillError::Noisy { noise, limit }) if (noise / DEG - 0.4).abs() < 0.02 && limit == 0.2 * DEG),
        "{refused:?}"
    );
    let drifting = Still { drift: 3.0 * DEG / 60.0, ..Still::RIG }.samples(&mut rng);
    assert!(matches!(noise_and_drift(&drifting, &rules()), Err(StillError::Drifting { drift, .. }) if drift > 0.0));
    let good = Still::RIG.samples(&mut rng);
    // Somebody turns it slowly by 3 deg and back: under the gyro's rule, not under the angle's.
    let turned = |s: &StillSample| StillSample { angle: s.angle + 3.0 * DEG * (s.time / 5.0).sin().max(0.0), ..*s };
    let turned: Vec<_> = good.iter().map(turned).collect();
    let refused = noise_and_drift(&turned, &rules());
    assert!(matches!(refused, Err(StillError::Moving { angle, .. }) if angle > 1.0 * DEG), "{refused:?}");
    let knocked: Vec<_> = good
        .iter()
        .enumerate()
        .map(|(i, s)| StillSample { rate: s.rate + if i == 900 { 20.0 * DEG } else { 0.0 }, ..*s })
        .collect();
    assert!(matches!(noise_and_drift(&knocked, &rules()), Err(StillError::Turning { rate, .. }) if rate > 19.0 * DEG));
    assert_eq!(noise_and_drift(&good[..100], &rules()), Err(StillError::TooFew(100)));
    let mut bad = good.clone();
    bad[5].rate = f64::NAN;
    assert_eq!(noise_and_drift(&bad, &rules()), Err(StillError::NotFinite(5)));
    let mut bad = good.clone();
    bad.swap(8, 9);
    assert_eq!(noise_and_drift(&bad, &rules()), Err(StillError::NotInOrder(9)));
}

#[test]
fn a_sensor_that_never_changes_has_neither_noise_nor_quantum() {
    let still: Vec<_> = (0..1000).map(|i| StillSample { time: 0.01 * f64::from(i), angle: 0.5, rate: 0.0 }).collect();
    let fit = noise_and_drift(&still, &rules()).unwrap();
    assert!(fit.noise < 1e-12 && fit.quantum.is_none() && fit.drift.value.abs() < 1e-12, "{fit:?}");
}

fn raw(q: UnitQuaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k].map(|x| (x / QUATERNION_STEP).round() * QUATERNION_STEP)
}

/// A rotation by noise of `sigma` (rad) about each axis.
fn shaken(sigma: f64, rng: &mut Pcg64Mcg) -> UnitQuaternion<f64> {
    let normal = Normal::new(0.0, sigma).unwrap();
    UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| normal.sample(rng)))
}

/// Turned to `far` (rad, with its sign) and back about `axis` from `base`, with `bend` of it about another axis.
fn turning(
    base: UnitQuaternion<f64>,
    axis: Unit<Vector3<f64>>,
    far: f64,
    bend: f64,
    rng: &mut Pcg64Mcg,
) -> Vec<[f64; 4]> {
    let other = Unit::new_normalize(axis.cross(&Vector3::new(0.3, -0.5, 0.8)));
    let reading = |i: i32| {
        let x = 0.5 * far * (1.0 - (std::f64::consts::TAU * f64::from(i) / 300.0).cos());
        let bent = UnitQuaternion::from_axis_angle(&other, bend * x);
        let q = base * bent * UnitQuaternion::from_axis_angle(&axis, x) * shaken(0.05 * DEG, rng);
        // The chip's sign is nobody's business.
        raw(q).map(|x| if i % 7 == 3 { -x } else { x })
    };
    (0..300).map(reading).collect()
}

fn still(base: UnitQuaternion<f64>, rng: &mut Pcg64Mcg) -> Vec<[f64; 4]> {
    (0..200).map(|i| raw(base * shaken(0.05 * DEG, rng)).map(|x| if i % 5 == 2 { -x } else { x })).collect()
}

fn somewhere(rng: &mut Pcg64Mcg) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| rng.random_range(-1.8..1.8)))
}

fn direction(rng: &mut Pcg64Mcg) -> Unit<Vector3<f64>> {
    Unit::new_normalize(Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal)))
}

#[test]
fn tare_axis_and_sign_come_back_with_their_uncertainty() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let (mut tares, mut axes) = (0, 0);
    for run in 0..200 {
        let (base, axis) = (somewhere(&mut rng), direction(&mut rng));
        let tare = fit_tare(&still(base, &mut rng)).unwrap();
        let [w, x, y, z] = tare.quaternion;
        let error =
            (base.inverse() * UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))).scaled_axis();
        assert!(error.norm() < 0.03 * DEG, "{error}");
        tares += usize::from(error.x.abs() < 1.96 * tare.uncertainty);
        // Far beyond half a turn as well.
        let far = [8.0, 40.0, 250.0][run % 3] * DEG;
        let (sign, turn) = if run % 2 == 0 { (1.0, Turn::Positive) } else { (-1.0, Turn::Negative) };
        let fit = fit_axis(&tare, &turning(base, axis, sign * far, 0.0, &mut rng), turn).unwrap();
        let found = Vector3::from(fit.axis);
        assert!(found.dot(&axis) > 0.999, "{run}: {fit:?} {axis:?}");
        assert!((fit.movement / (sign * far) - 1.0).abs() < 0.05, "{fit:?}");
        let across = axis.cross(&Vector3::new(0.1, 0.2, 0.97)).normalize();
        axes += usize::from(found.dot(&across).abs() < 1.96 * fit.uncertainty);
        let nearest = axis.iamax();
        assert_eq!((fit.nearest, fit.along), (nearest, axis[nearest] > 0.0));
    }
    println!("covered: tare {tares}, axis {axes} of 200");
    assert!((180..=198).contains(&tares) && (180..=198).contains(&axes), "{tares} {axes}");
}

#[test]
fn the_off_axis_part_is_reported_and_too_much_refused() {
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    let (base, axis) = (somewhere(&mut rng), direction(&mut rng));
    let tare = fit_tare(&still(base, &mut rng)).unwrap();
    // Bending in proportion to the turn tilts the axis; its vector part curves by half the product.
    let bent = fit_axis(&tare, &turning(base, axis, 60.0 * DEG, 0.1, &mut rng), Turn::Positive).unwrap();
    assert!(bent.share > 0.005 && bent.share < 0.1, "{bent:?}");
    let mut wild = turning(base, axis, 20.0 * DEG, 0.0, &mut rng);
    let other = Unit::new_normalize(axis.cross(&Vector3::new(0.3, -0.5, 0.8)));
    wild.extend(turning(base, other, 15.0 * DEG, 0.0, &mut rng));
    let refused = fit_axis(&tare, &wild, Turn::Positive);
    assert!(matches!(refused, Err(AxisError::Across { share }) if share > 0.3), "{refused:?}");
}

#[test]
fn orientations_that_say_nothing_are_refused_by_name() {
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let (base, axis) = (somewhere(&mut rng), direction(&mut rng));
    let tare = fit_tare(&still(base, &mut rng)).unwrap();
    let small = fit_axis(&tare, &turning(base, axis, 3.0 * DEG, 0.0, &mut rng), Turn::Positive);
    assert!(matches!(small, Err(AxisError::TooSmall(x)) if x > 2.5 * DEG && x < 3.5 * DEG), "{small:?}");
    let mut both = turning(base, axis, 20.0 * DEG, 0.0, &mut rng);
    both.extend(turning(base, axis, -15.0 * DEG, 0.0, &mut rng));
    assert!(matches!(fit_axis(&tare, &both, Turn::Positive), Err(AxisError::BothWays { .. })));
    let good = turning(base, axis, 20.0 * DEG, 0.0, &mut rng);
    assert_eq!(fit_axis(&tare, &good[..19], Turn::Positive), Err(AxisError::TooFew(19)));
    let mut reset = good.clone();
    reset[50] = [0.0; 4];
    assert_eq!(fit_axis(&tare, &reset, Turn::Positive), Err(AxisError::Norm { index: 50, norm: 0.0 }));
    assert_eq!(fit_axis(&Tare { quaternion: [0.0; 4], ..tare }, &good, Turn::Positive), Err(AxisError::Tare(0.0)));
    let mut jumping = good.clone();
    jumping[70] = raw(base * UnitQuaternion::from_axis_angle(&axis, 2.0));
    assert!(matches!(fit_axis(&tare, &jumping, Turn::Positive), Err(AxisError::Jump { index: 70, .. })));
    assert_eq!(fit_tare(&good[..9]), Err(TareError::TooFew(9)));
    assert!(matches!(fit_tare(&good), Err(TareError::Moving { .. })));
    assert_eq!(fit_tare(&reset), Err(TareError::Norm { index: 50, norm: 0.0 }));
}

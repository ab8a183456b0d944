//! Sequences of targets and of pressures.

use crate::harness::{LENGTH, module};
use freerig::fem::module::{Loads, Path};
use freerig::plan::path::{follow, forecast};
use freerig::plan::whisk::{self, Eight};
use freerig::plan::{Bound, End, Limits, PlanError, Rest, Target};
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector3;

/// From rest's axis sideways and back in 2 s, at 50 Hz.
fn sideways(z: f64, far: f64) -> (Vec<f64>, Vec<Target>) {
    let times: Vec<f64> = (0..=100).map(|k| 0.02 * f64::from(k)).collect();
    let targets = times.iter().map(|t| {
        let share = 0.5 - 0.5 * (std::f64::consts::PI * t).cos();
        Target::point(Vector3::new(far * share, 0.3 * far * share, z))
    });
    let targets = targets.collect();
    (times, targets)
}

#[test]
fn a_reachable_path_is_followed_and_its_pressures_forecast_it() {
    let m = module(60.0);
    let rest = Rest::new(&m, &Loads::pressures([0.0; 4])).unwrap();
    let (times, targets) = sideways(0.131, 0.006);
    let mut told = Vec::new();
    let plan = follow(&rest, &times, &targets, &Limits::up_to(7.0 * PSI), None, &mut |done| told.push(done)).unwrap();
    assert_eq!(told, (1..=101).collect::<Vec<_>>());
    assert!(plan.valid() && plan.facts.missed == 0 && plan.facts.ramp.is_none());
    assert!(plan.facts.worst_error.unwrap() <= 1e-5 * LENGTH);
    // The rods' resolution is worth a ten-thousandth of the length.
    assert!(plan.facts.discretisation.unwrap() < 1e-4 * LENGTH, "{:?}", plan.facts);
    // Smooth: the pressures bend by less than a hundredth of their range from sample to sample.
    for p in plan.pressures.windows(3) {
        for i in 0..4 {
            assert!((p[0][i] - 2.0 * p[1][i] + p[2][i]).abs() < 0.01 * 7.0 * PSI, "{p:?}");
        }
    }
    // It comes back to where it began, pressures too: the redundancy does not drift.
    let (first, last) = (plan.pressures[0], plan.pressures[100]);
    assert!(first.iter().zip(last).all(|(a, b)| (a - b).abs() < 0.01 * PSI), "{first:?} {last:?}");
    // What the pressures do on their own.
    let alone = forecast(&rest, &times, &plan.pressures).unwrap();
    for (a, b) in plan.predicted.iter().zip(&alone.predicted) {
        let apart = (Vector3::from(a.position) - Vector3::from(b.position)).norm();
        assert!(apart < 1e-9 * LENGTH, "{apart}");
    }
    assert!(alone.planned.is_empty() && alone.facts.worst_error.is_none());
}

#[test]
fn the_slew_rate_holds_and_what_it_costs_is_said() {
    let m = module(60.0);
    let rest = Rest::new(&m, &Loads::pressures([0.0; 4])).unwrap();
    let (times, targets) = sideways(0.131, 0.006);
    let free = follow(&rest, &times, &targets, &Limits::up_to(7.0 * PSI), None, &mut |_| {}).unwrap();
    let limits = Limits { slew: 0.5 * free.facts.fastest, ..Limits::up_to(7.0 * PSI) };
    let slow = follow(&rest, &times, &targets, &limits, None, &mut |_| {}).unwrap();
    assert!(slow.facts.missed > 10 && slow.facts.fastest <= limits.slew * (1.0 + 1e-9), "{:?}", slow.facts);
    assert!(slow.clipped.iter().flatten().flatten().any(|b| matches!(b, Bound::SlewUp | Bound::SlewDown)));
    // At the turning point it has caught up or not, but at the end it waits where it should be.
    assert!(slow.facts.worst_error.unwrap() > 1e-4 && slow.valid());
    // From a given start the first sample is within the slew rate too.
    let started = follow(&rest, &times, &targets, &limits, Some(rest.state()), &mut |_| {}).unwrap();
    assert!(started.pressures[0].iter().all(|p| *p <= limits.slew * 0.02 * (1.0 + 1e-9)));
}

#[test]
fn pressures_past_a_critical_point_end_there_by_name() {
    let m = module(60.0);
    let rest = Rest::new(&m, &Loads::pressures([0.0; 4])).unwrap();
    let highest = 8.0 * PSI;
    let critical = Path::new(&m, rest.state(), &Loads::pressures([highest; 4]), 0.05)
        .and_then(|mut path| path.next_critical((-0.01, 1.0)))
        .unwrap()
        .unwrap();
    let times: Vec<f64> = (0..=80).map(f64::from).collect();
    let pressures: Vec<[f64; 4]> = times.iter().map(|t| [t / 80.0 * highest; 4]).collect();
    let plan = forecast(&rest, &times, &pressures).unwrap();
    let (at, ended) = plan.facts.ended.clone().unwrap();
    assert_eq!(ended.end, End::Buckling);
    assert!(ended.pressures.iter().all(|p| (p / (critical.mu * highest) - 1.0).abs() < 1e-3), "{ended:?}");
    assert_eq!(plan.predicted.len(), at as usize);
    assert!(!plan.valid() && plan.margins.last().unwrap().stiffness < 0.1, "{:?}", plan.margins.last());
    // Already the ramp to the first pressures.
    let past = forecast(&rest, &[0.0, 1.0], &[[highest; 4]; 2]).unwrap();
    assert!(past.predicted.is_empty() && past.facts.ramp.is_some());
    // A diagonal pair turns until neighbours touch.
    let pair: Vec<[f64; 4]> = times.iter().map(|t| [t / 80.0 * highest, 0.0, t / 80.0 * highest, 0.0]).collect();
    let (_, ended) = forecast(&rest, &times, &pair).unwrap().facts.ended.unwrap();
    assert_eq!(ended.end, End::Contact);
    assert!(ended.to_string().contains("touch"), "{ended}");
}

#[test]
fn a_path_straight_through_the_base_is_refused_before_it_is_planned() {
    let m = module(60.0);
    let rest = Rest::new(&m, &Loads::pressures([0.0; 4])).unwrap();
    let times: Vec<f64> = (0..=20).map(f64::from).collect();
    // From where the plate rests down the axis, past the base at z = 0 on the way.
    let down: Vec<Target> =
        times.iter().map(|t| Target::point(Vector3::new(0.0, 0.0, LENGTH * (1.0 - t / 16.0)))).collect();
    let limits = Limits::up_to(7.0 * PSI);
    let mut planned = 0;
    let refused = follow(&rest, &times, &down, &limits, None, &mut |done| planned = done).unwrap_err();
    // On the base's plane is as little a place for the plate as below it.
    assert!(matches!(refused, PlanError::BelowBase { z, base: 0.0, .. } if z.abs() < 1e-12), "{refused}");
    assert!(refused.to_string().contains("pass through the base") && planned == 0, "{refused}");
    // What lies above the base all the way is no such case: it is projected, and how far it is off is told.
    let plan = follow(&rest, &times[..16], &down[..16], &limits, None, &mut |_| {}).unwrap();
    let asked = plan.planned.last().unwrap().position[2];
    let got = plan.predicted.last().unwrap().position[2];
    assert!(plan.valid() && plan.facts.missed > 0 && plan.facts.shortfall.is_some());
    assert!((plan.facts.worst_error.unwrap() - (got - asked)).abs() < 1e-3, "{asked} {got} {:?}", plan.facts);
    // Nor has an eight its centre there.
    let eight = Eight::level(Vector3::new(0.0, 0.0, -0.01), 0.01, 0.004, 0.25);
    assert!(matches!(whisk::eight(&rest, &eight, &limits, 25.0), Err(PlanError::BelowBase { .. })));
}

#[test]
fn times_that_do_not_rise_are_refused() {
    let m = module(60.0);
    let rest = Rest::new(&m, &Loads::pressures([0.0; 4])).unwrap();
    for times in [&[0.0, 0.0][..], &[0.0], &[0.0, f64::NAN]] {
        let refused = forecast(&rest, times, &[[0.0; 4]; 2]);
        assert!(matches!(refused, Err(PlanError::Invalid { .. })), "{times:?}");
    }
    let refused = forecast(&rest, &[0.0, 1.0], &[[0.0; 4], [f64::INFINITY; 4]]);
    assert!(matches!(refused, Err(PlanError::Invalid { .. })));
}

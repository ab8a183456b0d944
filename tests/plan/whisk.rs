//! Whisks: the paper's pattern, its counterexample, and eights of one's own choice.

use crate::harness::module;
use crate::section::{Bending, module_with};
use freerig::fem::module::{Loads, Module};
use freerig::fem::rod::Resolution;
use freerig::plan::whisk::{Eight, Order, Pattern, Scaled, eight, pattern};
use freerig::plan::{Bound, Limits, PlanError, Rest};
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector3;

fn rest(module: &Module) -> Rest<'_> {
    Rest::new(module, &Loads::pressures([0.0; 4])).unwrap()
}

fn gentle(order: Order) -> Pattern {
    Pattern { lowest: 2.0 * PSI, highest: 6.0 * PSI, middle: 4.0 * PSI, order, ..Pattern::paper() }
}

#[test]
fn crossing_the_square_draws_an_eight_and_round_it_a_circle() {
    let m = module(60.0);
    let rest = rest(&m);
    let limits = Limits::up_to(10.0 * PSI);
    let [crossing, round] = [Order::Crossing, Order::Round].map(|order| {
        let plan = pattern(&rest, &gentle(order), &limits, 100.0).unwrap();
        assert!(plan.plan.valid() && plan.instead.is_none() && plan.plan.times.len() == 401);
        // One branch: the state depends on the pressures alone.
        assert!(plan.closure.unwrap().0 < 1e-9);
        plan.figure.unwrap()
    });
    assert!(crossing.area.abs() < 1e-3 * crossing.length * crossing.width);
    let radius = 0.5 * round.length;
    assert!((round.width / round.length - 1.0).abs() < 0.01);
    assert!((round.area / (std::f64::consts::PI * radius * radius) - 1.0).abs() < 0.01);
    assert!(round.twist[1] - round.twist[0] < 0.02 && crossing.twist[1] - crossing.twist[0] > 1.0);
    // Along its length the eight is bent as the circle is.
    assert!((2.0 * radius / crossing.length - 1.0).abs() < 0.02, "{crossing:?} {round:?}");
}

#[test]
fn with_its_bending_stiffness_an_independent_rod_model_draws_the_same() {
    // Strains of degree 6: the turn of more than a radian takes more than what is enough for bending.
    let m = module_with(Bending::Theirs, true, Resolution::DEFAULT.refined());
    let rest = rest(&m);
    let limits = Limits::up_to(10.0 * PSI);
    let [(crossing, off), (round, _)] = [Order::Crossing, Order::Round].map(|order| {
        let plan = pattern(&rest, &gentle(order), &limits, 25.0).unwrap();
        (plan.figure.unwrap(), plan.plan.facts.discretisation.unwrap())
    });
    // It draws 10.4 x 2.4 mm and a circle of 5.2 mm radius, given to two digits, from a mesh of its own.
    assert!((crossing.length / 10.4e-3 - 1.0).abs() < 0.1, "{crossing:?}");
    assert!((crossing.width / 2.4e-3 - 1.0).abs() < 0.1, "{crossing:?}");
    assert!((0.5 * round.length / 5.2e-3 - 1.0).abs() < 0.1, "{round:?}");
    // What the usual resolution lacks is what it says it lacks.
    let usual = m.with_resolution(Resolution::DEFAULT).unwrap();
    let rest = Rest::new(&usual, &Loads::pressures([0.0; 4])).unwrap();
    let plan = pattern(&rest, &gentle(Order::Crossing), &limits, 25.0).unwrap();
    let said = plan.plan.facts.discretisation.unwrap();
    let lacks = (plan.figure.unwrap().width - crossing.width).abs();
    // Either side of the width may be off by it.
    assert!(off < 0.2 * said && lacks < 2.5 * said && said < 2.5 * lacks, "{off} {said} {lacks}");
}

#[test]
fn it_is_the_bending_stiffness_that_makes_the_eight_as_wide_as_it_is() {
    let width = |bending, unsheared| {
        let m = module_with(bending, unsheared, Resolution::DEFAULT.refined());
        let plan = pattern(&rest(&m), &gentle(Order::Crossing), &Limits::up_to(10.0 * PSI), 25.0).unwrap();
        let figure = plan.figure.unwrap();
        // How far it bends is the same.
        assert!((figure.length / 10.6e-3 - 1.0).abs() < 0.02, "{figure:?}");
        figure.width
    };
    let own = width(Bending::Own, false);
    let [theirs, constant] = [Bending::Theirs, Bending::Constant].map(|bending| width(bending, false));
    // An EI that rises with the pressure, whatever the twist, holds the pressed FREEs back: without that rise the eight
    // is twice as wide, and the section's own, which rises or falls with the twist, is near that. Shear does not count.
    assert!(constant > 1.8 * theirs && own > 1.6 * theirs && own < constant, "{own} {theirs} {constant}");
    assert!((width(Bending::Own, true) / own - 1.0).abs() < 0.02);
}

#[test]
fn the_middle_pressure_is_the_sinusoids_or_the_papers() {
    let m = module(30.0);
    let rest = rest(&m);
    for middle in [6.0, 5.0] {
        let asked = Pattern { middle: middle * PSI, ..Pattern::paper() };
        let plan = pattern(&rest, &asked, &Limits::up_to(10.0 * PSI), 100.0).unwrap().plan;
        // On every second: A, then B, D, C highest, their opposite in the order lowest.
        for (second, highest) in [0, 1, 3, 2, 0].into_iter().enumerate() {
            let p = plan.pressures[100 * second].map(|p| p / PSI);
            assert!((p[highest] - 10.0).abs() < 1e-9, "{second} {p:?}");
            let mut sorted = p;
            sorted.sort_by(f64::total_cmp);
            assert!(sorted.iter().zip([2.0, middle, middle, 10.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{p:?}");
        }
        let all = plan.pressures.iter().flatten();
        assert!(all.clone().all(|p| (2.0 * PSI - 1e-6..=10.0 * PSI + 1e-6).contains(p)));
    }
    let off = Pattern { middle: 8.5 * PSI, ..Pattern::paper() };
    assert!(matches!(pattern(&rest, &off, &Limits::up_to(10.0 * PSI), 100.0), Err(PlanError::Invalid { .. })));
    let slow = Limits { slew: PSI, ..Limits::up_to(10.0 * PSI) };
    let refused = pattern(&rest, &Pattern::paper(), &slow, 100.0).unwrap_err();
    assert!(refused.to_string().contains("lengthen the period"), "{refused}");
}

#[test]
fn a_clipped_pattern_says_so() {
    let m = module(30.0);
    let rest = rest(&m);
    let mut limits = Limits::up_to(7.0 * PSI);
    limits.high[1] = 0.0;
    let plan = pattern(&rest, &Pattern::paper(), &limits, 50.0).unwrap().plan;
    assert!(plan.pressures.iter().all(|p| p[1] == 0.0 && p[0] <= 7.0 * PSI));
    assert!(plan.clipped.iter().all(|c| c[1] == Some(Bound::High)));
    assert!(plan.clipped[0][0] == Some(Bound::High) && plan.clipped[0][2].is_none());
}

#[test]
fn past_its_end_a_whisk_is_answered_with_the_end_and_the_largest_stable_one() {
    let m = module(60.0);
    let rest = rest(&m);
    let limits = Limits::up_to(10.0 * PSI);
    for (asked, scaled) in [
        (Pattern::paper(), Scaled::Swing),
        // Where all four at the mean buckle.
        (Pattern { lowest: 7.0 * PSI, middle: 8.5 * PSI, ..Pattern::paper() }, Scaled::Pressures),
    ] {
        let answer = pattern(&rest, &asked, &limits, 100.0).unwrap();
        let ended = answer.plan.facts.ramp.clone().or(answer.plan.facts.ended.clone().map(|(_, ended)| ended));
        assert!(!answer.plan.valid() && answer.figure.is_none());
        assert!(ended.unwrap().pressures.iter().all(|p| (0.0..=10.0 * PSI).contains(p)));
        let instead = answer.instead.unwrap();
        assert_eq!(instead.scaled, scaled);
        assert!(instead.plan.valid() && instead.plan.margins.iter().all(|m| m.smooth >= limits.margin));
        // The largest: two hundredths more are too much.
        let more = instead.scale * 1.02;
        let (mean, swing) = (0.5 * (asked.lowest + asked.highest), 0.5 * (asked.highest - asked.lowest));
        let (mean, swing) = if scaled == Scaled::Swing { (mean, more * swing) } else { (more * mean, more * swing) };
        let larger = Pattern { lowest: mean - swing, highest: mean + swing, middle: mean, ..asked };
        assert!(pattern(&rest, &larger, &limits, 100.0).unwrap().instead.is_some(), "{}", instead.scale);
    }
}

#[test]
fn an_eight_of_chosen_size_place_and_frequency_is_drawn() {
    for gamma in [30.0, 60.0] {
        let m = module(gamma);
        let rest = rest(&m);
        let z = if gamma == 30.0 { 0.126 } else { 0.131 };
        let asked = Eight::level(Vector3::new(1e-3, -2e-3, z), 0.010, 0.004, 0.25);
        let plan = eight(&rest, &asked, &Limits::up_to(7.0 * PSI), 100.0).unwrap();
        assert!(plan.instead.is_none() && plan.plan.facts.missed == 0 && plan.plan.facts.ramp.is_none());
        assert!((plan.period - 4.0).abs() < 1e-12 && plan.plan.times.len() == 401);
        let figure = plan.figure.unwrap();
        // Extents of 400 samples: the extremes lie within half a sample.
        assert!((figure.length - 0.010).abs() < 1e-5 && (figure.width - 0.004).abs() < 1e-5, "{figure:?}");
        assert!((figure.centre[0] - 1e-3).abs() < 1e-5 && (figure.centre[1] + 2e-3).abs() < 1e-5, "{figure:?}");
        assert!(figure.area.abs() < 1e-3 * figure.length * figure.width);
        // It can be repeated: the pressures come back, to the width of the differences, 200 Pa, by which the freedom
        // that a point leaves is spent on the margin: that has an edge where another place of the tubes becomes the
        // nearest.
        assert!(plan.closure.unwrap().1 < 200.0, "{:?}", plan.closure);
    }
}

#[test]
fn an_eight_too_large_is_offered_smaller() {
    let m = module(30.0);
    let rest = rest(&m);
    let asked = Eight::level(Vector3::new(0.0, 0.0, 0.126), 0.06, 0.03, 0.25);
    let plan = eight(&rest, &asked, &Limits::up_to(7.0 * PSI), 25.0).unwrap();
    assert!(plan.plan.facts.missed > 0 && plan.plan.facts.shortfall.is_some());
    let instead = plan.instead.unwrap();
    assert!(instead.scaled == Scaled::Size && instead.plan.facts.missed == 0);
    let figure = instead.figure.unwrap();
    assert!((figure.length / (0.06 * instead.scale) - 1.0).abs() < 0.02, "{figure:?} {}", instead.scale);
    assert!((0.3..0.9).contains(&instead.scale));
    assert!(matches!(
        eight(&rest, &Eight { frequency: 0.0, ..asked }, &Limits::up_to(7.0 * PSI), 25.0),
        Err(PlanError::Invalid { .. })
    ));
}

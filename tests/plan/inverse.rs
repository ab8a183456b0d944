//! Pressures for a target: the inverse of the forward model, within every limit, with the redundancy on the margin.

use crate::harness::{LENGTH, module};
use freerig::fem::module::{Loads, Module, ModuleError};
use freerig::fem::rod::Resolution;
use freerig::plan::{Limits, PlanError, Rest, Shortfall, Target, inverse};
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::{UnitQuaternion, Vector3, Vector6};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

/// What counts as reached, m.
const REACHED: f64 = 1e-5 * LENGTH;

fn rest(module: &Module) -> Rest<'_> {
    Rest::new(module, &Loads::pressures([0.0; 4])).unwrap()
}

/// Each up to 3 psi: all stable, far from contact.
fn random(seed: u64) -> impl FnMut() -> [f64; 4] {
    let mut random = Pcg64::seed_from_u64(seed);
    move || std::array::from_fn(|_| random.random_range(0.0..3.0) * PSI)
}

#[test]
fn the_jacobian_is_the_difference_quotient_of_the_error() {
    for gamma in [30.0, 60.0] {
        let m = module(gamma);
        let rest = rest(&m);
        let pressures = [2.5, 0.3, 1.0, 2.0].map(|p| p * PSI);
        let state = rest.ramp(rest.state(), &pressures).unwrap();
        // Half a radian off, so that the rotation vector's own derivative counts.
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.4));
        let mut target = Target::pose(state.position() + Vector3::repeat(1e-3), turn, 0.05);
        target.position_weight = Vector3::new(1.0, 0.5, 2.0);
        let jacobian = target.jacobian(&state).unwrap();
        for i in 0..4 {
            let at = |by: f64| {
                let mut p = pressures;
                p[i] += by;
                target.residual(&rest.onward(&state, &p).unwrap())
            };
            let step = 20.0;
            let quotient = (at(step) - at(-step)) / (2.0 * step);
            let column: Vector6<f64> = jacobian.column(i).into();
            // Third derivatives over a square kilopascal-scale: (20 / 1e4)^2; rounding 1e-12 / 20.
            assert!((quotient - column).norm() < 1e-5 * column.norm(), "{i}: {}", (quotient - column).norm());
        }
    }
}

#[test]
fn a_pose_of_known_pressures_gives_them_back() {
    let m = module(60.0);
    let rest = rest(&m);
    let (mut pressures, limits) = (random(1), Limits::up_to(7.0 * PSI));
    for _ in 0..8 {
        let (want, start) = (pressures(), pressures());
        let state = rest.ramp(rest.state(), &want).unwrap();
        let start = rest.ramp(rest.state(), &start).unwrap();
        let target = Target::pose(state.position(), state.rotation(), 0.02);
        let found = inverse::warm(&rest, &target, &limits, &start, f64::INFINITY).unwrap();
        assert_eq!(found.shortfall, None);
        // Four pressures, six components: one answer, as sharp as the least singular value makes it.
        let sharp = target.jacobian(&state).unwrap().singular_values().min();
        for (got, want) in found.pressures.iter().zip(want) {
            assert!((got - want).abs() < 2.0 * REACHED / sharp, "{got} {want} {sharp}");
        }
    }
}

#[test]
fn a_points_redundancy_goes_to_the_margin() {
    for gamma in [30.0, 60.0] {
        let m = module(gamma);
        let rest = rest(&m);
        let (mut pressures, limits) = (random(2), Limits::up_to(7.0 * PSI));
        for _ in 0..2 {
            let want = rest.ramp(rest.state(), &pressures()).unwrap();
            let target = Target::point(want.position());
            let found = inverse::cold(&rest, &target, &limits).unwrap();
            assert!(found.shortfall.is_none() && found.ramp.is_none() && found.residual <= REACHED);
            assert!(found.margin.smooth >= rest.margin(&want).smooth - 1e-6);
            // The other pressures with the same tip: fix A's and let the three others find it.
            let mut others = 0;
            for step in [-2000.0, -500.0, -100.0, 100.0, 500.0, 2000.0] {
                let a = found.pressures[0] + step;
                if a < 0.0 {
                    continue;
                }
                let mut held = limits;
                (held.low[0], held.high[0]) = (a, a);
                let other = inverse::warm(&rest, &target, &held, &found.state, f64::INFINITY).unwrap();
                if other.shortfall.is_none() {
                    others += 1;
                    // An error of the tip within what counts as reached is worth some parts in a million.
                    assert!(other.margin.smooth < found.margin.smooth + 1e-5, "{gamma} {step}: {:?}", other.margin);
                }
            }
            assert!(others >= 2, "{others}");
        }
    }
}

#[test]
fn no_limit_is_broken_whatever_is_asked_for() {
    let mut random = Pcg64::seed_from_u64(5);
    for gamma in [30.0, 60.0] {
        let m = module(gamma);
        let rest = rest(&m);
        let mut state = rest.state().clone();
        let mut reached = 0;
        for k in 0..60 {
            let mut limits = Limits::up_to(6.0 * PSI);
            limits.high[2] = random.random_range(0.0..6.0) * PSI;
            let way = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)) * 0.03;
            // Far ones, and near ones at any height.
            let mut target = Target::point(rest.state().position() + way);
            if k % 3 != 0 {
                target.position = rest.state().position() + way * 0.2;
                target.position_weight.z = 0.0;
            }
            let reach = random.random_range(500.0..2e4);
            let (before, had) = (state.loads().pressures.clone(), rest.margin(&state).smooth);
            let found = inverse::warm(&rest, &target, &limits, &state, reach).unwrap();
            reached += usize::from(found.shortfall.is_none());
            for ((p, last), high) in found.pressures.iter().zip(&before).zip(limits.high) {
                assert!((p - last).abs() <= reach * (1.0 + 1e-12), "slew {} {reach}", p - last);
                let most = high.max(last - reach * (1.0 - 1e-12));
                assert!((0.0..=most).contains(p), "bounds {p} {high}");
            }
            assert!(found.state.stable());
            // A start outside the bounds has to come in first, whatever that does to the margin.
            if before[2] <= limits.high[2] {
                assert!(found.margin.smooth >= limits.margin.min(had) - 1e-12, "{:?} {had}", found.margin);
            }
            assert_eq!(found.shortfall.is_none(), found.residual <= REACHED);
            state = found.state;
        }
        assert!((5..55).contains(&reached), "{reached}");
    }
}

#[test]
fn a_target_out_of_reach_is_projected() {
    let m = module(60.0);
    let rest = rest(&m);
    let limits = Limits::up_to(5.0 * PSI);
    for target in [[0.08, 0.0, 0.131], [0.01, -0.05, 0.13], [0.002, 0.001, 0.15], [0.0, 0.0, 0.05]] {
        let target = Target::point(Vector3::from(target));
        let found = inverse::cold(&rest, &target, &limits).unwrap();
        assert_eq!(found.shortfall, Some(Shortfall::Bounds), "{target:?}");
        assert!(found.residual > 1e-3 && found.active.iter().any(Option::is_some));
        // Nothing nearer around it: the squared error's half falls into no direction that the bounds allow.
        let slope = target.jacobian(&found.state).unwrap().tr_mul(&target.residual(&found.state));
        for i in 0..4 {
            let (p, by) = (found.pressures[i], slope[i] / found.residual);
            let into = if p <= limits.low[i] {
                (-by).max(0.0)
            } else if p >= limits.high[i] {
                by.max(0.0)
            } else {
                by.abs()
            };
            // Within a kilopascal nothing is gained that counts.
            assert!(into * 1e3 < REACHED, "{target:?} {i}: {into}");
        }
    }
}

#[test]
fn the_least_margin_holds_a_plate_back_and_is_said_to() {
    let m = module(60.0);
    let rest = rest(&m);
    let target = Target::point(Vector3::new(0.08, 0.0, 0.1));
    let free = inverse::cold(&rest, &target, &Limits { margin: 0.0, ..Limits::up_to(7.0 * PSI) }).unwrap();
    let margin = free.margin.smooth + 0.1;
    let held = inverse::cold(&rest, &target, &Limits { margin, ..Limits::up_to(7.0 * PSI) }).unwrap();
    assert_eq!(held.shortfall, Some(Shortfall::Margin));
    assert!(held.margin.smooth >= margin && held.margin.smooth < margin + 0.01, "{:?}", held.margin);
    assert!(held.margin.least() >= held.margin.smooth && held.residual > free.residual);
}

#[test]
fn a_dead_channel_stays_where_it_is_and_the_others_do_what_they_can() {
    let m = module(60.0);
    let rest = rest(&m);
    let mut limits = Limits::up_to(7.0 * PSI);
    limits.high[1] = 0.0;
    let want = rest.ramp(rest.state(), &[1.5, 0.0, 1.0, 2.0].map(|p| p * PSI)).unwrap();
    let found = inverse::cold(&rest, &Target::point(want.position()), &limits).unwrap();
    assert!(found.shortfall.is_none() && found.pressures[1] == 0.0, "{found:?}");
    // Three pressures for three coordinates: they are the ones it came from.
    for (got, want) in found.pressures.iter().zip([1.5, 0.0, 1.0, 2.0]) {
        assert!((got / PSI - want).abs() < 0.02, "{:?}", found.pressures);
    }
    // All dead: there is nothing to choose.
    limits.high = [0.0; 4];
    let stuck = inverse::cold(&rest, &Target::point(want.position()), &limits).unwrap();
    assert!(stuck.pressures == [0.0; 4] && stuck.shortfall == Some(Shortfall::Bounds));
}

#[test]
fn what_is_no_target_is_named() {
    let m = module(60.0);
    let rest = rest(&m);
    let limits = Limits::up_to(7.0 * PSI);
    let cold = |target: &Target| inverse::cold(&rest, target, &limits).unwrap_err();
    let through = cold(&Target::point(Vector3::new(0.0, 0.0, -0.02)));
    assert!(matches!(through, PlanError::BelowBase { .. }));
    assert!(through.to_string().contains("pass through the base"), "{through}");
    assert!(matches!(cold(&Target::point(Vector3::new(0.0, f64::NAN, 0.13))), PlanError::Invalid { .. }));
    let nothing = Target { position_weight: Vector3::zeros(), ..Target::point(Vector3::z()) };
    assert!(matches!(cold(&nothing), PlanError::Invalid { .. }));
    let negative = Limits { high: [-1.0; 4], ..limits };
    let target = Target::point(rest.state().position());
    assert!(matches!(inverse::cold(&rest, &target, &negative), Err(PlanError::Invalid { .. })));
    // Only the height of a target that counts has to be above the base.
    let mut sideways = Target::point(Vector3::new(1e-3, 0.0, -1.0));
    sideways.position_weight.z = 0.0;
    assert!(inverse::cold(&rest, &sideways, &limits).unwrap().shortfall.is_none());
}

#[test]
fn what_does_not_count_is_free_and_makes_margin() {
    let m = module(60.0);
    let rest = rest(&m);
    let limits = Limits::up_to(7.0 * PSI);
    let state = rest.ramp(rest.state(), &[3.0, 1.0, 0.5, 2.0].map(|p| p * PSI)).unwrap();
    let point = Target::point(state.position());
    let mut sideways = point;
    sideways.position_weight.z = 0.0;
    let [of_point, of_sideways] = [point, sideways].map(|t| inverse::cold(&rest, &t, &limits).unwrap());
    assert!(of_sideways.shortfall.is_none(), "{:?}", of_sideways.shortfall);
    let (free, held) = (of_sideways.margin, of_point.margin);
    // So near rest (0.917) there is little to be had; errors of what is reached are worth some parts in a million.
    assert!(free.smooth > held.smooth + 1e-4, "{free:?} {held:?} {:?}", of_sideways.pressures);
    // No other height has more.
    for by in [-5e-4, -1e-4, 1e-4, 5e-4] {
        let other = Target::point(of_sideways.state.position() + Vector3::z() * by);
        let other = inverse::cold(&rest, &other, &limits).unwrap();
        if other.shortfall.is_none() {
            assert!(other.margin.smooth < free.smooth + 1e-4, "{by} {:?} {free:?}", other.margin);
        }
    }
    let off = of_sideways.state.position() - state.position();
    assert!(off.xy().norm() <= REACHED && off.z.abs() > 1e-4, "{off}");
    // A turn alone, wherever the plate is.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.6));
    let mut twist = Target::pose(Vector3::zeros(), turn, 0.05);
    twist.position_weight = Vector3::zeros();
    let found = inverse::cold(&rest, &twist, &limits).unwrap();
    assert!(found.shortfall.is_none() && found.state.rotation().angle_to(&turn) < 2.0 * REACHED / 0.05);
}

#[test]
fn a_payload_is_part_of_the_rest_that_margins_are_measured_against() {
    let light = module(60.0);
    let plate = |mass: f64| Module::new(light.mounts().to_vec(), mass, Resolution::DEFAULT).unwrap();
    let gravity = |g: f64| Loads { gravity: Vector3::new(0.0, 0.0, g), ..Loads::pressures([0.0; 4]) };
    let hanging = plate(0.05);
    let rest = Rest::new(&hanging, &gravity(9.81)).unwrap();
    assert!((rest.margin(rest.state()).least() - 1.0).abs() < 1e-9);
    let want = rest.ramp(rest.state(), &[2.0, 1.0, 0.0, 1.5].map(|p| p * PSI)).unwrap();
    assert!(want.loads().gravity.z == 9.81);
    let found = inverse::cold(&rest, &Target::point(want.position()), &Limits::up_to(7.0 * PSI)).unwrap();
    assert!(found.shortfall.is_none() && found.state.loads().gravity.z == 9.81);
    // Standing under a weight far beyond Euler's there is no rest.
    let heavy = plate(2.0);
    let refused = Rest::new(&heavy, &gravity(-9.81)).unwrap_err();
    assert!(matches!(refused, PlanError::Rest(_) | PlanError::Module(ModuleError::Ends { .. })), "{refused}");
    let single = Module::new(light.mounts()[..1].to_vec(), 0.0, Resolution::DEFAULT).unwrap();
    assert_eq!(Rest::new(&single, &gravity(0.0)).unwrap_err(), PlanError::Rods(1));
}

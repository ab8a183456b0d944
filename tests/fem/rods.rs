//! Rods and plates against tasks with converged answers and classical critical loads.
//!
//! The tasks' units are N, mm, rad; section of outer diameter 11.12 mm and inner 9.52 mm, 130 mm long. Their answers
//! were found by two independent codes; the tolerance beside each is what it is known to.

use std::f64::consts::PI;

use freerig::fem::module::{Kind, Loads, Module, ModuleError, Mount, Path};
use freerig::fem::rod::{Law, Profile, Resolution, Rod, Straight};
use nalgebra::{Rotation3, Vector2, Vector3, Vector6};
use rand::{Rng, SeedableRng};

const MM: f64 = 1e-3;
const LENGTH: f64 = 130.0 * MM;
const EA: f64 = 30.606;
const EI: f64 = 409.895e-6;
const GJ: f64 = 273.264e-6;
const GA: f64 = 5.4070;
const FINE: Resolution = Resolution { degree: 7, steps: 16 };

/// An elastic law whose spontaneous strains are those at "pressure" 1.
fn elastic([ea, ei, gj, ga]: [f64; 4], extension: f64, twist: f64) -> Law {
    Law {
        straight: Straight::spontaneous(ea, gj, extension, twist),
        bending: Profile::constant(ei),
        shear: Profile::constant(ga),
        coupling: Profile::constant(0.0),
        mirrored: false,
    }
}

fn law(extension: f64, twist_per_mm: f64) -> Law {
    elastic([EA, EI, GJ, GA], extension, twist_per_mm / MM)
}

/// The same, but it neither stretches nor shears to speak of: Euler's and Greenhill's rod.
fn stiff(extension: f64, twist: f64) -> Law {
    elastic([1e4 * EA, EI, GJ, 1e4 * GA], extension, twist)
}

fn mount(x: f64, y: f64, law: Law) -> Mount {
    Mount { base: Vector3::new(x, y, 0.0) * MM, rod: Rod::straight(LENGTH, law) }
}

fn single(law: Law, resolution: Resolution) -> Module {
    Module::new(vec![mount(0.0, 0.0, law)], 0.0, resolution).unwrap()
}

fn four(resolution: Resolution) -> Module {
    let mounts = vec![
        mount(-10.0, 10.0, law(0.06, 0.008)),
        mount(-10.0, -10.0, law(0.03, -0.004)),
        mount(10.0, -10.0, law(0.0, 0.0)),
        mount(10.0, 10.0, law(0.015, -0.002)),
    ];
    Module::new(mounts, 0.0, resolution).unwrap()
}

fn dead(force: Vector3<f64>, rods: usize) -> Loads {
    Loads { force, ..Loads::pressures(vec![0.0; rods]) }
}

fn r1() -> Loads {
    Loads { moment: Vector3::new(-0.6, 2.2, 0.4) * MM, ..dead(Vector3::new(0.015, 0.008, -0.010), 1) }
}

fn r2(fz: f64) -> Loads {
    Loads { force: Vector3::new(0.0, 0.0, fz), ..Loads::pressures([1.0; 4]) }
}

fn off(got: Vector3<f64>, want_mm: [f64; 3]) -> f64 {
    (got - Vector3::from(want_mm) * MM).norm() / LENGTH
}

#[test]
fn r1_a_bent_and_twisted_cantilever() {
    let want = [65.88336991, 28.14646053, 100.65456905];
    let usual = single(law(0.0, 0.0), Resolution::DEFAULT);
    let state = usual.equilibrium(&r1()).unwrap();
    assert!(off(state.position(), want) < 1e-4, "{}", off(state.position(), want));
    assert!(state.stable());
    // Estimated by one finer solution: of the error's size.
    let estimate = usual.discretisation_error(&state).unwrap();
    assert!((0.5..2.0).contains(&(estimate / off(state.position(), want))), "{estimate}");
    let fine = single(law(0.0, 0.0), FINE).equilibrium(&r1()).unwrap();
    // 62.822 deg is how far the tip's axis turns.
    let bend = fine.rotation().transform_vector(&Vector3::z()).z.acos().to_degrees();
    assert!(off(fine.position(), want) < 1e-6 && (bend - 62.822).abs() < 1e-3, "{bend}");
}

#[test]
fn r2_four_rods_with_spontaneous_strains_under_a_plate() {
    let want = [19.68336597, -11.19964926, 130.75976188];
    let usual = four(Resolution::DEFAULT);
    let state = usual.equilibrium(&r2(-0.2)).unwrap();
    assert!(off(state.position(), want) < 1e-4, "{}", off(state.position(), want));
    assert!(usual.discretisation_error(&state).unwrap() < 1e-4);
    let fine = four(FINE).equilibrium(&r2(-0.2)).unwrap();
    assert!(off(fine.position(), want) < 1e-6, "{}", off(fine.position(), want));
    let q = fine.rotation();
    let wanted = [0.07178131, 0.11815386, 0.02459726, 0.99009196];
    assert!(q.coords.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{q}");
    assert!(fine.stable());
    // What the rods do to the plate holds the load.
    let module = four(FINE);
    let sum: Vector3<f64> = (0..4).map(|i| fine.on_plate(&module, i).unwrap().force).sum();
    assert!((sum - Vector3::new(0.0, 0.0, 0.2)).norm() < 1e-9);
}

#[test]
fn r3_past_the_limit_point_and_down_the_collapsed_branch() {
    let module = four(FINE);
    let regular = module.equilibrium(&r2(-0.3)).unwrap();
    assert!(off(regular.position(), [24.84, -14.27, 129.29]) < 1e-4);
    // Load control ends at the limit point and says so.
    let Err(ModuleError::Ends { fraction, cause: None }) = module.equilibrium_from(&regular, &r2(-0.5)) else {
        panic!("no equilibrium beyond the limit point");
    };
    assert!((0.3 + 0.2 * fraction - 0.41063).abs() < 1e-3, "{fraction}");
    let start = module.equilibrium(&r2(0.0)).unwrap();
    let mut path = Path::new(&module, &start, &r2(-1.0), 0.2).unwrap();
    let first = path.next_critical((-0.1, 4.0)).unwrap().unwrap();
    assert_eq!((first.kind, first.gained, first.modes.len()), (Kind::Limit, 1, 1));
    assert!((first.mu / 0.41063 - 1.0).abs() < 1e-3, "{}", first.mu);
    // The load is flat there: 1e-3 of it is millimetres of the plate.
    assert!(off(first.point.state.position(), [46.09, -28.21, 118.87]) < 1e-3);
    let second = path.next_critical((-0.1, 4.0)).unwrap().unwrap();
    assert_eq!((second.kind, second.gained), (Kind::Limit, -1));
    assert!((second.mu / 0.36130 - 1.0).abs() < 1e-3, "{}", second.mu);
    assert!(off(second.point.state.position(), [87.29, -37.84, 73.52]) < 1e-3);
    // The collapsed branch is stable and regular: load control does.
    assert!(path.next_critical((-0.1, 3.0)).unwrap().is_none());
    let beyond = &path.point().state;
    let collapsed = module.equilibrium_from(beyond, &r2(-0.5135)).unwrap();
    assert!(off(collapsed.position(), [96.88, -32.90, -3.38]) < 1e-3, "{}", collapsed.position());
    let inverted = module.equilibrium_from(beyond, &r2(-3.0)).unwrap();
    assert!(off(inverted.position(), [42.6, -18.2, -91.0]) < 1e-3, "{}", inverted.position());
    assert!(collapsed.stable() && inverted.stable());
}

#[test]
fn five_hundred_modules_like_r2_are_all_solved() {
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(2);
    let mut errors = vec![];
    for case in 0..500 {
        let mounts = [(-10.0, 10.0), (-10.0, -10.0), (10.0, -10.0), (10.0, 10.0)]
            .map(|(x, y)| mount(x, y, law(random.random_range(0.0..0.06), random.random_range(-8e-3..8e-3))));
        let module = Module::new(mounts.to_vec(), 0.0, Resolution::DEFAULT).unwrap();
        let mut vector = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
        let (force, moment) = (vector(0.1), vector(1.0 * MM));
        let force = Vector3::new(force.x, force.y, -0.1 + force.z);
        let state = module.equilibrium(&Loads { force, moment, ..Loads::pressures([1.0; 4]) });
        let state = state.unwrap_or_else(|e| panic!("{case}: {e}"));
        assert!(state.stable(), "{case}");
        let error = module.discretisation_error(&state).unwrap();
        errors.push(error);
    }
    // Some stand close to their limit points, where the plate moves a lot for little.
    errors.sort_by(f64::total_cmp);
    assert!(errors[250] < 1e-3 && errors[499] < 0.1, "{} {}", errors[250], errors[499]);
}

#[test]
fn the_error_falls_with_the_fourth_power_of_the_step() {
    let at = |steps| {
        let module = single(law(0.0, 0.0), Resolution { degree: 5, steps });
        module.equilibrium(&r1()).unwrap().position()
    };
    let exact = at(64);
    let errors = [4, 8, 16].map(|steps| (at(steps) - exact).norm());
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((3.7..4.7).contains(&order), "{errors:?}");
    }
}

#[test]
fn a_moment_rolls_a_rod_up_into_a_circle() {
    let loads = Loads { moment: Vector3::new(0.0, 2.0 * PI * EI / LENGTH, 0.0), ..Loads::pressures([0.0]) };
    let state = single(law(0.0, 0.0), Resolution { degree: 1, steps: 4 }).equilibrium(&loads).unwrap();
    // Constant curvature is represented exactly.
    assert!(state.position().norm() < 1e-10 * LENGTH, "{}", state.position());
}

#[test]
fn the_45_degree_bend_reaches_its_converged_tips() {
    // Radius 100, unit square section, E = 1e7, nu = 0, in any units; J = Iy + Iz and full shear area.
    let law = elastic([1e7, 1e7 / 12.0, 5e6 / 6.0, 5e6], 0.0, 0.0);
    let mut rod = Rod::straight(100.0 * PI / 4.0, law);
    // It bends from z towards x.
    rod.rest_curvature = Vector2::new(0.0, 0.01);
    let module = Module::new(vec![Mount { base: Vector3::zeros(), rod }], 0.0, FINE).unwrap();
    let tip = module.equilibrium(&Loads::pressures([0.0])).unwrap().position();
    let chord = 100.0 * (PI / 4.0).sin();
    assert!((tip - Vector3::new(100.0 - chord, 0.0, chord)).norm() < 1e-9, "{tip}");
    for (load, want) in [
        (300.0, [22.24478, 58.77912, 40.19189]),
        (450.0, [18.50818, 52.23856, 48.50293]),
        (600.0, [15.68480, 47.15044, 53.47486]),
    ] {
        let got = module.equilibrium(&dead(Vector3::new(0.0, load, 0.0), 1)).unwrap().position();
        // The task lists them as (across, along at first, out of the plane).
        let got = Vector3::new(got.x, got.z, got.y);
        assert!((got - Vector3::from(want)).norm() < 1e-4 * 78.5, "{load}: {got}");
    }
}

/// The least x in `range` at which `unstable` says so, to 1e-6 of the range.
fn threshold(range: (f64, f64), mut unstable: impl FnMut(f64) -> bool) -> f64 {
    let (mut low, mut high) = range;
    assert!(!unstable(low) && unstable(high));
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if unstable(middle) { high = middle } else { low = middle }
    }
    0.5 * (low + high)
}

#[test]
fn struts_and_shafts_buckle_where_euler_and_greenhill_say() {
    let unit = EI / LENGTH.powi(2);
    let cantilever = single(stiff(0.0, 0.0), Resolution::DEFAULT);
    let down = |force: f64| dead(Vector3::new(0.0, 0.0, -force), 1);
    let critical = threshold((0.0, 5.0 * unit), |f| !cantilever.equilibrium(&down(f)).unwrap().stable());
    assert!((critical / (PI * PI / 4.0 * unit) - 1.0).abs() < 1e-3, "{critical}");
    // Both ends held, spontaneous extension pressing the rod, or spontaneous twist winding it.
    let count = |module: &Module, p: f64| module.blocked(&[p]).unwrap().negative_pivots();
    let strut = single(stiff(1e-4, 0.0), FINE);
    let force = |p: f64| 1e4 * EA * 1e-4 * p;
    let critical = force(threshold((0.0, 60.0 * unit / force(1.0)), |p| count(&strut, p) > 0));
    assert!((critical / (4.0 * PI * PI * unit) - 1.0).abs() < 0.01, "{critical}");
    // Two planes: both modes at once, which a determinant's sign does not see.
    assert_eq!(count(&strut, 1.02 * critical / force(1.0)), 2);
    let shaft = single(stiff(0.0, 1.0), FINE);
    let torque = |p: f64| GJ * p;
    let critical = torque(threshold((0.0, 12.0 * EI / LENGTH / GJ), |p| count(&shaft, p) > 0));
    assert!((critical / (8.9868 * EI / LENGTH) - 1.0).abs() < 0.01, "{critical}");
}

/// Complete elliptic integral K(k), by the arithmetic-geometric mean.
fn elliptic(k: f64) -> f64 {
    let (mut a, mut b) = (1.0f64, (1.0 - k * k).sqrt());
    for _ in 0..20 {
        (a, b) = (0.5 * (a + b), (a * b).sqrt());
    }
    0.5 * PI / a
}

#[test]
fn a_strut_buckles_both_ways_and_its_branch_is_eulers_elastica() {
    let module = single(stiff(0.0, 0.0), FINE);
    let rest = module.equilibrium(&dead(Vector3::zeros(), 1)).unwrap();
    let euler = PI * PI / 4.0 * EI / LENGTH.powi(2);
    let loads = dead(Vector3::new(0.0, 0.0, -2.0 * euler), 1);
    let mut path = Path::new(&module, &rest, &loads, 0.1).unwrap();
    let critical = path.next_critical((-1.0, 1.0)).unwrap().unwrap();
    // Two planes at once: a determinant's sign sees nothing.
    assert_eq!((critical.kind, critical.gained, critical.modes.len()), (Kind::Bifurcation, 2, 2));
    assert!((2.0 * critical.mu - 1.0).abs() < 1e-4, "{}", critical.mu);
    for side in [1.0, -1.0] {
        let path = Path::new(&module, &rest, &loads, 0.1).unwrap();
        let mut path = path.branch(&critical, 0, 0.1 * side).unwrap();
        for _ in 0..10 {
            let point = path.advance().unwrap();
            let axis = point.state.rotation().transform_vector(&Vector3::z());
            let half = 0.5 * axis.z.acos();
            let load = (2.0 / PI * elliptic(half.sin())).powi(2);
            assert!((2.0 * point.mu / load - 1.0).abs() < 1e-3, "{} {load}", 2.0 * point.mu);
            // It can turn about z for nothing: one pivot is rounding, of either sign.
            assert!(point.state.negative_pivots() <= 1);
        }
        assert!(path.point().mu > 0.55, "{}", path.point().mu);
    }
}

#[test]
fn turning_everything_turns_the_answer() {
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7);
    let loads = Loads { moment: Vector3::new(0.3, -0.2, 0.1) * MM, ..r2(-0.15) };
    let module = four(Resolution::DEFAULT);
    let turned = module.mounts().iter().map(|m| Mount { base: turn * m.base, ..m.clone() }).collect();
    let turned = Module::new(turned, 0.0, Resolution::DEFAULT).unwrap();
    let with = Loads { force: turn * loads.force, moment: turn * loads.moment, ..loads.clone() };
    let (a, b) = (module.equilibrium(&loads).unwrap(), turned.equilibrium(&with).unwrap());
    assert!((turn * a.position() - b.position()).norm() < 1e-11 * LENGTH);
    assert!((a.energy() - b.energy()).abs() < 1e-12 * a.energy().abs());
}

#[test]
fn energy_sensitivities_and_compliance_are_those_of_differences() {
    let module = four(Resolution::DEFAULT);
    let loads = r2(-0.2);
    let state = module.equilibrium(&loads).unwrap();
    let solve = |loads: &Loads| module.equilibrium_from(&state, loads).unwrap();
    // Envelope theorem: the energy's slope by the dead force is minus the plate's travel. The energy is 1e-2 J known
    // to rounding, the step 1e-4 N.
    let e = 1e-4;
    let shifted = |i: usize, s: f64| {
        let mut l = loads.clone();
        l.force[i] += s;
        solve(&l)
    };
    let travel = state.position() - module.rest();
    for i in 0..3 {
        let slope = (shifted(i, e).energy() - shifted(i, -e).energy()) / (2.0 * e);
        // Central differences are off by e^2 / 6 of the third derivative.
        assert!((slope + travel[i]).abs() < 1e-5 * LENGTH, "{slope} {}", travel[i]);
    }
    // The stiffness under a dead force is symmetric to rounding.
    let k = state.stiffness();
    assert!((k - k.transpose()).amax() < 1e-9 * k.amax());
    let between = |a: &freerig::fem::module::State, b: &freerig::fem::module::State| {
        let rotation = (b.rotation() * a.rotation().inverse()).scaled_axis();
        let shift = b.position() - a.position();
        Vector6::new(rotation.x, rotation.y, rotation.z, shift.x, shift.y, shift.z)
    };
    let compliance = state.compliance().unwrap();
    for i in 0..3 {
        let slope = between(&shifted(i, -e), &shifted(i, e)) / (2.0 * e);
        assert!((slope - compliance.column(3 + i)).norm() < 1e-4 * slope.norm(), "{slope} {compliance}");
        let moment = |s: f64| {
            let mut l = loads.clone();
            l.moment[i] = s;
            solve(&l)
        };
        let slope = between(&moment(-1e-5), &moment(1e-5)) / 2e-5;
        assert!((slope - compliance.column(i)).norm() < 1e-4 * slope.norm(), "{slope} {compliance}");
    }
    let by_pressure = state.by_pressure().unwrap();
    for (i, exact) in by_pressure.iter().enumerate() {
        let pressed = |s: f64| {
            let mut l = loads.clone();
            l.pressures[i] += s;
            solve(&l)
        };
        let slope = between(&pressed(-1e-3), &pressed(1e-3)) / 2e-3;
        assert!((slope - exact).norm() < 1e-4 * exact.norm() + 1e-9, "{slope} {exact}");
    }
}

#[test]
fn what_is_no_module_is_refused_by_name() {
    let refused = |mounts: Vec<Mount>, mass, resolution| Module::new(mounts, mass, resolution).unwrap_err();
    let one = || vec![mount(0.0, 0.0, law(0.0, 0.0))];
    assert!(matches!(refused(vec![], 0.0, FINE), ModuleError::Invalid { .. }));
    assert!(matches!(refused(one(), -1.0, FINE), ModuleError::Invalid { .. }));
    assert!(matches!(refused(one(), 0.0, Resolution { degree: 4, steps: 2 }), ModuleError::Invalid { .. }));
    let mut short = one();
    short[0].rod.length = 0.0;
    assert!(matches!(refused(short, 0.0, FINE), ModuleError::Invalid { .. }));
    let module = Module::new(one(), 0.0, FINE).unwrap();
    let wrong = module.equilibrium(&Loads::pressures([0.0, 0.0])).unwrap_err();
    assert_eq!(wrong, ModuleError::Pressures { pressures: 2, rods: 1 });
    let wrong = module.equilibrium(&dead(Vector3::new(f64::NAN, 0.0, 0.0), 1)).unwrap_err();
    assert!(matches!(wrong, ModuleError::Invalid { .. }));
    // Squeezed to nothing: the branch ends with a reason, not with numbers.
    let squeezed = module.equilibrium(&dead(Vector3::new(0.0, 0.0, -2.0 * EA), 1)).unwrap_err();
    assert!(matches!(squeezed, ModuleError::Ends { .. }), "{squeezed}");
}

//! The reference module with the law of the section: against reference/module.csv, and where its branches end.

use std::f64::consts::PI;
use std::sync::OnceLock;

use freerig::fem::ends::{End, Ends};
use freerig::fem::module::{
    Answer, Kind, Loads, Module, ModuleError, ModuleScene, Path, Reason, SceneError, State, answer,
};
use freerig::fem::rod::{Law, LawError, Profile, Resolution, RodError};
use freerig::fem::section::{Mesh, Section};
use freerig::fem::section_law::SectionLaw;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

const LENGTH: f64 = 0.13;
const FINE: Resolution = Resolution { degree: 6, steps: 8 };

/// The law up to 10 psi of the reference tube at 30 or 60 deg, tabulated once.
fn law(degrees: f64) -> &'static SectionLaw {
    static LAWS: [OnceLock<SectionLaw>; 2] = [OnceLock::new(), OnceLock::new()];
    let request = scene(degrees).request(0, Mesh::level(1), 10.0 * PSI);
    LAWS[usize::from(degrees == 60.0)].get_or_init(|| SectionLaw::build(&request).unwrap())
}

fn scene(degrees: f64) -> ModuleScene {
    ModuleScene::reference(degrees.to_radians())
}

/// The module of a scene of reference tubes.
fn build(scene: &ModuleScene, resolution: Resolution) -> Module {
    let laws = scene.frees.map(|free| law(free.tube.gamma.abs().to_degrees().round()).law(free.tube.gamma));
    scene.with_laws(laws, resolution).unwrap()
}

/// The same without radii: tubes that pass through each other.
fn through(module: &Module) -> Module {
    let mut mounts = module.mounts().to_vec();
    mounts.iter_mut().for_each(|mount| mount.rod.outer_radius = 0.0);
    Module::new(mounts, 0.0, Resolution { degree: 7, steps: 12 }).unwrap()
}

/// Gauge pressures of an actuation case, Pa.
fn case(number: usize, psi: f64) -> [f64; 4] {
    let on: &[usize] = [&[0, 1, 2, 3][..], &[0, 2], &[0], &[0, 1], &[0, 1, 2]][number - 1];
    std::array::from_fn(|i| if on.contains(&i) { psi * PSI } else { 0.0 })
}

fn rest(module: &Module) -> State {
    module.equilibrium(&Loads::pressures([0.0; 4])).unwrap()
}

/// A row of module.csv: (degrees, pressures, position m, rotation).
type Row = (f64, [f64; 4], Vector3<f64>, UnitQuaternion<f64>);

fn rows() -> Vec<Row> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/reference/module.csv");
    let row = |line: &str| {
        let v: Vec<f64> = line.split(',').take(10).map(|x| x.parse().unwrap()).collect();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[7], v[8], v[9]));
        (v[0], case(v[1] as usize, v[2]), Vector3::new(v[3], v[4], v[5]) * 1e-3, rotation)
    };
    let rows: Vec<Row> = std::fs::read_to_string(path).unwrap().lines().skip(1).map(row).collect();
    assert_eq!(rows.len(), 8, "module.csv");
    rows
}

/// The reference's law of bending: EI at 0, 3.5, 7 psi in N mm2, no shear.
fn reference_law(degrees: f64, law: Law) -> Law {
    let ei = if degrees == 30.0 { [673.0, 909.0, 1854.0] } else { [416.0, 476.0, 551.0] };
    let bending = Profile::through([(0.0, ei[0] * 1e-6), (3.5 * PSI, ei[1] * 1e-6), (7.0 * PSI, ei[2] * 1e-6)]);
    Law { bending, shear: Profile::constant(1e4), coupling: Profile::constant(0.0), ..law }
}

#[test]
fn with_the_references_bending_stiffness_it_is_the_reference() {
    for (degrees, pressures, position, rotation) in rows() {
        let scene = scene(degrees);
        let laws = scene.frees.map(|free| reference_law(degrees, law(degrees).law(free.tube.gamma)));
        let module = scene.with_laws(laws, FINE).unwrap();
        let state = module.equilibrium(&Loads::pressures(pressures)).unwrap();
        // The reference's own accuracy, and 0.1 % of the motion for this section's mesh (level 1 leaves 0.03 % of free
        // motion and 0.4 % of blocked loads, of which a module has both).
        let accuracy = if degrees == 30.0 { 0.002e-3 } else { 0.01e-3 };
        let travel = (position - module.rest()).norm();
        let off = (state.position() - position).norm();
        assert!(off < accuracy + 1e-3 * travel, "{degrees} deg {pressures:?}: {off} of {travel}");
        let turned = state.rotation().angle_to(&rotation);
        assert!(turned < accuracy / 0.02 + 1e-3 * rotation.angle(), "{degrees} deg {pressures:?}: {turned}");
        assert!(state.stable());
    }
}

#[test]
fn with_the_sections_own_bending_and_shear_it_is_near_the_reference() {
    for (degrees, pressures, position, rotation) in rows() {
        let module = build(&scene(degrees), Resolution::DEFAULT);
        let state = module.equilibrium(&Loads::pressures(pressures)).unwrap();
        // What is asked of another model of the same module: 4 % of the travel, and 0.4 mm.
        let travel = (position - module.rest()).norm();
        let off = (state.position() - position).norm();
        assert!(off < f64::min(0.04 * travel, 0.4e-3), "{degrees} deg {pressures:?}: {off} of {travel}");
        assert!(state.rotation().angle_to(&rotation) < 0.04 * rotation.angle() + 1e-9, "{degrees} deg {pressures:?}");
        // The discretisation is the smaller error by far.
        assert!(module.discretisation_error(&state).unwrap() * LENGTH < 0.02e-3 + 0.01 * off);
    }
}

#[test]
fn case_1_at_60_degrees_buckles_in_two_modes_where_the_held_sections_torque_says() {
    let module = through(&build(&scene(60.0), Resolution::DEFAULT));
    let to = Loads::pressures([10.0 * PSI; 4]);
    let critical = Path::new(&module, &rest(&module), &to, 0.05).unwrap().next_critical((-0.01, 0.9)).unwrap().unwrap();
    assert_eq!((critical.kind, critical.gained, critical.modes.len()), (Kind::Bifurcation, 2, 2));
    let found = 10.0 * critical.mu;
    // From the section alone: where the torque of the tube held from turning reaches 2 pi EI / L, with EI of that
    // state. It is a seventh lower than that of the free state, with which the same equation says 7.9 psi.
    let section = Section::new(&scene(60.0).frees[0].tube, Mesh::level(1)).unwrap();
    let mut state = section.rest().unwrap();
    let mut share = |psi: f64| {
        let held = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };
        let torque = section.advance(&mut state, psi * PSI, held).unwrap().moment.abs();
        torque * LENGTH / (2.0 * PI * section.bending(&state).unwrap().pure_bending())
    };
    let (mut low, mut high) = (5.0, 8.0);
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if share(middle) < 1.0 { low = middle } else { high = middle }
    }
    // Shear adds a little: a per cent of a pressure at which the torque grows as fast as the pressure itself. The law's
    // own EI is within 1.5 % of the section's.
    assert!((found / low - 1.0).abs() < 0.025, "{found} {low}");
    // An imperfect module, here one that is pushed sideways with 0.1 mN, moves without such a point, as the perfect
    // one's compliance says, which grows without bound: its inverse falls to nothing at the same pressure.
    let compliance = |psi: f64| {
        let perfect = module.equilibrium(&Loads::pressures([psi * PSI; 4])).unwrap();
        let mut pushed = perfect.loads().clone();
        pushed.force.x = 1e-4;
        let state = module.equilibrium(&pushed).unwrap();
        assert!(perfect.stable() && state.stable());
        let (sideways, compliance) =
            (state.position().xy().norm(), perfect.compliance().unwrap().column(3).rows(3, 2).norm());
        assert!((sideways / (compliance * 1e-4) - 1.0).abs() < 0.02, "{psi}: {sideways} {compliance}");
        compliance
    };
    let [far, early, late] = [4.0, found - 0.2, found - 0.1].map(compliance);
    // Twice as near, twice as soft, but for what does not soften: the columns' axial stiffness, against which the plate
    // tilts.
    assert!(late > 10.0 * far && (late / early / 2.0 - 1.0).abs() < 0.1, "{far} {early} {late}");
}

#[test]
fn up_to_7_psi_only_case_1_buckles_and_only_at_60_degrees() {
    for degrees in [30.0, 60.0] {
        let module = build(&scene(degrees), Resolution { degree: 7, steps: 12 });
        for number in 1..=5 {
            let to = Loads::pressures(case(number, 7.0));
            let mut path = Path::new(&module, &rest(&module), &to, 0.05).unwrap();
            while path.point().mu < 1.0 {
                match path.advance() {
                    Ok(point) if !point.state.stable() => {
                        assert!(degrees == 60.0 && number == 1 && 7.0 * point.mu > 6.4, "{degrees} deg case {number}");
                        break;
                    }
                    Ok(_) => {}
                    // Turned by a quarter and more, or bowed by the others, neighbours touch.
                    Err(ModuleError::Ends { fraction, cause: Some(cause) }) => {
                        assert!(matches!(*cause, ModuleError::Contact { .. }), "{cause}");
                        let first = [(30.0, 2, 6.5), (60.0, 2, 5.0), (60.0, 3, 6.2), (60.0, 5, 5.9)];
                        let named = first.into_iter().find(|of| (of.0, of.1) == (degrees, number));
                        let (_, _, first) = named.expect("Case 2, or Cases 3 and 5 at 60 deg");
                        assert!(7.0 * fraction > first, "{degrees} deg case {number} at {fraction}");
                        break;
                    }
                    Err(error) => panic!("{degrees} deg case {number}: {error}"),
                }
            }
        }
    }
}

#[test]
fn case_2_at_60_degrees_ends_where_neighbours_touch() {
    let scene = scene(60.0);
    let module = build(&scene, Resolution::DEFAULT);
    let to = Loads::pressures(case(2, 8.0));
    let mut path = Path::new(&module, &rest(&module), &to, 0.05).unwrap();
    let Err(ModuleError::Ends { fraction, cause: Some(cause) }) = path.next_critical((-0.01, 1.0)) else {
        panic!("tubes touch before 8 psi");
    };
    let ModuleError::Contact { rods: [a, b], clearance } = *cause else { panic!("{cause}") };
    assert!((b - a) % 2 == 1 && clearance < 0.0);
    // "About 105 deg of the plate, a little above 5 psi".
    let turn = path.point().state.rotation().angle().to_degrees();
    assert!((turn - 105.0).abs() < 3.0 && (5.0..5.4).contains(&(8.0 * fraction)), "{turn} deg at {}", 8.0 * fraction);
    // The same of the answer to one row.
    let [told] = &answer(&scene, &module, &[case(2, 8.0)])[..] else { panic!() };
    let limit = told.limit.as_ref().unwrap();
    assert!(matches!(limit.reason, Reason::Module(ModuleError::Contact { .. })) && told.pose.is_none());
    assert!((limit.fraction - fraction).abs() < 2e-3, "{} {fraction}", limit.fraction);
    assert!(limit.to_string().contains("touch"), "{limit}");
}

#[test]
fn answers_say_pose_resultants_stability_clearance_errors_and_limits() {
    let mut scene = scene(60.0);
    scene.plate_mass = 0.005;
    scene.gravity = Vector3::new(0.0, 0.0, 9.81);
    let module = build(&scene, Resolution::DEFAULT);
    let rows = [case(4, 3.0), case(1, 8.5), case(1, 12.0), case(3, 6.0)];
    let [bent, buckled, beyond, soft] = &answer(&scene, &module, &rows)[..] else { panic!() };
    let Answer { pose: Some(pose), limit: None, .. } = bent else { panic!("{bent:?}") };
    let sum: Vector3<f64> = pose.on_plate.iter().map(|w| w.force).sum();
    assert!((sum + Vector3::z() * 0.005 * 9.81).norm() < 1e-6, "{sum}");
    assert!(pose.negative_pivots == 0 && pose.least_clearance.unwrap().1 > 8e-3);
    assert!(pose.discretisation_error > 0.0 && pose.discretisation_error < 1e-4 * LENGTH);
    // What is told of the error is the error, and more, where the module is soft and the resolution counts.
    let exact = module.with_resolution(Resolution { degree: 9, steps: 20 }).unwrap();
    let exact = exact.equilibrium(&scene.loads(case(3, 6.0))).unwrap().position();
    let soft = soft.pose.as_ref().unwrap();
    let off = (soft.position - exact).norm();
    assert!(off < soft.discretisation_error && soft.discretisation_error < 0.01 * LENGTH, "{off} {soft:?}");
    assert!(off < 1e-3 * LENGTH, "{off}");
    // Past the buckling load the straight branch is told, with the share at which it lost its stability.
    let limit = buckled.limit.as_ref().unwrap();
    assert_eq!(
        (buckled.pose.as_ref().unwrap().negative_pivots, &limit.reason),
        (2, &Reason::Critical(Kind::Bifurcation))
    );
    assert!((6.3..6.7).contains(&(8.5 * limit.fraction)), "{limit}");
    // 12 psi is outside of the law, but it buckles before.
    let limit = beyond.limit.as_ref().unwrap();
    assert!(beyond.pose.is_none() && limit.reason == Reason::Critical(Kind::Bifurcation), "{limit}");
}

#[test]
fn hard_nothing_and_all_equal() {
    for degrees in [30.0, 60.0] {
        let module = build(&scene(degrees), Resolution::DEFAULT);
        let state = rest(&module);
        assert!((state.position() - module.rest()).norm() < 1e-9 * LENGTH && state.rotation().angle() < 1e-9);
        assert!(state.stable() && state.by_pressure().is_some());
        let equal = module.equilibrium(&Loads::pressures([5.0 * PSI; 4])).unwrap();
        assert!(equal.position().xy().norm() < 1e-9 * LENGTH && equal.rotation().angle() < 1e-9 && equal.stable());
        // The tubes held from turning by each other: the section says how long they are.
        let section = Section::new(&scene(degrees).frees[0].tube, Mesh::level(1)).unwrap();
        let held = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };
        let stretch = section.solve(5.0 * PSI, held).unwrap().stretch;
        // The table's error, relative to what the stretch is.
        assert!((equal.position().z / LENGTH - stretch).abs() < 5e-5, "{degrees} deg");
    }
}

#[test]
fn hard_one_channel_dead_and_one_free_of_the_wrong_hand() {
    // The channel of D is dead: the plate turns as the two R FREEs do, and bends away from three that lengthen.
    let module = build(&scene(60.0), Resolution::DEFAULT);
    let dead = module.equilibrium(&Loads::pressures(case(5, 4.0))).unwrap();
    assert!(dead.stable() && dead.rotation().scaled_axis().z < -0.2);
    // D stands at (+, -): what lengthens elsewhere tips the plate towards it.
    let at = dead.position();
    assert!(at.x > 0.0 && at.y < 0.0, "{at}");
    // B is wound as A: at equal pressures the plate does not stay, it turns negative.
    let mut wrong = scene(60.0);
    wrong.frees[1] = wrong.frees[0];
    let module = build(&wrong, Resolution::DEFAULT);
    let state = module.equilibrium(&Loads::pressures([3.0 * PSI; 4])).unwrap();
    assert!(state.rotation().scaled_axis().z < -0.2, "{}", state.rotation().scaled_axis());
    // A module of the other hands throughout is the mirror image.
    let mut mirrored = scene(60.0);
    mirrored.frees.iter_mut().for_each(|free| free.tube.gamma = -free.tube.gamma);
    let mirrored = build(&mirrored, Resolution::DEFAULT).equilibrium(&Loads::pressures(case(2, 3.0))).unwrap();
    let state = build(&scene(60.0), Resolution::DEFAULT).equilibrium(&Loads::pressures(case(2, 3.0))).unwrap();
    assert!((mirrored.rotation().scaled_axis().z + state.rotation().scaled_axis().z).abs() < 1e-9);
}

#[test]
fn hard_payload_hanging_upside_down_and_at_the_buckling_load() {
    let mut scene = scene(60.0);
    scene.plate_mass = 0.001;
    let module = build(&scene, Resolution::DEFAULT);
    let with = |gravity: f64| {
        let loads = Loads { gravity: Vector3::new(0.0, 0.0, gravity), ..Loads::pressures(case(4, 3.0)) };
        module.equilibrium(&loads).unwrap()
    };
    let (none, hanging, standing) = (with(0.0), with(9.81), with(-9.81));
    // 1 g: to first order what the compliance says, both ways; of the four columns' buckling load it is half a per
    // cent.
    let compliance = none.compliance().unwrap();
    let expected = compliance.column(5).fixed_rows::<3>(3) * (0.001 * 9.81);
    for (state, sign) in [(&hanging, 1.0), (&standing, -1.0)] {
        let moved = (state.position() - none.position()) * sign;
        assert!((moved - expected).norm() < 0.02 * expected.norm(), "{moved} {expected}");
    }
    // Pressed down by a dead load at zero pressure, four columns between a clamp and a plate that goes sideways buckle
    // in two modes. The plate tilts, too, against the columns' axial stiffness k = K11 (a / 2)^2 / L each: tan(x) / x =
    // -EI / (k L) with x^2 EI / L^2 the load of one.
    let to = Loads { force: Vector3::new(0.0, 0.0, -6.0), ..Loads::pressures([0.0; 4]) };
    let fine = module.with_resolution(FINE).unwrap();
    let critical = Path::new(&fine, &rest(&fine), &to, 0.02).unwrap().next_critical((-0.01, 1.0)).unwrap().unwrap();
    assert_eq!((critical.kind, critical.gained), (Kind::Bifurcation, 2));
    let load = 6.0 * critical.mu;
    let at = |share: f64| {
        let force = Vector3::new(0.0, 0.0, -load * share);
        fine.equilibrium(&Loads { force, ..Loads::pressures([0.0; 4]) }).unwrap()
    };
    let k11 = law(60.0).table().jet(1.0, 0.0, 0.0).unwrap().hessian.m11;
    let rest = [1.0, 0.0, 0.0];
    let (ei, shear) = (law(60.0).law(1.0).bending.at(rest), law(60.0).law(1.0).shear.at(rest));
    let tilt = ei / (k11 * 0.01 * 0.01);
    let (mut low, mut high) = (0.5 * PI + 1e-9, PI);
    for _ in 0..60 {
        let x = 0.5 * (low + high);
        if x.tan() / x < -tilt { low = x } else { high = x }
    }
    // Shear softens by the load over GA, and EI is that of the columns compressed; their shortening, below 1 %, is
    // left.
    let mut one = low * low * ei / (LENGTH * LENGTH);
    one *= law(60.0).law(1.0).bending.at([1.0 - one / k11, 0.0, 0.0]) / ei;
    let expected = 4.0 * one / (1.0 + one / shear);
    assert!((load / expected - 1.0).abs() < 0.02, "{load} for {expected}");
    assert!(at(0.999).stable() && at(1.001).negative_pivots() == 2);
    // On the load itself there is an answer or a named refusal, never a number that is none.
    match fine.equilibrium(&Loads { force: Vector3::new(0.0, 0.0, -load), ..Loads::pressures([0.0; 4]) }) {
        Ok(state) => assert!(state.position().iter().all(|x| x.is_finite())),
        Err(error) => assert!(matches!(error, ModuleError::Ends { .. }), "{error}"),
    }
}

#[test]
fn hard_tubes_that_overlap_and_pressures_beyond_the_law_are_refused_by_name() {
    let close = ModuleScene { spacing: 0.011, ..scene(60.0) };
    let laws = close.frees.map(|free| law(60.0).law(free.tube.gamma));
    assert!(matches!(close.with_laws(laws, FINE), Err(SceneError::Spacing { .. })));
    let module = through(&build(&scene(30.0), Resolution::DEFAULT));
    let Err(ModuleError::Ends { fraction, cause: Some(cause) }) = module.equilibrium(&Loads::pressures(case(1, 20.0)))
    else {
        panic!("20 psi is outside of the law");
    };
    let ModuleError::Rod { cause: RodError::Law(LawError::OutsideTable { pressure, .. }), .. } = *cause else {
        panic!("{cause}");
    };
    assert!(pressure > 10.0 * PSI * 0.99 && fraction > 0.45, "{pressure} {fraction}");
}

//! Four tubes under one plate, against what symmetry demands and against rods without end effects.
//!
//! The mesh is coarse (one element through the wall, six round, line fibres, which have no mesh-converged answer), and
//! the rods of module.csv neither shear nor have ends: what they can be held to is said at each test.

use freerig::fem::fidelity::{dead_length, module_mesh, rods_model_error, solid_answers};
use freerig::fem::module::{Kind, Loads, Module, ModuleScene, Path};
use freerig::fem::rod::Resolution;
use freerig::fem::section;
use freerig::fem::section_law::SectionLaw;
use freerig::fem::solid::{Mesh, ModuleEnd, ModulePath, PlateEquilibrium, SolidModule};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

const LENGTH: f64 = 0.13;

fn module(degrees: f64) -> SolidModule {
    let gamma = degrees.to_radians();
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(gamma) };
    let mesh = Mesh { around: 1, first: 4e-3, most_turn: 1.2, ..Mesh::whole(&tube) };
    SolidModule::new(&tube, LENGTH, [gamma, -gamma, gamma, -gamma], &mesh, 0.02).unwrap()
}

fn follow(degrees: f64, psi: [f64; 4]) -> ModulePath {
    let path = module(degrees).follow(&Vector3::zeros(), &[psi.map(|p| p * PSI)], &mut |_| {}).unwrap();
    assert_eq!((&path.end, path.unstable), (&ModuleEnd::Reached, None));
    assert!(path.states.iter().all(PlateEquilibrium::stable));
    path
}

/// The plate of module.csv.
fn reference(degrees: f64, case: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let text = std::fs::read_to_string(format!("{}/tests/reference/module.csv", env!("CARGO_MANIFEST_DIR"))).unwrap();
    let rows = text.lines().skip(1).map(|l| l.split(',').take(10).map(|x| x.parse().unwrap()).collect::<Vec<f64>>());
    let row = rows.into_iter().find(|r| r[0] == degrees && r[1] == case).unwrap();
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(row[6], row[7], row[8], row[9]));
    (Vector3::new(row[3], row[4], row[5]) * 1e-3, rotation)
}

/// Everything the tubes do to a plate without load must cancel: forces, and moments about the plate's centre.
fn assert_balanced(state: &PlateEquilibrium) {
    let mut force = Vector3::zeros();
    let mut moment = Vector3::zeros();
    for (wrench, (x, y)) in state.on_plate.iter().zip([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]) {
        force += wrench.force;
        moment += wrench.moment + (state.rotation * (Vector3::new(x, y, 0.0) * 0.01)).cross(&wrench.force);
    }
    // 1e-9 of the body's units, 12 N and 68 N mm.
    assert!(force.norm() < 1e-7 && moment.norm() < 1e-9, "{force} {moment}");
}

#[test]
fn nothing_moves_without_pressure() {
    let state = &follow(30.0, [0.0; 4]).states[0];
    assert!((state.position - Vector3::z() * LENGTH).norm() < 1e-12 && state.rotation.angle() < 1e-10);
    assert!(state.on_plate.iter().all(|w| w.force.norm() < 1e-8 && w.moment.norm() < 1e-10));
}

#[test]
fn all_four_lift_a_plate_straight() {
    let mut shares = Vec::new();
    let mut module = module(30.0);
    let path = module.follow(&Vector3::zeros(), &[[3.5 * PSI; 4]], &mut |share| shares.push(share)).unwrap();
    assert!(shares.windows(2).all(|s| s[0] < s[1]) && shares.last() == Some(&1.0), "{shares:?}");
    let state = &path.states[0];
    assert!(state.stable());
    assert!(state.position.xy().norm() < 1e-8 && state.rotation.angle() < 1e-7, "{state:?}");
    assert_balanced(state);
    // 4.89 mm shorter as rods; the bonded ends, about a radius each, keep 1 to 2 % of the length from shortening.
    let (position, _) = reference(30.0, 1.0);
    let shortening = (state.position.z - LENGTH) / (position.z - LENGTH);
    assert!((shortening - 1.0).abs() < 0.1, "{shortening}");
    // Neighbours turn against each other.
    let [a, b, c, d] = state.on_plate.map(|w| w.moment.z);
    assert!(a * b < 0.0 && (a + b).abs() < 1e-6 * a.abs() && (a - c).abs() < 1e-6 * a.abs() && b * d > 0.0);
}

#[test]
fn one_bends_and_turns_as_a_rod_does() {
    // Case 3; two neighbours, which only bend, are compared with rods of their own law below.
    let state = &follow(30.0, [3.5, 0.0, 0.0, 0.0]).states[0];
    assert_balanced(state);
    let (position, rotation) = reference(30.0, 3.0);
    let (travel, want) = (state.position - Vector3::z() * LENGTH, position - Vector3::z() * LENGTH);
    assert!((travel - want).norm() < 0.1 * want.norm(), "{travel} {want}");
    assert!(state.rotation.angle_to(&rotation) < 0.1 * rotation.angle(), "{}", state.rotation);
}

#[test]
fn a_dead_force_moves_the_plate_its_way() {
    let state = |force: Vector3<f64>| module(30.0).follow(&force, &[[0.0; 4]], &mut |_| {}).unwrap().states.remove(0);
    let pulled = state(Vector3::new(0.0, 0.02, 0.0));
    assert!(pulled.position.y > 1e-4 && pulled.position.x.abs() < 0.1 * pulled.position.y, "{pulled:?}");
    let sum: Vector3<f64> = pulled.on_plate.iter().map(|w| w.force).sum();
    assert!((sum + Vector3::new(0.0, 0.02, 0.0)).norm() < 1e-7, "{sum}");
}

#[test]
fn what_symmetry_saves_changes_nothing() {
    // A force too small to move anything breaks every symmetry, so that all four tubes are solved. Short tubes have the
    // same symmetries.
    let (length, gamma) = (0.04, 30f64.to_radians());
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(gamma) };
    let mesh = Mesh { around: 1, first: 4e-3, most_turn: 1.0, ..Mesh::whole(&tube) };
    let unseen = Vector3::new(1e-12, 1e-12, 0.0);
    for psi in [[1.0; 4], [1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 1.0, 0.0]] {
        let row = psi.map(|p| p * PSI);
        let [saved, whole] = [Vector3::zeros(), unseen].map(|force| {
            let mut module = SolidModule::new(&tube, length, [gamma, -gamma, gamma, -gamma], &mesh, 0.02).unwrap();
            module.follow(&force, &[row], &mut |_| {}).unwrap().states.remove(0)
        });
        assert!((saved.position - whole.position).norm() < 1e-8 * LENGTH, "{psi:?}: {saved:?} {whole:?}");
        assert!(saved.rotation.angle_to(&whole.rotation) < 1e-8, "{psi:?}: {saved:?} {whole:?}");
        for (a, b) in saved.on_plate.iter().zip(&whole.on_plate) {
            assert!((a.force - b.force).norm() < 1e-6 && (a.moment - b.moment).norm() < 1e-8, "{psi:?}: {a:?} {b:?}");
        }
        assert_eq!(
            (saved.negative_pivots, saved.expected_negative_pivots),
            (whole.negative_pivots, whole.expected_negative_pivots)
        );
        let [(pair, a), (_, b)] = [saved.least_clearance.unwrap(), whole.least_clearance.unwrap()];
        assert!((a - b).abs() < 1e-9 && (pair[1] - pair[0]) % 2 == 1, "{psi:?}: {a} {b}");
        assert_balanced(&saved);
    }
}

/// The rods of `scene`, with the law of the same fibres.
fn rods(scene: &ModuleScene) -> Module {
    rods_on(scene, section::Mesh::level(1))
}

fn rods_on(scene: &ModuleScene, mesh: section::Mesh) -> Module {
    let resolution = Resolution { degree: 6, steps: 8 };
    let mut law = None;
    let build = |request: &_| match &law {
        Some(law) => Ok(SectionLaw::clone(law)),
        None => SectionLaw::build(request).inspect(|built| law = Some(built.clone())),
    };
    scene.module(mesh, 10.0 * PSI, resolution, build).unwrap()
}

/// The usual mesh of a module, coarser along the tubes.
fn coarse(tube: &Tube) -> Mesh {
    Mesh { around_growth: 12.0, first: 4e-3, most_turn: 1.2, ..module_mesh(tube) }
}

/// A scene of reference FREEs, whose dead length is that of the single FREE at `psi`.
fn corrected(degrees: f64, psi: f64) -> ModuleScene {
    let mut scene = ModuleScene::reference(degrees.to_radians());
    let dead = dead_length(&scene.frees[0].tube, LENGTH, psi * PSI).unwrap();
    scene.frees.iter_mut().for_each(|free| free.dead_length = dead);
    scene
}

fn compared(degrees: f64, case: usize, psi: f64, mesh: fn(&Tube) -> Mesh) -> (f64, f64) {
    let on: &[usize] = [&[0, 1, 2, 3][..], &[0, 2], &[0], &[0, 1], &[0, 1, 2]][case - 1];
    let row = std::array::from_fn(|i| if on.contains(&i) { psi * PSI } else { 0.0 });
    let scene = corrected(degrees, psi);
    let by_rods = rods(&scene).equilibrium(&Loads::pressures(row)).unwrap();
    let bare = rods(&ModuleScene::reference(degrees.to_radians())).equilibrium(&Loads::pressures(row)).unwrap();
    let gammas = scene.frees.map(|free| free.tube.gamma);
    let tube = scene.frees[0].tube;
    let mut solid = SolidModule::new(&tube, LENGTH, gammas, &mesh(&tube), scene.spacing).unwrap();
    let path = solid.follow(&Vector3::zeros(), &[row], &mut |_| {}).unwrap();
    let state = &path.states[0];
    assert!(by_rods.stable() && state.stable());
    let travel = (state.position - Vector3::z() * LENGTH).norm();
    let [off, uncorrected] = [&by_rods, &bare].map(|rods| (rods.position() - state.position).norm() / travel);
    println!(
        "| {degrees} | {case} | {psi} | {:.2} | {:.3} {:.3} {:.3} | {:.3} {:.3} {:.3} | {:.2} % | {:.2} % |",
        1e3 * scene.frees[0].dead_length,
        1e3 * state.position.x,
        1e3 * state.position.y,
        1e3 * state.position.z,
        1e3 * by_rods.position().x,
        1e3 * by_rods.position().y,
        1e3 * by_rods.position().z,
        100.0 * uncorrected,
        100.0 * off,
    );
    (off, uncorrected)
}

#[test]
fn rods_with_one_end_correction_are_the_solid_in_case_4_at_30_degrees() {
    let (off, uncorrected) = compared(30.0, 4, 3.5, coarse);
    // Asked of the rods: 2 % of the travel. The correction, from the single FREE alone, is what brings them there.
    assert!(off < 0.02 && uncorrected > off, "{off} {uncorrected}");
}

/// Minutes.
#[test]
#[ignore = "the whole comparison, some minutes: cargo test --release --test fem -- --ignored --nocapture rods_against"]
fn rods_against_the_solid_of_the_same_fibres() {
    println!("| deg | case | psi | dead length mm | solid mm | rods mm | off without it | off |");
    let far: Vec<_> = [(30.0, 3), (30.0, 4), (30.0, 5), (60.0, 3), (60.0, 4), (60.0, 5)]
        .into_iter()
        .map(|(degrees, case)| (degrees, case, compared(degrees, case, 3.5, module_mesh).0))
        .filter(|(_, _, off)| *off > 0.02)
        .collect();
    assert!(far.is_empty(), "off by more than 2 % of the travel: {far:?}");
}

#[test]
fn case_1_at_60_degrees_buckles_where_the_rods_say() {
    // Line fibres on the same coarse divisions across the tube, for the rods' law and for the solid: it is the buckling
    // that is compared. What the law of strips says of it is held to the section's in module_reference.
    let mut scene = ModuleScene::reference(60f64.to_radians());
    scene.frees.iter_mut().for_each(|free| free.tube.fiber_width = 0.0);
    let module = rods_on(&scene, section::Mesh::Counted { radial: 1, strip: 1, gap: 1, growth: 1.0 });
    let rest = module.equilibrium(&Loads::pressures([0.0; 4])).unwrap();
    let to = Loads::pressures([10.0 * PSI; 4]);
    let rods = Path::new(&module, &rest, &to, 0.05).unwrap().next_critical((-0.01, 0.9)).unwrap().unwrap();
    assert_eq!((rods.kind, rods.gained), (Kind::Bifurcation, 2));
    // The ends, a hundredth of the length, move the buckling torque as much; the law's EI is told to 1.5 %: 2.5 % below
    // the rods' pressure the solid stands, and as much above it leans, to any side.
    let tube = scene.frees[0].tube;
    let gammas = scene.frees.map(|free| free.tube.gamma);
    let mesh = Mesh { around: 2, first: 4e-3, most_turn: 1.2, ..Mesh::whole(&tube) };
    let mut solid = SolidModule::new(&tube, LENGTH, gammas, &mesh, scene.spacing).unwrap();
    let rows = [0.975, 1.025].map(|share| [share * 10.0 * rods.mu * PSI; 4]);
    let path = solid.follow(&Vector3::zeros(), &rows, &mut |_| {}).unwrap();
    let [below, above] = &path.states[..] else { panic!("{:?}", path.end) };
    println!("the solid buckles at {:?} Pa, the rods at {} Pa", path.unstable, 10.0 * PSI * rods.mu);
    assert!(below.stable());
    assert_eq!(above.negative_pivots - above.expected_negative_pivots, 2);
    let found = path.unstable.unwrap()[0];
    assert!(rows[0][0] < found && found < rows[1][0], "{found}");
}

#[test]
fn what_the_solid_does_not_have_is_refused_by_name() {
    let mut scene = ModuleScene::reference(0.5);
    scene.moment.x = 1e-3;
    let said = solid_answers(&scene, &[[0.0; 4]], &mut |_| {}).unwrap_err().to_string();
    assert!(said.contains("moment") && said.contains("rods do"), "{said}");
    let mut scene = ModuleScene::reference(0.5);
    scene.frees[2].length = 0.12;
    let said = solid_answers(&scene, &[[0.0; 4]], &mut |_| {}).unwrap_err().to_string();
    assert!(said.contains("winding angles"), "{said}");
}

#[test]
fn refusals_name_the_rule() {
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(0.5) };
    let said = |mesh: Mesh, spacing: f64| match SolidModule::new(&tube, LENGTH, [0.5, -0.5, 0.5, -0.5], &mesh, spacing)
    {
        Ok(_) => panic!("accepted"),
        Err(error) => error.to_string(),
    };
    assert!(said(Mesh::whole(&tube), 0.01).contains("outer diameter"));
    assert!(said(Mesh::sector(&tube), 0.02).contains("cannot bend"));
    assert!(said(Mesh { most_turn: 2.0, ..Mesh::whole(&tube) }, 0.02).contains("turn"));
}

#[test]
fn ends_are_estimated_at_half_of_a_pressure_that_a_single_free_does_not_bear() {
    // By itself a FREE of 30 deg runs away between 7 and 8 psi (reference/section.csv); the others of a module hold it.
    let scene = ModuleScene::reference(30f64.to_radians());
    let [beyond, half] = [9.0, 4.5].map(|psi| rods_model_error(&scene, psi * PSI).unwrap());
    assert!(half.is_some_and(|ends| ends > 0.005 && ends < 0.1), "{half:?}");
    assert_eq!(beyond, half);
    // Where it bears neither, nothing is told.
    assert_eq!(rods_model_error(&scene, 20.0 * PSI).unwrap(), None);
}

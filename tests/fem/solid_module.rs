//! Four tubes under one plate, against what symmetry demands and against rods without end effects.
//!
//! The mesh is coarse (one element through the wall, six round, line fibres, which have no mesh-converged answer), and
//! the rods of module.csv neither shear nor have ends: what they can be held to is said at each test.

use freerig::fem::solid::{Mesh, ModulePath, PlateEquilibrium, SolidModule};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

const LENGTH: f64 = 0.13;

fn module(degrees: f64) -> SolidModule {
    let gamma = degrees.to_radians();
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(gamma) };
    let mesh = Mesh { around: 1, first: 2e-3, most_turn: 1.0, ..Mesh::whole(&tube) };
    SolidModule::new(&tube, LENGTH, [gamma, -gamma, gamma, -gamma], &mesh, 0.02).unwrap()
}

fn follow(degrees: f64, psi: [f64; 4]) -> ModulePath {
    let path = module(degrees).follow(&Vector3::zeros(), &[psi.map(|p| p * PSI)], &mut |_| {}).unwrap();
    assert_eq!(path.stuck, None);
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
fn two_neighbours_bend_and_one_bends_and_turns_as_rods_do() {
    for (degrees, case, psi) in [(30.0, 4.0, [3.5, 3.5, 0.0, 0.0]), (30.0, 3.0, [3.5, 0.0, 0.0, 0.0])] {
        let state = &follow(degrees, psi).states[0];
        assert_balanced(state);
        let (position, rotation) = reference(degrees, case);
        let (travel, want) = (state.position - Vector3::z() * LENGTH, position - Vector3::z() * LENGTH);
        assert!((travel - want).norm() < 0.1 * want.norm(), "{degrees} {case}: {travel} {want}");
        assert!(state.rotation.angle_to(&rotation) < 0.1 * rotation.angle(), "{degrees} {case}: {}", state.rotation);
    }
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

use nalgebra::{DMatrix, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::assembly::carried;
use super::*;
use crate::fem::solid::body::State;
use crate::fem::solid::cap::{AXIAL, TURN, Tilt};
use crate::fem::solid::element::TWIST;
use crate::fem::solid::mesh::{Mesh, Part, tube_body};
use crate::fem::tube::Tube;

fn bodies() -> Vec<Body> {
    let strip = Tube::reference(0.7);
    let line = Tube { fiber_width: 0.0, fibers: 3, ..Tube::reference(-0.3) };
    let mesh = |tube: &Tube, part| Mesh {
        part,
        wall: 1,
        around: 1,
        around_growth: 20.0,
        first: 4e-3,
        largest: 4e-3,
        ..Mesh::sector(tube)
    };
    [(strip, Part::Sector), (line, Part::Sector), (line, Part::Whole)]
        .map(|(tube, part)| tube_body(&tube, 8e-3, &mesh(&tube, part), None).unwrap())
        .to_vec()
}

/// A loaded system in a random state, and a random direction with the change of pressures that goes with it.
fn disturbed(body: Body, whole: bool, seed: u64) -> (System, State, Direction) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let held: [bool; COORDINATES] = std::array::from_fn(|q| q > AXIAL && !whole);
    let mut system = System::new(body, held).unwrap();
    system.loads = [0.02, -0.03, 0.01, 0.02, 0.03, -0.01];
    let mut state = system.body.rest();
    let small = |rng: &mut Pcg64Mcg, size: f64| rng.random_range(-size..size);
    state.gas = 0.15;
    for (position, unknowns) in state.positions.iter_mut().zip(&system.unknowns) {
        for i in (0..3).filter(|&i| unknowns[i] != HELD) {
            position[i] += small(&mut rng, 0.003);
        }
    }
    for q in (0..COORDINATES).filter(|&q| !held[q]) {
        state.cap[q] = small(&mut rng, if q == TURN { 0.5 } else { 0.02 });
    }
    state.pressures.iter_mut().flatten().for_each(|p| *p = small(&mut rng, 0.2));
    state.tensions.iter_mut().flatten().for_each(|t| *t = small(&mut rng, 0.2));
    system.body.carry(&mut state);
    system.evaluate(&state, true).unwrap();
    let mut direction = Direction {
        nodes: (0..system.size()).map(|_| small(&mut rng, 1.0)).collect(),
        pressures: Vec::new(),
        tensions: Vec::new(),
        cap: std::array::from_fn(|q| if held[q] { 0.0 } else { small(&mut rng, 1.0) }),
        gas: small(&mut rng, 1.0),
        volume: 0.0,
    };
    system.recover(&state, false, &mut direction);
    // The condensed pressures are stiff: leave them the part that the direction asks for, scaled down.
    (system, state, direction)
}

#[test]
fn the_tangent_is_the_derivative_of_the_residual_with_slope_two() {
    // The condensed matrix times du is A du + B^T dp with dp = kappa M^-1 B du: rubber, gas, fibre, cap, loads.
    for (case, body) in bodies().into_iter().enumerate() {
        let whole = case == 2;
        let (mut system, state, direction) = disturbed(body, whole, case as u64);
        let size = system.size();
        let mut slope = system.matrix.times(&direction.nodes);
        let mut cap = [0.0; COORDINATES];
        for (q, change) in direction.cap.iter().chain([&direction.gas]).enumerate() {
            for (s, b) in slope.iter_mut().zip(&system.border[q * size..]) {
                *s += b * change;
            }
        }
        for (q, of) in cap.iter_mut().enumerate() {
            *of = system.border[q * size..][..size].iter().zip(&direction.nodes).map(|(b, u)| b * u).sum();
            *of += (0..COORDINATES).map(|p| system.corner[(q, p)] * direction.cap[p]).sum::<f64>();
            *of += system.corner[(q, GAS)] * direction.gas;
        }
        let (residual, cap_residual) = (system.residual.clone(), system.cap_residual);
        let scale = slope.iter().fold(0.0_f64, |m, s| m.max(s.abs()));
        let mut remainder = |h: f64| {
            let mut there = state.clone();
            system.advance(&mut there, &direction, h);
            system.evaluate(&there, false).unwrap();
            let nodes = (system.residual.iter().zip(&residual).zip(&slope)).map(|((a, b), s)| a - b - h * s);
            let ends = (0..COORDINATES)
                .filter(|&q| !system.held[q])
                .map(|q| system.cap_residual[q] - cap_residual[q] - h * cap[q]);
            nodes.chain(ends).map(|r| r * r).sum::<f64>().sqrt()
        };
        let (large, small) = (remainder(1e-4), remainder(1e-5));
        let order = (large / small).log10();
        assert!((order - 2.0).abs() < 0.05, "case {case}: {order} ({large:.2e} {small:.2e} of {scale:.2e})");
    }
}

#[test]
fn the_residual_and_the_volume_slope_are_derivatives() {
    for (case, body) in bodies().into_iter().enumerate() {
        let (mut system, state, mut direction) = disturbed(body, case == 2, 10 + case as u64);
        direction.pressures.iter_mut().flatten().for_each(|p| *p = 0.0);
        direction.tensions.iter_mut().flatten().for_each(|t| *t = 0.0);
        direction.gas = 0.0;
        let size = system.size();
        let sum = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let slope = sum(&system.residual, &direction.nodes) + sum(&system.cap_residual, &direction.cap);
        let volume = -sum(&system.border[GAS * size..], &direction.nodes)
            - (0..COORDINATES).map(|q| system.corner[(q, GAS)] * direction.cap[q]).sum::<f64>();
        let mut at = |h: f64| {
            let mut there = state.clone();
            system.advance(&mut there, &direction, h);
            system.evaluate(&there, false).unwrap();
            (system.energy, system.volume)
        };
        // Central differences: truncation about 1e-8 of the third derivative.
        let h = 1e-5;
        let (plus, minus) = (at(h), at(-h));
        let by_difference = (plus.0 - minus.0) / (2.0 * h);
        assert!((by_difference - slope).abs() < 1e-5 * (1.0 + slope.abs()), "case {case}: {by_difference} {slope}");
        let by_difference = (plus.1 - minus.1) / (2.0 * h);
        assert!((by_difference - volume).abs() < 1e-6 * (1.0 + volume.abs()), "case {case}");
    }
}

#[test]
fn a_rigid_motion_changes_nothing() {
    // The whole tube, deformed at random, turned about any axis and moved: energy of rubber and fibres, and
    // misfit of volume stay, forces turn with it.
    let body = Body { supports: vec![Support::FREE; bodies()[2].reference.len()], ..bodies().remove(2) };
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut system = System::new(body, [true; COORDINATES]).unwrap();
    let mut state = system.body.rest();
    state.pressures.iter_mut().flatten().for_each(|p| *p = rng.random_range(-0.2..0.2));
    for y in &mut state.positions {
        *y += Vector3::from_fn(|_, _| rng.random_range(-0.01..0.01));
    }
    system.evaluate(&state, false).unwrap();
    let (energy, residual) = (system.energy, system.residual.clone());
    let turn = nalgebra::Rotation3::from_scaled_axis(Vector3::new(1.0, -2.0, 0.7));
    state.positions.iter_mut().for_each(|y| *y = turn * *y + Vector3::new(0.3, 2.0, -1.0));
    system.evaluate(&state, false).unwrap();
    assert!((system.energy / energy - 1.0).abs() < 1e-12);
    let largest = residual.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
    for (n, unknowns) in system.unknowns.iter().enumerate() {
        let force = |of: &[f64]| Vector3::from_fn(|i, _| of[unknowns[i]]);
        let difference = force(&system.residual) - turn * force(&residual);
        assert!(difference.norm() < 1e-11 * largest, "node {n}");
    }
}

#[test]
fn inertia_is_that_of_the_full_saddle_point_matrix() {
    // With a bulk modulus the condensed count plus the number of pressures is that of the dense matrix in
    // displacements, cap and pressures.
    let tube = Tube { fiber_width: 0.0, fibers: 3, ..Tube::reference(0.3) };
    let mesh = Mesh { wall: 1, around: 1, first: 4e-3, largest: 4e-3, ..Mesh::sector(&tube) };
    for gas in [0.0, -4.0] {
        let body = tube_body(&tube, 8e-3, &mesh, Some(100.0)).unwrap();
        let held = std::array::from_fn(|q| q > AXIAL);
        let mut system = System::new(body, held).unwrap();
        let mut state = system.body.rest();
        state.gas = gas;
        system.evaluate(&state, true).unwrap();
        system.factorize().unwrap();
        // Dense: undo the condensation. Unknowns: nodes, two of the cap, pressures.
        let (n, m) = (system.size(), system.body.pressures());
        let mut dense = DMatrix::zeros(n + 2 + m, n + 2 + m);
        for c in 0..n {
            let mut unit = vec![0.0; n];
            unit[c] = 1.0;
            dense.view_mut((0, c), (n, 1)).copy_from_slice(&system.matrix.times(&unit));
        }
        for q in 0..2 {
            for r in 0..n {
                dense[(r, n + q)] = system.border[q * n + r];
                dense[(n + q, r)] = system.border[q * n + r];
            }
            for p in 0..2 {
                dense[(n + q, n + p)] = system.corner[(q, p)];
            }
        }
        let tilt = Tilt::of(&state.cap);
        for (index, kept) in system.kept.iter().enumerate() {
            let block = &system.matrix.blocks()[index];
            let mut rows = DMatrix::zeros(PRESSURES, n + 2);
            for a in 0..PRESSURES {
                for (r, &unknown) in block.iter().enumerate().filter(|&(_, &u)| u != HELD) {
                    rows[(a, unknown)] += kept.constraint[a][r];
                }
                rows[(a, n)] += kept.constraint[a][TWIST] / system.body.length;
                for (node, of) in carried(&system.body, &system.body.cells[index], &tilt) {
                    for i in 0..3 {
                        rows[(a, n + 1)] += kept.constraint[a][3 * node + i] * of[(i, AXIAL)];
                    }
                }
            }
            let stiffness = DMatrix::from_fn(PRESSURES, PRESSURES, |r, c| kept.stiffness[(r, c)]);
            let condensed = rows.transpose() * &stiffness * &rows;
            let mut corner = dense.view_mut((0, 0), (n + 2, n + 2));
            corner -= condensed;
            let at = n + 2 + PRESSURES * index;
            let mass = stiffness.try_inverse().unwrap();
            dense.view_mut((at, at), (PRESSURES, PRESSURES)).copy_from(&(-mass));
            dense.view_mut((at, 0), (PRESSURES, n + 2)).copy_from(&rows);
            dense.view_mut((0, at), (n + 2, PRESSURES)).copy_from(&rows.transpose());
        }
        let negative = dense.symmetric_eigenvalues().iter().filter(|&&e| e < 0.0).count();
        assert_eq!(negative, m + system.negative(), "gas {gas}");
        assert_eq!(system.negative() > 0, gas < 0.0, "gas {gas}: {}", system.negative());
    }
}

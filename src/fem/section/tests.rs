//! What only the inside of the section can show: tangents, objectivity, the order of the fields, the phased form.

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::assembly::{Assembly, EPSILON};
use super::fields::{Fields, Sector};
use super::newton::{Condition, Workspace};
use super::phased::Phased;
use super::{Mesh, Section};
use crate::fem::ends::Ends;
use crate::fem::material::Law;
use crate::fem::tube::Tube;

const MESH: Mesh = Mesh::Counted { radial: 2, strip: 1, gap: 2, growth: 1.5 };

/// A deformed state that is no equilibrium: the tube at rest with every unknown moved.
fn disturbed(sector: &Sector, rng: &mut Pcg64Mcg) -> Fields {
    let mut fields = sector.rest();
    fields.position.iter_mut().for_each(|x| *x += rng.random_range(-3e-3..3e-3));
    fields.multiplier.iter_mut().flatten().for_each(|q| *q = rng.random_range(-0.3..0.3));
    fields.globals = [1.1, -0.15, 0.2];
    fields
}

fn moved(fields: &Fields, direction: &Fields, h: f64) -> Fields {
    let mut there = fields.clone();
    for (x, d) in there.position.iter_mut().zip(&direction.position) {
        *x += h * d;
    }
    for (x, d) in there.multiplier.iter_mut().flatten().zip(direction.multiplier.iter().flatten()) {
        *x += h * d;
    }
    for (x, d) in there.globals.iter_mut().zip(&direction.globals) {
        *x += h * d;
    }
    there
}

/// All first derivatives of the potential.
fn gradient(assembly: &Assembly) -> Vec<f64> {
    let constraints = assembly.constraint.iter().flatten();
    assembly.residual.iter().chain(constraints).chain(assembly.conjugate.iter()).copied().collect()
}

/// Product of the full second derivative with a direction, the penalty taken out.
fn product(sector: &Sector, assembly: &Assembly, d: &Fields) -> Vec<f64> {
    let mut forces = vec![0.0; d.position.len()];
    assembly.stiffness.multiply(&d.position, &mut forces);
    let mut constraints = vec![0.0; 3 * sector.points.len()];
    let mut conjugate = assembly.hessian * Vector3::from(d.globals);
    for index in 0..sector.points.len() {
        let nodes = sector.element(index / sector.rows(), index % sector.rows());
        for k in 0..3 {
            let b = &assembly.gradient[index][k];
            let dof = |local: usize| 3 * nodes[local / 3] + local % 3;
            let gained: f64 = b.iter().enumerate().map(|(local, b)| b * d.position[dof(local)]).sum();
            let factor = d.multiplier[index][k] - gained / (EPSILON * sector.mass[index][k]);
            for (local, b) in b.iter().enumerate() {
                forces[dof(local)] += b * factor;
            }
            let by_globals: f64 = (0..3).map(|g| assembly.constraint_coupling[index][g][k] * d.globals[g]).sum();
            constraints[3 * index + k] = gained + by_globals;
            for g in 0..3 {
                conjugate[g] += assembly.constraint_coupling[index][g][k] * d.multiplier[index][k];
            }
        }
    }
    for g in 0..3 {
        for (force, c) in forces.iter_mut().zip(&assembly.coupling[g]) {
            *force += c * d.globals[g];
        }
        conjugate[g] += assembly.coupling[g].iter().zip(&d.position).map(|(c, x)| c * x).sum::<f64>();
    }
    forces.into_iter().chain(constraints).chain(conjugate.iter().copied()).collect()
}

fn tubes() -> [Tube; 3] {
    let reference = Tube::reference(-0.9);
    [
        reference,
        Tube { fiber_width: 0.0, law: Law::NeoHookean { mu: 1e5 }, ..reference },
        Tube { law: Law::Linear { mu: 0.393e6 }, gamma: 0.5, ..reference },
    ]
}

#[test]
fn taylor_remainders_of_potential_and_residual_fall_with_slope_two() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for tube in tubes() {
        let sector = Sector::new(&tube, MESH).unwrap();
        let fields = disturbed(&sector, &mut rng);
        let direction = Fields {
            position: fields.position.iter().map(|_| rng.random_range(-1.0..1.0)).collect(),
            multiplier: fields.multiplier.iter().map(|_| [0; 3].map(|_| rng.random_range(-1.0..1.0))).collect(),
            globals: [0.7, -0.4, 0.9],
        };
        let mut assembly = Assembly::new(&sector);
        assembly.fill(&sector, &fields).unwrap();
        let (energy, here) = (assembly.energy, gradient(&assembly));
        let linear = product(&sector, &assembly, &direction);
        let flat: Vec<f64> = (direction.position.iter())
            .chain(direction.multiplier.iter().flatten())
            .chain(&direction.globals)
            .copied()
            .collect();
        let slope: f64 = here.iter().zip(&flat).map(|(g, d)| g * d).sum();
        let mut remainders = |h: f64| {
            assembly.fill(&sector, &moved(&fields, &direction, h)).unwrap();
            let there = gradient(&assembly);
            let vector: f64 = there.iter().zip(&here).zip(&linear).map(|((t, g), l)| (t - g - h * l).powi(2)).sum();
            ((assembly.energy - energy - h * slope).abs(), vector.sqrt())
        };
        let (large, small) = (remainders(4e-5), remainders(1e-5));
        // Strains are a hundred times the nodal change: the third order moves the slope by a few per cent.
        for (a, b) in [(large.0, small.0), (large.1, small.1)] {
            let order = (a / b).log(4.0);
            assert!((order - 2.0).abs() < 0.06, "{:?}: order {order}", tube.law);
        }
    }
}

#[test]
fn a_rigid_turn_and_shift_leave_the_potential_alone() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let sector = Sector::new(&Tube::reference(0.7), MESH).unwrap();
    let fields = disturbed(&sector, &mut rng);
    let mut turned = fields.clone();
    let (sine, cosine) = 0.8_f64.sin_cos();
    for d in turned.position.chunks_exact_mut(3) {
        (d[0], d[1]) = (cosine * d[0] - sine * d[1], sine * d[0] + cosine * d[1]);
    }
    let (mut a, mut b) = (Assembly::new(&sector), Assembly::new(&sector));
    a.fill(&sector, &fields).unwrap();
    b.fill(&sector, &turned).unwrap();
    assert!((a.energy - b.energy).abs() < 1e-12 * a.energy.abs());
    assert!((a.conjugate - b.conjugate).norm() < 1e-11 * a.conjugate.norm());
    for (f, g) in a.residual.chunks_exact(3).zip(b.residual.chunks_exact(3)) {
        let turned = [cosine * f[0] - sine * f[1], sine * f[0] + cosine * f[1], f[2]];
        assert!(turned.iter().zip(g).all(|(f, g)| (f - g).abs() < 1e-11));
    }
    for d in turned.position.chunks_exact_mut(3) {
        d[2] += 0.3;
    }
    b.fill(&sector, &turned).unwrap();
    // The volume's density changes by a derivative round the section, whose ends cancel over a whole sector only.
    assert!((a.conjugate.x - b.conjugate.x).abs() < 1e-11 * a.conjugate.norm());
}

#[test]
fn fields_converge_with_order_three() {
    // Rivlin's tube: r^2 = (R^2 + c) / lam, whatever the torsion. c from the finest mesh's inner radius is exact to
    // its superconvergent order 4, far below the fields' errors here.
    let tube = Tube { fiber_ea: 0.0, wall: 4e-3, law: Law::NeoHookean { mu: 1e5 }, ..Tube::reference(0.7) };
    let held = [Condition::Held(1.2), Condition::Held(0.3), Condition::Held(0.2)];
    let solve = |radial: usize| {
        let mesh = Mesh::Counted { radial, strip: 1, gap: 1, growth: 1.0 };
        let sector = Sector::new(&tube, mesh).unwrap();
        let found = Workspace::new(&sector).solve(&sector, sector.rest(), held).unwrap();
        (sector, found.fields)
    };
    let (sector, finest) = solve(32);
    let inner = tube.inner_radius / tube.outer_radius();
    let c = 1.2 * sector.radius_at(&finest, 0).powi(2) - inner * inner;
    let error = |radial: usize| {
        let (sector, fields) = solve(radial);
        let mut sum = 0.0;
        for (index, points) in sector.points.iter().enumerate() {
            let nodes = sector.element(index / sector.rows(), index % sector.rows());
            for point in points {
                let r: f64 = (0..9).map(|a| point.shape[a][2] * fields.position[3 * nodes[a]]).sum();
                sum += point.weight * (r - ((point.radius.powi(2) + c) / 1.2).sqrt()).powi(2);
            }
        }
        sum.sqrt()
    };
    let errors = [1, 2, 4, 8].map(error);
    for pair in errors.windows(2).skip(1) {
        let order = (pair[0] / pair[1]).log2();
        assert!((2.8..3.3).contains(&order), "{errors:?}");
    }
}

#[test]
fn a_phase_of_zero_is_the_equilibriums_own_second_variation() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    for tube in tubes() {
        let sector = Sector::new(&tube, MESH).unwrap();
        let fields = disturbed(&sector, &mut rng);
        let mut assembly = Assembly::new(&sector);
        assembly.fill(&sector, &fields).unwrap();
        let phased = Phased::new(&sector, &fields, 0).unwrap();
        let x: Vec<f64> = fields.position.iter().map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut plain = vec![0.0; x.len()];
        assembly.stiffness.multiply(&x, &mut plain);
        for part in 0..2 {
            let spread: Vec<f64> = (x.chunks_exact(3))
                .flat_map(
                    |d| if part == 0 { [d[0], d[1], d[2], 0.0, 0.0, 0.0] } else { [0.0, 0.0, 0.0, d[0], d[1], d[2]] },
                )
                .collect();
            let mut twice = vec![0.0; spread.len()];
            phased.stiffness.multiply(&spread, &mut twice);
            let scale = 1e-12 / EPSILON;
            let ends = [0, sector.node(2 * sector.columns(), 0)];
            for (node, (a, b)) in plain.chunks_exact(3).zip(twice.chunks_exact(6)).enumerate() {
                // The two forms of the volume differ by a derivative round the section, which the ends see.
                let same = &b[3 * part..][..3];
                let near = a.iter().zip(same).all(|(a, b)| (a - b).abs() < scale * (1.0 + a.abs()));
                assert!(near || ends.contains(&node), "{node}: {a:?} {same:?}");
            }
        }
    }
}

#[test]
fn moving_the_whole_tube_sideways_costs_nothing() {
    let section = Section::new(&Tube::reference(0.9), MESH).unwrap();
    let mut state = section.rest().unwrap();
    section.advance(&mut state, 3e4, Ends::FREE).unwrap();
    let form = Phased::new(&section.sector, &state.solution.fields, 1).unwrap();
    let shift: Vec<f64> = (0..section.sector.nodes()).flat_map(|_| [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]).collect();
    let mut force = vec![0.0; shift.len()];
    form.stiffness.multiply(&shift, &mut force);
    let fixed = Phased::fixed(&section.sector);
    let worst = force.iter().zip(&fixed).filter(|(_, fixed)| !**fixed).map(|(f, _)| f.abs()).fold(0.0, f64::max);
    // Round-off of the penalty.
    assert!(worst < 1e-13 / EPSILON, "{worst}");
}

#[test]
fn fields_on_a_finer_mesh_are_the_coarser_ones() {
    // Rows and columns of half the size: what is quadratic in an element of the one is in those of the other.
    let tube = Tube::reference(0.7);
    let mesh = |n: usize| Mesh::Counted { radial: 2 * n, strip: n, gap: 3 * n, growth: 1.0 };
    let [coarse, fine] = [1, 2].map(|n| Sector::new(&tube, mesh(n)).unwrap());
    let mut rng = Pcg64Mcg::seed_from_u64(4);
    let fields = disturbed(&coarse, &mut rng);
    let found = fine.interpolated(&coarse, &fields);
    let (mut a, mut b) = (Assembly::new(&coarse), Assembly::new(&fine));
    a.fill(&coarse, &fields).unwrap();
    b.fill(&fine, &found).unwrap();
    // The same integrals, by quadratures of other points: volumes are polynomials of degree 4 in each direction.
    assert!((a.conjugate.z / b.conjugate.z - 1.0).abs() < 1e-12);
    let sum = |assembly: &Assembly| assembly.constraint.iter().map(|c| c[0]).sum::<f64>();
    assert!((sum(&a) - sum(&b)).abs() < 1e-6, "{} {}", sum(&a), sum(&b));
    let back = coarse.interpolated(&fine, &found);
    assert!(back.position.iter().zip(&fields.position).all(|(x, y)| (x - y).abs() < 1e-14));
    assert_eq!(back.globals, fields.globals);
}

//! The element of the solid on bodies with known answers: patch, Cook's membrane, thick tube, thick sphere.

use std::f64::consts::{FRAC_PI_4, PI};

use freerig::fem::ends::Ends;
use freerig::fem::material::Law;
use freerig::fem::solid::body::{Body, Cell, Support};
use freerig::fem::solid::cap::COORDINATES;
use freerig::fem::solid::element::Rubber;
use freerig::fem::solid::fiber::Fiber;
use freerig::fem::solid::system::{Control, System};
use freerig::fem::solid::{Mesh, PathEnd, Solid, Tip};
use freerig::fem::tube::Tube;
use nalgebra::{Matrix3, Vector3};

/// A block of elements, the unit cube mapped by `at`; `support` says what holds a node of the unit cube.
fn block(
    count: [usize; 3],
    rubber: Rubber,
    at: impl Fn(Vector3<f64>) -> Vector3<f64>,
    support: impl Fn(Vector3<f64>) -> Support,
) -> Body {
    let points = count.map(|n| 2 * n + 1);
    let index = |i: usize, j: usize, k: usize| i + points[0] * (j + points[1] * k);
    let mut body = Body {
        reference: Vec::new(),
        supports: Vec::new(),
        cells: Vec::new(),
        rubber,
        fiber_ea: 0.0,
        reference_rate: 0.0,
        length: 1.0,
        cap_center: Vector3::zeros(),
    };
    for k in 0..points[2] {
        for j in 0..points[1] {
            for i in 0..points[0] {
                let unit = [(i, 0), (j, 1), (k, 2)].map(|(i, axis)| i as f64 / (points[axis] - 1) as f64);
                body.reference.push(at(unit.into()));
                body.supports.push(support(unit.into()));
            }
        }
    }
    for k in 0..count[2] {
        for j in 0..count[1] {
            for i in 0..count[0] {
                body.cells.push(Cell {
                    nodes: std::array::from_fn(|n| index(2 * i + n % 3, 2 * j + n / 3 % 3, 2 * k + n / 9)),
                    phases: [0.0; 27],
                    inner: i == 0,
                    fiber: Fiber::None,
                    center: [i as f64, j as f64, k as f64],
                });
            }
        }
    }
    body
}

fn system(body: Body) -> System {
    System::new(body, [true; COORDINATES]).unwrap()
}

#[test]
fn a_distorted_patch_deforms_affinely() {
    // Affine motion of the boundary: the interior follows exactly, whatever the law and the element's shape.
    let f = Matrix3::new(1.1, 0.2, -0.1, 0.05, 0.9, 0.1, 0.0, -0.15, 1.05);
    for law in [Law::Ogden { mu: 1.0, alpha: 1.2 }, Law::NeoHookean { mu: 1.0 }, Law::Linear { mu: 1.0 }] {
        let edge = |u: f64| u == 0.0 || u == 1.0;
        let body = block(
            [2, 2, 2],
            Rubber::new(law, Some(50.0)),
            |u| {
                // Corners inside are displaced; all edges stay straight, so the map of an element is trilinear.
                let hat = |x: f64| 1.0 - (2.0 * x - 1.0).abs();
                let bump = hat(u.x) * hat(u.y) * hat(u.z);
                Vector3::new(u.x, u.y + 0.1 * u.x, 1.2 * u.z) + Vector3::new(0.08, -0.06, 0.1) * bump
            },
            |u| if edge(u.x) || edge(u.y) || edge(u.z) { Support::FIXED } else { Support::FREE },
        );
        let mut system = system(body);
        let mut state = system.body.rest();
        for (position, support) in state.positions.iter_mut().zip(&system.body.supports) {
            if *support == Support::FIXED {
                *position = f * *position;
            }
        }
        system.solve(&mut state, &Control::pressure(0.0), 12).unwrap();
        for (y, rest) in state.positions.iter().zip(&system.body.reference) {
            assert!((y - f * rest).norm() < 1e-9, "{law:?}");
        }
        let (volume, _) = law.volume(&f);
        for p in &state.pressures {
            let exact = (50.0 - 2.0 / 3.0) * (volume - 1.0);
            assert!((p[0] - exact).abs() < 1e-6 && p[1..].iter().all(|p| p.abs() < 1e-6), "{p:?} {exact}");
        }
    }
}

/// Tip displacement of Cook's membrane (48 by 44 to 16, plane strain, E = 1, load 1 on the right edge).
fn cook(n: usize, nu: f64) -> f64 {
    let mu = 0.5 / (1.0 + nu);
    let bulk = 2.0 * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu));
    let body = block(
        [n, n, 1],
        Rubber::new(Law::Linear { mu }, Some(bulk)),
        |u| Vector3::new(48.0 * u.x, 44.0 * u.x + u.y * (44.0 - 28.0 * u.x), u.z),
        |u| if u.x == 0.0 { Support::FIXED } else { Support::Held([false, false, true]) },
    );
    let mut system = system(body);
    // The traction 1/16 on the edge of 16 by 1, consistent with the quadratic functions.
    for (node, at) in system.body.reference.iter().enumerate().filter(|(_, at)| at.x == 48.0) {
        let half = ((at.y - 44.0) / 16.0 * 2.0 * n as f64).round() as usize;
        let along = match half {
            h if h % 2 == 1 => 4.0,
            h if h == 0 || h == 2 * n => 1.0,
            _ => 2.0,
        };
        let across = if at.z == 0.5 { 4.0 } else { 1.0 };
        system.dead[node].y = along / (6.0 * n as f64) * across / 6.0;
    }
    let mut state = system.body.rest();
    system.solve(&mut state, &Control::pressure(0.0), 8).unwrap();
    let tip = system.body.reference.iter().position(|at| (at - Vector3::new(48.0, 60.0, 0.0)).norm() < 1e-9).unwrap();
    state.positions[tip].y - 60.0
}

#[test]
fn cooks_membrane_does_not_lock() {
    // At nu = 0.4999 a coarse mesh is as good as at nu = 0.3: no locking.
    for nu in [0.3, 0.4999] {
        let tips = [2, 4, 8, 16].map(|n| cook(n, nu));
        let limit = tips[3] + (tips[3] - tips[2]) / 3.0;
        let errors = tips.map(|t| (t / limit - 1.0).abs());
        assert!(errors[0] < 0.06 && errors[1] < 0.02 && errors[2] < 0.008, "{nu}: {errors:?} {limit}");
    }
}

/// Quadrature of `f` between `a` and `b`, Gauss on 2000 intervals.
fn integral(a: f64, b: f64, f: impl Fn(f64) -> f64) -> f64 {
    let h = (b - a) / 2000.0;
    (0..2000)
        .map(|i| {
            let x = a + (i as f64 + 0.5) * h;
            let d = 0.5 * h / 3.0_f64.sqrt();
            0.5 * h * (f(x - d) + f(x + d))
        })
        .sum()
}

/// Principal Kirchhoff stress over stretch term of the Ogden law: 2 mu / alpha l^alpha.
fn ogden(mu: f64, alpha: f64, l: f64) -> f64 {
    2.0 * mu / alpha * l.powf(alpha)
}

/// An octant of a sphere of inner radius 1 and outer 1.5, `n` elements through the wall and 3 n^2 over it.
fn octant(n: usize, law: Law) -> Body {
    // Three blocks, one for each face of a cube; nodes that coincide are one.
    let mut body = block([n, n, n], Rubber::new(law, None), |u| u, |_| Support::FREE);
    let one = std::mem::take(&mut body.reference);
    let cells = std::mem::take(&mut body.cells);
    body.supports.clear();
    for face in 0..3 {
        let at = |u: &Vector3<f64>| {
            let out =
                Vector3::new(1.0, (FRAC_PI_4 * u.y).tan(), (FRAC_PI_4 * u.z).tan()).normalize() * (1.0 + 0.5 * u.x);
            Vector3::from_fn(|i, _| out[(i + 3 - face) % 3])
        };
        let numbers: Vec<usize> = (one.iter().map(at))
            .map(|x| {
                let known = body.reference.iter().position(|y| (x - y).norm() < 1e-9);
                known.unwrap_or_else(|| {
                    body.reference.push(x);
                    body.supports.push(Support::Held([0, 1, 2].map(|i| x[i].abs() < 1e-9)));
                    body.reference.len() - 1
                })
            })
            .collect();
        body.cells.extend(cells.iter().map(|cell| Cell {
            nodes: cell.nodes.map(|node| numbers[node]),
            center: [cell.center[0], cell.center[1], cell.center[2] + (face * n) as f64],
            ..cell.clone()
        }));
    }
    body
}

#[test]
fn a_sphere_converges_with_order_three() {
    // Incompressible: r^3 = R^3 + c everywhere, once the cavity's volume is given.
    let c = 0.8;
    let error = |n: usize| {
        let mut system = system(octant(n, Law::Ogden { mu: 1.0, alpha: 1.2 }));
        let mut state = system.body.rest();
        for step in [0.5, 1.0] {
            system.solve(&mut state, &Control::volume(PI / 6.0 * (1.0 + c * step)), 15).unwrap();
        }
        let sum: f64 = (state.positions.iter().zip(&system.body.reference))
            .map(|(y, rest)| (y.norm() - (rest.norm().powi(3) + c).cbrt()).powi(2))
            .sum();
        (sum / state.positions.len() as f64).sqrt()
    };
    let errors = [1, 2, 4].map(error);
    let orders = [(errors[0] / errors[1]).log2(), (errors[1] / errors[2]).log2()];
    // Quadratic displacements: order 3 at least (nodes of a smooth mesh do better).
    assert!(orders.iter().all(|&o| o > 2.8) && errors[2] < 1e-4, "{errors:?} {orders:?}");
}

#[test]
fn a_thick_bare_tube_is_the_closed_solution_at_mid_length() {
    // r^2 = r_o^2 - (R_o^2 - R^2) / l and P = int (t_theta - t_r) dr / r; the ends push and pull no force:
    // int (2 t_z - t_r - t_theta) r dr = 0 for a closed tube.
    let (ri, wall, mu, alpha) = (4.76e-3, 2.4e-3, 0.393e6, 1.2);
    let tube = Tube {
        wall,
        fiber_ea: 0.0,
        fiber_width: 0.0,
        fibers: 8,
        law: Law::Ogden { mu, alpha },
        ..Tube::reference(0.7)
    };
    let mesh = Mesh { wall: 2, around: 1, first: 1e-3, along_growth: 2.0, largest: 4e-3, ..Mesh::sector(&tube) };
    let mut solid = Solid::new(&tube, 0.1, &mesh, None).unwrap();
    let path = solid.follow(&Tip::straight(Ends::FREE), &[6e4, 1e5], &mut |_| {}).unwrap();
    assert_eq!(path.states.len(), 2);
    for state in path.states {
        let (l, ro, outer) = (state.middle_stretch, state.middle_radius, ri + wall);
        let stresses = |big: f64| {
            let r = (ro * ro - (outer * outer - big * big) / l).sqrt();
            let t = |l: f64| ogden(mu, alpha, l);
            (r, [t(big / (r * l)), t(r / big), t(l)])
        };
        let pressure = integral(ri, outer, |big| {
            let (r, [tr, tt, _]) = stresses(big);
            (tt - tr) * big / (l * r * r)
        });
        assert!((pressure / state.pressure - 1.0).abs() < 2e-3, "{pressure} {}", state.pressure);
        let axial = integral(ri, outer, |big| {
            let (_, [tr, tt, tz]) = stresses(big);
            (2.0 * tz - tr - tt) * big / l
        });
        assert!(axial.abs() < 2e-3 * state.pressure * ri * ri, "{axial}");
        // A bare tube does not turn.
        assert!(state.rotation.abs() < 1e-9);
    }
}

#[test]
fn the_local_bulk_modulus_leaves_the_limit_alone() {
    // The pressure of the sphere at a given volume, with k from 0 to 2 mu: each mesh halving brings all of them nearer
    // to the closed solution, and to each other, by more than second order.
    let (mu, alpha, c) = (1.0, 1.2, 0.8);
    let exact = integral(1.0, 1.5, |big| {
        let l = (big.powi(3) + c).cbrt() / big;
        2.0 * (ogden(mu, alpha, l) - ogden(mu, alpha, 1.0 / (l * l))) / (l * l * l * big)
    });
    let errors = |n: usize| {
        [0.0, 1.0 / 3.0, 2.0 / 3.0, 2.0].map(|k| {
            let mut body = octant(n, Law::Ogden { mu, alpha });
            body.rubber.local_bulk = k * mu;
            let mut system = system(body);
            let mut state = system.body.rest();
            for step in [0.5, 1.0] {
                system.solve(&mut state, &Control::volume(PI / 6.0 * (1.0 + c * step)), 15).unwrap();
            }
            state.gas / exact - 1.0
        })
    };
    let (coarse, fine) = (errors(1), errors(2));
    let spread = |e: [f64; 4]| e.iter().fold(f64::MIN, |m, x| m.max(*x)) - e.iter().fold(f64::MAX, |m, x| m.min(*x));
    assert!(spread(fine) < 0.25 * spread(coarse), "{coarse:?} {fine:?}");
    for (a, b) in coarse.iter().zip(fine) {
        assert!(b.abs() < 0.25 * a.abs() + 1e-4, "{coarse:?} {fine:?}");
    }
}

/// Pressure and external axial force of a bare thick tube at the axial stretch `l` and the outer radius `ro`.
fn bare([ri, outer]: [f64; 2], mu: f64, alpha: f64, l: f64, ro: f64) -> (f64, f64) {
    let stresses = |big: f64| {
        let r = (ro * ro - (outer * outer - big * big) / l).sqrt();
        (r, [big / (r * l), r / big, l].map(|l| ogden(mu, alpha, l)))
    };
    let pressure = integral(ri, outer, |big| {
        let (r, [tr, tt, _]) = stresses(big);
        (tt - tr) * big / (l * r * r)
    });
    let axial = integral(ri, outer, |big| {
        let (_, [tr, tt, tz]) = stresses(big);
        PI * (2.0 * tz - tr - tt) * big / l
    });
    (pressure, axial)
}

#[test]
fn a_thick_bare_tube_passes_the_limit_point_of_the_closed_solution() {
    let (radii, mu, alpha) = ([4.76e-3, 7.16e-3_f64], 0.393e6, 1.2);
    // Without axial force, by bisection over the stretch; then the largest pressure over the radius.
    let pressure = |ro: f64| {
        let (mut low, mut high) = (0.7, 3.0);
        while high - low > 1e-10 {
            let middle = 0.5 * (low + high);
            let inside = radii[1].powi(2) - (radii[1].powi(2) - radii[0].powi(2)) / middle;
            let pulls = inside < 0.0 || bare(radii, mu, alpha, middle, ro).1 > 0.0;
            (low, high) = if pulls { (low, middle) } else { (middle, high) };
        }
        bare(radii, mu, alpha, low, ro).0
    };
    let exact = (0..40).map(|i| pressure(radii[1] * (1.2 + 0.02 * f64::from(i)))).fold(0.0, f64::max);
    let tube = Tube {
        wall: radii[1] - radii[0],
        fiber_ea: 0.0,
        fiber_width: 0.0,
        fibers: 8,
        law: Law::Ogden { mu, alpha },
        ..Tube::reference(0.7)
    };
    let limit = |length: f64| {
        let mesh = Mesh { wall: 2, around: 1, first: 2e-3, along_growth: 2.0, largest: 6e-3, ..Mesh::sector(&tube) };
        let mut solid = Solid::new(&tube, length, &mesh, None).unwrap();
        let path = solid.follow(&Tip::straight(Ends::FREE), &[2.0 * exact], &mut |_| {}).unwrap();
        let PathEnd::Limit(limit) = path.end else { panic!("{:?}", path.end) };
        limit / exact - 1.0
    };
    // The bonded ends hold the tube back: with one over its length squared, since it bulges in a half wave.
    let (short, long) = (limit(0.1), limit(0.2));
    assert!(short > 0.0 && long > 0.0 && long < 0.5 * short && long < 0.01, "{short} {long}");
}

#[test]
fn a_thick_sphere_passes_its_pressure_maximum() {
    // r^3 = R^3 + c; P = int 2 (t_theta - t_r) dr / r. The maximum of P over c is a limit point.
    let (mu, alpha) = (1.0, 1.2);
    let pressure = |c: f64| {
        integral(1.0, 1.5, |big| {
            let l = (big.powi(3) + c).cbrt() / big;
            2.0 * (ogden(mu, alpha, l) - ogden(mu, alpha, 1.0 / (l * l))) / (l * l * l * big)
        })
    };
    let mut system = system(octant(2, Law::Ogden { mu, alpha }));
    let mut state = system.body.rest();
    let peak = (1..400).map(|i| 0.05 * f64::from(i)).max_by(|a, b| pressure(*a).total_cmp(&pressure(*b))).unwrap();
    for c in [0.3, 0.8, 1.5, 2.5, 3.5, 5.0, 7.0, 9.0, 12.0, 16.0] {
        let volume = PI / 6.0 * (1.0 + c);
        system.solve(&mut state, &Control::volume(volume), 15).unwrap();
        assert!((state.gas / pressure(c) - 1.0).abs() < 4e-3, "{c}: {} {}", state.gas, pressure(c));
        // One negative pivot beyond the maximum, none before.
        if (c - peak).abs() > 0.2 * peak {
            assert_eq!(system.negative(), usize::from(c > peak), "{c} {peak}");
        }
    }
    assert!((1.0..12.0).contains(&peak), "the sweep must pass the maximum: {peak}");
}

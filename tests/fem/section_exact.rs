//! The section against closed solutions: Rivlin's inflation, extension and torsion, the thick Ogden tube and its limit
//! point, fibres smeared into a layer; and what equilibria must satisfy whatever the solution is.

use std::f64::consts::PI;

use freerig::fem::ends::{End, Ends};
use freerig::fem::material::Law;
use freerig::fem::section::{LimitKind, Mesh, Section, SectionError};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector3;

/// Composite Gauss quadrature, 3 points on each of 400 intervals: exact to round-off for these smooth integrands.
fn integral(a: f64, b: f64, f: impl Fn(f64) -> f64) -> f64 {
    let h = (b - a) / 400.0;
    let x = 0.6_f64.sqrt();
    (0..400)
        .map(|k| {
            let middle = a + (k as f64 + 0.5) * h;
            let at = |s: f64| f(middle + 0.5 * h * s);
            h / 18.0 * (5.0 * at(-x) + 8.0 * at(0.0) + 5.0 * at(x))
        })
        .sum()
}

/// Root of a monotone function by bisection.
fn root(mut a: f64, mut b: f64, f: impl Fn(f64) -> f64) -> f64 {
    let rising = f(b) > 0.0;
    for _ in 0..200 {
        let middle = 0.5 * (a + b);
        if (f(middle) > 0.0) == rising { b = middle } else { a = middle }
    }
    0.5 * (a + b)
}

fn held(stretch: f64, twist: f64) -> Ends {
    Ends { axial: End::Held(stretch), torsion: End::Held(twist) }
}

#[test]
fn rivlins_tube_is_solved() {
    // Neo-Hookean, no fibres: r^2 = (R^2 + c) / lam; Cauchy stresses from B alone.
    let (mu, stretch, twist, pressure) = (4e5, 1.15, 60.0, 4e4);
    for (wall, gamma) in [(0.8e-3, 0.7), (4.2e-3, -1.2)] {
        let tube = Tube { wall, gamma, fiber_ea: 0.0, law: Law::NeoHookean { mu }, ..Tube::reference(gamma) };
        let (ri, ro) = (tube.inner_radius, tube.outer_radius());
        let radius = |c: f64, reference: f64| ((reference * reference + c) / stretch).sqrt();
        let reference = |c: f64, r: f64| (stretch * r * r - c).sqrt();
        let hoop_less_radial = |c: f64, r: f64| {
            let big = reference(c, r);
            mu * ((r / big).powi(2) + (twist * r).powi(2) - (big / (stretch * r)).powi(2))
        };
        let c = root(-0.5 * ri * ri, 3.0 * ri * ri, |c| {
            integral(radius(c, ri), radius(c, ro), |r| hoop_less_radial(c, r) / r) - pressure
        });
        let (inner, outer) = (radius(c, ri), radius(c, ro));
        let radial = |r: f64| -integral(r, outer, |s| hoop_less_radial(c, s) / s);
        let axial = |r: f64| radial(r) + mu * (stretch * stretch - (reference(c, r) / (stretch * r)).powi(2));
        let force = 2.0 * PI * integral(inner, outer, |r| axial(r) * r) - PI * inner * inner * pressure;
        let moment = 2.0 * PI * integral(inner, outer, |r| mu * twist * stretch * r.powi(3));

        let mesh = Mesh::Counted { radial: 4, strip: 1, gap: 1, growth: 1.0 };
        let found = Section::new(&tube, mesh).unwrap().solve(pressure, held(stretch, twist)).unwrap();
        // Resultants of quadratic elements converge with order 4: 4 through the wall leave 1e-5 of a thick one.
        let tolerance = if wall > 1e-3 { 3e-5 } else { 1e-6 };
        assert!((found.outer_radius_mean / outer - 1.0).abs() < tolerance);
        assert!((found.force / -force - 1.0).abs() < 10.0 * tolerance, "{} {}", found.force, -force);
        assert!((found.moment / -moment - 1.0).abs() < 10.0 * tolerance, "{} {}", found.moment, -moment);
        assert!((found.volume / (PI * inner * inner * stretch) - 1.0).abs() < 3.0 * tolerance);
    }
}

#[test]
fn the_thick_ogden_tube_has_its_limit_point() {
    // Plane strain (stretch 1), alpha 1.2: P(r_i) = int 2 mu / alpha (l^alpha - l^-alpha) / r dr, l = r / R.
    let (mu, alpha) = (0.393e6, 1.2);
    let tube = Tube { fiber_ea: 0.0, wall: 2e-3, ..Tube::reference(0.7) };
    let (ri, ro) = (tube.inner_radius, tube.outer_radius());
    let pressure = |c: f64| {
        let outer = (ro * ro + c).sqrt();
        integral((ri * ri + c).sqrt(), outer, |r| {
            let hoop = r / (r * r - c).sqrt();
            2.0 * mu / alpha * (hoop.powf(alpha) - hoop.powf(-alpha)) / r
        })
    };
    // Golden section for the maximum.
    let (mut a, mut b) = (0.0, 20.0 * ri * ri);
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..80 {
        let (x, y) = (b - ratio * (b - a), a + ratio * (b - a));
        if pressure(x) < pressure(y) { a = x } else { b = y }
    }
    let maximum = pressure(a);
    let section = Section::new(&tube, Mesh::Counted { radial: 4, strip: 1, gap: 1, growth: 1.0 }).unwrap();
    let limit = section.limit_pressure(held(1.0, 0.0), 2.0 * maximum).unwrap().unwrap();
    assert_eq!(limit.kind, LimitKind::Pressure);
    assert!((limit.pressure / maximum - 1.0).abs() < 1e-4, "{} for {maximum}", limit.pressure);
    // Below it the closed solution, beyond it the named refusal.
    let below = section.solve(0.9 * maximum, held(1.0, 0.0)).unwrap();
    let c = root(0.0, a, |c| pressure(c) - 0.9 * maximum);
    assert!((below.outer_radius_mean / (ro * ro + c).sqrt() - 1.0).abs() < 2e-5);
    let beyond = section.solve(1.01 * maximum, held(1.0, 0.0)).unwrap_err();
    assert!(matches!(beyond, SectionError::BeyondLimit { .. }), "{beyond}");
}

#[test]
fn smeared_fibres_solve_the_exact_problem_in_the_radius() {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/reference/section_smeared.csv"));
    let text = text.unwrap();
    for degrees in [30.0_f64, 60.0] {
        let section = Section::smeared(&Tube::reference(degrees.to_radians()), 2).unwrap();
        let (mut free, mut blocked) = (section.rest().unwrap(), section.rest().unwrap());
        let mut compared = 0;
        for line in text.lines().skip(1) {
            let row: Vec<f64> = line.split(',').map(|field| field.parse().unwrap_or(f64::NAN)).collect();
            let &[_, angle, pressure, twist, stretch, radius, force, moment] = &row[..] else { panic!("{line}") };
            if angle != degrees {
                continue;
            }
            let near = |got: f64, want: f64, absolute: f64| (got - want).abs() <= (1e-3 * want.abs()).max(absolute);
            match section.advance(&mut free, pressure * PSI, Ends::FREE) {
                Ok(point) => {
                    assert!(near(point.twist * 1e-3, twist, 1e-10), "{line}: {}", point.twist);
                    assert!(near(point.stretch - 1.0, stretch - 1.0, 1e-8), "{line}: {}", point.stretch);
                    assert!(near(point.outer_radius_mean * 1e3, radius, 0.0), "{line}");
                }
                Err(error) => assert!(twist.is_nan(), "{line}: {error}"),
            }
            let point = section.advance(&mut blocked, pressure * PSI, Ends::BLOCKED).unwrap();
            assert!(near(point.force, force, 1e-6) && near(point.moment * 1e3, moment, 1e-6), "{line}: {point:?}");
            compared += 1;
        }
        assert_eq!(compared, 11, "0 to 10 psi at {degrees} deg");
    }
}

#[test]
fn the_tangent_is_the_derivative_along_equilibria() {
    let section = Section::new(&Tube::reference(0.7), Mesh::default()).unwrap();
    let base = [1.02, -8.0, 2.5e4];
    let at = |x: [f64; 3]| {
        let mut state = section.rest().unwrap();
        section.advance(&mut state, base[2], held(base[0], base[1])).unwrap();
        let found = section.advance(&mut state, x[2], held(x[0], x[1])).unwrap();
        (Vector3::new(-found.force, -found.moment, -found.volume), found.tangent, section.potential(&state))
    };
    let (_, tangent, _) = at(base);
    assert_eq!(tangent, tangent.transpose());
    for (k, h) in [(0, 1e-4), (1, 0.05), (2, 20.0)] {
        let moved = |s: f64| {
            let mut x = base;
            x[k] += s * h;
            at(x)
        };
        let (plus, minus) = (moved(1.0), moved(-1.0));
        let difference = (plus.0 - minus.0) / (2.0 * h);
        for i in 0..3 {
            // Central differences: h^2 of the strain's curvature, and the solver's 1e-9 over h.
            let scale = (tangent[(i, i)] * tangent[(k, k)]).abs().sqrt();
            assert!(
                (difference[i] - tangent[(i, k)]).abs() < 2e-5 * scale,
                "{i} {k}: {} {}",
                difference[i],
                tangent[(i, k)]
            );
        }
        // The potential's own derivatives are the resultants.
        let slope = (plus.2 - minus.2) / (2.0 * h);
        let middle = (plus.0 + minus.0)[k] / 2.0;
        assert!((slope - middle).abs() < 1e-5 * middle.abs(), "{k}: {slope} {middle}");
    }
}

#[test]
fn a_closed_cycle_of_stretch_twist_and_pressure_does_no_work() {
    let section = Section::new(&Tube::reference(-1.0), Mesh::default()).unwrap();
    let mut state = section.rest().unwrap();
    let corners = [[1.0, 0.0, 0.0], [1.05, 4.0, 1e4], [1.02, 12.0, 3e4], [0.98, 3.0, 2e4], [1.0, 0.0, 0.0]];
    let start = section.potential(&state);
    let (mut work, mut gross) = (0.0, 0.0);
    for pair in corners.windows(2) {
        // Three Gauss points an interval, eight intervals an edge.
        for interval in 0..8 {
            for (x, weight) in [(-0.6_f64.sqrt(), 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.6_f64.sqrt(), 5.0 / 18.0)] {
                let part = (interval as f64 + 0.5 + 0.5 * x) / 8.0;
                let at: [f64; 3] = std::array::from_fn(|k| pair[0][k] + part * (pair[1][k] - pair[0][k]));
                let found = section.advance(&mut state, at[2], held(at[0], at[1])).unwrap();
                let rate = [-found.force, -found.moment, -found.volume];
                let power: f64 = (0..3).map(|k| rate[k] * (pair[1][k] - pair[0][k])).sum();
                work += weight / 8.0 * power;
                gross += weight / 8.0 * power.abs();
            }
        }
    }
    section.advance(&mut state, 0.0, Ends::BLOCKED).unwrap();
    assert!(work.abs() < 1e-7 * gross, "{work} of {gross}");
    assert!((section.potential(&state) - start).abs() < 1e-9 * gross);
}

#[test]
fn left_and_right_tubes_are_mirror_images() {
    for ends in [Ends::FREE, Ends::BLOCKED] {
        let points = [0.9, -0.9].map(|gamma| {
            let section = Section::new(&Tube::reference(gamma), Mesh::default()).unwrap();
            let mut state = section.rest().unwrap();
            let found = section.advance(&mut state, 3e4, ends).unwrap();
            (found, section.bending(&state).unwrap())
        });
        let ((right, bend_right), (left, bend_left)) = (points[0], points[1]);
        // Round-off, magnified by the condition of the penalised matrix.
        let same = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-9 * scale;
        assert!(same(right.twist, -left.twist, 30.0) && same(right.stretch, left.stretch, 1.0), "{right:?} {left:?}");
        assert!(same(right.force, left.force, 3.0) && same(right.moment, -left.moment, 0.03));
        assert!(same(right.outer_radius_at_fiber, left.outer_radius_at_fiber, 6e-3));
        assert!(same(bend_right.bending, bend_left.bending, 1e-3));
        assert!(same(bend_right.coupling, -bend_left.coupling, 1e-1));
    }
}

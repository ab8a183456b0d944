//! Tangents of the solid, each alone: the Taylor remainder of its force falls with slope two over decades of the step.

use freerig::fem::material::Law;
use freerig::fem::solid::cap::{COORDINATES, TILT, Tilt};
use freerig::fem::solid::element::{Contribution, Kernel, Place, Positions, Rubber, SIZE, TWIST};
use freerig::fem::solid::fiber::{self, Fiber, THREADS};
use freerig::fem::solid::surface;
use nalgebra::{SMatrix, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A distorted, deformed element of a turning frame.
struct Element {
    reference: Positions,
    current: Positions,
    phases: [f64; 27],
    rate: f64,
}

impl Element {
    fn random(seed: u64) -> Element {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut near = |v: Vector3<f64>, size: f64| v + Vector3::from_fn(|_, _| rng.random_range(-size..size));
        let corner =
            |n: usize| Vector3::new(1.0 + 0.1 * (n % 3) as f64, 0.1 * (n / 3 % 3) as f64, 0.2 * (n / 9) as f64);
        let reference: Positions = std::array::from_fn(|n| near(corner(n), 0.005));
        let current = reference.map(|v| near(v * 1.1, 0.01));
        Element { reference, current, phases: std::array::from_fn(|n| 0.05 * (n / 3 % 3) as f64), rate: 0.9 }
    }

    /// Moved by `h` times a change of the nodes and the rate.
    fn moved(&self, change: &[f64; SIZE], h: f64) -> Element {
        let current = std::array::from_fn(|n| self.current[n] + Vector3::from_row_slice(&change[3 * n..3 * n + 3]) * h);
        Element { current, rate: self.rate + h * change[TWIST], ..*self }
    }

    fn place(&self) -> Place<'_> {
        let Element { reference, current, phases, rate } = self;
        Place { reference, current, phases, reference_rate: 0.5, rate: *rate }
    }
}

/// Checks the slope of the remainder |f(h) - f(0) - h K d| over steps of 1e-1 to 1e-5 of the element's size.
fn check(name: &str, add: impl Fn(&Element, bool, &mut Contribution)) {
    for seed in 0..3 {
        let element = Element::random(seed);
        let mut rng = Pcg64Mcg::seed_from_u64(100 + seed);
        let change: [f64; SIZE] = std::array::from_fn(|_| rng.random_range(-0.1..0.1));
        let mut here = Contribution::zero();
        add(&element, true, &mut here);
        let product = |r: usize| (0..SIZE).map(|c| here.matrix[c * SIZE + r] * change[c]).sum::<f64>();
        let slope: Vec<f64> = (0..SIZE).map(product).collect();
        let remainders: Vec<f64> = (1..=5)
            .map(|decade| {
                let h = 10f64.powi(-decade);
                let mut there = Contribution::zero();
                add(&element.moved(&change, h), false, &mut there);
                let rest = |r: usize| (there.force[r] - here.force[r] - h * slope[r]).powi(2);
                (0..SIZE).map(rest).sum::<f64>().sqrt()
            })
            .collect();
        for (decade, pair) in (1..).zip(remainders.windows(2)) {
            // The cubic term is of the order of the step beside the square one, and moves the slope by as much; the
            // last remainder is at 1e-10 of the force, above rounding.
            let order = (pair[0] / pair[1]).log10();
            let bound = 2.0 * 10f64.powi(-decade) + 2e-3;
            assert!((order - 2.0).abs() < bound, "{name}, seed {seed}: {order} {remainders:?}");
        }
    }
}

#[test]
fn the_rubbers_tangent_is_exact_for_every_law() {
    let laws = [Law::Ogden { mu: 1.0, alpha: 1.2 }, Law::Ogden { mu: 1.0, alpha: -2.0 }, Law::NeoHookean { mu: 1.0 }];
    for law in laws {
        let rubber = Rubber::new(law, None);
        check(&format!("{law:?}"), |element, tangent, out| {
            let pressure = [0.3, -0.1, 0.2, 0.05];
            Kernel::default().solid(&element.place(), &pressure, &rubber, tangent, out).unwrap();
        });
    }
}

#[test]
fn the_follower_pressures_tangent_is_exact_and_symmetric() {
    check("gas", |element, tangent, out| surface::add(&element.place(), 0.7, tangent, out));
    let mut out = Contribution::zero();
    surface::add(&Element::random(1).place(), 0.7, true, &mut out);
    for c in 0..SIZE {
        for r in 0..c {
            assert_eq!(out.matrix[c * SIZE + r], out.matrix[r * SIZE + c]);
        }
    }
}

#[test]
fn a_fibres_tangent_is_exact_as_a_line_and_as_a_strip() {
    for fiber in [Fiber::Line, Fiber::Strip(0.7)] {
        let ea = 50.0;
        // With the tensions of the stretch: they move with it.
        check(&format!("{fiber:?}"), |element, tangent, out| {
            let tensions = fiber::tighten(&element.place(), fiber, ea, Some(&[0.0; THREADS]), &[0.0; SIZE]);
            fiber::add(&element.place(), fiber, ea, &tensions, tangent, out);
            assert!(out.slack < 1e-12);
        });
    }
}

#[test]
fn the_change_of_a_tension_is_its_derivative() {
    let element = Element::random(5);
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    let change: [f64; SIZE] = std::array::from_fn(|_| rng.random_range(-0.1..0.1));
    let (fiber, ea, none) = (Fiber::Strip(0.7), 50.0, [0.0; SIZE]);
    let at = |h: f64| fiber::tighten(&element.moved(&change, h).place(), fiber, ea, Some(&[0.0; THREADS]), &none);
    let slope = fiber::tighten(&element.place(), fiber, ea, None, &change);
    let remainder = |h: f64| {
        let (there, here) = (at(h), at(0.0));
        (0..THREADS).map(|i| (there[i] - here[i] - h * slope[i]).powi(2)).sum::<f64>().sqrt()
    };
    for decade in 1..4 {
        let order = (remainder(10f64.powi(-decade)) / remainder(10f64.powi(-decade - 1))).log10();
        assert!((order - 2.0).abs() < 0.1, "{decade}: {order}");
    }
}

#[test]
fn the_rigid_caps_tangent_is_exact_at_a_finite_rotation() {
    // A force on a node at `arm` of a cap that has tilted by 2 rad: first and second derivatives of its work.
    let (arm, force) = (Vector3::new(0.6, -0.8, 0.3), Vector3::new(0.4, 0.9, -1.1));
    let here = [0.0, 0.2, 0.1, -0.3, 1.6, -1.2];
    let change: [f64; COORDINATES] = [0.0, 0.3, -0.4, 0.5, 0.6, -0.7];
    let moved = |h: f64| -> [f64; COORDINATES] { std::array::from_fn(|q| here[q] + h * change[q]) };
    let by = SMatrix::<f64, COORDINATES, 1>::from(change);
    let tilt = Tilt::of(&here);
    let mut second = SMatrix::<f64, COORDINATES, COORDINATES>::zeros();
    for i in 0..2 {
        for j in 0..2 {
            second[(TILT[i], TILT[j])] = force.dot(&(tilt.second[i][j] * arm));
        }
    }
    let remainders = |h: f64| {
        let there = Tilt::of(&moved(h));
        let shift = Tilt::displacement(&moved(h)) - Tilt::displacement(&here);
        let position = shift + (there.rotation - tilt.rotation) * arm - tilt.slope(&arm) * by * h;
        let work = (there.slope(&arm) - tilt.slope(&arm)).tr_mul(&force) - second * by * h;
        [position.norm(), work.norm()]
    };
    for decade in 1..5 {
        let (large, small) = (remainders(10f64.powi(-decade)), remainders(10f64.powi(-decade - 1)));
        for i in 0..2 {
            let order = (large[i] / small[i]).log10();
            assert!((order - 2.0).abs() < 0.1, "{i} {decade}: {order}");
        }
    }
}

//! Rods under a plate against tasks with converged answers (units there: N, mm, rad; here SI).

use freerig::fem::module::{Loads, Module, Mount};
use freerig::fem::rod::{Law, Quadratic, Resolution, Rod, Straight};
use nalgebra::{Vector3};

const MM: f64 = 1e-3;
const LENGTH: f64 = 130.0 * MM;

/// The tasks' section, whose spontaneous strains are those at "pressure" 1.
fn law(extension: f64, twist_per_mm: f64) -> Law {
    Law {
        straight: Straight::spontaneous(30.606, 273.264e-6, extension, twist_per_mm / MM),
        bending: Quadratic::constant(409.895e-6),
        shear: Quadratic::constant(5.4070),
        coupling: Quadratic::constant(0.0),
        mirrored: false,
    }
}

fn mount(x: f64, y: f64, law: Law) -> Mount {
    Mount { base: Vector3::new(x, y, 0.0) * MM, rod: Rod { length: LENGTH, law, outer_radius: 0.0 } }
}

fn single(resolution: Resolution) -> Module {
    Module::new(vec![mount(0.0, 0.0, law(0.0, 0.0))], 0.0, resolution).unwrap()
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

fn r1() -> Loads {
    Loads { force: Vector3::new(0.015, 0.008, -0.010), moment: Vector3::new(-0.6, 2.2, 0.4) * MM, ..Loads::pressures([0.0]) }
}

fn r2(fz: f64) -> Loads {
    Loads { force: Vector3::new(0.0, 0.0, fz), ..Loads::pressures([1.0; 4]) }
}

#[test]
fn r1_look() {
    for degree in 1..8 {
        for steps in [2, 3, 4, 6, 8, 16, 32] {
            if degree >= 2 * steps { continue; }
            let m = single(Resolution { degree, steps });
            let s = m.equilibrium(&r1()).unwrap();
            let e = (s.position() / MM - Vector3::new(65.88336991, 28.14646053, 100.65456905)).norm() / 130.0;
            let t = std::time::Instant::now();
            for _ in 0..100 { std::hint::black_box(m.equilibrium(&r1()).unwrap()); }
            println!("{degree} {steps} {:.3e} it {} neg {} {:?}", e, s.iterations(), s.negative_pivots(), t.elapsed()/100);
        }
    }
}

#[test]
fn r2_look() {
    for (degree, steps) in [(2,2), (2,3),(3,3), (3,4), (4,4), (5,8), (7,16), (9,32)] {
            let m = four(Resolution { degree, steps });
            let s = m.equilibrium(&r2(-0.2)).unwrap();
            let e = (s.position() / MM - Vector3::new(19.68336597, -11.19964926, 130.75976188)).norm() / 130.0;
            let t = std::time::Instant::now();
            for _ in 0..100 { std::hint::black_box(m.equilibrium(&r2(-0.2)).unwrap()); }
            println!("{degree} {steps} {:.3e} it {} neg {} {:?} est {:?} {:?}", e, s.iterations(), s.negative_pivots(), t.elapsed()/100, m.discretisation_error(&s), s.rotation());
    }
}
#[test]
fn speed_look() {
    let best = |f: &dyn Fn() -> usize| {
        let mut best = f64::INFINITY;
        let mut it = 0;
        for _ in 0..4000 {
            let t = std::time::Instant::now();
            it = std::hint::black_box(f());
            best = best.min(t.elapsed().as_secs_f64());
        }
        (best * 1e6, it)
    };
    for (degree, steps) in [(1, 2), (2, 2), (2, 3), (3, 4), (5, 8)] {
        let (m, l) = (single(Resolution { degree, steps }), r1());
        let (f, l2) = (four(Resolution { degree, steps }), r2(-0.2));
        println!("{degree} {steps} R1 {:?} us R2 {:?} us", best(&|| m.equilibrium(&l).unwrap().iterations()), best(&|| f.equilibrium(&l2).unwrap().iterations()));
        let s = f.equilibrium(&l2).unwrap();
        let l3 = r2(-0.201);
        println!("   warm {:?}", best(&|| f.equilibrium_from(&s, &l3).unwrap().iterations()));
    }
}
#[test]
fn r3_look() {
    use freerig::fem::module::Path;
    for (degree, steps) in [(3, 4), (5, 8), (7, 16), (9, 32)] {
        let m = four(Resolution { degree, steps });
        let start = m.equilibrium(&r2(0.0)).unwrap();
        let t = std::time::Instant::now();
        let mut path = Path::new(&m, &start, &r2(-1.0), 0.2).unwrap();
        for _ in 0..6 {
            match path.next_critical((-0.1, 4.0)) {
                Ok(Some(c)) => println!("{degree} {steps} mu {:.6} {:?} gained {} at {:.3?} modes {}", c.mu, c.kind, c.gained, c.point.state.position() / MM, c.modes.len()),
                Ok(None) => { println!("end {} {:?}", path.point().mu, path.point().state.position() / MM); break }
                Err(e) => { println!("{e} at {}", path.point().mu); break }
            }
        }
        println!("{:?}", t.elapsed());
        for fz in [-0.3] {
            let s = m.equilibrium(&r2(fz)).unwrap();
            println!("{:.3?}", s.position() / MM);
        }
        println!("{:?}", m.equilibrium(&r2(-0.45)).unwrap_err().to_string());
        for fz in [-0.5135, -3.0] {
            match m.equilibrium_from(&path.point().state, &r2(fz)) {
            Ok(s) => println!("{fz} {:.4?} neg {}", s.position() / MM, s.negative_pivots()), Err(e) => println!("{e}") }
        }
    }
}

//! Fibres on the outer face of an element, along its third coordinate.
//!
//! A line is a truss on the edge j = 0; a strip spreads the same stiffness over the face. With the tangent
//! `g = y_t + omega Z_t e_z x y` and its length at rest g0, the stretch of each thread is |g| / g0, and
//! `Pi = EA/2 int (|g|/g0 - 1)^2 g0 dt`, in tension and compression alike.

use nalgebra::{Matrix3, Vector3};

use super::element::{Contribution, Place, TWIST, across, across_back};
use super::shapes::{GAUSS, line};

/// The fibre of an element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fiber {
    /// None.
    None,
    /// A truss on the outer edge j = 0.
    Line,
    /// The whole outer face carries this share of a fibre, 0 to 1.
    Strip(f64),
}

/// Adds a fibre of stiffness `ea` to `out`.
pub fn add(place: &Place, fiber: Fiber, ea: f64, tangent: bool, out: &mut Contribution) {
    match fiber {
        Fiber::None => {}
        Fiber::Line => thread(place, -1.0, ea, tangent, out),
        Fiber::Strip(share) => {
            for (s, weight) in GAUSS {
                thread(place, s, 0.5 * weight * share * ea, tangent, out);
            }
        }
    }
}

/// One thread of stiffness `ea` at the coordinate `s` of the outer face.
fn thread(place: &Place, s: f64, ea: f64, tangent: bool, out: &mut Contribution) {
    let (a, _) = line(s);
    for (t, wt) in GAUSS {
        let (b, db) = line(t);
        let shapes: [(usize, f64, f64); 9] = std::array::from_fn(|c| {
            let (j, k) = (c % 3, c / 3);
            (2 + 3 * j + 9 * k, a[j] * b[k], a[j] * db[k])
        });
        let (mut y, mut g, mut rest, mut rest_y) =
            (Vector3::zeros(), Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for &(n, value, dt) in &shapes {
            y += place.current[n] * value;
            g += place.current[n] * dt;
            rest_y += place.reference[n] * value;
            rest += place.reference[n] * dt;
        }
        let rise = rest.z;
        rest += across(&rest_y) * (place.reference_rate * rise);
        let turn = across(&y) * rise;
        g += turn * place.rate;
        let (length, rest) = (g.norm(), rest.norm());
        let (direction, strain) = (g / length, length / rest - 1.0);
        let ea = ea * wt;
        out.energy += 0.5 * ea * strain * strain * rest;
        let q = direction * (ea * strain);
        let by_rate = across_back(&q) * rise;
        for &(n, value, dt) in &shapes {
            let force = q * dt + by_rate * (place.rate * value);
            for i in 0..3 {
                out.force[3 * n + i] += force[i];
            }
        }
        out.force[TWIST] += q.dot(&turn);
        if !tangent {
            continue;
        }
        let along = direction * direction.transpose();
        let second = (along / rest + (Matrix3::identity() - along) * (strain / length)) * ea;
        let mut columns = [Vector3::zeros(); 28];
        let mut rows = [TWIST; 28];
        for (c, &(n, value, dt)) in shapes.iter().enumerate() {
            for i in 0..3 {
                let mut unit = Vector3::zeros();
                unit[i] = 1.0;
                columns[3 * c + i] = unit * dt + across(&unit) * (value * place.rate * rise);
                rows[3 * c + i] = 3 * n + i;
            }
        }
        columns[27] = turn;
        for c in 0..28 {
            let product = second * columns[c];
            for r in 0..=c {
                out.add_symmetric(rows[r], rows[c], columns[r].dot(&product));
            }
        }
        for &(n, value, _) in &shapes {
            for i in 0..2 {
                out.add_symmetric(3 * n + i, TWIST, by_rate[i] * value);
            }
        }
    }
}

//! Fibres on the outer face of an element, along its third coordinate.
//!
//! A line is a truss on the edge j = 0; a strip spreads the same stiffness over the face. With the tangent
//! `g = y_t + (psi_t + omega Z_t) e_z x y` and its length at rest g0, the stretch of each thread is |g| / g0, and
//! `Pi = EA/2 int (|g|/g0 - 1)^2 g0 dt`, in tension and compression alike.
//!
//! Fibres are so stiff that the tension of a state in the middle of an iteration says nothing: it is that of the
//! stretching that a correction makes by turning an element. So the tension T at each point is an unknown too, `Pi =
//! int (T (|g|/g0 - 1) - T^2 / (2 EA)) g0 dt`, and moves with the linearised stretch, as the pressures in the rubber do
//! with the volume. It is eliminated point by point: the matrix is that of displacements, with T in it in place of what
//! the stretch says. What is converged is the same; far bending takes a few iterations instead of not converging at all
//! (mixed integration points: Magisano, Leonetti and Garcea, IJNME 2017).

use nalgebra::{Matrix3, Vector3};

use super::element::{Contribution, Place, SIZE, TWIST, across, across_back};
use super::shapes::{GAUSS, line};

/// Points of an element's fibre, at most: three along each of three threads.
pub const THREADS: usize = 9;

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

impl Fiber {
    /// The points: coordinates s and t of the outer face, and the weight.
    fn points(self) -> impl Iterator<Item = (f64, f64, f64)> {
        let threads = match self {
            Fiber::None => [None; 3],
            Fiber::Line => [Some((-1.0, 1.0)), None, None],
            Fiber::Strip(share) => GAUSS.map(|(s, weight)| Some((s, 0.5 * weight * share))),
        };
        let along = |(s, weight): (f64, f64)| GAUSS.map(|(t, wt)| (s, t, weight * wt));
        threads.into_iter().flatten().flat_map(along)
    }
}

/// A point of a thread.
struct Point {
    /// Nodes with the values and slopes of their functions.
    shapes: [(usize, f64, f64); 9],
    /// Direction and length of g, length at rest.
    direction: Vector3<f64>,
    length: f64,
    rest: f64,
    /// psi_t + omega Z_t.
    turned: f64,
    /// Z_t, and dg / domega.
    rise: f64,
    turn: Vector3<f64>,
}

impl Point {
    fn at(place: &Place, s: f64, t: f64) -> Point {
        let ((a, _), (b, db)) = (line(s), line(t));
        let shapes: [(usize, f64, f64); 9] = std::array::from_fn(|c| {
            let (j, k) = (c % 3, c / 3);
            (2 + 3 * j + 9 * k, a[j] * b[k], a[j] * db[k])
        });
        let (mut y, mut g, mut rest, mut rest_y) =
            (Vector3::zeros(), Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        let mut phase = 0.0;
        for &(n, value, dt) in &shapes {
            y += place.current[n] * value;
            g += place.current[n] * dt;
            rest_y += place.reference[n] * value;
            rest += place.reference[n] * dt;
            phase += place.phases[n] * dt;
        }
        let rise = rest.z;
        rest += across(&rest_y) * (phase + place.reference_rate * rise);
        let turned = phase + place.rate * rise;
        g += across(&y) * turned;
        let length = g.norm();
        Point { shapes, direction: g / length, length, rest: rest.norm(), turned, rise, turn: across(&y) * rise }
    }

    /// Adds the derivatives of `factor` |g|.
    fn add_force(&self, factor: f64, force: &mut [f64; SIZE]) {
        let q = self.direction * factor;
        let at_value = across_back(&q) * self.turned;
        for &(n, value, dt) in &self.shapes {
            let of = q * dt + at_value * value;
            for i in 0..3 {
                force[3 * n + i] += of[i];
            }
        }
        force[TWIST] += q.dot(&self.turn);
    }

    fn strain(&self) -> f64 {
        self.length / self.rest - 1.0
    }
}

/// Adds a fibre of stiffness `ea` with these tensions to `out`.
pub fn add(place: &Place, fiber: Fiber, ea: f64, tensions: &[f64; THREADS], tangent: bool, out: &mut Contribution) {
    if ea == 0.0 {
        return;
    }
    for ((s, t, weight), &tension) in fiber.points().zip(tensions) {
        let point = Point::at(place, s, t);
        let strain = point.strain();
        let slack = ea * strain - tension;
        out.slack = out.slack.max(slack.abs());
        out.energy += weight * tension * (strain - 0.5 * tension / ea) * point.rest;
        point.add_force(weight * tension, &mut out.force);
        point.add_force(weight * slack, &mut out.taken_up);
        if tangent {
            stiffen(&point, weight * ea, weight * tension, out);
        }
    }
}

/// Adds the second derivatives of a point.
fn stiffen(point: &Point, ea: f64, tension: f64, out: &mut Contribution) {
    let along = point.direction * point.direction.transpose();
    let second = along * (ea / point.rest) + (Matrix3::identity() - along) * (tension / point.length);
    let mut columns = [Vector3::zeros(); 28];
    let mut rows = [TWIST; 28];
    for (c, &(n, value, dt)) in point.shapes.iter().enumerate() {
        for i in 0..3 {
            let mut unit = Vector3::zeros();
            unit[i] = 1.0;
            columns[3 * c + i] = unit * dt + across(&unit) * (value * point.turned);
            rows[3 * c + i] = 3 * n + i;
        }
    }
    columns[27] = point.turn;
    for c in 0..28 {
        let product = second * columns[c];
        for r in 0..=c {
            out.add_symmetric(rows[r], rows[c], columns[r].dot(&product));
        }
    }
    let by_rate = across_back(&(point.direction * tension)) * point.rise;
    for &(n, value, _) in &point.shapes {
        for i in 0..2 {
            out.add_symmetric(3 * n + i, TWIST, by_rate[i] * value);
        }
    }
}

/// Changes of the tensions that go with the `change` of the element's rows; with the tensions `now` also what brings
/// them to what the stretch says.
pub fn tighten(
    place: &Place,
    fiber: Fiber,
    ea: f64,
    now: Option<&[f64; THREADS]>,
    change: &[f64; SIZE],
) -> [f64; THREADS] {
    let mut tensions = [0.0; THREADS];
    for (index, ((s, t, _), tension)) in fiber.points().zip(&mut tensions).enumerate() {
        let point = Point::at(place, s, t);
        let mut slope = [0.0; SIZE];
        point.add_force(ea / point.rest, &mut slope);
        *tension = slope.iter().zip(change).map(|(s, c)| s * c).sum();
        if let Some(now) = now {
            *tension += ea * point.strain() - now[index];
        }
    }
    tensions
}

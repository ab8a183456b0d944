//! The least distance between the surfaces of two rods.
//!
//! Centre lines are cubic Hermite curves through the ends of the Magnus steps, whose directions are known; the nearest
//! pair of their chords is where a Gauss-Newton search on the curves begins. Radii are those of the tubes as they are,
//! swollen by the pressure: the wall keeps its volume about the cavity, whose cross-section the law knows.

use std::f64::consts::PI;

use nalgebra::{Matrix2, Vector2, Vector3};

use super::newton::Solver;
use super::state::Unknowns;
use super::{Module, ModuleError};
use crate::fem::rod::{Assembly, Basis, Rod};

/// Corrections of the nearest pair; it is found to micrometres in two or three.
const SEARCHES: usize = 8;

/// A tube's centre line: positions, directions (by the parameter from node to node) and the tube's radius at the nodes.
pub(crate) struct Centreline {
    points: Vec<Vector3<f64>>,
    slopes: Vec<Vector3<f64>>,
    radii: Vec<f64>,
}

impl Centreline {
    /// Through points, whose neighbours give the directions.
    pub(crate) fn through(points: Vec<Vector3<f64>>, radii: Vec<f64>) -> Centreline {
        let last = points.len() - 1;
        let slope = |k: usize| match k {
            0 => points[1] - points[0],
            k if k == last => points[k] - points[k - 1],
            k => (points[k + 1] - points[k - 1]) * 0.5,
        };
        Centreline { slopes: (0..=last).map(slope).collect(), points, radii }
    }

    /// Of a rod whose cavity has the cross-section `bore` at rest, m2.
    fn new(assembly: &Assembly, basis: &Basis, strains: &[f64], rod: &Rod, bore: f64) -> Centreline {
        let step = rod.length / basis.steps as f64;
        let of = |[volume, stretch]: &[f64; 2]| {
            ((rod.outer_radius.powi(2) + (volume - bore) / PI) / stretch).max(0.0).sqrt()
        };
        let within: Vec<f64> =
            assembly.cavity.chunks_exact(2).map(|pair| 0.5 * (of(&pair[0]) + of(&pair[1]))).collect();
        let radii = (0..=within.len()).map(|k| 0.5 * (within[k.saturating_sub(1)] + within[k.min(within.len() - 1)]));
        let slopes = assembly.nodes.iter().enumerate().map(|(k, node)| {
            let mut v = Vector3::z();
            for (p, q) in basis.at_node(k).iter().zip(strains.chunks_exact(6)) {
                v += Vector3::new(q[3], q[4], q[5]) * *p;
            }
            node.re * v * step
        });
        let points = assembly.nodes.iter().map(|node| node.position()).collect();
        Centreline { slopes: slopes.collect(), points, radii: radii.collect() }
    }

    /// The tube's radius at `s`.
    fn radius(&self, s: f64) -> f64 {
        let k = (s.floor().max(0.0) as usize).min(self.pieces() - 1);
        self.radii[k] + (self.radii[k + 1] - self.radii[k]) * (s - k as f64)
    }

    fn pieces(&self) -> usize {
        self.points.len() - 1
    }

    /// Position and derivative at `s`, 0 to the number of pieces.
    fn at(&self, s: f64) -> (Vector3<f64>, Vector3<f64>) {
        let k = (s.floor().max(0.0) as usize).min(self.pieces() - 1);
        let u = s - k as f64;
        let (p, q) = (self.points[k], self.points[k + 1]);
        let (a, b) = (self.slopes[k], self.slopes[k + 1]);
        let d = q - p;
        // p + u a + u^2 (3 d - 2 a - b) + u^3 (a + b - 2 d)
        let (second, third) = (3.0 * d - 2.0 * a - b, a + b - 2.0 * d);
        (p + (a + (second + third * u) * u) * u, a + (2.0 * second + 3.0 * third * u) * u)
    }
}

impl Solver<'_> {
    /// The closest two rods and the distance of their surfaces, m, at the last linearisation; none without two rods
    /// that have a radius. An error where they touch.
    pub fn clearance(&self, at: &Unknowns) -> Result<Option<([usize; 2], f64)>, ModuleError> {
        let least = self.module().least_distance(self.assemblies(), at);
        match least {
            Some((rods, clearance)) if clearance < 0.0 => Err(ModuleError::Contact { rods, clearance }),
            least => Ok(least),
        }
    }
}

impl Module {
    fn least_distance(&self, assemblies: &[Assembly], at: &Unknowns) -> Option<([usize; 2], f64)> {
        let lines: Vec<_> = (self.mounts.iter().zip(&self.bores).zip(assemblies).zip(&at.rods).enumerate())
            .filter(|(_, (((mount, _), _), _))| mount.rod.outer_radius > 0.0)
            .map(|(i, (((mount, bore), assembly), (strains, _)))| {
                (i, Centreline::new(assembly, &self.basis, strains, &mount.rod, *bore))
            })
            .collect();
        least_clearance(&lines)
    }
}

/// The closest two of the tubes and the distance of their surfaces, m; none of fewer than two.
pub(crate) fn least_clearance(lines: &[(usize, Centreline)]) -> Option<([usize; 2], f64)> {
    let mut least: Option<([usize; 2], f64)> = None;
    for (k, (i, line)) in lines.iter().enumerate() {
        for (j, other) in &lines[k + 1..] {
            let clearance = distance(line, other);
            if least.is_none_or(|(_, c)| clearance < c) {
                least = Some(([*i, *j], clearance));
            }
        }
    }
    least
}

/// The least distance of the surfaces of two tubes.
fn distance(a: &Centreline, b: &Centreline) -> f64 {
    let widest = |line: &Centreline, k: usize| line.radii[k].max(line.radii[k + 1]);
    let mut best = (f64::INFINITY, 0.0, 0.0);
    for i in 0..a.pieces() {
        let (p, d) = (a.points[i], a.points[i + 1] - a.points[i]);
        for j in 0..b.pieces() {
            let (q, e) = (b.points[j], b.points[j + 1] - b.points[j]);
            let apart = (p - q + (d - e) * 0.5).norm() - 0.5 * (d.norm() + e.norm());
            if apart - widest(a, i) - widest(b, j) < best.0 {
                let (s, t) = nearest(&(p - q), &d, &e);
                let length = (p - q + d * s - e * t).norm();
                let (s, t) = (i as f64 + s, j as f64 + t);
                let clearance = length - a.radius(s) - b.radius(t);
                if clearance < best.0 {
                    best = (clearance, s, t);
                }
            }
        }
    }
    // The chords' own distance is no more than where to begin.
    let (_, mut s, mut t) = best;
    let mut least = f64::INFINITY;
    for _ in 0..SEARCHES {
        let ((p, d), (q, e)) = (a.at(s), b.at(t));
        let w = p - q;
        let clearance = w.norm() - a.radius(s) - b.radius(t);
        if clearance.is_nan() || clearance >= least - 1e-9 {
            break;
        }
        least = clearance;
        let (ds, dt) = interior(&w, &d, &e);
        s = (s + ds).clamp(0.0, a.pieces() as f64);
        t = (t + dt).clamp(0.0, b.pieces() as f64);
    }
    least
}

/// The stationary (s, t) of |w + s d - t e|; the least one where the lines are parallel.
fn interior(w: &Vector3<f64>, d: &Vector3<f64>, e: &Vector3<f64>) -> (f64, f64) {
    let (dd, ee, de) = (d.norm_squared(), e.norm_squared(), d.dot(e));
    // A touch of damping makes parallel lines regular.
    let damping = 1e-9 * (dd + ee);
    let matrix = Matrix2::new(dd + damping, -de, -de, ee + damping);
    let right = Vector2::new(-w.dot(d), w.dot(e));
    matrix.lu().solve(&right).map_or((0.0, 0.0), |x| (x.x, x.y))
}

/// The nearest points (s, t) in [0, 1] of two chords, w + s d against t e.
fn nearest(w: &Vector3<f64>, d: &Vector3<f64>, e: &Vector3<f64>) -> (f64, f64) {
    let (dd, ee, de) = (d.norm_squared(), e.norm_squared(), d.dot(e));
    let s = interior(w, d, e).0.clamp(0.0, 1.0);
    let t = ((w.dot(e) + s * de) / ee).clamp(0.0, 1.0);
    // The best s for this t.
    let s = ((t * de - w.dot(d)) / dd).clamp(0.0, 1.0);
    (s, t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(curve: impl Fn(f64) -> (Vector3<f64>, Vector3<f64>), pieces: usize) -> Centreline {
        let nodes = (0..=pieces).map(|k| curve(k as f64 / pieces as f64));
        let (points, slopes) = nodes.map(|(p, d)| (p, d / pieces as f64)).unzip();
        Centreline { points, slopes, radii: vec![0.0; pieces + 1] }
    }

    #[test]
    fn straight_and_crossing_lines_are_as_far_apart_as_geometry_says() {
        let up = |x: f64| move |s: f64| (Vector3::new(x, 0.0, s), Vector3::z());
        assert!((distance(&line(up(0.0), 4), &line(up(0.3), 7)) - 0.3).abs() < 1e-12);
        let cross = |s: f64| (Vector3::new(s - 0.37, 0.2, 0.613), Vector3::x());
        assert!((distance(&line(up(0.0), 4), &line(cross, 5)) - 0.2).abs() < 1e-9);
        let beyond = |s: f64| (Vector3::new(s - 0.37, 0.3, 1.4), Vector3::x());
        assert!((distance(&line(up(0.0), 4), &line(beyond, 5)) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn of_parallel_tubes_the_widest_places_count() {
        let tube = |x: f64| Centreline {
            radii: vec![1.0, 1.2, 1.5, 1.2, 1.0],
            ..line(move |s: f64| (Vector3::new(x, 0.0, s), Vector3::z()), 4)
        };
        assert!((distance(&tube(0.0), &tube(4.0)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn two_helices_of_opposite_phase_are_found_as_close_as_a_fine_search_finds_them() {
        let helix = |phase: f64| {
            move |s: f64| {
                let (sine, cosine) = (2.0 * s + phase).sin_cos();
                (Vector3::new(0.3 * cosine, 0.3 * sine, s), Vector3::new(-0.6 * sine, 0.6 * cosine, 1.0))
            }
        };
        let (a, b) = (helix(0.0), helix(2.0));
        let got = distance(&line(a, 8), &line(b, 8));
        let fine = (0..2000 * 2000).map(|k| (a((k / 2000) as f64 / 1999.0).0 - b((k % 2000) as f64 / 1999.0).0).norm());
        let want = fine.fold(f64::INFINITY, f64::min);
        // The curves are cubic through eight pieces: (1/8)^4 / 384 of their fourth derivative.
        assert!((got - want).abs() < 1e-5, "{got} {want}");
    }
}

//! One measure of the error of a tube's states: the relative difference of what their ends leave open.
//!
//! A point of the outer surface at the height z of a tube held at z = 0 moves by `(lam - 1) z` along the tube and by
//! `Ro tau z` round it: on the unrolled surface its way per length is
//!
//! ```text
//!     |motion| = hypot(lam - 1, Ro tau)
//! ```
//!
//! What a support does to the tube, it does on a circle of that radius: `F / (2 pi Ro)` per length of it along the tube
//! and `M / (2 pi Ro^2)` round it, of the magnitude `|load| / (2 pi Ro)` with
//!
//! ```text
//!     |load| = hypot(F, M / Ro)
//! ```
//!
//! The two are dual: `F dlam + M dtau` is the scalar product of (F, M / Ro) and (dlam, Ro dtau), so a relative error of
//! the load is one of the work too, and neither depends on how the components are weighed. A free end leaves the
//! motion open and a held one the load; of a tube with one of each the larger relative difference counts.
//!
//! Differences are related to the largest magnitude among the reference states: a curve's error is one over its range,
//! and a state next to rest, of which round-off is a large part, does not make it.

use super::ends::{End, Ends, Equilibrium};
use super::tube::Tube;

/// Motion below which a state counts as rest, and load over mu Ro^2: the solvers' own accuracy.
const REST: f64 = 1e-9;

/// What a state's error is measured in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Axial stretch, 1 at rest.
    pub stretch: f64,
    /// Twist, rad per reference metre.
    pub twist: f64,
    /// Force on the distal support, N.
    pub force: f64,
    /// Moment on it, N m.
    pub moment: f64,
}

impl From<&Equilibrium> for Outcome {
    fn from(e: &Equilibrium) -> Outcome {
        Outcome { stretch: e.stretch, twist: e.twist, force: e.force, moment: e.moment }
    }
}

/// Relative difference of states of `tube` from reference states at the same pressures and `ends`, given in pairs
/// (state, reference), as the module's theory has it. Zero where nothing moves.
pub fn difference(tube: &Tube, ends: Ends, pairs: &[(Outcome, Outcome)]) -> f64 {
    let radius = tube.outer_radius();
    let open = |end: End, motion: f64, load: f64| match end {
        End::Loaded(_) => [motion, 0.0],
        End::Held(_) => [0.0, load],
    };
    // (along, round) of the motion, then of the load.
    let vectors = |o: &Outcome| {
        let [along, force] = open(ends.axial, o.stretch - 1.0, o.force);
        let [round, moment] = open(ends.torsion, o.twist * radius, o.moment / radius);
        [[along, round], [force, moment]]
    };
    let load = tube.law.shear_modulus() * radius * radius;
    let mut relative = 0.0_f64;
    for (k, rest) in [REST, REST * load].into_iter().enumerate() {
        let (mut largest, mut scale) = (0.0_f64, rest);
        for (state, reference) in pairs {
            let (a, b) = (vectors(state)[k], vectors(reference)[k]);
            largest = largest.max((a[0] - b[0]).hypot(a[1] - b[1]));
            scale = scale.max(b[0].hypot(b[1]));
        }
        if largest > rest {
            relative = relative.max(largest / scale);
        }
    }
    relative
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(stretch: f64, twist: f64, force: f64, moment: f64) -> Outcome {
        Outcome { stretch, twist, force, moment }
    }

    #[test]
    fn what_the_ends_leave_open_counts_over_the_largest_of_it() {
        let tube = Tube::reference(0.7);
        let radius = tube.outer_radius();
        let reference = [outcome(1.1, 0.0, 1.0, 0.0), outcome(1.2, 0.0, 2.0, 0.0)];
        let off = [outcome(1.1, 0.02 / radius, 1.0, 0.5 * radius), outcome(1.2, 0.0, 2.0, 0.0)];
        let pairs: Vec<_> = off.into_iter().zip(reference).collect();
        assert!((difference(&tube, Ends::FREE, &pairs) - 0.1).abs() < 1e-12);
        assert!((difference(&tube, Ends::BLOCKED, &pairs) - 0.25).abs() < 1e-12);
        // Free to move and held against turning: 0 of the motion, 0.5 of 0.5 of the moment.
        let mixed = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };
        let turned = [(outcome(1.1, 0.0, 0.0, 0.0), outcome(1.1, 0.0, 0.0, 0.5))];
        assert_eq!(difference(&tube, mixed, &turned), 1.0);
    }

    #[test]
    fn rest_and_nothing_differ_by_nothing() {
        let tube = Tube::reference(0.7);
        let rest = [(outcome(1.0 + 1e-12, 1e-9, 1e-10, 1e-12), outcome(1.0, 0.0, 0.0, 0.0))];
        assert_eq!(difference(&tube, Ends::FREE, &rest), 0.0);
        assert_eq!(difference(&tube, Ends::BLOCKED, &rest), 0.0);
        assert_eq!(difference(&tube, Ends::FREE, &[]), 0.0);
    }
}

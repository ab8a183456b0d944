//! The hand of a person at the simulated bench: it turns the FREE's end, holds it, and lets it go.
//!
//! A grip is a moment that grows, stands, and is gone from one substep of the plant to the next; it damps what it
//! holds. When and how far are a little different each time, from the plant's seed.

use std::time::Duration;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use super::Plant;
use crate::clock::Time;

/// Time from taking hold to the full moment, s.
const TURN: f64 = 0.8;
/// Steps in which the moment grows.
const TURN_STEPS: u32 = 40;
/// Time for which it then stands, s.
const HOLD: f64 = 0.8;
/// Farthest that a release is off its time, s, and that the angle is off what was asked for, as a share.
const UNSURE: (f64, f64) = (0.2, 0.15);

/// What a person does to a FREE while a program runs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hand {
    /// When the end is let go, in s since the program's start; it is taken hold of [`Hand::BEFORE`] earlier.
    pub releases_s: Vec<f64>,
    /// How far it is turned before, rad: to one side and to the other in turn.
    pub angle_rad: f64,
    /// Inertia that has been added to the end, kg m2.
    pub added_inertia_kg_m2: f64,
}

impl Hand {
    /// From taking hold to letting go, at most, s.
    pub const BEFORE: f64 = TURN + HOLD + UNSURE.0;
}

impl Plant {
    /// Has a hand do to the FREE `free` what `hand` says, from `start` on; what it has added is taken away at `end`.
    pub fn pluck(&mut self, free: usize, hand: &Hand, start: Time, end: Time) {
        let Some(stiffness) = self.true_free(free).map(|f| f.torsional_stiffness) else { return };
        self.add_inertia(free, hand.added_inertia_kg_m2, start);
        self.add_inertia(free, 0.0, end);
        let mut random = Pcg64::seed_from_u64(self.seed().wrapping_add(start.as_nanos()));
        let mut unsure = |most: f64| most * (2.0 * random.random::<f64>() - 1.0);
        let mut side = 1.0;
        for release in &hand.releases_s {
            let at = |seconds: f64| start + Duration::try_from_secs_f64(seconds).unwrap_or_default();
            let release = release + unsure(UNSURE.0);
            let moment = side * stiffness * hand.angle_rad * (1.0 + unsure(UNSURE.1));
            for step in 1..=TURN_STEPS {
                let share = f64::from(step) / f64::from(TURN_STEPS);
                self.grip(free, Some(share * moment), at(release - HOLD - TURN * (1.0 - share)));
            }
            self.grip(free, None, at(release));
            side = -side;
        }
    }
}

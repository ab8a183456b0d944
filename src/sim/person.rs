//! The person at a simulated rig: reads a ruler and a gauge, each with an error of its own.

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::units::PASCAL_PER_PSI;

/// Standard deviation of a length read from a ruler, m.
pub const RULER: f64 = 0.2e-3;
/// Standard deviation of a pressure read from a test gauge, Pa: 0.2 % of 15 psi.
pub const GAUGE: f64 = 0.03 * PASCAL_PER_PSI;

/// Someone who reads.
#[derive(Clone, Debug)]
pub struct Person {
    rng: Pcg64,
}

impl Person {
    /// The person of a rig with this seed.
    pub fn new(seed: u64) -> Self {
        // Not the numbers that the FREEs are scattered by.
        Self { rng: Pcg64::seed_from_u64(seed ^ 0x0070_6572_736f_6e21) }
    }

    /// What is read of a length, m.
    pub fn length(&mut self, truth: f64) -> f64 {
        truth + RULER * self.normal()
    }

    /// What is read of a pressure, Pa.
    pub fn pressure(&mut self, truth: f64) -> f64 {
        truth + GAUGE * self.normal()
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }
}

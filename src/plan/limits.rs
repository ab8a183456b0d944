//! What a plan may ask of the regulators and of the module.

use super::{FREES, PlanError};

/// Bounds of a plan. Pressures are gauge, Pa, of A, B, C, D.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest pressures. A channel whose lowest is its highest stays there: a dead one at 0.
    pub low: [f64; 4],
    /// Highest pressures.
    pub high: [f64; 4],
    /// Fastest change of any pressure, Pa/s; infinite for none.
    pub slew: f64,
    /// Least smooth [`super::Margin`], 0 to 0.7.
    pub margin: f64,
}

/// A bound that holds a pressure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// The lowest pressure.
    Low,
    /// The highest pressure.
    High,
    /// The fastest fall.
    SlewDown,
    /// The fastest rise.
    SlewUp,
}

impl Limits {
    /// Between 0 and `high` Pa, at any rate, with a fifth of the stiffness and clearance at rest left.
    pub fn up_to(high: f64) -> Limits {
        Limits { low: [0.0; FREES], high: [high; FREES], slew: f64::INFINITY, margin: 0.2 }
    }

    /// An error that names the first bound that is none.
    pub fn check(&self) -> Result<(), PlanError> {
        for (low, high) in self.low.iter().zip(&self.high) {
            if !low.is_finite() {
                return Err(PlanError::invalid("a lowest pressure (Pa)", *low, "must be finite"));
            }
            if !(high.is_finite() && high >= low) {
                let rule = "must be finite and not below the lowest";
                return Err(PlanError::invalid("a highest pressure (Pa)", *high, rule));
            }
        }
        if self.slew.is_nan() || self.slew <= 0.0 {
            return Err(PlanError::invalid("the slew rate (Pa/s)", self.slew, "must be positive"));
        }
        if !(0.0..=0.7).contains(&self.margin) {
            let rule = "must be 0 to 0.7 (at rest it is 0.8)";
            return Err(PlanError::invalid("the margin", self.margin, rule));
        }
        Ok(())
    }

    /// `pressures` between the lowest and the highest.
    pub(super) fn clip(&self, pressures: &[f64; 4]) -> [f64; 4] {
        std::array::from_fn(|i| pressures[i].clamp(self.low[i], self.high[i]))
    }

    /// Where [`Limits::clip`] changes them.
    pub(super) fn clips(&self, pressures: &[f64; 4]) -> [Option<Bound>; FREES] {
        std::array::from_fn(|i| match pressures[i] {
            p if p < self.low[i] => Some(Bound::Low),
            p => (p > self.high[i]).then_some(Bound::High),
        })
    }

    /// The pressures within a change of `reach` Pa from `start`, and which bound each end is. A start outside the
    /// bounds moves towards them as fast as it may.
    pub(super) fn around(&self, start: &[f64; 4], reach: f64) -> Window {
        let mut window = Window { low: self.low, high: self.high, bounds: [[Bound::Low, Bound::High]; FREES] };
        for (i, start) in start.iter().enumerate() {
            let (slowest, fastest) = (start - reach, start + reach);
            if slowest > window.low[i] {
                (window.low[i], window.bounds[i][0]) = (slowest, Bound::SlewDown);
            }
            if fastest < window.high[i] {
                (window.high[i], window.bounds[i][1]) = (fastest, Bound::SlewUp);
            }
            // Out of the bounds by more than the reach: the slew limit alone holds.
            if window.low[i] > window.high[i] {
                let nearest = if fastest < self.low[i] { fastest } else { slowest };
                (window.low[i], window.high[i]) = (nearest, nearest);
            }
        }
        window
    }
}

/// A box of pressures.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub low: [f64; 4],
    pub high: [f64; 4],
    bounds: [[Bound; 2]; FREES],
}

impl Window {
    /// Pressure `i` cannot move.
    pub fn fixed(&self, i: usize) -> bool {
        self.low[i] == self.high[i]
    }

    /// Which bounds hold `pressures`.
    pub fn active(&self, pressures: &[f64; 4]) -> [Option<Bound>; FREES] {
        std::array::from_fn(|i| {
            let [low, high] = self.bounds[i];
            // A pascal is no freedom.
            if pressures[i] <= self.low[i] + 1.0 {
                Some(low)
            } else {
                (pressures[i] >= self.high[i] - 1.0).then_some(high)
            }
        })
    }
}

//! Rubber and fibres remember: Maxwell-slip (Prandtl-Ishlinskii) hysteresis of the end's moment, both ways.
//!
//! Springs in parallel, each in series with a slider: spring i, of stiffness w_i, is dragged by the angle and slips
//! once it is strained by x_i,
//!
//! ```text
//! M_h(phi) = sum w_i (phi - z_i),    z_i = clamp(z_i, phi - x_i, phi + x_i)      (sign: it opposes the motion)
//! ```
//!
//! Rate-independent, with return-point memory.
//!
//! The parameters are fitted once, the state moves: [`Hysteresis`] is constant, [`HysteresisState`] is what remembers.

use thiserror::Error;

/// How many elements there are; unused ones have a weight of zero.
pub const ELEMENTS: usize = 8;

/// Parameters that no hysteresis can have.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum HysteresisError {
    /// A threshold that is not positive.
    #[error("hysteresis element {0} slips at {1} rad; it must be finite and positive")]
    Threshold(usize, f64),
    /// A negative weight.
    #[error("hysteresis element {0} has a stiffness of {1} N m/rad; it must be finite and not negative")]
    Weight(usize, f64),
}

/// The elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hysteresis {
    thresholds: [f64; ELEMENTS],
    weights: [f64; ELEMENTS],
}

/// Where the sliders stand, rad. Of a FREE that has never been turned: zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HysteresisState {
    sliders: [f64; ELEMENTS],
}

impl Default for Hysteresis {
    fn default() -> Self {
        Self::NONE
    }
}

impl Hysteresis {
    /// No hysteresis.
    pub const NONE: Self = Self { thresholds: [1.0; ELEMENTS], weights: [0.0; ELEMENTS] };

    /// Elements that slip at `thresholds` (rad, positive) and have the stiffnesses `weights` (N m/rad, not negative).
    pub fn new(thresholds: [f64; ELEMENTS], weights: [f64; ELEMENTS]) -> Result<Self, HysteresisError> {
        for (i, (&x, &w)) in thresholds.iter().zip(&weights).enumerate() {
            if !(x.is_finite() && x > 0.0) {
                return Err(HysteresisError::Threshold(i, x));
            }
            if !(w.is_finite() && w >= 0.0) {
                return Err(HysteresisError::Weight(i, w));
            }
        }
        Ok(Self { thresholds, weights })
    }

    /// Thresholds between `shortest` and `longest` (rad, both positive), each the same multiple of the one before: a
    /// grid to fit weights on.
    pub fn grid(shortest: f64, longest: f64) -> [f64; ELEMENTS] {
        let ratio = longest / shortest;
        std::array::from_fn(|i| shortest * ratio.powf(i as f64 / (ELEMENTS - 1) as f64))
    }

    /// Strain at which each element slips, rad.
    pub fn thresholds(&self) -> &[f64; ELEMENTS] {
        &self.thresholds
    }

    /// Stiffness of each element, N m/rad.
    pub fn weights(&self) -> &[f64; ELEMENTS] {
        &self.weights
    }

    /// Largest moment, N m.
    pub fn saturation(&self) -> f64 {
        self.elements().map(|(x, w)| x * w).sum()
    }

    /// Each element's share of the moment at `angle` (rad) for a weight of one, rad: what a fit of the weights needs
    /// as its columns.
    pub fn strains(&self, state: &HysteresisState, angle: f64) -> [f64; ELEMENTS] {
        std::array::from_fn(|i| (angle - state.sliders[i]).clamp(-self.thresholds[i], self.thresholds[i]))
    }

    /// Moment at `angle` (rad), N m: what must be overcome beside the springs. Moves nothing.
    pub fn moment(&self, state: &HysteresisState, angle: f64) -> f64 {
        self.strains(state, angle).iter().zip(&self.weights).map(|(strain, w)| strain * w).sum()
    }

    /// The same, against the rest that a full cycle in the positive direction leaves behind
    /// ([`HysteresisState::rested`]): there the angle is counted from, and the springs bear what the elements hold.
    pub fn moment_from_rest(&self, state: &HysteresisState, angle: f64) -> f64 {
        self.moment(state, angle) + self.saturation()
    }

    /// Stiffness that the sticking elements add at `angle` (rad), N m/rad.
    pub fn tangent(&self, state: &HysteresisState, angle: f64) -> f64 {
        let sticks = |i: usize| (angle - state.sliders[i]).abs() < self.thresholds[i];
        (0..ELEMENTS).filter(|&i| sticks(i)).map(|i| self.weights[i]).sum()
    }

    /// Moves the end to `angle`, rad: the sliders that slip follow. An angle that is no number moves nothing.
    pub fn advance(&self, state: &mut HysteresisState, angle: f64) {
        if !angle.is_finite() {
            return;
        }
        for (z, x) in state.sliders.iter_mut().zip(self.thresholds) {
            *z = z.clamp(angle - x, angle + x);
        }
    }

    fn elements(&self) -> impl Iterator<Item = (f64, f64)> {
        self.thresholds.into_iter().zip(self.weights)
    }
}

impl HysteresisState {
    /// The state of an end that has come back from far in the positive direction and rests at zero: every element is
    /// strained to its threshold. A FREE that has been under pressure always rests so.
    pub fn rested(hysteresis: &Hysteresis) -> Self {
        Self { sliders: hysteresis.thresholds }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Hysteresis {
        let weights = [0.02, 0.0, 0.015, 0.01, 0.008, 0.005, 0.003, 0.001];
        Hysteresis::new(Hysteresis::grid(0.01, 0.4), weights).unwrap()
    }

    fn turned_to(h: &Hysteresis, angle: f64) -> HysteresisState {
        let mut state = HysteresisState::default();
        h.advance(&mut state, angle);
        state
    }

    #[test]
    fn a_full_cycle_ends_in_the_rested_state() {
        let h = some();
        let mut state = turned_to(&h, 2.0);
        h.advance(&mut state, 0.0);
        assert_eq!(state, HysteresisState::rested(&h));
        assert_eq!(h.moment_from_rest(&state, 0.0), 0.0);
        assert!((h.moment_from_rest(&state, 2.0) - 2.0 * h.saturation()).abs() < 1e-15);
    }

    #[test]
    fn it_saturates_and_forgets_closed_inner_loops() {
        let h = some();
        let mut state = turned_to(&h, 2.0);
        assert!((h.moment(&state, 2.0) - h.saturation()).abs() < 1e-15);
        assert_eq!(h.tangent(&state, 2.1), 0.0, "all slip");
        h.advance(&mut state, 1.7);
        let before = h.moment(&state, 1.7);
        for angle in [1.75, 1.72, 1.7] {
            h.advance(&mut state, angle);
        }
        assert!((h.moment(&state, 1.7) - before).abs() < 1e-15);
        h.advance(&mut state, f64::NAN);
        assert!((h.moment(&state, 1.7) - before).abs() < 1e-15);
    }

    #[test]
    fn the_tangent_and_the_strains_are_those_of_the_moment() {
        let h = some();
        let state = turned_to(&h, 0.9);
        for angle in [0.894, 0.823, 0.617, 0.3] {
            let slope = (h.moment(&state, angle + 1e-7) - h.moment(&state, angle - 1e-7)) / 2e-7;
            assert!((slope - h.tangent(&state, angle)).abs() < 1e-8, "{angle}");
            let sum: f64 = h.strains(&state, angle).iter().zip(h.weights()).map(|(a, b)| a * b).sum();
            assert!((sum - h.moment(&state, angle)).abs() < 1e-16);
        }
    }

    #[test]
    fn impossible_elements_are_named() {
        let mut thresholds = Hysteresis::grid(0.01, 0.1);
        let mut weights = [0.0; ELEMENTS];
        weights[2] = -1.0;
        assert_eq!(Hysteresis::new(thresholds, weights), Err(HysteresisError::Weight(2, -1.0)));
        thresholds[1] = 0.0;
        assert_eq!(Hysteresis::new(thresholds, weights), Err(HysteresisError::Threshold(1, 0.0)));
        assert_eq!(Hysteresis::NONE.moment(&HysteresisState::default(), 1.0), 0.0);
    }
}

//! Rubber and fibres remember: Maxwell-slip (Prandtl-Ishlinskii) hysteresis of the end's moment, both ways.
//!
//! Springs in parallel, each in series with a slider: spring i, of stiffness w_i, is dragged by the angle and slips
//! once it is strained by x_i,
//!
//! ```text
//! M_h(phi) = sum w_i (phi - z_i),    z_i = clamp(z_i, phi - x_i, phi + x_i)      (sign: it opposes the motion)
//! ```
//!
//! Rate-independent, with return-point memory. From the angle the moment follows directly; from the moment (and the
//! elastic stiffness beside it) the angle follows exactly, too, since the sum is piecewise linear and increasing.
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

/// Where the sliders stand, rad. At rest and untouched: zero.
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

    /// The angle (rad) at which springs of `stiffness` (N m/rad, positive) and the elements together bear `moment`
    /// (N m): the inverse of `stiffness * angle + moment(angle)`. Exact, in at most 2 [`ELEMENTS`] pieces.
    pub fn angle(&self, state: &HysteresisState, stiffness: f64, moment: f64) -> f64 {
        let total = |angle: f64| stiffness * angle + self.moment(state, angle);
        // The corners, where an element begins to slip, in rising order: between two of them the sum is a line.
        let mut corners = [0.0; 2 * ELEMENTS];
        for (i, (z, x)) in state.sliders.iter().zip(self.thresholds).enumerate() {
            (corners[2 * i], corners[2 * i + 1]) = (z - x, z + x);
        }
        corners.sort_unstable_by(f64::total_cmp);
        let above = corners.partition_point(|&c| total(c) < moment);
        match (above.checked_sub(1).map(|i| corners[i]), corners.get(above)) {
            (Some(low), Some(&high)) => {
                let (from, to) = (total(low), total(high));
                if to > from { low + (high - low) * (moment - from) / (to - from) } else { low }
            }
            // Beyond all corners every element slips: only the springs give way.
            (Some(last), None) => last + (moment - total(last)) / stiffness,
            (None, Some(&first)) => first + (moment - total(first)) / stiffness,
            (None, None) => moment / stiffness,
        }
    }

    fn elements(&self) -> impl Iterator<Item = (f64, f64)> {
        self.thresholds.into_iter().zip(self.weights)
    }
}

impl HysteresisState {
    /// The state of an end that was at rest at zero and has been turned to `angle` (rad) in one go.
    pub fn turned_to(hysteresis: &Hysteresis, angle: f64) -> Self {
        let mut state = Self::default();
        hysteresis.advance(&mut state, angle);
        state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> Hysteresis {
        let weights = [0.02, 0.0, 0.015, 0.01, 0.008, 0.005, 0.003, 0.001];
        Hysteresis::new(Hysteresis::grid(0.01, 0.4), weights).unwrap()
    }

    /// A course with nested loops.
    fn course() -> impl Iterator<Item = f64> {
        (0..2000).map(|i| {
            let t = f64::from(i) * 5e-3;
            0.6 * (1.0 - (2.0 * t).cos()) + 0.1 * (11.0 * t).sin()
        })
    }

    #[test]
    fn it_saturates_and_forgets_closed_inner_loops() {
        let h = some();
        let mut state = HysteresisState::turned_to(&h, 2.0);
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
    fn the_inverse_gives_the_angle_back_all_along_nested_loops() {
        let (h, stiffness) = (some(), 0.086);
        let mut state = HysteresisState::default();
        for angle in course() {
            let moment = stiffness * angle + h.moment(&state, angle);
            // Piecewise linear both ways: rounding only.
            assert!((h.angle(&state, stiffness, moment) - angle).abs() < 1e-12, "{angle}");
            h.advance(&mut state, angle);
            assert!((h.angle(&state, stiffness, moment) - angle).abs() < 1e-12, "after the sliders moved: {angle}");
        }
    }

    #[test]
    fn the_tangent_and_the_strains_are_those_of_the_moment() {
        let h = some();
        let state = HysteresisState::turned_to(&h, 0.9);
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
        assert!((Hysteresis::NONE.angle(&HysteresisState::default(), 0.1, 0.05) - 0.5).abs() < 1e-15);
    }
}

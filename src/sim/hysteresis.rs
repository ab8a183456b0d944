//! Maxwell-slip hysteresis: friction that remembers.
//!
//! Several springs in parallel, each in series with a slider: a spring of stiffness k_i carries at most f_i,
//! then its slider follows. Together they give the pre-sliding stiffness, the loop and its non-local memory
//! (every reversal begins a new branch) that rubber with fibres shows, rate-independently.

/// How many sliders. Each begins to slip at another displacement, so the branches are round.
const SLIDERS: usize = 5;

/// Parallel Maxwell-slip elements between the FREE's end and the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct MaxwellSlip {
    /// Each slider's stiffness, N m/rad.
    stiffness: [f64; SLIDERS],
    /// Displacement at which each begins to slip, rad.
    slip: [f64; SLIDERS],
    /// Where each slider stands, rad.
    position: [f64; SLIDERS],
    /// What the springs bear of it where the angle is counted from, N m.
    bias: f64,
}

impl MaxwellSlip {
    /// Elements that together saturate at `moment` (N m, not negative), the last of them after a displacement of
    /// `reach` (rad, positive): they share the moment evenly and slip at reach / 2^i.
    pub fn new(moment: f64, reach: f64) -> Self {
        let slip = std::array::from_fn(|i| reach / f64::from(1 << (SLIDERS - 1 - i)));
        Self { stiffness: slip.map(|x| moment / SLIDERS as f64 / x), slip, position: [0.0; SLIDERS], bias: 0.0 }
    }

    /// As a full cycle in `direction` (1 or -1) has left them: all elements are strained to their limit, and the end
    /// rests at the angle of zero, which is counted from there.
    pub fn rested(self, direction: f64) -> Self {
        Self { position: self.slip.map(|x| direction * x), bias: -direction * self.saturation(), ..self }
    }

    /// The largest moment, N m.
    pub fn saturation(&self) -> f64 {
        self.stiffness.iter().zip(&self.slip).map(|(k, x)| k * x).sum()
    }

    /// Moment on the end at `angle` (rad), N m, with the sliders where they stand or, beyond their limits,
    /// where `angle` drags them; it opposes the motion. Moves nothing.
    pub fn moment(&self, angle: f64) -> f64 {
        self.bias - self.elements().map(|(k, x, z)| k * (angle - z).clamp(-x, x)).sum::<f64>()
    }

    /// Stiffness that the sticking elements add at `angle`, N m/rad.
    pub fn tangent(&self, angle: f64) -> f64 {
        self.elements().filter(|&(_, x, z)| (angle - z).abs() < x).map(|(k, _, _)| k).sum()
    }

    /// Stiffness that all elements add while they stick, N m/rad.
    pub fn full_stiffness(&self) -> f64 {
        self.stiffness.iter().sum()
    }

    /// Moves the end to `angle`, rad: the sliders that slip follow.
    pub fn advance(&mut self, angle: f64) {
        for (z, x) in self.position.iter_mut().zip(self.slip) {
            *z = z.clamp(angle - x, angle + x);
        }
    }

    fn elements(&self) -> impl Iterator<Item = (f64, f64, f64)> {
        (0..SLIDERS).map(|i| (self.stiffness[i], self.slip[i], self.position[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_virgin_curve_saturates_and_the_loop_closes() {
        let mut m = MaxwellSlip::new(0.01, 0.2);
        assert_eq!(m.moment(0.0), 0.0);
        assert!((m.saturation() - 0.01).abs() < 1e-15);
        m.advance(1.0);
        assert!((m.moment(1.0) + 0.01).abs() < 1e-15, "saturated, against the motion");
        // After a reversal of twice the reach it is saturated the other way round.
        m.advance(0.6);
        assert!((m.moment(0.6) - 0.01).abs() < 1e-15);
        // A closed inner loop leaves no trace (return-point memory).
        let before = m.clone();
        for angle in [0.65, 0.6] {
            m.advance(angle);
        }
        assert!((m.moment(0.6) - before.moment(0.6)).abs() < 1e-15);
    }

    #[test]
    fn what_has_been_cycled_rests_at_zero() {
        for direction in [1.0, -1.0] {
            let mut m = MaxwellSlip::new(0.01, 0.2).rested(direction);
            assert!(m.moment(0.0).abs() < 1e-15);
            for angle in [direction, 0.0] {
                m.advance(angle);
            }
            assert!(m.moment(0.0).abs() < 1e-15, "a cycle ends where it began");
            assert!((m.moment(direction) + direction * 0.02).abs() < 1e-15);
        }
    }

    #[test]
    fn the_tangent_is_the_slope_of_the_moment() {
        let mut m = MaxwellSlip::new(0.02, 0.3);
        m.advance(0.5);
        for angle in [0.487, 0.403, 0.213, -0.117] {
            let slope = (m.moment(angle + 1e-7) - m.moment(angle - 1e-7)) / 2e-7;
            // Central difference of a piecewise linear function, away from its corners: rounding only.
            assert!((slope + m.tangent(angle)).abs() < 1e-6, "{angle}");
        }
    }
}

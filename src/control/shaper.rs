//! Input shaping: a jump of the reference becomes the fastest move that the regulator can make and the mode bears.
//!
//! The shaped reference is the program's plus a difference that dies out,
//!
//! ```text
//! shaped(t) = program(t) + d(t),     d = quintic over T: from what the jump left to (0, 0, 0)
//! ```
//!
//! A program without jumps passes unchanged. At a jump of position or rate the quintic takes up the difference, so
//! that the shaped position and rate stay continuous, whatever was under way. T is the shortest time
//! with which the command that the model needs for the move, inverse lag included, keeps within p_max and within
//! [`SHARE`] of the slew limits, and at least [`PERIODS`] periods of the FREE's torsional mode: a quintic of that
//! length holds next to nothing at the mode's frequency, even where it is 20 % off.

/// Share of the slew limit that a move uses: the rest is for hysteresis and feedback.
pub const SHARE: f64 = 0.85;
/// Shortest move, in periods of the identified mode.
pub const PERIODS: f64 = 2.0;
/// Longest move, s.
pub const LONGEST: f64 = 4.0;
/// A smaller jump of the position is none, rad: what a tick may lose by extrapolating the program.
const POSITION_JUMP: f64 = 2e-3;
/// A smaller jump of the rate is none, rad/s.
const RATE_JUMP: f64 = 0.05;
/// Halvings of the duration's bracket.
const HALVINGS: usize = 12;

/// Position (rad), rate (rad/s) and acceleration (rad/s2) in the FREE's own direction.
pub type Motion = [f64; 3];

/// A difference that dies out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quintic {
    /// Duration, s; 0 is no difference at all.
    pub duration: f64,
    coefficients: [f64; 6],
}

impl Quintic {
    /// From `start` to rest at zero within `duration` seconds.
    pub fn new(start: Motion, duration: f64) -> Self {
        let t = duration;
        let [d, v, a] = [start[0], start[1] * t, start[2] * t * t];
        let coefficients =
            [d, v, 0.5 * a, -10.0 * d - 6.0 * v - 1.5 * a, 15.0 * d + 8.0 * v + 1.5 * a, -6.0 * d - 3.0 * v - 0.5 * a];
        Self { duration, coefficients }
    }

    /// The difference `t` seconds after its start.
    pub fn at(&self, t: f64) -> Motion {
        if t.is_nan() || t >= self.duration {
            return [0.0; 3];
        }
        let u = (t / self.duration).max(0.0);
        let [mut value, mut rate, mut half] = [0.0; 3];
        for c in self.coefficients.iter().rev() {
            half = half * u + rate;
            rate = rate * u + value;
            value = value * u + c;
        }
        [value, rate / self.duration, 2.0 * half / (self.duration * self.duration)]
    }
}

/// The shaper of one FREE.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaper {
    difference: Quintic,
    /// Since the difference's start, s.
    elapsed: f64,
    /// The program at the tick before.
    last: Motion,
}

impl Shaper {
    /// At rest at `position`, rad.
    pub fn at_rest(position: f64) -> Self {
        Self { last: [position, 0.0, 0.0], ..Self::default() }
    }

    /// The shaped reference for the program's `wanted`, `dt` seconds after the tick before. `feasible` says whether the
    /// command can follow the program, going on as it does now, plus the difference; it is asked at most 13 times, and
    /// only at a jump. `shortest` is the shortest duration of a move, s.
    pub fn step(
        &mut self,
        wanted: Motion,
        dt: f64,
        shortest: f64,
        feasible: impl Fn(&Motion, &Quintic) -> bool,
    ) -> Motion {
        let [position, rate, acceleration] = self.last;
        let expected = [position + rate * dt + 0.5 * acceleration * dt * dt, rate + acceleration * dt, acceleration];
        let change = (wanted[2] - acceleration).abs() * dt;
        let jumps = (wanted[0] - expected[0]).abs() > POSITION_JUMP + change * dt
            || (wanted[1] - expected[1]).abs() > RATE_JUMP + 2.0 * change;
        self.last = wanted;
        self.elapsed += dt;
        let mut difference = self.difference.at(self.elapsed);
        if jumps {
            // Accelerations jump in ordinary programs, too (a cubic's ends): they need no mending.
            for i in 0..2 {
                difference[i] += expected[i] - wanted[i];
            }
            let duration = shortest_duration(shortest, |t| feasible(&wanted, &Quintic::new(difference, t)));
            (self.difference, self.elapsed) = (Quintic::new(difference, duration), 0.0);
        }
        std::array::from_fn(|i| wanted[i] + difference[i])
    }
}

/// Shortest duration from `shortest` on that is good, by bisection; [`LONGEST`] if none is.
fn shortest_duration(shortest: f64, good: impl Fn(f64) -> bool) -> f64 {
    if good(shortest) {
        return shortest;
    }
    let (mut low, mut high) = (shortest, LONGEST.max(shortest));
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if good(middle) { high = middle } else { low = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quintic_starts_as_told_and_ends_at_rest() {
        let start = [0.7, -1.3, 4.0];
        let q = Quintic::new(start, 0.4);
        for (a, b) in q.at(0.0).iter().zip(start) {
            assert!((a - b).abs() < 1e-12);
        }
        // Sixth-degree cancellation in units of T: rounding times 15/T^2.
        assert!(q.at(0.4 - 1e-12).iter().all(|x| x.abs() < 1e-8));
        assert_eq!(q.at(0.5), [0.0; 3]);
        assert_eq!(q.at(f64::NAN), [0.0; 3]);
        let (h, [_, rate, acceleration]) = (1e-5, q.at(0.17));
        let (a, b, c) = (q.at(0.17 - h)[0], q.at(0.17)[0], q.at(0.17 + h)[0]);
        // Central differences: h^2 f'''/6 and rounding.
        assert!((rate - (c - a) / (2.0 * h)).abs() < 1e-6 && (acceleration - (a - 2.0 * b + c) / (h * h)).abs() < 1e-3);
    }

    #[test]
    fn a_smooth_program_passes_unchanged() {
        let program = crate::trajectory::paper_trajectory().unwrap();
        let mut shaper = Shaper::at_rest(0.0);
        for k in 0..5000 {
            let (position, rate, acceleration) = program.at(f64::from(k) * 2e-3);
            let wanted = [position, rate, acceleration];
            assert_eq!(shaper.step(wanted, 2e-3, 0.1, |_, _| false), wanted, "{k}");
        }
    }

    #[test]
    fn a_step_becomes_a_smooth_move_even_on_top_of_another() {
        let mut shaper = Shaper::at_rest(0.0);
        let mut last = [0.0; 3];
        for k in 0..600 {
            let target = if k < 100 { 1.0 } else { 0.4 };
            let shaped = shaper.step([target, 0.0, 0.0], 2e-3, 0.05, |_, q| q.duration >= 0.5);
            // A quintic of 0.5 s and 1.3 rad has rates up to 6, accelerations up to 50, jerks up to 900.
            assert!((shaped[0] - last[0]).abs() < 0.02 && (shaped[1] - last[1]).abs() < 0.2, "{k}: {shaped:?}");
            assert!((-0.1..=1.01).contains(&shaped[0]));
            last = shaped;
        }
        assert_eq!(last, [0.4, 0.0, 0.0]);
    }
}

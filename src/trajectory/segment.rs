//! One piece of a sequence.

use std::f64::consts::{FRAC_PI_2, TAU};

use serde::{Deserialize, Serialize};

/// How a segment goes from its first value to its last; u is the time since its start over its duration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "snake_case")]
pub enum Shape {
    /// Jumps to `to` at once and stays there.
    Step,
    /// Constant rate.
    Linear,
    /// 3 u^2 - 2 u^3: at rest at both ends (Eqs 8-9 of the paper; Eq. 9 as printed lacks its powers of t).
    Cubic,
    /// 10 u^3 - 15 u^4 + 6 u^5: at rest and without acceleration at both ends.
    Quintic,
    /// `from` + amplitude (sin(2 pi frequency t + phase) - sin(phase)); `to` is its value at the end.
    Sinusoid {
        /// Amplitude, in the sequence's unit.
        amplitude: f64,
        /// Frequency, Hz.
        #[serde(rename = "frequency_hz")]
        frequency: f64,
        /// Phase, rad.
        #[serde(rename = "phase_rad")]
        phase: f64,
    },
}

/// One piece of a sequence. Values are in the sequence's unit (rad or Pa).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Duration, s, positive.
    #[serde(rename = "duration_s")]
    pub duration: f64,
    /// Value at its start.
    pub from: f64,
    /// Value at its end.
    pub to: f64,
    /// Course between them.
    #[serde(flatten)]
    pub shape: Shape,
}

impl Segment {
    /// A segment that ends where its shape leads: `to` is taken as it is, but for a sinusoid, which computes it.
    pub fn new(from: f64, shape: Shape, to: f64, duration: f64) -> Self {
        let mut segment = Self { duration, from, to, shape };
        if let Shape::Sinusoid { .. } = shape {
            segment.to = segment.at(duration).0;
        }
        segment
    }

    /// Value, first and second derivative, `t` seconds after the segment's start, 0 <= t <= duration. At the end
    /// this is the limit from the left, which a [`Sequence`](super::Sequence) does not show where it jumps.
    pub fn at(&self, t: f64) -> (f64, f64, f64) {
        let span = self.to - self.from;
        let polynomial = |p: [f64; 3]| {
            (self.from + span * p[0], span * p[1] / self.duration, span * p[2] / (self.duration * self.duration))
        };
        let u = t / self.duration;
        match self.shape {
            Shape::Step => (self.to, 0.0, 0.0),
            Shape::Linear => polynomial([u, 1.0, 0.0]),
            Shape::Cubic => polynomial([u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u), 6.0 - 12.0 * u]),
            Shape::Quintic => polynomial([
                u * u * u * (10.0 + u * (6.0 * u - 15.0)),
                30.0 * (u * (1.0 - u)).powi(2),
                60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
            ]),
            Shape::Sinusoid { amplitude, frequency, phase } => {
                let omega = TAU * frequency;
                let (sin, cos) = (omega * t + phase).sin_cos();
                (self.from + amplitude * (sin - phase.sin()), amplitude * omega * cos, -amplitude * omega * omega * sin)
            }
        }
    }

    /// Lowest and highest value anywhere in the segment, its own ends included.
    pub fn range(&self) -> (f64, f64) {
        let (low, high) = (self.from.min(self.to), self.from.max(self.to));
        match self.shape {
            Shape::Sinusoid { amplitude, frequency, phase } => {
                // The arc it sweeps contains the crest `at` if a whole number of turns leads there.
                let end = phase + TAU * frequency * self.duration;
                let (first, last) = (phase.min(end), phase.max(end));
                let reaches = |at: f64| at + TAU * ((first - at) / TAU).ceil() <= last;
                let middle = self.from - amplitude * phase.sin();
                [FRAC_PI_2, -FRAC_PI_2].into_iter().filter(|&at| reaches(at)).fold((low, high), |(low, high), at| {
                    let crest = middle + amplitude * at.sin();
                    (low.min(crest), high.max(crest))
                })
            }
            Shape::Step | Shape::Linear | Shape::Cubic | Shape::Quintic => (low, high),
        }
    }

    /// Every number of the segment, with its name.
    pub(super) fn numbers(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let shape = match self.shape {
            Shape::Sinusoid { amplitude, frequency, phase } => {
                [Some(("amplitude", amplitude)), Some(("frequency", frequency)), Some(("phase", phase))]
            }
            Shape::Step | Shape::Linear | Shape::Cubic | Shape::Quintic => [None; 3],
        };
        [("duration", self.duration), ("first value", self.from), ("last value", self.to)]
            .into_iter()
            .chain(shape.into_iter().flatten())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SINUSOID: Shape = Shape::Sinusoid { amplitude: 0.4, frequency: 1.3, phase: 0.7 };
    const SMOOTH: [Shape; 4] = [Shape::Linear, Shape::Cubic, Shape::Quintic, SINUSOID];

    #[test]
    fn derivatives_are_those_of_the_value() {
        // Central differences: truncation h^2 f'''/6 and rounding eps f/h stay below 1e-8 at h = 1e-5 here
        // (third derivatives up to amplitude omega^3 = 220, so 4e-9).
        let h = 1e-5;
        for shape in SMOOTH {
            let segment = Segment::new(-0.3, shape, 1.1, 1.7);
            for i in 1..100 {
                let t = 1.7 * f64::from(i) / 100.0;
                let (_, rate, acceleration) = segment.at(t);
                let (before, after) = (segment.at(t - h), segment.at(t + h));
                assert!((rate - (after.0 - before.0) / (2.0 * h)).abs() < 1e-8, "{shape:?} at {t}");
                assert!((acceleration - (after.1 - before.1) / (2.0 * h)).abs() < 5e-8, "{shape:?} at {t}");
            }
        }
    }

    #[test]
    fn shapes_meet_their_ends() {
        for shape in [Shape::Linear, Shape::Cubic, Shape::Quintic] {
            let segment = Segment::new(-0.3, shape, 1.1, 1.7);
            assert!((segment.at(0.0).0 - -0.3).abs() < 1e-15);
            assert!((segment.at(1.7).0 - 1.1).abs() < 1e-15);
        }
        for shape in [Shape::Cubic, Shape::Quintic] {
            let segment = Segment::new(-0.3, shape, 1.1, 1.7);
            assert_eq!((segment.at(0.0).1, segment.at(1.7).1), (0.0, 0.0), "at rest: {shape:?}");
        }
        let quintic = Segment::new(-0.3, Shape::Quintic, 1.1, 1.7);
        assert_eq!((quintic.at(0.0).2, quintic.at(1.7).2), (0.0, 0.0), "without acceleration");
        assert_eq!(Segment::new(0.2, Shape::Step, 1.0, 1.0).at(0.0), (1.0, 0.0, 0.0));
        let sinusoid = Segment::new(0.2, SINUSOID, f64::NAN, 2.0);
        assert_eq!(sinusoid.at(0.0).0, 0.2);
        assert_eq!(sinusoid.at(2.0).0, sinusoid.to);
    }

    #[test]
    fn the_cubic_is_that_of_the_paper() {
        // Eqs 8-9 corrected, half way: half the distance at 1.5 times the mean rate.
        let (value, rate, acceleration) = Segment::new(0.0, Shape::Cubic, 1.0, 2.0).at(1.0);
        assert_eq!((value, rate, acceleration), (0.5, 0.75, 0.0));
    }

    #[test]
    fn a_range_holds_every_value_and_no_more() {
        let short = Shape::Sinusoid { amplitude: -0.4, frequency: 0.1, phase: 0.2 };
        for shape in SMOOTH.into_iter().chain([Shape::Step, short]) {
            let segment = Segment::new(if shape == Shape::Step { 1.1 } else { -0.3 }, shape, 1.1, 1.7);
            let (low, high) = segment.range();
            let values = (0..=10_000).map(|i| segment.at(1.7 * f64::from(i) / 1e4).0);
            let seen = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            // A crest lies at most half a sample beside a sample: 0.4 (omega 8.5e-5)^2 / 2 = 1e-7 above it.
            assert!((low - seen.0).abs() < 2e-7 && (high - seen.1).abs() < 2e-7, "{shape:?}");
        }
    }
}

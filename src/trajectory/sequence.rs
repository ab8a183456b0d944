//! A reference over time, piece by piece.

/// How a segment goes from its first value to its last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Jumps to `to` at once and stays there.
    Step,
    /// Constant rate.
    Linear,
    /// 3 u^2 - 2 u^3: at rest at both ends (Eqs 8-9 of the paper, corrected).
    Cubic,
    /// 10 u^3 - 15 u^4 + 6 u^5: at rest and without acceleration at both ends.
    Quintic,
    /// `from` + amplitude (sin(2 pi frequency t + phase) - sin(phase)); `to` is its value at the end.
    Sinusoid {
        /// Amplitude, in the sequence's unit.
        amplitude: f64,
        /// Frequency, Hz.
        frequency: f64,
        /// Phase, rad.
        phase: f64,
    },
}

/// One piece of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Duration, s, positive.
    pub duration: f64,
    /// Value at its start.
    pub from: f64,
    /// Value at its end.
    pub to: f64,
    /// Course between them.
    pub shape: Shape,
}

/// Segments one after the other; before the first and after the last the value stands still.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    segments: Box<[Segment]>,
    starts: Box<[f64]>,
}

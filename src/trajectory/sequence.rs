//! A reference over time, piece by piece.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Segment, Shape};

/// Why segments do not make a sequence.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SequenceError {
    /// Nothing to follow.
    #[error("a sequence needs at least one segment")]
    Empty,
    /// A number of a segment is infinite or not a number.
    #[error("segment {segment}: its {what} is {value}; it must be finite")]
    NotFinite {
        /// Counted from 1.
        segment: usize,
        /// Which number.
        what: &'static str,
        /// What it is.
        value: f64,
    },
    /// A segment takes no time, or negative time.
    #[error("segment {segment}: its duration is {duration} s; it must be positive")]
    NotPositive {
        /// Counted from 1.
        segment: usize,
        /// What it is, s.
        duration: f64,
    },
    /// A sinusoid whose stated end is not where it ends.
    #[error("segment {segment}: the sinusoid ends at {ends}, not at {stated}")]
    Inconsistent {
        /// Counted from 1.
        segment: usize,
        /// Its value at the end.
        ends: f64,
        /// What `to` says.
        stated: f64,
    },
    /// Repeated no times.
    #[error("a sequence must be repeated at least once")]
    NoRepeat,
}

/// Segments one after the other; before the first and after the last the value stands still.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Segment>", into = "Vec<Segment>")]
pub struct Sequence {
    segments: Box<[Segment]>,
    /// Start of each segment, s, and the end of the last.
    starts: Box<[f64]>,
}

impl Sequence {
    /// A sequence of `segments`: at least one, finite numbers, positive durations. They need not be continuous.
    pub fn new(segments: impl Into<Box<[Segment]>>) -> Result<Self, SequenceError> {
        let segments: Box<[Segment]> = segments.into();
        if segments.is_empty() {
            return Err(SequenceError::Empty);
        }
        let mut starts = Vec::with_capacity(segments.len() + 1);
        let mut time = 0.0;
        starts.push(time);
        for (number, segment) in (1..).zip(&segments) {
            if let Some((what, value)) = segment.numbers().find(|n| !n.1.is_finite()) {
                return Err(SequenceError::NotFinite { segment: number, what, value });
            }
            if segment.duration <= 0.0 {
                return Err(SequenceError::NotPositive { segment: number, duration: segment.duration });
            }
            let ends = segment.at(segment.duration).0;
            let scale = segment.from.abs().max(segment.to.abs()).max(ends.abs());
            if (ends - segment.to).abs() > 1e-9 * scale {
                return Err(SequenceError::Inconsistent { segment: number, ends, stated: segment.to });
            }
            time += segment.duration;
            starts.push(time);
        }
        Ok(Self { segments, starts: starts.into() })
    }

    /// Begins a sequence at `value`, to be continued segment by segment.
    pub fn starting_at(value: f64) -> SequenceBuilder {
        SequenceBuilder { first: value, last: value, segments: Vec::new() }
    }

    /// Stands at `value` for `duration` seconds.
    pub fn constant(value: f64, duration: f64) -> Result<Self, SequenceError> {
        Self::starting_at(value).hold(duration).build()
    }

    /// Value, first and second derivative at time `t`, s since the start. Before the start the first value and
    /// after the end the last one stand still; at a boundary the later segment holds.
    pub fn at(&self, t: f64) -> (f64, f64, f64) {
        if t < 0.0 {
            return (self.first(), 0.0, 0.0);
        }
        let index = self.starts.partition_point(|&start| start <= t);
        // `starts` begins with 0, so the index is at least 1 here, unless t is not a number.
        match index.checked_sub(1).and_then(|i| self.segments.get(i).zip(self.starts.get(i))) {
            Some((segment, start)) => segment.at(t - start),
            None => (self.last(), 0.0, 0.0),
        }
    }

    /// Total duration, s.
    pub fn duration(&self) -> f64 {
        self.starts[self.segments.len()]
    }

    /// Value before the start.
    pub fn first(&self) -> f64 {
        self.segments[0].from
    }

    /// Value after the end.
    pub fn last(&self) -> f64 {
        self.segments[self.segments.len() - 1].to
    }

    /// Lowest and highest value that the sequence can take.
    pub fn range(&self) -> (f64, f64) {
        self.segments
            .iter()
            .map(Segment::range)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), r| (low.min(r.0), high.max(r.1)))
    }

    /// The segments with their start times, s.
    pub fn segments(&self) -> impl ExactSizeIterator<Item = (f64, &Segment)> {
        self.starts[..self.segments.len()].iter().copied().zip(&self.segments)
    }

    /// The same sequence `times` times, one after the other. Where its end is not its start, it jumps.
    pub fn repeated(&self, times: usize) -> Result<Self, SequenceError> {
        if times == 0 {
            return Err(SequenceError::NoRepeat);
        }
        Self::new(self.segments.repeat(times))
    }

    /// The same sequence, standing still at its end until it has lasted `duration` seconds.
    pub fn extended_to(&self, duration: f64) -> Result<Self, SequenceError> {
        let missing = duration - self.duration();
        if missing <= 0.0 {
            return Ok(self.clone());
        }
        let mut segments = self.segments.to_vec();
        segments.push(Segment::new(self.last(), Shape::Step, self.last(), missing));
        Self::new(segments)
    }
}

impl TryFrom<Vec<Segment>> for Sequence {
    type Error = SequenceError;

    fn try_from(segments: Vec<Segment>) -> Result<Self, SequenceError> {
        Self::new(segments)
    }
}

impl From<Sequence> for Vec<Segment> {
    fn from(sequence: Sequence) -> Self {
        sequence.segments.into()
    }
}

/// A sequence under construction: every segment begins where the one before it ended.
#[derive(Clone, Debug)]
pub struct SequenceBuilder {
    first: f64,
    last: f64,
    segments: Vec<Segment>,
}

impl SequenceBuilder {
    /// Continues to `to` within `duration` seconds; a sinusoid computes its own end and ignores `to`.
    pub fn then(mut self, shape: Shape, to: f64, duration: f64) -> Self {
        let segment = Segment::new(self.last, shape, to, duration);
        self.last = segment.to;
        self.segments.push(segment);
        self
    }

    /// Jumps to `to` and stays there for `duration` seconds.
    pub fn step(self, to: f64, duration: f64) -> Self {
        self.then(Shape::Step, to, duration)
    }

    /// Moves to `to` with a cubic in `moving` seconds and stays there for the rest of a slot of `slot` seconds.
    pub fn cubic_in_slot(self, to: f64, moving: f64, slot: f64) -> Self {
        let moved = self.then(Shape::Cubic, to, moving);
        if slot > moving { moved.hold(slot - moving) } else { moved }
    }

    /// Swings around its value for `duration` seconds: amplitude in the sequence's unit, Hz, rad.
    pub fn sinusoid(self, amplitude: f64, frequency: f64, phase: f64, duration: f64) -> Self {
        let last = self.last;
        self.then(Shape::Sinusoid { amplitude, frequency, phase }, last, duration)
    }

    /// Stays for `duration` seconds.
    pub fn hold(self, duration: f64) -> Self {
        let last = self.last;
        self.then(Shape::Step, last, duration)
    }

    /// Goes back to the first value within `duration` seconds, so that repeating is smooth.
    pub fn close(self, shape: Shape, duration: f64) -> Self {
        let first = self.first;
        self.then(shape, first, duration)
    }

    /// The sequence.
    pub fn build(self) -> Result<Sequence, SequenceError> {
        Sequence::new(self.segments)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence() -> Sequence {
        Sequence::starting_at(0.5).then(Shape::Cubic, 2.0, 1.5).hold(0.5).step(-1.0, 1.0).build().unwrap()
    }

    #[test]
    fn it_holds_before_and_after_and_jumps_where_it_says_so() {
        let sequence = sequence();
        assert_eq!(sequence.duration(), 3.0);
        assert_eq!((sequence.first(), sequence.last()), (0.5, -1.0));
        assert_eq!(sequence.at(-1.0), (0.5, 0.0, 0.0));
        assert_eq!(sequence.at(0.0).0, 0.5);
        assert_eq!(sequence.at(0.75), (1.25, 1.5, 0.0));
        assert_eq!(sequence.at(1.9), (2.0, 0.0, 0.0));
        assert_eq!(sequence.at(2.0), (-1.0, 0.0, 0.0));
        assert_eq!(sequence.at(3.0), (-1.0, 0.0, 0.0));
        assert_eq!(sequence.at(f64::INFINITY), (-1.0, 0.0, 0.0));
        assert_eq!(sequence.range(), (-1.0, 2.0));
    }

    #[test]
    fn binary_search_finds_what_a_linear_one_finds() {
        let mut builder = Sequence::starting_at(0.0);
        for i in 0..37 {
            builder = builder.then(Shape::Linear, f64::from(i % 5), 0.1 + 0.01 * f64::from(i));
        }
        let sequence = builder.build().unwrap();
        for i in 0..1000 {
            let t = sequence.duration() * f64::from(i) / 999.5;
            let (start, segment) = sequence.segments().filter(|s| s.0 <= t).last().unwrap();
            assert_eq!(sequence.at(t), segment.at(t - start));
        }
    }

    #[test]
    fn what_is_no_sequence_is_refused_by_name() {
        assert_eq!(Sequence::new([]).unwrap_err(), SequenceError::Empty);
        let segment = |duration, to| Segment { duration, from: 0.0, to, shape: Shape::Linear };
        let error = Sequence::new([segment(1.0, 1.0), segment(0.0, 1.0)]).unwrap_err();
        assert_eq!(error, SequenceError::NotPositive { segment: 2, duration: 0.0 });
        let error = Sequence::new([segment(1.0, f64::INFINITY)]).unwrap_err().to_string();
        assert!(error.contains("segment 1") && error.contains("last value") && error.contains("finite"), "{error}");
        assert!(matches!(Sequence::new([segment(f64::NAN, 1.0)]), Err(SequenceError::NotFinite { .. })));
        let shape = Shape::Sinusoid { amplitude: 1.0, frequency: 0.25, phase: 0.0 };
        let wrong = Segment { duration: 1.0, from: 0.0, to: 0.3, shape };
        assert!(matches!(Sequence::new([wrong]), Err(SequenceError::Inconsistent { .. })));
        assert_eq!(sequence().repeated(0).unwrap_err(), SequenceError::NoRepeat);
    }

    #[test]
    fn repeats_and_extensions() {
        let sequence = sequence();
        let twice = sequence.repeated(2).unwrap();
        assert_eq!(twice.duration(), 6.0);
        assert_eq!(twice.at(3.75), sequence.at(0.75));
        let longer = sequence.extended_to(5.0).unwrap();
        assert_eq!((longer.duration(), longer.last()), (5.0, -1.0));
        assert_eq!(sequence.extended_to(1.0).unwrap(), sequence);
        let closed = Sequence::starting_at(0.2).step(1.0, 1.0).close(Shape::Quintic, 1.0).build().unwrap();
        assert_eq!(closed.first(), closed.last());
    }

    #[test]
    fn a_file_gives_back_the_same_bits_and_is_checked() {
        let sequence = Sequence::starting_at(0.1).then(Shape::Quintic, 0.7, 1.0 / 3.0).sinusoid(0.3, 2.0, 0.1, 0.77);
        let sequence = sequence.build().unwrap();
        let text = serde_json::to_string(&sequence).unwrap();
        assert!(text.contains(r#""duration_s""#) && text.contains(r#""shape":"sinusoid""#), "{text}");
        assert_eq!(serde_json::from_str::<Sequence>(&text).unwrap(), sequence);
        let bad = r#"[{"duration_s":-1.0,"from":0.0,"to":1.0,"shape":"linear"}]"#;
        assert!(serde_json::from_str::<Sequence>(bad).unwrap_err().to_string().contains("must be positive"));
    }
}

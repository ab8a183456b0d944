//! Errors of an angle against its reference, record by record.

use std::collections::VecDeque;

use super::metrics::ErrorMetrics;

/// The final error is the mean over this time, s.
const LAST: f64 = 0.1;

/// What is kept of the errors that have passed by.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    count: f64,
    squares: f64,
    peak: f64,
    /// Time and error of the latest ones, s and rad.
    last: VecDeque<(f64, f64)>,
}

impl Tally {
    /// Adds the error at the time `t` (s, later than the one before); one that is not a number counts as none.
    pub fn add(&mut self, t: f64, error: f64) {
        if !error.is_finite() {
            return;
        }
        self.count += 1.0;
        self.squares += error * error;
        self.peak = self.peak.max(error.abs());
        self.last.push_back((t, error));
        while self.last.front().is_some_and(|(earlier, _)| *earlier < t - LAST) {
            self.last.pop_front();
        }
    }

    /// Adds all that `later` has seen, and empties it.
    pub fn append(&mut self, later: &mut Tally) {
        if later.count == 0.0 {
            return;
        }
        let Tally { count, squares, peak, last } = std::mem::take(later);
        self.count += count;
        self.squares += squares;
        self.peak = self.peak.max(peak);
        self.last.extend(last);
        let end = self.last.back().map_or(f64::NEG_INFINITY, |(t, _)| *t);
        self.last.retain(|(t, _)| *t >= end - LAST);
    }

    /// The figures; `None` where there was no error.
    pub fn metrics(&self) -> Option<ErrorMetrics> {
        (self.count > 0.0).then(|| ErrorMetrics {
            rms_rad: (self.squares / self.count).sqrt(),
            peak_rad: self.peak,
            final_rad: self.last.iter().map(|(_, e)| *e).sum::<f64>() / self.last.len() as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_those_computed_by_hand_in_one_piece_or_two() {
        let mut whole = Tally::default();
        let (mut first, mut second) = (Tally::default(), Tally::default());
        for i in 0..100 {
            let (t, error) = (0.01 * f64::from(i), if i < 50 { 1.0 } else { 0.1 });
            whole.add(t, error);
            if i < 95 { &mut first } else { &mut second }.add(t, error);
            whole.add(t, f64::NAN);
        }
        first.append(&mut second);
        for tally in [whole, first] {
            let e = tally.metrics().unwrap();
            assert!((e.rms_rad - (0.5f64 * (1.0 + 0.01)).sqrt()).abs() < 1e-12);
            assert_eq!(e.peak_rad, 1.0);
            assert!((e.final_rad - 0.1).abs() < 1e-12);
        }
        assert_eq!(second.metrics(), None);
    }
}

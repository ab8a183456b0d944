//! Points at rest of a run in which the pressure went from hold to hold.

use super::{Result, Run};
use crate::ident::RestPoint;
use crate::signal::Truth;

/// How long a FREE is given to come to rest after its pressure has arrived, s.
const SETTLING: f64 = 0.5;
/// Shortest rest that gives a point, s.
const REST: f64 = 0.5;

/// Means over a stretch of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest {
    /// Angle, rad; not a number where it is not measured.
    pub angle: f64,
    /// Measured pressure, Pa; not a number where it is not measured.
    pub pressure: f64,
    /// What the simulated FREE really did; none of a real one.
    pub truth: Option<Truth>,
}

impl Run {
    /// What the FREE `subject` did on average in each of the `spans` (from, to in s of the program's time, one after
    /// another); none of one in which nothing was recorded.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn rests(&self, subject: usize, spans: &[(f64, f64)]) -> Result<Vec<Option<Rest>>> {
        // Angle, pressure, true extension, true angle, true pressure.
        let mut sums = vec![([0.0; 5], [0.0; 5]); spans.len()];
        let mut at = 0;
        for (record, truth) in self.records()? {
            let (now, Some(free)) = (record.program_time, record.frees().get(subject)) else { continue };
            while spans.get(at).is_some_and(|span| now > span.1) {
                at += 1;
            }
            if spans.get(at).is_none_or(|span| now.is_nan() || now < span.0) {
                continue;
            }
            let angle = if free.estimate.valid { free.estimate.angle } else { f64::NAN };
            let truth = truth.get(subject).map(|t| [t.extension, t.angle, t.pressure]).unwrap_or([f64::NAN; 3]);
            let values = [angle, free.pressure.pressure, truth[0], truth[1], truth[2]];
            let (sum, count) = &mut sums[at];
            for (i, value) in values.into_iter().enumerate().filter(|(_, value)| value.is_finite()) {
                sum[i] += value;
                count[i] += 1.0;
            }
        }
        let rest = |(sum, count): ([f64; 5], [f64; 5])| {
            let mean: [f64; 5] = std::array::from_fn(|i| if count[i] > 0.0 { sum[i] / count[i] } else { f64::NAN });
            let [angle, pressure, extension, true_angle, true_pressure] = mean;
            let truth = Truth { angle: true_angle, extension, pressure: true_pressure, ..Truth::default() };
            count.iter().any(|n| *n > 0.0).then_some(Rest { angle, pressure, truth: (count[2] > 0.0).then_some(truth) })
        };
        Ok(sums.into_iter().map(rest).collect())
    }

    /// Mean angle and measured pressure of the FREE `subject` over the rest of every hold, in their order; without the
    /// first half second of each.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn rest_points(&self, subject: usize) -> Result<Vec<RestPoint>> {
        let mut points = Vec::new();
        let mut hold = Hold::default();
        for (record, _) in self.records()? {
            let Some(free) = record.frees().get(subject).filter(|_| record.program_time.is_finite()) else { continue };
            if free.reference.position != hold.reference {
                points.extend(hold.point());
                hold = Hold { reference: free.reference.position, since: record.program_time, ..Hold::default() };
            }
            hold.until = record.program_time;
            if hold.until - hold.since > SETTLING && free.pressure.pressure.is_finite() {
                hold.angle += free.estimate.angle;
                hold.pressure += free.pressure.pressure;
                hold.count += 1.0;
            }
        }
        points.extend(hold.point());
        Ok(points)
    }
}

/// Sums over one hold.
#[derive(Default)]
struct Hold {
    reference: f64,
    since: f64,
    until: f64,
    angle: f64,
    pressure: f64,
    count: f64,
}

impl Hold {
    fn point(&self) -> Option<RestPoint> {
        let rested = self.until - self.since > SETTLING + REST && self.count > 0.0;
        rested.then(|| RestPoint { angle: self.angle / self.count, pressure: self.pressure / self.count })
    }
}

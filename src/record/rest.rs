//! Points at rest of a run in which the pressure went from hold to hold.

use super::{Result, Run};
use crate::ident::RestPoint;

/// How long a FREE is given to come to rest after its pressure has arrived, s.
const SETTLING: f64 = 0.5;
/// Shortest rest that gives a point, s.
const REST: f64 = 0.5;

impl Run {
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

//! The pressure that drives the model: what a run has measured, in as many readings as the model can go through.

/// Most readings that are kept: of a longer run they are averaged.
const MOST: usize = 1 << 21;

/// Readings of a pressure: their times increase.
#[derive(Clone, Debug)]
pub struct Drive {
    /// When, s.
    pub t: Vec<f64>,
    /// How much, Pa.
    pub pressure: Vec<f64>,
    /// How many readings each of these is the mean of.
    pub averaged: usize,
    /// Sums of the time and the pressure of the mean that is not full yet, and of how many.
    open: (f64, f64, usize),
    latest: f64,
    most: usize,
}

impl Default for Drive {
    fn default() -> Self {
        Self::of_at_most(MOST)
    }
}

impl Drive {
    fn of_at_most(most: usize) -> Self {
        Self { t: Vec::new(), pressure: Vec::new(), averaged: 1, open: (0.0, 0.0, 0), latest: f64::NEG_INFINITY, most }
    }

    /// Adds a reading; one that is not a number, or not later than the one before, says nothing.
    pub fn add(&mut self, t: f64, pressure: f64) {
        if !(pressure.is_finite() && t.is_finite() && t > self.latest + 1e-6) {
            return;
        }
        self.latest = t;
        self.open = (self.open.0 + t, self.open.1 + pressure, self.open.2 + 1);
        if self.open.2 == self.averaged {
            self.close();
        }
        if self.t.len() == self.most {
            let mean = |all: &[f64]| all.chunks_exact(2).map(|two| f64::midpoint(two[0], two[1])).collect();
            (self.t, self.pressure) = (mean(&self.t), mean(&self.pressure));
            self.averaged *= 2;
        }
    }

    /// Whether there was no reading yet.
    pub fn is_empty(&self) -> bool {
        self.latest == f64::NEG_INFINITY
    }

    /// Ends the last mean, and counts the times from `zero` (s) on.
    pub fn end(&mut self, zero: f64) {
        if self.open.2 > 0 {
            self.close();
        }
        self.t.iter_mut().for_each(|t| *t -= zero);
    }

    fn close(&mut self) {
        let (t, pressure, count) = std::mem::take(&mut self.open);
        self.t.push(t / count as f64);
        self.pressure.push(pressure / count as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_readings_are_kept_as_they_are_and_many_as_means() {
        let of = |n: usize| {
            let mut drive = Drive::of_at_most(16);
            for i in 0..n {
                let t = 0.5 * i as f64;
                drive.add(t, 3.0 * t);
                // Seen again by the next record, and lost.
                drive.add(t, 9.0);
                drive.add(t + 0.1, f64::NAN);
            }
            drive.end(1.0);
            drive
        };
        let few = of(15);
        assert_eq!((few.averaged, few.t.len(), few.t[1], few.pressure[1]), (1, 15, -0.5, 1.5));
        let many = of(103);
        assert_eq!((many.averaged, many.t.len()), (8, 13));
        for (t, p) in many.t.iter().zip(&many.pressure) {
            assert!((3.0 * (t + 1.0) - p).abs() < 1e-12, "a ramp stays a ramp: {t} {p}");
        }
        // The last mean is of the seven readings from 48.0 to 51.0 s.
        assert!((many.t[12] - (49.5 - 1.0)).abs() < 1e-12);
    }
}

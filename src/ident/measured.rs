//! What a fit says of one parameter.

/// A value and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard uncertainty, same unit.
    pub uncertainty: f64,
    /// Degrees of freedom behind the uncertainty; at least one.
    pub freedom: usize,
}

impl Measured {
    /// A value that is known.
    pub fn exact(value: f64) -> Self {
        Self { value, uncertainty: 0.0, freedom: usize::MAX }
    }

    /// The 95 % interval, by Student's distribution.
    pub fn interval(&self) -> (f64, f64) {
        let half = student_975(self.freedom) * self.uncertainty;
        (self.value - half, self.value + half)
    }

    /// Whether the 95 % interval holds `truth`.
    pub fn covers(&self, truth: f64) -> bool {
        let (low, high) = self.interval();
        (low..=high).contains(&truth)
    }

    /// The same in a unit `factor` times smaller.
    pub fn times(self, factor: f64) -> Self {
        Self { value: factor * self.value, uncertainty: factor.abs() * self.uncertainty, ..self }
    }

    /// What follows from it: another value, with an uncertainty behind which are the same degrees of freedom.
    pub(super) fn follows(self, value: f64, uncertainty: f64) -> Self {
        Self { value, uncertainty, ..self }
    }
}

/// The 97.5 % point of Student's distribution: exact for one and two degrees of freedom, else Cornish and Fisher's
/// expansion about the normal one, which is 1 % short at three and better above.
fn student_975(freedom: usize) -> f64 {
    match freedom {
        0 | 1 => 12.706,
        2 => 4.303,
        n => {
            let (n, z) = (n as f64, 1.959_964_f64);
            let first = (z.powi(3) + z) / 4.0;
            let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
            let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
            z + first / n + second / n.powi(2) + third / n.powi(3)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_points_are_those_of_the_tables() {
        for (freedom, point) in
            [(1, 12.706), (2, 4.303), (3, 3.182), (6, 2.447), (10, 2.228), (30, 2.042), (1000, 1.962)]
        {
            assert!((student_975(freedom) / point - 1.0).abs() < 0.012, "{freedom}: {}", student_975(freedom));
        }
    }
}

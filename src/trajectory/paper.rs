//! The two courses of the paper's experiments.

use super::{Sequence, SequenceError};

/// The paper's trajectory: 40, 10, 70 deg, each a cubic of 1.5 s at the start of a slot of 3 s, from 0 at t = 0.
pub fn paper_trajectory() -> Result<Sequence, SequenceError> {
    let angles = [40.0f64, 10.0, 70.0];
    angles.iter().fold(Sequence::starting_at(0.0), |s, a| s.cubic_in_slot(a.to_radians(), 1.5, 3.0)).build()
}

/// The paper's steps, increments of 50, -30, 60 deg every 3 s: 50, 20, 80 deg.
pub fn paper_steps() -> Result<Sequence, SequenceError> {
    let angles = [50.0f64, 20.0, 80.0];
    angles.iter().fold(Sequence::starting_at(0.0), |s, a| s.step(a.to_radians(), 3.0)).build()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_nine_seconds_and_end_where_the_paper_ends() {
        let (trajectory, steps) = (paper_trajectory().unwrap(), paper_steps().unwrap());
        assert_eq!((trajectory.duration(), steps.duration()), (9.0, 9.0));
        let degrees = |s: &Sequence, t| (s.at(t).0.to_degrees() * 1e9).round() / 1e9;
        assert_eq!(
            [0.0, 0.75, 1.5, 3.0, 3.75, 4.5, 7.5, 20.0].map(|t| degrees(&trajectory, t)),
            [0.0, 20.0, 40.0, 40.0, 25.0, 10.0, 70.0, 70.0]
        );
        assert_eq!([-0.1, 0.0, 2.999, 3.0, 6.0, 9.0].map(|t| degrees(&steps, t)), [0.0, 50.0, 50.0, 20.0, 80.0, 80.0]);
    }
}

//! The lumped parameters of one FREE.

use std::f64::consts::FRAC_PI_2;
use std::fmt;

use thiserror::Error;

/// A FREE as the lumped model (Eqs 1-4 of the paper) sees it. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Free {
    /// Winding angle from the tube's axis, rad, signed (R positive), 0 < |gamma| < pi/2.
    pub gamma: f64,
    /// Length at rest, m.
    pub length: f64,
    /// Radius of the fibres at rest, m (the fibre radius: with the inner one the actuation is 27 to 37 % too small).
    pub radius: f64,
    /// Mass of the end cap and what hangs on it, kg.
    pub mass: f64,
    /// Rotational inertia of the end, kg m2.
    pub inertia: f64,
    /// Axial stiffness ke, N/m.
    pub axial_stiffness: f64,
    /// Torsional stiffness kt, N m/rad.
    pub torsional_stiffness: f64,
    /// Axial damping ce, N s/m.
    pub axial_damping: f64,
    /// Torsional damping ct, N m s/rad.
    pub torsional_damping: f64,
}

impl Free {
    /// The FREE of the paper's lumped model, with its parameters as printed. Overdamped in torsion (ratio 7.3).
    pub fn paper() -> Self {
        let (mass, radius) = (0.028, 0.007);
        Self {
            gamma: -40f64.to_radians(),
            length: 0.110,
            radius,
            mass,
            inertia: mass * radius * radius,
            axial_stiffness: 10110.0,
            torsional_stiffness: 0.086,
            axial_damping: 5.0,
            torsional_damping: 0.005,
        }
    }

    /// The FREE of the authors' published simulation. Rings at 39.9 Hz in torsion (damping ratio 0.058) and at
    /// 122 Hz along its axis (0.008).
    pub fn published_code() -> Self {
        Self {
            length: 0.120,
            axial_stiffness: 16478.0,
            torsional_stiffness: 0.0862,
            axial_damping: 0.34,
            torsional_damping: 3.97e-5,
            ..Self::paper()
        }
    }

    /// +1 if the end turns positive under pressure (an L FREE), -1 if negative (R).
    pub fn direction(&self) -> f64 {
        -self.gamma.signum()
    }

    /// Undamped natural frequencies at zero pressure, rad/s: (axial, torsional).
    pub fn natural_frequencies(&self) -> (f64, f64) {
        ((self.axial_stiffness / self.mass).sqrt(), (self.torsional_stiffness / self.inertia).sqrt())
    }

    /// Damping ratios at zero pressure, 1 is critical: (axial, torsional).
    pub fn damping_ratios(&self) -> (f64, f64) {
        (
            self.axial_damping / (2.0 * (self.axial_stiffness * self.mass).sqrt()),
            self.torsional_damping / (2.0 * (self.torsional_stiffness * self.inertia).sqrt()),
        )
    }

    /// Every parameter that no FREE can have.
    pub fn problems(&self) -> Vec<FreeProblem> {
        let gamma = self.gamma.is_finite() && self.gamma != 0.0 && self.gamma.abs() < FRAC_PI_2;
        let gamma = (!gamma).then_some(FreeProblem {
            parameter: "gamma",
            value: self.gamma,
            rule: "must lie between -pi/2 and pi/2 rad and not be zero",
        });
        let positive = [
            ("length", self.length),
            ("radius", self.radius),
            ("mass", self.mass),
            ("inertia", self.inertia),
            ("axial_stiffness", self.axial_stiffness),
            ("torsional_stiffness", self.torsional_stiffness),
        ];
        let not_negative = [("axial_damping", self.axial_damping), ("torsional_damping", self.torsional_damping)];
        let problem = |(parameter, value), rule| FreeProblem { parameter, value, rule };
        let positive = positive.into_iter().filter(|p| !(p.1.is_finite() && p.1 > 0.0));
        let not_negative = not_negative.into_iter().filter(|p| !(p.1.is_finite() && p.1 >= 0.0));
        gamma
            .into_iter()
            .chain(positive.map(|p| problem(p, "must be finite and positive")))
            .chain(not_negative.map(|p| problem(p, "must be finite and not negative")))
            .collect()
    }

    /// Ok if no parameter is impossible.
    pub fn validate(&self) -> Result<(), FreeError> {
        let problems = self.problems();
        if problems.is_empty() { Ok(()) } else { Err(FreeError { problems }) }
    }
}

/// A parameter that no FREE can have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeProblem {
    /// Name of the field of [`Free`].
    pub parameter: &'static str,
    /// Its value, SI.
    pub value: f64,
    /// What it breaks.
    pub rule: &'static str,
}

impl fmt::Display for FreeProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {} {}", self.parameter, self.value, self.rule)
    }
}

/// Every impossible parameter of a FREE.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("impossible FREE: {}", .problems.iter().map(FreeProblem::to_string).collect::<Vec<_>>().join("; "))]
pub struct FreeError {
    /// At least one.
    pub problems: Vec<FreeProblem>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_are_valid_and_ring_as_known() {
        for free in [Free::paper(), Free::published_code()] {
            free.validate().unwrap();
            assert_eq!(free.direction(), 1.0, "an L FREE turns positive");
        }
        // Figures of the authors' parameters, to the digits known.
        let hertz = |omega: f64| omega / std::f64::consts::TAU;
        let (axial, torsional) = Free::published_code().natural_frequencies();
        assert!((hertz(axial) - 122.0).abs() < 0.5 && (hertz(torsional) - 39.9).abs() < 0.05);
        let (axial, torsional) = Free::published_code().damping_ratios();
        assert!((axial - 0.008).abs() < 5e-4 && (torsional - 0.058).abs() < 5e-4);
        assert!((Free::paper().damping_ratios().1 - 7.3).abs() < 0.05);
    }

    #[test]
    fn every_impossible_parameter_is_named() {
        let free = Free { gamma: 0.0, length: -1.0, torsional_damping: f64::NAN, ..Free::paper() };
        let error = free.validate().unwrap_err();
        let names: Vec<_> = error.problems.iter().map(|p| p.parameter).collect();
        assert_eq!(names, ["gamma", "length", "torsional_damping"]);
        assert!(error.to_string().contains("length = -1 must be finite and positive"), "{error}");
        assert!(Free { axial_damping: 0.0, ..Free::paper() }.validate().is_ok(), "undamped is possible");
    }
}

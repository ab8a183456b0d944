//! The inverse nonlinear static model as a table: which pressure holds which angle.
//!
//! Built when arming from the equilibria of Eqs 1-4 with the exact fibre radius, and then only interpolated. Angles
//! and pressures are in the FREE's own direction, so that the table is the same for L and R. Where the equilibrium
//! ends (a FREE that runs away) the table ends, too, and goes on along its last slope.

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::model::{Free, FreeError, Kinematics, Law, Lumped};

/// Intervals of the table. Over 150 deg each is 1.2 deg; a cubic through values and slopes errs by less than 1 Pa.
const INTERVALS: usize = 128;
/// Fewest measured points for a correction of second degree that is not just drawn through them.
pub const POINTS_MIN: usize = 6;

/// Why there is no table.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StaticMapError {
    /// A FREE that cannot be.
    #[error(transparent)]
    Free(#[from] FreeError),
    /// A range that is no range, or in which the FREE has no equilibrium at all.
    #[error("the FREE has no equilibrium between 0 and {:.2} deg", .0.to_degrees())]
    Range(f64),
    /// Too few measured points, or all at one angle.
    #[error(
        "{0} measured points between 2 deg and the end of the table; at least {POINTS_MIN} at different angles are needed"
    )]
    Points(usize),
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Node {
    /// Pa.
    pressure: f64,
    /// Pa/rad.
    slope: f64,
    /// Moment per pressure, N m/Pa.
    moment: f64,
}

/// Pressure, stiffness and actuation over the angle.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticMap {
    step: f64,
    nodes: Box<[Node]>,
}

impl StaticMap {
    /// The table of `free` from rest to `highest` (rad, positive, in the FREE's own direction), or to where its
    /// equilibrium ends.
    pub fn of_model(free: &Free, highest: f64) -> Result<Self, StaticMapError> {
        let model = Lumped::new(*free, Law::Nonlinear(Kinematics::Exact))?;
        if !(highest.is_finite() && highest > 0.0) {
            return Err(StaticMapError::Range(highest));
        }
        let step = highest / INTERVALS as f64;
        let (direction, load) = (free.direction(), Default::default());
        let node = |angle: f64| {
            let at = model.equilibrium_at_rotation(direction * angle, load).ok()?;
            let moment = direction * model.actuation(at.extension, at.rotation).ok()?.moment;
            Some(Node { pressure: at.pressure, slope: 0.0, moment })
        };
        let mut nodes: Vec<_> = (0..=INTERVALS).map_while(|i| node(i as f64 * step)).collect();
        if nodes.len() < 3 {
            return Err(StaticMapError::Range(highest));
        }
        // Slopes by differences of second order: P is smooth, and the cubic needs no better ones.
        let last = nodes.len() - 1;
        for i in 0..=last {
            let p = |k: usize| nodes[k].pressure;
            nodes[i].slope = match i {
                0 => (-3.0 * p(0) + 4.0 * p(1) - p(2)) / (2.0 * step),
                _ if i == last => (3.0 * p(last) - 4.0 * p(last - 1) + p(last - 2)) / (2.0 * step),
                _ => (p(i + 1) - p(i - 1)) / (2.0 * step),
            };
        }
        Ok(Self { step, nodes: nodes.into() })
    }

    /// The table brought to measured `points`: (angle, pressure) at rest, rad and Pa in the FREE's own direction,
    /// without the hysteresis. Least squares for a factor c0 + c1 phi + c2 phi^2 on the pressure, so that the model's
    /// shape stays where nothing was measured.
    pub fn corrected(mut self, points: &[(f64, f64)]) -> Result<Self, StaticMapError> {
        let top = self.highest();
        let (mut normal, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
        for &(angle, pressure) in points.iter().filter(|p| p.0 > 0.035 && p.0 <= top && p.1.is_finite()) {
            let x = angle / top;
            let row = Vector3::new(1.0, x, x * x) * self.pressure(angle);
            normal += row * row.transpose();
            right += row * pressure;
            count += 1;
        }
        let solved = normal.lu().solve(&right).filter(|c| c.iter().all(|x| x.is_finite()));
        let (true, Some(c)) = (count >= POINTS_MIN, solved) else { return Err(StaticMapError::Points(count)) };
        for (i, node) in self.nodes.iter_mut().enumerate() {
            let x = i as f64 * self.step / top;
            let factor = c[0] + c[1] * x + c[2] * x * x;
            let by_angle = (c[1] + 2.0 * c[2] * x) / top;
            node.slope = node.slope * factor + node.pressure * by_angle;
            node.pressure *= factor;
            // What holds the angle with less pressure has that much more moment per pressure.
            node.moment /= factor.max(0.1);
        }
        Ok(self)
    }

    /// Highest angle of the table, rad.
    pub fn highest(&self) -> f64 {
        (self.nodes.len() - 1) as f64 * self.step
    }

    /// Pressure that holds `angle`, Pa; beyond the table along its ends' slopes.
    pub fn pressure(&self, angle: f64) -> f64 {
        let (a, b, x) = self.interval(angle);
        if x < 0.0 {
            return a.pressure + a.slope * x * self.step;
        }
        if x > 1.0 {
            return b.pressure + b.slope * (x - 1.0) * self.step;
        }
        let y = 1.0 - x;
        let bent = x * y * (y * a.slope - x * b.slope) * self.step;
        a.pressure * y * y * (1.0 + 2.0 * x) + b.pressure * x * x * (3.0 - 2.0 * x) + bent
    }

    /// Moment per pressure at `angle`, N m/Pa, positive.
    pub fn moment(&self, angle: f64) -> f64 {
        let (a, b, x) = self.interval(angle);
        let x = x.clamp(0.0, 1.0);
        a.moment + x * (b.moment - a.moment)
    }

    fn interval(&self, angle: f64) -> (&Node, &Node, f64) {
        let at = angle / self.step;
        // What is no number counts as zero.
        let index = (at.max(0.0) as usize).min(self.nodes.len() - 2);
        (&self.nodes[index], &self.nodes[index + 1], at - index as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_the_equilibrium_for_l_and_r() {
        for gamma in [-40f64, 40.0, -55.0] {
            let free = Free { gamma: gamma.to_radians(), ..Free::paper() };
            let model = Lumped::new(free, Law::Nonlinear(Kinematics::Exact)).unwrap();
            let map = StaticMap::of_model(&free, 1.8).unwrap();
            for i in 0..90 {
                let angle = 0.0193 * f64::from(i);
                let exact = model.static_pressure(free.direction() * angle).unwrap();
                assert!((map.pressure(angle) - exact).abs() < 1.0, "{gamma} {angle}: {} {exact}", map.pressure(angle));
                // At rest springs and pressure balance: the moment is where the angle's share of it comes from.
                let held = map.moment(angle) * exact;
                assert!((held - free.torsional_stiffness * angle).abs() < 1e-5, "{gamma} {angle}");
            }
            assert!(map.pressure(-0.1) < 0.0 && map.pressure(f64::NAN).is_nan());
        }
    }

    #[test]
    fn a_free_that_runs_away_has_a_shorter_table() {
        let free = Free { gamma: -30f64.to_radians(), ..Free::paper() };
        let map = StaticMap::of_model(&free, 3.0).unwrap();
        assert!(map.highest() < 3.0 && map.highest() > 0.3, "{}", map.highest());
        assert!(matches!(StaticMap::of_model(&free, 0.0), Err(StaticMapError::Range(_))));
    }

    #[test]
    fn measured_points_bend_the_table_to_another_free() {
        let real = Free { torsional_stiffness: 0.095, gamma: -41f64.to_radians(), radius: 0.0071, ..Free::paper() };
        let model = Lumped::new(real, Law::Nonlinear(Kinematics::Exact)).unwrap();
        let exact = |angle: f64| model.static_pressure(angle).unwrap();
        let points: Vec<_> = (1..=12).map(|i| 0.12 * f64::from(i)).map(|a| (a, exact(a))).collect();
        let nominal = StaticMap::of_model(&Free::paper(), 1.6).unwrap();
        let before = (nominal.pressure(0.7) / exact(0.7) - 1.0).abs();
        let map = nominal.clone().corrected(&points).unwrap();
        for i in 1..28 {
            let angle = 0.05 * f64::from(i);
            // Two FREEs of nearly the same shape: the ratio of their pressures is a parabola to 1e-4.
            assert!((map.pressure(angle) / exact(angle) - 1.0).abs() < 3e-4, "{angle}");
        }
        assert!(before > 0.02);
        assert!(matches!(nominal.corrected(&points[..3]), Err(StaticMapError::Points(3))));
    }
}

//! `[free.knob]` of rig.toml: the knob that a FREE's free end turns, and what temperature it sets.
//!
//! Off is where the vented FREE rests: the FREE is mounted wound on by a little, so that without pressure it presses
//! the knob against its off stop, and zero of the angle is there. From off the knob goes the way the FREE turns, as far
//! as its other stop.

use super::reader::Section;
use crate::control::Limits;
use crate::sim::KnobSim;
use crate::units::{Angle, Temperature};

/// A knob on a FREE's free end.
#[derive(Clone, Debug, PartialEq)]
pub struct Knob {
    /// From off to its other stop, rad, in the FREE's own direction.
    pub travel: f64,
    /// What temperature it sets, where that is known.
    pub temperatures: Option<Temperatures>,
}

/// A table of the knob's angle (rad, with its sign) and what it sets (degrees Celsius): both rise or fall throughout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Temperatures(Vec<(f64, f64)>);

impl Temperatures {
    /// A table of at least two rows whose angles rise or fall strictly, and whose temperatures do; none of any other.
    pub fn new(rows: Vec<(f64, f64)>) -> Option<Temperatures> {
        let one_way = |pick: fn(&(f64, f64)) -> f64| {
            let steps = || rows.windows(2).map(|pair| pick(&pair[1]) - pick(&pair[0]));
            steps().all(|step| step > 0.0) || steps().all(|step| step < 0.0)
        };
        let finite = rows.iter().all(|(angle, temperature)| angle.is_finite() && temperature.is_finite());
        (finite && rows.len() > 1 && one_way(|row| row.0) && one_way(|row| row.1)).then_some(Temperatures(rows))
    }

    /// The rows: angle, rad, and temperature, degrees Celsius.
    pub fn rows(&self) -> &[(f64, f64)] {
        &self.0
    }

    /// What the knob sets at `angle`, rad: between two rows linear, beyond the ends what they set; not a number of
    /// none.
    pub fn at(&self, angle: f64) -> f64 {
        between(self.0.iter().copied(), angle)
    }

    /// The angle that sets `temperature`, degrees Celsius, rad; none outside of the table.
    pub fn angle(&self, temperature: f64) -> Option<f64> {
        let (low, high) = self.range();
        let inverse = self.0.iter().map(|&(angle, temperature)| (temperature, angle));
        (low..=high).contains(&temperature).then(|| between(inverse, temperature))
    }

    /// Lowest and highest temperature, degrees Celsius.
    pub fn range(&self) -> (f64, f64) {
        let ends = |pick: fn(f64, f64) -> f64| self.0.iter().map(|row| row.1).reduce(pick).unwrap_or(f64::NAN);
        (ends(f64::min), ends(f64::max))
    }

    /// The angle that sets `temperature`, or the rule that there is none of the knob of the FREE `name`.
    ///
    /// # Errors
    /// The rule, for a person.
    pub fn angle_of(&self, temperature: f64, name: &str) -> Result<f64, String> {
        self.angle(temperature).ok_or_else(|| {
            let (low, high) = self.range();
            let [asked, low, high] = [temperature, low, high].map(Temperature::celsius);
            format!("{asked} is outside {low} to {high}, what the knob of `{name}` sets")
        })
    }
}

/// Linear between two of `rows`, whose first numbers rise or fall; beyond the ends what they hold.
fn between(rows: impl Iterator<Item = (f64, f64)>, at: f64) -> f64 {
    let mut before: Option<(f64, f64)> = None;
    for (x, y) in rows {
        if let Some((x0, y0)) = before {
            let share = (at - x0) / (x - x0);
            if share <= 1.0 {
                return y0 + share.max(0.0) * (y - y0);
            }
        }
        before = Some((x, y));
    }
    if at.is_nan() { f64::NAN } else { before.map_or(f64::NAN, |(_, y)| y) }
}

/// `[free.knob]`, and what its simulated twin is like.
#[derive(Clone, Debug)]
pub(super) struct RawKnob {
    pub(super) knob: Knob,
    pub(super) sim: KnobSim,
}

/// Reads the knob of a FREE that turns in the direction `own` (1 or -1) within `limits`.
pub(super) fn read_knob(mut section: Section<'_>, own: f64, limits: &Limits) -> RawKnob {
    let travel = section.number("travel_deg", None, 1.0..=900.0);
    let soft = if own > 0.0 { limits.angle_soft.1 } else { -limits.angle_soft.0 };
    if soft > travel {
        let rule = format!("ends before the soft envelope of the angle does, at {:.1}", Angle::radians(own * soft));
        section.reject(
            "travel_deg",
            rule,
            "narrow soft_angle_deg in [free.limits]: no angle beyond the stop is reached",
        );
    }
    let temperatures = read_temperatures(&mut section, own, travel);
    let mut twin = section.section("sim");
    let sim = KnobSim {
        travel,
        friction: twin.number("friction_mnm", 2.5, 0.0..=1000.0),
        preload: twin.number("preload_mnm", 3.0, 0.0..=1000.0),
    };
    if sim.friction > 0.0 && sim.preload <= sim.friction {
        twin.reject(
            "preload_mnm",
            format!("must be above friction_mnm, {:.3}: the vented FREE has to turn its knob off", 1e3 * sim.friction),
            "wind the FREE on by more when it is mounted, and write the moment here",
        );
    }
    RawKnob { knob: Knob { travel, temperatures }, sim }
}

fn read_temperatures(section: &mut Section<'_>, own: f64, travel: f64) -> Option<Temperatures> {
    const ANGLES: &str = "angles_deg";
    const TEMPERATURES: &str = "temperatures_degc";
    let angles = section.numbers(ANGLES, -900.0..=900.0);
    let temperatures = section.numbers(TEMPERATURES, -200.0..=2000.0);
    let (angles, temperatures) = match (angles, temperatures) {
        (Some(angles), Some(temperatures)) => (angles, temperatures),
        // What is there and wrong has been told.
        (Some(_), None) if !section.has(TEMPERATURES) => {
            section.require(TEMPERATURES, "what the knob sets at each of `angles_deg`");
            return None;
        }
        (None, Some(_)) if !section.has(ANGLES) => {
            section.require(ANGLES, "where the knob sets each of `temperatures_degc`");
            return None;
        }
        _ => return None,
    };
    if angles.len() != temperatures.len() || angles.len() < 2 {
        let rule = format!("has {} values for {} angles", temperatures.len(), angles.len());
        section.reject(TEMPERATURES, rule, "write one temperature for each of `angles_deg`, two or more");
        return None;
    }
    let turned = |angle: &f64| own * angle;
    let way = if own > 0.0 { "rise from 0" } else { "fall from 0: an R FREE turns negative" };
    if !angles.windows(2).all(|pair| turned(&pair[1]) > turned(&pair[0])) || angles.iter().any(|a| turned(a) < 0.0) {
        section.reject(ANGLES, format!("must {way}, each further than the one before"), "write them in their order");
        return None;
    }
    if let Some(beyond) = angles.iter().find(|angle| turned(angle) > travel) {
        let [beyond, travel] = [*beyond, travel].map(Angle::radians);
        let rule = format!("goes to {beyond:.1}, and the knob's travel is {travel:.1}");
        section.reject(ANGLES, rule, "end the table at the stop, or correct travel_deg");
        return None;
    }
    let rows = angles.into_iter().zip(temperatures).collect();
    let table = Temperatures::new(rows);
    if table.is_none() {
        let rule = "must rise from each to the next, or fall: else a temperature has two angles";
        section.reject(TEMPERATURES, rule, "leave out the rows where it stands still or turns back");
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_sets_a_temperature_and_a_temperature_has_its_angle() {
        for (own, sign) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let rows = [(0.0, 20.0), (0.5, 80.0), (2.0, 230.0)].map(|(a, t)| (own * a, sign * t)).to_vec();
            let table = Temperatures::new(rows).unwrap();
            for (angle, temperature) in [(0.0, 20.0), (0.25, 50.0), (0.5, 80.0), (1.25, 155.0), (2.0, 230.0)] {
                assert!((table.at(own * angle) - sign * temperature).abs() < 1e-9, "{table:?}");
                assert!((table.angle(sign * temperature).unwrap() - own * angle).abs() < 1e-12, "{table:?}");
            }
            // Beyond the table the knob sets what its ends do; no angle sets anything else.
            assert_eq!((table.at(-own), table.at(9.0 * own)), (sign * 20.0, sign * 230.0));
            assert_eq!((table.angle(sign * 19.0), table.angle(sign * 231.0)), (None, None));
            assert!(table.at(f64::NAN).is_nan() && table.angle(f64::NAN).is_none());
        }
    }

    #[test]
    fn what_is_no_table_is_none() {
        for rows in [
            vec![],
            vec![(0.0, 20.0)],
            vec![(0.0, 20.0), (1.0, 20.0)],
            vec![(0.0, 20.0), (1.0, 60.0), (2.0, 50.0)],
            vec![(0.0, 20.0), (0.0, 60.0)],
            vec![(0.0, 20.0), (1.0, f64::NAN)],
        ] {
            assert_eq!(Temperatures::new(rows.clone()), None, "{rows:?}");
        }
    }
}

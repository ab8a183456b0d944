//! Whether the calibrations fit the rig as it is now: asked whenever it is armed.
//!
//! | what has changed since a value was measured | arming |
//! | --- | --- |
//! | the geometry that it was fitted with, by more than 1 % | refuses |
//! | the regulator, for the zero and span of an analogue one | refuses: the pressure behind a code is not known |
//! | the regulator, for everything else | warns |
//! | the IMU | warns (one whose saved profile is of another sensor is refused by its driver) |
//! | `soft_angle_deg` goes more than twice as far as the angles that it was measured over | warns |
//! | `max_pressure_psi` is more than three times the pressure that it was measured up to | warns |
//! | 1000 pressure cycles | warns |
//! | half a year | warns; age alone never refuses |

use std::collections::BTreeMap;

use jiff::civil::Date;

use super::cycles;
use crate::config::calibration::{Entry, keys};
use crate::config::{Conditions, Rig};
use crate::units::{Angle, Pressure};

/// A change of the geometry that matters: 1 % in the radius is 3 % in kt.
const GEOMETRY: f64 = 0.01;
/// How far beyond the angles that were measured the soft envelope may go. A staircase goes to where 70 % of it are
/// expected, and a FREE may be a third stiffer than it was believed to be.
const ANGLE: f64 = 2.0;
/// How far beyond the pressures that were measured the highest one may be.
const PRESSURE: f64 = 3.0;
/// Days after which a value is old.
const DAYS: i32 = 183;
/// Pressure cycles after which the rubber is another one.
const CYCLES: u64 = 1000;

/// What does not fit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Validity {
    /// What a person should know.
    pub warnings: Vec<String>,
    /// What is not to be armed with.
    pub refusals: Vec<String>,
}

/// What does not fit `rig` today.
pub fn of(rig: &Rig) -> Validity {
    check(rig, jiff::Zoned::now().date(), &cycles::counted(rig))
}

/// Which regulator the FREE `index` of `rig` has: `alicat A on line`, `channel B of 0x60 on main`, `pwm C on line`.
pub fn regulator(rig: &Rig, index: usize) -> Option<String> {
    let alicat = rig.wiring.serial.iter().flat_map(|line| line.units.iter().map(move |unit| (line, unit)));
    if let Some((line, unit)) = alicat.into_iter().find(|(_, unit)| unit.free == index && !unit.gauge) {
        return Some(format!("alicat {} on {}", char::from(unit.id), line.name));
    }
    super::calibration::channels::wired(rig).into_iter().find(|w| w.free == index).map(|w| w.channel)
}

/// What does not fit `rig` on the day `today`, when its FREEs have so many pressure `cycles` behind them.
pub fn check(rig: &Rig, today: Date, cycles: &[u64]) -> Validity {
    // By FREE and reason: the values that it is about.
    let mut found: BTreeMap<(usize, bool, String), Vec<&str>> = BTreeMap::new();
    for (index, known) in rig.calibrations.iter().enumerate() {
        for (name, entry, conditions) in known.conditions() {
            let cycles = cycles.get(index).copied().unwrap_or_default();
            for (refuses, reason) in reasons(rig, index, (name, entry), conditions, today, cycles) {
                found.entry((index, refuses, reason)).or_default().push(name);
            }
        }
    }
    let mut validity = Validity::default();
    for ((index, refuses, reason), names) in found {
        let text = format!("{}: {}: {reason}", rig.control.frees[index].name, names.join(", "));
        if refuses { validity.refusals.push(text) } else { validity.warnings.push(text) }
    }
    validity
}

/// Why a value does not fit, and whether that refuses.
fn reasons(
    rig: &Rig,
    index: usize,
    (name, entry): (&str, &Entry),
    conditions: &Conditions,
    today: Date,
    cycles: u64,
) -> Vec<(bool, String)> {
    let control = &rig.control.frees[index];
    let mut reasons = Vec::new();
    if let Some(fitted) = conditions.geometry {
        let free = &control.free;
        let gamma = rig.calibrations[index].value(&keys::WINDING_ANGLE).unwrap_or(free.gamma);
        let each = [
            (keys::WINDING_ANGLE.name, fitted.gamma, gamma, 180.0 / std::f64::consts::PI),
            (keys::LENGTH.name, fitted.length, free.length, 1e3),
            (keys::FIBER_RADIUS.name, fitted.radius, free.radius, 1e3),
        ];
        for (key, then, now, scale) in each.into_iter().filter(|(_, then, now, _)| (now / then - 1.0).abs() > GEOMETRY)
        {
            let (then, now) = (scale * then, scale * now);
            reasons.push((true, format!("fitted with {key} = {then:.3}, which is {now:.3} now: measure again")));
        }
    }
    let regulator = regulator(rig, index);
    if let (Some(then), Some(now)) = (&conditions.regulator, &regulator)
        && then != now
    {
        let analogue = [keys::ZERO_CODE.name, keys::PRESSURE_PER_CODE.name].contains(&name);
        reasons.push((analogue, format!("measured with the regulator {then}, and it is {now} now: measure again")));
    }
    let sensor = rig.calibrations[index].imu_profile.map(|profile| profile.unique_id);
    if let (Some(then), Some(now)) = (conditions.sensor, sensor)
        && then != now
    {
        reasons.push((false, "measured with another IMU".into()));
    }
    if let Some((low, high)) = conditions.angle {
        let (soft_low, soft_high) = control.limits.angle_soft;
        // In the FREE's own direction: the other one is not what pressure does.
        let (soft, measured) = if control.free.direction() > 0.0 { (soft_high, high) } else { (-soft_low, -low) };
        if soft > ANGLE * measured {
            let [soft, measured] = [soft, measured].map(Angle::radians);
            reasons
                .push((false, format!("measured up to {measured:.0}, and soft_angle_deg lets it turn to {soft:.0}")));
        }
    }
    if let Some((_, high)) = conditions.pressure
        && control.limits.pressure_max > PRESSURE * high
    {
        let [max, high] = [control.limits.pressure_max, high].map(Pressure::pascals);
        reasons.push((false, format!("measured up to {high:.1}, and max_pressure_psi is {max:.1}")));
    }
    if let Some(then) = conditions.cycles.filter(|then| cycles > then + CYCLES) {
        reasons.push((false, format!("measured {} pressure cycles ago", cycles - then)));
    }
    let date: Option<Date> = entry.date.as_deref().and_then(|date| date.parse().ok());
    if let Some(days) = date.map(|date| (today - date).get_days()).filter(|days| *days > DAYS) {
        reasons.push((false, format!("measured {days} days ago")));
    }
    reasons
}

//! Whisk files: the pressures of a module's four FREEs over one period, as `freerig plan whisk` writes them and
//! `freerig whisk` runs them.
//!
//! ```toml
//! kind = "whisk"
//! name = "eight"
//! periods = 3                    # how often in one run
//! lead_s = 2                     # from zero to the first pressures, and back
//! times_s = [0, 0.01, ...]       # over one period, from 0 on; pressures are linear in between
//! a_psi = [...]                  # as many for each of the module's FREEs A, B, C, D
//! b_psi = [...]
//! c_psi = [...]
//! d_psi = [...]
//! predicted_mm = [[x, y, z], ...]        # where the model puts the plate's centre; may be left out
//! planned_mm = [[x, y, z], ...]          # where it was wanted; may be left out
//! ```

use std::fmt::Write;

use super::axis::check_limits;
use super::calibration::quoted;
use super::reader::Section;
use super::rig::Rig;
use crate::signal::Quantity;
use crate::trajectory::{Axis, Segment, Sequence, Shape};
use crate::units::PASCAL_PER_PSI;

/// The keys of the four FREEs' pressures.
const COLUMNS: [&str; 4] = ["a_psi", "b_psi", "c_psi", "d_psi"];
/// Most samples of a period.
const SAMPLES: usize = 100_000;
/// Any pressure that the FREEs' limits judge, psi.
const ANY: std::ops::RangeInclusive<f64> = -1e4..=1e4;

/// A whisk. SI units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Whisk {
    /// What a person calls it.
    pub name: String,
    /// How often its period runs, at least once.
    pub periods: u32,
    /// From zero to the first pressures, and back, s.
    pub lead: f64,
    /// Over one period, rising from 0, s.
    pub times: Vec<f64>,
    /// Gauge pressures of A, B, C, D at these times, Pa.
    pub pressures: Vec<[f64; 4]>,
    /// Where the plate's centre was wanted, m, from the middle of the bases; empty where nothing was.
    pub planned: Vec<[f64; 3]>,
    /// Where the model puts it, m; empty where that is not known.
    pub predicted: Vec<[f64; 3]>,
}

impl Whisk {
    /// The file that says it; `remarks` stand at its head.
    pub fn to_toml(&self, remarks: &[String]) -> String {
        let mut text = String::new();
        let mut line = |line: String| {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{line}");
        };
        remarks.iter().flat_map(|remark| remark.lines()).for_each(|remark| line(format!("# {remark}")));
        line("kind = \"whisk\"".into());
        line(format!("name = {}", quoted(&self.name)));
        line(format!("periods = {}", self.periods));
        line(format!("lead_s = {}", rounded(self.lead)));
        let list = |values: &mut dyn Iterator<Item = String>| values.collect::<Vec<_>>().join(", ");
        line(format!("times_s = [{}]", list(&mut self.times.iter().map(|t| rounded(*t)))));
        for (index, key) in COLUMNS.iter().enumerate() {
            let psi = list(&mut self.pressures.iter().map(|p| rounded(p[index] / PASCAL_PER_PSI)));
            line(format!("{key} = [{psi}]"));
        }
        for (key, points) in [("planned_mm", &self.planned), ("predicted_mm", &self.predicted)] {
            if !points.is_empty() {
                let row = |p: &[f64; 3]| format!("[{}]", p.map(|x| rounded(1e3 * x)).join(", "));
                line(format!("{key} = [{}]", list(&mut points.iter().map(row))));
            }
        }
        text
    }

    /// Duration of one period, s.
    pub fn period(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Where the plate's centre is to go, m: where it was wanted, or else where the model puts it; as many points as
    /// times, or none.
    pub fn path(&self) -> &[[f64; 3]] {
        let whole = |points: &&Vec<[f64; 3]>| points.len() == self.times.len();
        [&self.planned, &self.predicted].into_iter().find(whole).map_or(&[], |points| points)
    }

    /// What is asked of the FREE `index` (0 to 3): up to the first pressure, the periods, and down again.
    fn axis(&self, index: usize) -> Option<Axis> {
        let column = || self.pressures.iter().map(|p| p[index]);
        let (first, last) = (column().next()?, column().next_back()?);
        let mut segments = vec![Segment::new(0.0, Shape::Quintic, first, self.lead)];
        let mut at = first;
        for _ in 0..self.periods {
            for (times, to) in self.times.windows(2).zip(column().skip(1)) {
                segments.push(Segment::new(at, Shape::Linear, to, times[1] - times[0]));
                at = to;
            }
        }
        segments.push(Segment::new(last, Shape::Quintic, 0.0, self.lead));
        Some(Axis { quantity: Quantity::Pressure, sequence: Sequence::new(segments).ok()? })
    }
}

/// Reads a whisk for the module of `rig`, and what it asks of every FREE; nothing where that is nothing sensible (which
/// has been noted).
pub(super) fn read_whisk(root: &mut Section<'_>, rig: &Rig) -> Option<(Whisk, Vec<(usize, Axis)>)> {
    let periods = root.integer("periods", 3, 1..=10_000) as u32;
    let lead = root.number("lead_s", 2.0, 0.1..=60.0);
    let times = root.numbers("times_s", 0.0..=86_400.0);
    let columns = COLUMNS.map(|key| root.numbers(key, ANY));
    let planned = points(root, "planned_mm");
    let predicted = points(root, "predicted_mm");
    let Some(module) = &rig.module else {
        root.reject(
            "kind",
            "needs a module, and the rig has none",
            "add a `[module]` to rig.toml, or name another rig",
        );
        return None;
    };
    let Some(times) = times else {
        root.require("times_s", "times over one period, from 0 on");
        return None;
    };
    let rising = times.first() == Some(&0.0) && times.windows(2).all(|t| t[1] > t[0]);
    if !rising || !(2..=SAMPLES).contains(&times.len()) {
        let rule = format!("must rise from 0 in 2 to {SAMPLES} times");
        root.reject("times_s", rule, "write the times of one period, in seconds");
        return None;
    }
    let mut pressures = vec![[0.0; 4]; times.len()];
    for (index, (key, column)) in COLUMNS.into_iter().zip(columns).enumerate() {
        let Some(column) = column else {
            root.require(key, "the pressures of this FREE, one for each of `times_s`");
            return None;
        };
        if column.len() != times.len() {
            let rule = format!("has {} values for {} times", column.len(), times.len());
            root.reject(key, rule, "write one pressure for each of `times_s`");
            return None;
        }
        for (row, pressure) in pressures.iter_mut().zip(column) {
            row[index] = pressure;
        }
    }
    for (key, points) in [("planned_mm", &planned), ("predicted_mm", &predicted)] {
        if points.len() > times.len() {
            let rule = format!("has {} points for {} times", points.len(), times.len());
            root.reject(key, rule, "write one point for each of `times_s`, or remove it");
        }
    }
    let whisk = Whisk { name: String::new(), periods, lead, times, pressures, planned, predicted };
    let mut axes = Vec::new();
    for (index, free) in module.frees.into_iter().enumerate() {
        let axis = whisk.axis(index)?;
        let control = &rig.control.frees[free];
        check_limits(root, control, &axis, COLUMNS[index]);
        check_slew(root, &whisk, index, control.limits.slew, &control.name);
        axes.push((free, axis));
    }
    Some((whisk, axes))
}

/// A regulator that is asked to be faster than it may lags behind, and the plate draws something else.
fn check_slew(root: &Section<'_>, whisk: &Whisk, index: usize, slew: f64, name: &str) {
    let rate = |(t, p): (&[f64], &[[f64; 4]])| (p[1][index] - p[0][index]).abs() / (t[1] - t[0]);
    let fastest = whisk.times.windows(2).zip(whisk.pressures.windows(2)).map(rate).fold(0.0, f64::max);
    if fastest > slew * (1.0 + 1e-6) {
        let (fastest, slew) = (fastest / PASCAL_PER_PSI, slew / PASCAL_PER_PSI);
        let rule = format!("changes by up to {fastest:.1} psi/s; `{name}` takes {slew:.1}");
        root.reject(COLUMNS[index], rule, "plan a slower or a smaller whisk, or raise slew_psi_per_s in rig.toml");
    }
}

/// Points in m; none where the key is not there.
fn points(root: &mut Section<'_>, key: &'static str) -> Vec<[f64; 3]> {
    let rows = root.rows(key, -1e4..=1e4);
    let mut points = Vec::with_capacity(rows.len());
    for row in rows {
        match <[f64; 3]>::try_from(row) {
            Ok(point) => points.push(point),
            Err(row) => {
                let rule = format!("has a point of {} numbers", row.len());
                root.reject(key, rule, "write three for each point: x, y, z in mm");
                return Vec::new();
            }
        }
    }
    points
}

/// A number of a file: a micrometre, a millionth of a psi and a microsecond are below everything that counts.
fn rounded(value: f64) -> String {
    let value = (value * 1e6).round() / 1e6;
    // No negative zero.
    format!("{}", value + 0.0)
}

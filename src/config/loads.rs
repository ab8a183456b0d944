//! Weights and torques of a script, in the order in which they are put on.

use std::ops::RangeInclusive;

use super::reader::Section;

/// A load of known size, and what was read under it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownLoad {
    /// Mass (kg) that hangs on the end, or moment (N m) about the axis.
    pub amount: f64,
    /// Pressure under it, Pa.
    pub pressure: f64,
    /// Length (m) or angle (rad) that was read; none where it is to be read now.
    pub reading: Option<f64>,
}

/// Reads `weights = [{ mass_g = 200, length_mm = 131.2, pressure_psi = 0 }, ...]`.
pub(super) fn read_weights(root: &mut Section<'_>) -> Vec<KnownLoad> {
    read(root, "weights", ("mass_g", 0.0..=1e5), ("length_mm", 1.0..=5000.0))
}

/// Reads `torques = [{ moment_mnm = 20, angle_deg = 13.1, pressure_psi = 0 }, ...]`.
pub(super) fn read_torques(root: &mut Section<'_>) -> Vec<KnownLoad> {
    read(root, "torques", ("moment_mnm", -1e5..=1e5), ("angle_deg", -900.0..=900.0))
}

type Quantity = (&'static str, RangeInclusive<f64>);

fn read(root: &mut Section<'_>, key: &'static str, amount: Quantity, reading: Quantity) -> Vec<KnownLoad> {
    let one = |mut section: Section<'_>| KnownLoad {
        amount: section.number(amount.0, None, amount.1.clone()),
        pressure: section.number("pressure_psi", 0.0, 0.0..=150.0),
        reading: section.optional_number(reading.0, reading.1.clone()),
    };
    let loads: Vec<KnownLoad> = root.sections(key).into_iter().map(one).collect();
    let read = loads.iter().filter(|load| load.reading.is_some()).count();
    if read != 0 && read != loads.len() {
        let rule = format!("{read} of {} have `{}`", loads.len(), reading.0);
        root.reject(key, rule, "write it for all of them, or for none: then they are read one after another");
    }
    loads
}

//! What a value of a calibration holds for: `[conditions.KEY]` in its file.
//!
//! ```toml
//! [conditions.torsional_stiffness_nm_per_rad]
//! pressure_psi = [0.0, 6.2]      # the range it was measured over
//! angle_deg = [0.0, 84.0]
//! winding_angle_deg = -40.0      # the geometry that it was fitted with
//! length_mm = 110.0
//! fiber_radius_mm = 7.0
//! regulator = "alicat A on line"
//! sensor_id = "00112233445566778899aabbccddeeff"
//! cycles = 12                    # pressure cycles that the FREE had behind it
//! ```

use super::calibration::{Calibration, Key, SCHEMA, hex, quoted, read_bytes};
use super::reader::Section;
use crate::units::PASCAL_PER_PSI;

/// Geometry that a value was fitted with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedGeometry {
    /// Winding angle, rad, with its sign.
    pub gamma: f64,
    /// Length at rest, m.
    pub length: f64,
    /// Radius of the fibres at rest, m.
    pub radius: f64,
}

/// What a value holds for; whatever is `None` does not matter to it, or is not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conditions {
    /// Lowest and highest pressure, Pa.
    pub pressure: Option<(f64, f64)>,
    /// Lowest and highest angle, rad.
    pub angle: Option<(f64, f64)>,
    /// Geometry.
    pub geometry: Option<FittedGeometry>,
    /// Which regulator.
    pub regulator: Option<String>,
    /// Unique number of the IMU.
    pub sensor: Option<[u8; 16]>,
    /// Pressure cycles of the FREE at that time.
    pub cycles: Option<u64>,
}

impl Conditions {
    /// The lines of its table.
    pub(super) fn lines(&self) -> impl Iterator<Item = String> {
        let span = |name: &str, range: Option<(f64, f64)>, scale: f64| {
            range.map(|(low, high)| format!("{name} = [{:?}, {:?}]", round(low / scale), round(high / scale)))
        };
        let deg = std::f64::consts::PI / 180.0;
        let [gamma, length, radius] = match self.geometry {
            Some(g) => [
                ("winding_angle_deg", g.gamma / deg),
                ("length_mm", 1e3 * g.length),
                ("fiber_radius_mm", 1e3 * g.radius),
            ]
            .map(|(name, value)| Some(format!("{name} = {:?}", round(value)))),
            None => [None, None, None],
        };
        [
            span("pressure_psi", self.pressure, PASCAL_PER_PSI),
            span("angle_deg", self.angle, deg),
            gamma,
            length,
            radius,
            self.regulator.as_ref().map(|text| format!("regulator = {}", quoted(text))),
            self.sensor.map(|id| format!("sensor_id = \"{}\"", hex(&id))),
            self.cycles.map(|cycles| format!("cycles = {cycles}")),
        ]
        .into_iter()
        .flatten()
    }
}

/// The conversion from and to SI leaves some noise at the end.
fn round(value: f64) -> f64 {
    (1e6 * value).round() / 1e6
}

/// Reads `[conditions.NAME]`; `None` where there is no such value.
pub(super) fn read_conditions(
    name: &str,
    mut section: Section<'_>,
    calibration: &Calibration,
) -> Option<(&'static Key, Conditions)> {
    let span = |section: &mut Section<'_>, key: &'static str, limit: f64| {
        section.expect(key);
        section.has(key).then(|| section.span(key, (0.0, 0.0), -limit..=limit))
    };
    let conditions = Conditions {
        pressure: span(&mut section, "pressure_psi", 1e3),
        angle: span(&mut section, "angle_deg", 1e4),
        geometry: geometry(&mut section),
        regulator: section.optional_text("regulator"),
        sensor: read_bytes(&mut section, "sensor_id"),
        cycles: {
            section.expect("cycles");
            section.has("cycles").then(|| section.integer("cycles", 0, 0..=i64::MAX) as u64)
        },
    };
    let key = SCHEMA.iter().find(|key| key.name == name && calibration.entry(key).is_some())?;
    Some((key, conditions))
}

/// All three or none.
fn geometry(section: &mut Section<'_>) -> Option<FittedGeometry> {
    // Each is read, whatever is wrong with the others: what nobody reads is an unknown key.
    let gamma = section.optional_number("winding_angle_deg", -89.0..=89.0);
    let length = section.optional_number("length_mm", 1.0..=2000.0);
    let radius = section.optional_number("fiber_radius_mm", 0.1..=200.0);
    Some(FittedGeometry { gamma: gamma?, length: length?, radius: radius? })
}

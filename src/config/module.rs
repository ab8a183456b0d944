//! `[module]` of rig.toml: four FREEs under one plate.

use nalgebra::{Vector2, Vector3};

use super::calibration::Calibration;
use super::free::{RawFree, RawImu, read_imu};
use super::reader::Section;
use super::sections::RawI2c;
use crate::fem::module::{Free, ModuleScene};
use crate::model::GRAVITY;

/// FREEs of a module.
pub const FREES: usize = 4;

/// Four FREEs on a square under one rigid plate, which carries the IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleConfig {
    /// The rig's indices of A, B, C, D: A at (+, +), then counter-clockwise about z, which runs from the bases to the
    /// plate.
    pub frees: [usize; FREES],
    /// Side of the square, centre to centre, m.
    pub spacing: f64,
    /// Mass of the plate with all that is fixed to it, kg.
    pub plate_mass: f64,
    /// Acceleration of gravity, m/s2: towards +z where the module hangs.
    pub gravity: Vector3<f64>,
    /// Damping ratio of the simulated plate's modes.
    pub damping: f64,
    /// What hangs on the simulated plate beyond its mass, kg.
    pub payload: f64,
}

impl ModuleConfig {
    /// The module that the calibrations of its FREEs describe.
    pub(super) fn scene<'c>(&self, calibration: impl Fn(usize) -> &'c Calibration) -> ModuleScene {
        let frees = self.frees.map(|index| {
            let known = calibration(index);
            let (tube, _) = known.tube();
            Free { tube, length: known.free().length, dead_length: 0.0, rest_curvature: Vector2::zeros() }
        });
        let zero = Vector3::zeros();
        ModuleScene {
            frees,
            spacing: self.spacing,
            plate_mass: self.plate_mass,
            force: zero,
            moment: zero,
            gravity: self.gravity,
        }
    }
}

/// `[module]`, and the plate's IMU.
#[derive(Debug)]
pub(super) struct RawModule {
    pub(super) config: ModuleConfig,
    pub(super) imu: Option<RawImu>,
}

/// Reads the module of `frees`; `None` where there is none, or too much is wrong with it.
pub(super) fn read_module(root: &mut Section<'_>, i2c: &[RawI2c], frees: &[RawFree]) -> Option<RawModule> {
    if !root.has("module") {
        root.expect("module");
        return None;
    }
    let mut section = root.section("module");
    let members = read_members(&mut section, frees);
    let spacing = section.number("spacing_mm", 20.0, 1.0..=500.0);
    let plate_mass = section.number("plate_mass_g", 10.0, 0.1..=5000.0);
    let directions = [("hanging", 1.0), ("standing", -1.0), ("none", 0.0)];
    let direction = section.choice("gravity", Some(1.0), &directions).unwrap_or(1.0);
    let imu = section.has("imu").then(|| read_imu(section.section("imu"), i2c, frees));
    if imu.is_none() {
        section.expect("imu");
    }
    let mut twin = section.section("sim");
    let damping = twin.number("damping_percent", 20.0, 1.0..=90.0);
    let payload = twin.number("payload_g", 0.0, 0.0..=5000.0);
    let members = members?;
    for index in members {
        let tube = frees[index].calibration.tube().0;
        let (width, mm) = (2.0 * tube.outer_radius(), 1e3);
        if spacing <= width {
            let rule =
                format!("FREE `{}` is {:.2} mm thick: its neighbour is in its place", frees[index].name, width * mm);
            section.reject(
                "spacing_mm",
                rule,
                "write the distance between the axes of neighbours, above their thickness",
            );
        }
    }
    let gravity = Vector3::z() * (direction * GRAVITY);
    Some(RawModule { config: ModuleConfig { frees: members, spacing, plate_mass, gravity, damping, payload }, imu })
}

fn read_members(section: &mut Section<'_>, frees: &[RawFree]) -> Option<[usize; FREES]> {
    const EXAMPLE: &str =
        "write for example `frees = [\"a\", \"b\", \"c\", \"d\"]`: A at (+, +), then counter-clockwise";
    let names = section.texts("frees");
    if names.is_empty() {
        section.require("frees", EXAMPLE);
        return None;
    }
    let known = || frees.iter().map(|free| free.name.as_str()).collect::<Vec<_>>().join(", ");
    let mut members = Vec::new();
    for name in &names {
        match frees.iter().position(|free| free.name == *name) {
            Some(index) if members.contains(&index) => {
                section.reject("frees", format!("FREE `{name}` is there twice"), EXAMPLE);
                return None;
            }
            Some(index) => members.push(index),
            None => {
                section.reject("frees", format!("there is no FREE `{name}`"), format!("write four of: {}", known()));
                return None;
            }
        }
    }
    for &index in &members {
        let free = &frees[index];
        if free.imu.is_some() {
            let rule = format!("FREE `{}` has an IMU of its own", free.name);
            section.reject("frees", rule, format!("remove [free.imu] of `{}`: the plate carries one", free.name));
        }
        if free.knob.is_some() {
            let rule = format!("FREE `{}` has a knob on its end", free.name);
            section.reject("frees", rule, format!("remove [free.knob] of `{}`: its end is on the plate", free.name));
        }
        if free.model {
            let rule = format!("FREE `{}` has `controller = \"model\"`, which is that of a single FREE", free.name);
            section.reject("frees", rule, "remove it: a module follows the pressures of its plan");
        }
    }
    let count = members.len();
    members.try_into().ok().or_else(|| {
        section.reject("frees", format!("a module has {FREES} FREEs, not {count}"), EXAMPLE);
        None
    })
}

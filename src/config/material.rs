//! `[material]` of a script: the files of a material calibration, and what was tested.
//!
//! ```toml
//! [material]
//! shore_a = 31                        # measured, to be held beside the estimate
//! tensile = [                         # one of each specimen
//!     { file = "dogbone.csv", gauge_length_mm = 33, area_mm2 = 12 },
//!     { file = "tube.csv", gauge_length_mm = 80, inner_diameter_mm = 9.52, wall_mm = 0.8 },
//! ]
//! [material.inflation]                # of a bare tube, closed and free unless held_stretch is given
//! file = "inflation.csv"
//! inner_diameter_mm = 9.52
//! wall_mm = 0.8
//! pressure_error_psi = 0.02           # standard deviation of a reading
//! radius_error_mm = 0.02
//! [material.fiber]
//! file = "fiber.csv"
//! length_mm = 100                     # where the table has elongations
//! fibers = 1                          # pulled together
//! ```
//!
//! The files' columns: `stretch` (or `strain`) and `stress_mpa`, or `elongation_mm` and `force_n`; `pressure_psi` and
//! `outer_radius_mm` (or `outer_diameter_mm`); `strain` (or `elongation_mm`) and `force_n`; each in any unit of its
//! kind.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use super::columns::Columns;
use super::problem::Problem;
use super::reader::Section;
use crate::fem::ends::End;
use crate::ident::material::{BareTube, FiberPoint, InflationPoint, ReadingErrors, TensilePoint};

/// A file of measured points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Test<P> {
    /// Its path.
    pub file: PathBuf,
    /// SHA-256 of it, hexadecimal.
    pub sha256: String,
    /// Line of each point.
    pub lines: Vec<usize>,
    /// The points, in their order.
    pub points: Vec<P>,
}

impl<P> Test<P> {
    /// Name of the file and the beginning of its hash: where a value comes from.
    pub fn source(&self) -> String {
        let name = self.file.file_name().unwrap_or_default().to_string_lossy();
        format!("{name} sha256:{}", self.sha256.get(..12).unwrap_or_default())
    }
}

/// What was tested, and what came of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Material {
    /// Tensile curves, one of each specimen.
    pub tensile: Vec<Test<TensilePoint>>,
    /// Inflation of a bare tube.
    pub inflation: Option<(Test<InflationPoint>, BareTube, ReadingErrors)>,
    /// Tensile test of a fibre.
    pub fiber: Option<Test<FiberPoint>>,
    /// Measured hardness.
    pub shore_a: Option<f64>,
}

/// Reads `[material]`; `base` is the script's folder. What is wrong with the tables goes to `problems`.
pub(super) fn read_material(mut section: Section<'_>, base: &Path, problems: &mut Vec<Problem>) -> Material {
    let tensile = section.sections("tensile");
    let tensile = tensile.into_iter().filter_map(|section| read_tensile(section, base, problems)).collect();
    let inflation = if section.has("inflation") {
        read_inflation(section.section("inflation"), base, problems)
    } else {
        section.expect("inflation");
        None
    };
    let fiber = if section.has("fiber") {
        read_fiber(section.section("fiber"), base, problems)
    } else {
        section.expect("fiber");
        None
    };
    let known = ["tensile", "inflation", "fiber"];
    if !known.iter().any(|key| section.has(key)) {
        section.require("tensile", "a list of tensile curves, or [material.inflation], or [material.fiber]");
    }
    Material { tensile, inflation, fiber, shore_a: section.optional_number("shore_a", 0.0..=99.0) }
}

fn read_table(section: &mut Section<'_>, base: &Path, problems: &mut Vec<Problem>) -> Option<(PathBuf, Columns)> {
    let name = section.text("file", "test.csv");
    if name.is_empty() {
        return None;
    }
    let path = base.join(name);
    match Columns::read(&path) {
        Ok(table) => Some((path, table)),
        Err(wrong) => {
            problems.extend(wrong);
            None
        }
    }
}

/// Section of a specimen, m2: as it is given, or that of a tube.
fn read_area(section: &mut Section<'_>) -> Option<f64> {
    let area = section.optional_number("area_mm2", 1e-3..=1e5);
    let tube =
        (section.optional_number("inner_diameter_mm", 0.1..=400.0), section.optional_number("wall_mm", 0.01..=50.0));
    match (area, tube) {
        (Some(area), (None, None)) => Some(area),
        (None, (Some(inner), Some(wall))) => Some(PI * wall * (inner + wall)),
        (None, (None, None)) => None,
        _ => {
            let rule = "either area_mm2, or both inner_diameter_mm and wall_mm of a tube";
            section.reject("area_mm2", rule, "keep one of the two");
            None
        }
    }
}

fn read_tensile(mut section: Section<'_>, base: &Path, problems: &mut Vec<Problem>) -> Option<Test<TensilePoint>> {
    let (length, area) = (section.optional_number("gauge_length_mm", 0.1..=1e4), read_area(&mut section));
    let (file, table) = read_table(&mut section, base, problems)?;
    let before = problems.len();
    let stretch = table
        .quantity("stretch", "", problems)
        .or_else(|| Some(table.quantity("strain", "", problems)?.into_iter().map(|e| 1.0 + e).collect::<Vec<_>>()));
    let stress = table.quantity("stress", "pressure", problems);
    let elongation = table.quantity("elongation", "length", problems);
    let force = table.quantity("force", "force", problems);
    let stretch = match (stretch, elongation) {
        (Some(stretch), _) => stretch,
        (None, Some(elongation)) => {
            let Some(length) = length else {
                section.require("gauge_length_mm", "the length at rest that the elongations belong to");
                return None;
            };
            elongation.into_iter().map(|e| 1.0 + e / length).collect()
        }
        (None, None) => {
            if problems.len() == before {
                table.lacks("`stretch`, `strain` or `elongation_mm`", problems);
            }
            return None;
        }
    };
    let stress = match (stress, force) {
        (Some(stress), _) => stress,
        (None, Some(force)) => {
            let Some(area) = area else {
                section
                    .require("area_mm2", "the section at rest that the forces act on (or a tube's diameter and wall)");
                return None;
            };
            force.into_iter().map(|f| f / area).collect()
        }
        (None, None) => {
            if problems.len() == before {
                table.lacks("`stress_mpa` or `force_n`", problems);
            }
            return None;
        }
    };
    table.above("stretch", &stretch, 0.0, problems);
    let points = stretch.into_iter().zip(stress).map(|(stretch, stress)| TensilePoint { stretch, stress }).collect();
    Some(Test { file, sha256: table.sha256.clone(), lines: table.lines(), points })
}

type Inflated = (Test<InflationPoint>, BareTube, ReadingErrors);

fn read_inflation(mut section: Section<'_>, base: &Path, problems: &mut Vec<Problem>) -> Option<Inflated> {
    let inner_radius = 0.5 * section.number("inner_diameter_mm", None, 0.1..=400.0);
    let wall = section.number("wall_mm", None, 0.01..=50.0);
    let axial = section.optional_number("held_stretch", 0.5..=3.0).map_or(End::Loaded(0.0), End::Held);
    let errors = ReadingErrors {
        pressure: section.number("pressure_error_psi", 0.02, 0.0..=10.0),
        radius: section.number("radius_error_mm", 0.02, 1e-4..=10.0),
    };
    let (file, table) = read_table(&mut section, base, problems)?;
    let before = problems.len();
    let pressure = table.quantity("pressure", "pressure", problems);
    let radius = table.quantity("outer_radius", "length", problems).or_else(|| {
        let diameter = table.quantity("outer_diameter", "length", problems)?;
        Some(diameter.into_iter().map(|d| 0.5 * d).collect::<Vec<_>>())
    });
    let (Some(pressure), Some(radius)) = (pressure, radius) else {
        if problems.len() == before {
            table.lacks("`pressure_psi` and `outer_radius_mm` (or `outer_diameter_mm`)", problems);
        }
        return None;
    };
    table.above("outer_radius", &radius, 0.0, problems);
    let points = pressure.into_iter().zip(radius);
    let points = points.map(|(pressure, outer_radius)| InflationPoint { pressure, outer_radius }).collect();
    let test = Test { file, sha256: table.sha256.clone(), lines: table.lines(), points };
    Some((test, BareTube { inner_radius, wall, axial }, errors))
}

fn read_fiber(mut section: Section<'_>, base: &Path, problems: &mut Vec<Problem>) -> Option<Test<FiberPoint>> {
    let length = section.optional_number("length_mm", 0.1..=1e4);
    let fibers = section.integer("fibers", 1, 1..=1000) as f64;
    let (file, table) = read_table(&mut section, base, problems)?;
    let before = problems.len();
    let strain = table.quantity("strain", "", problems);
    let elongation = table.quantity("elongation", "length", problems);
    let force = table.quantity("force", "force", problems);
    let strain = match (strain, elongation, length) {
        (Some(strain), ..) => Some(strain),
        (None, Some(elongation), Some(length)) => Some(elongation.into_iter().map(|e| e / length).collect()),
        (None, Some(_), None) => {
            section.require("length_mm", "the length at rest that the elongations belong to");
            return None;
        }
        (None, None, _) => None,
    };
    let (Some(strain), Some(force)) = (strain, force) else {
        if problems.len() == before {
            table.lacks("`strain` (or `elongation_mm`) and `force_n`", problems);
        }
        return None;
    };
    let points = strain.into_iter().zip(force).map(|(strain, force)| FiberPoint { strain, force: force / fibers });
    Some(Test { file, sha256: table.sha256.clone(), lines: table.lines(), points: points.collect() })
}

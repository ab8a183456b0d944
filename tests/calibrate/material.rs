//! `freerig calibrate material` as a user meets it: files of tests that textbook formulas made, with noise.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Output;

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;

use crate::harness::{self, freerig, refused};

const MU: f64 = 0.393e6;
const ALPHA: f64 = 1.2;
const EA: f64 = 644.0;
const INNER: f64 = 4.76e-3;
const OUTER: f64 = INNER + 0.8e-3;
const PSI: f64 = 6894.757293168;

const SCRIPT: &str = "\
[material]
shore_a = 31
tensile = [
    { file = \"dogbone.csv\", gauge_length_mm = 33, area_mm2 = 12 },
    { file = \"tube.csv\", gauge_length_mm = 80, inner_diameter_mm = 9.52, wall_mm = 0.8 },
]
[material.inflation]
file = \"inflation.csv\"
inner_diameter_mm = 9.52
wall_mm = 0.8
held_stretch = 1
[material.fiber]
file = \"fiber.csv\"
length_mm = 100
fibers = 2
";

fn normal(rng: &mut Pcg64Mcg) -> f64 {
    StandardNormal.sample(rng)
}

/// Force over elongation of a specimen, N and mm.
fn tension(length: f64, area: f64, mu: f64, rng: &mut Pcg64Mcg) -> String {
    let mut text = String::from("# testing machine\ntime_s,elongation_mm,force_n\n");
    for i in 0..=150 {
        let l = 1.0 + f64::from(i) / 150.0;
        let stress = 2.0 * mu / ALPHA * (l.powf(ALPHA - 1.0) - l.powf(-0.5 * ALPHA - 1.0)) + 500.0 * normal(rng);
        writeln!(text, "{i},{:.4},{:.5}", 1e3 * length * (l - 1.0), stress * area).unwrap();
    }
    text
}

/// Pressure of a tube of fixed length: the energy's slope by the volume, by midpoints through the wall.
fn pressure(outer: f64) -> f64 {
    let energy = |outer: f64| -> f64 {
        let at = |i: i32| {
            let rest = INNER + 0.8e-3 * (f64::from(i) + 0.5) / 200.0;
            let hoop = (outer * outer - OUTER * OUTER + rest * rest).sqrt() / rest;
            let sum = hoop.powf(ALPHA) + hoop.powf(-ALPHA) - 2.0;
            2.0 * MU / (ALPHA * ALPHA) * sum * 2.0 * PI * rest * 0.8e-3 / 200.0
        };
        (0..200).map(at).sum()
    };
    let h = 1e-4 * OUTER;
    (energy(outer + h) - energy(outer - h)) / (2.0 * h) / (2.0 * PI * outer)
}

fn inflation(rng: &mut Pcg64Mcg) -> String {
    let mut text = String::from("pressure_psi,outer_diameter_mm\n");
    for i in 0..=24 {
        let outer = OUTER * (1.0 + 0.03 * f64::from(i));
        let (p, r) = (pressure(outer) + 100.0 * normal(rng), outer + 1e-5 * normal(rng));
        writeln!(text, "{:.4},{:.4}", p / PSI, 2e3 * r).unwrap();
    }
    text
}

/// Two fibres pulled together, slack to 0.5 % at a fifth of the stiffness.
fn fiber(rng: &mut Pcg64Mcg) -> String {
    let mut text = String::from("elongation_mm,force_n\n");
    for i in 0..=60 {
        let strain = 4e-4 * f64::from(i);
        let one = 0.2 * EA * strain.min(0.005) + EA * (strain - 0.005).max(0.0);
        writeln!(text, "{:.4},{:.4}", 100.0 * strain, 2.0 * one + 0.02 * normal(rng)).unwrap();
    }
    text
}

/// A folder with the example rig, the tests' files and their script.
fn bench() -> tempfile::TempDir {
    let folder = harness::bench();
    let rng = &mut Pcg64Mcg::seed_from_u64(11);
    let area = PI * (OUTER * OUTER - INNER * INNER);
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
    // Specimens of a batch differ: by 1 % up and down.
    write("dogbone.csv", tension(33e-3, 12e-6, 1.01 * MU, rng));
    write("tube.csv", tension(80e-3, area, 0.99 * MU, rng));
    write("inflation.csv", inflation(rng));
    write("fiber.csv", fiber(rng));
    write("tests.toml", SCRIPT.into());
    folder
}

fn calibrate(folder: &Path) -> Output {
    freerig(folder, &["calibrate", "material", "--free", "paper", "--script", "tests.toml", "--json"])
}

fn edit(folder: &Path, file: &str, from: &str, to: &str) {
    let path = folder.join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn the_papers_material_comes_out_of_files_within_its_uncertainty() {
    let folder = bench();
    let output = calibrate(folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    let of = |key: &str| {
        let value = found["values"].as_array().unwrap().iter().find(|v| v["key"] == key).unwrap();
        (value["value"].as_f64().unwrap(), value["standard_uncertainty"].as_f64().unwrap())
    };
    let truths = [
        ("youngs_modulus_mpa", 3e-6 * MU),
        ("shear_modulus_mpa", 1e-6 * MU),
        ("ogden_exponent", ALPHA),
        ("fiber_stiffness_n", EA),
    ];
    for (key, truth) in truths {
        let (value, uncertainty) = of(key);
        println!("{key} {value} +- {uncertainty}, truth {truth}");
        // Three standard uncertainties, and they are worth something: 3 % (a quarter of alpha, for two specimens know
        // mu to 2 %).
        assert!((value - truth).abs() < 3.0 * uncertainty, "{key} {value} +- {uncertainty}, not {truth}");
        assert!(uncertainty < if key == "ogden_exponent" { 0.3 } else { 0.03 * truth }, "{key} {uncertainty}");
    }
    // Gent: 1.18 MPa are 30.8, and E is known as well as it is.
    let (shore, uncertainty) = of("shore_a_estimate");
    assert!((shore - 30.8).abs() < 3.0 * uncertainty && uncertainty < 1.0, "{found}");
    let laws = found["laws"].as_array().unwrap();
    let best = |test: &str| laws.iter().find(|row| row["test"] == test).unwrap()["law"].as_str().unwrap().to_owned();
    assert_eq!((laws.len(), best("tension").as_str(), best("inflation").as_str()), (6, "Ogden", "Ogden"));
    let text = fs::read_to_string(folder.path().join("calibration/paper.toml")).unwrap();
    for part in ["[material]", "dogbone.csv sha256:", "tube.csv sha256:", "inflation.csv sha256:", "fiber.csv sha256:"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("SIMULATED") && freerig(folder.path(), &["config", "check"]).status.success(), "{text}");
    let page = fs::read_to_string(folder.path().join(found["report"].as_str().unwrap())).unwrap();
    assert!(page.matches("<svg").count() == 6 && page.contains("neo-Hookean") && page.contains("Shore A"));
}

#[test]
fn without_a_rig_the_calibration_is_found_by_its_name() {
    let folder = bench();
    fs::remove_file(folder.path().join("rig.toml")).unwrap();
    assert!(calibrate(folder.path()).status.success());
    let lone = freerig(folder.path(), &["calibrate", "material", "--script", "tests.toml"]);
    refused(&lone, 2, &["rig.toml"]);
    let other = freerig(folder.path(), &["calibrate", "material", "--free", "other", "--script", "tests.toml"]);
    refused(&other, 2, &["other.toml"]);
}

#[test]
fn files_that_are_wrong_are_named_with_line_column_value_and_remedy() {
    let before = fs::read_to_string(bench().path().join("calibration/paper.toml")).unwrap();
    let cases: [(&str, &str, &str, i32, &[&str]); 9] = [
        (
            "dogbone.csv",
            "\n3,0.6600,",
            "\n3,0.66O0,",
            2,
            &["dogbone.csv:6", "elongation_mm = 0.66O0", "must be a number", "remedy"],
        ),
        (
            "tube.csv",
            "elongation_mm",
            "elongation",
            2,
            &["tube.csv:2", "elongation", "unit of length", "`elongation_mm`"],
        ),
        ("tube.csv", "force_n", "load_n", 2, &["tube.csv:2", "`force_n`", "load_n"]),
        ("fiber.csv", "elongation_mm,force_n\n", "", 2, &["fiber.csv:1", "must name the columns"]),
        ("tests.toml", "gauge_length_mm = 33, ", "", 2, &["tests.toml:4", "gauge_length_mm", "is required"]),
        ("tests.toml", "fiber.csv", "fibre.csv", 2, &["fibre.csv", "cannot read"]),
        (
            "tests.toml",
            "wall_mm = 0.8\nheld",
            "wall_in = 0.8\nheld",
            2,
            &["material.inflation.wall_in", "unknown key", "wall_mm"],
        ),
        // A diameter taken for a radius: the bore of this tube would be closed.
        (
            "inflation.csv",
            "outer_diameter_mm",
            "outer_diameter_cm",
            1,
            &["inflation.csv", "least outer radius is 55.", "at rest 5.560 mm"],
        ),
        (
            "inflation.csv",
            "outer_diameter_mm\n",
            "outer_diameter_mm\n0.1,4.0\n",
            1,
            &["inflation.csv:2", "no equilibrium"],
        ),
    ];
    for (file, from, to, status, words) in cases {
        let folder = bench();
        edit(folder.path(), file, from, to);
        refused(&calibrate(folder.path()), status, words);
        assert_eq!(fs::read_to_string(folder.path().join("calibration/paper.toml")).unwrap(), before);
    }
}

#[test]
fn tests_that_do_not_carry_a_value_are_refused_by_name() {
    let folder = bench();
    // Stretched to 15 % only.
    let short: String = fs::read_to_string(folder.path().join("tube.csv"))
        .unwrap()
        .lines()
        .take(25)
        .fold(String::new(), |text, line| text + line + "\n");
    fs::write(folder.path().join("tube.csv"), short).unwrap();
    refused(&calibrate(folder.path()), 1, &["tube.csv", "specimen 2", "an exponent needs 0.2", "test again"]);
    fs::write(folder.path().join("tests.toml"), "ready = []\n").unwrap();
    refused(&calibrate(folder.path()), 2, &["tests.toml", "[material]"]);
}

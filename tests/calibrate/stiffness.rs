//! ke and kt by known loads, pressure cycles, and what a calibration holds for, as a user meets them on the simulated
//! rig.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Output;

use freerig::config::Rig;
use freerig::daemon::validity;
use freerig::sim::Plant;
use serde_json::Value;

use crate::harness::{bench, freerig, json, refused};

const KE: &str = "axial_stiffness_n_per_m";
const KT: &str = "torsional_stiffness_nm_per_rad";
const BY_TORQUES: &str = "torsional_stiffness_by_torques_nm_per_rad";

fn calibrate(folder: &Path) -> Output {
    freerig(folder, &["calibrate", "stiffness", "--stepped", "--script", "loads.toml", "--json"])
}

fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// A script with these loads up and down at these pressures.
fn loads(key: &str, quantity: &str, loads: &[f64], psi: &[f64]) -> String {
    let mut text = format!("{key} = [\n");
    for pressure in psi {
        for load in loads {
            writeln!(text, "    {{ {quantity} = {load:?}, pressure_psi = {pressure:?} }},").unwrap();
        }
    }
    text + "]\n"
}

fn value(found: &Value, key: &str) -> (f64, f64) {
    let value = found["values"].as_array().unwrap().iter().find(|v| v["key"] == key).unwrap_or_else(|| panic!("{key}"));
    (value["value"].as_f64().unwrap(), value["standard_uncertainty"].as_f64().unwrap())
}

#[test]
fn weights_and_torques_find_the_true_stiffnesses_whatever_the_radius() {
    let folder = bench();
    let psi = [0.0, 1.5, 3.0];
    let weights = loads("weights", "mass_g", &[0.0, 1000.0, 2000.0, 3000.0, 2000.0, 1000.0, 0.0], &psi);
    let torques = loads("torques", "moment_mnm", &[0.0, 10.0, 20.0, 30.0, 20.0, 10.0, 0.0], &psi);
    fs::write(folder.path().join("loads.toml"), format!("ready = [\"stiffness\"]\n{weights}{torques}")).unwrap();
    let truth = *Plant::new(&Rig::load(&folder.path().join("rig.toml")).unwrap().bench).true_free(0).unwrap();
    let found = json(&calibrate(folder.path()));
    let ((ke, u_ke), (kt, u_kt), (steps, _)) = (value(&found, KE), value(&found, BY_TORQUES), value(&found, KT));
    println!("ke {ke:.0} +- {u_ke:.0}, true {:.0}", truth.axial_stiffness);
    println!("kt {kt:.5} +- {u_kt:.5} by torques, {steps:.5} by steps, true {:.5}", truth.torsional_stiffness);
    println!("{:#}", found["remarks"]);
    // 0.2 mm of reading error on 2.9 mm.
    assert!((ke - truth.axial_stiffness).abs() < 3.0 * u_ke && u_ke < 0.08 * ke, "{found}");
    assert!((kt - truth.torsional_stiffness).abs() < 3.0 * u_kt && u_kt < 0.02 * kt, "{found}");
    // The staircase is off by what radius and winding angle are off by; torques are not.
    assert!(
        (steps / truth.torsional_stiffness - 1.0).abs() > 3.0 * (kt / truth.torsional_stiffness - 1.0).abs(),
        "{found}"
    );
    let remarks = found["remarks"].to_string();
    assert!(remarks.contains("steps of pressure") && remarks.contains("fibre radius"), "{remarks}");
    assert!(remarks.contains("ke varies by") && remarks.contains("over 3 pressures"), "{remarks}");
    let text = fs::read_to_string(folder.path().join("calibration/paper.toml")).unwrap();
    for part in [
        "SIMULATED: least squares over 21 known weights",
        "simulated_nominal = 10110.0",
        "[conditions.axial_stiffness_n_per_m]",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let page = fs::read_to_string(folder.path().join(found["report"].as_str().unwrap())).unwrap();
    assert!(page.matches("<svg").count() == 7 && page.contains("Known torques"), "{}", page.len());
    assert!(freerig(folder.path(), &["config", "check"]).status.success());
}

#[test]
fn readings_that_stand_in_the_script_are_taken_as_they_are() {
    let folder = bench();
    let mut text = String::from("ready = [\"stiffness\"]\nweights = [\n");
    for grams in [0.0, 500.0, 1000.0, 1500.0, 1000.0, 500.0, 0.0] {
        // 9 kN/m; a ruler whose zero is anywhere.
        writeln!(text, "{{ mass_g = {grams:?}, length_mm = {:?} }},", 131.2 + 1e3 * 9.81e-3 * grams / 9000.0).unwrap();
    }
    fs::write(folder.path().join("loads.toml"), text + "]\n").unwrap();
    let found = json(&calibrate(folder.path()));
    let (ke, _) = value(&found, KE);
    assert!((ke / 9000.0 - 1.0).abs() < 1e-9, "{found}");
    assert!(found["remarks"].to_string().contains("whether it varies with the pressure needs 3"), "{found}");
}

#[test]
fn loads_that_cannot_be_are_refused_before_anything_moves() {
    let folder = bench();
    let file = folder.path().join("calibration/paper.toml");
    let before = fs::read_to_string(&file).unwrap();
    let cases: [(&str, i32, &[&str]); 6] = [
        ("torques = [{ moment_mnm = 300 }]", 1, &["300.0 mN m", "would turn it to", "beyond"]),
        ("weights = [{ mass_g = 10, pressure_psi = 9.5 }]", 1, &["9.50 psi", "beyond"]),
        ("weights = [{ mass_g = 10 }, { mass_g = 20, length_mm = 3 }]", 2, &["loads.toml", "1 of 2 have `length_mm`"]),
        ("weights = [{ mass_g = -10 }]", 2, &["loads.toml:2", "mass_g = -10", "within 0 to"]),
        ("weights = [{ mass_kg = 1 }]", 2, &["mass_kg", "mass_g = 1000"]),
        ("torques = 3", 2, &["torques = 3", "list of tables"]),
    ];
    for (loads, status, words) in cases {
        fs::write(folder.path().join("loads.toml"), format!("ready = [\"stiffness\"]\n{loads}\n")).unwrap();
        refused(&calibrate(folder.path()), status, words);
        assert!(!folder.path().join("runs").exists(), "{loads}: something has moved");
    }
    // Up only: told once they have been fitted, and nothing is written.
    let up = loads("weights", "mass_g", &[0.0, 500.0, 1000.0, 1500.0, 2000.0, 2500.0], &[0.0]);
    fs::write(folder.path().join("loads.toml"), format!("ready = [\"stiffness\"]\n{up}")).unwrap();
    refused(&calibrate(folder.path()), 1, &["the weights", "never falls", "up and down"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), before);
}

#[test]
fn pressure_cycles_are_counted_over_runs_and_shown() {
    let folder = bench();
    let rig = folder.path().join("rig.toml");
    edit(&rig, "max_pressure_psi = 10 ", "max_pressure_psi = 4 ");
    edit(&rig, "warn_pressure_psi = 10.5", "warn_pressure_psi = 4.5");
    edit(&rig, "hard_pressure_psi = 11", "hard_pressure_psi = 5");
    // Over 2 psi (half), once to 1.5 psi only, once down to 1.2 psi (not below a quarter): two cycles.
    let experiment = "kind = \"sweep\"\npressures_psi = [3, 0, 1.5, 0, 3, 1.2, 3, 0]\nmove_s = 0.5\nhold_s = 0.5\nand_back = false\n";
    fs::write(folder.path().join("cycles.toml"), experiment).unwrap();
    for _ in 0..2 {
        let run = freerig(folder.path(), &["sweep", "cycles.toml", "--stepped"]);
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    }
    let counts = json(&freerig(folder.path(), &["runs", "--json"]))["pressure_cycles"].clone();
    assert_eq!(
        (counts["simulated"]["paper"].as_u64(), counts["hardware"]["paper"].as_u64()),
        (Some(4), None),
        "{counts}"
    );
    let text = freerig(folder.path(), &["runs"]);
    assert!(String::from_utf8_lossy(&text.stderr).contains("SIMULATED paper: 4 pressure cycles"));
}

#[test]
fn arming_asks_whether_the_calibration_fits_the_rig() {
    let folder = bench();
    let file = folder.path().join("calibration/paper.toml");
    let conditions = format!(
        "{}\n[conditions.{KT}]\npressure_psi = [0.0, 6.0]\nangle_deg = [-0.5, 65.0]\nwinding_angle_deg = -40.0\n\
         length_mm = 110.0\nfiber_radius_mm = 7.0\nregulator = \"alicat A on line\"\ncycles = 10\n",
        fs::read_to_string(&file)
            .unwrap()
            .replace("method = \"identified by the paper's authors\" }", "method = \"test\", date = \"2026-01-31\" }")
    );
    fs::write(&file, &conditions).unwrap();
    let path = folder.path().join("rig.toml");
    let check = |day: &str, cycles: u64| {
        let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
        // What is read is written again, word for word.
        assert!(
            rig.calibrations[0]
                .to_toml()
                .contains(&conditions[conditions.find("[conditions").unwrap()..].trim_end().to_owned())
        );
        validity::check(&rig, day.parse().unwrap(), &[cycles])
    };
    assert_eq!(check("2026-02-01", 900), validity::Validity::default());
    // Age and wear warn and never refuse.
    let old = check("2027-03-01", 5000);
    assert_eq!((old.warnings.len(), old.refusals.len()), (2, 0), "{old:?}");
    assert!(
        old.warnings.concat().contains("4990 pressure cycles ago") && old.warnings.concat().contains("394 days ago"),
        "{old:?}"
    );
    edit(&path, "soft_angle_deg = [-120, 120]", "soft_angle_deg = [-120, 140]");
    let wide = check("2026-02-01", 10);
    assert!(wide.warnings.concat().contains("measured up to 65 deg") && wide.refusals.is_empty(), "{wide:?}");
    edit(&path, "unit = \"A\"", "unit = \"B\"");
    assert!(check("2026-02-01", 10).warnings.concat().contains("alicat B on line"));
    // Another radius is another FREE: 3 % are 9 % in kt.
    edit(&file, "fiber_radius_mm = { value = 7.0", "fiber_radius_mm = { value = 7.2");
    let step = freerig(folder.path(), &["step", "--angles", "10deg", "--stepped"]);
    refused(&step, 1, &[KT, "fitted with fiber_radius_mm = 7.000, which is 7.200 now", "[conditions.KEY]"]);
    edit(&file, &format!("[conditions.{KT}]"), "[conditions.torsional]");
    refused(&freerig(folder.path(), &["config", "check"]), 2, &["no value `torsional`", "remove the table"]);
}

#[test]
fn a_free_of_the_other_hand_is_recognised_and_refused() {
    let folder = bench();
    let path = folder.path().join("calibration/paper.toml");
    // What hangs there is an L FREE, as in the paper; the calibration says R.
    let wound = "winding_angle_deg = { value = -40.0";
    edit(&path, wound, "winding_angle_deg = { value = 40.0, simulated_nominal = -40.0");
    let before = fs::read(&path).unwrap();
    let sweep = freerig(folder.path(), &["calibrate", "stiffness", "--stepped"]);
    let rule = "an R FREE, which turns negative under pressure";
    refused(
        &sweep,
        1,
        &["`paper` turned to ", "winding angle of 40.0 deg", rule, "sign of winding_angle_deg", "untouched"],
    );
    // The IMU sees the same turn first; it may as well sit upside down.
    let imu = freerig(folder.path(), &["calibrate", "imu", "--stepped"]);
    refused(&imu, 1, &["axis = [0, 0, -1]", "if not, `paper` is of the other hand", rule]);
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn a_free_on_a_plate_has_no_stiffness_to_be_seen() {
    let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments/cook/rig.toml");
    let rig = rig.to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    for what in ["stiffness", "damping"] {
        let output = freerig(folder.path(), &["calibrate", what, "--free", "a", "--stepped", "--rig", rig]);
        refused(&output, 1, &["the end of `a` is on its module's plate", "before it is mounted"]);
    }
}

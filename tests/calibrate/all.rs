//! `freerig calibrate` and `freerig tune` as a user meets them, on the simulated rig.

use std::fs;
use std::path::Path;

use crate::harness::{bench, freerig, json, refused};

const KT: &str = "torsional_stiffness_nm_per_rad";

fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(path, text.replace(from, to)).unwrap();
}

#[test]
fn a_stiffness_is_measured_written_and_the_simulated_free_stays_what_it_is() {
    let folder = bench();
    let calibrate =
        || json(&freerig(folder.path(), &["calibrate", "stiffness", "--free", "paper", "--stepped", "--json"]));
    let first = calibrate();
    let file = folder.path().join("calibration/paper.toml");
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(first["simulated"], true);
    let value = &first["values"][0];
    let (kt, uncertainty) = (value["value"].as_f64().unwrap(), value["standard_uncertainty"].as_f64().unwrap());
    assert_eq!((value["key"].as_str(), value["before"].as_f64()), (Some(KT), Some(0.086)));
    // The simulated FREE is not the nominal one, and the fit knows how well it knows it.
    assert!((kt / 0.086 - 1.0).abs() > 0.01 && uncertainty > 0.0 && uncertainty < 0.01 * kt, "{value}");
    for part in ["[hysteresis]", "SIMULATED: ", "simulated_nominal = 0.086", "standard_uncertainty", "run = "] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let page = fs::read_to_string(folder.path().join(first["report"].as_str().unwrap())).unwrap();
    assert!(page.contains("SIMULATED") && page.contains("<svg"));
    // Measured again from what was measured: the start does not show in the result.
    let nominals = |text: &str| -> Vec<String> {
        let with = text
            .lines()
            .filter_map(|line| Some((line.split_once(" =")?.0, line.split_once("simulated_nominal = ")?.1)));
        with.map(|(key, rest)| format!("{key} = {}", rest.split([',', ' ']).next().unwrap_or(rest))).collect()
    };
    let (before, second) = (nominals(&text), calibrate());
    // What the simulated FREE is scattered around is no matter of how often it is measured, and of no measurement.
    assert_eq!(nominals(&fs::read_to_string(&file).unwrap()), before);
    let angle = before.iter().find_map(|line| line.strip_prefix("effective_winding_angle_deg = ")).unwrap();
    assert!((angle.parse::<f64>().unwrap() + 40.0).abs() < 1e-9, "{before:?}");
    let again = second["values"][0]["value"].as_f64().unwrap();
    assert!((again - kt).abs() < 3.0 * uncertainty, "{kt} {again} {uncertainty}");
    assert!(fs::read_to_string(&file).unwrap().contains("simulated_nominal = 0.086"));
    // What was measured on a simulated FREE is not for a real one.
    edit(&folder.path().join("rig.toml"), "backend = \"sim\"", "backend = \"linux\"");
    refused(&freerig(folder.path(), &["config", "check"]), 2, &["simulated FREE", KT, "freerig calibrate"]);
}

#[test]
fn a_calibration_that_ends_in_a_fault_leaves_the_old_one_as_it_was() {
    let folder = bench();
    let file = folder.path().join("calibration/paper.toml");
    // Believed to be four times as stiff as it is: it turns beyond its soft envelope.
    edit(&file, &format!("{KT} = {{ value = 0.086,"), &format!("{KT} = {{ value = 0.35, simulated_nominal = 0.086,"));
    let before = fs::read_to_string(&file).unwrap();
    let output = freerig(folder.path(), &["calibrate", "stiffness", "--stepped"]);
    refused(&output, 3, &["angle_limit"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), before);
}

#[test]
fn answers_come_from_a_script_and_a_wrong_one_is_named() {
    let folder = bench();
    let script = folder.path().join("answers.toml");
    let calibrate = || freerig(folder.path(), &["calibrate", "stiffness", "--stepped", "--script", "answers.toml"]);
    refused(&calibrate(), 2, &["answers.toml"]);
    fs::write(&script, "ready = [\"stifness\"]\n").unwrap();
    refused(&calibrate(), 2, &["answers.toml:1", "stifness", "write some of: imu, regulator, stiffness, damping"]);
    fs::write(&script, "ready = []\n").unwrap();
    refused(&calibrate(), 2, &["stiffness", "ready", "hangs free"]);
    refused(&freerig(folder.path(), &["calibrate", "stiffness", "--free", "other"]), 2, &["`other`", "paper"]);
}

#[test]
fn tuned_gains_have_the_margins_asked_for_and_can_be_used() {
    let folder = bench();
    let tuned = json(&freerig(folder.path(), &["tune", "--free", "paper", "--gain-margin", "4", "--write", "--json"]));
    let row = &tuned["tuned"];
    assert!(row["gain_margin"].as_f64().unwrap() > 0.98 * 4.0 && row["phase_margin_deg"].as_f64().unwrap() >= 60.0);
    assert!(row["spectral_radius"].as_f64().unwrap() < 1.0 && tuned["damping_ratio"].as_f64().unwrap() >= 0.7);
    let unstable = tuned["beside"].as_array().unwrap().iter().find(|r| r["name"] == "paper-pi").unwrap();
    assert_eq!(unstable["stable"], false);
    let page = fs::read_to_string(folder.path().join(tuned["report"].as_str().unwrap())).unwrap();
    assert!(tuned["simulated"] == true && page.contains("SIMULATED"));
    assert!(page.contains("Root locus") && page.matches("<svg").count() == 2);
    edit(&folder.path().join("rig.toml"), "gains = \"freerig\"", "gains = \"tuned-model\"");
    let used = json(&freerig(folder.path(), &["tune", "--json"]));
    assert!(used["beside"].as_array().unwrap().iter().all(|r| r["name"] != "tuned-model"));
    assert!(freerig(folder.path(), &["config", "check"]).status.success());
    refused(&freerig(folder.path(), &["tune", "--damping", "2"]), 2, &["damping", "2", "between 0 and 1"]);
}

#[test]
fn the_regulators_lag_and_dead_time_are_measured_through_line_and_device() {
    let folder = bench();
    // The calibration knows neither; the simulated regulator has 60 and 15 ms.
    let file = folder.path().join("calibration/paper.toml");
    edit(&file, "lag_ms = { value = 60.0,", "lag_ms = { value = 100.0,");
    edit(&file, "dead_time_ms = { value = 15.0,", "dead_time_ms = { value = 30.0,");
    let found = json(&freerig(folder.path(), &["calibrate", "regulator", "--stepped", "--json"]));
    let of = |key: &str| {
        let values = found["values"].as_array().unwrap();
        values.iter().find(|v| v["key"] == key).unwrap()["value"].as_f64().unwrap()
    };
    // When a command is taken up within a tick (2 ms) is not recorded, and 1 % of the lag for the device's turns.
    assert!((of("lag_ms") - 60.0).abs() < 1.2, "{found}");
    assert!((of("dead_time_ms") - 15.0).abs() < 1.0, "{found}");
    let page = fs::read_to_string(folder.path().join(found["report"].as_str().unwrap())).unwrap();
    assert!(page.contains("SIMULATED") && page.contains("span"));

    // The simulated regulator fills by 30 psi/s at most. Where no step up shows that, a slower fall is not put in its
    // place: the interlocks grow a stale pressure by it.
    freerig(folder.path(), &["calibrate", "regulator", "--stepped", "--json"]);
    let known: toml::Table = fs::read_to_string(&file).unwrap().parse().unwrap();
    let fill = known["regulator"]["fastest_fill_psi_per_s"]["value"].as_float().unwrap();
    assert!((fill - 30.0).abs() < 1.0, "{fill}");
}

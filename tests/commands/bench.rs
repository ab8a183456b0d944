//! `freerig bench` in a reduced size: its JSON, its files, and what its rows must say.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// A suite's rows, and what it leaves in the runs' folder.
fn bench(suite: &str, count: &str) -> (Vec<Value>, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::copy(source.join("rig.toml"), folder.path().join("rig.toml")).unwrap();
    std::fs::create_dir(folder.path().join("calibration")).unwrap();
    for file in std::fs::read_dir(source.join("calibration")).unwrap().flatten() {
        std::fs::copy(file.path(), folder.path().join("calibration").join(file.file_name())).unwrap();
    }
    let output = Command::new(env!("CARGO_BIN_EXE_freerig"))
        .args(["bench", &format!("--{suite}"), "--count", count, "--json"])
        .current_dir(folder.path())
        // Peers that are installed would take minutes.
        .env("PATH", folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("stdout is one JSON object");
    let mut rows = answer["rows"].as_array().unwrap().clone();
    // What was timed in another row has no time of its own.
    let timed = |r: &Value| r["time_s"].as_f64().is_none_or(|t| t >= 0.0);
    // The controllers bring the loop's pace along.
    let own = |r: &Value| r["suite"] == suite || (suite == "control" && r["suite"] == "pace");
    assert!(rows.iter().all(|r| own(r) && timed(r)), "{rows:?}");
    let all = rows.clone();
    rows.retain(|r| r["suite"] == suite);
    let csv = std::fs::read_to_string(folder.path().join(format!("runs/bench-{suite}.csv"))).unwrap();
    assert_eq!(csv.lines().next(), Some("suite,method,case,relative_error,time_s,failed"));
    assert_eq!(csv.lines().count(), rows.len() + 1);
    for ending in ["svg", "html"] {
        let text = std::fs::read_to_string(folder.path().join(format!("runs/bench-{suite}.{ending}"))).unwrap();
        assert!(text.contains("<svg"), "{ending}");
    }
    (all, folder)
}

/// The relative error of the row of `method` whose case begins or ends with `case`.
fn error(rows: &[Value], method: &str, case: &str) -> f64 {
    let is = |r: &&Value| {
        let name = r["case"].as_str().unwrap();
        r["method"] == method && (name.starts_with(case) || name.ends_with(case))
    };
    rows.iter().find(is).unwrap()["relative_error"].as_f64().unwrap()
}

#[test]
fn the_integrators_reach_the_reference_solutions() {
    let (rows, _) = bench("lumped", "1");
    for case in ["published trajectory", "paper trajectory", "published steps", "published, 5 psi", "paper, 5 psi"] {
        // 1e-5 rad of rotations of half a radian and more, as the model's own tests ask for.
        let finest = error(&rows, "Radau IIA, order 5", &format!("{case}, step 0.0625 ms"));
        assert!(finest < 2e-5, "{case}: {finest}");
    }
    // The explicit method is lost where the fast pole, 3600 1/s, is beyond its limit, 2.8 a step.
    let lost = |r: &&Value| r["case"] == "paper trajectory, step 2.0000 ms" && r["method"] == "Runge-Kutta, order 4";
    let lost = rows.iter().find(lost).unwrap();
    assert!(lost["failed"] == true && lost["relative_error"].is_null(), "{lost}");
}

#[test]
fn the_tiers_of_the_finite_elements_stand_in_their_order() {
    let (rows, _) = bench("fem", "2");
    for case in ["free, 40 deg", "free, 60 deg", "blocked, 40 deg"] {
        let case = format!("{case}, 1 to 4 psi");
        let of = |method: &str| error(&rows, method, &case);
        // Each level divides the elements further; the automatic mesh is within what it was asked for.
        assert!(of("section, level 3") < of("section, level 2") && of("section, level 2") < of("section, level 1"));
        assert!(of("section, within 0.5 %") < 5e-3, "{case}");
        assert!(of("section, level 1") < of("smeared"), "{case}");
        // The closed form smears the fibres, too, and strains them little; blocked, smearing is most of its error.
        assert!(case.starts_with("blocked") || of("smeared") < of("linear"), "{case}");
    }
    // A peer that is missing is named, with how to come by it.
    let peers: Vec<_> = rows.iter().filter(|r| r["method"] == "CalculiX").collect();
    assert!(peers.len() == 1 && peers[0]["case"].as_str().unwrap().contains("apt install calculix-ccx"), "{peers:?}");
    // physics: end effects of 1 to 3 % at 40 deg; at mid-length there are none.
    let solid = |case: &str| error(&rows, "solid", &format!("free, 40 deg, 1 to 4 psi, from the section: {case}"));
    assert!(solid("at mid-length") < solid("ends included") && solid("ends included") < 0.05);
    for ends in ["free", "blocked"] {
        assert!(error(&rows, "section, level 1", &format!("2 geometries, {ends}, worst")) < 2e-2);
    }
}

#[test]
fn the_rods_come_to_their_known_answers() {
    let (rows, _) = bench("rods", "1");
    // The acceptance: 0.01 % of R1 and R2, 0.1 % of R3's turning points, at the resolution that everything uses.
    for task in ["R1, cold", "R2, cold", "R2, warm"] {
        assert!(error(&rows, "freerig", &format!("{task}, degree 4, 4 steps")) < 1e-4, "{task}");
        let of = |how: &str| error(&rows, "freerig", &format!("{task}, {how}"));
        assert!(
            of("degree 7, 16 steps") < of("degree 2, 3 steps") && of("degree 2, 3 steps") < of("degree 1, 2 steps")
        );
    }
    assert!(error(&rows, "freerig", "R3, both turning points, degree 5, 8 steps") < 1e-3);
    let peers: Vec<_> = rows.iter().filter(|r| r["method"] == "Exudyn").collect();
    assert!(peers.len() == 1 && peers[0]["case"].as_str().unwrap().contains("pip install exudyn"), "{peers:?}");
    assert_eq!(peers[0]["failed"], false);
}

#[test]
fn the_choice_of_the_model_is_judged_and_its_table_made() {
    let (rows, folder) = bench("fidelity", "2");
    for method in ["auto", "linear", "nonlinear", "section", "solid"] {
        assert!(error(&rows, method, "2 scenes, true error, median") < 20.0, "{method}");
    }
    let share = |what: &str| error(&rows, "auto", &format!("2 choices, share of true errors above the {what}"));
    assert_eq!((share("estimate"), share("tolerance")), (0.0, 0.0));
    let table = std::fs::read_to_string(folder.path().join("runs/certified.csv")).unwrap();
    let stored = include_str!("../../src/fem/fidelity/certified.csv");
    // A line that says where it comes from, the names, and every bucket.
    assert!(table.starts_with("# `freerig bench --fidelity`, version"), "{table}");
    assert_eq!(table.lines().count(), stored.lines().count());
    assert_eq!(table.lines().nth(1), stored.lines().nth(1));
}

#[test]
fn a_few_frees_are_identified() {
    let (rows, _) = bench("identification", "10");
    // The acceptance's limits hold for medians of 200; ten have three times their scatter at most.
    assert!(error(&rows, "this fit", "10 FREEs, kt, median") < 3e-3);
    assert!(error(&rows, "this fit", "10 FREEs, ct, median") < 2e-2);
    assert!(error(&rows, "this fit", "10 FREEs, f, median") < 1e-3);
    assert!(rows.iter().any(|r| r["method"] == "log decrement") && rows.iter().any(|r| r["method"] == "curve fit"));
}

#[test]
fn the_module_comes_to_the_finest_rods() {
    let (rows, _) = bench("module", "1");
    for case in ["30 deg, case 3", "30 deg, case 4", "60 deg, case 3", "60 deg, case 4"] {
        for start in ["cold", "warm"] {
            let of = |how: &str| error(&rows, &format!("equilibrium, {start}"), &format!("{case}, 3.5 psi, {how}"));
            // Of the plate's travel.
            assert!(of("degree 5, 8 steps") < of("degree 2, 2 steps") && of("degree 4, 6 steps") < 1e-3, "{case}");
        }
        let jacobian = error(&rows, "Jacobian, from the factorisation", &format!("{case}, 3.5 psi, degree 5, 8 steps"));
        assert!(jacobian < 1e-2, "{case}: {jacobian}");
    }
    for method in ["inverse, warm", "inverse, cold", "whisk plan", "workspace"] {
        let found: Vec<_> = rows.iter().filter(|r| r["method"] == method).collect();
        assert!(!found.is_empty() && found.iter().all(|r| r["failed"] == false), "{found:?}");
    }
}

#[test]
fn a_few_plants_are_followed() {
    let (rows, _) = bench("control", "4");
    let model = error(&rows, "model", "1 calibrated FREEs, median RMS");
    let published = error(&rows, "published PI", "1 calibrated FREEs, median RMS");
    // The acceptance: 0.12 deg of 70, and five times closer than the published gains.
    assert!(model < 0.12 / 70.0 && model < 0.2 * published, "{model} {published}");
    // The devices' own periods (10 and 16 ms) bound the error, not the tick: every one meets the acceptance.
    for ms in [1, 2, 4, 8, 16] {
        let case = format!("1 calibrated FREEs, tick of {ms} ms, median RMS; processor time a second");
        assert!(error(&rows, "model", &case) < 0.12 / 70.0, "{ms} ms");
    }
    // cyclictest and python-control are missing here, and named.
    for (peer, remedy) in [("cyclictest", "rt-tests"), ("python-control", "pip install control")] {
        let found: Vec<_> = rows.iter().filter(|r| r["method"] == peer).collect();
        assert!(found.len() == 1 && found[0]["case"].as_str().unwrap().contains(remedy), "{found:?}");
    }
    let off = |r: &&Value| r["method"] == "model" && r["case"].as_str().unwrap().starts_with("4 plants");
    assert!(rows.iter().filter(off).all(|r| r["failed"] == false));
}

#[test]
fn every_fault_is_seen_and_the_pressure_gone_within_its_limits() {
    let (rows, _) = bench("faults", "1");
    let names: std::collections::BTreeSet<_> = rows.iter().map(|r| r["method"].as_str().unwrap()).collect();
    for row in &freerig::control::MATRIX {
        assert!(names.contains(row.code.name()), "{}", row.code.name());
    }
    for row in &rows {
        assert!(row["failed"] == false && row["relative_error"].as_f64().unwrap() <= 1.0, "{row}");
    }
}

#[test]
fn a_bad_count_is_bad_usage() {
    let output = Command::new(env!("CARGO_BIN_EXE_freerig")).args(["bench", "--count", "0"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

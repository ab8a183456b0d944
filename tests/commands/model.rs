//! `freerig model single` and `freerig plan design`, as their users and their scripts meet them.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

const PSI: f64 = 6894.757293168;
/// The reference FREE of the finite elements.
const FREE: [&str; 10] = [
    "--gamma",
    "40deg",
    "--length",
    "130mm",
    "--inner-diameter",
    "9.52mm",
    "--wall",
    "0.8mm",
    "--fiber-width",
    "0.4mm",
];

fn place() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::copy(source.join("rig.toml"), folder.path().join("rig.toml")).unwrap();
    std::fs::create_dir(folder.path().join("calibration")).unwrap();
    std::fs::copy(source.join("calibration/paper.toml"), folder.path().join("calibration/paper.toml")).unwrap();
    folder
}

fn freerig(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_freerig")).args(args).current_dir(folder).output().unwrap()
}

#[track_caller]
fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn the_section_answers_under_the_contracts_keys_and_names_the_limit() {
    let folder = place();
    let args =
        [&["model", "single"], &FREE[..], &["--pressure", "1psi,-0.1psi,9psi", "--fidelity", "section", "--json"]];
    let answer = json(&freerig(folder.path(), &args.concat()));
    assert_eq!(answer["fidelity"], "section");
    let points = answer["points"].as_array().unwrap();
    assert_eq!(points.len(), 3);
    // The reference at 1 psi: twist to 0.2 %, stretch - 1 to 1 %.
    let number = |key: &str| points[0][key].as_f64().unwrap();
    assert!((number("twist_rad_per_m") / -2.8509798 - 1.0).abs() < 2e-3, "{answer}");
    assert!(((number("axial_stretch") - 1.0) / (0.9967925 - 1.0) - 1.0).abs() < 1e-2);
    assert!((number("outer_radius_mean_m") / 5.6998686e-3 - 1.0).abs() < 1e-3);
    assert!(number("outer_radius_at_fiber_m") < number("outer_radius_mean_m"));
    assert!(number("force_n").abs() < 1e-6 && number("moment_nm").abs() < 1e-9);
    assert!((number("pressure_pa") - PSI).abs() < 1e-6 && points[0]["converged"] == true);
    assert!(points[1]["twist_rad_per_m"].as_f64().unwrap() > 0.0, "suction turns it the other way");
    assert!(points[2]["converged"] == false && points[2]["twist_rad_per_m"].is_null());
    assert!((answer["limit_pressure_pa"].as_f64().unwrap() / PSI / 8.2397145 - 1.0).abs() < 1e-2);
    for key in ["wall_time_s", "discretisation_error_estimate", "model_error_estimate"] {
        assert!(answer[key].as_f64().is_some_and(|x| x >= 0.0), "{key}: {answer}");
    }
}

#[test]
fn a_fold_of_some_meshes_is_told() {
    let folder = place();
    let free = [&["model", "single", "--gamma", "60deg"], &FREE[2..], &["--ends", "blocked"]].concat();
    let at = |pressure: &str, more: &[&str]| {
        let flags = ["--fidelity", "section", "--pressure", pressure];
        freerig(folder.path(), &[&free[..], &flags, more].concat())
    };
    // Level 2 of the reference FREE folds at 6.3 to 6.4 psi, level 1 at 10 psi and a blunt mesh not before: 7 psi is
    // answered, by rubber that has not folded, as the reference's has not (section.csv, exact to 3e-4).
    let answer = json(&at("4psi,7psi", &["--json"]));
    let point = &answer["points"][1];
    assert!(point["converged"] == true && answer["limit_pressure_pa"].is_null(), "{answer}");
    let (radius, force, moment) = (5.56e-3, 1.3039407, -24.76585e-3);
    let off =
        (point["force_n"].as_f64().unwrap() - force).hypot((point["moment_nm"].as_f64().unwrap() - moment) / radius);
    let load = f64::hypot(force, moment / radius);
    let told = answer["discretisation_error_estimate"].as_f64().unwrap();
    assert!(off < (told + 3e-4) * load && told < 0.02, "{off} of {load}: {answer}");
    // What folds, where, and what is lost with it.
    let note = |pressure: &str| {
        let text = String::from_utf8_lossy(&at(pressure, &[]).stdout).into_owned();
        let note = text.lines().find(|line| line.starts_with("note: the rubber folds")).map(String::from);
        (note, text)
    };
    let (Some(found), _) = note("4psi,7psi") else { panic!("a note") };
    for words in
        ["not up to 7.00 psi on the blunt one", "at 6.3", "on the fine one", "at 4.2", "a property of the mesh"]
    {
        assert!(found.contains(words), "{words}: {found}");
    }
    assert!(found.contains("% (fine)") && found.contains("% (sharp)"), "{found}");
    // At 5 psi the sharp mesh alone has folded; below it there is nothing to say.
    let (Some(found), _) = note("3psi,5psi") else { panic!("a note") };
    assert!(found.contains("not up to 5.00 psi on the fine one") && found.contains("at 4.2"), "{found}");
    let (none, text) = note("2psi,4psi");
    assert_eq!(none, None, "{text}");
}

#[test]
fn auto_says_what_it_chose_and_why_and_a_curve_is_drawn() {
    let folder = place();
    let args = [&["model", "single"], &FREE[..], &["--pressure", "0.1psi", "--tolerance", "20%", "--json"]];
    let answer = json(&freerig(folder.path(), &args.concat()));
    assert_eq!(answer["fidelity"], "linear");
    assert!(answer["reason"].as_str().unwrap().contains("the cheapest within 20.00 %"), "{answer}");
    let args = [&["model", "single"], &FREE[..], &["--fidelity", "linear", "--ends", "blocked", "--curve"]];
    let output = freerig(folder.path(), &args.concat());
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.contains("linear model") && text.contains("model error"), "{text}");
    let page = text.lines().find_map(|line| line.strip_prefix("curve: ")).unwrap();
    let page = std::fs::read_to_string(folder.path().join(page)).unwrap();
    assert!(page.matches("<svg").count() == 3 && page.contains("force (N)"));
}

#[test]
fn what_cannot_be_answered_is_named_with_its_remedy() {
    let folder = place();
    for (args, words) in [
        (&["--pressure", "7"][..], &["no unit", "psi"][..]),
        (&["--pressure", "1psi", "--fiber-model", "line"], &["--fidelity solid"]),
        (&["--pressure", "1psi", "--gamma", "0deg"], &["--gamma 0 deg", "0.1 and 89.9 deg"]),
        (&["--pressure", "1psi", "--tolerance", "1"], &["no unit", "%"]),
        (&["--pressure", "1psi", "--tolerance", "0.001%"], &["tolerance", "0.05 %"]),
        (&["--pressure", "1psi", "--fiber-width", "9mm"], &["--fiber-width 9 mm", "share"]),
        (&["--pressure", "1psi", "--wall=-1mm"], &["--wall -1 mm", " mm at an inner diameter of ", "remedy"]),
        (&["--pressure", "1psi", "--length", "0mm"], &["--length 0 mm", "must be positive", "remedy"]),
    ] {
        let output = freerig(folder.path(), &[&["model", "single"], args].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(words.iter().all(|word| text.contains(word)), "{args:?}: {text}");
    }
}

#[test]
fn designs_are_swept_and_the_best_are_named_beside_the_papers() {
    let folder = place();
    let flags =
        ["--sweep", "gamma=30deg..70deg", "--count", "5", "--pressure", "4psi", "--csv", "design.csv", "--json"];
    // Geometry but the angle.
    let args = [&["plan", "design"], &FREE[4..], &flags[..]].concat();
    let answer = json(&freerig(folder.path(), &args));
    assert_eq!(answer["rows"].as_array().unwrap().len(), 5 * 8);
    let best = |aim: &str| {
        let row = answer["best"].as_array().unwrap().iter().find(|b| b["aim"] == aim).unwrap().clone();
        (row["value"].as_f64().unwrap().to_degrees().round(), row["paper"].as_f64().unwrap().to_degrees().round())
    };
    // Force and moment fall from 30 deg on; extension grows to 70.
    assert_eq!((best("force").0, best("moment").0, best("extension").0), (30.0, 30.0, 70.0));
    assert_eq!((best("rotation").1, best("force").1), (50.0, 20.0));
    // Free extension changes its sign near the neutral angle.
    let neutral = answer["neutral"].as_f64().unwrap().to_degrees();
    assert!((50.0..58.0).contains(&neutral), "{neutral}");
    let csv = std::fs::read_to_string(folder.path().join("design.csv")).unwrap();
    assert!(csv.starts_with("gamma_deg,pressure_pa,twist_rad_per_m") && csv.lines().count() == 41);
    assert!(folder.path().join(answer["report"].as_str().unwrap()).is_file());
    let wrong = freerig(folder.path(), &["plan", "design", "--sweep", "angle=1deg..2deg"]);
    let text = String::from_utf8_lossy(&wrong.stderr);
    assert!(wrong.status.code() == Some(2) && text.contains("gamma, wall"), "{text}");
}

#[test]
fn a_study_is_shared_killed_resumed_and_merged() {
    let folder = place();
    let at = |pressure: &str, more: &[&str]| {
        let flags = [
            "plan",
            "design",
            "--json",
            "--study",
            "study",
            "--pressure",
            pressure,
            "--tolerance",
            "2%",
            "--sweep",
            "gamma=40deg..60deg:3",
            "--sweep",
            "wall=0.7mm..0.9mm:3",
            "--sweep",
            "fibers=5..7",
        ];
        freerig(folder.path(), &[&flags[..], &FREE[4..], more].concat())
    };
    let question = |more: &[&str]| at("4psi", more);
    // 27 designs are 27 pieces: every second one for each of two shares.
    let first = json(&question(&["--shard", "1/2"]));
    assert_eq!((&first["computed_now"], &first["missing"]), (&14.into(), &13.into()));
    assert!(first["parquet"].is_null() && first["best"].as_array().unwrap().is_empty());
    let again = json(&question(&["--shard", "1/2"]));
    assert_eq!(again["computed_now"], 0, "what is there is not computed again");
    let piece = folder.path().join("study/piece-00000.parquet");
    let kept = std::fs::read(&piece).unwrap();
    let merged = json(&question(&[]));
    assert_eq!((&merged["computed_now"], &merged["missing"]), (&13.into(), &0.into()));
    let best = merged["best"].as_array().unwrap();
    assert_eq!(best.len(), 4);
    // Thinner walls turn and stretch more, whatever the rest.
    assert_eq!(best[0]["aim"], "rotation");
    assert!((best[0]["values"][1].as_f64().unwrap() - 0.7e-3).abs() < 1e-9, "{best:?}");
    let whole = std::fs::read(folder.path().join("study/designs.parquet")).unwrap();
    let page = std::fs::read_to_string(folder.path().join("study/report.html")).unwrap();
    for said in ["27 designs", "gamma=40deg..60deg:3, wall=0.7mm..0.9mm:3", "discretisation error, estimated"] {
        assert!(page.contains(said), "{said}");
    }
    assert!(merged["discretisation_error_estimate"].as_f64().unwrap() > 0.0 && merged["missed"].is_u64());
    // A piece that is gone or damaged is computed again, to the same bits.
    std::fs::write(&piece, &kept[..kept.len() / 2]).unwrap();
    let damaged = question(&[]);
    assert_eq!(damaged.status.code(), Some(1));
    let said = String::from_utf8_lossy(&damaged.stderr).into_owned();
    assert!(said.contains("piece-00000.parquet") && said.contains("delete this file"), "{said}");
    std::fs::remove_file(&piece).unwrap();
    assert_eq!(json(&question(&[]))["computed_now"], 1);
    assert_eq!(std::fs::read(&piece).unwrap(), kept);
    assert_eq!(std::fs::read(folder.path().join("study/designs.parquet")).unwrap(), whole);
    // Another question does not belong into this folder.
    let other = at("5psi", &[]);
    let said = String::from_utf8_lossy(&other.stderr).into_owned();
    assert!(other.status.code() == Some(2) && said.contains("pressures_pa"), "{said}");
}

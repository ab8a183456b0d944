//! `freerig model module` and `freerig plan workspace|inverse|path`, as their users and their scripts meet them.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};

use serde_json::Value;

const PSI: f64 = 6894.757293168;
/// The reference module but for its winding angle.
const MODULE: [&str; 18] = [
    "--length",
    "130mm",
    "--inner-diameter",
    "9.52mm",
    "--wall",
    "0.8mm",
    "--fiber-width",
    "0.4mm",
    "--fiber-ea",
    "644N",
    "--fibers",
    "6",
    "--mu",
    "0.393MPa",
    "--alpha",
    "1.2",
    "--spacing",
    "20mm",
];
/// Height of the plate at rest, m.
const REST: f64 = 0.13;

/// One command at a time: what the first one tabulates, the others find in the cache.
static ONE: Mutex<()> = Mutex::new(());

fn place() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::copy(source.join("rig.toml"), folder.path().join("rig.toml")).unwrap();
    std::fs::create_dir(folder.path().join("calibration")).unwrap();
    std::fs::copy(source.join("calibration/paper.toml"), folder.path().join("calibration/paper.toml")).unwrap();
    folder
}

fn freerig(folder: &Path, args: &[&str]) -> Output {
    let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("module_cli");
    let mut command = Command::new(env!("CARGO_BIN_EXE_freerig"));
    command.args(args).current_dir(folder).env("XDG_CACHE_HOME", cache).env_remove("STATE_DIRECTORY");
    command.output().unwrap()
}

#[track_caller]
fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// `freerig model module` of the reference module by rods.
#[track_caller]
fn model(folder: &Path, gamma: &str, flags: &[&str]) -> Value {
    let fixed = ["model", "module", "--gamma", gamma, "--fidelity", "rod", "--json"];
    json(&freerig(folder, &[&fixed, &MODULE[..], flags].concat()))
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list = value.as_array().unwrap_or_else(|| panic!("{value}"));
    let list: Vec<f64> = list.iter().map(|x| x.as_f64().unwrap()).collect();
    list.try_into().unwrap()
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

#[test]
fn the_plate_is_where_the_reference_has_it() {
    let folder = place();
    // gamma, case, P, x, y, z, qw, qx, qy, qz, force.
    let reference: Vec<Vec<f64>> = (include_str!("../reference/module.csv").lines().skip(1))
        .map(|line| line.split(',').take(10).map(|cell| cell.parse().unwrap()).collect())
        .collect();
    for gamma in [30.0, 60.0] {
        let rows: Vec<&Vec<f64>> = reference.iter().filter(|row| row[0] == gamma).collect();
        assert_eq!(rows.len(), 4);
        let on =
            |case: f64| [[1.0; 4], [1.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]][case as usize - 1];
        let mut table = String::from("# cases\nnote_s,a_psi,b_psi,c_psi,d_psi\n");
        for row in &rows {
            let [a, b, c, d] = on(row[1]).map(|on| on * row[2]);
            table += &format!("0,{a},{b},{c},{d}\n");
        }
        std::fs::write(folder.path().join("rows.csv"), table).unwrap();
        let answer = model(folder.path(), &format!("{gamma}deg"), &["--pressures", "rows.csv"]);
        let answers = answer["rows"].as_array().unwrap();
        assert_eq!(answers.len(), 4);
        for (row, answer) in rows.iter().zip(answers) {
            let want: [f64; 3] = std::array::from_fn(|i| 1e-3 * row[3 + i]);
            let travel = apart(want, [0.0, 0.0, REST]);
            let off = apart(numbers(&answer["position_m"]), want);
            println!("{gamma} deg, case {}: {:.3} of {:.2} mm", row[1], 1e3 * off, 1e3 * travel);
            // The reference's rods have bending stiffness by three pressures and no shear: 4 % or 0.4 mm.
            assert!(off < f64::max(0.04 * travel, 0.4e-3), "{gamma} deg, case {}: {off} m of {travel} m", row[1]);
            let quaternion: [f64; 4] = numbers(&answer["quaternion_wxyz"]);
            let turn = 2.0 * (quaternion[3].atan2(quaternion[0]) - row[9].atan2(row[6])).abs();
            let turned = 2.0 * row[9].atan2(row[6]).abs();
            assert!(turn < f64::max(0.04 * turned, 0.5f64.to_radians()), "{gamma} deg, case {}: {turn}", row[1]);
            assert!(answer["stable"] == true && answer["negative_pivots"] == 0 && answer["limit"].is_null());
            assert!(answer["least_clearance_m"].as_f64().unwrap() > 0.0);
            assert!(answer["discretisation_error_estimate"].as_f64().unwrap() < 0.02, "{answer}");
        }
    }
}

#[test]
fn the_frees_carry_plate_weight_and_force_and_the_mirror_image_mirrors() {
    let folder = place();
    let loads = ["--plate-mass", "20g", "--gravity", "-1m/s2,0m/s2,9.81m/s2", "--force", "0N,-0.05N,0.1N"];
    let right = model(folder.path(), "60deg", &[&["--pressures", "3psi,1psi,0psi,2psi"], &loads[..]].concat());
    let mut sum = [-0.02, -0.05, 0.1 + 0.02 * 9.81];
    let resultants = right["resultants"].as_array().unwrap();
    assert_eq!(resultants.iter().map(|r| r["free"].as_str().unwrap()).collect::<String>(), "ABCD");
    for resultant in resultants {
        let force: [f64; 3] = numbers(&resultant["force_n"]);
        (0..3).for_each(|i| sum[i] += force[i]);
        assert!(numbers::<3>(&resultant["moment_nm"]).iter().all(|m| m.is_finite()));
    }
    // Newton's tolerance of the loads is 1e-8 of a rod's stiffness, some 10 N.
    assert!(sum.iter().all(|f| f.abs() < 1e-6), "{sum:?}");
    // The mirror image in the plane x = y keeps A and C, exchanges B and D, and every hand.
    let mirrored = ["--layout", "LRLR", "--plate-mass", "20g"];
    let loads = ["--gravity", "0m/s2,-1m/s2,9.81m/s2", "--force", "-0.05N,0N,0.1N"];
    let left =
        model(folder.path(), "60deg", &[&["--pressures", "3psi,2psi,0psi,1psi"], &mirrored[..], &loads].concat());
    let ([x, y, z], other) = (numbers::<3>(&right["position_m"]), numbers(&left["position_m"]));
    assert!(apart([y, x, z], other) < 1e-9 && x.hypot(y) > 1e-3, "{x} {y} {z} {other:?}");
    let ([w, qx, qy, qz], other) = (numbers::<4>(&right["quaternion_wxyz"]), numbers::<4>(&left["quaternion_wxyz"]));
    assert!([w, -qy, -qx, -qz].iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-8), "{other:?}");
}

#[test]
fn past_a_limit_the_values_are_missing_and_the_limit_is_named() {
    let folder = place();
    // Neighbouring tubes touch when the plate has turned about 105 deg, a little above 5 psi.
    std::fs::write(folder.path().join("rows.csv"), "a_kpa,b_kpa,c_kpa,d_kpa\n48,0,48,0\n7,0,0,0\n").unwrap();
    let answer = model(folder.path(), "60deg", &["--pressures", "rows.csv"]);
    let (past, before) = (&answer["rows"][0], &answer["rows"][1]);
    for key in ["position_m", "quaternion_wxyz", "resultants", "stable", "negative_pivots", "least_clearance_m"] {
        assert!(past[key].is_null() && !before[key].is_null(), "{key}: {answer}");
    }
    assert!(past["limit"].as_str().unwrap().contains("touch"), "{past}");
    let psi = past["limit_share"].as_f64().unwrap() * 48e3 / PSI;
    assert!((4.5..6.0).contains(&psi), "{psi}");
    assert_eq!(past["pressures_pa"][2], 48e3);
    // For people, too, and with status 0.
    let args = [&["model", "module", "--gamma", "60deg", "--fidelity", "rod", "--pressures", "rows.csv"], &MODULE[..]];
    let output = freerig(folder.path(), &args.concat());
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("limit of row 1") && text.contains("touch"), "{text}");
}

#[test]
fn what_cannot_be_answered_is_named_with_its_rule_and_its_remedy() {
    let folder = place();
    std::fs::write(folder.path().join("bare.csv"), "a,b,c,d\n1,2,3,4\n").unwrap();
    std::fs::write(folder.path().join("late.csv"), "t_s,x_mm,y_mm,z_mm\n0,0,0,130\n0,1,0,130\n").unwrap();
    let pressures = ["--pressures", "1psi,0psi,0psi,0psi"];
    let module = |flags: &[&'static str]| [&["model", "module"], &pressures[..], flags].concat();
    for (args, words) in [
        (module(&["--gamma", "-40deg"]), &["-40 deg", "must be positive", "--layout", "--gamma 40deg"][..]),
        (module(&["--layout", "RLR"]), &["RLR", "four letters", "RLRL"]),
        (module(&["--layout", "rlrl"]), &["rlrl", "R or L"]),
        (module(&["--spacing", "9mm"]), &["9.00 mm", "overlap", "remedy", "--spacing"]),
        (module(&["--length", "20mm"]), &["0.02", "four outer radii", "--length"]),
        (module(&["--force", "1,0,0"]), &["no unit", "N, mN"]),
        (module(&["--force", "1N,0N"]), &["2 of 3"]),
        (module(&["--gravity", "up"]), &["up", "hanging", "standing", "none"]),
        (module(&["--plate-mass", "-5g"]), &["-5 g", "must not be negative"]),
        (module(&["--gamma", "30deg,60deg"]), &["30 deg, 60 deg", "one winding angle"]),
        (vec!["model", "module", "--pressures", "1psi,0psi,0psi"], &["3 of 4", "FILE.csv"]),
        (vec!["model", "module", "--pressures", "1psi,0psi,0psi,-1psi"], &["D is -1.000 psi", "begin at 0", "remedy"]),
        (vec!["model", "module", "--pressures", "nowhere.csv"], &["nowhere.csv", "cannot read"]),
        (vec!["model", "module", "--pressures", "bare.csv"], &["bare.csv:1", "unit of pressure", "`a_psi`"]),
        (vec!["plan", "path", "late.csv"], &["late.csv:3", "t_s = 0", "must be later"]),
        (vec!["plan", "inverse", "--position", "0mm,0mm"], &["2 of 3"]),
        (vec!["plan", "inverse", "--position", "0mm,0mm,130mm", "--dead", "E"], &["`E`", "A, B, C or D"]),
        (vec!["plan", "inverse", "--position", "0mm,0mm,130mm", "--margin", "2"], &["margin is 2", "0 to 0.7"]),
        (vec!["plan", "workspace", "--pressure", "-1psi"], &["-1.000 psi", "must be positive"]),
    ] {
        let output = freerig(folder.path(), &args);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(words.iter().all(|word| text.contains(word)), "{args:?}: {text}");
    }
}

#[test]
fn the_inverse_leads_where_the_model_says() {
    let folder = place();
    let flags = [&["--gamma", "60deg", "--json"], &MODULE[..]].concat();
    let inverse = |more: &[&str]| json(&freerig(folder.path(), &[&["plan", "inverse"], &flags[..], more].concat()));
    let found = inverse(&["--position", "3mm,-2mm,130.5mm"]);
    let pressures: [f64; 4] = numbers(&found["pressures_pa"]);
    assert!(found["reached"] == true && found["shortfall"].is_null(), "{found}");
    assert!(pressures.iter().all(|p| (0.0..=7.0 * PSI).contains(p)), "{found}");
    assert!(found["margin"]["smooth"].as_f64().unwrap() >= 0.1);
    let text = pressures.map(|p| format!("{p}Pa")).join(",");
    let there = model(folder.path(), "60deg", &["--pressures", &text]);
    // A target counts as reached within 1e-5 of the length.
    assert!(apart(numbers(&there["position_m"]), [3e-3, -2e-3, 130.5e-3]) < 2e-6, "{there}");
    // Turned as asked, too.
    let turned = inverse(&["--position", "0mm,-2mm,132mm", "--twist", "-15deg"]);
    let [w, _, _, z] = numbers::<4>(&turned["quaternion_wxyz"]);
    assert!(turned["reached"] == true && ((2.0 * z.atan2(w)).to_degrees() + 15.0).abs() < 0.1, "{turned}");
    // A dead FREE stays at zero.
    let dead = inverse(&["--position", "3mm,-2mm,130.5mm", "--dead", "A"]);
    assert!(numbers::<4>(&dead["pressures_pa"])[0].abs() < 1e-9, "{dead}");
    // Farther than anything goes: the nearest plate, and why.
    let far = inverse(&["--position", "0mm,-60mm,120mm"]);
    assert!(far["reached"] == false && far["residual_m"].as_f64().unwrap() > 0.02, "{far}");
    assert!(far["shortfall"].as_str().is_some_and(|s| !s.is_empty()), "{far}");
    let below = freerig(folder.path(), &[&["plan", "inverse", "--position", "0mm,0mm,-5mm"], &flags[..]].concat());
    assert!(below.status.code() == Some(2) && String::from_utf8_lossy(&below.stderr).contains("z is -5.0 mm"));
}

#[test]
fn a_path_is_planned_within_its_rates_and_its_file_leads_along_it() {
    let folder = place();
    let mut table = String::from("t_s,x_mm,y_mm,z_mm\n");
    for k in 0..=12 {
        let u = std::f64::consts::TAU * f64::from(k) / 12.0;
        table += &format!("{},{},{},130.6\n", 0.5 * f64::from(k), 2.0 * u.cos(), 2.0 * u.sin());
    }
    std::fs::write(folder.path().join("circle.csv"), table).unwrap();
    let flags = ["circle.csv", "--slew", "10psi/s", "--csv", "pressures.csv", "--json", "--gamma", "60deg"];
    let plan = json(&freerig(folder.path(), &[&["plan", "path"], &flags[..], &MODULE[..]].concat()));
    let samples = plan["samples"].as_array().unwrap();
    assert!(samples.len() == 13 && plan["missed"] == 0, "{plan}");
    assert!(plan["worst_error_m"].as_f64().unwrap() < 2e-6 && plan["least_margin"].as_f64().unwrap() > 0.1);
    for pair in samples.windows(2) {
        let [before, after] = [0, 1].map(|i| numbers::<4>(&pair[i]["pressures_pa"]));
        assert!(before.iter().zip(after).all(|(a, b)| (b - a).abs() <= 10.0 * PSI * 0.5 + 1.0), "{before:?} {after:?}");
    }
    let page = std::fs::read_to_string(folder.path().join(plan["report"].as_str().unwrap())).unwrap();
    assert!(page.contains("planned") && page.contains("predicted") && page.matches("<svg").count() == 4);
    // What was written is a table for the model, which says the same.
    let answer = model(folder.path(), "60deg", &["--pressures", "pressures.csv"]);
    let rows = answer["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 13);
    for (row, sample) in rows.iter().zip(samples) {
        assert!(apart(numbers(&row["position_m"]), numbers(&sample["planned_m"])) < 2e-6, "{row}");
    }
    // Slower than the path: it falls behind, and says what holds it.
    let flags = ["circle.csv", "--slew", "0.2psi/s", "--json", "--gamma", "60deg"];
    let slow = json(&freerig(folder.path(), &[&["plan", "path"], &flags[..], &MODULE[..]].concat()));
    assert!(slow["missed"].as_u64().unwrap() > 0 && slow["fastest_pa_per_s"].as_f64().unwrap() <= 0.2 * PSI * 1.0001);
    let held = |sample: &Value| sample["clipped"].as_array().unwrap().iter().any(|c| c.as_str().is_some());
    assert!(slow["samples"].as_array().unwrap().iter().any(held), "{slow}");
}

#[test]
fn the_workspace_is_fifteen_paths_beside_the_papers_figures() {
    let folder = place();
    let flags = ["--gamma", "60deg", "--csv", "paths.csv", "--json"];
    let answer = json(&freerig(folder.path(), &[&["plan", "workspace"], &flags[..], &MODULE[..]].concat()));
    let module = &answer["modules"][0];
    let paths = module["paths"].as_array().unwrap();
    assert_eq!(paths.len(), 15);
    let of = |frees: &str| paths.iter().find(|path| path["frees"] == frees).unwrap();
    let sideways = |frees: &str| of(frees)["sideways_m"].as_f64().unwrap();
    // Case 1 stays on the axis and lengthens, Case 2 turns without bending, the four of Case 4 are alike.
    assert!(sideways("ABCD") < 1e-6 && of("ABCD")["along_z_m"].as_f64().unwrap() > 1e-3);
    assert!(sideways("AC") < 1e-6 && of("AC")["tilt_rad"].as_f64().unwrap() < 1e-6);
    assert!(of("AC")["turn_rad"].as_f64().unwrap() < -0.5 && of("BD")["turn_rad"].as_f64().unwrap() > 0.5);
    for frees in ["BC", "CD", "AD"] {
        assert!((sideways(frees) / sideways("AB") - 1.0).abs() < 1e-4, "{frees}");
    }
    // 60 deg lengthens and moves away from the pair under pressure.
    let last = of("AB")["points"].as_array().unwrap().last().unwrap();
    let [x, y, z]: [f64; 3] = numbers(&last["position_m"]);
    assert!(x.abs() < 1e-6 && y < -5e-3 && z > REST, "{last}");
    let rows = answer["paper"].as_array().unwrap();
    assert_eq!(rows.iter().filter(|row| row["what"].as_str().unwrap().contains("60 deg")).count(), 3, "{rows:?}");
    for row in rows.iter().filter(|row| !row["ours"].is_null()) {
        let (ours, paper) = (row["ours"].as_f64().unwrap(), row["paper"].as_f64().unwrap());
        assert!((row["misfit"].as_f64().unwrap() - (ours / paper - 1.0)).abs() < 1e-12);
    }
    let csv = std::fs::read_to_string(folder.path().join("paths.csv")).unwrap();
    let points: usize = paths.iter().map(|path| path["points"].as_array().unwrap().len()).sum();
    assert!(csv.starts_with("gamma_deg,case,frees,pressure_psi,x_mm") && csv.lines().count() == 1 + points);
    // Every path that ends early is a cross; a dot and four circles for the others.
    let page = std::fs::read_to_string(folder.path().join(answer["report"].as_str().unwrap())).unwrap();
    assert!(page.contains("Case 4: two neighbours") && page.matches("<svg").count() == 4);
    assert!(page.matches("<circle").count() >= 2 * 15 * 4, "{}", page.matches("<circle").count());
    let recording = std::fs::read(folder.path().join(answer["recording"].as_str().unwrap())).unwrap();
    assert!(recording.starts_with(b"RRF") && recording.len() > 10_000, "{}", recording.len());
    let name = |key: &str| Path::new(answer[key].as_str().unwrap()).file_name().unwrap().to_str().unwrap().to_owned();
    assert!(page.contains(&name("recording")));
}

#[test]
fn the_solid_answers_what_the_rods_are_asked() {
    let folder = place();
    // All alike, one tube is solved for four.
    let flags = ["--pressures", "2psi,2psi,2psi,2psi", "--gravity", "none"];
    let fixed = ["model", "module", "--gamma", "30deg", "--fidelity", "solid", "--json"];
    let solid = json(&freerig(folder.path(), &[&fixed, &MODULE[..], &flags].concat()));
    let rods = model(folder.path(), "30deg", &flags);
    assert_eq!((&solid["fidelity"], &rods["fidelity"]), (&"solid".into(), &"rod".into()));
    let [solid_at, rods_at] = [&solid, &rods].map(|answer| numbers::<3>(&answer["position_m"]));
    let travel = apart(rods_at, [0.0, 0.0, REST]);
    // The bonded ends, two in a hundred of the length, do not shorten.
    assert!(travel > 2e-3 && apart(solid_at, rods_at) < 0.05 * travel, "{solid_at:?} {rods_at:?}");
    assert!(solid["stable"] == true && solid["negative_pivots"] == 0 && solid["limit"].is_null());
    let error = solid["discretisation_error_estimate"].as_f64().unwrap();
    assert!(error > 0.0 && error < 0.05, "{error}");
    // Swollen tubes are nearer to one another than those at rest, 20 - 11.12 mm.
    for answer in [&solid, &rods] {
        let clearance = answer["least_clearance_m"].as_f64().unwrap();
        assert!((8.0e-3..8.87e-3).contains(&clearance), "{clearance}");
    }
}

#[test]
fn where_the_ends_matter_auto_corrects_the_rods_before_it_asks_the_solid() {
    let folder = place();
    let fixed = ["model", "module", "--gamma", "30deg", "--json"];
    let flags = ["--pressures", "3.5psi,3.5psi,0psi,0psi", "--gravity", "none"];
    let asked = [&fixed, &MODULE[..], &flags, &["--tolerance", "3%"]].concat();
    let corrected = json(&freerig(folder.path(), &asked));
    let bare = model(folder.path(), "30deg", &flags);
    let reason = corrected["reason"].as_str().unwrap();
    assert!(corrected["fidelity"] == "rod" && reason.contains("; with a dead length "), "{reason}");
    // Beyond the tolerance without the correction, within it with: told as a discretisation's and the ends' part.
    let share = |key: &str| corrected[key].as_f64().unwrap();
    let (resolution, ends) = (share("discretisation_error_estimate"), share("model_error_estimate"));
    assert!(resolution > 0.0 && ends > 0.0 && resolution + ends <= 0.03, "{resolution} {ends}");
    assert!(bare["model_error_estimate"].is_null());
    // The solid of the module (docs/models.md), which the answer is as near to as it says, and the bare rods are not.
    let solid = [0.0, 14.235e-3, 126.600e-3];
    let travel = apart(solid, [0.0, 0.0, REST]);
    let [with, without] = [&corrected, &bare].map(|answer| apart(numbers(&answer["position_m"]), solid) / travel);
    assert!(with <= resolution + ends && without > 2.0 * with, "{with} {without}");
}

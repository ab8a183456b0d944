//! The program as a user meets it: what it prints, what it writes, its exit status.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// A folder with the example rig, and nothing else.
fn bench() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    fs::copy(source.join("rig.toml"), folder.path().join("rig.toml")).unwrap();
    fs::create_dir(folder.path().join("calibration")).unwrap();
    for file in fs::read_dir(source.join("calibration")).unwrap().flatten() {
        fs::copy(file.path(), folder.path().join("calibration").join(file.file_name())).unwrap();
    }
    folder
}

fn freerig(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_freerig")).args(args).current_dir(folder).output().unwrap()
}

fn json(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("stdout is one JSON object")
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().flatten().map(|f| f.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn the_demo_runs_reports_and_writes_only_runs() {
    let folder = bench();
    let output = freerig(folder.path(), &["demo", "--json"]);
    let demo = json(&output);
    assert_eq!(demo["simulated"], true);
    let comparisons = demo["comparisons"].as_array().unwrap();
    assert_eq!(comparisons.len(), 2);
    for comparison in comparisons {
        for gains in ["published", "own"] {
            let run = &comparison[gains];
            assert_eq!(run["outcome"], "done", "{run}");
            let free = &run["frees"][0];
            let rms = free["rms_error_rad"].as_f64().unwrap();
            assert!(rms > 0.0 && rms <= free["peak_error_rad"].as_f64().unwrap(), "{free}");
            let run = folder.path().join(run["folder"].as_str().unwrap());
            for file in ["run.toml", "run.rrd", "samples.arrows", "report.html"] {
                assert!(run.join(file).is_file(), "{file} in {}", run.display());
            }
        }
    }
    // What was measured first makes the difference: five times closer than the published gains.
    assert_eq!(comparisons[1]["experiment"], "trajectory");
    assert!(comparisons[1]["rms_ratio"].as_f64().unwrap() >= 5.0, "{}", comparisons[1]["rms_ratio"]);
    assert!(folder.path().join(demo["calibration"]["report"].as_str().unwrap()).is_file());
    let calibration = fs::read(folder.path().join("calibration/paper.toml")).unwrap();
    assert_eq!(calibration, include_bytes!("../../calibration/paper.toml"), "the demo leaves the calibration as it is");
    let page = fs::read_to_string(folder.path().join(demo["report"].as_str().unwrap())).unwrap();
    for whisk in ["open_loop", "closed_loop"] {
        let id = demo["whisk"][whisk]["id"].as_str().unwrap();
        assert!(page.contains(&format!("href=\"{id}/report.html\"")), "{id} is not on the page");
    }
    assert_eq!(names(folder.path()), ["calibration", "rig.toml", "runs"]);
    assert!(names(&folder.path().join("runs")).iter().all(|name| !name.starts_with('.')), "nothing is left behind");
}

#[test]
fn the_same_seed_gives_the_same_figures_and_another_gives_others() {
    let folder = bench();
    let figures = |seed: &str| {
        let args = ["trajectory", "--stepped", "--seed", seed, "--angles", "30deg,-10deg", "--hold", "0.5s", "--json"];
        json(&freerig(folder.path(), &args))["runs"][0]["frees"].clone()
    };
    let (one, again, other) = (figures("1"), figures("1"), figures("2"));
    assert_eq!(one, again);
    assert_ne!(one, other);
}

#[test]
fn an_angle_that_pressure_cannot_reach_is_warned_of() {
    let folder = bench();
    let said = |angles: &str| {
        let args = ["step", "--stepped", "--angles", angles, "--hold", "0.2s"];
        String::from_utf8_lossy(&freerig(folder.path(), &args).stderr).into_owned()
    };
    let text = said("30deg,-10deg");
    assert!(text.contains("warning: -10.0 deg is asked of `paper`") && text.contains("positive angles"), "{text}");
    assert!(!said("30deg,10deg").contains("warning"));
}

#[test]
fn repetitions_come_with_mean_and_scatter_and_say_simulated() {
    let folder = bench();
    let args = ["step", "--stepped", "--angles", "20deg", "--hold", "1s", "--repeat", "3", "--note", "thrice"];
    let output = freerig(folder.path(), &args);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.starts_with("SIMULATED") && text.contains("over 3 runs"), "{text}");
    assert_eq!(text.matches("report: ").count(), 3);
}

#[test]
fn a_sweep_finds_the_hysteresis() {
    let folder = bench();
    let rig = folder.path().join("rig.toml");
    let text = fs::read_to_string(&rig).unwrap();
    let hysteresis = |percent: &str| {
        let line = format!("hysteresis_percent = {percent} ");
        fs::write(&rig, text.replace("hysteresis_percent = 5 ", &line)).unwrap();
        let sweep = json(&freerig(folder.path(), &["sweep", "--stepped", "--json"]));
        sweep["runs"][0]["frees"][0]["hysteresis_rad"].as_f64().unwrap()
    };
    let (with, without) = (hysteresis("5"), hysteresis("0"));
    assert!(with > 3.0 * without, "{with} rad with, {without} rad without");
    // Three holds on each way: one cycle or two, it is the same loop, but for the readings' noise.
    fs::write(&rig, &text).unwrap();
    let over = |pressures: &str| {
        let sweep = json(&freerig(folder.path(), &["sweep", "--stepped", "--pressures", pressures, "--json"]));
        sweep["runs"][0]["frees"][0]["hysteresis_rad"].as_f64().unwrap()
    };
    let (one, two) = (over("0psi,2psi,4psi"), over("0psi,2psi,4psi,2psi,0psi"));
    assert!((two / one - 1.0).abs() < 0.1, "{one} rad of one cycle, {two} rad of two");
}

#[test]
fn gains_without_a_margin_are_refused_unless_accepted() {
    let folder = bench();
    let args = ["step", "--stepped", "--angles", "10deg", "--hold", "0.5s", "--gains", "paper-pi"];
    let refused = freerig(folder.path(), &args);
    let text = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(1), "{text}");
    assert!(text.contains("margin") && text.contains("--accept-margin"), "{text}");
    let accepted = freerig(folder.path(), &[&args[..], &["--accept-margin"]].concat());
    let text = String::from_utf8_lossy(&accepted.stderr).into_owned();
    assert!(!text.contains("--accept-margin"), "{text}");
}

#[test]
fn a_bad_configuration_is_listed_whole_and_nothing_is_done() {
    let folder = bench();
    let rig = folder.path().join("rig.toml");
    let text = fs::read_to_string(&rig).unwrap();
    let broken = text
        .replace("rate_hz = 500", "rate_hz = 10")
        .replace("priority = 80", "priorty = 80")
        .replace("calibration = \"paper\"", "calibration = \"nowhere\"")
        .replace("slew_psi_per_s = 30             #", "slew_kpa_per_s = 30             #");
    assert_ne!(text, broken);
    fs::write(&rig, broken).unwrap();
    for command in [&["config", "check"][..], &["step", "--stepped"], &["demo"]] {
        let output = freerig(folder.path(), command);
        let said = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(2), "{said}");
        for problem in ["rate_hz", "priorty", "did you mean `priority`", "nowhere", "slew_kpa_per_s"] {
            assert!(said.contains(problem), "{problem} in {said}");
        }
    }
    assert_eq!(names(folder.path()), ["calibration", "rig.toml"]);
}

#[test]
fn bad_usage_names_what_would_be_good() {
    let folder = bench();
    for (args, expected) in [
        (&["step", "--stepped", "--angles", "30"][..], "deg"),
        (&["step", "--seed", "3"], "--stepped"),
        (&["step", "--stepped", "nowhere.toml"], "nowhere.toml"),
        (&["step", "--stepped", "--gains", "mine"], "published-step"),
        (&["step", "--stepped", "--free", "nobody"], "paper"),
        (&["step", "--stepped", "--angles", "170deg"], "soft envelope"),
        (&["sweep", "--stepped", "--pressures", "20psi"], "paper"),
    ] {
        let output = freerig(folder.path(), args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(expected), "{args:?}: {said}");
    }
}

#[test]
fn without_a_daemon_an_experiment_says_how_to_start_one() {
    let folder = bench();
    let output = freerig(folder.path(), &["step"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("freerig run"), "{said}");
}

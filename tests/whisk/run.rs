//! Plans as files, and as they stand.

use std::fs;
use std::path::Path;

use freerig::config::{Rig, Whisk};
use freerig::daemon::api::RunResult;
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Stepped, procedure};
use freerig::record::{Apart, Run, TipPath};
use freerig::units::PASCAL_PER_PSI as PSI;
use tempfile::TempDir;

use crate::harness::{parse, rig};

/// A small circle of pressures about 3 psi.
fn circle() -> Whisk {
    let times: Vec<f64> = (0..=40).map(|k| 0.1 * f64::from(k)).collect();
    let at = |t: f64, free: usize| {
        let phase = std::f64::consts::TAU * (t / 4.0 + 0.25 * free as f64);
        (3.0 + phase.sin()) * PSI
    };
    let pressures = times.iter().map(|t| std::array::from_fn(|free| at(*t, free))).collect();
    Whisk { name: "circle".into(), periods: 1, lead: 2.0, times, pressures, ..Whisk::default() }
}

fn carry_out(rig: &Rig, whisk: &Whisk) -> Run {
    let experiment = parse(&whisk.to_toml(&["a remark".into()]), rig).unwrap();
    let mut bench = Stepped::new(rig).unwrap();
    // No margin is asked of a FREE whose angle nobody controls.
    procedure::arm(&mut bench, rig, false).unwrap();
    let job = Job { stepped: true, ..Job::new(experiment, Attendance::Here) };
    run(&mut bench, rig, &job, &mut |_| {}).unwrap().remove(0)
}

#[test]
fn a_plan_is_what_it_was_after_it_has_been_written_and_read() {
    let (_folder, rig) = rig(&[]);
    let whisk = Whisk { predicted: vec![[1e-3, -2e-3, 0.13]; 41], ..circle() };
    let read = parse(&whisk.to_toml(&["two\nlines".into()]), &rig).unwrap();
    let back = read.whisk.unwrap();
    assert_eq!((back.name.as_str(), back.periods, back.lead), ("circle", 1, 2.0));
    let off = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // A file has a millionth of a psi and a micrometre.
    assert!(back.pressures.iter().zip(&whisk.pressures).all(|(a, b)| off(a, b) <= 1e-6 * PSI));
    assert!(back.predicted.iter().all(|p| (p[0] - 1e-3).abs() < 1e-9 && (p[2] - 0.13).abs() < 1e-9));
    // Two seconds up, four of the period, two down.
    assert!((read.program.duration - 8.0).abs() < 1e-9);
    for free in 0..4 {
        let at = |t: f64| read.program.reference(free, t).position;
        assert!(at(0.0).abs() < 1e-9 && at(8.0).abs() < 1e-9);
        assert!((at(3.0) - whisk.pressures[10][free]).abs() < 1e-5 * PSI);
    }
}

#[test]
fn what_is_no_whisk_is_told_with_its_rule() {
    let (_folder, rig) = rig(&[]);
    let told = |change: &dyn Fn(&mut Whisk), words: &[&str]| {
        let mut whisk = circle();
        change(&mut whisk);
        let error = parse(&whisk.to_toml(&[]), &rig).unwrap_err();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    told(&|w| w.pressures[3][1] = 7.5 * PSI, &["b_psi", "7.50", "0 to 7.00 psi"]);
    told(&|w| w.pressures[3][2] = -PSI, &["c_psi", "-1.00"]);
    told(&|w| w.times.iter_mut().for_each(|t| *t *= 0.01), &["a_psi", "psi/s", "takes 30.0"]);
    told(&|w| w.times[1] = 0.0, &["times_s", "rise from 0"]);
    told(&|w| w.pressures.truncate(40), &["a_psi", "40 values for 41 times"]);
    // Angles belong to the plate.
    let angle = "kind = \"step\"\nfree = \"a\"\nangles_deg = [10]\nhold_s = 1\n";
    assert!(parse(angle, &rig).unwrap_err().contains("turns with its module's plate"));
    // And a rig without a module has no whisk.
    let single = Rig::load(Path::new("rig.toml")).unwrap();
    assert!(parse(&circle().to_toml(&[]), &single).unwrap_err().contains("needs a module"));
}

#[test]
fn what_is_no_module_is_told_with_its_rule() {
    let text = fs::read_to_string("experiments/module/rig.toml").unwrap();
    let text = text
        .replace("\"../../calibration\"", &format!("{:?}", Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration")));
    let told = |from: &str, to: &str, words: &[&str]| {
        assert!(text.contains(from), "{from}");
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("rig.toml");
        fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let error = Rig::load(&path).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    told("frees = [\"a\", \"b\", \"c\", \"d\"]", "frees = [\"a\", \"b\", \"c\"]", &["module.frees", "4 FREEs, not 3"]);
    told(
        "frees = [\"a\", \"b\", \"c\", \"d\"]",
        "frees = [\"a\", \"b\", \"c\", \"e\"]",
        &["no FREE `e`", "a, b, c, d"],
    );
    told("frees = [\"a\", \"b\", \"c\", \"d\"]", "frees = [\"a\", \"b\", \"c\", \"a\"]", &["`a` is there twice"]);
    told("spacing_mm = 20 ", "spacing_mm = 11 ", &["module.spacing_mm", "11.12 mm thick"]);
}

#[test]
fn a_payload_that_nobody_has_said_hangs_on_the_simulated_plate_alone() {
    let (_folder, rig) = rig(&[("damping_percent = 20", "payload_g = 50\ndamping_percent = 20")]);
    let there = rig.bench.module.as_ref().unwrap().true_scene(&rig.bench).plate_mass;
    let said = rig.module_scene().unwrap().plate_mass;
    assert!((there - 0.06).abs() < 1e-12 && (said - 0.01).abs() < 1e-12, "{there} {said}");
}

#[test]
fn the_module_that_is_the_models_goes_where_the_plan_says_but_for_the_regulators_lag() {
    let (_folder, rig) = rig(&[("scatter_percent = 5 ", "scatter_percent = 0 ")]);
    let run = carry_out(&rig, &circle());
    assert_eq!(run.result_name(), "done");
    let path = TipPath::of(&run).unwrap().unwrap();
    // The estimate is the model at the measured pressures: of a module that is the model, it is right but for the
    // readings' age (11 ms on the line), the noise of pressures and orientation, and the plate's swing, which lags by
    // 2 zeta / omega (0.2 at some 3 Hz: 20 ms). The tip moves by less than 20 mm/s.
    let apart = Apart::between(&path.estimated, &path.truth).unwrap();
    assert!(apart.rms < 20e-3 * 0.035, "{apart:?}");
    let moved = path.truth.iter().flatten().map(|p| p.xy().norm()).fold(0.0, f64::max);
    assert!(moved > 1e-3, "the plate moves sideways: {moved}");
    let result = RunResult::of(&run).unwrap();
    // Nothing was planned or predicted in this file: there is nothing to be off.
    assert_eq!(result.tip, None);
    let page = fs::read_to_string(run.folder.join("report.html")).unwrap();
    assert!(page.contains("Way of the plate") && page.contains("SIMULATED"));
    // How one FREE turns under the plate is compared with no model of one FREE.
    assert!(page.contains("No comparison with the model") && !page.contains("RMSD to the model at rest"));
}

#[test]
fn the_sensors_axis_does_not_matter() {
    let changes =
        [("scatter_percent = 5 ", "scatter_percent = 0 "), ("address = 0x28", "address = 0x28\naxis = [0, 1, 0]")];
    let (_folder, rig) = rig(&changes);
    let path = TipPath::of(&carry_out(&rig, &circle())).unwrap().unwrap();
    let apart = Apart::between(&path.estimated, &path.truth).unwrap();
    assert!(apart.rms < 20e-3 * 0.035, "{apart:?}");
}

#[test]
fn orientation_tells_something_of_a_module_that_is_not_the_models() {
    let (_folder, rig) = rig(&[]);
    let run = carry_out(&rig, &circle());
    let path = TipPath::of(&run).unwrap().unwrap();
    let estimated = Apart::between(&path.estimated, &path.truth).unwrap();
    let moved =
        Apart::between(&path.truth, &vec![Some(nalgebra::Vector3::new(0.0, 0.0, 0.13)); path.truth.len()]).unwrap();
    assert!(estimated.rms < 0.5 * moved.rms, "{estimated:?} {moved:?}");
}

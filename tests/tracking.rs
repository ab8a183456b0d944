//! How well a FREE whose stiffness and hysteresis were measured is followed: the whole simulated rig on the stepped
//! clock, drivers and chips included, true angle against reference.

use std::path::Path;
use std::process::Command;

use freerig::config::Rig;
use freerig::config::experiment::{Experiment, Kind};
use freerig::control::tune::{Target, tune};
use freerig::control::{ControllerKind, Gains, ModelSpec};
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Stepped, procedure};
use freerig::ident::sweep::{RestPoint, fit_sweep};
use freerig::record::{Metrics, Run, RunResult};
use freerig::signal::{TickRecord, Truth};
use freerig::sim::Plant;

/// The paper's range and back, with inner loops: a quarter of an hour on a bench.
const SWEEP: &str = r#"
kind = "sweep"
name = "hysteresis"
pressures_psi = [0, 0.3, 0.6, 1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 5.3, 5, 4.7, 4.4, 4, 3.5, 3, 2.5, 2, 1.5, 1, 0.7, 0.4,
    0.2, 0.4, 0.8, 1.5, 2.5, 3.5, 3.2, 2.8, 2.2, 1.6, 2, 2.6, 3.4, 4.2, 5, 5.3, 5, 4.5, 3.8, 3, 2.2, 1.4, 0.7, 0]
move_s = 0.5
hold_s = 1.5
"#;

fn rig(runs: &Path) -> Rig {
    let mut rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).expect("rig.toml is clean");
    rig.record.directory = runs.to_owned();
    rig
}

fn carry_out(rig: &Rig, name: &str, text: &str) -> Run {
    let mut bench = Stepped::new(rig).unwrap();
    procedure::arm(&mut bench, rig, true).unwrap();
    let experiment = Experiment::parse(Path::new(name), text, rig, None).unwrap();
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Here) };
    let run = run(&mut bench, rig, &job, &mut |_| {}).unwrap().remove(0);
    assert_eq!(run.stop().unwrap().result, RunResult::Done, "{:?}", run.stop());
    run
}

/// Mean of readings at rest: the last second of every hold of the pressure.
fn rest_points(run: &Run) -> Vec<RestPoint> {
    let mut points = Vec::new();
    let (mut reference, mut since) = (f64::NAN, 0.0);
    let mut sums = (0.0, 0.0, 0.0);
    let mut close = |sums: &mut (f64, f64, f64)| {
        if sums.2 > 250.0 {
            points.push(RestPoint { angle: sums.0 / sums.2, pressure: sums.1 / sums.2 });
        }
        *sums = (0.0, 0.0, 0.0);
    };
    for (record, _) in run.records().unwrap().filter(|(r, _)| r.program_time.is_finite()) {
        let free = &record.frees[0];
        if free.reference.position != reference {
            close(&mut sums);
            (reference, since) = (free.reference.position, record.program_time);
        }
        if record.program_time - since > 0.5 {
            sums.0 += free.estimate.angle;
            sums.1 += free.pressure.pressure;
            sums.2 += 1.0;
        }
    }
    close(&mut sums);
    points
}

/// The rig whose controller knows the true geometry, damping, lag and delay, and the stiffness and the hysteresis that
/// a sweep on the rig itself has shown.
fn calibrated(runs: &Path) -> Rig {
    let mut rig = rig(runs);
    let truth = *Plant::new(&rig.bench).true_free(0).unwrap();
    let points = rest_points(&carry_out(&rig, "sweep.toml", SWEEP));
    let fit = fit_sweep(&points, &truth).unwrap();
    let off = fit.stiffness / truth.torsional_stiffness - 1.0;
    println!(
        "kt {:.3} % off, standard uncertainty {:.3} %",
        100.0 * off,
        100.0 * fit.stiffness_uncertainty / fit.stiffness
    );
    assert!(off.abs() < 0.01, "{fit:?}");
    let period = rig.control.period;
    let free = &mut rig.control.frees[0];
    free.free = truth;
    free.free.torsional_stiffness = fit.stiffness;
    free.controller = ControllerKind::Model(ModelSpec { hysteresis: fit.hysteresis, statics: None });
    free.gains = tune(&free.free, &free.regulator, &free.imu.unwrap(), period, &Target::MODEL).unwrap().gains;
    rig
}

/// The same rig with Eq. 5 alone.
fn plain(rig: &Rig, gains: Gains) -> Rig {
    let mut rig = rig.clone();
    let free = &mut rig.control.frees[0];
    (free.controller, free.gains, free.feedforward) = (ControllerKind::Pid, gains, 0.0);
    rig
}

/// Time (s), reference and true angle (deg), and true pressure (Pa) in every tick of the program.
fn course(rig: &Rig, kind: Kind) -> Vec<(f64, f64, f64, f64)> {
    let (name, text) = kind.default_file().unwrap();
    let run = carry_out(rig, name, text);
    let records = run.records().unwrap().filter(|(r, _)| r.program_time.is_finite());
    let degrees = |rad: f64| rad.to_degrees();
    let tick = |(r, t): (TickRecord, Vec<Truth>)| {
        (r.program_time, degrees(r.frees[0].reference.position), degrees(t[0].angle), t[0].pressure)
    };
    records.map(tick).collect()
}

/// RMS and peak of reference - truth, deg.
fn errors(course: &[(f64, f64, f64, f64)]) -> (f64, f64) {
    let errors = course.iter().map(|(_, reference, truth, _)| reference - truth);
    let square = errors.clone().map(|e| e * e).sum::<f64>();
    ((square / course.len() as f64).sqrt(), errors.map(f64::abs).fold(0.0, f64::max))
}

/// The same from nothing but what `freerig calibrate all` finds, on rigs of other seeds.
#[test]
fn what_is_calibrated_from_nothing_is_followed_and_predicted() {
    for seed in ["1", "2"] {
        let folder = tempfile::tempdir().unwrap();
        let source = Path::new(env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(source.join("rig.toml")).unwrap();
        std::fs::write(folder.path().join("rig.toml"), text.replace("gains = \"freerig\"", "gains = \"tuned-model\""))
            .unwrap();
        std::fs::create_dir(folder.path().join("calibration")).unwrap();
        // Gains of that name must stand there before there are tuned ones.
        let known = std::fs::read_to_string(source.join("calibration/paper.toml")).unwrap();
        let known =
            known + "\n[gains.tuned-model]\nproportional_pa_per_rad = 11600.0\nintegral_pa_per_rad_s = 200000.0\n";
        std::fs::write(folder.path().join("calibration/paper.toml"), known).unwrap();
        let freerig = |args: &[&str]| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_freerig"));
            let output =
                command.args(args).args(["--stepped", "--seed", seed]).current_dir(folder.path()).output().unwrap();
            assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        };
        let latest = || Run::find(&folder.path().join("runs"), "latest").unwrap();
        freerig(&["calibrate", "all"]);
        freerig(&["trajectory"]);
        let error = Metrics::of(&latest()).unwrap().frees[0].true_error.unwrap();
        let (rms, peak) = (error.rms_rad.to_degrees(), error.peak_rad.to_degrees());
        freerig(&["sweep"]);
        let share = Metrics::of(&latest()).unwrap().frees[0].model_rmsd_percent.unwrap();
        println!("seed {seed}: RMS {rms:.3} deg, peak {peak:.3}; open loop {share:.2} % of the range");
        assert!(rms <= 0.12 && peak <= 0.5 && share <= 1.0, "{rms} {peak} {share}");
    }
}

#[test]
fn the_model_follows_the_papers_trajectory_five_times_closer_than_the_published_gains() {
    let folder = tempfile::tempdir().unwrap();
    let rig = calibrated(folder.path());
    let published = Gains { proportional: 17236.9, integral: 603291.5, ..Gains::default() };
    let (rms, peak) = errors(&course(&rig, Kind::Trajectory));
    let (theirs, _) = errors(&course(&plain(&rig, published), Kind::Trajectory));
    let free = &rig.control.frees[0];
    let tuned = tune(&free.free, &free.regulator, &free.imu.unwrap(), rig.control.period, &Target::PID).unwrap();
    let (pid, _) = errors(&course(&plain(&rig, tuned.gains), Kind::Trajectory));
    println!("RMS: model {rms:.3} deg (peak {peak:.3}), published gains {theirs:.3}, tuned PID {pid:.3}");
    assert!(rms <= 0.12 && peak <= 0.5, "{rms} {peak}");
    assert!(rms <= 0.2 * theirs && rms <= 0.2 * pid, "{rms} {theirs} {pid}");
}

/// How long a step may take: one and a half times what slew and lag of the regulator, followed without any preview,
/// take to come within 2 % of the pressure.
fn allowance(rig: &Rig, pressures: (f64, f64)) -> f64 {
    let regulator = &rig.bench.plants[0].regulator;
    let slewing = (pressures.1 - pressures.0).abs() / regulator.slew;
    1.5 * (regulator.dead_time.as_secs_f64() + slewing + regulator.lag.as_secs_f64() * 50f64.ln())
}

#[test]
fn steps_led_by_the_model_settle_as_fast_as_the_regulator_allows_and_do_not_overshoot() {
    let folder = tempfile::tempdir().unwrap();
    let rig = calibrated(folder.path());
    let course = course(&rig, Kind::Step);
    let mut pressure = 0.0;
    for (start, from, to) in [(0.0, 0.0, 50.0), (3.0, 50.0, 20.0), (6.0, 20.0, 80.0)] {
        let slot = || course.iter().filter(|(t, ..)| (start..start + 2.99).contains(t));
        let share = slot().map(|&(t, _, truth, _)| (t - start, (truth - from) / (to - from) - 1.0));
        let over = share.clone().map(|(_, x)| x).fold(0.0, f64::max);
        let settled = share.filter(|(_, x)| x.abs() > 0.02).map(|(t, _)| t).fold(0.0, f64::max);
        let reached = slot().next_back().unwrap().3;
        let allowed = allowance(&rig, (pressure, reached));
        pressure = reached;
        println!(
            "{from} to {to} deg: overshoot {:.2} %, settled in {settled:.3} s of {allowed:.3} s allowed",
            100.0 * over
        );
        assert!(over <= 0.02 && settled <= allowed, "{over} {settled} {allowed}");
    }
}

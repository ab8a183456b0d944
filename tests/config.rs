//! Configuration: every problem is named, all of them at once, and nothing is built from a file that has one.

use std::fs;
use std::path::{Path, PathBuf};

use freerig::config::calibration::{Entry, SCHEMA, keys};
use freerig::config::{Backend, Calibration, ConfigError, Course, Experiment, Kind, Rig};
use freerig::control::{ControllerKind, Gains};
use freerig::hardware::wiring::ImuProfile;
use freerig::signal::Quantity;
use freerig::units::{Angle, PASCAL_PER_PSI, Pressure};
use proptest::prelude::*;
use tempfile::TempDir;

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The repository's rig.toml and calibrations in a folder of their own, with `edit` applied to rig.toml.
fn rig_with(edit: impl FnOnce(String) -> String) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("calibration")).unwrap();
    for name in ["paper.toml", "published-code.toml"] {
        let from = repository().join("calibration").join(name);
        fs::copy(from, folder.path().join("calibration").join(name)).unwrap();
    }
    let path = folder.path().join("rig.toml");
    fs::write(&path, edit(fs::read_to_string(repository().join("rig.toml")).unwrap())).unwrap();
    (folder, path)
}

/// Replaces the one place where `from` stands.
fn replace(text: &str, from: &str, to: &str) -> String {
    assert_eq!(text.matches(from).count(), 1, "`{from}` must stand in rig.toml once");
    text.replace(from, to)
}

fn problems(path: &Path) -> ConfigError {
    Rig::load(path).expect_err("this rig has a problem")
}

/// Loads the example with one edit and expects exactly one problem, with this key and these words.
#[track_caller]
fn one_problem(from: &str, to: &str, key: &str, rule: &str, remedy: &str) {
    let (_folder, path) = rig_with(|text| replace(&text, from, to));
    let error = problems(&path);
    let [problem] = error.problems.as_slice() else { panic!("one problem is expected: {error}") };
    assert_eq!(problem.key, key, "{error}");
    assert!(problem.rule.contains(rule), "{error}");
    assert!(problem.remedy.contains(remedy), "{error}");
    let line = problem.line.expect("a problem of a key has a line");
    let text = fs::read_to_string(&path).unwrap();
    // The line is that of the key, or of the table that lacks it.
    let shown = text.lines().nth(line - 1).unwrap();
    let last = key.rsplit('.').next().unwrap();
    assert!(shown.contains(last) || shown.starts_with('['), "line {line} is `{shown}`, the key is {key}");
}

const SECOND_FREE: &str = r#"
[[free]]
name = "second"
calibration = "published-code"
[free.imu]
bus = "main"
address = 0x29
[free.regulator]
kind = "alicat"
line = "line"
unit = "B"
full_scale_psi = 15
[free.limits]
max_pressure_psi = 8
proof_pressure_psi = 15
"#;

#[test]
fn the_repositorys_rig_is_clean_and_complete() {
    let rig = Rig::load(&repository().join("rig.toml")).unwrap();
    assert_eq!(rig.backend, Backend::Sim);
    assert_eq!(rig.realtime.period.as_micros(), 2000);
    assert_eq!(rig.control.period, rig.realtime.period);
    assert_eq!(rig.free("paper"), Some(0));
    let free = &rig.control.frees[0];
    assert_eq!(free.free.torsional_stiffness, 0.086);
    assert_eq!(free.free.gamma, (-40f64).to_radians());
    assert_eq!(free.limits.pressure_max, 10.0 * PASCAL_PER_PSI);
    assert_eq!(free.limits.pressure_hard, 11.0 * PASCAL_PER_PSI);
    assert_eq!(free.limits.angle_hard, ((-150f64).to_radians(), 150f64.to_radians()));
    assert_eq!(free.imu.as_ref().unwrap().delay.as_millis(), 15);
    let bench = &rig.bench.plants[0];
    assert_eq!((bench.scatter, bench.hysteresis), (0.03, 0.05));
    assert_eq!(bench.regulator.lag.as_millis(), 60);
    assert_eq!((rig.wiring.i2c[0].imus[0].address, rig.wiring.serial[0].units[0].id), (0x28, b'A'));
    assert_eq!(rig.files.len(), 2);
    assert!(rig.files[0].path.ends_with("rig.toml") && rig.files[1].path.ends_with("calibration/paper.toml"));
}

#[test]
fn the_example_writes_out_every_default() {
    // Whatever is left out means what the example says.
    let (_folder, path) = rig_with(|text| {
        let required =
            ["full_scale_psi", "max_pressure_psi", "proof_pressure_psi", "kind", "line =", "bus", "device", "name"];
        let kept = |line: &&str| line.starts_with('[') || required.iter().any(|key| line.starts_with(key));
        text.lines().filter(kept).collect::<Vec<_>>().join("\n")
    });
    let short = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
    let mut long = Rig::load(&repository().join("rig.toml")).unwrap();
    // The two keys whose value in the example is not the default, as its comments say.
    long.control.frees[0].controller = ControllerKind::Pid;
    long.control.frees[0].limits.tracking_error.0 = f64::INFINITY;
    assert_eq!(short.control, long.control);
    assert_eq!(short.wiring, long.wiring);
    assert_eq!(short.bench, long.bench);
    assert_eq!(short.record, long.record);
    assert_eq!(short.realtime, long.realtime);
}

#[test]
fn every_problem_is_listed_at_once() {
    let (_folder, path) = rig_with(|text| {
        let text = replace(&text, "rate_hz = 500 ", "rate_hz = 9000 ");
        let text = replace(&text, "backend = \"sim\"\n", "backend = \"simulated\"\ncolour = \"red\"\n");
        let text = replace(&text, "max_pressure_psi = 10 ", "max_pressure = 10 ");
        let text = replace(&text, "calibration = \"paper\"", "calibration = \"missing\"");
        let text = text + &SECOND_FREE.replace("0x29", "0x28");
        text + "[[free]]\nname = \"third\"\ncalibration = \"broken\"\n"
    });
    fs::write(path.with_file_name("calibration").join("broken.toml"), "schema = 1\nname = \"broken\"\n").unwrap();
    let error = problems(&path);
    let listed: Vec<&str> = error.problems.iter().map(|problem| problem.key.as_str()).collect();
    for key in [
        "backend",
        "colour",
        "loop.rate_hz",
        "free.paper.limits.max_pressure",
        "free.paper.limits.max_pressure_psi",
        "free.paper.calibration",
        "free.second.imu.address",
        "free.third.regulator.kind",
        "lumped.torsional_stiffness_nm_per_rad",
    ] {
        assert!(listed.contains(&key), "`{key}` is missing in:\n{error}");
    }
    let text = error.to_string();
    assert!(text.contains("problems in the configuration") && text.contains("remedy:"));
    assert!(error.problems.iter().all(|problem| !problem.rule.is_empty() && !problem.remedy.is_empty()), "{error}");
}

#[test]
fn unknown_keys_come_with_the_key_that_was_meant() {
    one_problem("priority = 80 ", "priorty = 80 ", "loop.priorty", "unknown key", "did you mean `priority`");
    one_problem("seed = 1 ", "sead = 1 ", "sim.sead", "unknown key", "did you mean `seed`");
    one_problem("[record]", "[recrod]", "recrod", "unknown key", "did you mean `record`");
}

#[test]
fn a_key_in_another_unit_is_answered_with_the_value_in_the_right_one() {
    let (from, to) = ("imu_delay_ms = 15", "imu_delay_s = 0.015");
    one_problem(from, to, "sim.imu_delay_s", "unknown key", "imu_delay_ms = 15`");
    one_problem(
        "warn_pressure_psi = 10.5 ",
        "warn_pressure = 10.5 ",
        "free.paper.limits.warn_pressure",
        "unknown key",
        "`warn_pressure_psi`",
    );
}

#[test]
fn values_are_held_to_their_type_and_range() {
    one_problem("rate_hz = 500 ", "rate_hz = 10 ", "loop.rate_hz", "within 50 to 4000", "within 50 to 4000");
    // A required key that is there and wrong is wrong, and not missing as well.
    let (ten, many) = ("max_pressure_psi = 10 ", "max_pressure_psi = 500 ");
    one_problem(ten, many, "free.paper.limits.max_pressure_psi", "must be within 0.1 to 150", "within 0.1 to 150");
    one_problem("rate_hz = 500 ", "rate_hz = \"500\" ", "loop.rate_hz", "must be a number", "a number within");
    one_problem("rate_hz = 500 ", "rate_hz = nan ", "loop.rate_hz", "must be a number", "a number within");
    one_problem("priority = 80 ", "priority = 8.5 ", "loop.priority", "whole number", "1 to 98");
    one_problem("live_view = true ", "live_view = 1 ", "record.live_view", "true or false", "live_view = true");
    one_problem("backend = \"sim\"\n", "backend = \"real\"\n", "backend", "one of \"sim\", \"linux\"", "\"linux\"");
    one_problem("baud_bd = 19200 ", "baud_bd = 19201 ", "serial.line.baud_bd", "must be one of", "front panel");
    one_problem("unit = \"A\" ", "unit = \"AB\" ", "free.paper.regulator.unit", "one letter", "front panel");
    one_problem("axis = [0, 0, 1]", "axis = [0, 0, 0.5]", "free.paper.imu.axis", "unit vector", "[0, 0, 1]");
    one_problem("address = 0x28", "address = 0x60", "free.paper.imu.address", "0x28 to 0x29", "0x28 to 0x29");
    one_problem("page_port = 9090", "page_port = 9876", "record.page_port", "differ", "another port");
    let long = format!("path = \"/{}\"", "x".repeat(120));
    one_problem("path = \"runs/control.sock\"", &long, "socket.path", "at most 97 bytes", "shorter");
}

#[test]
fn limits_are_held_to_their_order() {
    let limits = "free.paper.limits";
    one_problem(
        "warn_pressure_psi = 10.5",
        "warn_pressure_psi = 9",
        &format!("{limits}.warn_pressure_psi"),
        "order",
        "above 10.00",
    );
    one_problem(
        "hard_pressure_psi = 11 ",
        "hard_pressure_psi = 10.2 ",
        &format!("{limits}.hard_pressure_psi"),
        "order",
        "above 10.50",
    );
    one_problem(
        "proof_pressure_psi = 15",
        "proof_pressure_psi = 10.9",
        &format!("{limits}.proof_pressure_psi"),
        "order",
        "tested",
    );
    // One wrong number is answered with its own correction, not with three others that would go along with it.
    one_problem(
        "max_pressure_psi = 10 ",
        "max_pressure_psi = 99 ",
        &format!("{limits}.max_pressure_psi"),
        "below proof_pressure_psi, 15.00 psi",
        "for example 7.5",
    );
    one_problem(
        "full_scale_psi = 15",
        "full_scale_psi = 10.8",
        &format!("{limits}.hard_pressure_psi"),
        "full scale of 10.80 psi",
        "wider",
    );
    one_problem(
        "soft_angle_deg = [-120, 120]",
        "soft_angle_deg = [-120, 160]",
        &format!("{limits}.soft_angle_deg"),
        "inside",
        "narrow",
    );
    one_problem(
        "hard_angle_deg = [-150, 150]",
        "hard_angle_deg = [150, -150]",
        &format!("{limits}.hard_angle_deg"),
        "lower one first",
        "[-1, 1]",
    );
}

#[test]
fn names_must_lead_somewhere() {
    one_problem("gains = \"freerig\"", "gains = \"paper-pid\"", "free.paper.gains", "no gains `paper-pid`", "paper-pi");
    one_problem(
        "calibration = \"paper\" ",
        "calibration = \"none\" ",
        "free.paper.calibration",
        "none.toml",
        "published-code",
    );
    one_problem("\nbus = \"main\"", "\nbus = \"other\"", "free.paper.imu.bus", "no `[i2c.other]`", "main");
    one_problem("line = \"line\"", "line = \"other\"", "free.paper.regulator.line", "no `[serial.other]`", "line");
}

#[test]
fn two_frees_cannot_share_a_device_or_a_name() {
    let with_second = |from: &str, to: &str| {
        let (_folder, path) = rig_with(|text| text + &replace(SECOND_FREE, from, to));
        problems(&path)
    };
    let (_folder, path) = rig_with(|text| text + SECOND_FREE);
    let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(rig.free("second"), Some(1));
    // Two units on the line: each is served half as often.
    assert_eq!(rig.control.frees[0].regulator.period.as_micros(), 31_770);
    for (from, to, key) in [
        ("unit = \"B\"", "unit = \"A\"", "free.second.regulator.unit"),
        ("0x29", "0x28", "free.second.imu.address"),
        ("name = \"second\"", "name = \"paper\"", "free.paper.name"),
    ] {
        let error = with_second(from, to);
        assert_eq!(error.problems.len(), 1, "{error}");
        assert_eq!(error.problems[0].key, key, "{error}");
    }
}

#[test]
fn two_frees_cannot_share_a_dac_channel_and_need_its_measured_map() {
    let dac = |name: &str| {
        format!(
            "[[free]]\nname = \"{name}\"\ncalibration = \"dac\"\n[free.regulator]\nkind = \"mcp4728\"\nbus = \"main\"\n\
             channel = \"C\"\nfull_scale_psi = 15\n[free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\n"
        )
    };
    let (_folder, path) = rig_with(|text| text + &dac("one") + &dac("two"));
    let mut calibration = Calibration::read(&repository().join("calibration/paper.toml")).unwrap();
    calibration.name = "dac".into();
    let directory = path.with_file_name("calibration");
    calibration.write(&directory).unwrap();
    let error = problems(&path);
    let keys: Vec<_> = error.problems.iter().map(|problem| problem.key.as_str()).collect();
    assert_eq!(keys, ["free.one.regulator", "free.two.regulator", "free.two.regulator.channel"], "{error}");

    let given = |value| Entry { value, method: "staircase".into(), ..Entry::default() };
    calibration.set(&keys::ZERO_CODE, given(120.0));
    calibration.set(&keys::PRESSURE_PER_CODE, given(25.0));
    calibration.write(&directory).unwrap();
    fs::write(&path, fs::read_to_string(&path).unwrap().replacen("channel = \"C\"", "channel = \"A\"", 1)).unwrap();
    let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
    let channels = rig.wiring.i2c[0].dacs[0].channels;
    assert_eq!(channels.map(|channel| channel.map(|channel| channel.free)), [Some(1), None, Some(2), None]);
    assert!(!rig.control.frees[1].regulator.measures, "a DAC has no pressure sensor");
}

#[test]
fn a_pwm_output_has_its_id_on_the_line_alone_and_needs_its_measured_map() {
    let output = |name: &str, id: &str| {
        format!(
            "[[free]]\nname = \"{name}\"\ncalibration = \"pwm\"\n[free.regulator]\nkind = \"pwm\"\nline = \"line\"\n\
             unit = \"{id}\"\nfull_scale_psi = 15\n[free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\n"
        )
    };
    // `A` is the Alicat unit's.
    let (_folder, path) = rig_with(|text| text + &output("one", "A") + &output("two", "c"));
    let mut calibration = Calibration::read(&repository().join("calibration/paper.toml")).unwrap();
    calibration.name = "pwm".into();
    let directory = path.with_file_name("calibration");
    calibration.write(&directory).unwrap();
    let error = problems(&path);
    let mut keys: Vec<_> = error.problems.iter().map(|problem| problem.key.as_str()).collect();
    keys.sort_unstable();
    let (one, two) = ("free.one.regulator", "free.two.regulator");
    assert_eq!(keys, [one, &format!("{one}.unit"), two, &format!("{two}.unit")], "{error}");

    let given = |value| Entry { value, method: "staircase".into(), ..Entry::default() };
    calibration.set(&keys::ZERO_CODE, given(120.0));
    calibration.set(&keys::PRESSURE_PER_CODE, given(25.0));
    calibration.write(&directory).unwrap();
    let text = fs::read_to_string(repository().join("rig.toml")).unwrap();
    fs::write(&path, text + &output("one", "B") + &output("two", "C")).unwrap();
    let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
    let line = &rig.wiring.serial[0];
    assert_eq!(line.pwms.iter().map(|pwm| (pwm.id, pwm.channel.free)).collect::<Vec<_>>(), [(b'B', 1), (b'C', 2)]);
    assert_eq!((line.units.len(), line.pwms[0].channel.zero_code), (1, 120.0));
    assert!(!rig.control.frees[1].regulator.measures, "an output has no pressure sensor");
    // Three units take turns on the line, 30.5 characters each at 19200 Bd.
    assert_eq!(rig.control.frees[1].regulator.period.as_micros(), 47_656);
    // 3.5 idle characters and the 12 of a command.
    assert!((rig.transport(1) - 15.5 * 10.0 / 19_200.0).abs() < 1e-9);
}

#[test]
fn a_slew_limit_that_a_ramp_down_cannot_keep_is_a_problem_of_the_file() {
    // 10 psi at 2 psi/s take 5 s; a ramp down has 3.
    one_problem(
        "slew_psi_per_s = 30 ",
        "slew_psi_per_s = 2 ",
        "safety.ramp_time_s",
        "is 3.0 s, and `paper` takes 5.0 s",
        "raise slew_psi_per_s of `paper`",
    );
}

#[test]
fn a_line_too_slow_for_its_units_is_a_problem_of_the_file() {
    // Five units at 9600 baud: 30.5 characters of 10 bits each.
    let unit = |name: &str, id: &str| {
        SECOND_FREE
            .replace("[free.imu]\nbus = \"main\"\naddress = 0x29\n", "")
            .replace("second", name)
            .replace("\"B\"", id)
    };
    let five = |baud: &str| {
        rig_with(|text| {
            let others = ["b", "c", "d", "e"].map(|n| unit(n, &format!("\"{}\"", n.to_uppercase()))).concat();
            replace(&text, "baud_bd = 19200", &format!("baud_bd = {baud}")) + &others
        })
    };
    let (_folder, path) = five("9600");
    let error = problems(&path);
    assert_eq!(error.problems.len(), 1, "{error}");
    let problem = &error.problems[0];
    assert_eq!(problem.key, "serial.line.baud_bd");
    assert!(problem.rule.contains("5 units in 159 ms") && problem.rule.contains("command_timeout_ms = 100"), "{error}");
    assert!(problem.remedy.contains("at least 19200 (79 ms)"), "{error}");
    for (baud, period) in [("19200", 79), ("38400", 39), ("115200", 13)] {
        let (_folder, path) = five(baud);
        let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(rig.control.frees[4].regulator.period.as_millis(), period);
    }
}

#[test]
fn every_syntax_error_is_listed() {
    let (_folder, path) = rig_with(|_| "a = = 3\n[b\nc = \"x\n".into());
    let error = problems(&path);
    assert!(error.problems.len() >= 2, "{error}");
    assert_eq!(error.problems[0].line, Some(1));
    assert!(problems(Path::new("/nowhere/rig.toml")).to_string().contains("--rig FILE"));
}

#[test]
fn a_changed_file_is_noticed() {
    let (_folder, path) = rig_with(|text| text);
    let rig = Rig::load(&path).unwrap();
    assert!(rig.changed_files().is_empty());
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.clone() + "\n").unwrap();
    assert_eq!(rig.changed_files(), [path.as_path()]);
    fs::write(&path, text).unwrap();
    assert!(rig.changed_files().is_empty(), "the same text is the same configuration");
    fs::remove_file(path.with_file_name("calibration").join("paper.toml")).unwrap();
    assert_eq!(rig.changed_files().len(), 1);
    // SHA-256 of "abc", FIPS 180-2.
    let file = freerig::config::SourceFile { path, text: "abc".into() };
    assert_eq!(file.sha256(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

#[test]
fn the_reference_frees_are_those_of_the_paper_and_its_code() {
    for (name, length, axial, torsional, axial_damping, torsional_damping) in
        [("paper", 0.110, 10110.0, 0.086, 5.0, 0.005), ("published-code", 0.120, 16478.0, 0.0862, 0.34, 3.97e-5)]
    {
        let free = Calibration::read(&repository().join(format!("calibration/{name}.toml"))).unwrap().free();
        assert_eq!(free.gamma, (-40f64).to_radians());
        assert_eq!((free.length, free.radius, free.mass), (length, 0.007, 0.028));
        assert!((free.inertia - free.mass * free.radius * free.radius).abs() < 1e-18, "I = m R^2");
        assert_eq!((free.axial_stiffness, free.torsional_stiffness), (axial, torsional));
        assert_eq!((free.axial_damping, free.torsional_damping), (axial_damping, torsional_damping));
    }
}

/// Up to `longest` characters of any script, none of which controls anything.
fn text(longest: usize) -> impl Strategy<Value = String> {
    let character = any::<char>().prop_filter("a printable character", |c| !c.is_control());
    proptest::collection::vec(character, 0..=longest).prop_map(String::from_iter)
}

fn some_text(longest: usize) -> impl Strategy<Value = String> {
    text(longest).prop_filter("some text", |text| !text.is_empty())
}

/// Up to `longest` of `characters`.
fn made_of(characters: &'static str, longest: usize) -> impl Strategy<Value = String> {
    let characters: Vec<char> = characters.chars().collect();
    proptest::collection::vec(proptest::sample::select(characters), 0..=longest).prop_map(String::from_iter)
}

/// A line that may stand in an experiment file, or nearly so.
fn assignment() -> impl Strategy<Value = String> {
    let keys = ["kind", "angles_deg", "pressures_psi", "hold_s", "move_s", "shape", "segments", "free", "repeat"];
    let value = prop_oneof![
        Just("\"step\"".to_owned()),
        Just("\"sweep\"".to_owned()),
        Just("{ to_deg = 1 }".to_owned()),
        made_of("0123456789, .-", 12).prop_map(|list| format!("[{list}]")),
        made_of("0123456789.e-", 9),
    ];
    (proptest::sample::select(keys.to_vec()), value).prop_map(|(key, value)| format!("{key} = {value}\n"))
}

fn calibration_strategy() -> impl Strategy<Value = Calibration> {
    let entry = (any::<u64>(), proptest::option::of(0.0..1e3f64), text(20), proptest::option::of(-1e9..1e9f64));
    let gains = proptest::collection::btree_map(some_text(12), (0.0..1e8f64, 0.0..1e8f64), 0..3);
    (proptest::collection::vec(entry, SCHEMA.len()), gains, proptest::option::of(any::<[u8; 22]>())).prop_map(
        |(entries, gains, registers)| {
            let mut calibration = Calibration::default();
            calibration.name = "any".into();
            calibration.note = "a \"quoted\" note
"
            .into();
            calibration.imu_profile = registers.map(|registers| ImuProfile { unique_id: [0xa5; 16], registers });
            for (key, (draw, uncertainty, method, prediction)) in SCHEMA.iter().zip(entries) {
                let fraction = draw as f64 / u64::MAX as f64;
                let value = key.range.0 + fraction * (key.range.1 - key.range.0);
                let value = if key.name == keys::WINDING_ANGLE.name && value.abs() < 1.0 { 40.0 } else { value };
                // Of the same hand as the geometry's.
                let hand = calibration.value(&keys::WINDING_ANGLE).filter(|_| key.name == keys::EFFECTIVE_ANGLE.name);
                let value = hand.map_or(value, |wound| value.abs().max(1.0).copysign(wound));
                if key.required || draw % 2 == 0 {
                    let date = Some("2026-01-31".to_owned());
                    let run = Some("2026-01-31-calibrate-1".to_owned());
                    let standard_uncertainty = uncertainty;
                    calibration.set(
                        key,
                        Entry {
                            value,
                            standard_uncertainty,
                            method,
                            residual: uncertainty,
                            date,
                            run,
                            prediction,
                            simulated_nominal: (draw % 3 == 0).then_some(value),
                        },
                    );
                }
            }
            for (name, (proportional, integral)) in gains {
                calibration.set_gains(name, Gains { proportional, integral, derivative: 0.0, derivative_filter: 20.0 });
            }
            calibration
        },
    )
}

#[test]
fn an_effective_winding_angle_of_the_other_hand_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(repository().join("calibration/paper.toml")).unwrap();
    let path = folder.path().join("paper.toml");
    let with = |angle: f64| {
        let line = format!("[lumped]\neffective_winding_angle_deg = {{ value = {angle:?}, method = \"test\" }}");
        fs::write(&path, text.replace("[lumped]", &line)).unwrap();
        Calibration::read(&path)
    };
    let known = with(-38.0).unwrap();
    assert!((known.free().gamma.to_degrees() + 38.0).abs() < 1e-9, "the lumped model's");
    assert!((known.tube().0.gamma.to_degrees() + 40.0).abs() < 1e-9, "the tube's is the geometry's");
    assert!((known.simulated_nominal().gamma.to_degrees() + 40.0).abs() < 1e-9, "and so is the simulated FREE's");
    let error = with(38.0).unwrap_err().to_string();
    assert!(error.contains("must have the sign of `winding_angle_deg`") && error.contains("remove it"), "{error}");
}

#[test]
fn one_wrong_key_of_a_values_conditions_leaves_the_others_known() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("paper.toml");
    let text = fs::read_to_string(repository().join("calibration/paper.toml")).unwrap();
    let keys = "winding_angle_deg = -40.0\nlength_mm = 0\nfiber_radius_mm = 7.0";
    fs::write(&path, format!("{text}\n[conditions.torsional_stiffness_nm_per_rad]\n{keys}\n")).unwrap();
    let error = Calibration::read(&path).unwrap_err();
    let [problem] = error.problems.as_slice() else { panic!("one problem is expected: {error}") };
    assert!(problem.key.ends_with("length_mm") && problem.rule.contains("must be"), "{error}");
}

proptest! {
    #[test]
    fn a_calibration_reads_back_as_it_was_written(calibration in calibration_strategy()) {
        let folder = tempfile::tempdir().unwrap();
        let path = calibration.write(folder.path()).unwrap();
        let read = Calibration::read(&path).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(read, calibration);
    }

    #[test]
    fn whatever_a_file_says_nothing_panics(text in text(300), cut in 0usize..6000, insert in made_of("[]={}\"'#\n,.abcxyz0159-", 12)) {
        let example = fs::read_to_string(repository().join("rig.toml")).unwrap();
        let mut at = cut.min(example.len());
        while !example.is_char_boundary(at) {
            at -= 1;
        }
        for text in [text, format!("{}{insert}{}", &example[..at], &example[at..]), format!("{}{insert}", &example[..at])] {
            let (_folder, path) = rig_with(|_| text);
            if let Err(error) = Rig::load(&path) {
                prop_assert!(!error.problems.is_empty());
            }
            let _ = Calibration::read(&path);
        }
    }

    #[test]
    fn whatever_an_experiment_says_nothing_panics(body in assignment()) {
        let rig = Rig::load(&repository().join("rig.toml")).unwrap();
        for text in [body.clone(), format!("kind = \"step\"\nangles_deg = [10]\nhold_s = 1\n{body}"), format!("kind = \"sweep\"\n{body}")] {
            let _ = Experiment::parse(Path::new("any.toml"), &text, &rig, None);
        }
    }
}

#[test]
fn a_calibration_is_replaced_as_a_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let mut calibration = Calibration::read(&repository().join("calibration/paper.toml")).unwrap();
    let path = calibration.write(folder.path()).unwrap();
    let before = fs::read_to_string(&path).unwrap();
    // A reader that opened the file before sees all of the old one, whatever is written meanwhile.
    let mut open = fs::File::open(&path).unwrap();
    calibration.set(&keys::TORSIONAL_STIFFNESS, Entry { value: 0.09, method: "weights".into(), ..Entry::default() });
    calibration.write(folder.path()).unwrap();
    let mut seen = String::new();
    std::io::Read::read_to_string(&mut open, &mut seen).unwrap();
    assert_eq!(seen, before);
    assert_eq!(Calibration::read(&path).unwrap().free().torsional_stiffness, 0.09);
    // The target cannot be replaced: what was there stays, and no temporary file is left behind.
    let blocked = folder.path().join("blocked.toml");
    fs::create_dir(&blocked).unwrap();
    fs::write(blocked.join("inside"), "").unwrap();
    calibration.name = "blocked".into();
    assert!(calibration.write(folder.path()).is_err());
    let mut left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["blocked.toml", "paper.toml"]);
}

fn example_rig() -> Rig {
    Rig::load(&repository().join("rig.toml")).unwrap()
}

#[test]
fn the_experiments_of_the_repository_are_those_of_the_paper() {
    let rig = example_rig();
    for (file, kind, gains, duration, at) in [
        ("paper-step", Kind::Step, None, 9.0, [(1.0, 50.0), (4.0, 20.0), (8.9, 80.0)]),
        ("published-step", Kind::Step, Some("published-step"), 9.0, [(1.0, 50.0), (4.0, 20.0), (8.9, 80.0)]),
        ("paper-trajectory", Kind::Trajectory, None, 9.0, [(0.75, 20.0), (3.75, 25.0), (7.6, 70.0)]),
        (
            "published-trajectory",
            Kind::Trajectory,
            Some("published-trajectory"),
            9.0,
            [(0.75, 20.0), (3.75, 25.0), (7.6, 70.0)],
        ),
    ] {
        let path = repository().join(format!("experiments/{file}.toml"));
        let text = freerig::config::experiment::read_text(&path).unwrap();
        let experiment = Experiment::parse(&path, &text, &rig, None).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((experiment.kind, experiment.subject, experiment.repeat), (kind, 0, 1));
        assert_eq!(experiment.gains.map(|gains| gains.0).as_deref(), gains);
        assert_eq!(experiment.program.duration, duration);
        for (time, degrees) in at {
            let reference = experiment.program.reference(0, time);
            assert_eq!(reference.quantity, Quantity::Angle);
            // The cubic is exact to rounding.
            assert!((reference.position.to_degrees() - degrees).abs() < 1e-9, "{file} at {time} s");
        }
    }
}

#[test]
fn a_sweep_goes_up_and_down_again() {
    let rig = example_rig();
    let (name, text) = Kind::Sweep.default_file().unwrap();
    let sweep = Experiment::parse(Path::new(name), text, &rig, None).unwrap_or_else(|error| panic!("{error}"));
    let psi = |time| sweep.program.reference(0, time).position / PASCAL_PER_PSI;
    assert_eq!(sweep.program.duration, 33.0);
    for (time, expected) in [(0.0, 0.0), (5.9, 1.0), (17.9, 5.0), (20.9, 4.0), (32.9, 0.0)] {
        assert!((psi(time) - expected).abs() < 1e-9, "{time} s");
    }
}

#[test]
fn flags_and_files_say_the_same() {
    let rig = example_rig();
    for kind in Kind::ALL {
        let Some((name, text)) = kind.default_file() else { continue };
        let file = Experiment::parse(Path::new(name), text, &rig, None).unwrap();
        let flags = Course::default().to_toml(kind);
        let flags = Experiment::parse(Path::new("flags"), &flags, &rig, None).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(flags.program, file.program, "no flag at all means the default file");
    }
    let course = Course {
        angles: vec![Angle::degrees(33.0), Angle::degrees(-12.5)],
        hold: Some(0.5),
        moving: Some(0.25),
        shape: Some("quintic".into()),
        gains: Some("paper-pi".into()),
        ..Course::default()
    };
    let text = course.to_toml(Kind::Trajectory);
    assert!(text.contains("angles_deg = [33, -12.5]"), "{text}");
    let experiment = Experiment::parse(Path::new("flags"), &text, &rig, Some("paper")).unwrap();
    assert_eq!(experiment.program.duration, 1.5);
    assert_eq!(experiment.gains.unwrap().1.proportional, 32_000.0);
    let course = Course { pressures: vec![Pressure::psi(7.0)], ..Course::default() };
    assert!(course.to_toml(Kind::Step).contains("pressures_psi = [7]"));
}

#[test]
fn segments_say_piece_by_piece_what_happens() {
    let text = "kind = \"trajectory\"\nsegments = [\n  { to_deg = 40, shape = \"quintic\", duration_s = 1.5 },\n  \
                { hold_s = 2 },\n  { amplitude_deg = 10, frequency_hz = 0.5, duration_s = 4 },\n]\n";
    let experiment =
        Experiment::parse(Path::new("x.toml"), text, &example_rig(), None).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((experiment.name.as_str(), experiment.program.duration), ("x", 7.5));
    let degrees = |time| experiment.program.reference(0, time).position.to_degrees();
    assert!(
        (degrees(0.75) - 20.0).abs() < 1e-9 && (degrees(3.0) - 40.0).abs() < 1e-9 && (degrees(4.0) - 50.0).abs() < 1e-9
    );
}

#[test]
fn an_experiment_is_held_to_the_rig_that_is_to_run_it() {
    let rig = example_rig();
    for (text, words) in [
        ("kind = \"step\"\nangles_deg = [130]\nhold_s = 1", "soft envelope of `paper` is -120.0 deg to 120.0 deg"),
        ("kind = \"sweep\"\npressures_psi = [0, 11]\nhold_s = 1", "`paper` takes 0 to 10.00 psi"),
        ("kind = \"sweep\"\npressures_psi = [-1]\nhold_s = 1", "`paper` takes 0 to 10.00 psi"),
        ("kind = \"step\"\nangles_deg = [10]\nhold_s = 1\nfree = \"left\"", "no FREE `left`"),
        ("kind = \"step\"\nangles_deg = [10]\nhold_s = 1\ngains = \"mine\"", "no gains `mine`"),
        ("kind = \"step\"\nangles_deg = [10]", "hold_s: is required"),
        ("kind = \"step\"\nhold_s = 1", "angles_deg: is required"),
        ("kind = \"jump\"\nhold_s = 1", "must be one of \"step\", \"trajectory\", \"sweep\""),
        ("kind = \"step\"\nangles_deg = [10]\npressures_psi = [1]\nhold_s = 1", "contradicts `angles_deg`"),
        ("kind = \"step\"\nangles_deg = []\nhold_s = 1", "is empty"),
        ("kind = \"step\"\nangles_deg = [10]\nhold_s = 1\nmove_s = 1", "a step takes no time"),
        ("kind = \"trajectory\"\nangles_deg = [10]\nhold_s = 1", "move_s: is required"),
        ("kind = \"trajectory\"\nsegments = [{ to_deg = 1, duration_s = 1 }, { to_psi = 1, duration_s = 1 }]", "mixes"),
        ("kind = \"trajectory\"\nsegments = [{ hold_s = 1 }]", "no angle and no pressure"),
        ("kind = \"step\"\nangles = [10]\nhold_s = 1", "write `angles_deg`"),
        ("kind = \"step\"\nangles_deg = [10]\nhold_s = 1\nrepeat = 0", "whole number within 1 to 1000"),
    ] {
        let error = Experiment::parse(Path::new("x.toml"), text, &rig, None).expect_err(text);
        assert!(error.to_string().contains(words), "{text}\n{error}");
        // What is missing brings no other problem with it.
        assert!(!words.contains("is required") || error.problems.len() == 1, "{text}\n{error}");
    }
}

#[test]
fn experiments_for_several_frees_name_them() {
    let (_folder, path) = rig_with(|text| text + SECOND_FREE);
    let rig = Rig::load(&path).unwrap();
    let one = "kind = \"step\"\nangles_deg = [10]\nhold_s = 1";
    let error = Experiment::parse(Path::new("x.toml"), one, &rig, None).unwrap_err();
    assert!(error.to_string().contains("--free NAME"), "{error}");
    assert_eq!(Experiment::parse(Path::new("x.toml"), one, &rig, Some("second")).unwrap().subject, 1);
    let both = "kind = \"step\"\n[[axis]]\nfree = \"second\"\nangles_deg = [10]\nhold_s = 1\n\
                [[axis]]\nfree = \"paper\"\npressures_psi = [1]\nhold_s = 2";
    let experiment = Experiment::parse(Path::new("x.toml"), both, &rig, None).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((experiment.subject, experiment.program.duration), (1, 2.0));
    let twice = both.replace("\"second\"", "\"paper\"");
    let error = Experiment::parse(Path::new("x.toml"), &twice, &rig, None).unwrap_err();
    assert!(error.to_string().contains("two references"), "{error}");
}

#[test]
fn digital_lines_are_read_and_each_has_a_number_of_its_own() {
    let gpio = "[gpio]\nchip = \"/dev/gpiochip4\"\ndump_valve = 17\nheartbeat = 27\nestop = 22\n\n[safety]";
    let (_folder, path) = rig_with(|text| replace(&text, "[safety]", gpio));
    let rig = Rig::load(&path).unwrap();
    let wired = rig.wiring.gpio.unwrap();
    assert_eq!((wired.dump_valve, wired.heartbeat, wired.estop), (Some(17), Some(27), Some(22)));
    assert!(wired.chip.ends_with("gpiochip4") && rig.control.dump_valve && rig.bench.one_shot);
    // On real lines the valve is fitted where it is wired.
    for (lines, fitted) in [("dump_valve = 17", true), ("estop = 22", false)] {
        let (_folder, path) = rig_with(|text| {
            let text = replace(&text, "[safety]", &format!("[gpio]\n{lines}\n\n[safety]"));
            replace(&text, "\nbackend = \"sim\"", "\nbackend = \"linux\"")
        });
        assert_eq!(Rig::load(&path).unwrap().control.dump_valve, fitted, "{lines}");
    }
    let twice = "[gpio]\ndump_valve = 17\nestop = 17\n\n[safety]";
    one_problem("[safety]", twice, "gpio.estop", "another line has this number", "gpioinfo");
    one_problem("[safety]", "[gpio]\nheartbeat = 27\n\n[safety]", "gpio.heartbeat", "dump valve's", "dump_valve");
}

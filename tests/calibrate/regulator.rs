//! `freerig calibrate regulator` of analogue regulators behind a DAC, as a user meets it on the simulated rig.

use std::fs;
use std::path::Path;
use std::process::Output;

use freerig::config::Rig;
use freerig::daemon::calibration::gauge;
use freerig::sim::SimRig;
use serde_json::Value;

use crate::harness::{freerig, refused};

const PSI: f64 = 6894.757293168;

/// A folder with a rig of two FREEs on the channels A and B of one DAC; `twin` goes into their [free.sim].
fn bench(twin: [&str; 2]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR"));
    let paper = fs::read_to_string(source.join("calibration/paper.toml")).unwrap();
    fs::create_dir(folder.path().join("calibration")).unwrap();
    let mut rig = String::from("[i2c.main]\ndevice = \"/dev/i2c-1\"\n");
    for ((name, channel, imu), twin) in [("one", "A", "0x28"), ("two", "B", "0x29")].into_iter().zip(twin) {
        let nominal = "[regulator]\nzero_code = { value = 60.0, method = \"nominal\" }\n\
                       span_pa_per_code = { value = 26.0, method = \"nominal\" }\n";
        let known = paper.replace("name = \"paper\"", &format!("name = \"{name}\"")).replace("[regulator]\n", nominal);
        fs::write(folder.path().join(format!("calibration/{name}.toml")), known).unwrap();
        rig += &format!(
            "[[free]]\nname = \"{name}\"\n[free.imu]\nbus = \"main\"\naddress = {imu}\n\
             [free.regulator]\nkind = \"mcp4728\"\nbus = \"main\"\nchannel = \"{channel}\"\nfull_scale_psi = 15\n\
             [free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\n[free.sim]\n{twin}\n"
        );
    }
    fs::write(folder.path().join("rig.toml"), rig + "[sim]\nseed = 5\n").unwrap();
    folder
}

fn calibrate(folder: &Path, more: &[&str]) -> Output {
    freerig(folder, &[&["calibrate", "regulator", "--free", "two", "--stepped", "--json"], more].concat())
}

#[test]
fn channel_zero_and_span_are_measured_and_the_simulated_regulator_stays_what_it_is() {
    let folder = bench(["", ""]);
    let rig = Rig::load(&folder.path().join("rig.toml")).unwrap();
    let truth = SimRig::analogue(&rig.bench, 1).unwrap();
    assert!((truth.zero_code - 60.0).abs() > 1.0 && (truth.pascals_per_code / 26.0 - 1.0).abs() > 0.003, "{truth:?}");
    let measure = || {
        let output = calibrate(folder.path(), &[]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains("channel B of 0x60 on main feeds `two`"), "{said}");
        let found: Value = serde_json::from_slice(&output.stdout).unwrap();
        let of = |i: usize| {
            let value = &found["values"][i];
            (value["value"].as_f64().unwrap(), value["standard_uncertainty"].as_f64().unwrap())
        };
        (of(0), of(1), found)
    };
    // The second begins from what the first found.
    for round in 0..2 {
        let ((zero, u_zero), (span, u_span), found) = measure();
        println!(
            "zero {zero:.1} +- {u_zero:.1}, true {:.1}; span {span:.3} +- {u_span:.3}, true {:.3}",
            truth.zero_code, truth.pascals_per_code
        );
        assert!((zero - truth.zero_code).abs() < 3.0 * u_zero && u_zero < 15.0, "{round}: {found}");
        assert!((span - truth.pascals_per_code).abs() < 3.0 * u_span && u_span < 0.01 * span, "{round}: {found}");
        let page = fs::read_to_string(folder.path().join(found["report"].as_str().unwrap())).unwrap();
        assert!(page.contains("SIMULATED") && page.contains("hysteresis") && page.contains("crosstalk"));
    }
    let text = fs::read_to_string(folder.path().join("calibration/two.toml")).unwrap();
    for part in [
        "simulated_nominal = 60.0",
        "simulated_nominal = 26.0",
        "hysteresis 0.",
        "[conditions.zero_code]",
        "channel B of 0x60 on main",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn tubes_on_other_channels_than_rig_toml_says_are_refused_with_what_to_change() {
    let folder = bench(["dac_channel = \"B\"", "dac_channel = \"A\""]);
    let before = fs::read_to_string(folder.path().join("calibration/two.toml")).unwrap();
    let words = [
        "`one` is fed by channel B",
        "write `channel = \"B\"` for it",
        "`two` is fed by channel A",
        "write `channel = \"A\"`",
    ];
    refused(&calibrate(folder.path(), &[]), 1, &words);
    // One that hangs on a channel that rig.toml does not name is found to hang on none that it does.
    let folder = bench(["", "dac_channel = \"D\""]);
    refused(
        &calibrate(folder.path(), &[]),
        1,
        &["pressure 1 follows no channel", "1 is `two` with channel B", "`channel` or `unit` in rig.toml"],
    );
    assert_eq!(fs::read_to_string(folder.path().join("calibration/two.toml")).unwrap(), before);
}

#[test]
fn readings_of_the_gauge_come_from_a_script_and_unsound_ones_are_refused() {
    let folder = bench(["", ""]);
    let rig = Rig::load(&folder.path().join("rig.toml")).unwrap();
    let commanded: Vec<f64> = gauge::pressures(&rig, 1).unwrap().into_iter().map(|p| p / PSI).collect();
    let with = |readings: Vec<f64>| {
        fs::write(folder.path().join("gauge.toml"), format!("ready = [\"regulator\"]\ngauge_psi = {readings:?}\n"))
            .unwrap();
        calibrate(folder.path(), &["--script", "gauge.toml"])
    };
    // 5 % more than was commanded, and nothing below 0.4 psi: the map is code = 60 + p / 26.
    let sound = with(commanded.iter().map(|p| 1.05 * p).collect());
    let found: Value =
        serde_json::from_slice(&sound.stdout).unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&sound.stderr)));
    let of = |i: usize| found["values"][i]["value"].as_f64().unwrap();
    // Codes are whole numbers.
    assert!((of(0) - 60.0).abs() < 1.0 && (of(1) / (1.05 * 26.0) - 1.0).abs() < 2e-3, "{found}");
    refused(&with(vec![1.0, 2.0]), 1, &["2 readings of the gauge for 17 steps", "in psi"]);
    let leaking = commanded.iter().enumerate().map(|(i, p)| if i > 8 { 0.85 * p } else { *p }).collect();
    refused(&with(leaking), 1, &["lower on the way down", "leak"]);
    refused(&with(commanded.iter().map(|p| 0.3 * p).collect()), 1, &["the span is", "wrong range"]);
    refused(&with(commanded.iter().map(|p| p + 1.2).collect()), 1, &["below zero", "there is pressure in the FREE"]);
    fs::write(folder.path().join("gauge.toml"), "gauge_psi = [1, \"x\"]\n").unwrap();
    refused(&calibrate(folder.path(), &["--script", "gauge.toml"]), 2, &["gauge.toml:1", "list of numbers"]);
}

#[test]
fn without_zero_and_span_the_rig_says_how_to_begin() {
    let folder = bench(["", ""]);
    let file = folder.path().join("calibration/two.toml");
    let text = fs::read_to_string(&file).unwrap();
    let bare: String =
        text.lines().filter(|line| !line.contains("_code")).fold(String::new(), |all, line| all + line + "\n");
    fs::write(&file, bare).unwrap();
    let words = ["zero_code", "nominal", "span_pa_per_code = { value = 25.3", "freerig calibrate regulator"];
    refused(&freerig(folder.path(), &["config", "check"]), 2, &words);
}

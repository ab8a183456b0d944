//! The scene of the paper's demonstration: a module that whisks and a FREE that turns a cooktop's knob, five channels
//! at once, by Alicat units and by DACs.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use freerig::config::experiment::Experiment;
use freerig::config::{Rig, Whisk};
use freerig::control::Request;
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Bench, Stepped, procedure};
use freerig::signal::{FaultCode, ImuHealth, State, TickRecord};
use freerig::sim::chips::Misbehaviour;
use freerig::units::PASCAL_PER_PSI as PSI;
use tempfile::TempDir;

/// The example's knob.
const KNOB: usize = 4;
/// What the knob does in these tests.
const HEAT: &str =
    "[[axis]]\nfree = \"knob\"\ntemperatures_degc = [115, 80]\nshape = \"cubic\"\nmove_s = 1.5\nhold_s = 1.5\n";

/// The text of the example rig in `folder`, its runs there.
fn text(folder: &Path) -> String {
    let calibrations = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration");
    let text = fs::read_to_string("experiments/cook/rig.toml").unwrap();
    let runs = folder.join("runs");
    text.replace("\"../../calibration\"", &format!("{calibrations:?}")).replacen(
        "[loop]",
        &format!("[record]\ndirectory = {runs:?}\nlive_view = false\n\n[loop]"),
        1,
    )
}

fn load(folder: &Path, text: &str) -> Result<Rig, String> {
    let path = folder.join("rig.toml");
    fs::write(&path, text).unwrap();
    Rig::load(&path).map_err(|error| error.to_string())
}

/// The example rig with other values: each a text of its rig.toml and what takes its place.
fn rig(changes: &[(&str, &str)]) -> (TempDir, Rig) {
    let folder = TempDir::new().unwrap();
    let mut text = text(folder.path());
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let rig = load(folder.path(), &text).unwrap_or_else(|error| panic!("{error}"));
    (folder, rig)
}

/// A small circle of pressures about 3 psi, in 2 s.
fn circle() -> Whisk {
    let times: Vec<f64> = (0..=40).map(|k| 0.05 * f64::from(k)).collect();
    let at = |t: f64, free: usize| {
        let phase = std::f64::consts::TAU * (t / 2.0 + 0.25 * free as f64);
        (3.0 + phase.sin()) * PSI
    };
    let pressures = times.iter().map(|t| std::array::from_fn(|free| at(*t, free))).collect();
    Whisk { name: "cook".into(), periods: 1, lead: 2.0, times, pressures, ..Whisk::default() }
}

fn parse(text: &str, rig: &Rig) -> Result<Experiment, String> {
    Experiment::parse(Path::new("cook.toml"), text, rig, None).map_err(|error| error.to_string())
}

/// Whisk and knob at once.
fn scene(rig: &Rig) -> Experiment {
    parse(&(circle().to_toml(&[]) + HEAT), rig).unwrap_or_else(|error| panic!("{error}"))
}

/// The whole scene: the knob goes to its temperatures while the plate goes round, and off at the end.
fn cooks(rig: &Rig) {
    let experiment = scene(rig);
    let mut bench = Stepped::new(rig).unwrap();
    procedure::arm(&mut bench, rig, false).unwrap();
    let job = Job { stepped: true, ..Job::new(experiment, Attendance::Here) };
    let run = run(&mut bench, rig, &job, &mut |_| {}).unwrap().remove(0);
    assert_eq!(run.result_name(), "done", "{:?}", run.stop());

    let columns =
        ["program_time_s", "knob.angle_rad", "knob.true_angle_rad", "a.angle_rad", "a.true_x_m", "a.true_y_m"]
            .map(String::from);
    let table = run.table(&columns).unwrap();
    let knob = rig.temperatures(KNOB).unwrap();
    for (t, temperature) in [(2.9, 115.0), (5.9, 80.0)] {
        let row = table.get("program_time_s").iter().position(|time| *time >= t).unwrap();
        let of = |column: &str| table.get(column)[row].to_degrees();
        let (angle, truth) = (of("knob.angle_rad"), of("knob.true_angle_rad"));
        println!("{t} s: the knob at {truth:.2} deg, {:.1} degC", knob.at(truth.to_radians()));
        // Friction alone would let it stand off by friction / kt, 12 deg; the loop is to leave a sixth of that.
        assert!((truth - knob.angle(temperature).unwrap().to_degrees()).abs() < 2.0, "{truth}");
        // What is measured is the knob, not the plate: five times the noise of 0.05 deg.
        assert!((angle - truth).abs() < 0.25, "{angle} {truth}");
        assert!((of("a.angle_rad") - angle).abs() > 10.0);
    }
    let sideways = table.get("a.true_x_m").iter().zip(table.get("a.true_y_m")).map(|(x, y)| x.hypot(*y));
    let moved = sideways.fold(0.0, f64::max);
    assert!(moved > 1e-3, "the plate moves sideways: {moved}");
    let errors = &run.stop().unwrap().errors;
    assert!(errors.len() == 1 && errors[0].free == "knob" && errors[0].rms_rad < 2f64.to_radians(), "{errors:?}");
    let page = fs::read_to_string(run.folder.join("report.html")).unwrap();
    for part in ["Way of the plate", "<h2>knob</h2>", "What the knob sets", "temperature [degC]"] {
        assert!(page.contains(part), "{part}");
    }

    // The pressures are gone, and with them the heat.
    let now = bench.now();
    let off = bench.sim().plant().lock().unwrap().truth(KNOB, now).angle;
    assert!(off.abs() < 1e-9, "{off}");
}

#[test]
fn five_channels_of_alicat_units_whisk_and_turn_the_knob_at_once() {
    let (_folder, rig) = rig(&[]);
    assert_eq!(rig.control.frees[KNOB].regulator.period.as_millis(), 13);
    cooks(&rig);
}

/// The example rig with analogue regulators behind two DACs: the module's on 0x60, the knob's on 0x61.
fn rig_of_dacs() -> (TempDir, Rig) {
    let folder = TempDir::new().unwrap();
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration");
    let nominal = "[regulator]\nzero_code = { value = 60.0, method = \"test\" }\n\
                   span_pa_per_code = { value = 25.0, method = \"test\" }\n";
    for name in ["module-r.toml", "module-l.toml", "knob.toml"] {
        let known = fs::read_to_string(here.join(name)).unwrap();
        fs::write(folder.path().join(name), known.replace("[regulator]\n", nominal)).unwrap();
    }
    let mut text = text(folder.path()).replace(&format!("{here:?}"), "\".\"");
    for (unit, address, channel) in
        [("A", 0x60, "A"), ("B", 0x60, "B"), ("C", 0x60, "C"), ("D", 0x60, "D"), ("E", 0x61, "A")]
    {
        let alicat = format!("kind = \"alicat\"\nline = \"line\"\nunit = \"{unit}\"\n");
        assert!(text.contains(&alicat), "{unit}");
        let dac = format!("kind = \"mcp4728\"\nbus = \"main\"\naddress = {address}\nchannel = \"{channel}\"\n");
        text = text.replace(&alicat, &dac);
    }
    let rig = load(folder.path(), &text).unwrap_or_else(|error| panic!("{error}"));
    (folder, rig)
}

#[test]
fn five_channels_of_two_dacs_whisk_and_turn_the_knob_at_once() {
    let (_folder, rig) = rig_of_dacs();
    let on: Vec<_> =
        rig.wiring.i2c[0].dacs.iter().map(|dac| (dac.address, dac.channels.iter().flatten().count())).collect();
    assert_eq!(on, [(0x60, 4), (0x61, 1)]);
    cooks(&rig);
}

#[test]
fn without_the_knobs_imu_everything_holds_then_goes_down_and_the_knob_turns_off() {
    let (_folder, rig) = rig(&[]);
    let mut bench = Stepped::new(&rig).unwrap();
    procedure::arm(&mut bench, &rig, false).unwrap();
    let program = Arc::new(scene(&rig).program);
    bench.request(Request::Start { program, attended: false, identify: false }).unwrap();
    bench.pass(Duration::from_millis(2500)).unwrap();
    let before = bench.latest();
    assert!(before.state == State::Track && before.frees().iter().all(|free| free.command > PSI), "{:?}", before.state);

    // The IMU at 0x29 does not answer any more; that of the plate beside it at 0x28 does.
    bench.sim().imu(KNOB).unwrap().always(Misbehaviour::Nak);
    let pass = |bench: &mut Stepped, until: Duration, fits: &dyn Fn(&TickRecord) -> bool| {
        let begun = bench.now();
        while !fits(&bench.latest()) {
            assert!(bench.now().since(begun) < until, "{:?} {:?}", bench.latest().state, bench.latest().latched);
            bench.pass(rig.control.period).unwrap();
        }
    };
    // Three periods of 10 ms, one more and a tick: everything holds. 200 ms, a period and a tick: everything goes down.
    pass(&mut bench, Duration::from_millis(42), &|r| r.state == State::Faulting);
    let held = bench.latest();
    assert!(held.latched.is_empty() && held.frees().iter().all(|free| free.command > PSI));
    pass(&mut bench, Duration::from_millis(212), &|r| r.latched.contains(FaultCode::ImuStale));
    let ramped = bench.latest();
    assert!(ramped.frees[KNOB].faults.contains(FaultCode::ImuStale) && !ramped.vent);
    for free in 0..KNOB {
        assert!(ramped.frees[free].imu.health == ImuHealth::Good && ramped.frees[free].faults.is_empty(), "{free}");
    }
    // Where it stays away the ladder comes to its end, and that vents: sooner than the ramp would.
    pass(&mut bench, Duration::from_millis(1012), &|r| r.latched.contains(FaultCode::BusLost) && r.vent);
    assert!(bench.latest().frees().iter().all(|free| free.command == 0.0));
    pass(&mut bench, rig.control.vent_time, &|r| r.state == State::Faulted);
    // The readings are below the limit by now, and the truth is no more than their noise away from them.
    let later = bench.now() + Duration::from_secs(1);
    let plant = bench.sim().plant();
    let mut plant = plant.lock().unwrap();
    for (free, control) in rig.control.frees.iter().enumerate() {
        let pressure = plant.pressure(free, later);
        assert!(pressure < control.limits.pressure_zero, "{}: {pressure} Pa", control.name);
    }
    assert!(plant.truth(KNOB, later).angle.abs() < 1e-9, "off");
}

#[test]
fn what_is_no_knob_is_told_with_its_rule() {
    let folder = TempDir::new().unwrap();
    let text = text(folder.path());
    let told = |from: &str, to: &str, words: &[&str]| {
        assert!(text.contains(from), "{from}");
        let error = load(folder.path(), &text.replacen(from, to, 1)).unwrap_err();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    let angles = "angles_deg = [0, 30, 60, 90, 120, 150, 180]";
    let temperatures = "temperatures_degc = [20, 45, 80, 115, 150, 190, 230]";
    told(temperatures, "", &["temperatures_degc", "is required"]);
    told(temperatures, "temperatures_degc = [20, 45]", &["2 values for 7 angles"]);
    told(temperatures, "temperatures_degc = [20, 45, 80, 80, 150, 190, 230]", &["rise", "two angles", "leave out"]);
    told(angles, "angles_deg = [0, 30, 60, 90, 120, 150, 150]", &["angles_deg", "further than the one before"]);
    told(angles, "angles_deg = [-10, 30, 60, 90, 120, 150, 180]", &["angles_deg", "rise from 0"]);
    told(angles, "angles_deg = [0, 30, 60, 90, 120, 150, 220]", &["220.0 deg", "travel is 210.0 deg"]);
    told("travel_deg = 210 ", "travel_deg = 180 ", &["travel_deg", "200.0 deg", "narrow soft_angle_deg"]);
    told("preload_mnm = 3 ", "preload_mnm = 2 ", &["preload_mnm", "above friction_mnm, 2.500", "turn its knob off"]);
    let in_module = "frees = [\"a\", \"b\", \"c\", \"knob\"]";
    told("frees = [\"a\", \"b\", \"c\", \"d\"]", in_module, &["`knob` has a knob on its end"]);
}

#[test]
fn temperatures_are_asked_within_what_the_knob_sets() {
    let (_folder, rig) = rig(&[]);
    let experiment = scene(&rig);
    let at = |t: f64| experiment.program.reference(KNOB, t).position.to_degrees();
    assert!((at(2.0) - 90.0).abs() < 1e-9 && (at(5.0) - 60.0).abs() < 1e-9, "{} {}", at(2.0), at(5.0));
    let segments =
        "kind = \"trajectory\"\nfree = \"knob\"\nsegments = [{ to_degc = 150, duration_s = 2 }, { hold_s = 1 }]\n";
    let reference = parse(segments, &rig).unwrap().program.reference(KNOB, 2.5).position;
    assert!((reference.to_degrees() - 120.0).abs() < 1e-9);
    let told = |text: &str, words: &[&str]| {
        let error = parse(text, &rig).unwrap_err();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    told(&segments.replace("150", "250"), &["to_degc", "250 degC", "20 degC to 230 degC", "`knob`"]);
    let whisk = circle().to_toml(&[]);
    told(&(whisk.clone() + &HEAT.replace("115", "10")), &["temperatures_degc", "10 degC is outside"]);
    let other = HEAT.replace("\"knob\"", "\"a\"");
    told(&(whisk.clone() + &other), &["`a` has no knob that sets temperatures", "[free.knob]"]);
    let twice = other.replace("temperatures_degc = [115, 80]", "pressures_psi = [1]");
    told(&(whisk + &twice), &["two references"]);
}

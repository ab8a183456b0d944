//! What becomes of runs: the stepped rig makes them, `freerig runs`, `report`, `compare` and `export` read them.

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use arrow::array::AsArray;
use arrow::datatypes::Float64Type;
use freerig::config::Rig;
use freerig::config::experiment::Experiment;
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Bench, Stepped, procedure};
use freerig::record::{
    Comparison, ErrorMetrics, RecordOptions, Recorder, Run, RunKind, RunResult, StartDocument, TIME_BASE,
};
use freerig::sim::chips::{Misbehaviour, Mischief};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::Value;

const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml");

/// One run of each kind, in a folder of their own.
struct Made {
    /// Where `runs/` is.
    home: PathBuf,
    own: Run,
    published: Run,
    sweep: Run,
    repeated: Vec<Run>,
    fault: Run,
    killed: Run,
}

fn experiment(rig: &Rig, text: &str) -> Experiment {
    Experiment::parse(Path::new("test.toml"), text, rig, None).unwrap()
}

/// Runs the experiment `text` on the stepped clock; `at` is told the regulator's handle and the program's time.
fn stepped(rig: &Rig, text: &str, at: impl Fn(&Mischief, f64)) -> Vec<Run> {
    let mut bench = Stepped::new(rig).unwrap();
    procedure::arm(&mut bench, rig, true).unwrap();
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment(rig, text), Attendance::Here) };
    let regulator = bench.sim().regulator(0).unwrap().clone();
    run(&mut bench, rig, &job, &mut |p| at(&regulator, p.elapsed)).unwrap()
}

fn made() -> &'static Made {
    static MADE: OnceLock<Made> = OnceLock::new();
    MADE.get_or_init(|| {
        let home = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("runs-test");
        let _ = fs::remove_dir_all(&home);
        fs::create_dir_all(&home).unwrap();
        let mut rig = Rig::load(Path::new(RIG)).unwrap();
        rig.record.directory = home.join("runs");
        let one = |text: &str| stepped(&rig, text, |_, _| {}).remove(0);
        let course = "kind = \"trajectory\"\nname = \"paper trajectory\"\nangles_deg = [40, 10, 70]\nshape = \"cubic\"\n\
                      move_s = 1.5\nhold_s = 1.5\n";
        let own = one(&format!("{course}note = \"own gains\""));
        let published = one(&format!("{course}gains = \"published-step\""));
        let sweep = one(include_str!("../../experiments/sweep.toml"));
        let steps = "kind = \"step\"\nname = \"three steps\"\nangles_deg = [50, 20, 80]\nmove_s = 0\nhold_s = 3\nrepeat = 3";
        let repeated = stepped(&rig, steps, |_, _| {});
        let fault = stepped(&rig, course, |regulator, t| {
            if t > 3.0 {
                regulator.always(Misbehaviour::Silent);
            }
        })
        .remove(0);
        let mut bench = Stepped::new(&rig).unwrap();
        let start = StartDocument {
            subject: "paper".into(),
            stepped: true,
            ..StartDocument::new(RunKind::Set, &rig.control)
        };
        bench.attach(Recorder::create(&rig.record.directory, start, RecordOptions::default()).unwrap());
        bench.pass(Duration::from_secs(2)).unwrap();
        let recorder = bench.detach().unwrap().unwrap();
        let killed = Run::open(recorder.folder()).unwrap();
        // As after a kill: nothing of the recorder runs any more.
        std::mem::forget(recorder);
        Made { home, own, published, sweep, repeated, fault, killed }
    })
}

/// `freerig ARGUMENTS`: exit status, stdout, stderr.
fn freerig(arguments: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_freerig"))
        .args(arguments)
        .args(["--rig", RIG])
        .current_dir(&made().home)
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

fn json(arguments: &[&str]) -> Value {
    let (status, out, err) = freerig(&[arguments, &["--json"]].concat());
    assert_eq!(status, 0, "{err}");
    serde_json::from_str(&out).unwrap_or_else(|e| panic!("{e}: {out}"))
}

fn near(value: &Value, expected: f64) -> bool {
    value.as_f64().is_some_and(|v| (v - expected).abs() <= 1e-9 * expected.abs())
}

#[test]
fn runs_lists_every_run_with_what_it_was() {
    let made = made();
    let listed = json(&["runs"]);
    let runs = listed["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 8);
    let of = |run: &Run| runs.iter().find(|r| r["id"] == run.id()).unwrap();
    let own = of(&made.own);
    assert_eq!(own["kind"], "trajectory");
    assert_eq!(
        (&own["free"], &own["gains"], &own["note"]),
        (&"paper".into(), &"model, freerig".into(), &"own gains".into())
    );
    assert_eq!((&own["result"], &own["simulated"], &own["complete"]), (&"done".into(), &true.into(), &true.into()));
    // The same figure as the metrics have it.
    let error = freerig::record::Metrics::of(&made.own).unwrap().frees[0].error.unwrap();
    assert!(near(&own["rms_error_rad"], error.rms_rad) && near(&own["peak_error_rad"], error.peak_rad));
    assert_eq!(of(&made.published)["gains"], "model, published-step");
    assert_eq!(of(&made.sweep)["gains"], "open loop");
    assert_eq!(of(&made.sweep)["rms_error_rad"], Value::Null);
    assert_eq!(of(&made.repeated[2])["repetition"]["index"], 3);
    assert_eq!(of(&made.fault)["result"], "fault");
    assert_eq!((&of(&made.killed)["result"], &of(&made.killed)["complete"]), (&"incomplete".into(), &false.into()));

    let (status, text, _) = freerig(&["runs"]);
    assert_eq!(status, 0);
    assert_eq!(text.lines().count(), 9);
    for line in text.lines().skip(1) {
        assert!(line.contains("SIMULATED"), "{line}");
    }
    assert!(text.lines().last().unwrap().contains("incomplete"), "{text}");
    let (_, text, _) = freerig(&["runs", "--latest", "2"]);
    assert_eq!(text.lines().count(), 3);
}

#[test]
fn report_takes_an_id_its_beginning_a_folder_or_latest() {
    let made = made();
    let folder = made.own.folder.to_str().unwrap();
    for wanted in [made.own.id(), &made.own.id()[..22], folder] {
        let report = json(&["report", wanted]);
        assert_eq!(report["figures"]["id"], made.own.id());
        assert!(Path::new(&made.home).join(report["report"].as_str().unwrap()).is_file());
    }
    assert_eq!(json(&["report", "latest"])["figures"]["id"], made.killed.id());
    let (status, text, _) = freerig(&["report", made.own.id()]);
    assert_eq!(status, 0);
    for part in
        ["SIMULATED", "RMS error", "peak error", "RMSD to the model", "overshoot", "settling", "deadline misses"]
    {
        assert!(text.contains(part), "{part}: {text}");
    }
    let (_, text, _) = freerig(&["report", made.sweep.id()]);
    assert!(text.contains("hysteresis") && text.contains("RMSD to the model at rest"), "{text}");
    assert!(!text.contains("on its way"), "its holds are enough: {text}");
}

#[test]
fn a_run_that_is_not_there_is_bad_usage_and_the_nearest_is_named() {
    let made = made();
    let typo = made.own.id().replace("trajectory", "trajetcory");
    for command in [["report"].as_slice(), &["export", "--csv"], &["compare", "latest"]] {
        let (status, _, err) = freerig(&[command, &[&typo]].concat());
        assert_eq!(status, 2, "{err}");
        assert!(err.contains(&format!("did you mean `{}`", made.own.id())), "{err}");
        assert!(err.contains("it holds 8, the latest:") && err.contains("remedy:"), "{err}");
    }
    let (status, _, err) = freerig(&["report", "2"]);
    assert_eq!(status, 2);
    assert!(err.contains("8 runs"), "{err}");
}

#[test]
fn the_report_says_what_happened() {
    let made = made();
    let page = |run: &Run| {
        let page = fs::read_to_string(freerig::record::write_report(run, &mut |_| {}).unwrap().0).unwrap();
        for outside in ["http://", "https://", "src=", "<link", "<script", "@import", "url("] {
            // The namespace of SVG is a name, not an address.
            assert!(!page.replace("http://www.w3.org/2000/svg", "").contains(outside), "{outside}");
        }
        assert!(page.contains("SIMULATED"));
        page
    };
    let own = page(&made.own);
    for part in ["reference", "model, from the measured pressure", "RMSD to the model", "overshoot", "settling"] {
        assert!(own.contains(part), "{part}");
    }
    let sweep = page(&made.sweep);
    for part in ["twist [deg/mm]", "model at rest", "hysteresis"] {
        assert!(sweep.contains(part), "{part}");
    }
    let first = page(&made.repeated[0]);
    assert!(first.contains("3 repetitions") && first.contains("one standard deviation"));
    let fault = page(&made.fault);
    for part in ["pressure_stale", "latched", "power"] {
        assert!(fault.contains(part), "{part}");
    }
    assert_eq!(made.fault.stop().unwrap().result, RunResult::Fault);
    let killed = page(&made.killed);
    assert!(killed.contains("incomplete") && killed.contains("cut off"));
}

#[test]
fn compare_is_the_same_both_ways_and_its_ratio_the_inverse() {
    let made = made();
    let (own, published) = (made.own.id(), made.published.id());
    let (there, back) = (json(&["compare", own, published]), json(&["compare", published, own]));
    let deviation = |v: &Value| v["deviations"][0]["rms_rad"].as_f64().unwrap();
    assert!((deviation(&there) - deviation(&back)).abs() < 1e-12 && deviation(&there) > 1e-3);
    let ratio = |v: &Value| v["runs"][1]["rms_ratio"].as_f64().unwrap();
    assert!((ratio(&there) * ratio(&back) - 1.0).abs() < 1e-12);
    let rms = |v: &Value, i: usize| v["runs"][i]["error"]["rms_rad"].as_f64().unwrap();
    assert!((ratio(&there) - rms(&there, 1) / rms(&there, 0)).abs() < 1e-12);
    let page = made.home.join(there["page"].as_str().unwrap());
    assert_eq!(page.parent(), Some(made.own.folder.as_path()));
    let page = fs::read_to_string(page).unwrap();
    for part in ["<svg", "published-step", "freerig", "SIMULATED", &format!("../{published}/report.html")] {
        assert!(page.contains(part), "{part}");
    }
    // A run is as far from itself as nothing.
    let itself = json(&["compare", own, own]);
    assert_eq!((deviation(&itself), ratio(&itself)), (0.0, 1.0));

    let (status, text, _) = freerig(&["compare", own, made.sweep.id()]);
    assert_eq!(status, 0);
    assert!(text.contains("different programs"), "{text}");
    let (_, text, _) = freerig(&["compare", own, made.fault.id()]);
    assert!(text.contains("fault"), "{text}");
}

#[test]
fn runs_of_one_program_are_related_to_its_first() {
    let made = made();
    let runs = [&made.own, &made.repeated[0], &made.published, &made.repeated[1]].map(Clone::clone);
    let comparison = Comparison::of(&runs).unwrap();
    let ratio = |i: usize| comparison.rows[i].rms_ratio.unwrap();
    let rms = |i: usize| comparison.rows[i].error.map(|e: ErrorMetrics| e.rms_rad).unwrap();
    assert_eq!((ratio(0), ratio(1)), (1.0, 1.0));
    assert!((ratio(2) - rms(2) / rms(0)).abs() < 1e-12 && (ratio(3) - rms(3) / rms(1)).abs() < 1e-12);
    assert_eq!(comparison.deviations().count(), 2);
    let page = comparison.write(&made.home.join("runs/all.html")).unwrap();
    let page = fs::read_to_string(page).unwrap();
    for run in &runs {
        assert!(page.contains(&format!("href=\"{}/report.html\"", run.id())));
    }
}

/// The values of a column of numbers, by their bits.
fn bits(values: impl IntoIterator<Item = f64>) -> Vec<u64> {
    // Not a number is one value here: a text does not keep its bits.
    values.into_iter().map(|v| if v.is_nan() { f64::NAN.to_bits() } else { v.to_bits() }).collect()
}

#[test]
fn an_export_comes_back_as_it_was_recorded() {
    let made = made();
    let numbers = ["t_s", "program_time_s", "paper.angle_rad", "paper.command_pa", "paper.reference_rad"];
    let names: Vec<String> = numbers.map(String::from).into();
    for run in [&made.own, &made.killed] {
        let table = run.table(&names).unwrap();
        let states: Vec<String> = run.records().unwrap().map(|(r, _)| r.state.name().to_owned()).collect();

        let exported = json(&["export", run.id(), "--parquet"]);
        assert_eq!(exported["rows"], table.len());
        assert_eq!(exported["time_base"], TIME_BASE);
        let file = File::open(made.home.join(exported["file"].as_str().unwrap())).unwrap();
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
        let metadata = reader.metadata().file_metadata().key_value_metadata().unwrap().clone();
        let document = metadata.iter().find(|kv| kv.key == "freerig.run").and_then(|kv| kv.value.clone()).unwrap();
        assert_eq!(toml::from_str::<freerig::record::RunDocument>(&document).unwrap(), run.document);
        let batches: Vec<_> = reader.build().unwrap().map(Result::unwrap).collect();
        for name in &numbers {
            let column = |b: &arrow::array::RecordBatch| {
                b.column_by_name(name).unwrap().as_primitive::<Float64Type>().values().to_vec()
            };
            let read: Vec<f64> = batches.iter().flat_map(column).collect();
            assert_eq!(bits(read), bits(table.get(name).iter().copied()), "{name}");
        }
        let text = |b: &arrow::array::RecordBatch| {
            let column = b.column_by_name("state").unwrap().as_string::<i32>().clone();
            column.iter().map(|v| v.unwrap().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(batches.iter().flat_map(text).collect::<Vec<_>>(), states);

        let path = made.home.join(format!("{}.csv", run.id()));
        let exported = json(&["export", run.id(), "--csv", "--output", path.to_str().unwrap()]);
        assert_eq!(exported["rows"], table.len());
        let csv = fs::read_to_string(&path).unwrap();
        let mut lines = csv.lines();
        let header: Vec<&str> = lines.next().unwrap().split(',').collect();
        assert_eq!(header.iter().collect::<HashSet<_>>().len(), header.len());
        let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
        assert_eq!(rows.len(), table.len());
        let column = |name: &str| {
            let i = header.iter().position(|h| *h == name).unwrap();
            rows.iter().map(move |row| row[i]).collect::<Vec<_>>()
        };
        for name in &numbers {
            let read = column(name).into_iter().map(|v| v.parse().unwrap());
            assert_eq!(bits(read), bits(table.get(name).iter().copied()), "{name}");
        }
        assert_eq!(column("state"), states);
    }
}

#[test]
fn an_export_needs_a_format_and_a_folder() {
    let made = made();
    assert_eq!(freerig(&["export", made.own.id()]).0, 2);
    let (status, _, err) = freerig(&["export", made.own.id(), "--csv", "--output", "/nonexistent/a.csv"]);
    assert_eq!(status, 1);
    assert!(err.contains("/nonexistent"), "{err}");
}

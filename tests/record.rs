//! The record: what is pushed comes back bit for bit, a killed run is readable up to its last whole batch and
//! said to be incomplete, rerun's own tool accepts the file, and the figures are those computed by hand.

use std::fs;
use std::path::Path;
use std::process::Command;

use freerig::clock::Time;
use freerig::record::{
    RRD_NAME, RecordOptions, Recorder, Run, RunKind, RunResult, SAMPLES_NAME, StartDocument, StopDocument,
};
use freerig::signal::{
    Estimate, FaultCode, FaultSet, FreeTick, ImuHealth, ImuSample, LimitSet, MAX_FREES, PressureSample, Quantity,
    Reference, Refusal, RefusalCode, RegulatorHealth, RegulatorStatus, RequestKind, State, Terms, TickRecord, Trim,
    Truth,
};

use freerig::trajectory::Program;

#[path = "record/fixture.rs"]
mod fixture;

use fixture::{PERIOD_NS, Scramble};

impl Scramble {
    fn float(&mut self) -> f64 {
        f64::from_bits(self.bits())
    }
    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.bits() as usize % all.len()]
    }
}

/// A record whose every field holds anything, NaN payloads included.
fn scrambled(r: &mut Scramble, tick: u64, frees: usize) -> TickRecord {
    let mut record = TickRecord {
        tick,
        time: Time::from_nanos(5_000_000_000 + tick * PERIOD_NS),
        latency_ns: r.bits() as u32,
        execution_ns: r.bits() as u32,
        skipped: r.bits() >> 1,
        state: r.of(&[State::Boot, State::Arming, State::Track, State::Faulted, State::RampDown]),
        request: r.of(&[RequestKind::None, RequestKind::Arm, RequestKind::Gains]),
        estop: r.of(&[true, false]),
        realtime: r.of(&[true, false]),
        config_changed: r.of(&[true, false]),
        supply_low: r.of(&[true, false]),
        heartbeat: Time::from_nanos(r.bits()),
        trim: Trim { time: Time::from_nanos(r.bits()), ..Trim::default() },
        refusal: Refusal {
            code: r.of(&[RefusalCode::None, RefusalCode::NotVented, RefusalCode::Busy]),
            free: r.bits() as u8,
            fault: r.of(&[None, Some(FaultCode::ImuStale), Some(FaultCode::EmergencyStop)]),
        },
        program_time: r.float(),
        latched: FaultSet(r.bits() as u32),
        faults: FaultSet(r.bits() as u32),
        vent: r.of(&[true, false]),
        free_count: frees as u8,
        ..TickRecord::default()
    };
    record.trim.pressure[..frees].fill_with(|| r.float());
    for free in &mut record.frees[..frees] {
        *free = FreeTick {
            imu: ImuSample {
                time: Time::from_nanos(r.bits()),
                sequence: r.bits() as u32,
                quaternion: [r.float(), r.float(), r.float(), r.float()],
                rate: [r.float(), r.float(), r.float()],
                acceleration: [r.float(), r.float(), r.float()],
                calibration: r.bits() as u8,
                health: r.of(&[ImuHealth::Absent, ImuHealth::Good, ImuHealth::Restarting, ImuHealth::Lost]),
            },
            pressure: PressureSample {
                time: Time::from_nanos(r.bits()),
                sequence: r.bits() as u32,
                pressure: r.float(),
                setpoint: r.float(),
                status: RegulatorStatus(r.bits() as u16),
                health: r.of(&[RegulatorHealth::Good, RegulatorHealth::Unmeasured, RegulatorHealth::Lost]),
            },
            reference: Reference {
                quantity: r.of(&[Quantity::None, Quantity::Angle, Quantity::Pressure]),
                position: r.float(),
                rate: r.float(),
                acceleration: r.float(),
            },
            estimate: Estimate {
                tare: [r.float(), r.float(), r.float(), r.float()],
                angle: r.float(),
                rate: r.float(),
                measured_angle: r.float(),
                measured_rate: r.float(),
                tilt: r.float(),
                age: r.float(),
                sequence: r.bits() as u32,
                valid: r.of(&[true, false]),
            },
            terms: Terms {
                proportional: r.float(),
                integral: r.float(),
                derivative: r.float(),
                feedforward: r.float(),
                filtered_rate: r.float(),
            },
            wanted: r.float(),
            command: r.float(),
            limits: LimitSet(r.bits() as u8),
            faults: FaultSet(r.bits() as u32),
        };
    }
    record
}

/// The bits of a record, because not a number is not equal to itself. `{:?}` prints every field; floats are
/// compared apart.
fn bits(record: &TickRecord) -> (String, Vec<u64>) {
    let mut floats = vec![record.program_time.to_bits()];
    for f in record.frees() {
        let all = [f.imu.quaternion.as_slice(), &f.estimate.tare, &f.imu.rate, &f.imu.acceleration].concat();
        let (e, t, r, p) = (f.estimate, f.terms, f.reference, f.pressure);
        floats.extend(
            all.into_iter().chain([p.pressure, p.setpoint, r.position, r.rate, r.acceleration]).map(f64::to_bits),
        );
        floats.extend([e.angle, e.rate, e.measured_angle, e.measured_rate, e.tilt, e.age].map(f64::to_bits));
        floats.extend([t.proportional, t.integral, t.derivative, t.feedforward, t.filtered_rate].map(f64::to_bits));
        floats.extend([f.wanted, f.command].map(f64::to_bits));
    }
    (format!("{record:?}"), floats)
}

fn start(names: &[&str]) -> StartDocument {
    fixture::start(RunKind::Step, names)
}

fn record_scrambled(runs: &Path, names: &[&str], count: u64, truth: bool) -> (Recorder, Vec<TickRecord>, Vec<Truth>) {
    let options = RecordOptions { truth, rrd: false, ..RecordOptions::default() };
    let mut recorder = Recorder::create(runs, start(names), options).unwrap();
    let mut r = Scramble(1);
    let (mut records, mut truths) = (Vec::new(), Vec::new());
    for tick in 0..count {
        let record = scrambled(&mut r, tick, names.len());
        let t = vec![
            Truth {
                angle: r.float(),
                extension: r.float(),
                pressure: tick as f64,
                position: [r.float(), r.float(), r.float()]
            };
            names.len()
        ];
        recorder.push(&record, truth.then_some(&t)).unwrap();
        records.push(record);
        truths.push(t[0]);
    }
    (recorder, records, truths)
}

#[test]
fn every_field_of_every_record_comes_back_bit_for_bit() {
    let runs = tempfile::tempdir().unwrap();
    let names: Vec<String> = (0..MAX_FREES).map(|i| format!("free-{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for (names, truth) in [(&names[..1], false), (&names[..], true)] {
        let (recorder, records, truths) = record_scrambled(runs.path(), names, 777, truth);
        let run = recorder.finish(StopDocument::default()).unwrap();
        let run = Run::open(&run.folder).unwrap();
        assert!(run.is_complete());
        let back: Vec<_> = run.records().unwrap().collect();
        assert_eq!(back.len(), records.len());
        for ((record, pushed), truth_pushed) in back.iter().zip(&records).zip(&truths) {
            assert_eq!(bits(&record.0), bits(pushed));
            if truth {
                assert_eq!(record.1[0].angle.to_bits(), truth_pushed.angle.to_bits());
                assert_eq!(record.1[names.len() - 1].pressure, truth_pushed.pressure);
            }
        }
    }
}

#[test]
fn a_killed_run_is_readable_to_its_last_whole_batch_and_incomplete() {
    let runs = tempfile::tempdir().unwrap();
    let (recorder, records, _) = record_scrambled(runs.path(), &["a"], 230, false);
    let folder = recorder.folder().to_owned();
    // Killed: no destructor, no finish. 230 records at 500 Hz: four whole batches of 50 have been cut.
    std::mem::forget(recorder);
    let run = Run::open(&folder).unwrap();
    assert!(!run.is_complete());
    assert_eq!(run.result_name(), "incomplete");
    assert_eq!(run.records().unwrap().count(), 200);

    // Cut the file anywhere: what is read is a whole number of batches from the beginning, and never an error
    // except where not even the schema is left.
    let path = folder.join(SAMPLES_NAME);
    let whole = fs::read(&path).unwrap();
    let mut r = Scramble(9);
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..200 {
        let length = r.bits() as usize % (whole.len() + 1);
        fs::write(&path, &whole[..length]).unwrap();
        let Ok(back) = run.records() else {
            seen.insert(usize::MAX);
            continue;
        };
        let back: Vec<_> = back.collect();
        assert_eq!(back.len() % 50, 0, "cut at {length}");
        seen.insert(back.len());
        for (a, b) in back.iter().zip(&records) {
            assert_eq!(bits(&a.0), bits(b));
        }
    }
    assert!([0, 50, 100, 150].iter().all(|n| seen.contains(n)), "{seen:?}");
}

#[test]
fn the_stop_document_is_completed_by_what_the_records_have_shown() {
    let runs = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(runs.path(), start(&["a"]), RecordOptions::default()).unwrap();
    for tick in 0..1000u64 {
        let mut record = TickRecord {
            tick: tick + if tick >= 500 { 3 } else { 0 },
            skipped: 7 + if tick >= 500 { 3 } else { 0 },
            latency_ns: if tick == 999 { 1_000_000 } else { 20_000 },
            execution_ns: 5_000,
            free_count: 1,
            ..TickRecord::default()
        };
        record.time = Time::from_nanos(record.tick * PERIOD_NS);
        if tick >= 600 {
            record.frees[0].limits.insert(LimitSet::SLEW);
            record.frees[0].faults.insert(FaultCode::ImuStale);
            record.latched.insert(FaultCode::ImuStale);
        }
        recorder.push(&record, None).unwrap();
    }
    let stop = StopDocument { result: RunResult::Fault, lost_records: 2, ..StopDocument::default() };
    let run = recorder.finish(stop).unwrap();
    let stop = run.stop().unwrap();
    assert_eq!((stop.records, stop.lost_records, stop.loop_statistics.deadline_misses), (1000, 2, 3));
    assert_eq!(stop.limits_seen, ["slew"]);
    assert_eq!(stop.faults.len(), 1);
    let fault = &stop.faults[0];
    assert_eq!((fault.name.as_str(), fault.free.as_deref(), fault.latched), ("imu_stale", Some("a"), true));
    assert_eq!(fault.tick, 603);
    assert!((fault.t_s - 603.0 * 0.002).abs() < 1e-12);
    // Two significant digits.
    assert!((stop.loop_statistics.latency_p50_us - 20.0).abs() < 0.2);
    assert!((stop.loop_statistics.latency_max_us - 1000.0).abs() < 10.0);
    assert_eq!(run.result_name(), "fault");
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_with_its_path() {
    let runs = tempfile::tempdir().unwrap();
    let file = runs.path().join("file");
    fs::write(&file, "").unwrap();
    let error = Recorder::create(&file, start(&["a"]), RecordOptions::default()).err().unwrap();
    assert!(error.to_string().contains("file"), "{error}");
}

/// rerun's own tool of the pinned version, where it is installed.
fn rerun_tool() -> Option<impl Fn(&[&str]) -> (bool, String)> {
    let call = |arguments: &[&str]| {
        let output = Command::new("rerun").args(arguments).output().ok()?;
        let text = [output.stdout, output.stderr].concat();
        Some((output.status.success(), String::from_utf8_lossy(&text).into_owned()))
    };
    match call(&["--version"]) {
        Some((true, text)) if text.contains("0.36.3") => Some(move |a: &[&str]| call(a).unwrap_or_default()),
        other => {
            println!("skipped: `rerun` 0.36.3 is not installed (pip install rerun-sdk==0.36.3): {other:?}");
            None
        }
    }
}

#[test]
fn reruns_own_tool_accepts_the_file_of_a_finished_and_of_a_killed_run() {
    let Some(rerun) = rerun_tool() else { return };
    let runs = tempfile::tempdir().unwrap();
    let sequence = freerig::trajectory::paper_steps().unwrap();
    let program = Program::angle(0, sequence).unwrap();
    let recorder = fixture::run(runs.path(), start(&["paper"]), &program, 1, None);
    let run = recorder.finish(StopDocument::default()).unwrap();
    assert_eq!(run.stop().unwrap().rerun_error, "");
    let path = run.folder.join(RRD_NAME);
    let path = path.to_str().unwrap();
    let (ok, text) = rerun(&["rrd", "verify", path]);
    assert!(ok, "{text}");
    let (ok, text) = rerun(&["rrd", "print", "-vv", path]);
    assert!(ok, "{text}");
    for entity in ["/frees/paper/angle/estimate", "/rig/paper/fibers", "/states/life_cycle", "/events"] {
        assert!(text.contains(entity), "{entity} is missing:\n{text}");
    }

    // Killed: everything but the last half second of data is in the file by then.
    let recorder = fixture::run(runs.path(), start(&["paper"]), &program, 1, None);
    let folder = recorder.folder().to_owned();
    std::thread::sleep(std::time::Duration::from_millis(500));
    let cut = runs.path().join("cut.rrd");
    fs::copy(folder.join(RRD_NAME), &cut).unwrap();
    std::mem::forget(recorder);
    let (ok, text) = rerun(&["rrd", "stats", cut.to_str().unwrap()]);
    assert!(ok, "{text}");
}

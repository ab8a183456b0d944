//! Faults that come together, or while the rig is busy with something else: arming, starting, calibrating, ramping
//! down.

use std::path::Path;
use std::sync::atomic::Ordering;

use freerig::config::experiment::Experiment;
use freerig::control::Request;
use freerig::control::fault::Reaction;
use freerig::daemon::calibration::stiffness;
use freerig::daemon::experiment::{Attendance, Job, run};
use freerig::daemon::{Bench, DaemonError, procedure};
use freerig::record::RunResult;
use freerig::signal::{FaultCode, FaultSet, LimitSet, State};
use freerig::sim::chips::Misbehaviour;
use freerig::sim::{PlantFault, Valve};

use super::stage::{NO_DUMP_VALVE, PSI, Stage, TURNS_FAR, ms};

/// What goes wrong, and what must be latched in the end.
type Blow = (&'static str, fn(&mut Stage), FaultCode);

const BLOWS: [Blow; 6] = [
    ("IMU silent", |s| s.imu().always(Misbehaviour::Nak), FaultCode::ImuStale),
    ("IMU garbage", |s| s.imu().always(Misbehaviour::Garbage), FaultCode::ImuImplausible),
    ("valve open", |s| s.inject(PlantFault::Valve(0, Valve::StuckOpen)), FaultCode::OverpressureHard),
    ("unit says OPL", |s| s.tokens("OPL"), FaultCode::RegulatorStatus),
    ("line unplugged", |s| s.line().lock().unwrap().plug(false), FaultCode::BusLost),
    ("client gone", |s| s.heart = false, FaultCode::ClientLost),
];

#[test]
fn any_two_faults_in_any_order_end_vented_and_the_first_is_not_forgotten() {
    for (i, (first, strike, code)) in BLOWS.iter().enumerate() {
        for (j, (second, strike_again, next)) in BLOWS.iter().enumerate() {
            // One thing cannot go wrong in two ways at once.
            if i == j || (i < 2 && j < 2) {
                continue;
            }
            let mut s = Stage::armed(&TURNS_FAR);
            s.track(60.0, true);
            strike(&mut s);
            // Up to 0.3 s later: before the first is seen, in its hold, in its ramp.
            s.pass(ms(5 + 49 * ((i + 2 * j) as u64 % 7))).unwrap();
            strike_again(&mut s);
            // The slowest to be seen is the client, after 1.5 s; then a ramp.
            let (mut vented, mut ever) = (false, FaultSet::NONE);
            let end = s.now() + ms(1600) + s.rig.control.ramp_time + s.rig.control.vent_time;
            while s.now() < end {
                s.pass(ms(2)).unwrap();
                assert!(s.last.vent || !vented, "{first}, {second}: a vent is not taken back");
                (vented, ever) = (s.last.vent, ever.union(s.last.latched));
            }
            assert_eq!(s.last.state, State::Faulted, "{first}, {second}");
            s.is_vented();
            assert!(!s.last.latched.contains(FaultCode::VentFailed), "{first}, {second}");
            assert_eq!(s.last.latched, ever, "{first}, {second}: what is latched stays");
            // What the second has ended needs not be seen any more.
            let seen = s.first.contains_key(code) || s.first.contains_key(next);
            assert!(seen, "{first}, {second}: {:?}", s.first);
        }
    }
}

#[test]
fn a_stale_imu_does_not_hide_an_overpressure() {
    let mut s = Stage::tracking(&TURNS_FAR);
    s.imu().always(Misbehaviour::Nak);
    s.expect(FaultCode::ImuStale, Reaction::Hold, ms(46));
    s.inject(PlantFault::Valve(0, Valve::StuckOpen));
    s.until(ms(350), "vent", |r| r.vent);
    assert!(s.last.latched.contains(FaultCode::OverpressureHard));
    s.rests_vented(Reaction::Vent);
    s.imu().stop();
    s.inject(PlantFault::Valve(0, Valve::Working));
    s.works_again();
}

#[test]
fn a_line_lost_during_a_ramp_down_is_vented_by_what_is_left() {
    for faulty in [false, true] {
        let mut s = Stage::tracking(&[]);
        match faulty {
            false => s.request(Request::Disarm).unwrap(),
            true => s.tokens("OPL"),
        }
        s.pass(ms(600)).unwrap();
        assert_eq!(s.last.state, if faulty { State::Faulting } else { State::RampDown });
        assert!(!s.last.vent && s.truth(0) > 1.0 * PSI);
        s.line().lock().unwrap().plug(false);
        s.until(ms(68), "vent", |r| r.vent);
        s.rests_vented(Reaction::Vent);
        s.tokens("");
        s.line().lock().unwrap().plug(true);
        s.works_again();
    }
    // Without a dump valve nothing is left.
    let mut s = Stage::tracking(&[NO_DUMP_VALVE]);
    s.request(Request::Disarm).unwrap();
    s.pass(ms(600)).unwrap();
    s.line().lock().unwrap().plug(false);
    s.until(ms(70) + s.rig.control.vent_time, "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    assert!(s.truth(0) > 1.0 * PSI);
    s.line().lock().unwrap().plug(true);
    s.works_again();
}

#[test]
fn what_goes_wrong_while_arming_ends_the_arming_without_pressure() {
    type Wrong = (fn(&mut Stage), fn(&mut Stage), &'static str);
    let wrongs: [Wrong; 4] = [
        (|s| s.imu().always(Misbehaviour::Nak), |s| s.imu().stop(), "imu_stale"),
        (|s| s.line().lock().unwrap().plug(false), |s| s.line().lock().unwrap().plug(true), "bus_lost"),
        (|s| s.tokens("ADC"), |s| s.tokens(""), "regulator_status"),
        (
            |s| s.inject(PlantFault::Valve(0, Valve::StuckOpen)),
            |s| s.inject(PlantFault::Valve(0, Valve::Working)),
            "overpressure",
        ),
    ];
    for (break_it, repair, name) in wrongs {
        let mut s = Stage::new(&TURNS_FAR);
        // The gyro is calibrated only after 3 s of rest: until then arming waits.
        s.until(ms(3000), "disarmed", |r| r.state == State::Disarmed);
        s.request(Request::Arm).unwrap();
        s.until(ms(10), "arming", |r| r.state == State::Arming);
        s.pass(ms(7)).unwrap();
        break_it(&mut s);
        s.until(ms(700), name, |r| r.state != State::Arming);
        assert_eq!(s.last.frees[0].command, 0.0, "{name}");
        let overpressure = name == "overpressure";
        assert_eq!(s.last.state == State::Disarmed, !overpressure, "{name}: {:?}", s.last.state);
        s.pass(s.rig.control.vent_time).unwrap();
        assert!(s.truth(0) < 0.2 * PSI || overpressure, "{name}");
        assert!(s.first.keys().any(|code| code.name().starts_with(name)), "{name}: {:?}", s.first);
        if overpressure {
            s.rests_vented(Reaction::Vent);
        }
        repair(&mut s);
        s.pass(ms(3000)).unwrap();
        let rig = s.rig.clone();
        if overpressure {
            s.works_again();
        } else {
            s.broken = false;
            procedure::arm(&mut s, &rig, true).unwrap();
        }
    }
}

#[test]
fn a_rig_that_finds_something_wrong_at_its_start_does_not_leave_boot() {
    for break_it in [|s: &Stage| s.imu().always(Misbehaviour::Nak), |s: &Stage| s.line().lock().unwrap().plug(false)] {
        let mut s = Stage::new(&[]);
        break_it(&s);
        let rig = s.rig.clone();
        match procedure::arm(&mut s, &rig, true) {
            Err(error @ DaemonError::Boot { .. }) => {
                // Every device that is waited for is named, once, with its reason.
                let text = error.to_string();
                assert!(text.lines().count() >= 2 && text.lines().skip(1).all(|line| line.contains(": ")), "{text}");
            }
            other => panic!("{other:?}"),
        }
        s.is_vented();
        s.imu().stop();
        s.line().lock().unwrap().plug(true);
        s.pass(ms(3000)).unwrap();
        procedure::arm(&mut s, &rig, true).unwrap();
    }
}

#[test]
fn every_device_is_unplugged_and_plugged_in_again_while_nothing_is_armed() {
    type Plug = (fn(&Stage), fn(&Stage));
    let plugs: [Plug; 3] = [
        (|s| s.imu().always(Misbehaviour::Silent), |s| s.imu().stop()),
        (|s| s.regulator(0).always(Misbehaviour::Silent), |s| s.regulator(0).stop()),
        (|s| s.line().lock().unwrap().plug(false), |s| s.line().lock().unwrap().plug(true)),
    ];
    for (unplug, plug) in plugs {
        let mut s = Stage::new(&[]);
        let rig = s.rig.clone();
        s.until(ms(3000), "disarmed", |r| r.state == State::Disarmed);
        unplug(&s);
        s.pass(ms(3000)).unwrap();
        assert_eq!(s.last.state, State::Disarmed, "nothing to take away, nothing to latch");
        assert!(s.last.latched.is_empty());
        assert!(matches!(procedure::arm(&mut s, &rig, true), Err(DaemonError::Refused { .. })));
        plug(&s);
        s.pass(ms(3000)).unwrap();
        procedure::arm(&mut s, &rig, true).unwrap();
        procedure::disarm(&mut s, &rig).unwrap();
        assert_eq!(s.last.state, State::Disarmed);
    }
}

#[test]
fn a_calibration_that_meets_a_fault_ends_vented_and_its_run_has_the_first_errors() {
    let mut s = Stage::armed(&[]);
    let rig = s.rig.clone();
    let text = stiffness::experiment(&rig, 0).unwrap();
    let experiment = Experiment::parse(Path::new("calibration.toml"), &text, &rig, Some("paper")).unwrap();
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Here) };
    let line = s.line();
    let runs = run(&mut s, &rig, &job, &mut |progress| {
        if progress.elapsed > 20.0 {
            line.lock().unwrap().plug(false);
        }
    })
    .unwrap();
    s.rests_vented(Reaction::Vent);
    let stop = runs[0].stop().unwrap();
    assert_eq!(stop.result, RunResult::Fault, "{stop:?}");
    assert!(stop.message.contains("bus_lost"), "{}", stop.message);
    let first = &stop.faults[0];
    assert_eq!((first.name.as_str(), first.free.as_deref(), first.latched), ("bus_lost", Some("paper"), true));
    assert!(first.t_s > 20.0 && first.t_s < 20.3, "{}", first.t_s);
    // The pressures before, and the zero of the very tick.
    let at = stop.around.iter().position(|m| m.t_s == first.t_s).unwrap();
    assert!(at >= 9 && stop.around[at - 1].command_pa[0] > 0.0 && stop.around[at].command_pa[0] == 0.0);
    assert!(stop.around[at - 1].pressure_pa[0] > PSI && stop.around[at].state == "faulting");
    line.lock().unwrap().plug(true);
    s.works_again();
}

#[test]
fn an_imu_that_only_leaves_its_mode_costs_a_hold_and_keeps_its_tare() {
    let mut s = Stage::tracking(&[]);
    let before = s.last.frees[0].estimate;
    let (mut bus, _) = s.bench.sim().i2c(0).unwrap();
    embedded_hal::i2c::I2c::write(&mut bus, 0x28, &[0x3D, 0x00]).unwrap();
    s.until(ms(60), "hold", |r| r.state == State::Faulting);
    s.until(ms(150), "back", |r| r.state == State::Hold);
    s.pass(ms(200)).unwrap();
    let after = s.last.frees[0].estimate;
    assert_eq!(after.tare, before.tare);
    // The pressure stood; the FREE creeps by its hysteresis at most.
    assert!((after.angle - before.angle).abs() < 1f64.to_radians(), "{} {}", before.angle, after.angle);
    assert!(s.last.latched.is_empty());
    assert_eq!(s.last.state, State::Hold);
}

#[test]
fn limits_in_force_explain_and_do_not_latch() {
    let mut s = Stage::armed(&TURNS_FAR);
    s.go_to(14.0);
    let mut seen = LimitSet::default();
    // Up to 14 psi/s: the command is clipped after 0.7 s, and the pressure is not there yet.
    for _ in 0..200 {
        s.pass(ms(4)).unwrap();
        seen.insert(s.last.frees[0].limits);
    }
    assert!(seen.contains(LimitSet::PRESSURE_MAX), "{seen:?}");
    assert!(s.first.is_empty() && s.last.state == State::Track, "{:?}", s.first);
    s.bench.switches().estop.store(true, Ordering::Release);
    s.pass(ms(4) + s.rig.control.vent_time).unwrap();
    s.is_vented();
}

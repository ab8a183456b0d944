//! Row by row: the condition is brought about, and the reaction follows in time.
//!
//! Detection may take the debounce, one period of the device and one tick; a vent its stated time, a ramp its own
//! and that of a vent.

use std::sync::atomic::Ordering;
use std::time::Duration;

use freerig::control::Request;
use freerig::control::fault::{MATRIX, Reaction};
use freerig::daemon::{Bench, DaemonError, procedure};
use freerig::signal::{FaultCode, FaultSet, RefusalCode, State};
use freerig::sim::chips::Misbehaviour;
use freerig::sim::{PlantFault, Valve};

use super::stage::{NO_DUMP_VALVE, PSI, Stage, TURNS_FAR, ms};

/// One period of a single Alicat unit at 19200 Bd, a reply's way over the line, and one tick.
const SAMPLE: Duration = Duration::from_millis(16 + 12 + 2);
/// One period of the IMU, the reading itself, and one tick.
const FRAME: Duration = Duration::from_millis(10 + 4 + 2);

#[test]
fn every_latched_fault_tells_a_person_what_to_do() {
    for row in &MATRIX {
        let mut fault = FaultSet::NONE;
        fault.insert(row.code);
        let error = DaemonError::Fault(fault);
        assert!(error.is_rig_fault());
        assert!(error.to_string().contains(row.code.name()), "{error}");
        assert!(error.remedy().starts_with(row.remedy) && error.remedy().ends_with("`freerig clear`."));
    }
}

#[test]
fn overpressure_hard_a_valve_stuck_open_is_vented_by_the_dump_valve() {
    let mut s = Stage::tracking(&TURNS_FAR);
    s.inject(PlantFault::Valve(0, Valve::StuckOpen));
    // 30 psi/s: from above 2 psi to 11 psi.
    s.expect(FaultCode::OverpressureHard, Reaction::Vent, ms(300) + SAMPLE);
    // What flows in within one reading (which takes two thirds of a period to arrive) and one tick.
    assert!(s.truth(0) < 11.0 * PSI + 30.0 * PSI * SAMPLE.as_secs_f64(), "{}", s.truth(0) / PSI);
    s.rests_vented(Reaction::Vent);
    // The dump valve alone keeps the pressure away: still open, still faulted.
    s.pass(ms(5000)).unwrap();
    s.is_vented();
    s.inject(PlantFault::Valve(0, Valve::Working));
    s.works_again();
}

#[test]
fn overpressure_soft_is_ramped_down() {
    let mut s = Stage::armed(&TURNS_FAR);
    s.press(9.0);
    // A valve that sticks open under a supply that gives no more than 10.75 psi: above p_warn, below p_hard.
    s.inject(PlantFault::Supply(10.75 * PSI));
    s.inject(PlantFault::Valve(0, Valve::StuckOpen));
    // 10.5 psi are reached within 0.2 s.
    let took = s.expect(FaultCode::OverpressureSoft, Reaction::Ramp, ms(200 + 100) + SAMPLE);
    assert!(took > ms(100));
    s.inject(PlantFault::Valve(0, Valve::Working));
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn overpressure_soft_that_the_ramp_does_not_take_away_is_vented() {
    let mut s = Stage::armed(&TURNS_FAR);
    s.press(9.0);
    s.inject(PlantFault::Supply(10.75 * PSI));
    s.inject(PlantFault::Valve(0, Valve::StuckOpen));
    s.expect(FaultCode::OverpressureSoft, Reaction::Ramp, ms(300) + SAMPLE);
    s.until(ms(2000), "vent", |r| r.vent);
    assert!(s.last.latched.contains(FaultCode::PressureNotFollowing));
    s.rests_vented(Reaction::Vent);
}

#[test]
fn pressure_sensor_range_a_sensor_over_its_range_is_vented() {
    let mut s = Stage::tracking(&[]);
    s.tokens("POV");
    let took = s.expect(FaultCode::PressureSensorRange, Reaction::Vent, SAMPLE + ms(2 * 18));
    assert!(took > ms(2 * 16), "three samples");
    s.rests_vented(Reaction::Vent);
    s.will_not_clear(FaultCode::PressureSensorRange);
    s.tokens("");
    s.works_again();
}

#[test]
fn pressure_not_following_a_stuck_valve_a_leak_and_a_lost_supply_are_vented() {
    let faults = [
        (PlantFault::Valve(0, Valve::Stuck), PlantFault::Valve(0, Valve::Working)),
        (PlantFault::Leak(0, 0.02), PlantFault::Leak(0, f64::INFINITY)),
        (PlantFault::Supply(0.5 * PSI), PlantFault::Supply(20.0 * PSI)),
    ];
    for (fault, repair) in faults {
        let mut s = Stage::armed(&[]);
        s.inject(fault);
        s.go_to(5.0);
        // At 5 psi/s, and with a lag of 0.1 s, the command is 3 % of the full scale (0.45 psi) ahead of a pressure of
        // up to 0.5 psi after 0.3 s; then one second in sum.
        s.expect(FaultCode::PressureNotFollowing, Reaction::Vent, ms(300 + 1000) + SAMPLE);
        s.rests_vented(Reaction::Vent);
        s.inject(repair);
        s.works_again();
    }
}

#[test]
fn imu_stale_a_short_gap_holds_and_resumes_a_long_one_ramps() {
    let mut s = Stage::tracking(&[]);
    s.imu().always(Misbehaviour::Nak);
    let took = s.expect(FaultCode::ImuStale, Reaction::Hold, ms(30) + FRAME);
    assert!(took >= ms(20), "three periods after the last one: {took:?}");
    let held = s.last.frees[0].command;
    s.pass(ms(80)).unwrap();
    assert_eq!((s.last.state, s.last.frees[0].command), (State::Faulting, held), "the pressure stands");
    s.imu().stop();
    s.until(ms(70), "hold", |r| r.state == State::Hold);
    assert_eq!(s.last.frees[0].command, held);
    // Once more, for longer.
    s.first.clear();
    s.imu().always(Misbehaviour::Nak);
    s.expect(FaultCode::ImuStale, Reaction::Hold, ms(30) + FRAME);
    s.until(ms(200), "ramp", |r| !r.latched.is_empty());
    assert!(s.last.latched.contains(FaultCode::ImuStale) && s.last.state == State::Faulting && !s.last.vent);
    let ramp = s.now();
    s.imu().stop();
    s.until(s.rig.control.ramp_time + s.rig.control.vent_time, "faulted", |r| r.state == State::Faulted);
    assert!(s.now().since(ramp) >= s.rig.control.ramp_time, "a ramp, no vent");
    s.is_vented();
    s.works_again();
}

#[test]
fn imu_implausible_garbage_is_held_and_then_ramped() {
    let mut s = Stage::tracking(&[]);
    s.imu().always(Misbehaviour::Garbage);
    let took = s.expect(FaultCode::ImuImplausible, Reaction::Hold, ms(20) + FRAME);
    assert!(took > ms(20) - FRAME, "three readings: {took:?}");
    s.until(ms(200), "ramp", |r| r.latched.contains(FaultCode::ImuImplausible));
    assert!(!s.last.vent);
    s.imu().stop();
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn imu_implausible_a_turned_sensor_is_not_believed() {
    let mut s = Stage::tracking(&[]);
    // One bit of one byte, in one burst out of many: never a fault, and never a jump of the command.
    let before = s.last.frees[0].command;
    for _ in 0..20 {
        s.imu().next(1, Misbehaviour::BitFlip);
        s.pass(ms(100)).unwrap();
    }
    assert_eq!(s.last.state, State::Track);
    assert!((s.last.frees[0].command - before).abs() < 0.5 * PSI);
}

#[test]
fn angle_limit_the_soft_envelope_ramps_and_the_hard_one_vents() {
    // A person turns the FREE's end: 0.086 Nm/rad.
    for (degrees, reaction) in [(135.0f64, Reaction::Ramp), (170.0, Reaction::Vent)] {
        let mut s = Stage::armed(&[]);
        s.press(2.0);
        let stiffness = s.rig.control.frees[0].free.torsional_stiffness;
        let missing = degrees.to_radians() - s.last.frees[0].estimate.angle;
        s.inject(PlantFault::Load(0, stiffness * missing));
        s.until(ms(500), "angle_limit", |r| r.frees[0].faults.contains(FaultCode::AngleLimit));
        match reaction {
            Reaction::Ramp => assert!(!s.last.vent && s.last.latched.contains(FaultCode::AngleLimit)),
            _ => {
                s.until(ms(500), "vent", |r| r.vent);
            }
        }
        s.rests_vented(reaction);
        s.inject(PlantFault::Load(0, 0.0));
        s.works_again();
    }
}

#[test]
fn tracking_error_a_load_that_pressure_cannot_fight_is_ramped_down() {
    let mut s = Stage::armed(&[]);
    s.track(10.0, false);
    // On by 80 degrees in the FREE's own direction: it cannot push back.
    let stiffness = s.rig.control.frees[0].free.torsional_stiffness;
    s.inject(PlantFault::Load(0, stiffness * 80f64.to_radians()));
    let took = s.expect(FaultCode::TrackingError, Reaction::Ramp, ms(1500 + 1000));
    assert!(took >= ms(1500));
    s.inject(PlantFault::Load(0, 0.0));
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn deadline_five_stalls_warn_twenty_ramp() {
    let mut s = Stage::tracking(&[]);
    let stall = |s: &mut Stage| {
        s.bench.wake_late(Duration::from_micros(1500));
        s.pass(ms(6)).unwrap();
    };
    for _ in 0..4 {
        stall(&mut s);
    }
    assert!(s.faults().is_empty());
    stall(&mut s);
    s.expect(FaultCode::Deadline, Reaction::Warn, ms(2));
    for _ in 0..14 {
        stall(&mut s);
    }
    assert_eq!(s.last.state, State::Track, "nineteen");
    stall(&mut s);
    s.expect(FaultCode::Deadline, Reaction::Ramp, ms(2));
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn client_lost_an_attended_program_is_ramped_down_a_detached_one_goes_on() {
    let mut s = Stage::armed(&[]);
    s.track(60.0, true);
    s.heart = false;
    let took = s.expect(FaultCode::ClientLost, Reaction::Ramp, ms(1500) + ms(2));
    assert!(took >= ms(1500) - s.rig.control.period, "the last beat was up to a tick ago");
    s.heart = true;
    s.rests_vented(Reaction::Ramp);
    s.works_again();

    let mut s = Stage::tracking(&[]);
    s.heart = false;
    s.pass(ms(5000)).unwrap();
    assert_eq!(s.last.state, State::Track);
}

#[test]
fn regulator_status_what_the_unit_says_is_ramped_down() {
    for tokens in ["ADC", "OPL", "HLD", "EXH"] {
        let mut s = Stage::tracking(&[]);
        s.tokens(tokens);
        s.expect(FaultCode::RegulatorStatus, Reaction::Ramp, SAMPLE);
        s.tokens("");
        s.rests_vented(Reaction::Ramp);
        s.works_again();
    }
}

#[test]
fn regulator_status_a_unit_that_does_not_obey_is_ramped_down() {
    // A rejection, and a set-point that comes from somewhere else.
    let mut s = Stage::tracking(&[]);
    s.regulator(0).next(1, Misbehaviour::Nak);
    // The rejected command costs a poll on top.
    s.expect(FaultCode::RegulatorStatus, Reaction::Ramp, SAMPLE * 2);
    s.rests_vented(Reaction::Ramp);
    s.works_again();

    let mut s = Stage::tracking(&[]);
    s.line().lock().unwrap().unit(b'A').unwrap().analog = true;
    s.expect(FaultCode::RegulatorStatus, Reaction::Ramp, SAMPLE);
    s.rests_vented(Reaction::Ramp);
    s.line().lock().unwrap().unit(b'A').unwrap().analog = false;
    s.works_again();
}

#[test]
fn regulator_status_a_factory_unit_is_not_armed() {
    let mut s = Stage::new(&[]);
    s.line().lock().unwrap().unit(b'A').unwrap().analog = true;
    let rig = s.rig.clone();
    let error = procedure::arm(&mut s, &rig, true).unwrap_err();
    assert!(error.to_string().contains("regulator_status"), "{error}");
    assert!(error.remedy().contains("set-point source to serial"), "{}", error.remedy());
    assert_eq!(s.last.state, State::Disarmed);
}

#[test]
fn config_changed_refuses_to_arm_and_to_start_and_warns_while_armed() {
    let mut s = Stage::tracking(&[]);
    s.bench.switches().config_changed.store(true, Ordering::Relaxed);
    s.expect(FaultCode::ConfigChanged, Reaction::Warn, ms(2));
    s.pass(ms(1000)).unwrap();
    assert_eq!(s.last.state, State::Track, "what runs goes on");
    let rig = s.rig.clone();
    procedure::disarm(&mut s, &rig).unwrap();
    refused(&mut s, RefusalCode::ConfigChanged);
}

#[test]
fn realtime_lost_refuses_to_arm_where_it_is_required_and_warns_while_armed() {
    let required = ("require_realtime = false", "require_realtime = true");
    let mut s = Stage::tracking(&[required]);
    s.bench.switches().realtime.store(false, Ordering::Relaxed);
    s.expect(FaultCode::RealtimeLost, Reaction::Warn, ms(2));
    let rig = s.rig.clone();
    procedure::disarm(&mut s, &rig).unwrap();
    refused(&mut s, RefusalCode::NotRealtime);
    // Where it is not required it is nothing.
    let s = Stage::tracking(&[]);
    s.bench.switches().realtime.store(false, Ordering::Relaxed);
    assert!(s.faults().is_empty());
}

fn refused(s: &mut Stage, code: RefusalCode) {
    let rig = s.rig.clone();
    match procedure::arm(s, &rig, true) {
        Err(DaemonError::Refused { refusal, .. }) => assert_eq!(refusal.code, code),
        other => panic!("{other:?}"),
    }
    assert_eq!(s.last.state, State::Disarmed);
}

#[test]
fn vent_failed_a_valve_stuck_open_without_a_dump_valve() {
    let mut s = Stage::tracking(&[NO_DUMP_VALVE, TURNS_FAR[0], TURNS_FAR[1]]);
    s.inject(PlantFault::Valve(0, Valve::StuckOpen));
    s.expect(FaultCode::OverpressureHard, Reaction::Vent, ms(300) + SAMPLE);
    s.first.clear();
    let took = s.until(s.rig.control.vent_time + ms(2), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    assert!(took >= s.rig.control.vent_time);
    assert!(s.truth(0) > 10.0 * PSI, "nothing that software could do");
    // Cut off by hand: the valve is closed, the line opened.
    s.inject(PlantFault::Valve(0, Valve::Working));
    s.works_again();
}

#[test]
fn vent_failed_a_dump_valve_that_sticks_does_not_count() {
    let mut s = Stage::armed(&[]);
    s.press(5.0);
    s.inject(PlantFault::DumpStuck(true));
    s.inject(PlantFault::Valve(0, Valve::Stuck));
    s.bench.switches().estop.store(true, Ordering::Release);
    s.expect(FaultCode::EmergencyStop, Reaction::Vent, ms(2));
    s.until(s.rig.control.vent_time + ms(2), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    let remedy = DaemonError::Fault(s.last.latched).remedy();
    assert!(remedy.contains("shut the supply"), "{remedy}");
}

#[test]
fn emergency_stop_from_anywhere() {
    let stop = |s: &mut Stage| {
        s.bench.switches().estop.store(true, Ordering::Release);
        s.pass(ms(2)).unwrap();
        assert!(s.last.state == State::Faulted && s.last.latched.contains(FaultCode::EmergencyStop));
        assert!(s.last.vent && s.last.frees[0].command == 0.0);
        s.pass(s.rig.control.vent_time).unwrap();
        s.rests_vented(Reaction::Vent);
        let rig = s.rig.clone();
        let error = procedure::clear(s, &rig).unwrap_err();
        assert!(matches!(error, DaemonError::Refused { .. }), "{error}");
        s.bench.switches().estop.store(false, Ordering::Release);
        s.works_again();
    };
    stop(&mut Stage::tracking(&[]));
    stop(&mut Stage::tracking(&[NO_DUMP_VALVE]));
    stop(&mut Stage::armed(&[]));
    let mut ramping = Stage::tracking(&[]);
    ramping.request(Request::Disarm).unwrap();
    ramping.pass(ms(500)).unwrap();
    assert_eq!(ramping.last.state, State::RampDown);
    stop(&mut ramping);
    // In the middle of another fault's reaction, and before anything is connected.
    let mut holding = Stage::tracking(&[]);
    holding.imu().always(Misbehaviour::Nak);
    holding.expect(FaultCode::ImuStale, Reaction::Hold, ms(50));
    holding.imu().stop();
    stop(&mut holding);
    let mut booting = Stage::new(&[]);
    booting.pass(ms(10)).unwrap();
    assert_eq!(booting.last.state, State::Boot);
    stop(&mut booting);
}

//! The digital lines: the dump valve's coil and heartbeat, and the emergency stop's contact.

use std::sync::atomic::Ordering;

use freerig::control::fault::Reaction;
use freerig::daemon::{Bench, DaemonError, procedure};
use freerig::signal::{FaultCode, RefusalCode, State};
use freerig::sim::{PlantFault, Valve};

use super::stage::{PSI, Stage, ms};

const LINES: (&str, &str) =
    ("[safety]", "[gpio]\ndump_valve = 17\nheartbeat = 27\nestop = 22\nsupply = 23\n\n[safety]");
const NO_HEARTBEAT: (&str, &str) = ("[safety]", "[gpio]\ndump_valve = 17\n\n[safety]");

#[test]
fn the_stops_contact_vents_and_is_not_cleared_while_it_is_pressed() {
    let mut s = Stage::tracking(&[LINES]);
    let button = s.bench.sim().button();
    button.press(true);
    // Two looks, 2 ms apart, and a tick.
    s.expect(FaultCode::EmergencyStop, Reaction::Vent, ms(6));
    s.pass(s.rig.control.vent_time).unwrap();
    s.rests_vented(Reaction::Vent);
    let rig = s.rig.clone();
    assert!(procedure::clear(&mut s, &rig).is_err());
    button.press(false);
    s.works_again();
}

#[test]
fn a_contact_that_bounces_for_a_moment_is_no_stop_and_one_that_is_pressed_from_the_start_keeps_it_from_arming() {
    let mut s = Stage::tracking(&[LINES]);
    let button = s.bench.sim().button();
    for _ in 0..20 {
        button.press(true);
        s.pass(ms(2)).unwrap();
        button.press(false);
        s.pass(ms(7)).unwrap();
    }
    assert_eq!(s.last.state, State::Track);

    let mut s = Stage::new(&[LINES]);
    s.bench.sim().button().press(true);
    let rig = s.rig.clone();
    match procedure::arm(&mut s, &rig, true) {
        Err(DaemonError::Fault(faults)) => assert!(faults.contains(FaultCode::EmergencyStop)),
        Err(DaemonError::Refused { refusal, .. }) => assert_eq!(refusal.code, RefusalCode::EmergencyStop),
        other => panic!("{other:?}"),
    }
    s.is_vented();
}

#[test]
fn without_a_heartbeat_the_valve_opens_whatever_its_output_stage_does() {
    // The regulator's valve sticks under pressure, and so does the output behind the dump valve's coil.
    for (lines, vented) in [(LINES, true), (NO_HEARTBEAT, false)] {
        let mut s = Stage::armed(&[lines]);
        s.press(5.0);
        s.inject(PlantFault::Valve(0, Valve::Stuck));
        s.bench.sim().stick_coil(true);
        s.bench.switches().estop.store(true, Ordering::Release);
        s.expect(FaultCode::EmergencyStop, Reaction::Vent, ms(2));
        s.pass(s.rig.control.vent_time + ms(4)).unwrap();
        assert_eq!(s.truth(0) < 0.2 * PSI, vented, "{}", s.truth(0) / PSI);
        assert_eq!(s.last.latched.contains(FaultCode::VentFailed), !vented);
    }
}

#[test]
fn a_loop_that_stands_still_stops_the_heartbeat() {
    let mut s = Stage::tracking(&[LINES]);
    s.bench.sim().stick_coil(true);
    s.inject(PlantFault::Valve(0, Valve::Stuck));
    s.bench.wake_late(ms(60_000));
    s.pass(s.rig.wiring.command_timeout + s.rig.control.vent_time).unwrap();
    assert!(s.truth(0) < 0.2 * PSI, "{}", s.truth(0) / PSI);
}

#[test]
fn a_supply_that_falls_is_ramped_down_and_a_short_dip_is_none() {
    let mut s = Stage::tracking(&[LINES]);
    for _ in 0..3 {
        s.inject(PlantFault::Supply(12.0 * PSI));
        s.pass(ms(480)).unwrap();
        s.inject(PlantFault::Supply(22.5 * PSI));
        s.pass(ms(50)).unwrap();
    }
    assert_eq!(s.last.state, State::Track);
    s.inject(PlantFault::Supply(12.0 * PSI));
    let took = s.expect(FaultCode::SupplyLow, Reaction::Ramp, ms(500 + 6));
    assert!(took >= ms(500));
    s.rests_vented(Reaction::Ramp);
    s.will_not_clear(FaultCode::SupplyLow);
    s.inject(PlantFault::Supply(22.5 * PSI));
    s.works_again();
}

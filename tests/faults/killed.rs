//! Regulator, IMU, serial line and DAC are killed, one at a time, while the rig tracks.
//!
//! With the dump valve the pressure is gone within the stated time; without it the rig says `vent_failed`, and zero
//! is the first that the device hears when it is back.

use freerig::control::fault::{Reaction, row};
use freerig::daemon::{Bench, DaemonError};
use freerig::signal::{FaultCode, State};
use freerig::sim::chips::Misbehaviour;

use super::stage::{NO_DUMP_VALVE, PSI, SECOND_FREE, Stage, ms};

/// Three periods of a single Alicat unit, and what it takes to notice: one reading on the line and one tick.
const STALE: u64 = 48 + 16 + 2;

#[test]
fn a_killed_regulator_is_stale_then_lost_and_the_dump_valve_vents() {
    let mut s = Stage::tracking(&[]);
    s.regulator(0).always(Misbehaviour::Silent);
    s.expect(FaultCode::PressureStale, Reaction::Vent, ms(STALE));
    s.until(ms(500), "bus_lost", |r| r.latched.contains(FaultCode::BusLost));
    s.rests_vented(Reaction::Vent);
    s.will_not_clear(FaultCode::PressureStale);
    s.regulator(0).stop();
    s.works_again();
}

#[test]
fn a_killed_regulator_without_a_dump_valve_is_a_failed_vent() {
    let mut s = Stage::tracking(&[NO_DUMP_VALVE]);
    let heard = s.line().lock().unwrap().eavesdrop();
    s.regulator(0).always(Misbehaviour::Silent);
    s.expect(FaultCode::PressureStale, Reaction::Vent, ms(STALE));
    s.until(s.rig.control.vent_time + ms(2), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    assert_eq!(s.last.state, State::Faulted);
    assert!(s.truth(0) > 2.0 * PSI, "a unit without power holds its pressure");
    let remedy = DaemonError::Fault(s.last.latched).remedy();
    assert!(remedy.contains(row(FaultCode::VentFailed).remedy), "{remedy}");
    // While it is away it hears nothing but zero.
    heard.lock().unwrap().clear();
    s.pass(ms(3000)).unwrap();
    s.regulator(0).stop();
    s.until(ms(2500), "zero", |r| r.frees[0].pressure.pressure < 0.2 * PSI);
    only_zero(&heard.lock().unwrap());
    s.works_again();
}

#[test]
fn an_unplugged_serial_line_is_lost_and_the_dump_valve_vents() {
    let mut s = Stage::tracking(&[]);
    s.line().lock().unwrap().plug(false);
    s.expect(FaultCode::BusLost, Reaction::Vent, ms(STALE));
    s.rests_vented(Reaction::Vent);
    s.will_not_clear(FaultCode::PressureStale);
    s.line().lock().unwrap().plug(true);
    s.works_again();
}

#[test]
fn an_unplugged_serial_line_without_a_dump_valve_hears_zero_first_when_it_is_back() {
    let mut s = Stage::tracking(&[NO_DUMP_VALVE]);
    let heard = s.line().lock().unwrap().eavesdrop();
    s.line().lock().unwrap().plug(false);
    s.expect(FaultCode::BusLost, Reaction::Vent, ms(STALE));
    s.until(s.rig.control.vent_time + ms(2), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    s.pass(ms(10_000)).unwrap();
    assert!(s.truth(0) > 2.0 * PSI, "the unit has power and its last set-point");
    assert!(s.last.latched.contains(FaultCode::VentFailed) && s.last.vent);
    heard.lock().unwrap().clear();
    s.line().lock().unwrap().plug(true);
    // Opened again within 200 ms, zero on the line within 5 ms, and gone with the regulator's own lag.
    s.pass(ms(220)).unwrap();
    assert_eq!(heard.lock().unwrap().first().map(|c| c.as_slice()), Some(&b"AS0.0000"[..]));
    s.pass(ms(780)).unwrap();
    s.is_vented();
    only_zero(&heard.lock().unwrap());
    s.works_again();
}

fn only_zero(heard: &[Vec<u8>]) {
    let setpoints: Vec<_> = heard.iter().filter(|c| c.get(1) == Some(&b'S')).collect();
    assert!(!setpoints.is_empty());
    assert!(setpoints.iter().all(|c| c.as_slice() == b"AS0.0000"), "{setpoints:?}");
}

#[test]
fn a_killed_imu_is_held_then_ramped_then_vented_as_lost() {
    for changes in [&[][..], &[NO_DUMP_VALVE]] {
        let mut s = Stage::tracking(changes);
        s.imu().always(Misbehaviour::Silent);
        s.expect(FaultCode::ImuStale, Reaction::Hold, ms(46));
        s.until(ms(200), "ramp", |r| r.latched.contains(FaultCode::ImuStale));
        assert!(!s.last.vent);
        s.until(ms(1000), "bus_lost", |r| r.latched.contains(FaultCode::BusLost));
        assert!(s.last.vent);
        s.rests_vented(Reaction::Vent);
        s.will_not_clear(FaultCode::ImuStale);
        s.imu().stop();
        s.works_again();
    }
}

#[test]
fn a_stuck_imu_is_not_believed() {
    let mut s = Stage::tracking(&[]);
    s.imu().always(Misbehaviour::Stuck);
    s.expect(FaultCode::ImuStale, Reaction::Hold, ms(46));
    s.until(ms(200), "ramp", |r| r.latched.contains(FaultCode::ImuStale));
    s.rests_vented(Reaction::Ramp);
    s.imu().stop();
    s.works_again();
}

#[test]
fn an_imu_that_was_reset_comes_back_after_a_ramp() {
    let mut s = Stage::tracking(&[]);
    s.imu().next(1, Misbehaviour::Reset);
    s.until(ms(60), "hold", |r| r.state == State::Faulting);
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn two_frees_are_vented_whichever_of_their_devices_dies() {
    type Kill = fn(&Stage);
    let kills: [(&str, Kill, Kill); 4] = [
        ("Alicat", |s| s.regulator(0).always(Misbehaviour::Silent), |s| s.regulator(0).stop()),
        ("DAC", |s| s.regulator(1).always(Misbehaviour::Silent), |s| s.regulator(1).stop()),
        (
            "IMU",
            |s| s.bench.sim().imu(1).unwrap().always(Misbehaviour::Silent),
            |s| s.bench.sim().imu(1).unwrap().stop(),
        ),
        ("line", |s| s.line().lock().unwrap().plug(false), |s| s.line().lock().unwrap().plug(true)),
    ];
    for (name, kill, repair) in kills {
        let mut s = Stage::tracking(&[SECOND_FREE]);
        kill(&s);
        s.until(ms(1200), name, |r| r.vent);
        s.rests_vented(Reaction::Vent);
        repair(&s);
        s.works_again();
    }
}

#[test]
fn a_dac_that_cannot_be_reached_without_a_dump_valve_is_a_failed_vent() {
    let mut s = Stage::tracking(&[SECOND_FREE, NO_DUMP_VALVE]);
    // It keeps its outputs and hears nothing.
    s.regulator(1).always(Misbehaviour::Nak);
    s.expect(FaultCode::PressureStale, Reaction::Vent, ms(30 + 10 + 2));
    s.until(s.rig.control.vent_time + ms(2), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    assert!(s.last.latched.contains(FaultCode::BusLost));
    assert!(s.truth(0) < 0.2 * PSI, "the other one is vented");
    assert!(s.truth(1) > 2.0 * PSI);
    s.regulator(1).stop();
    s.pass(ms(1500)).unwrap();
    s.is_vented();
    s.works_again();
}

#[test]
fn a_dac_that_was_reset_starts_at_zero_and_is_told_again() {
    let mut s = Stage::tracking(&[SECOND_FREE]);
    let before = s.truth(1);
    for _ in 0..20 {
        s.regulator(1).next(1, Misbehaviour::Reset);
        s.pass(ms(50)).unwrap();
        assert!(s.truth(1) <= before + 0.2 * PSI, "no surge");
    }
    assert_eq!(s.last.state, State::Track);
}

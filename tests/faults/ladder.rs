//! The IMU's recovery ladder, rung by rung, while the rig tracks.

use embedded_hal::i2c::I2c;
use freerig::control::fault::Reaction;
use freerig::daemon::Bench;
use freerig::signal::{FaultCode, State};
use freerig::sim::chips::Misbehaviour;

use super::stage::{Stage, ms};

const RESET_LINE: [(&str, &str); 2] =
    [("[safety]", "[gpio]\n\n[safety]"), ("period_ms = 10 ", "reset_line = 5\nperiod_ms = 10 ")];

#[test]
fn two_retries_in_the_same_turn_are_not_even_a_late_reading() {
    let mut s = Stage::tracking(&[]);
    for _ in 0..20 {
        s.imu().next(2, Misbehaviour::Nak);
        s.pass(ms(53)).unwrap();
        assert!(s.first.is_empty() && s.last.state == State::Track, "{:?}", s.first);
    }
}

#[test]
fn a_bus_that_somebody_holds_is_freed_at_the_second_rung_and_costs_a_hold() {
    let mut s = Stage::tracking(&[]);
    let tare = s.last.frees[0].estimate.tare;
    s.bench.sim().i2c(0).unwrap().0.hold();
    s.expect(FaultCode::ImuStale, Reaction::Hold, ms(46));
    // Freed 50 ms after the last good reading, and read again with the next turn.
    s.until(ms(60), "back", |r| r.state == State::Hold);
    assert!(s.last.latched.is_empty());
    assert_eq!(s.last.frees[0].estimate.tare, tare);
}

#[test]
fn a_chip_that_lost_its_settings_is_set_up_anew_after_a_ramp() {
    let mut s = Stage::tracking(&[]);
    s.imu().next(1, Misbehaviour::Reset);
    s.until(ms(60), "hold", |r| r.state == State::Faulting);
    s.rests_vented(Reaction::Ramp);
    assert!(!s.last.latched.contains(FaultCode::BusLost), "set up within its second");
    s.works_again();
}

#[test]
fn a_chip_that_hangs_is_brought_back_by_its_reset_line_and_is_lost_without_one() {
    let mut s = Stage::tracking(&RESET_LINE);
    s.imu().always(Misbehaviour::Hung);
    s.expect(FaultCode::ImuStale, Reaction::Hold, ms(46));
    s.rests_vented(Reaction::Ramp);
    assert!(!s.last.latched.contains(FaultCode::BusLost), "reset and set up within its second");
    s.works_again();

    let mut s = Stage::tracking(&[]);
    s.imu().always(Misbehaviour::Hung);
    s.until(ms(1100), "bus_lost", |r| r.latched.contains(FaultCode::BusLost));
    s.rests_vented(Reaction::Vent);
    s.imu().stop();
    s.works_again();
}

#[test]
fn an_unplugged_chip_with_a_reset_line_is_lost_all_the_same_and_comes_back() {
    let mut s = Stage::tracking(&RESET_LINE);
    s.imu().always(Misbehaviour::Silent);
    s.until(ms(1100), "bus_lost", |r| r.latched.contains(FaultCode::BusLost));
    s.rests_vented(Reaction::Vent);
    s.imu().stop();
    s.works_again();
}

#[test]
fn something_that_writes_its_mode_again_and_again_is_put_right_each_time() {
    let mut s = Stage::tracking(&[]);
    let (mut bus, _) = s.bench.sim().i2c(0).unwrap();
    let tare = s.last.frees[0].estimate.tare;
    // CONFIG, ACCGYRO, NDOF: to the last two only the supervision of every second looks.
    for mode in [0x00, 0x05, 0x0C] {
        bus.write(0x28, &[0x3D, mode]).unwrap();
        s.pass(ms(1300)).unwrap();
        assert!(s.last.latched.is_empty() && s.last.frees[0].estimate.tare == tare, "mode {mode:#04x}");
        let mut now = [0];
        bus.write_read(0x28, &[0x3D], &mut now).unwrap();
        assert_eq!(now[0] & 0x0F, 0x08, "after mode {mode:#04x}");
    }
}

//! A FREE on a microcontroller's PWM output, its pressure measured by an Alicat gauge on the same line: faults that
//! come by way of the output.

use freerig::control::fault::Reaction;
use freerig::daemon::Bench;
use freerig::signal::FaultCode;
use freerig::sim::chips::Misbehaviour;

use super::stage::{PSI, Stage, TURNS_FAR, ms};

const SECOND: &str = "[[free]]\nname = \"second\"\ncalibration = \"second\"\n\
     [free.imu]\nbus = \"main\"\naddress = 0x29\naxis = [0, 0, 1]\n\
     [free.regulator]\nkind = \"pwm\"\nline = \"line\"\nunit = \"P\"\nfull_scale_psi = 15\n\
     [free.pressure_sensor]\nkind = \"alicat\"\nline = \"line\"\nunit = \"G\"\nfull_scale_psi = 15\n\
     [free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\nsoft_angle_deg = [-400, 400]\n\
     hard_angle_deg = [-500, 500]\n[sim]\nseed";
/// Three units on a line of 19200 Bd, 30.5 characters each.
const ROUND: u64 = 48;

fn tracking() -> Stage {
    Stage::tracking(&[("[sim]\nseed", SECOND), TURNS_FAR[0], TURNS_FAR[1]])
}

#[test]
fn the_output_presses_and_the_gauge_measures() {
    let mut s = tracking();
    s.pass(ms(1000)).unwrap();
    let (seen, truth) = (s.last.frees[1].pressure, s.truth(1));
    assert!((seen.pressure - truth).abs() < 0.1 * PSI, "{} {}", seen.pressure / PSI, truth / PSI);
    // Zero and span of the regulator are off by the seeded scatter; the set-point is what the map makes of the duty.
    assert!((seen.setpoint - s.last.frees[1].command).abs() < 0.1 * PSI);
    assert!(s.faults().is_empty());
}

#[test]
fn an_output_that_was_reset_under_pressure_is_ramped_down() {
    let mut s = tracking();
    s.regulator(1).next(1, Misbehaviour::Reset);
    s.expect(FaultCode::RegulatorStatus, Reaction::Ramp, ms(ROUND + 4));
    s.rests_vented(Reaction::Ramp);
    s.works_again();
}

#[test]
fn a_watchdog_that_barks_too_soon_is_ramped_down() {
    let mut s = tracking();
    let patience = |s: &Stage, patience| s.line().lock().unwrap().output(b'P').unwrap().watchdog = patience;
    // Shorter than a round of the line: it acts between any two commands.
    patience(&s, ms(10));
    s.expect(FaultCode::RegulatorStatus, Reaction::Ramp, ms(2 * ROUND + 4));
    s.rests_vented(Reaction::Ramp);
    patience(&s, ms(250));
    s.works_again();
}

#[test]
fn an_output_that_is_silent_or_garbled_is_vented_and_comes_back() {
    for how in [Misbehaviour::Silent, Misbehaviour::Garbage, Misbehaviour::Stuck] {
        let mut s = tracking();
        s.regulator(1).always(how);
        // Three of its own periods from its last word on, whatever the gauge says.
        s.until(ms(3 * ROUND + 2), "vent", |record| record.vent);
        assert!(s.faults().contains(FaultCode::PressureStale), "{how:?}: {:?}", s.faults());
        if how == Misbehaviour::Stuck {
            // It takes nothing any more, and is told again and again: nothing but the dump valve vents it.
            s.pass(s.rig.control.vent_time).unwrap();
            s.is_vented();
        } else {
            s.rests_vented(Reaction::Vent);
        }
        s.regulator(1).stop();
        s.works_again();
    }
}

//! What can go wrong between controller, owner and chip: a loop that stands still, lines that come and go, units
//! that babble or lie, programs that ask for too much, and everything at once.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use freerig::control::fault::Reaction;
use freerig::control::{Gains, Request};
use freerig::daemon::Bench;
use freerig::signal::{FaultCode, State};
use freerig::sim::chips::Misbehaviour;
use freerig::sim::{PlantFault, Valve};
use freerig::trajectory::{Program, Sequence, Shape};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::stage::{NO_DUMP_VALVE, PSI, SECOND_FREE, SECOND_UNIT, Stage, ms};

#[test]
fn a_loop_that_stands_still_for_good_leaves_the_rig_vented() {
    for changes in [&[][..], &[NO_DUMP_VALVE], &[SECOND_FREE], &[SECOND_FREE, NO_DUMP_VALVE]] {
        let mut s = Stage::tracking(changes);
        s.bench.wake_late(Duration::from_secs(3600));
        s.pass(ms(90)).unwrap();
        assert!(s.truth(0) > 2.0 * PSI, "not at once");
        // Zero after 100 ms by the owners themselves; from there on the time of any vent.
        s.pass(ms(10 + 20) + s.rig.control.vent_time).unwrap();
        for free in 0..s.rig.control.frees.len() {
            assert!(s.truth(free) < 0.2 * PSI, "{changes:?}: FREE {free}: {}", s.truth(free) / PSI);
        }
        assert_eq!(s.line().lock().unwrap().unit(b'A').unwrap().setpoint(), 0.0);
    }
}

#[test]
fn a_short_stall_changes_nothing() {
    let mut s = Stage::tracking(&[]);
    let before = s.last.frees[0].command;
    s.bench.wake_late(ms(80));
    s.pass(ms(1000)).unwrap();
    assert_eq!(s.last.state, State::Track);
    assert!(s.first.is_empty(), "{:?}", s.first);
    assert!((s.last.frees[0].command - before).abs() < 0.2 * PSI);
}

#[test]
fn after_a_long_stall_the_command_begins_where_the_owners_left_the_rig() {
    for hold in [true, false] {
        let mut s = Stage::tracking(&[]);
        if hold {
            s.request(Request::Stop).unwrap();
            s.pass(ms(100)).unwrap();
        }
        s.bench.wake_late(ms(400));
        let slew = s.rig.control.frees[0].limits.slew;
        s.until(ms(500), "tick", |r| r.skipped > 0);
        // The owners have commanded zero for 300 ms: the first command after it is not the old one.
        let allowed = slew * 10.0 * s.rig.control.period.as_secs_f64();
        assert!(s.last.frees[0].command <= allowed, "{}", s.last.frees[0].command / PSI);
        for _ in 0..500 {
            let before = s.last.frees[0].command;
            s.pass(s.rig.control.period).unwrap();
            let step = s.last.frees[0].command - before;
            assert!(step <= slew * s.rig.control.period.as_secs_f64() * (1.0 + 1e-9), "{step}");
        }
        assert!(s.first.is_empty(), "{:?}", s.first);
        assert!(!hold || s.last.frees[0].command == 0.0, "a held pressure that is lost stays lost");
    }
}

#[test]
fn a_line_that_comes_and_goes_never_brings_an_old_set_point_back() {
    for gone in (0..400).step_by(10) {
        for changes in [&[][..], &[NO_DUMP_VALVE]] {
            let mut s = Stage::tracking(changes);
            let heard = s.line().lock().unwrap().eavesdrop();
            s.line().lock().unwrap().plug(false);
            s.pass(ms(gone)).unwrap();
            heard.lock().unwrap().clear();
            s.line().lock().unwrap().plug(true);
            s.until(ms(300), "first command", |_| !heard.lock().unwrap().is_empty());
            s.pass(ms(1700)).unwrap();
            let heard = heard.lock().unwrap();
            assert_eq!(heard[0], b"AS0.0000", "after {gone} ms");
            assert!(heard.iter().all(|c| c[1] != b'S' || c == b"AS0.0000"), "after {gone} ms: the rig had vented");
            assert_eq!(s.last.state, State::Faulted, "after {gone} ms");
            s.is_vented();
        }
    }
}

#[test]
fn a_unit_that_babbles_does_not_keep_zero_from_the_others() {
    for changes in [&[SECOND_UNIT][..], &[SECOND_UNIT, NO_DUMP_VALVE]] {
        let mut s = Stage::tracking(changes);
        s.regulator(0).next(1, Misbehaviour::Babble);
        s.until(ms(300), "vent", |r| r.vent);
        s.pass(s.rig.control.vent_time).unwrap();
        assert!(s.truth(1) < 0.2 * PSI, "{}", s.truth(1) / PSI);
        s.line().lock().unwrap().hush();
        s.pass(ms(2000)).unwrap();
        s.works_again();
    }
}

#[test]
fn an_emergency_stop_reaches_the_unit_while_the_line_recovers() {
    for how in [Misbehaviour::Late(ms(90)), Misbehaviour::Truncated, Misbehaviour::Garbage, Misbehaviour::WrongId] {
        let mut s = Stage::tracking(&[NO_DUMP_VALVE]);
        s.regulator(0).next(2, how);
        s.pass(ms(20)).unwrap();
        s.bench.switches().estop.store(true, Ordering::Release);
        let took = s.until(s.rig.control.vent_time, "faulted", |r| r.state == State::Faulted);
        assert!(took <= ms(4), "{how:?}");
        s.pass(s.rig.control.vent_time).unwrap();
        s.is_vented();
        assert!(!s.last.latched.contains(FaultCode::VentFailed), "{how:?}");
    }
}

#[test]
fn replies_that_are_always_late_are_stale_and_vented() {
    for late in [30, 60, 100, 300, 600] {
        let mut s = Stage::tracking(&[NO_DUMP_VALVE]);
        s.regulator(0).always(Misbehaviour::Late(ms(late)));
        s.until(ms(200), "vent", |r| r.vent || late == 30);
        s.pass(s.rig.control.vent_time + ms(100)).unwrap();
        // The unit hears every command, and obeys: only its replies cannot be used.
        if late > 30 {
            s.is_vented();
        }
        s.regulator(0).stop();
        if late > 30 {
            s.works_again();
        }
    }
}

#[test]
fn a_sensor_that_is_stuck_is_found_out_when_the_command_moves() {
    // At zero, while the pressure really rises.
    let mut s = Stage::armed(&[]);
    s.regulator(0).always(Misbehaviour::Stuck);
    s.go_to(5.0);
    s.expect(FaultCode::PressureNotFollowing, Reaction::Vent, ms(1300));
    s.pass(s.rig.control.vent_time).unwrap();
    s.is_vented();
    s.regulator(0).stop();
    s.works_again();
    // Under pressure, while the pressure really falls: it cannot be verified.
    let mut s = Stage::armed(&[]);
    s.press(5.0);
    s.regulator(0).always(Misbehaviour::Stuck);
    let rig = s.rig.clone();
    freerig::daemon::procedure::disarm(&mut s, &rig).unwrap_err();
    s.until(ms(4000), "vent_failed", |r| r.latched.contains(FaultCode::VentFailed));
    s.is_vented();
    s.regulator(0).stop();
    s.works_again();
}

#[test]
fn what_asks_for_too_much_gets_p_max() {
    // Beyond p_max, beyond the full scale, and an angle that no pressure reaches.
    for program in [
        Program::pressure(0, to(14.0 * PSI)).unwrap(),
        Program::pressure(0, to(1e9)).unwrap(),
        Program::angle(0, to(100.0)).unwrap(),
    ] {
        let mut s = Stage::armed(&[]);
        s.request(Request::Start { program: Arc::new(program), attended: false, identify: false }).unwrap();
        s.pass(ms(6000)).unwrap();
        assert!(s.truth(0) <= 10.0 * PSI);
        let rig = s.rig.clone();
        if s.last.state != State::Faulted {
            freerig::daemon::procedure::disarm(&mut s, &rig).unwrap();
        }
        s.is_vented();
    }
}

#[test]
fn gains_that_make_the_loop_swing_never_pass_the_limits() {
    let mut s = Stage::tracking(&[]);
    let wild = Gains { proportional: 1e9, integral: 1e12, derivative: 1e6, derivative_filter: 0.0 };
    s.request(Request::Gains { free: 0, gains: wild }).unwrap();
    s.pass(ms(5000)).unwrap();
    let rig = s.rig.clone();
    if s.last.state != State::Faulted {
        freerig::daemon::procedure::disarm(&mut s, &rig).unwrap();
    }
    s.is_vented();
    for gain in [f64::NAN, f64::INFINITY, -1.0] {
        let mut s = Stage::tracking(&[]);
        let before = s.last.frees[0].command;
        s.request(Request::Gains { free: 0, gains: Gains { proportional: gain, ..wild } }).unwrap();
        s.pass(ms(200)).unwrap();
        assert!((s.last.frees[0].command - before).abs() < 0.2 * PSI, "refused");
    }
}

fn to(value: f64) -> Sequence {
    Sequence::starting_at(0.0).then(Shape::Linear, value, 2.0).hold(3.0).build().unwrap()
}

/// Everything goes wrong at random for a while. Whatever happens, the limits hold (that is looked at in every
/// tick); and when everything works again, an emergency stop vents, and the rig can be used again.
fn chaos(seed: u64) -> String {
    let all = [&[][..], &[NO_DUMP_VALVE], &[SECOND_FREE], &[SECOND_FREE, NO_DUMP_VALVE], &[SECOND_UNIT]];
    let mut s = Stage::tracking(all[seed as usize % all.len()]);
    let mut rng = Pcg64::seed_from_u64(seed);
    let kinds = [
        Misbehaviour::Nak,
        Misbehaviour::Reset,
        Misbehaviour::Garbage,
        Misbehaviour::BitFlip,
        Misbehaviour::Silent,
        Misbehaviour::Stuck,
        Misbehaviour::WrongId,
        Misbehaviour::Truncated,
        Misbehaviour::Babble,
    ];
    let mut notes = String::new();
    for _ in 0..60 {
        let free = rng.random_range(0..s.rig.control.frees.len());
        let how = match rng.random_range(0..kinds.len() + 1) {
            0 => Misbehaviour::Late(ms(rng.random_range(1..150))),
            kind => kinds[kind - 1],
        };
        let count = rng.random_range(1..6);
        match rng.random_range(0..9) {
            0..3 => s.regulator(free).next(count, how),
            3..5 => s.bench.sim().imu(free).unwrap().next(count, how),
            5 => {
                let plugged = rng.random::<bool>();
                s.line().lock().unwrap().plug(plugged);
            }
            6 => s.bench.wake_late(ms(rng.random_range(1..200))),
            7 => {
                let fault = match rng.random_range(0..5) {
                    0 => PlantFault::Leak(free, rng.random_range(0.01..1.0)),
                    1 => PlantFault::Valve(free, Valve::Stuck),
                    2 => PlantFault::Valve(free, Valve::StuckOpen),
                    3 => PlantFault::Load(free, rng.random_range(-0.2..0.2)),
                    _ => PlantFault::Supply(rng.random_range(0.0..20.0) * PSI),
                };
                s.inject(fault);
            }
            _ => {
                let request = match rng.random_range(0..5) {
                    0 => Request::Clear,
                    1 => Request::Arm,
                    2 => Request::Disarm,
                    3 => Request::Stop,
                    _ => {
                        let program = Arc::new(Program::angle(0, to(1.0)).unwrap());
                        Request::Start { program, attended: true, identify: false }
                    }
                };
                s.request(request).ok();
            }
        }
        s.pass(ms(rng.random_range(1..120))).unwrap();
        notes.push_str(&format!("{:?} {:x}\n", s.last.state, s.last.frees[0].command.to_bits()));
    }
    // Everything is repaired.
    s.inject(PlantFault::Supply(22.5 * PSI));
    for free in 0..s.rig.control.frees.len() {
        s.inject(PlantFault::Leak(free, f64::INFINITY));
        s.inject(PlantFault::Valve(free, Valve::Working));
        s.inject(PlantFault::Load(free, 0.0));
        s.regulator(free).stop();
        s.bench.sim().imu(free).unwrap().stop();
    }
    s.line().lock().unwrap().plug(true);
    s.line().lock().unwrap().hush();
    s.bench.switches().estop.store(true, Ordering::Release);
    s.pass(ms(3000) + s.rig.control.vent_time).unwrap();
    assert_eq!(s.last.state, State::Faulted);
    s.is_vented();
    s.bench.switches().estop.store(false, Ordering::Release);
    s.works_again();
    notes
}

#[test]
fn whatever_goes_wrong_the_limits_hold_and_the_rig_comes_back() {
    for seed in 0..40 {
        chaos(seed);
    }
}

#[test]
fn what_goes_wrong_goes_wrong_the_same_way_twice() {
    assert_eq!(chaos(7), chaos(7));
}

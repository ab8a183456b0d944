//! Every edge of the life cycle's diagram, and every refusal.

use freerig::control::lifecycle::ARMING_TIME;
use freerig::control::{Gains, Request};
use freerig::signal::*;
use freerig::trajectory::{Program, Sequence};

use crate::harness::*;

fn refused(record: &TickRecord) -> (RefusalCode, u8) {
    (record.refusal.code, record.refusal.free)
}

#[test]
fn it_boots_disarmed_with_zero_commands_once_every_device_has_spoken() {
    let mut rig = Rig::one();
    rig.devices[0].imu_runs = false;
    rig.run_for(0.5);
    assert_eq!(rig.last.state, State::Boot);
    assert_eq!(refused(&rig.ask(Request::Arm)), (RefusalCode::NoImu, 0));
    rig.devices[0].imu_runs = true;
    rig.run_for(0.1);
    assert_eq!(rig.last.state, State::Disarmed);
    assert_eq!(rig.last.frees[0].command, 0.0);
    assert!(!rig.last.vent && rig.last.latched.is_empty());
}

#[test]
fn arming_tares_and_holds() {
    let mut rig = Rig::one();
    rig.devices[0].angle = 1.2; // wherever the sensor happens to point
    rig.arm();
    rig.run_for(0.1);
    let estimate = rig.last.frees[0].estimate;
    assert!(estimate.valid && estimate.angle.abs() < 1e-12 && estimate.measured_angle.abs() < 1e-12, "{estimate:?}");
}

#[test]
fn a_reading_that_cannot_be_stays_out_of_the_tare() {
    let mut rig = Rig::one();
    rig.run_for(0.05);
    rig.ask(Request::Arm);
    rig.run_for(0.04);
    // A flipped bit: half a radian within 10 ms, and no rate.
    rig.devices[0].angle = 0.5;
    rig.run_for(0.01);
    rig.devices[0].angle = 0.0;
    rig.run_for(0.5);
    assert_eq!(rig.last.state, State::Hold);
    assert!(rig.last.frees[0].estimate.angle.abs() < 1e-12, "{:?}", rig.last.frees[0].estimate);
}

#[test]
fn a_request_in_the_tick_in_which_a_hold_ends_is_heard() {
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].imu_runs = false;
    rig.until(0.1, |r| r.state == State::Faulting);
    rig.devices[0].imu_runs = true;
    while !(rig.input.tick + 1).is_multiple_of(IMU_TICKS) {
        assert_eq!(rig.tick().state, State::Faulting);
    }
    let record = rig.ask(Request::Disarm);
    assert_eq!((record.state, record.refusal), (State::RampDown, Refusal::NONE));
}

#[test]
fn arming_is_refused_at_once_where_something_speaks_against_it() {
    for (code, prepare) in [
        (RefusalCode::ConfigChanged, (|r| r.input.config_changed = true) as fn(&mut Rig)),
        (RefusalCode::FaultPresent, |r| {
            r.devices[0].status = RegulatorStatus::ANALOG_SOURCE;
            r.run_for(0.05);
        }),
    ] {
        let mut rig = Rig::one();
        rig.run_for(0.05);
        prepare(&mut rig);
        let record = rig.ask(Request::Arm);
        assert_eq!((record.refusal.code, record.state), (code, State::Disarmed));
        assert!(!code.remedy().is_empty());
    }
    let mut realtime = config(vec![free_control(-40.0)]);
    realtime.require_realtime = true;
    let mut rig = Rig::new(&realtime);
    rig.input.realtime = false;
    rig.run_for(0.05);
    assert!(rig.last.faults.contains(FaultCode::RealtimeLost));
    assert_eq!(rig.ask(Request::Arm).refusal.code, RefusalCode::NotRealtime);
    rig.input.realtime = true;
    assert_eq!(rig.ask(Request::Arm).refusal.code, RefusalCode::None);
}

#[test]
fn arming_gives_up_and_names_what_it_waited_for() {
    for (code, prepare) in [
        (RefusalCode::NotVented, (|d| d.stuck = Some(0.21 * PSI)) as fn(&mut Device)),
        (RefusalCode::NotCalibrated, |d| d.calibration = 0xef),
        (RefusalCode::NotStill, |d| d.rate = 0.06),
    ] {
        let mut rig = Rig::one();
        prepare(&mut rig.devices[0]);
        rig.run_for(0.05);
        assert_eq!(rig.ask(Request::Arm).refusal, Refusal::NONE);
        let t = rig.until(ARMING_TIME + 1.0, |r| r.state != State::Arming);
        assert!((t - ARMING_TIME).abs() < 0.003, "{t}");
        assert_eq!((rig.last.state, refused(&rig.last)), (State::Disarmed, (code, 0)));
    }
    // A fault ends it at once.
    let mut rig = Rig::one();
    rig.run_for(0.05);
    rig.ask(Request::Arm);
    rig.devices[0].imu_runs = false;
    rig.until(0.1, |r| r.state == State::Disarmed);
    assert_eq!(rig.last.refusal.fault, Some(FaultCode::ImuStale));
}

#[test]
fn arming_can_be_called_off() {
    let mut rig = Rig::one();
    rig.run_for(0.05);
    rig.ask(Request::Arm);
    assert_eq!(rig.ask(Request::Disarm).state, State::Disarmed);
}

#[test]
fn a_program_starts_ends_and_stops_into_a_hold_of_the_pressure() {
    let mut rig = Rig::armed();
    rig.start(pressure_program(3.0 * PSI, 1.0), false);
    assert_eq!(rig.last.program_time, 0.0);
    let t = rig.until(2.0, |r| r.state == State::Hold);
    assert!((t - 1.0).abs() < 0.003, "{t}");
    assert_eq!(rig.run_for(1.0).frees[0].command, 3.0 * PSI);
    assert!(rig.last.program_time.is_nan());
    rig.start(pressure_program(5.0 * PSI, 10.0), false);
    rig.run_for(1.0);
    let record = rig.ask(Request::Stop);
    assert_eq!((record.state, record.frees[0].command), (State::Hold, 5.0 * PSI));
}

#[test]
fn identification_is_a_program_with_a_name_of_its_own() {
    let mut rig = Rig::armed();
    let program = pressure_program(PSI, 1.0);
    assert_eq!(rig.ask(Request::Start { program, attended: false, identify: true }).state, State::Identify);
}

#[test]
fn programs_that_do_not_fit_are_refused() {
    let mut blind = free_control(-40.0);
    blind.imu = None;
    let mut rig = Rig::new(&config(vec![blind]));
    rig.arm();
    let start = |program| Request::Start { program, attended: false, identify: false };
    let angle = angle_program(Sequence::constant(0.1, 1.0).unwrap());
    assert_eq!(refused(&rig.ask(start(angle))), (RefusalCode::BadProgram, 0));
    let second = Program::pressure(1, Sequence::constant(0.1, 1.0).unwrap()).unwrap();
    assert_eq!(refused(&rig.ask(start(second.into()))), (RefusalCode::BadProgram, 1));
    assert_eq!(refused(&rig.ask(start(Program::default().into()))), (RefusalCode::BadProgram, Refusal::RIG));
    rig.input.config_changed = true;
    assert_eq!(rig.ask(start(pressure_program(PSI, 1.0))).refusal.code, RefusalCode::ConfigChanged);
    rig.input.config_changed = false;
    rig.start(pressure_program(PSI, 1.0), false);
}

#[test]
fn a_program_that_is_over_is_handed_back_before_another_one_starts() {
    let mut rig = Rig::armed();
    let program = pressure_program(PSI, 10.0);
    let start = || Request::Start { program: program.clone(), attended: false, identify: false };
    let mut ask = |request| {
        rig.input.time = rig.input.time + TICK;
        rig.input.request = request;
        let record = rig.controller.tick(&rig.input);
        rig.input.request = None;
        record
    };
    ask(Some(start()));
    ask(Some(Request::Stop));
    assert_eq!(ask(Some(start())).refusal.code, RefusalCode::Busy);
    assert!(std::sync::Arc::ptr_eq(&rig.controller.take_retired().unwrap(), &program));
    let mut ask = |request| {
        rig.input.time = rig.input.time + TICK;
        rig.input.request = request;
        rig.controller.tick(&rig.input)
    };
    assert_eq!(ask(Some(start())).state, State::Track);
}

#[test]
fn disarming_ramps_down_verifies_and_only_then_is_disarmed() {
    let mut rig = Rig::tracking(6.0);
    assert_eq!(rig.ask(Request::Disarm).state, State::RampDown);
    let mut last = rig.last.frees[0].command;
    let t = rig.until(5.0, |r| r.state == State::Disarmed);
    // 3 s of ramp, then the regulator's lag until 0.2 psi.
    assert!((3.0..3.2).contains(&t), "{t}");
    let mut rig = Rig::tracking(6.0);
    rig.ask(Request::Disarm);
    while rig.last.state == State::RampDown {
        let now = rig.tick().frees[0].command;
        assert!(now <= last + 1e-9 && last - now <= 6.0 * PSI / 3.0 * 0.002 + 1e-6);
        last = now;
    }
    assert_eq!(rig.last.frees[0].command, 0.0);
}

#[test]
fn a_ramp_down_that_does_not_vent_ends_in_a_vent_that_failed() {
    let mut rig = Rig::tracking(2.0);
    rig.devices[0].offset = 0.29 * PSI; // below the tolerance of the not-following detector, above p_zero
    rig.ask(Request::Disarm);
    let t = rig.until(6.0, |r| r.state == State::Faulting);
    assert!((t - 4.5).abs() < 0.01, "{t}");
    assert!(rig.last.vent && rig.last.latched.contains(FaultCode::VentFailed));
    rig.until(2.0, |r| r.state == State::Faulted);
}

#[test]
fn the_emergency_stop_vents_from_anywhere_and_must_be_released_before_clearing() {
    type Prepare = fn(&mut Rig);
    let states: [(State, Prepare); 8] = [
        (State::Boot, |_| ()),
        (State::Disarmed, |r| {
            r.run_for(0.1);
        }),
        (State::Arming, |r| {
            r.run_for(0.1);
            r.ask(Request::Arm);
        }),
        (State::Hold, Rig::arm),
        (State::Track, |r| {
            r.arm();
            r.pressurise(4.0);
        }),
        (State::RampDown, |r| {
            r.arm();
            r.pressurise(4.0);
            r.ask(Request::Disarm);
        }),
        (State::Faulting, |r| {
            r.arm();
            r.pressurise(4.0);
            r.devices[0].imu_runs = false;
            r.until(0.1, |r| r.state == State::Faulting);
            r.devices[0].imu_runs = true;
        }),
        (State::Faulted, |r| {
            r.arm();
            r.devices[0].stuck = Some(12.0 * PSI);
            r.until(0.1, |r| r.state == State::Faulting);
            r.devices[0].stuck = None;
            r.until(0.1, |r| r.state == State::Faulted);
        }),
    ];
    for (state, prepare) in states {
        let mut rig = Rig::one();
        prepare(&mut rig);
        assert_eq!(rig.last.state, state);
        rig.input.estop = true;
        let record = rig.tick();
        assert_eq!(record.state, State::Faulted, "{state:?}");
        assert!(record.vent && record.latched.contains(FaultCode::EmergencyStop));
        assert_eq!(record.frees[0].command, 0.0);
        rig.run_for(1.0);
        assert_eq!(rig.ask(Request::Clear).refusal.code, RefusalCode::EmergencyStop);
        rig.input.estop = false;
        rig.run_for(0.1);
        assert_eq!(rig.ask(Request::Clear).refusal, Refusal::NONE, "{state:?}");
        assert_eq!(rig.last.state, State::Disarmed);
        assert!(rig.last.latched.is_empty() && !rig.last.vent);
    }
}

#[test]
fn clearing_re_checks_the_cause_and_the_pressure() {
    let mut rig = Rig::tracking(4.0);
    rig.devices[0].status = RegulatorStatus::OVERPRESSURE_LIMIT;
    rig.until(6.0, |r| r.state == State::Faulted);
    assert_eq!(rig.ask(Request::Clear).refusal.fault, Some(FaultCode::RegulatorStatus));
    rig.devices[0].status = RegulatorStatus::default();
    rig.devices[0].stuck = Some(0.25 * PSI);
    rig.run_for(0.1);
    assert_eq!(rig.ask(Request::Clear).refusal.code, RefusalCode::NotVented);
    rig.devices[0].stuck = None;
    rig.run_for(0.1);
    assert_eq!(rig.ask(Request::Arm).refusal.code, RefusalCode::WrongState);
    assert_eq!(rig.ask(Request::Clear).state, State::Disarmed);
    rig.ask(Request::Arm);
    assert_eq!(rig.run_for(0.5).state, State::Hold);
}

#[test]
fn requests_out_of_place_are_refused() {
    let mut rig = Rig::one();
    rig.run_for(0.1);
    let program = pressure_program(PSI, 1.0);
    for request in [Request::Clear, Request::Stop, Request::Start { program, attended: false, identify: false }] {
        assert_eq!(rig.ask(request).refusal.code, RefusalCode::WrongState);
    }
    rig.arm();
    for request in [Request::Arm, Request::Clear] {
        assert_eq!(rig.ask(request).refusal.code, RefusalCode::WrongState);
        assert_eq!(rig.last.state, State::Hold);
    }
    let bad = Gains { proportional: -1.0, ..Gains::default() };
    assert_eq!(refused(&rig.ask(Request::Gains { free: 0, gains: bad })), (RefusalCode::BadGains, 0));
    assert_eq!(rig.ask(Request::Gains { free: 3, gains: Gains::default() }).refusal.code, RefusalCode::BadGains);
    assert_eq!(rig.ask(Request::Gains { free: 0, gains: Gains::default() }).refusal, Refusal::NONE);
    assert_eq!(rig.controller.gains(0), Some(Gains::default()));
}

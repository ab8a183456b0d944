//! Every row of the fault matrix that needs only these sensors: debounce at its limit and just below it, reaction,
//! latching, clearing.

use std::time::Duration;

use freerig::control::Request;
use freerig::signal::*;
use freerig::trajectory::Sequence;

use crate::harness::*;

/// The fault latches, vents at once, and clears once `mend` has removed its cause.
fn vents(rig: &mut Rig, code: FaultCode) {
    assert!(rig.faults().contains(code), "{:?}", rig.faults());
    assert_eq!((rig.last.state, rig.last.vent, rig.last.frees[0].command), (State::Faulting, true, 0.0));
    assert!(rig.last.latched.contains(code));
}

fn clears(rig: &mut Rig, mend: impl FnOnce(&mut Rig)) {
    let latched = rig.last.latched;
    mend(rig);
    rig.run_for(2.0);
    assert_eq!(rig.last.state, State::Faulted);
    assert!(rig.last.vent);
    assert_eq!(rig.last.latched.0 & latched.0, latched.0, "a latched fault stays until it is cleared");
    assert_eq!(rig.ask(Request::Clear).state, State::Disarmed, "{:?}", rig.last.refusal);
    assert!(rig.last.latched.is_empty());
}

#[test]
fn overpressure_hard_vents_on_one_sample() {
    let mut rig = Rig::tracking(6.0);
    rig.devices[0].stuck = Some(11.0 * PSI);
    rig.run_for(0.032);
    assert!(!rig.faults().contains(FaultCode::OverpressureHard));
    rig.devices[0].stuck = Some(11.001 * PSI);
    let t = rig.until(0.1, |r| r.state != State::Track);
    assert!(t <= 0.016 + 1e-9, "one device period at most: {t}");
    vents(&mut rig, FaultCode::OverpressureHard);
    clears(&mut rig, |r| r.devices[0].stuck = None);
}

#[test]
fn overpressure_vents_even_while_disarmed() {
    let mut rig = Rig::one();
    rig.run_for(0.1);
    rig.devices[0].stuck = Some(12.0 * PSI);
    rig.run_for(0.02);
    vents(&mut rig, FaultCode::OverpressureHard);
}

#[test]
fn overpressure_vents_even_before_every_device_has_spoken() {
    let mut rig = Rig::one();
    rig.devices[0].imu_runs = false;
    rig.run_for(0.1);
    assert_eq!(rig.last.state, State::Boot);
    rig.devices[0].stuck = Some(12.0 * PSI);
    rig.run_for(0.02);
    vents(&mut rig, FaultCode::OverpressureHard);
}

#[test]
fn an_imu_that_comes_back_with_another_north_does_not_stand_against_clearing() {
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].imu_health = ImuHealth::Restarting;
    rig.until(6.0, |r| r.state == State::Faulted);
    // Beyond the hard envelope of an angle whose zero is gone.
    rig.devices[0].angle = 2.5;
    clears(&mut rig, |r| r.devices[0].imu_health = ImuHealth::Good);
    rig.ask(Request::Arm);
    assert_eq!(rig.run_for(0.5).state, State::Hold);
    assert!(rig.last.frees[0].estimate.angle.abs() < 1e-12);
}

#[test]
fn overpressure_soft_ramps_down_after_100_ms() {
    let mut rig = Rig::tracking(6.0);
    let good = rig.last.frees[0].pressure.time;
    rig.devices[0].stuck = Some(10.6 * PSI);
    rig.until(0.02, |r| r.frees[0].pressure.pressure > 10.5 * PSI);
    // From the latest reading that was below.
    rig.run_for(0.098 - rig.last.time.seconds_since(good));
    assert_eq!(rig.last.state, State::Track);
    rig.tick();
    assert_eq!((rig.last.state, rig.last.vent), (State::Faulting, false));
    assert!(rig.last.latched.contains(FaultCode::OverpressureSoft));
    rig.devices[0].stuck = None;
    let t = rig.until(6.0, |r| r.state == State::Faulted);
    assert!(t <= 3.0 + 1.5, "ramp + t_vent: {t}");
    clears(&mut rig, |_| ());
    // Interrupted at 98 ms it counts from the start again.
    let mut rig = Rig::tracking(6.0);
    for _ in 0..3 {
        rig.devices[0].stuck = Some(10.6 * PSI);
        rig.run_for(0.080);
        rig.devices[0].stuck = None;
        rig.run_for(0.032);
    }
    assert_eq!(rig.last.state, State::Track);
}

#[test]
fn pressure_sensor_range_vents_after_three_samples() {
    type Spoil = fn(&mut Device);
    let spoils: [Spoil; 4] = [
        |d| d.stuck = Some(f64::NAN),
        |d| d.stuck = Some(-0.31 * PSI),
        |d| d.status = RegulatorStatus::PRESSURE_OVER_RANGE,
        |d| d.regulator_health = RegulatorHealth::Unmeasured,
    ];
    for spoil in spoils {
        let mut rig = Rig::tracking(1.0);
        let first = rig.last.frees[0].pressure.sequence;
        spoil(&mut rig.devices[0]);
        rig.until(0.1, |r| r.frees[0].pressure.sequence == first + 2);
        rig.run_for(0.014);
        assert_eq!(rig.last.state, State::Track, "two samples");
        rig.tick();
        assert_eq!(rig.last.frees[0].pressure.sequence, first + 3);
        vents(&mut rig, FaultCode::PressureSensorRange);
        clears(&mut rig, |r| r.devices[0] = Device { pressure: r.devices[0].pressure, ..Device::default() });
    }
}

#[test]
fn pressure_stale_vents_after_three_device_periods() {
    let mut rig = Rig::tracking(2.0);
    rig.until(0.1, |r| r.frees[0].pressure.time == r.time);
    rig.devices[0].regulator_runs = false;
    rig.run_for(0.048);
    assert_eq!(rig.last.state, State::Track, "an age of three periods is not more than three");
    rig.tick();
    vents(&mut rig, FaultCode::PressureStale);
    // Nothing can be verified: the vent has failed, as far as anybody knows.
    let t = rig.until(3.0, |r| r.state == State::Faulted);
    assert!((t - 1.5).abs() < 0.003, "{t}");
    assert!(rig.last.latched.contains(FaultCode::VentFailed));
    assert_eq!(rig.ask(Request::Clear).refusal.fault, Some(FaultCode::PressureStale));
    clears(&mut rig, |r| r.devices[0].regulator_runs = true);
}

#[test]
fn with_a_dump_valve_a_dead_line_is_no_failed_vent() {
    let mut with = config(vec![free_control(-40.0)]);
    with.dump_valve = true;
    let mut rig = Rig::new(&with);
    rig.arm();
    rig.pressurise(2.0);
    rig.devices[0].regulator_runs = false;
    rig.until(3.0, |r| r.state == State::Faulted);
    assert!(!rig.last.latched.contains(FaultCode::VentFailed) && rig.last.vent);
}

#[test]
fn a_stale_pressure_is_grown_to_its_worst_case() {
    // 9.9 psi and 30 psi/s: 11 psi at an age of 36.7 ms, short of three periods (48 ms).
    let mut rig = Rig::tracking(9.9);
    rig.devices[0].stuck = Some(9.9 * PSI);
    rig.run_for(0.1);
    rig.until(0.1, |r| r.frees[0].pressure.time == r.time);
    rig.devices[0].regulator_runs = false;
    rig.run_for(0.036);
    assert_eq!(rig.last.state, State::Track);
    rig.tick();
    vents(&mut rig, FaultCode::PressureStale);
}

#[test]
fn time_that_the_loop_stood_still_is_no_silence_of_a_device() {
    let mut rig = Rig::tracking(2.0);
    rig.input.time = rig.input.time + Duration::from_millis(60);
    rig.input.skipped += 30;
    assert_eq!(rig.tick().state, State::Track);
    assert_eq!(rig.run_for(0.5).state, State::Track);
}

#[test]
fn a_frozen_or_future_time_stamp_does_not_hide_a_silent_device() {
    let mut rig = Rig::tracking(2.0);
    rig.devices[0].regulator_runs = false;
    rig.devices[0].imu_runs = false;
    let far = rig.input.time + Duration::from_secs(1000);
    let pressure = &mut rig.input.pressure[0];
    (pressure.time, pressure.sequence) = (far, pressure.sequence + 1);
    let t = rig.until(0.1, |r| r.frees[0].faults.contains(FaultCode::PressureStale));
    assert!((t - 0.052).abs() < 1e-9, "{t}");
}

#[test]
fn a_regulator_that_does_not_follow_vents_after_a_second() {
    // Holding 4 psi, the line bursts.
    let mut rig = Rig::tracking(4.0);
    rig.devices[0].stuck = Some(0.0);
    rig.until(0.1, |r| r.frees[0].pressure.pressure == 0.0);
    // The reading before, 16 ms ago, was the last good one.
    rig.run_for(0.980);
    assert_eq!(rig.last.state, State::Track);
    let t = rig.until(0.1, |r| r.state == State::Faulting);
    assert!(t < 0.01, "{t}");
    vents(&mut rig, FaultCode::PressureNotFollowing);
    clears(&mut rig, |_| ());
}

#[test]
fn a_stuck_reading_is_found_under_a_moving_command_and_a_slow_approach_is_forgiven() {
    let mut rig = Rig::armed();
    let swing = Sequence::starting_at(1.0 * PSI).sinusoid(3.0 * PSI, 0.5, -std::f64::consts::FRAC_PI_2, 60.0).build();
    let program = freerig::trajectory::Program::pressure(0, swing.unwrap()).unwrap();
    rig.start(program.into(), false);
    rig.run_for(1.0);
    rig.devices[0].stuck = Some(rig.last.frees[0].pressure.pressure);
    let t = rig.until(6.0, |r| r.state == State::Faulting);
    assert!(rig.faults().contains(FaultCode::PressureNotFollowing), "{t} {:?}", rig.faults());
    // A regulator that takes 3 s to get there is slow, not broken.
    let mut rig = Rig::armed();
    rig.start(pressure_program(6.0 * PSI, 60.0), false);
    for k in 0..1500 {
        rig.devices[0].stuck = Some(6.0 * PSI * f64::from(k) / 1500.0);
        rig.tick();
        assert_eq!(rig.last.state, State::Track, "{k}");
    }
}

#[test]
fn imu_stale_holds_after_three_periods_and_resumes_as_hold() {
    let mut rig = Rig::tracking(3.0);
    rig.until(0.1, |r| r.frees[0].imu.time == r.time);
    rig.devices[0].imu_runs = false;
    rig.run_for(0.030);
    assert_eq!(rig.last.state, State::Track);
    rig.tick();
    assert_eq!(rig.last.state, State::Faulting);
    assert!(rig.faults().contains(FaultCode::ImuStale) && rig.last.latched.is_empty() && !rig.last.vent);
    let held = rig.last.frees[0].command;
    rig.run_for(0.05);
    assert_eq!(rig.last.frees[0].command, held);
    rig.devices[0].imu_runs = true;
    rig.until(0.02, |r| r.state == State::Hold);
    assert_eq!(rig.last.frees[0].command, held);
    assert!(rig.last.latched.is_empty());
}

#[test]
fn an_imu_that_is_silent_and_then_restarts_is_not_back() {
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].imu_runs = false;
    rig.until(0.1, |r| r.state == State::Faulting);
    rig.devices[0].imu_runs = true;
    rig.devices[0].imu_health = ImuHealth::Restarting;
    let t = rig.until(1.0, |r| {
        assert_eq!(r.state, State::Faulting);
        !r.latched.is_empty()
    });
    assert!(t < 0.2 && rig.last.latched.contains(FaultCode::ImuStale), "{t} {:?}", rig.last.latched);
}

#[test]
fn imu_stale_for_200_ms_ramps_down() {
    let mut rig = Rig::tracking(3.0);
    rig.until(0.1, |r| r.frees[0].imu.time == r.time);
    rig.devices[0].imu_runs = false;
    rig.run_for(0.200);
    assert!(rig.last.latched.is_empty());
    rig.tick();
    assert!(rig.last.latched.contains(FaultCode::ImuStale) && !rig.last.vent);
    let t = rig.until(6.0, |r| r.state == State::Faulted);
    assert!((2.999..3.3).contains(&t), "{t}");
    clears(&mut rig, |r| r.devices[0].imu_runs = true);
}

#[test]
fn imu_implausible_holds_after_three_samples_and_ramps_down_after_200_ms() {
    type Spoil = fn(&mut Device);
    let spoils: [Spoil; 3] =
        [|d| d.norm = 1.021, |d| d.imu_health = ImuHealth::Restarting, |d| d.angle = std::f64::consts::PI - 0.01];
    for spoil in spoils {
        let mut rig = Rig::tracking(3.0);
        let first = rig.last.frees[0].imu.sequence;
        spoil(&mut rig.devices[0]);
        rig.until(0.1, |r| r.frees[0].imu.sequence == first + 2);
        rig.run_for(0.008);
        assert_eq!(rig.last.state, State::Track, "two samples");
        rig.tick();
        assert_eq!(rig.last.state, State::Faulting);
        assert!(rig.faults().contains(FaultCode::ImuImplausible) && rig.last.latched.is_empty());
        rig.run_for(0.1);
        assert!(rig.last.latched.is_empty());
        rig.run_for(0.1);
        assert!(rig.last.latched.contains(FaultCode::ImuImplausible), "{:?}", rig.faults());
    }
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].norm = 1.019;
    assert_eq!(rig.run_for(0.5).state, State::Track);
}

#[test]
fn angle_limits_ramp_down_outside_the_soft_envelope_and_vent_outside_the_hard_one() {
    for sign in [1.0, -1.0] {
        let turn_to = |rig: &mut Rig, angle: f64| {
            // In steps that the gyro's jump check lets through.
            while (rig.devices[0].angle - sign * angle).abs() > 1e-12 {
                let left = sign * angle - rig.devices[0].angle;
                rig.devices[0].angle += left.clamp(-0.2, 0.2);
                rig.run_for(0.01);
            }
        };
        let mut rig = Rig::tracking(3.0);
        turn_to(&mut rig, 1.6 - 1e-9);
        assert_eq!(rig.last.state, State::Track);
        turn_to(&mut rig, 1.61);
        assert_eq!((rig.last.state, rig.last.vent), (State::Faulting, false));
        assert!(rig.last.latched.contains(FaultCode::AngleLimit));
        turn_to(&mut rig, 1.99);
        assert!(!rig.last.vent);
        turn_to(&mut rig, 2.01);
        assert!(rig.last.vent);
        turn_to(&mut rig, 0.0);
        clears(&mut rig, |_| ());
    }
}

#[test]
fn a_tracking_error_ramps_down_after_its_configured_time() {
    let mut free = free_control(-40.0);
    free.limits.tracking_error = (0.2, 0.3);
    let mut rig = Rig::new(&config(vec![free]));
    rig.arm();
    rig.start(angle_program(Sequence::constant(0.19, 60.0).unwrap()), false);
    assert_eq!(rig.run_for(1.0).state, State::Track);
    rig.ask(Request::Stop);
    rig.start(angle_program(Sequence::constant(0.21, 60.0).unwrap()), false);
    // The interlocks first see the program in the tick after its start.
    rig.run_for(0.3);
    assert_eq!(rig.last.state, State::Track);
    rig.tick();
    assert!(rig.last.latched.contains(FaultCode::TrackingError), "{:?}", rig.faults());
    let still_there = rig.until(6.0, |r| r.state == State::Faulted);
    assert!(still_there > 1.0);
    clears(&mut rig, |_| ());
}

#[test]
fn deadlines_warn_at_5_and_ramp_down_at_20_among_the_last_100_ticks() {
    let mut rig = Rig::tracking(3.0);
    let stall = |rig: &mut Rig| {
        rig.input.latency_ns = 1_000_001;
        rig.tick();
        rig.input.latency_ns = 10_000;
        rig.tick();
    };
    for _ in 0..4 {
        stall(&mut rig);
    }
    assert!(rig.last.faults.is_empty());
    stall(&mut rig);
    assert!(rig.last.faults.contains(FaultCode::Deadline));
    assert_eq!(rig.last.state, State::Track);
    for _ in 0..14 {
        stall(&mut rig);
    }
    assert_eq!((rig.last.state, rig.last.latched), (State::Track, FaultSet::NONE));
    stall(&mut rig);
    assert_eq!((rig.last.state, rig.last.latched), (State::Faulting, set(&[FaultCode::Deadline])));
    // They are forgotten a hundred ticks later.
    clears(&mut rig, |r| {
        r.run_for(3.5);
    });
}

#[test]
fn the_late_ticks_of_one_stall_count_once() {
    let mut rig = Rig::tracking(3.0);
    for _ in 0..4 {
        for late in 0..10u32 {
            rig.input.latency_ns = 1_900_000;
            rig.input.skipped += u64::from(late % 2);
            rig.tick();
        }
        rig.input.latency_ns = 0;
        rig.run_for(0.01);
    }
    assert!(rig.last.faults.is_empty());
    assert_eq!(rig.last.state, State::Track);
}

#[test]
fn a_client_that_is_lost_for_a_second_and_a_half_ends_an_attended_program_only() {
    let mut rig = Rig::armed();
    rig.start(pressure_program(3.0 * PSI, 60.0), true);
    for _ in 0..20 {
        rig.input.heartbeat = rig.input.time;
        rig.run_for(0.5);
        assert_eq!(rig.last.state, State::Track);
    }
    rig.input.heartbeat = rig.input.time;
    rig.run_for(1.498);
    assert_eq!(rig.last.state, State::Track);
    rig.tick();
    assert_eq!(rig.last.latched, set(&[FaultCode::ClientLost]));
    clears(&mut rig, |r| {
        r.run_for(3.0);
    });
    let mut rig = Rig::armed();
    rig.start(pressure_program(3.0 * PSI, 60.0), false);
    assert_eq!(rig.run_for(5.0).state, State::Track);
}

#[test]
fn regulator_status_ramps_down_on_one_sample() {
    for status in [
        RegulatorStatus::CONVERTER_FAILED,
        RegulatorStatus::OVERPRESSURE_LIMIT,
        RegulatorStatus::HELD,
        RegulatorStatus::EXHAUSTING,
        RegulatorStatus::ECHO_MISMATCH,
        RegulatorStatus::REJECTED,
        RegulatorStatus::ANALOG_SOURCE,
    ] {
        let mut rig = Rig::tracking(3.0);
        rig.devices[0].status = status;
        let t = rig.until(0.1, |r| r.state == State::Faulting);
        assert!(t <= 0.016 + 1e-9);
        assert_eq!((rig.last.latched, rig.last.vent), (set(&[FaultCode::RegulatorStatus]), false));
    }
    for status in [RegulatorStatus::UNKNOWN_TOKEN, RegulatorStatus::LOCKED] {
        let mut rig = Rig::tracking(3.0);
        rig.devices[0].status = status;
        assert_eq!(rig.run_for(0.5).state, State::Track);
    }
    // A unit that holds its valve is nobody's business while disarmed.
    let mut rig = Rig::one();
    rig.devices[0].status = RegulatorStatus::HELD;
    rig.run_for(0.1);
    assert!(rig.faults().is_empty());
}

#[test]
fn a_lost_bus_vents() {
    for spoil in
        [(|d| d.imu_health = ImuHealth::Lost) as fn(&mut Device), |d| d.regulator_health = RegulatorHealth::Lost]
    {
        let mut rig = Rig::tracking(3.0);
        spoil(&mut rig.devices[0]);
        rig.until(0.1, |r| r.state == State::Faulting);
        vents(&mut rig, FaultCode::BusLost);
        clears(&mut rig, |r| r.devices[0] = Device { pressure: r.devices[0].pressure, ..Device::default() });
    }
}

#[test]
fn a_changed_file_warns_while_armed() {
    let mut rig = Rig::tracking(3.0);
    rig.input.config_changed = true;
    rig.run_for(0.1);
    assert_eq!((rig.last.state, rig.last.faults), (State::Track, set(&[FaultCode::ConfigChanged])));
}

#[test]
fn a_vent_that_does_not_empty_the_free_has_failed() {
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].stuck = Some(3.0 * PSI);
    rig.input.estop = true;
    rig.tick();
    rig.input.estop = false;
    rig.run_for(1.498);
    assert!(!rig.last.latched.contains(FaultCode::VentFailed));
    rig.tick();
    assert!(rig.last.latched.contains(FaultCode::VentFailed));
    rig.devices[0].stuck = None;
    rig.devices[0].pressure = 0.0;
    clears(&mut rig, |r| {
        r.run_for(3.0);
    });
}

#[test]
fn a_stronger_reaction_takes_over_from_a_weaker_one() {
    let mut rig = Rig::tracking(3.0);
    rig.devices[0].status = RegulatorStatus::HELD;
    rig.until(0.1, |r| r.state == State::Faulting);
    rig.devices[0].stuck = Some(12.0 * PSI);
    rig.until(0.1, |r| r.vent);
    let expected = set(&[FaultCode::RegulatorStatus, FaultCode::OverpressureHard]);
    assert_eq!(rig.last.latched.0 & expected.0, expected.0);
}

//! Whatever comes in: commands within 0..=p_max and the slew limit, the integral bounded, everything finite.

use std::time::Duration;

use freerig::clock::Time;
use freerig::control::{ControlError, Controller, Gains, Request};
use freerig::signal::*;
use freerig::trajectory::{Sequence, Shape};
use proptest::prelude::*;

use crate::harness::*;

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -2.0..2.0f64,
        2 => -1e5..1e5f64,
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(f64::MAX), Just(-0.0)],
    ]
}

#[derive(Clone, Debug)]
enum Event {
    Garbage { imu: [f64; 8], pressure: f64, health: u8, status: u16 },
    Request(u8, f64),
    Run(u16),
    Stop(bool, bool),
    Time(i64),
    Late(u32, u32),
    Devices(bool, bool),
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        (prop::array::uniform8(any_number()), any_number(), 0u8..5, any::<u16>())
            .prop_map(|(imu, pressure, health, status)| Event::Garbage { imu, pressure, health, status }),
        (0u8..7, any_number()).prop_map(|(r, x)| Event::Request(r, x)),
        (1u16..400).prop_map(Event::Run),
        (prop::bool::weighted(0.2), prop::bool::weighted(0.2)).prop_map(|(e, c)| Event::Stop(e, c)),
        prop_oneof![-10_000_000i64..100_000_000, Just(i64::MAX / 4)].prop_map(Event::Time),
        (any::<u32>(), any::<u32>()).prop_map(|(a, b)| Event::Late(a, b)),
        (prop::bool::weighted(0.8), prop::bool::weighted(0.8)).prop_map(|(a, b)| Event::Devices(a, b)),
    ]
}

fn request(kind: u8, x: f64) -> Request {
    let finite = if x.is_finite() { x } else { 1.0 };
    match kind {
        0 => Request::Arm,
        1 => Request::Disarm,
        2 => Request::Clear,
        3 => Request::Stop,
        4 => Request::Gains {
            free: (finite.abs() as usize) % 8,
            gains: Gains { proportional: x, integral: x, derivative: x, derivative_filter: x },
        },
        5 => Request::Start { program: pressure_program(finite.abs(), 0.5), attended: false, identify: false },
        _ => Request::Start {
            program: angle_program(
                Sequence::starting_at(0.0).then(Shape::Cubic, finite, 0.3).hold(1.0).build().unwrap(),
            ),
            attended: finite > 0.0,
            identify: false,
        },
    }
}

fn judge(rig: &mut Rig, last: &mut [f64; 2], last_time: &mut Time) -> Result<(), TestCaseError> {
    let record = rig.last;
    let dt = record.time.seconds_since(*last_time).max(0.0);
    *last_time = record.time;
    for (free, last) in record.frees().iter().zip(last.iter_mut()) {
        prop_assert!(free.command >= 0.0 && free.command <= 10.0 * PSI, "{}", free.command);
        let zero = record.vent || matches!(record.state, State::Boot | State::Disarmed | State::Arming);
        if zero {
            prop_assert_eq!(free.command, 0.0);
        }
        if !record.vent {
            prop_assert!((free.command - *last).abs() <= 30.0 * PSI * dt + 1e-6, "{} {}", free.command, last);
        }
        *last = free.command;
        prop_assert!(free.terms.integral.abs() <= 10.0 * PSI && free.terms.sum().is_finite());
        prop_assert!(free.estimate.angle.is_finite() && free.estimate.rate.is_finite());
    }
    if !record.latched.is_empty() {
        prop_assert!(matches!(record.state, State::Faulting | State::Faulted));
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn limits_are_never_exceeded_whatever_comes_in(events in prop::collection::vec(event(), 1..40), arm in any::<bool>()) {
        let mut rig = Rig::new(&config(vec![free_control(-40.0), free_control(40.0)]));
        rig.plant = true;
        if arm {
            rig.arm();
        }
        let mut last = [0.0; 2];
        let mut last_time = rig.input.time;
        for event in events {
            match event {
                Event::Garbage { imu, pressure, health, status } => {
                    let p = &mut rig.input.pressure[0];
                    p.pressure = pressure;
                    p.sequence = p.sequence.wrapping_add(1);
                    p.status = RegulatorStatus(status);
                    p.health = [RegulatorHealth::Absent, RegulatorHealth::Good, RegulatorHealth::Unmeasured, RegulatorHealth::Lost, RegulatorHealth::Good][usize::from(health)];
                    let i = &mut rig.input.imu[0];
                    i.quaternion = [imu[0], imu[1], imu[2], imu[3]];
                    i.rate = [imu[4], imu[5], imu[6]];
                    i.sequence = i.sequence.wrapping_add(1);
                    i.health = [ImuHealth::Absent, ImuHealth::Good, ImuHealth::Implausible, ImuHealth::Restarting, ImuHealth::Lost][usize::from(health)];
                    rig.tick();
                }
                Event::Request(kind, x) => { rig.ask(request(kind, x)); }
                Event::Run(ticks) => {
                    for _ in 0..ticks {
                        rig.tick();
                        judge(&mut rig, &mut last, &mut last_time)?;
                    }
                }
                Event::Stop(estop, changed) => {
                    rig.input.estop = estop;
                    rig.input.config_changed = changed;
                    rig.tick();
                }
                Event::Time(ns) => {
                    let t = rig.input.time;
                    rig.input.time = if ns < 0 { t - Duration::from_nanos(ns.unsigned_abs()) } else { t + Duration::from_nanos(ns as u64) };
                    rig.tick();
                }
                Event::Late(latency, execution) => {
                    rig.input.latency_ns = latency;
                    rig.input.execution_ns = execution;
                    rig.input.skipped = rig.input.skipped.wrapping_add(1);
                    rig.tick();
                    rig.input.latency_ns = 0;
                    rig.input.execution_ns = 0;
                }
                Event::Devices(imu, regulator) => {
                    rig.devices[0].imu_runs = imu;
                    rig.devices[0].regulator_runs = regulator;
                    rig.tick();
                }
            }
            judge(&mut rig, &mut last, &mut last_time)?;
        }
    }
}

#[test]
fn a_configuration_out_of_range_is_refused_by_name() {
    let spoil = |change: fn(&mut freerig::control::FreeControl)| {
        let mut free = free_control(-40.0);
        change(&mut free);
        Controller::new(&config(vec![free])).map(|_| ()).unwrap_err()
    };
    for (what, error) in [
        ("warn_pressure", spoil(|f| f.limits.pressure_warn = f.limits.pressure_max)),
        ("hard_pressure", spoil(|f| f.limits.pressure_hard = f64::NAN)),
        ("slew", spoil(|f| f.limits.slew = 3.0 * PSI)),
        ("angle_hard", spoil(|f| f.limits.angle_hard = (-1.0, 2.0))),
        ("IMU axis", spoil(|f| f.imu.as_mut().unwrap().axis = [0.0, 0.0, 0.9])),
        ("proportional gain", spoil(|f| f.gains.proportional = -1.0)),
        ("feedforward", spoil(|f| f.feedforward = 1.1)),
    ] {
        assert!(matches!(&error, ControlError::Value { what: w, .. } if *w == what), "{error}");
        assert!(error.to_string().contains("paper"));
    }
    assert_eq!(Controller::new(&config(vec![])).map(|_| ()), Err(ControlError::FreeCount(0)));
    let seven = config(vec![free_control(-40.0); 7]);
    assert_eq!(Controller::new(&seven).map(|_| ()), Err(ControlError::FreeCount(7)));
}

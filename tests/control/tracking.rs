//! The closed loop: it follows, engages and changes gains without a bump, for L and R FREEs; and it can be replayed.

use std::sync::Arc;

use freerig::control::replay::{Carried, Replay};
use freerig::control::{ControllerKind, FreeControl, Gains, ModelSpec, Request, default_gains};
use freerig::signal::*;
use freerig::trajectory::{Axis, Program, Sequence, Shape, paper_trajectory};

use crate::harness::*;

fn cubic(to: f64, moving: f64, total: f64) -> Sequence {
    Sequence::starting_at(0.0).then(Shape::Cubic, to, moving).hold(total - moving).build().unwrap()
}

fn rig_with(gamma: f64) -> Rig {
    let mut rig = Rig::new(&config(vec![free_control(gamma)]));
    rig.plant = true;
    rig.arm();
    rig
}

#[test]
fn l_and_r_frees_settle_alike_in_their_own_direction() {
    for gamma in [-40.0, 40.0] {
        let direction = if gamma < 0.0 { 1.0 } else { -1.0 };
        let mut rig = rig_with(gamma);
        rig.start(angle_program(cubic(direction * 0.7, 1.5, 6.0)), false);
        rig.run_for(5.9);
        let f = rig.last.frees[0];
        assert!((f.estimate.angle - direction * 0.7).abs() < 1e-3, "{gamma}: {:?}", f.estimate);
        assert!(f.command > 0.0 && rig.last.state == State::Track);
    }
}

/// RMS of reference - true angle over `seconds` of `sequence`, deg, and the largest overshoot of its last value.
fn follow(gains: Gains, feedforward: f64, sequence: Sequence, seconds: f64) -> (f64, f64) {
    let mut free = free_control(-40.0);
    (free.gains, free.feedforward) = (gains, feedforward);
    let mut rig = Rig::new(&config(vec![free]));
    rig.plant = true;
    rig.arm();
    rig.start(angle_program(sequence.clone()), false);
    let (mut sum, mut over, ticks) = (0.0, f64::NEG_INFINITY, (seconds / 0.002) as u32);
    for _ in 0..ticks {
        let record = rig.tick();
        let error = record.frees[0].reference.position - rig.devices[0].angle;
        sum += error * error;
        over = over.max(rig.devices[0].angle - sequence.last());
    }
    assert_eq!(rig.last.state, State::Track, "{:?}", rig.faults());
    ((sum / f64::from(ticks)).sqrt().to_degrees(), over.to_degrees())
}

fn own_gains() -> Gains {
    let free = free_control(-40.0);
    default_gains(&free.free, &free.regulator, &free.imu.unwrap(), TICK)
}

#[test]
fn freerigs_own_gains_follow_the_papers_trajectory_within_a_degree_and_better_than_the_published_ones() {
    let trajectory = || paper_trajectory().unwrap();
    let (published, _) =
        follow(Gains { proportional: 17236.9, integral: 603291.5, ..Gains::default() }, 0.0, trajectory(), 8.9);
    let (without, _) = follow(own_gains(), 0.0, trajectory(), 8.9);
    let (with, _) = follow(own_gains(), 1.0, trajectory(), 8.9);
    println!("RMS: published-trajectory {published:.3}, own {without:.3}, own with feedforward {with:.3} deg");
    assert!(with < 1.0 && with < 0.3 * without && with < 0.2 * published, "{published} {without} {with}");
}

#[test]
fn a_step_with_freerigs_own_gains_hardly_overshoots_and_by_less_than_a_tenth_with_feedforward() {
    let step = Sequence::starting_at(0.0).step(50f64.to_radians(), 4.0).build().unwrap();
    // With feedforward both it and the error push while the regulator slews.
    for (feedforward, bound) in [(0.0, 0.5), (1.0, 5.0)] {
        let (rms, over) = follow(own_gains(), feedforward, step.clone(), 3.9);
        println!("50 deg step, feedforward {feedforward}: RMS {rms:.2}, overshoot {over:.2} deg");
        assert!(over < bound, "{feedforward}: {over}");
    }
}

#[test]
fn a_step_starts_from_rest_and_a_second_program_from_the_pressure_that_is_held() {
    let mut rig = rig_with(-40.0);
    rig.start(angle_program(Sequence::starting_at(0.0).step(0.5, 4.0).build().unwrap()), false);
    assert!(rig.last.frees[0].terms.integral.abs() < 262406.0 * 0.5 * 0.002 + 1e-6);
    rig.run_for(4.1);
    assert_eq!(rig.last.state, State::Hold);
    let held = rig.last.frees[0].command;
    rig.start(angle_program(cubic(0.5, 1.0, 2.0)), false); // from 0, where the FREE is not
    assert!((rig.last.frees[0].command - held).abs() <= 30.0 * PSI * 0.002 + 1e-9);
    assert!((rig.last.frees[0].wanted - held).abs() < 0.1 * PSI, "{:?} {held}", rig.last.frees[0]);
}

#[test]
fn gains_change_in_flight_without_a_bump() {
    let mut rig = rig_with(-40.0);
    rig.start(angle_program(cubic(0.7, 1.5, 20.0)), false);
    rig.run_for(1.0);
    let before = rig.last.frees[0].wanted;
    let gains = Gains { proportional: 10e3, integral: 100e3, derivative: 0.0, derivative_filter: 5.0 };
    let record = rig.ask(Request::Gains { free: 0, gains });
    assert_eq!(record.refusal, Refusal::NONE);
    assert!((record.frees[0].wanted - before).abs() < 0.05 * PSI, "{} {before}", record.frees[0].wanted);
    assert!((rig.run_for(15.0).frees[0].estimate.angle - 0.7).abs() < 2e-3);
}

#[test]
fn a_hold_for_the_imu_freezes_the_terms() {
    let mut rig = rig_with(-40.0);
    rig.start(angle_program(cubic(0.7, 1.5, 20.0)), false);
    rig.run_for(1.0);
    rig.devices[0].imu_runs = false;
    rig.until(0.1, |r| r.state == State::Faulting);
    let frozen = rig.last.frees[0];
    assert!(frozen.limits.contains(LimitSet::INTEGRATOR_HELD));
    rig.run_for(0.05);
    assert_eq!(rig.last.frees[0].terms, frozen.terms);
    assert_eq!(rig.last.frees[0].command, frozen.command);
}

#[test]
fn a_replay_from_arming_or_from_hold_gives_the_commands_again_bit_for_bit() {
    let mut free = free_control(-40.0);
    free.feedforward = 0.7;
    let model = FreeControl { controller: ControllerKind::Model(ModelSpec::default()), ..free_control(40.0) };
    let config = config(vec![free, model]);
    let mut rig = Rig::new(&config);
    rig.plant = true;
    rig.run_for(0.051);
    rig.keep = true;
    rig.devices[0].angle = 0.4;
    rig.arm();
    let armed = rig.records.len() - 1;
    let axis = |sequence| Axis { quantity: Quantity::Angle, sequence };
    let step = Sequence::starting_at(0.0).step(-0.3, 4.0).build().unwrap();
    let program = Arc::new(Program::new([(0, axis(cubic(0.7, 1.5, 4.0))), (1, axis(step))]).unwrap());
    rig.start(program.clone(), true);
    let gains = Gains { proportional: 10e3, integral: 100e3, derivative: 500.0, derivative_filter: 5.0 };
    for k in 0..1400u32 {
        rig.input.heartbeat = rig.input.time;
        if k == 500 {
            rig.ask(Request::Gains { free: 0, gains });
        }
        if k == 900 {
            rig.devices[1].status = RegulatorStatus::HELD;
        }
        rig.tick();
    }
    rig.run_for(3.0);
    assert_eq!(rig.last.state, State::Faulted);
    let carried = Carried { program, attended: true, identify: false, gains: vec![(0, gains)] };
    for seed in [0, armed] {
        let mut replay = Replay::new(&config, &rig.records[seed], carried.clone()).unwrap().unwrap();
        let records = &rig.records[seed + 1..];
        assert!(records.len() > 2500 && records.iter().any(|r| r.frees[0].command > 2.0 * PSI));
        assert_eq!(replay.first_difference(records), None, "seed {seed}");
    }
    // It is not blind: another bit in one input and the commands differ.
    let mut records = rig.records[armed + 1..].to_vec();
    records[600].frees[0].imu.rate[2] += 1e-3;
    records[600].frees[0].imu.sequence += 1;
    let mut replay = Replay::new(&config, &rig.records[armed], carried.clone()).unwrap().unwrap();
    assert_eq!(replay.first_difference(&records), Some(600));
    assert!(Replay::new(&config, &rig.records[armed + 50], carried).unwrap().is_none(), "a seed in mid-program");
}

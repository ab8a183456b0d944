//! The same in real time: threads, a pseudo-terminal, and an end without a farewell.
//!
//! Nothing is said about how fast it goes: the machine may stall.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use freerig::clock::Clock;
use freerig::config::Rig;
use freerig::control::Request;
use freerig::daemon::{Bench, Live, LiveBench, Switches, procedure};
use freerig::signal::{FaultCode, State};
use freerig::sim::Plant;
use freerig::trajectory::{Program, Sequence, Shape};

use super::stage::{self, PSI, ms};

/// A slow loop, for machines without real-time rights.
const SLOW: (&str, &str) = ("rate_hz = 500", "rate_hz = 50");

fn truth(plant: &Mutex<Plant>, ahead: Duration) -> f64 {
    plant.lock().unwrap().pressure(0, Clock::Live.now() + ahead)
}

/// Arms and takes the FREE to 4 psi; false on a machine that stalls so much that the rig will not have it.
fn press(bench: &mut LiveBench, rig: &Rig, plant: &Mutex<Plant>) -> bool {
    for _ in 0..4 {
        if procedure::arm(bench, rig, true).is_ok() {
            let ramp = Sequence::starting_at(0.0).then(Shape::Linear, 4.0 * PSI, 1.0).hold(600.0).build().unwrap();
            let program = Arc::new(Program::pressure(0, ramp).unwrap());
            bench.request(Request::Start { program, attended: false, identify: false }).unwrap();
            for _ in 0..100 {
                bench.pass(ms(50)).unwrap();
                if bench.latest().state == State::Track && truth(plant, Duration::ZERO) > 3.0 * PSI {
                    return true;
                }
            }
        }
        bench.pass(rig.control.vent_time).unwrap();
        procedure::clear(bench, rig).ok();
    }
    eprintln!("skipped: this machine stalls too much");
    false
}

fn wait_for(bench: &mut LiveBench, what: &str, mut holds: impl FnMut(&mut LiveBench) -> bool) {
    for _ in 0..600 {
        if holds(bench) {
            return;
        }
        bench.pass(ms(50)).unwrap();
    }
    panic!("waited 30 s for {what}; the rig stands in {:?}", bench.latest().state);
}

#[test]
fn a_pulled_plug_vents_and_a_rig_that_is_dropped_leaves_no_pressure() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig = stage::rig(folder.path(), &[SLOW]);
    rig.record.directory = folder.path().to_owned();
    let live = Live::start(&rig, Switches::default()).unwrap();
    let plant = live.sim().unwrap().plant();
    let mut bench = live.bench();
    if !press(&mut bench, &rig, &plant) {
        return;
    }
    live.ptys()[0].lock().unwrap().unplug();
    wait_for(&mut bench, "bus_lost", |b| b.latest().latched.contains(FaultCode::BusLost));
    wait_for(&mut bench, "the vent", |_| truth(&plant, Duration::ZERO) < 0.2 * PSI);
    let line = Arc::clone(live.sim().unwrap().line(0).unwrap());
    let setpoint = || line.lock().unwrap().unit(b'A').unwrap().setpoint();
    assert!(setpoint() > 0.0, "it was the dump valve");
    live.ptys()[0].lock().unwrap().plug().unwrap();
    wait_for(&mut bench, "the return", |b| procedure::clear(b, &rig).is_ok());
    assert_eq!(setpoint(), 0.0);
    if !press(&mut bench, &rig, &plant) {
        return;
    }
    drop(live);
    assert_eq!(setpoint(), 0.0);
    assert!(truth(&plant, rig.control.vent_time) < 0.2 * PSI);
    assert!(bench.pass(ms(20)).is_err(), "whoever still looks is told");
}

//! One full cycle of ticks, boot to fault and vent, under an allocation guard: the tick allocates and frees nothing.

use std::sync::Arc;

use assert_no_alloc::assert_no_alloc;
use freerig::control::{ControllerKind, FreeControl, Gains, ModelSpec, Request};
use freerig::model::{ELEMENTS, Hysteresis};
use freerig::signal::{MAX_FREES, Quantity, State};
use freerig::trajectory::{Axis, Program, Sequence};

use crate::harness::*;

#[test]
fn a_cycle_of_arming_tracking_faulting_and_venting_allocates_nothing() {
    // As many FREEs as a rig can hold: one under the model, with a step in its program, one under the PID, and a
    // module's four, which follow pressures.
    let spec =
        ModelSpec { hysteresis: Hysteresis::new([0.1; ELEMENTS], [1e-3; ELEMENTS]).unwrap(), ..ModelSpec::default() };
    let model = FreeControl { controller: ControllerKind::Model(spec), ..free_control(-40.0) };
    let whisk = |gamma| FreeControl { controller: ControllerKind::Nothing, ..free_control(gamma) };
    let frees = vec![model, free_control(40.0), whisk(40.0), whisk(-40.0), whisk(40.0), whisk(-40.0)];
    assert_eq!(frees.len(), MAX_FREES);
    let mut rig = Rig::new(&config(frees));
    rig.plant = true;
    let turn = Sequence::starting_at(0.0).cubic_in_slot(0.5, 1.0, 1.5).step(0.4, 0.5).build().unwrap();
    let press = Sequence::starting_at(0.0).cubic_in_slot(PSI, 1.0, 1.5).build().unwrap();
    let pressed = (2..MAX_FREES).map(|free| (free, Axis { quantity: Quantity::Pressure, sequence: press.clone() }));
    let turned = (0, Axis { quantity: Quantity::Angle, sequence: turn });
    let program = Arc::new(Program::new([turned].into_iter().chain(pressed)).unwrap());
    let start = |identify| Request::Start { program: program.clone(), attended: false, identify };
    let gains = Gains { proportional: 1e4, integral: 1e5, derivative: 100.0, derivative_filter: 10.0 };
    let mut requests = [
        (50, Request::Arm),
        (300, start(false)),
        (600, Request::Gains { free: 0, gains }),
        (1500, start(true)),
        (1700, Request::Stop),
        (1800, start(false)),
        (4000, Request::Clear),
        (4100, Request::Arm),
        (4400, Request::Disarm),
    ]
    .into_iter()
    .peekable();
    let mut visited = [false; 9];
    for k in 0..4600u32 {
        let request = requests.next_if(|(at, _)| *at == k).map(|(_, request)| request);
        if k == 2000 {
            rig.devices[1].imu_runs = false;
        }
        if k == 3900 {
            rig.devices[1].imu_runs = true;
        }
        rig.input.request = request;
        // Aborts the test at the first allocation. What the harness does beside the tick touches no heap either.
        let record = assert_no_alloc(|| rig.tick());
        visited[record.state as usize] = true;
    }
    let names =
        [State::Disarmed, State::Arming, State::Hold, State::Track, State::Identify, State::Faulting, State::Faulted];
    for state in names {
        assert!(visited[state as usize], "{state:?} was not visited");
    }
    assert_eq!(rig.last.state, State::Disarmed);
}

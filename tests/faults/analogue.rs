//! An analogue regulator whose pressure is measured: by an ADC's channel, or by an Alicat gauge on the serial line.

use freerig::control::fault::Reaction;
use freerig::daemon::{Bench, DaemonError, is_vented, procedure};
use freerig::signal::{FaultCode, State};
use freerig::sim::chips::Misbehaviour;
use freerig::sim::{PlantFault, Valve};

use super::stage::{NO_DUMP_VALVE, PSI, Stage, TURNS_FAR, ms};

const FREE: &str = "[[free]]\nname = \"second\"\ncalibration = \"second\"\n\
     [free.imu]\nbus = \"main\"\naddress = 0x29\naxis = [0, 0, 1]\n\
     [free.regulator]\nkind = \"mcp4728\"\nbus = \"main\"\naddress = 0x60\nchannel = \"A\"\nfull_scale_psi = 15\n\
     [free.limits]\nmax_pressure_psi = 8\nproof_pressure_psi = 15\nsoft_angle_deg = [-400, 400]\n\
     hard_angle_deg = [-500, 500]\n";
const ADC: &str = "[free.pressure_sensor]\nkind = \"ads1115\"\nbus = \"main\"\naddress = 0x48\nchannel = 2\n\
     zero_v = 0.5\nfull_v = 4.5\nfull_scale_psi = 15\n";
const GAUGE: &str = "[free.pressure_sensor]\nkind = \"alicat\"\nline = \"line\"\nunit = \"G\"\nfull_scale_psi = 15\n";

/// Both FREEs at 60 degrees, the second one's pressure measured by `sensor`.
fn tracking(sensor: &str, changes: &[(&str, &str)]) -> Stage {
    let second = format!("{FREE}{sensor}\n[sim]\nseed");
    let mut all = vec![("[sim]\nseed", second.as_str()), TURNS_FAR[0], TURNS_FAR[1]];
    all.extend(changes);
    Stage::tracking(&all)
}

/// Three periods of the sensor (10 ms of the ADC's channel, 32 ms of two units on the line), one more, and a tick.
fn stale(sensor: &str) -> std::time::Duration {
    if sensor == ADC { ms(4 * 10 + 2) } else { ms(4 * 35 + 2) }
}

#[test]
fn the_sensor_measures_what_the_regulator_cannot_and_verifies_the_vent() {
    for sensor in [ADC, GAUGE] {
        let mut s = tracking(sensor, &[]);
        let heard = s.line().lock().unwrap().eavesdrop();
        s.pass(ms(1000)).unwrap();
        let (seen, truth) = (s.last.frees[1].pressure, s.truth(1));
        // Noise of 0.01 psi, and what the FREE still moves within a few periods.
        assert!((seen.pressure - truth).abs() < 0.1 * PSI, "{sensor}: {} {}", seen.pressure / PSI, truth / PSI);
        assert!(seen.setpoint > 2.0 * PSI, "and the set-point is the DAC's");
        assert!(!is_vented(&s.last, &s.rig));
        let rig = s.rig.clone();
        procedure::disarm(&mut s, &rig).unwrap();
        assert!(is_vented(&s.last, &s.rig) && s.truth(1) < 0.2 * PSI);
        assert!(s.last.frees[1].pressure.pressure < 0.2 * PSI);
        // No set-point ever goes to a gauge: it may hang on the same line as a regulator.
        let told: Vec<_> = heard.lock().unwrap().iter().filter(|c| c.starts_with(b"GS")).cloned().collect();
        assert!(told.is_empty(), "{told:?}");
    }
}

#[test]
fn pressures_that_only_the_sensor_sees_are_vented() {
    type Break = (PlantFault, PlantFault, FaultCode, u64);
    let breaks: [Break; 2] = [
        // 30 psi/s from above 2 psi to 9 psi, and one reading.
        (
            PlantFault::Valve(1, Valve::StuckOpen),
            PlantFault::Valve(1, Valve::Working),
            FaultCode::OverpressureHard,
            240 + 40,
        ),
        // The band is left within 0.1 s, then one second in sum.
        (
            PlantFault::Leak(1, 0.02),
            PlantFault::Leak(1, f64::INFINITY),
            FaultCode::PressureNotFollowing,
            100 + 1000 + 40,
        ),
    ];
    for sensor in [ADC, GAUGE] {
        for (fault, repair, code, longest) in breaks {
            let mut s = tracking(sensor, &[]);
            s.inject(fault);
            s.expect(code, Reaction::Vent, ms(longest));
            s.rests_vented(Reaction::Vent);
            s.inject(repair);
            s.works_again();
        }
    }
}

#[test]
fn a_vent_that_fails_is_seen_by_the_sensor() {
    for sensor in [ADC, GAUGE] {
        let mut s = tracking(sensor, &[NO_DUMP_VALVE]);
        s.inject(PlantFault::Valve(1, Valve::Stuck));
        let rig = s.rig.clone();
        s.request(freerig::control::Request::Disarm).unwrap();
        s.until(rig.control.ramp_time + rig.control.vent_time * 2, "vent_failed", |r| {
            r.latched.contains(FaultCode::VentFailed)
        });
        assert!(s.truth(1) > 2.0 * PSI && s.truth(0) < 0.2 * PSI);
    }
}

#[test]
fn a_sensor_that_is_silent_garbled_or_cut_off_is_vented_and_comes_back() {
    type Act = fn(&Stage);
    let silent: Act = |s| s.bench.sim().sensor(1).unwrap().always(Misbehaviour::Silent);
    let garbled: Act = |s| s.bench.sim().sensor(1).unwrap().always(Misbehaviour::Garbage);
    let mended: Act = |s| s.bench.sim().sensor(1).unwrap().stop();
    let cut: Act = |s| s.bench.sim().cut_sensor(1, true);
    let joined: Act = |s| s.bench.sim().cut_sensor(1, false);
    use FaultCode::{PressureSensorRange, PressureStale};
    let cases = [
        ("silent", ADC, silent, mended, PressureStale, stale(ADC)),
        ("garbled", ADC, garbled, mended, PressureStale, stale(ADC)),
        // 0 V where 0.5 V is no pressure: three readings.
        ("cut off", ADC, cut, joined, PressureSensorRange, ms(4 * 10 + 2)),
        ("silent", GAUGE, silent, mended, PressureStale, stale(GAUGE)),
        ("garbled", GAUGE, garbled, mended, PressureStale, stale(GAUGE)),
    ];
    for (name, sensor, broken, repaired, code, longest) in cases {
        let mut s = tracking(sensor, &[]);
        broken(&s);
        let took = s.until(longest, name, |r| r.frees[1].faults.contains(code));
        assert!(s.last.vent && s.last.frees.iter().all(|f| f.command == 0.0), "{name} after {took:?}");
        s.pass(s.rig.control.vent_time + ms(2)).unwrap();
        s.is_vented();
        s.will_not_clear(code);
        repaired(&s);
        s.works_again();
    }
}

#[test]
fn a_dac_that_falls_silent_is_not_hidden_by_its_sensor() {
    let mut s = tracking(ADC, &[]);
    s.regulator(1).always(Misbehaviour::Silent);
    // Three of its own periods.
    s.expect(FaultCode::PressureStale, Reaction::Vent, ms(3 * 10 + 10 + 2));
    s.rests_vented(Reaction::Vent);
    s.regulator(1).stop();
    s.works_again();
}

#[test]
fn a_sensor_is_unplugged_and_plugged_in_again_while_nothing_is_armed() {
    for sensor in [ADC, GAUGE] {
        let mut s = tracking(sensor, &[]);
        let rig = s.rig.clone();
        procedure::disarm(&mut s, &rig).unwrap();
        s.bench.sim().sensor(1).unwrap().always(Misbehaviour::Silent);
        s.pass(ms(3000)).unwrap();
        assert_eq!(s.last.state, State::Disarmed);
        assert!(matches!(procedure::arm(&mut s, &rig, true), Err(DaemonError::Refused { .. })));
        s.bench.sim().sensor(1).unwrap().stop();
        s.pass(ms(3000)).unwrap();
        procedure::arm(&mut s, &rig, true).unwrap();
    }
}

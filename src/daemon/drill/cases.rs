//! How each fault of the matrix is brought about.

use std::sync::atomic::Ordering;

use super::scene::{Scene, Start};
use crate::config::Rig;
use crate::control::{Reaction, interlocks};
use crate::daemon::Bench;
use crate::daemon::stepped::lock;
use crate::hardware::gpio;
use crate::hardware::i2c_owner::IMU_LOST_AFTER;
use crate::hardware::wiring::{GpioWiring, SerialWiring, UnitWiring};
use crate::signal::{FaultCode, FaultSet};
use crate::sim::chips::{AlicatChip, Misbehaviour};
use crate::sim::{PlantFault, Valve};

/// Gives a time of the rig, s.
type Seconds = fn(&Rig) -> f64;

/// One way in which one fault comes about.
#[derive(Clone, Copy)]
pub struct Case {
    /// The fault.
    pub code: FaultCode,
    /// How it is brought about, in words.
    pub how: &'static str,
    /// What the rig is to do.
    pub reaction: Reaction,
    /// Whether the pressure then has to fall: not where its only path has been cut.
    pub falls: bool,
    /// Faults that belong to the same cause, and may come first.
    pub(super) along: FaultSet,
    pub(super) start: Start,
    /// What the rig is made to be.
    pub(super) prepare: fn(&mut Rig),
    /// So many late ticks come first.
    pub(super) stalls: u32,
    pub(super) provoke: fn(&mut Scene),
    /// Whether the condition holds, in truth.
    pub(super) begun: fn(&mut Scene) -> bool,
    /// What is repaired once it has been seen, so that the stated reaction is seen to its end.
    pub(super) repair: fn(&mut Scene),
    pub(super) debounce: Seconds,
    pub(super) period: Seconds,
}

impl Case {
    fn new(code: FaultCode, how: &'static str, reaction: Reaction, start: Start) -> Self {
        Self {
            code,
            how,
            reaction,
            falls: reaction.latches(),
            along: FaultSet::NONE,
            start,
            prepare: |_| (),
            stalls: 0,
            provoke: |_| (),
            begun: |_| true,
            repair: |_| (),
            debounce: |_| 0.0,
            period: regulator,
        }
    }

    fn provoked(self, provoke: fn(&mut Scene)) -> Self {
        Self { provoke, ..self }
    }

    fn within(self, debounce: Seconds, period: Seconds) -> Self {
        Self { debounce, period, ..self }
    }

    fn from(self, begun: fn(&mut Scene) -> bool) -> Self {
        Self { begun, ..self }
    }

    fn repaired(self, repair: fn(&mut Scene)) -> Self {
        Self { repair, ..self }
    }

    fn on(self, prepare: fn(&mut Rig)) -> Self {
        Self { prepare, ..self }
    }

    fn after_stalls(self, stalls: u32) -> Self {
        Self { stalls, ..self }
    }

    fn along(self, code: FaultCode) -> Self {
        let mut along = self.along;
        along.insert(code);
        Self { along, ..self }
    }
}

fn regulator(rig: &Rig) -> f64 {
    rig.control.frees[0].regulator.period.as_secs_f64()
}

fn imu(rig: &Rig) -> f64 {
    rig.control.frees[0].imu.map_or(0.0, |imu| imu.period.as_secs_f64())
}

fn tick(rig: &Rig) -> f64 {
    rig.control.period.as_secs_f64()
}

fn nothing(_: &Rig) -> f64 {
    0.0
}

/// Room to turn, for what is about pressure.
fn turns_far(rig: &mut Rig) {
    for free in &mut rig.control.frees {
        (free.limits.angle_soft, free.limits.angle_hard) = ((-7.0, 7.0), (-8.0, 8.0));
    }
}

/// Nothing exhausts but the regulators themselves.
fn without_dump_valve(rig: &mut Rig) {
    (rig.control.dump_valve, rig.bench.dump_valve) = (false, false);
}

/// The line and the Alicat unit of the first FREE; none where it has another regulator.
fn unit(rig: &Rig) -> Option<(usize, &SerialWiring, &UnitWiring)> {
    let lines = rig.wiring.serial.iter().enumerate();
    lines
        .flat_map(|(i, line)| line.units.iter().map(move |unit| (i, line, unit)))
        .find(|(.., unit)| unit.free == 0 && !unit.gauge)
}

/// Does something to the first FREE's unit.
fn with_unit(scene: &mut Scene, act: impl FnOnce(&mut AlicatChip)) {
    let Some((index, id)) = unit(&scene.rig).map(|(index, _, unit)| (index, unit.id)) else { return };
    if let Some(line) = scene.bench.sim().line(index)
        && let Some(unit) = lock(line).unit(id)
    {
        act(unit);
    }
}

fn plug(scene: &Scene, plugged: bool) {
    if let Some(line) = unit(&scene.rig).and_then(|(index, ..)| scene.bench.sim().line(index)) {
        lock(line).plug(plugged);
    }
}

fn regulator_is(scene: &Scene, how: Misbehaviour) {
    if let Some(chip) = scene.bench.sim().regulator(0) {
        chip.always(how);
    }
}

fn imu_is(scene: &Scene, how: Misbehaviour) {
    if let Some(chip) = scene.bench.sim().imu(0) {
        chip.always(how);
    }
}

/// Soft and hard limit of the first FREE's angle, rad, in its own direction.
fn envelope(rig: &Rig) -> (f64, f64) {
    let free = &rig.control.frees[0];
    let far = |(low, high): (f64, f64)| if free.free.direction() > 0.0 { high } else { -low };
    (far(free.limits.angle_soft), far(free.limits.angle_hard))
}

/// Has a load turn the first FREE to the angle that `to` makes of its soft and its hard limit.
fn turn_to(scene: &mut Scene, to: fn(f64, f64) -> f64) {
    let (soft, hard) = envelope(&scene.rig);
    scene.turn(to(soft, hard) - scene.shown_angle());
}

/// Every case that this rig can be drilled in, in the order of the faults' numbers. The study needs the first FREE to
/// have an IMU and an Alicat unit; without them there is no case.
pub fn cases(rig: &Rig) -> Vec<Case> {
    use FaultCode as F;
    use Reaction::{Hold, Ramp, Vent, Warn};
    let drilled = unit(rig).is_some() && rig.control.frees.first().is_some_and(|free| free.imu.is_some());
    if !drilled {
        return Vec::new();
    }
    let (press, little, turn) = (Start::Press(0.5), Start::Press(0.2), Start::Turn(0.5));
    let mut cases = vec![
        Case::new(F::OverpressureHard, "the regulator's valve sticks open", Vent, press)
            .on(turns_far)
            .provoked(|s| s.inject(PlantFault::Valve(0, Valve::StuckOpen)))
            .from(|s| s.truth(0).pressure > s.rig.control.frees[0].limits.pressure_hard)
            .within(regulator, regulator),
        Case::new(F::OverpressureSoft, "the valve sticks open under a supply between warn and hard", Ramp, press)
            .on(turns_far)
            .provoked(|s| {
                let limits = s.rig.control.frees[0].limits;
                s.inject(PlantFault::Supply(0.5 * (limits.pressure_warn + limits.pressure_hard)));
                s.inject(PlantFault::Valve(0, Valve::StuckOpen));
            })
            .from(|s| s.truth(0).pressure > s.rig.control.frees[0].limits.pressure_warn)
            .repaired(|s| s.inject(PlantFault::Valve(0, Valve::Working)))
            .within(|_| interlocks::SOFT_DEBOUNCE, regulator),
        Case::new(F::PressureSensorRange, "the unit says POV", Vent, turn)
            .provoked(|s| with_unit(s, |unit| unit.tokens = "POV".into()))
            .within(|rig| f64::from(interlocks::SAMPLES_DEBOUNCE) * regulator(rig), regulator),
        Case::new(F::PressureStale, "the unit loses its power", Vent, turn)
            .provoked(|s| regulator_is(s, Misbehaviour::Silent))
            .within(|rig| interlocks::STALE_PERIODS * regulator(rig), regulator),
        Case::new(F::PressureNotFollowing, "the FREE bursts", Vent, press)
            .on(turns_far)
            .provoked(|s| s.inject(PlantFault::Leak(0, 0.01)))
            .from(|s| {
                let free = &s.rig.control.frees[0];
                let tolerance = interlocks::follow_tolerance(&free.regulator);
                s.truth(0).pressure < 0.5 * free.limits.pressure_max - tolerance
            })
            .within(|_| interlocks::FOLLOW_BUDGET, regulator),
        Case::new(F::SupplyLow, "the supply falls, and its pressure switch opens", Ramp, turn)
            .on(|rig| {
                let lines =
                    GpioWiring { chip: "sim".into(), dump_valve: None, heartbeat: None, estop: None, supply: Some(0) };
                rig.wiring.gpio.get_or_insert(lines).supply.get_or_insert(u32::MAX);
            })
            .provoked(|s| {
                let highest = s.rig.control.frees.iter().map(|free| free.limits.pressure_max).fold(0.0, f64::max);
                s.inject(PlantFault::Supply(highest));
            })
            .within(|_| interlocks::SUPPLY_DEBOUNCE, |_| 2.0 * gpio::LOOK.as_secs_f64()),
        Case::new(F::ImuStale, "the IMU does not acknowledge", Hold, turn)
            .provoked(|s| imu_is(s, Misbehaviour::Nak))
            .within(|rig| interlocks::STALE_PERIODS * imu(rig), imu),
        Case::new(F::ImuStale, "and goes on like that", Ramp, turn)
            .provoked(|s| imu_is(s, Misbehaviour::Nak))
            .repaired(|s| imu_is(s, Misbehaviour::None))
            .within(|_| interlocks::IMU_RAMP_AGE, imu),
        Case::new(F::ImuImplausible, "the IMU answers with random bytes", Hold, turn)
            .provoked(|s| imu_is(s, Misbehaviour::Garbage))
            .within(|rig| f64::from(interlocks::SAMPLES_DEBOUNCE) * imu(rig), imu),
        Case::new(F::ImuImplausible, "and goes on like that", Ramp, turn)
            .provoked(|s| imu_is(s, Misbehaviour::Garbage))
            .repaired(|s| imu_is(s, Misbehaviour::None))
            .within(|_| interlocks::IMU_RAMP_AGE, imu),
        Case::new(F::AngleLimit, "a hand turns the end beyond the soft envelope", Ramp, little)
            .provoked(|s| turn_to(s, |soft, hard| 0.5 * (soft + hard)))
            .from(|s| s.shown_angle() > envelope(&s.rig).0)
            .repaired(|s| s.turn(0.0))
            .within(imu, imu),
        Case::new(F::AngleLimit, "and beyond the hard one", Vent, little)
            .provoked(|s| turn_to(s, |soft, hard| 2.0 * hard - soft))
            .from(|s| s.shown_angle() > envelope(&s.rig).1)
            .repaired(|s| s.turn(0.0))
            .within(imu, imu),
        Case::new(F::Deadline, "five ticks come late", Warn, turn)
            .after_stalls(interlocks::LATE_WARN - 1)
            .provoked(Scene::late)
            .within(tick, tick),
        Case::new(F::Deadline, "twenty ticks come late", Ramp, turn)
            .after_stalls(interlocks::LATE_RAMP - 1)
            .provoked(Scene::late)
            .within(tick, tick),
        Case::new(F::ClientLost, "the client is gone", Ramp, turn)
            .provoked(|s| s.heart = false)
            .within(|_| interlocks::HEARTBEAT_MAX, nothing),
        Case::new(F::RegulatorStatus, "the unit says OPL", Ramp, turn)
            .provoked(|s| with_unit(s, |unit| unit.tokens = "OPL".into()))
            .repaired(|s| with_unit(s, |unit| unit.tokens.clear()))
            .within(regulator, regulator),
        Case::new(F::BusLost, "the serial line is unplugged", Vent, turn).provoked(|s| plug(s, false)),
        Case::new(F::BusLost, "the IMU is unplugged: after the ladder's second", Vent, turn)
            .provoked(|s| imu_is(s, Misbehaviour::Silent))
            .along(F::ImuStale)
            .within(|_| IMU_LOST_AFTER.as_secs_f64(), imu),
        Case::new(F::ConfigChanged, "rig.toml is edited", Warn, turn)
            .provoked(|s| s.bench.switches().config_changed.store(true, Ordering::Relaxed))
            .within(nothing, tick),
        Case::new(F::RealtimeLost, "the loop loses its rights", Warn, turn)
            .on(|rig| rig.control.require_realtime = true)
            .provoked(|s| s.bench.switches().realtime.store(false, Ordering::Relaxed))
            .within(nothing, tick),
        Case {
            falls: false,
            ..Case::new(F::VentFailed, "no dump valve, and the line is unplugged: from the vent on", Vent, turn)
                .on(without_dump_valve)
                .provoked(|s| plug(s, false))
                .from(|s| s.bench.latest().vent)
                .along(F::BusLost)
                .along(F::PressureStale)
                .within(|rig| rig.control.vent_time.as_secs_f64(), nothing)
        },
        Case::new(F::EmergencyStop, "the stop is pressed", Vent, turn)
            .provoked(|s| s.bench.switches().estop.store(true, Ordering::Release))
            .within(nothing, tick),
    ];
    if rig.control.frees[0].limits.tracking_error.0.is_finite() {
        let lost = Case::new(F::TrackingError, "a hand turns the end away from its reference", Ramp, Start::Turn(0.1))
            .provoked(|s| s.turn(1.5 * s.rig.control.frees[0].limits.tracking_error.0))
            .from(|s| {
                let free = &s.rig.control.frees[0];
                let reference = s.bench.latest().frees[0].reference.position * free.free.direction();
                s.shown_angle() - reference > free.limits.tracking_error.0
            })
            .repaired(|s| s.turn(0.0))
            .within(|rig| rig.control.frees[0].limits.tracking_error.1, imu);
        cases.push(lost);
    }
    cases.sort_by_key(|case| case.code as u8);
    cases
}

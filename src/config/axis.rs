//! What an experiment file asks of one FREE.

use super::experiment::Kind;
use super::knob::Temperatures;
use super::reader::Section;
use super::rig::Rig;
use crate::control::FreeControl;
use crate::signal::Quantity;
use crate::trajectory::{Axis, Sequence, Shape};
use crate::units::{Angle, Pressure};

/// Longest duration of a piece, s: a day.
const LONGEST: f64 = 86_400.0;
/// Shortest duration of a piece, s.
const SHORTEST: f64 = 1e-3;
/// A time, s, that breaks no rule about rates.
const UNHURRIED: f64 = 100.0;
/// Widest range of a number that the FREE's limits judge.
const ANY: std::ops::RangeInclusive<f64> = -1e6..=1e6;

const SHAPES: [(&str, Shape); 4] =
    [("step", Shape::Step), ("linear", Shape::Linear), ("cubic", Shape::Cubic), ("quintic", Shape::Quintic)];

/// Reads what `section` asks of its FREE, or of the one called `free`; nothing where it asks for nothing sensible
/// (which has been noted).
pub(super) fn read_axis(section: &mut Section<'_>, kind: Kind, rig: &Rig, free: Option<&str>) -> Option<(usize, Axis)> {
    let index = read_free(section, rig, free);
    let knob = index.map(|index| Turned { name: &rig.control.frees[index].name, sets: rig.temperatures(index) });
    let given = ["angles_deg", "pressures_psi", "temperatures_degc", "segments"];
    given.iter().for_each(|key| section.expect(key));
    let present: Vec<&str> = given.into_iter().filter(|key| section.has(key)).collect();
    let axis = match present.as_slice() {
        ["segments"] => read_segments(section, knob),
        [_] => read_course(section, kind, knob),
        [] => {
            section.require(if kind == Kind::Sweep { "pressures_psi" } else { "angles_deg" }, "the values to visit");
            ["shape", "move_s", "hold_s", "and_back"].iter().for_each(|key| section.expect(key));
            None
        }
        [first, second, ..] => {
            section.reject(second, format!("contradicts `{first}`"), format!("keep one of {}", present.join(", ")));
            section.accept_rest();
            None
        }
    };
    let (index, axis) = (index?, axis?);
    check_limits(section, &rig.control.frees[index], &axis, present.first().copied().unwrap_or_default());
    Some((index, axis))
}

/// The FREE that an axis is about, and what its knob sets.
#[derive(Clone, Copy)]
struct Turned<'r> {
    name: &'r str,
    sets: Option<&'r Temperatures>,
}

impl Turned<'_> {
    /// The angle, rad, that sets `temperature`, degrees Celsius, the value of `key`; none where there is none, which is
    /// noted.
    fn angle(&self, section: &Section<'_>, key: &str, temperature: f64) -> Option<f64> {
        let Some(table) = self.sets else {
            let rule = format!("`{}` has no knob that sets temperatures", self.name);
            section.reject(key, rule, "ask for angles, or write the knob's table into [free.knob] of rig.toml");
            return None;
        };
        let remedy = "keep within the knob's table";
        table.angle_of(temperature, self.name).map_err(|rule| section.reject(key, rule, remedy)).ok()
    }
}

/// The FREE it is about.
fn read_free(section: &mut Section<'_>, rig: &Rig, free: Option<&str>) -> Option<usize> {
    let written = section.optional_text("free");
    let known = rig.free_names().collect::<Vec<_>>().join(", ");
    match written.as_deref().or(free) {
        Some(name) => {
            let index = rig.free(name);
            if index.is_none() {
                section.reject("free", format!("the rig has no FREE `{name}`"), format!("write one of: {known}"));
            }
            index
        }
        None if rig.control.frees.len() == 1 => Some(0),
        None => {
            section.reject(
                "free",
                "is required: the rig has several FREEs",
                format!("write `free = ...` or `--free NAME`: one of {known}"),
            );
            None
        }
    }
}

/// Values to visit, one after the other, with holds.
fn read_course(section: &mut Section<'_>, kind: Kind, knob: Option<Turned<'_>>) -> Option<Axis> {
    let (default_shape, default_move) = match kind {
        Kind::Step => (Shape::Step, Some(0.0)),
        Kind::Trajectory => (Shape::Cubic, None),
        Kind::Sweep | Kind::Whisk => (Shape::Linear, Some(1.0)),
    };
    let angles = section.numbers("angles_deg", ANY);
    let pressures = section.numbers("pressures_psi", ANY);
    let temperatures = section.numbers("temperatures_degc", ANY);
    let shape = section.choice("shape", Some(default_shape), &SHAPES).unwrap_or(default_shape);
    let default_move = if shape == Shape::Step { Some(0.0) } else { default_move };
    let moving = section.number("move_s", default_move, 0.0..=LONGEST);
    let hold = section.number("hold_s", None, 0.0..=LONGEST);
    let and_back = section.flag("and_back", kind == Kind::Sweep);
    let (quantity, key, mut values) = match (angles, pressures, temperatures) {
        (Some(angles), ..) => (Quantity::Angle, "angles_deg", angles),
        (None, Some(pressures), _) => (Quantity::Pressure, "pressures_psi", pressures),
        (None, None, Some(temperatures)) => {
            let (knob, key) = (knob?, "temperatures_degc");
            let angles = temperatures.into_iter().map(|t| knob.angle(section, key, t)).collect::<Option<_>>()?;
            (Quantity::Angle, key, angles)
        }
        (None, None, None) => return None,
    };
    if values.is_empty() {
        section.reject(key, "is empty", format!("write the values to visit, for example `{key} = [1, 2]`"));
        return None;
    }
    // A time that is missing or wrong has been told; the values are looked at all the same, with one that fits.
    let moving = match shape {
        _ if moving.is_finite() => moving,
        Shape::Step => 0.0,
        _ => UNHURRIED,
    };
    let hold = if hold.is_finite() { hold } else { UNHURRIED };
    if shape == Shape::Step && moving > 0.0 {
        section.reject("move_s", "a step takes no time", "remove it, or write another shape: linear, cubic, quintic");
        return None;
    }
    if shape != Shape::Step && moving < SHORTEST {
        section.reject(
            "move_s",
            "a movement takes time",
            "write a time, for example `move_s = 1.5`, or `shape = \"step\"`",
        );
        return None;
    }
    if shape == Shape::Step && hold < SHORTEST {
        section.reject("hold_s", "a step is held for some time", "write a time, for example `hold_s = 3`");
        return None;
    }
    if and_back {
        let back: Vec<f64> = values.iter().rev().skip(1).copied().collect();
        values.extend(back);
    }
    let mut builder = Sequence::starting_at(0.0);
    for value in values {
        builder = match shape {
            Shape::Step => builder.step(value, hold),
            _ => builder.then(shape, value, moving),
        };
        if shape != Shape::Step && hold > 0.0 {
            builder = builder.hold(hold);
        }
    }
    finish(section, key, quantity, builder.build())
}

/// Piece by piece, from zero on.
fn read_segments(section: &mut Section<'_>, knob: Option<Turned<'_>>) -> Option<Axis> {
    let mut quantity = None;
    let mut builder = Sequence::starting_at(0.0);
    let mut complete = true;
    for mut segment in section.sections("segments") {
        let Some((of, shape, to, duration)) = read_segment(&mut segment, knob) else {
            complete = false;
            continue;
        };
        if let (Some(one), Some(other)) = (quantity, of)
            && one != other
        {
            segment.reject("duration_s", "mixes angles and pressures", "use one of the two in all segments of an axis");
            complete = false;
        }
        quantity = quantity.or(of);
        builder = match shape {
            Some(shape) => builder.then(shape, to, duration),
            None => builder.hold(duration),
        };
    }
    if !complete {
        return None;
    }
    let Some(quantity) = quantity else {
        section.reject(
            "segments",
            "asks for no angle and no pressure",
            "write for example `{ to_deg = 40, duration_s = 1.5 }`",
        );
        return None;
    };
    finish(section, "segments", quantity, builder.build())
}

/// Quantity (none for a hold), shape (none for a hold), end and duration of one segment.
fn read_segment(
    segment: &mut Section<'_>,
    knob: Option<Turned<'_>>,
) -> Option<(Option<Quantity>, Option<Shape>, f64, f64)> {
    if let Some(hold) = segment.optional_number("hold_s", SHORTEST..=LONGEST) {
        return Some((None, None, 0.0, hold));
    }
    let duration = segment.number("duration_s", None, SHORTEST..=LONGEST);
    let to = [("to_deg", Quantity::Angle), ("to_psi", Quantity::Pressure)]
        .map(|(key, quantity)| segment.optional_number(key, ANY).map(|value| (quantity, value)));
    let hot = match segment.optional_number("to_degc", ANY) {
        Some(temperature) => Some((Quantity::Angle, knob?.angle(segment, "to_degc", temperature)?)),
        None => None,
    };
    let amplitude = [("amplitude_deg", Quantity::Angle), ("amplitude_psi", Quantity::Pressure)]
        .map(|(key, quantity)| segment.optional_number(key, 0.0..=1e6).map(|value| (quantity, value)));
    let shape = segment.choice("shape", Some(Shape::Cubic), &SHAPES)?;
    let frequency = segment.optional_number("frequency_hz", 1e-4..=100.0);
    let phase = segment.number("phase_deg", 0.0, -360.0..=360.0);
    let to = to.into_iter().chain([hot]).flatten().next();
    let amplitude = amplitude.into_iter().flatten().next();
    if !duration.is_finite() {
        return None;
    }
    match (to, amplitude, frequency) {
        (Some((quantity, to)), None, None) => Some((Some(quantity), Some(shape), to, duration)),
        (None, Some((quantity, amplitude)), Some(frequency)) => {
            Some((Some(quantity), Some(Shape::Sinusoid { amplitude, frequency, phase }), 0.0, duration))
        }
        _ => {
            segment.reject(
                "duration_s",
                "a segment goes to a value, or swings",
                "write `to_deg` (or `to_psi`, or `to_degc`), or `amplitude_deg` (or `amplitude_psi`) with `frequency_hz`, or `hold_s` alone",
            );
            None
        }
    }
}

fn finish(
    section: &Section<'_>,
    key: &str,
    quantity: Quantity,
    sequence: Result<Sequence, crate::trajectory::SequenceError>,
) -> Option<Axis> {
    match sequence {
        Ok(sequence) => Some(Axis { quantity, sequence }),
        Err(error) => {
            section.reject(key, error.to_string(), "correct the values or the times");
            None
        }
    }
}

/// What is asked must be within what the FREE may do.
pub(super) fn check_limits(section: &Section<'_>, free: &FreeControl, axis: &Axis, key: &str) {
    let (low, high) = axis.sequence.range();
    match axis.quantity {
        Quantity::Pressure => {
            let max = Pressure::pascals(free.limits.pressure_max);
            // The conversion from psi and back leaves some noise in the last digit.
            if low < 0.0 || high > max.si() * (1.0 + 1e-12) {
                let (low, high) = (Pressure::pascals(low), Pressure::pascals(high));
                section.reject(
                    key,
                    format!("goes from {low:.2} to {high:.2}; `{}` takes 0 to {max:.2}", free.name),
                    "keep within the FREE's limits",
                );
            }
        }
        Quantity::Angle => {
            let (lowest, highest) = free.limits.angle_soft;
            if low < lowest || high > highest {
                let [low, high, lowest, highest] = [low, high, lowest, highest].map(Angle::radians);
                section.reject(
                    key,
                    format!(
                        "goes from {low:.1} to {high:.1}; the soft envelope of `{}` is {lowest:.1} to {highest:.1}",
                        free.name
                    ),
                    "keep within the envelope, or widen it in rig.toml",
                );
            }
            if !free.controls_angle() {
                let why = if free.imu.is_none() { "has no IMU" } else { "turns with its module's plate" };
                section.reject(
                    key,
                    format!("`{}` {why}: its angle cannot be controlled", free.name),
                    "ask for pressures, or name a FREE with an IMU of its own",
                );
            }
        }
        Quantity::None => {}
    }
}

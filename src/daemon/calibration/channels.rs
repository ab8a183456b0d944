//! Which channel of a DAC feeds which FREE: measured, never assumed.
//!
//! The channels are raised gently, one after another, and it is watched which FREE answers: by its pressure where it is
//! measured, else by its turning, as the pressure that its model needs for it. A map that differs from rig.toml's is
//! refused with what to change there: a pressure that goes to another FREE than the one that is watched is no matter
//! of a fit.

use std::fmt::Write as _;

use super::CalibrationError;
use super::stiffness::highest_pressure;
use crate::config::Rig;
use crate::ident::regulator::{ChannelMap, Trial, map_channels};
use crate::model::{Kinematics, Law, Lumped};
use crate::record::Run;
use crate::units::PASCAL_PER_PSI;

/// Name of the experiment.
pub const NAME: &str = "calibrate regulator: channels";

/// To get to a pressure, to stay there, and the end of that which counts as rest, s.
const MOVE: f64 = 1.0;
const HOLD: f64 = 2.0;
const REST: f64 = 0.8;
/// A channel is raised to where the model expects this turn, rad ...
const TURN: f64 = 0.14;
/// ... or to this share of the highest pressure, whichever is lower.
const SHARE: f64 = 0.3;
/// What answers with less than this share of the pressure does not hang on the channel.
const ANSWER: f64 = 0.3;

/// A channel of a DAC, or a PWM output, that rig.toml names, and its FREE.
#[derive(Clone, Debug, PartialEq)]
pub struct Wired {
    /// Index of the FREE.
    pub free: usize,
    /// Its name.
    pub name: String,
    /// `channel B of 0x60 on main`, `pwm B on line`.
    pub channel: String,
    /// What rig.toml says of it: `channel = "B"`, `unit = "B"`.
    pub key: String,
}

/// The FREEs of `rig` that hang on DACs and PWM outputs, in their order.
pub fn wired(rig: &Rig) -> Vec<Wired> {
    let mut wired = Vec::new();
    for bus in &rig.wiring.i2c {
        for dac in &bus.dacs {
            for (letter, channel) in ('A'..='D').zip(dac.channels) {
                let Some(channel) = channel else { continue };
                wired.push(Wired {
                    free: channel.free,
                    name: rig.control.frees[channel.free].name.clone(),
                    channel: format!("channel {letter} of {:#04x} on {}", dac.address, bus.name),
                    key: format!("channel = \"{letter}\""),
                });
            }
        }
    }
    for line in &rig.wiring.serial {
        wired.extend(line.pwms.iter().map(|pwm| Wired {
            free: pwm.channel.free,
            name: rig.control.frees[pwm.channel.free].name.clone(),
            channel: format!("pwm {} on {}", char::from(pwm.id), line.name),
            key: format!("unit = \"{}\"", char::from(pwm.id)),
        }));
    }
    wired.sort_by_key(|w| w.free);
    wired
}

/// What each channel is raised to, Pa.
fn pressures(rig: &Rig, wired: &[Wired]) -> Result<Vec<f64>, CalibrationError> {
    let one = |w: &Wired| {
        let free = &rig.control.frees[w.free];
        if free.imu.is_none() && !free.regulator.measures {
            let reason =
                "it has neither an IMU nor a pressure sensor: nothing would show that its channel is the right one";
            return Err(CalibrationError::Range { free: w.name.clone(), reason: reason.into() });
        }
        let turned = Lumped::new(free.free, Law::Nonlinear(Kinematics::Exact))?;
        let turned = turned.static_pressure(free.free.direction() * TURN).unwrap_or(f64::INFINITY);
        Ok(turned.min(SHARE * highest_pressure(rig, w.free)?))
    };
    wired.iter().map(one).collect()
}

/// The experiment for the channels of `rig`, as the text of an experiment file: all at zero, each in its turn, all at
/// zero.
///
/// # Errors
/// Where a FREE cannot be taken to a pressure, or nothing would be seen of it.
pub fn experiment(rig: &Rig) -> Result<String, CalibrationError> {
    let wired = wired(rig);
    let pressures = pressures(rig, &wired)?;
    let mut text = format!("kind = \"sweep\"\nname = \"{NAME}\"\n");
    for (own, (w, pressure)) in wired.iter().zip(pressures).enumerate() {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "[[axis]]\nfree = \"{}\"\nsegments = [", w.name);
        for trial in 0..wired.len() + 2 {
            let psi = if trial == own + 1 { pressure / PASCAL_PER_PSI } else { 0.0 };
            let _ = writeln!(text, "    {{ to_psi = {psi:?}, shape = \"linear\", duration_s = {MOVE:?} }},");
            let _ = writeln!(text, "    {{ hold_s = {HOLD:?} }},");
        }
        text.push_str("]\n");
    }
    Ok(text)
}

/// The map that `run`, an [`experiment`] with `rig`, shows, as a sentence.
///
/// # Errors
/// Where there is no map, or not the one of rig.toml.
pub fn evaluate(rig: &Rig, run: &Run) -> Result<String, CalibrationError> {
    let wired = wired(rig);
    let raised = pressures(rig, &wired)?;
    let unfit = |reason: String| CalibrationError::Regulator { run: run.id().to_owned(), reason };
    let span = |trial: usize| {
        let end = (trial + 1) as f64 * (MOVE + HOLD);
        (end - REST, end)
    };
    let spans: Vec<_> = (0..wired.len() + 2).map(span).collect();
    let mut trials: Vec<Trial> = (0..spans.len())
        .map(|trial| Trial {
            commands: (0..wired.len()).map(|own| if trial == own + 1 { raised[own] } else { 0.0 }).collect(),
            pressures: Vec::new(),
        })
        .collect();
    for w in &wired {
        let free = &rig.control.frees[w.free];
        let at_rest = Lumped::new(free.free, Law::Linear)?.actuation(0.0, 0.0);
        let per_rad = at_rest.map_or(f64::NAN, |a| free.free.torsional_stiffness / a.moment);
        for (trial, rest) in trials.iter_mut().zip(run.rests(w.free, &spans)?) {
            let answer =
                rest.map_or(f64::NAN, |r| if free.regulator.measures { r.pressure } else { r.angle * per_rad });
            trial.pressures.push(answer);
        }
    }
    let least = ANSWER * raised.iter().copied().fold(f64::INFINITY, f64::min);
    let legend = || {
        let each = wired.iter().enumerate().map(|(i, w)| format!("{i} is `{}` with {}", w.name, w.channel));
        each.collect::<Vec<_>>().join(", ")
    };
    let map = map_channels(&trials, least).map_err(|error| {
        unfit(format!(
            "{error}. Here {}. Look at the tubes, the regulators' supply and cables, and at `channel` or `unit` in rig.toml",
            legend()
        ))
    })?;
    compare(&wired, &map).map_err(|reason| CalibrationError::Map { run: run.id().to_owned(), reason })?;
    let each = wired.iter().map(|w| format!("{} feeds `{}`", w.channel, w.name)).collect::<Vec<_>>().join(", ");
    Ok(format!("measured, as rig.toml says: {each}; crosstalk {:.1} %", 100.0 * map.crosstalk))
}

/// Whether the map is rig.toml's; else what to change.
fn compare(wired: &[Wired], map: &ChannelMap) -> Result<(), String> {
    let wrong = map.channels.iter().enumerate().filter(|(pressure, channel)| pressure != *channel);
    let change = |(pressure, channel): (usize, &usize)| {
        let (free, really) = (&wired[pressure], &wired[*channel]);
        format!("`{}` is fed by {}, not by {}: write `{}` for it", free.name, really.channel, free.channel, really.key)
    };
    let changes: Vec<_> = wrong.map(change).collect();
    if changes.is_empty() { Ok(()) } else { Err(changes.join("; ")) }
}

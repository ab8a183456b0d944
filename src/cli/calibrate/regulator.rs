//! `freerig calibrate regulator`: of a unit that measures its pressure, dynamics and soundness; of an analogue
//! regulator behind a DAC or a PWM output, its channel, zero and span.

use anyhow::{Context as _, anyhow};
use jiff::Zoned;

use super::{How, ask, confirm, failure, loads, measure, prepare, tell};
use crate::cli::{Context, Failure, attend, control};
use crate::config::{Rig, Script};
use crate::daemon::calibration::{Finding, channels, gauge, regulator, stiffness};
use crate::record::Run;
use crate::sim::Person;
use crate::units::{PASCAL_PER_PSI, Pressure};

pub(super) fn run(how: &How, context: &Context) -> Result<(), Failure> {
    let (rig, index) = prepare(how, context)?;
    let (finding, run) = find(how, &rig, index, context)?;
    tell(&finding, &rig, index, &run, context)
}

pub(super) fn find(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<(Finding, Run), Failure> {
    if gauge::channel(rig, index).is_some() {
        return behind_a_dac(how, rig, index, context);
    }
    let highest = stiffness::highest_pressure(rig, index).map_err(failure)?;
    let instruction = format!(
        "The FREE is on its regulator and hangs free. Its pressure will jump up to {:.2} for half a minute; nobody is near \
         it without eye protection.",
        Pressure::pascals(highest)
    );
    confirm(how, rig, "regulator", &instruction, context)?;
    let text = regulator::experiment(rig, index).map_err(failure)?;
    let run = measure(how, rig, index, &text, context)?;
    let today = Zoned::now().date().to_string();
    Ok((regulator::evaluate(rig, index, &run, &today).map_err(failure)?, run))
}

fn behind_a_dac(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<(Finding, Run), Failure> {
    let highest = stiffness::highest_pressure(rig, index).map_err(failure)?;
    let instruction = format!(
        "Every FREE behind a DAC or a PWM output is on its regulator and hangs free, and a gauge is on the line of `{}`. The channels \
         will be raised a little one after another, then this one in steps up to {:.2}, as far as its present zero and \
         span are right; nobody is near without eye protection.",
        rig.control.frees[index].name,
        Pressure::pascals(highest)
    );
    confirm(how, rig, "regulator", &instruction, context)?;
    let text = channels::experiment(rig).map_err(failure)?;
    let mapped = measure(how, rig, index, &text, context)?;
    let map = channels::evaluate(rig, &mapped).map_err(failure)?;
    context.note(&map);
    let (run, readings) = read(how, rig, index, mapped, context)?;
    let today = Zoned::now().date().to_string();
    Ok((gauge::evaluate(rig, index, &readings, &map, &run, &today).map_err(failure)?, run))
}

/// The gauge's readings at every step, and the run that they belong to: from the script, by the simulated person, or by
/// a person at the terminal.
fn read(how: &How, rig: &Rig, index: usize, mapped: Run, context: &Context) -> Result<(Run, Vec<f64>), Failure> {
    let script = how.script.as_deref().map(Script::read).transpose()?;
    if let Some(readings) = script.and_then(|script| script.gauge) {
        return Ok((mapped, readings));
    }
    if rig.is_simulated() {
        context.note("SIMULATED: a simulated person reads the gauge, with an error of 0.03 psi");
        let text = gauge::experiment(rig, index).map_err(failure)?;
        let run = measure(how, rig, index, &text, context)?;
        let mut person = Person::new(rig.bench.seed);
        let rests = run.rests(index, &gauge::spans())?.into_iter();
        let readings = rests.map(|rest| Some(person.pressure(rest?.truth?.pressure))).collect::<Option<_>>();
        let readings = readings.with_context(|| format!("the run {} lacks records", run.id()))?;
        return Ok((run, readings));
    }
    if !ask::somebody() {
        let error = anyhow!("somebody must read the gauge, and there is no terminal");
        return Err(
            Failure::usage(error).remedy("run it in a terminal, or write its readings into the script: `gauge_psi`")
        );
    }
    let readings = by_hand(rig, index, context);
    // However it ended, the pressure goes down.
    let down = attend::disarm(&rig.socket.path);
    let readings = readings?;
    down.map(|()| (mapped, readings))
}

fn by_hand(rig: &Rig, index: usize, context: &Context) -> Result<Vec<f64>, Failure> {
    let client = control::client(context)?;
    let free = &rig.control.frees[index];
    let mut readings = Vec::new();
    for pressure in gauge::pressures(rig, index).map_err(failure)? {
        loads::set(&client, &free.name, pressure)?;
        let read = PASCAL_PER_PSI * ask::number("What does the gauge read, in psi?", context)?;
        if read > free.limits.pressure_max {
            let (read, max) = (Pressure::pascals(read), Pressure::pascals(free.limits.pressure_max));
            let error = anyhow!("{read:.2} is above {max:.2}, the highest pressure of `{}`", free.name);
            return Err(Failure::failed(error).remedy(
                "the span in its calibration is too small: write what the gauge says per code, and start again",
            ));
        }
        readings.push(read);
    }
    Ok(readings)
}

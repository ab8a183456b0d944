//! What the model, with the hysteresis that is known, makes of the pressure that a run has measured.

use super::signals::{Signals, interpolate};
use crate::model::{Kinematics, Law, Load, Lumped, response};

/// Angle by the nonlinear lumped model (exact kinematics) from the recorded pressure, rad, one entry a record;
/// the reason in words where the model cannot say.
///
/// The measured pressure counts at the times of its own readings, linear between them; a FREE whose regulator
/// measures none is given the command.
pub fn dynamic(signals: &Signals) -> Result<Vec<f64>, String> {
    if signals.in_module {
        return Err("its end is on a module's plate, which the lumped model does not know".into());
    }
    let free = signals.free.ok_or("the run does not say what the FREE is")?;
    let measured = signals.pressure.iter().any(|p| p.is_finite());
    let (times, pressures) =
        if measured { (&signals.pressure_time, &signals.pressure) } else { (&signals.t, &signals.command) };
    let mut t: Vec<f64> = Vec::new();
    let mut p: Vec<f64> = Vec::new();
    for (&time, &pressure) in times.iter().zip(pressures) {
        if pressure.is_finite() && time.is_finite() && t.last().is_none_or(|&last| time > last + 1e-6) {
            t.push(time);
            p.push(pressure);
        }
    }
    let motion = response(&free, &signals.hysteresis, Kinematics::Exact, &t, &p).map_err(|e| e.to_string())?;
    let angles: Vec<f64> = motion.into_iter().map(|(_, phi)| phi).collect();
    // Where the pressure is not known the model has nothing to say.
    let known = |i: usize| !measured || signals.pressure.get(i).is_some_and(|p| p.is_finite());
    let at = |(i, &at): (usize, &f64)| if known(i) { interpolate(&t, &angles, at) } else { f64::NAN };
    Ok(signals.t.iter().enumerate().map(at).collect())
}

/// Angle at rest by the same model at equally spaced pressures from 0 to `highest` (Pa): (pressure, angle), Pa
/// and rad, as far as there is an equilibrium.
pub fn quasi_static(signals: &Signals, highest: f64) -> (Vec<f64>, Vec<f64>) {
    const POINTS: usize = 120;
    let Some(model) = signals.free.and_then(|f| Lumped::new(f, Law::Nonlinear(Kinematics::Exact)).ok()) else {
        return (Vec::new(), Vec::new());
    };
    (0..=POINTS)
        .map(|i| highest * i as f64 / POINTS as f64)
        .map_while(|p| Some((p, model.equilibrium_at_pressure(p, Load::default()).ok()?.rotation)))
        .unzip()
}

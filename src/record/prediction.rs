//! What the model, with the hysteresis that is known, makes of the pressure that a run has measured.

use super::signals::{Signals, interpolate};
use crate::model::{Kinematics, Law, Load, Lumped, response};

/// Angle by the nonlinear lumped model (exact kinematics) from the pressure that drives it, rad, one entry a record
/// that is kept; the reason in words where the model cannot say.
pub fn dynamic(signals: &Signals) -> Result<Vec<f64>, String> {
    if signals.in_module {
        return Err("its end is on a module's plate, which the lumped model does not know".into());
    }
    let free = signals.free.ok_or("the run does not say what the FREE is")?;
    let drive = &signals.drive;
    let motion = response(&free, &signals.hysteresis, Kinematics::Exact, &drive.t, &drive.pressure);
    let angles: Vec<f64> = motion.map_err(|e| e.to_string())?.into_iter().map(|(_, phi)| phi).collect();
    // Where the pressure is not known the model has nothing to say.
    let known = |pressure: &f64| !signals.measured || pressure.is_finite();
    let at = |(t, p): (&f64, &f64)| if known(p) { interpolate(&drive.t, &angles, *t) } else { f64::NAN };
    Ok(signals.t.iter().zip(&signals.pressure).map(at).collect())
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

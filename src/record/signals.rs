//! The signals of one FREE in a run, as the plots, the metrics and the comparison want them: SI units, and time
//! counted from the start of the program (of the run, where nothing was run).

use std::ops::Range;

use super::columns::column_name;
use super::document::{RunResult, StartDocument};
use super::run::Run;
use super::tube::TubeDocument;
use super::{RecordError, Result};
use crate::config::Temperatures;
use crate::model::{Free, Hysteresis};
use crate::signal::Quantity;

/// A reading of the pressure that is older counts as none, s: four periods of the slowest line there is.
const STALE: f64 = 0.256;

/// Signals of one FREE; every vector has one entry a record, not a number where there is no value.
#[derive(Clone, Debug, Default)]
pub struct Signals {
    /// Name of the FREE.
    pub name: String,
    /// Its model.
    pub free: Option<Free>,
    /// Its hysteresis, as far as it is known.
    pub hysteresis: Hysteresis,
    /// Whether its end is on a module's plate.
    pub in_module: bool,
    /// Its tube as finite elements see it.
    pub tube: Option<TubeDocument>,
    /// What its knob sets, where it turns one and that is known.
    pub temperatures: Option<Temperatures>,
    /// Time since the program's start, s; negative before it.
    pub t: Vec<f64>,
    /// Reference, rad; not a number where no angle was asked.
    pub reference: Vec<f64>,
    /// Reference, Pa; not a number where no pressure was asked.
    pub reference_pressure: Vec<f64>,
    /// Estimated angle, rad; not a number while the estimate is not valid.
    pub angle: Vec<f64>,
    /// True angle of the simulated rig, rad; empty for hardware.
    pub true_angle: Vec<f64>,
    /// Measured pressure, Pa; not a number where its reading is too old to count.
    pub pressure: Vec<f64>,
    /// Commanded pressure, Pa.
    pub command: Vec<f64>,
    /// Terms of the command, Pa: P, I, D, feedforward.
    pub terms: [Vec<f64>; 4],
    /// Time of the pressure reading that each record saw, s, as `t`.
    pub pressure_time: Vec<f64>,
    /// Bits of the limits in force.
    pub limits: Vec<f64>,
    /// Bits of the faults of this FREE.
    pub faults: Vec<f64>,
    /// The records while the program ran; all of them where there was no program.
    pub window: Range<usize>,
    /// What was asked of this FREE during the program.
    pub quantity: Quantity,
    /// Whether what came after the program is worth a look: the run did not end as it should.
    pub aftermath: bool,
}

impl Signals {
    /// Loads the signals of the FREE `name`.
    ///
    /// # Errors
    /// Where the samples cannot be read or hold no record of this FREE.
    pub fn load(run: &Run, name: &str) -> Result<Self> {
        let own = [
            "reference_rad",
            "reference_pa",
            "angle_rad",
            "estimate_valid",
            "true_angle_rad",
            "pressure_pa",
            "command_pa",
            "p_pa",
            "i_pa",
            "d_pa",
            "ff_pa",
            "pressure_time_ns",
            "limits",
            "faults",
        ];
        let mut columns: Vec<String> = own.iter().map(|c| column_name(name, c)).collect();
        columns.extend(["t_s", "time_ns", "program_time_s"].map(String::from));
        let table = run.table(&columns)?;
        let get = |column: &str| table.get(&column_name(name, column)).to_vec();
        let mut angle = get("angle_rad");
        if angle.is_empty() {
            let reason = format!("it holds no record of the FREE `{name}`");
            return Err(RecordError::NoSamples { path: run.folder.clone(), reason });
        }
        let (t, program) = (table.get("t_s"), table.get("program_time_s"));
        let running = |p: &f64| p.is_finite();
        let window = match (program.iter().position(running), program.iter().rposition(running)) {
            (Some(first), Some(last)) => first..last + 1,
            _ => 0..t.len(),
        };
        let zero = t
            .get(window.start)
            .map_or(0.0, |&t| t - program.get(window.start).map_or(0.0, |p| if p.is_finite() { *p } else { 0.0 }));
        // Whole nanoseconds of a year are beyond 53 bits; the difference of two near ones is not.
        let since = |own: f64, (record, t): (&f64, &f64)| t - zero - (record - own) * 1e-9;
        let records = table.get("time_ns").iter().zip(t);
        let pressure_time: Vec<f64> =
            get("pressure_time_ns").iter().zip(records).map(|(&own, record)| since(own, record)).collect();
        for (angle, valid) in angle.iter_mut().zip(get("estimate_valid")) {
            *angle = if valid == 0.0 { f64::NAN } else { *angle };
        }
        let mut pressure = get("pressure_pa");
        for ((pressure, read), t) in pressure.iter_mut().zip(&pressure_time).zip(t) {
            *pressure = if t - zero - read > STALE { f64::NAN } else { *pressure };
        }
        let document = run.start().frees.iter().find(|f| f.name == name);
        let mut signals = Self {
            name: name.into(),
            free: document.map(|f| f.model.into()),
            hysteresis: document.and_then(|f| f.hysteresis).map(Hysteresis::from).unwrap_or_default(),
            in_module: in_module(run.start(), name),
            tube: document.and_then(|f| f.tube),
            temperatures: document.and_then(|f| f.temperatures.as_ref()?.table()),
            t: t.iter().map(|t| t - zero).collect(),
            reference: get("reference_rad"),
            reference_pressure: get("reference_pa"),
            angle,
            true_angle: get("true_angle_rad"),
            pressure,
            command: get("command_pa"),
            terms: ["p_pa", "i_pa", "d_pa", "ff_pa"].map(get),
            pressure_time,
            limits: get("limits"),
            faults: get("faults"),
            window,
            quantity: Quantity::None,
            aftermath: run.stop().is_none_or(|s| s.result != RunResult::Done),
        };
        let asked = |values: &[f64]| values[signals.window.clone()].iter().any(|v| v.is_finite());
        signals.quantity = if asked(&signals.reference) {
            Quantity::Angle
        } else if asked(&signals.reference_pressure) {
            Quantity::Pressure
        } else {
            Quantity::None
        };
        Ok(signals)
    }

    /// The FREEs of `run` of which something was asked; all of them where nothing was.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn load_all(run: &Run) -> Result<Vec<Self>> {
        let mut all = run.names().iter().map(|n| Self::load(run, n)).collect::<Result<Vec<_>>>()?;
        if all.iter().any(|s| s.quantity != Quantity::None) {
            all.retain(|s| s.quantity != Quantity::None);
        }
        Ok(all)
    }

    /// reference - angle, rad, one entry a record.
    pub fn error(&self) -> Vec<f64> {
        self.reference.iter().zip(&self.angle).map(|(r, y)| r - y).collect()
    }

    /// Time since the program's start of the moment `t_s` since the run's first record, s.
    pub fn since_program(&self, t_s: f64) -> f64 {
        t_s + self.t.first().copied().unwrap_or(0.0)
    }

    /// The true angle within the window, where the rig was simulated.
    pub fn true_angle_in_window(&self) -> Option<&[f64]> {
        self.true_angle.get(self.window.clone()).filter(|w| w.iter().any(|v| v.is_finite()))
    }
}

/// Linear interpolation of `y` over increasing `x` at `at`; the ends hold; not a number where there are none.
pub fn interpolate(x: &[f64], y: &[f64], at: f64) -> f64 {
    let i = x.partition_point(|&v| v <= at);
    match (i, x.len().min(y.len())) {
        (_, 0) => f64::NAN,
        (0, _) => y[0],
        (i, n) if i >= n => y[n - 1],
        (i, _) => y[i - 1] + (y[i] - y[i - 1]) * (at - x[i - 1]) / (x[i] - x[i - 1]),
    }
}

fn in_module(start: &StartDocument, name: &str) -> bool {
    let index = start.frees.iter().position(|free| free.name == name);
    start.module.as_ref().zip(index).is_some_and(|(module, index)| module.frees.contains(&index))
}

//! The signals of one FREE in a run, as the plots, the metrics and the comparison want them: SI units, and time
//! counted from the start of the program (of the run, where nothing was run).

use std::ops::Range;

use super::document::{RunResult, StartDocument};
use super::drive::Drive;
use super::metrics::ErrorMetrics;
use super::run::Run;
use super::tube::TubeDocument;
use crate::config::Temperatures;
use crate::model::{Free, Hysteresis};
use crate::signal::Quantity;

/// Signals of one FREE; every vector has one entry a record that is kept, not a number where there is no value.
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
    /// True angle of the simulated rig, rad.
    pub true_angle: Vec<f64>,
    /// Measured pressure, Pa; not a number where its reading is too old to count.
    pub pressure: Vec<f64>,
    /// Commanded pressure, Pa.
    pub command: Vec<f64>,
    /// Terms of the command, Pa: P, I, D, feedforward.
    pub terms: [Vec<f64>; 4],
    /// What drives the model: the measured pressure at the times of its own readings, of a FREE whose regulator
    /// measures none the command; as `t`.
    pub drive: Drive,
    /// Whether that was measured.
    pub measured: bool,
    /// Errors of the angle while the program ran, of every record; none without an angle reference.
    pub error: Option<ErrorMetrics>,
    /// The same of the true angle of the simulated rig.
    pub true_error: Option<ErrorMetrics>,
    /// Range over every record while the program ran of the reference, where no angle was asked of the angle, rad.
    pub range: Option<f64>,
    /// Highest measured pressure of every record, Pa.
    pub highest_pressure: Option<f64>,
    /// The records while the program ran; all of them where there was no program.
    pub window: Range<usize>,
    /// What was asked of this FREE during the program.
    pub quantity: Quantity,
    /// Whether what came after the program is worth a look: the run did not end as it should.
    pub aftermath: bool,
}

impl Signals {
    /// The FREE `name` of `run`, without its signals.
    pub(super) fn named(run: &Run, name: &str) -> Self {
        let document = run.start().frees.iter().find(|f| f.name == name);
        Self {
            name: name.into(),
            free: document.map(|f| f.model.into()),
            hysteresis: document.and_then(|f| f.hysteresis).map(Hysteresis::from).unwrap_or_default(),
            in_module: in_module(run.start(), name),
            tube: document.and_then(|f| f.tube),
            temperatures: document.and_then(|f| f.temperatures.as_ref()?.table()),
            aftermath: run.stop().is_none_or(|s| s.result != RunResult::Done),
            ..Self::default()
        }
    }

    /// All that has one entry a record.
    pub(super) fn columns(&mut self) -> impl Iterator<Item = &mut Vec<f64>> {
        let Self { t, reference, reference_pressure, angle, true_angle, pressure, command, terms, .. } = self;
        [t, reference, reference_pressure, angle, true_angle, pressure, command].into_iter().chain(terms)
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

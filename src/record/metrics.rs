//! The figures of a run. Angles in rad, pressures in Pa, times in s; `None` where there is no such figure.
//!
//! | figure | definition |
//! | --- | --- |
//! | RMS, peak error | of reference - angle while the program runs |
//! | final error | mean over the last 0.1 s of the program |
//! | move | from one hold of the reference (at least 0.2 s) to the next; steps and smooth moves alike |
//! | overshoot | greatest excursion beyond the move's target, in the move's direction |
//! | settling time | from the move's start until the angle stays within 2 % of the move for the rest of the hold |
//! | steady error | mean error over the last fifth of the hold |
//! | RMSD to the model | RMS of angle - model over the range of the reference (of the angle in a sweep), and in rad |
//! | RMSD to the model at rest | in a sweep: RMS of angle - model at rest at the same pressure, over the range of the angle |
//! | hysteresis | greatest difference of the angle between the ways up and down of a cycle at one pressure, over its range; the mean over the cycles; at the ends of the holds, where a sweep has them |
//!
//! The angle is the estimate that the controller acts on; with the simulated rig the same figures of the true
//! angle stand beside.

use serde::Serialize;

use super::Result;
use super::document::ErrorDocument;
use super::module::{Apart, TipPath};
use super::prediction;
use super::recorded::Recorded;
use super::run::Run;
use super::signals::Signals;
use super::sweep::Loops;
use crate::signal::Quantity;

/// Share of a move within which the angle counts as settled.
const SETTLED: f64 = 0.02;
/// Shortest stand-still of the reference that counts as a hold, s.
pub(super) const SHORTEST_HOLD: f64 = 0.2;
/// Smallest difference between two holds that counts as a move, rad.
const SMALLEST_MOVE: f64 = 0.0087;

/// What figures of a sweep are marked with that are not of its holds.
pub const ON_THE_WAY: &str = "with the pressure on its way: fewer than three holds up and down";

/// Figures of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Metrics {
    /// The run.
    pub id: String,
    /// Whether devices and plant were simulated.
    pub simulated: bool,
    /// Whether the run has ended.
    pub complete: bool,
    /// Records read.
    pub records: u64,
    /// Periods skipped because of overruns.
    pub deadline_misses: u64,
    /// By FREE.
    pub frees: Vec<FreeMetrics>,
    /// How far a module's plate was from where it was wanted.
    pub tip: Option<TipMetrics>,
}

/// How far the centre of a module's plate was from its plan, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TipMetrics {
    /// The estimated centre.
    pub estimated: Apart,
    /// The true one of the simulated rig.
    pub truth: Option<Apart>,
}

/// Figures of one FREE.
#[derive(Clone, Debug, Serialize)]
pub struct FreeMetrics {
    /// Its name.
    pub free: String,
    /// What was asked: `angle`, `pressure` or `none`.
    pub quantity: Quantity,
    /// Errors of the estimated angle; with an angle reference only.
    pub error: Option<ErrorMetrics>,
    /// Errors of the true angle; simulated only.
    pub true_error: Option<ErrorMetrics>,
    /// The moves of the reference, in order.
    pub moves: Vec<MoveMetrics>,
    /// RMS of angle - model, rad.
    pub model_rmsd_rad: Option<f64>,
    /// The same over the range of the reference (of the angle in a sweep), per cent.
    pub model_rmsd_percent: Option<f64>,
    /// Why there is no comparison with the model.
    pub model_refusal: Option<String>,
    /// RMS of angle - model at rest, over pressure, rad; in a sweep only.
    pub rest_rmsd_rad: Option<f64>,
    /// The same over the range of the angle, per cent.
    pub rest_rmsd_percent: Option<f64>,
    /// Greatest difference between the ways up and down of a cycle, mean over the cycles, rad; in a sweep only.
    pub hysteresis_rad: Option<f64>,
    /// The same over the range of the angle, per cent.
    pub hysteresis_percent: Option<f64>,
    /// Whether the figures of a sweep are of the pressure on its way, for want of holds: damping and delays are in
    /// them.
    pub on_the_way: bool,
    /// Highest measured pressure, Pa.
    pub highest_pressure_pa: Option<f64>,
}

/// Errors while the program runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorMetrics {
    /// Root of the mean square, rad.
    pub rms_rad: f64,
    /// Greatest magnitude, rad.
    pub peak_rad: f64,
    /// Mean over the last 0.1 s, rad.
    pub final_rad: f64,
}

/// One move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MoveMetrics {
    /// When the reference leaves the hold before, s since the program's start.
    pub start_s: f64,
    /// Where from, rad.
    pub from_rad: f64,
    /// Where to, rad.
    pub to_rad: f64,
    /// Excursion beyond the target, rad.
    pub overshoot_rad: f64,
    /// The same over the move, per cent.
    pub overshoot_percent: f64,
    /// Time until it stays within 2 %, s; `None` where it does not.
    pub settling_s: Option<f64>,
    /// Mean error over the last fifth of the hold, rad.
    pub steady_error_rad: f64,
}

impl Metrics {
    /// The figures of `run`.
    ///
    /// # Errors
    /// Where its samples cannot be read.
    pub fn of(run: &Run) -> Result<Self> {
        let recorded = Recorded::of(run, &mut |_| {})?;
        let predictions: Vec<_> = recorded.frees.iter().map(prediction::dynamic).collect();
        Ok(Self::from(run, &recorded, &predictions, TipPath::of(run)?.as_ref()))
    }

    /// The same of what has been read and predicted already.
    pub(super) fn from(
        run: &Run,
        recorded: &Recorded,
        predictions: &[std::result::Result<Vec<f64>, String>],
        tip: Option<&TipPath>,
    ) -> Self {
        Self {
            id: run.id().into(),
            simulated: run.start().simulated(),
            complete: run.is_complete(),
            records: recorded.records,
            deadline_misses: recorded.deadline_misses,
            frees: recorded.frees.iter().zip(predictions).map(|(s, p)| FreeMetrics::of(s, p)).collect(),
            tip: tip.and_then(TipMetrics::of),
        }
    }
}

impl TipMetrics {
    /// Of what is known of `path`; none where nothing was wanted or estimated.
    fn of(path: &TipPath) -> Option<TipMetrics> {
        let estimated = Apart::between(&path.estimated, path.wanted())?;
        Some(TipMetrics { estimated, truth: Apart::between(&path.truth, path.wanted()) })
    }
}

impl FreeMetrics {
    fn of(signals: &Signals, prediction: &std::result::Result<Vec<f64>, String>) -> Self {
        let window = signals.window.clone();
        let (t, reference) = (&signals.t[window.clone()], &signals.reference[window.clone()]);
        let angle = &signals.angle[window.clone()];
        let angular = signals.quantity == Quantity::Angle;
        // A FREE under a module's plate turns as the others let it: its angle says nothing of its own rest or
        // hysteresis.
        let sweep = signals.quantity == Quantity::Pressure && !signals.in_module;
        let (model_rmsd_rad, model_refusal) = match prediction {
            // A FREE of which nothing was asked moves within its noise.
            Ok(_) if signals.quantity == Quantity::None => (None, None),
            Ok(model) => (rms(angle.iter().zip(&model[window.clone()]).map(|(y, m)| y - m)), None),
            Err(reason) => (None, Some(reason.clone())),
        };
        let percent = |value: Option<f64>| Some(100.0 * value? / signals.range.filter(|r| *r > 0.0)?);
        let loops = if sweep { Loops::of(signals) } else { Loops::default() };
        Self {
            free: signals.name.clone(),
            quantity: signals.quantity,
            error: signals.error.filter(|_| angular),
            true_error: signals.true_error.filter(|_| angular),
            moves: if angular { moves_where_known(t, reference, angle) } else { Vec::new() },
            model_rmsd_rad,
            model_rmsd_percent: percent(model_rmsd_rad),
            model_refusal,
            rest_rmsd_rad: loops.rest.map(|r| r.0),
            rest_rmsd_percent: loops.rest.map(|r| 100.0 * r.0 / r.1),
            hysteresis_rad: loops.hysteresis,
            hysteresis_percent: percent(loops.hysteresis),
            on_the_way: loops.on_the_way,
            highest_pressure_pa: signals.highest_pressure,
        }
    }
}

/// [`moves`], of the records alone that hold an angle.
fn moves_where_known(t: &[f64], reference: &[f64], y: &[f64]) -> Vec<MoveMetrics> {
    let known: Vec<usize> = (0..y.len()).filter(|&i| y[i].is_finite()).collect();
    let of = |values: &[f64]| known.iter().map(|&i| values[i]).collect::<Vec<_>>();
    moves(&of(t), &of(reference), &of(y))
}

/// The moves between the holds of `reference`; the first starts from the angle at the start.
pub fn moves(t: &[f64], reference: &[f64], y: &[f64]) -> Vec<MoveMetrics> {
    let mut moves = Vec::new();
    let Some(&first) = y.first() else { return moves };
    let (mut from, mut start) = (first, 0);
    let mut hold = 0;
    for i in 1..=reference.len() {
        if i < reference.len() && (reference[i] - reference[hold]).abs() <= 1e-9 {
            continue;
        }
        // hold..i stands still.
        if t[i - 1] - t[hold] >= SHORTEST_HOLD {
            let to = reference[hold];
            if (to - from).abs() >= SMALLEST_MOVE {
                moves.push(one_move(&t[start..i], &y[start..i], (from, to), t[hold]));
            }
            (from, start) = (to, i);
        }
        hold = i;
    }
    moves
}

fn one_move(t: &[f64], y: &[f64], (from, to): (f64, f64), hold_start: f64) -> MoveMetrics {
    let size = to - from;
    let beyond = y.iter().map(|y| (y - to) * size.signum()).fold(0.0, f64::max);
    let settled = |y: &f64| (y - to).abs() <= SETTLED * size.abs();
    let settling_s = match y.iter().rposition(|y| !settled(y)) {
        None => Some(0.0),
        Some(last) => t.get(last + 1).map(|&at| at - t[0]),
    };
    let end = t[t.len() - 1];
    let fifth = end - 0.2 * (end - hold_start);
    let (sum, count) =
        t.iter().zip(y).filter(|(t, _)| **t >= fifth).fold((0.0, 0.0), |(s, n), (_, y)| (s + to - y, n + 1.0));
    MoveMetrics {
        start_s: t[0],
        from_rad: from,
        to_rad: to,
        overshoot_rad: beyond,
        overshoot_percent: 100.0 * beyond / size.abs(),
        settling_s,
        steady_error_rad: sum / count,
    }
}

/// Root of the mean square of the numbers in `values`; `None` where there are none.
pub fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.filter(|v| v.is_finite()).fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
    (n > 0.0).then(|| (sum / n).sqrt())
}

/// Greatest minus smallest number in `values`.
pub fn range(values: &[f64]) -> Option<f64> {
    let numbers = || values.iter().copied().filter(|v| v.is_finite());
    Some(numbers().reduce(f64::max)? - numbers().reduce(f64::min)?)
}

/// Tracking errors of the FREEs of `run` that were given an angle.
///
/// # Errors
/// Where its samples cannot be read.
pub fn errors(run: &Run) -> Result<Vec<ErrorDocument>> {
    let errors = Recorded::of(run, &mut |_| {})?.frees.into_iter().filter_map(|s| {
        let ErrorMetrics { rms_rad, peak_rad, final_rad } = s.error.filter(|_| s.quantity == Quantity::Angle)?;
        Some(ErrorDocument { free: s.name, rms_rad, peak_rad, final_rad })
    });
    Ok(errors.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 0.01 s apart.
    fn times(n: usize) -> Vec<f64> {
        (0..n).map(|i| 0.01 * i as f64).collect()
    }

    #[test]
    fn a_damped_step_has_its_textbook_overshoot_and_settling_time() {
        // Second order, ratio 0.5: overshoot exp(-pi 0.5/sqrt(0.75)) = 16.30 %.
        let (zeta, omega) = (0.5f64, 20.0);
        let damped = omega * (1.0 - zeta * zeta).sqrt();
        let step = |t: f64| {
            1.0 - (-zeta * omega * t).exp() * ((damped * t).cos() + zeta * omega / damped * (damped * t).sin())
        };
        let t: Vec<f64> = (0..4000).map(|i| 1e-3 * i as f64).collect();
        let reference: Vec<f64> = t.iter().map(|&t| if t < 2.0 { 1.0 } else { 0.5 }).collect();
        let y: Vec<f64> = t.iter().map(|&t| if t < 2.0 { step(t) } else { 1.0 - 0.5 * step(t - 2.0) }).collect();
        let moves = moves(&t, &reference, &y);
        assert_eq!(moves.len(), 2);
        // By bisection of the envelope's last crossing of 2 %.
        let settling = (0..4000).rev().find(|&i| (step(1e-3 * f64::from(i)) - 1.0).abs() > 0.02).unwrap();
        for (m, start) in moves.iter().zip([0.0, 2.0]) {
            assert!((m.overshoot_percent - 16.3034).abs() < 0.01, "{m:?}");
            assert!((m.start_s - start).abs() < 1e-9);
            assert!((m.settling_s.unwrap() - 1e-3 * f64::from(settling + 1)).abs() < 1.5e-3, "{m:?} {settling}");
            assert!(m.steady_error_rad.abs() < 1e-6);
        }
        assert_eq!((moves[1].from_rad, moves[1].to_rad), (1.0, 0.5));
    }

    #[test]
    fn a_response_that_never_settles_has_no_settling_time() {
        let t = times(300);
        let m = moves(&t, &[1.0; 300], &t.iter().map(|t| if *t == 0.0 { 0.0 } else { 0.9 }).collect::<Vec<_>>());
        assert_eq!(m[0].settling_s, None);
        assert!((m[0].steady_error_rad - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_sinusoid_has_no_moves() {
        let t = times(1000);
        let reference: Vec<f64> = t.iter().map(|t| (3.0 * t).sin()).collect();
        assert!(moves(&t, &reference, &reference).is_empty());
    }
}

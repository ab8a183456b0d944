//! The figures of a report: which signals of a run go into which plot. Degrees and psi, as on the bench.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::bars::Bars;
use super::columns::{column_name, limit_names, state_of};
use super::document::FaultDocument;
use super::lanes::{Lane, Lanes, state_color};
use super::module::TipPath;
use super::plot::{Band, Line, Plot};
use super::prediction;
use super::run::Run;
use super::signals::{Signals, interpolate};
use super::sweep::ways_together;
use super::{Result, palette};
use crate::config::Temperatures;
use crate::signal::{FaultSet, Quantity};
use crate::units::PASCAL_PER_PSI;

/// Shown before and after the program, s.
const AROUND: f64 = 0.25;

const TIME: &str = "time [s]";

fn degrees(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| v.to_degrees()).collect()
}

fn psi(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| v / PASCAL_PER_PSI).collect()
}

/// The time that a report shows: the program and a little around it; to the end where the run did not end well.
pub fn shown(signals: &Signals) -> (f64, f64) {
    let (first, last) = (signals.t.first().copied().unwrap_or(0.0), signals.t.last().copied().unwrap_or(1.0));
    let from = signals.t.get(signals.window.start).map_or(first, |t| t - AROUND);
    let to = signals.t.get(signals.window.end.saturating_sub(1)).map_or(last, |t| t + AROUND);
    let to = if signals.aftermath { last } else { to.min(last) };
    (from.max(first), to.max(from.max(first) + 1e-3))
}

fn over_time(signals: &Signals, y_label: &str, height: u32, lines: Vec<Line>) -> Plot {
    let x_range = Some(shown(signals));
    Plot { x_label: TIME.into(), y_label: y_label.into(), x_range, height, lines, ..Plot::default() }
}

/// When the run's faults were first seen, on the time base of `signals`: those of its FREE and of the rig.
pub fn marks(run: &Run, signals: &Signals) -> Vec<(f64, u32, String)> {
    let Some(stop) = run.stop() else { return Vec::new() };
    let own = |f: &&FaultDocument| f.free.as_ref().is_none_or(|free| *free == signals.name);
    stop.faults.iter().filter(own).map(|f| (signals.since_program(f.t_s), palette::RED, f.name.clone())).collect()
}

/// Response against the reference, the model's prediction and, simulated, the truth.
pub fn response(signals: &Signals, model: Option<&[f64]>) -> Plot {
    let line = |label: &str, rgb: u32, values: &[f64]| Line::new(label, rgb, &signals.t, degrees(values));
    let mut lines = Vec::new();
    if signals.quantity == Quantity::Angle {
        lines.push(line("reference", palette::GREY, &signals.reference).width(3));
    }
    if let Some(model) = model {
        lines.push(line("model, from the measured pressure", palette::ORANGE, model).dashed());
    }
    if signals.true_angle_in_window().is_some() {
        lines.push(line("true angle (SIMULATED)", palette::GREEN, &signals.true_angle).width(1));
    }
    lines.push(line("angle", palette::BLUE, &signals.angle));
    over_time(signals, "angle [deg]", 380, lines)
}

/// What the knob of `table` sets at the angles: wanted, simulated, and as measured.
pub fn temperature(signals: &Signals, table: &Temperatures) -> Plot {
    let line = |label: &str, rgb: u32, angles: &[f64]| {
        Line::new(label, rgb, &signals.t, angles.iter().map(|angle| table.at(*angle)).collect())
    };
    let mut lines = Vec::new();
    if signals.quantity == Quantity::Angle {
        lines.push(line("reference", palette::GREY, &signals.reference).width(3));
    }
    if signals.true_angle_in_window().is_some() {
        lines.push(line("true (SIMULATED)", palette::GREEN, &signals.true_angle).width(1));
    }
    lines.push(line("set", palette::BLUE, &signals.angle));
    over_time(signals, "temperature [degC]", 260, lines)
}

/// Tracking error, and what the model leaves unexplained.
pub fn error(signals: &Signals, model: Option<&[f64]>) -> Plot {
    let mut lines = Vec::new();
    if let Some(model) = model {
        let rest: Vec<f64> = signals.angle.iter().zip(model).map(|(y, m)| y - m).collect();
        lines.push(Line::new("angle - model", palette::ORANGE, &signals.t, degrees(&rest)).dashed());
    }
    if signals.quantity == Quantity::Angle {
        lines.push(Line::new("reference - angle", palette::RED, &signals.t, degrees(&signals.error())));
    }
    over_time(signals, "error [deg]", 240, lines)
}

/// Command and measured pressure.
pub fn pressure(signals: &Signals) -> Plot {
    let lines = vec![
        Line::new("command", palette::GREY, &signals.t, psi(&signals.command)).width(3),
        Line::new("measured", palette::BLUE, &signals.t, psi(&signals.pressure)),
    ];
    over_time(signals, "pressure [psi]", 260, lines)
}

/// The controller's terms.
pub fn terms(signals: &Signals) -> Plot {
    let of = [("P", palette::BLUE), ("I", palette::GREEN), ("D", palette::ORANGE), ("feedforward", palette::PURPLE)];
    let lines = of.iter().zip(&signals.terms).map(|((l, rgb), v)| Line::new(l, *rgb, &signals.t, psi(v))).collect();
    over_time(signals, "terms [psi]", 260, lines)
}

/// Twist per length against pressure, both ways, with the model at rest.
pub fn sweep(signals: &Signals) -> Plot {
    let window = signals.window.clone();
    let pressure = &signals.pressure[window];
    let length_mm = signals.free.map_or(f64::NAN, |f| f.length * 1e3);
    let twist = |values: &[f64]| values.iter().map(|v| v.to_degrees() / length_mm).collect::<Vec<_>>();
    let highest = pressure.iter().copied().filter(|p| p.is_finite()).fold(0.0, f64::max);
    let (model_pressure, model) = prediction::quasi_static(signals, highest);
    let [up, down] = ways_together(signals);
    let mut lines = vec![
        Line::new("up", palette::BLUE, &psi(&up[0]), twist(&up[1])),
        Line::new("down", palette::GREEN, &psi(&down[0]), twist(&down[1])),
    ];
    if !model.is_empty() {
        lines.push(Line::new("model at rest", palette::ORANGE, &psi(&model_pressure), twist(&model)).dashed());
    }
    // As the paper's Fig. 7: what geometry and material alone say, over what was measured.
    if let Some(tube) = &signals.tube {
        let (pressure, twist) = tube.free_twist(highest);
        let per_mm = twist.iter().map(|t| t.to_degrees() * 1e-3).collect();
        lines.push(Line::new("finite elements, long FREE", palette::PURPLE, &psi(&pressure), per_mm).dashed());
    }
    Plot { x_label: "pressure [psi]".into(), y_label: "twist [deg/mm]".into(), height: 420, lines, ..Plot::default() }
}

/// Ways of a module's plate that are known: what they are, their colours, the points.
fn ways_of(path: &TipPath) -> impl Iterator<Item = (&'static str, u32, &[Option<Vector3<f64>>])> {
    let all: [(_, _, &[_]); 4] = [
        ("planned", palette::GREY, &path.planned),
        ("predicted", palette::ORANGE, &path.predicted),
        ("true (SIMULATED)", palette::GREEN, &path.truth),
        ("estimated", palette::BLUE, &path.estimated),
    ];
    all.into_iter().filter(|(.., points)| points.iter().any(Option::is_some))
}

/// One coordinate of a way, mm; not a number where it is not known.
fn millimetres(points: &[Option<Vector3<f64>>], axis: usize) -> Vec<f64> {
    points.iter().map(|p| p.map_or(f64::NAN, |p| 1e3 * p[axis])).collect()
}

/// The way of a module's plate as seen along its axis.
pub fn tip_from_above(path: &TipPath) -> Plot {
    let lines = ways_of(path).map(|(label, rgb, points)| {
        Line::new(label, rgb, &millimetres(points, 0), millimetres(points, 1)).width(if label == "planned" {
            3
        } else {
            1
        })
    });
    Plot {
        x_label: "x [mm]".into(),
        y_label: "y [mm]".into(),
        height: 520,
        square: true,
        lines: lines.collect(),
        ..Plot::default()
    }
}

/// The same, coordinate by coordinate.
pub fn tip_over_time(path: &TipPath) -> Plot {
    let rest = path.truth.iter().chain(&path.estimated).flatten().next().map_or(0.0, |p| 1e3 * p.z);
    let lines = ways_of(path).flat_map(|(label, rgb, points)| {
        let name = |axis: &str| format!("{axis}, {label}");
        let z = millimetres(points, 2).into_iter().map(|z| z - rest).collect();
        [
            Line::new(&name("x"), rgb, &path.t, millimetres(points, 0)).width(1),
            Line::new(&name("y"), rgb, &path.t, millimetres(points, 1)).width(1).dashed(),
            Line::new(&name("z from the beginning"), rgb, &path.t, z).width(3),
        ]
    });
    Plot { x_label: TIME.into(), y_label: "centre [mm]".into(), height: 380, lines: lines.collect(), ..Plot::default() }
}

/// Several runs of the same experiment: mean of their angles with one standard deviation either way, and how far
/// each is from the mean.
pub fn repeats(runs: &[Signals]) -> (Plot, Plot) {
    let Some(first) = runs.first() else { return Default::default() };
    let t: Vec<f64> = first.t[first.window.clone()].to_vec();
    let at = |run: &Signals| -> Vec<f64> {
        let window = run.window.clone();
        t.iter().map(|&t| interpolate(&run.t[window.clone()], &run.angle[window.clone()], t).to_degrees()).collect()
    };
    let all: Vec<Vec<f64>> = runs.iter().map(at).collect();
    let n = all.len() as f64;
    let mean: Vec<f64> = (0..t.len()).map(|i| all.iter().map(|y| y[i]).sum::<f64>() / n).collect();
    let scatter: Vec<f64> = (0..t.len())
        .map(|i| (all.iter().map(|y| (y[i] - mean[i]).powi(2)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt())
        .collect();
    let edge = |sign: f64| mean.iter().zip(&scatter).map(|(m, s)| m + sign * s).collect::<Vec<_>>();
    // As many points as a band can show.
    let step = t.len().div_ceil(1500).max(1);
    let every = |v: &[f64]| v.iter().copied().step_by(step).collect::<Vec<_>>();
    let band = Band {
        label: "one standard deviation".into(),
        rgb: palette::BLUE,
        x: every(&t),
        low: every(&edge(-1.0)),
        high: every(&edge(1.0)),
    };
    let mut lines: Vec<Line> = Vec::new();
    if first.quantity == Quantity::Angle {
        let reference = degrees(&first.reference[first.window.clone()]);
        lines.push(Line::new("reference", palette::GREY, &t, reference).width(2));
    }
    let apart = all.iter().enumerate().map(|(i, y)| {
        let apart = y.iter().zip(&mean).map(|(y, m)| y - m).collect();
        Line::new(&format!("run {}", i + 1), RUNS[i % RUNS.len()], &t, apart).width(1)
    });
    let apart = Plot {
        x_label: TIME.into(),
        y_label: "angle - mean [deg]".into(),
        height: 240,
        lines: apart.collect(),
        ..Plot::default()
    };
    lines.push(Line::new(&format!("mean of {n} runs"), palette::BLUE, &t, mean));
    let mean = Plot {
        x_label: TIME.into(),
        y_label: "angle [deg]".into(),
        height: 340,
        bands: vec![band],
        lines,
        ..Plot::default()
    };
    (mean, apart)
}

/// How many ticks woke up how late, and took how long; on a logarithmic scale, so that a stall is seen beside the rest.
pub fn latency(run: &Run) -> Result<Bars> {
    const PER_DECADE: f64 = 16.0;
    const COLUMNS: [&str; 2] = ["latency_ns", "execution_ns"];
    let mut counts: [BTreeMap<i32, u64>; 2] = Default::default();
    for table in run.tables(&COLUMNS.map(String::from))? {
        let table = table?;
        for (counts, name) in counts.iter_mut().zip(COLUMNS) {
            // A time that was not measured is none.
            for micros in table.get(name).iter().map(|v| v * 1e-3).filter(|v| *v > 0.0) {
                *counts.entry((micros.log10() * PER_DECADE).floor() as i32).or_default() += 1;
            }
        }
    }
    let edge = |bin: i32| 10f64.powf(f64::from(bin) / PER_DECADE);
    let [latency, execution] =
        counts.map(|counts| counts.into_iter().map(|(i, n)| (edge(i), edge(i + 1), n)).collect::<Vec<_>>());
    Ok(Bars {
        x_label: "time [us]".into(),
        height: 240,
        series: vec![
            ("from the deadline to the wake-up".into(), palette::BLUE, latency),
            ("execution".into(), palette::ORANGE, execution),
        ],
    })
}

/// States, faults and limits over time. `signals` gives the time base.
pub fn timeline(run: &Run, signals: &Signals) -> Result<Lanes> {
    let names = run.names();
    let mut columns: Vec<String> = ["state", "rig_faults", "latched_faults"].map(String::from).into();
    columns.extend(names.iter().flat_map(|n| [column_name(n, "faults"), column_name(n, "limits")]));
    let changes = changes(run, &columns)?;
    let (first, last) = (signals.t.first().copied().unwrap_or(0.0), signals.t.last().copied().unwrap_or(1.0));
    let spans = |column: &str, shown: &dyn Fn(u32) -> Option<(u32, String)>| {
        let changes = columns.iter().position(|c| c == column).map_or(&[][..], |i| &changes[i]);
        let ends = changes.iter().skip(1).map(|(t, _)| first + t).chain([last]);
        let spans = changes.iter().zip(ends).filter_map(|(&(t, code), end)| {
            let (rgb, text) = shown(code)?;
            Some((first + t, end, rgb, text))
        });
        spans.collect::<Vec<_>>()
    };
    let faults = |set: u32| {
        let names: Vec<_> = FaultSet(set).iter().map(|c| c.name()).collect();
        (!names.is_empty()).then(|| (palette::RED, names.join(", ")))
    };
    let limits = |set: u32| {
        let names: Vec<_> = limit_names(set as u8).collect();
        (!names.is_empty()).then(|| (palette::ORANGE, names.join(", ")))
    };
    let state = |code: u32| Some((state_color(code as u8), state_of(code as u8).name().to_owned()));
    let mut lanes = vec![Lane { name: "state".into(), spans: spans("state", &state) }];
    for name in &names {
        lanes.push(Lane { name: format!("{name}: limits"), spans: spans(&column_name(name, "limits"), &limits) });
        lanes.push(Lane { name: format!("{name}: faults"), spans: spans(&column_name(name, "faults"), &faults) });
    }
    lanes.push(Lane { name: "rig: faults".into(), spans: spans("rig_faults", &faults) });
    lanes.push(Lane { name: "latched".into(), spans: spans("latched_faults", &faults) });
    lanes.retain(|lane| !lane.spans.is_empty());
    Ok(Lanes { x_label: TIME.into(), x_range: (first, last.max(first + 1e-3)), lanes })
}

/// The values of each of `columns`, and since when: seconds since the run's first record.
fn changes(run: &Run, columns: &[String]) -> Result<Vec<Vec<(f64, u32)>>> {
    let mut changes = vec![Vec::<(f64, u32)>::new(); columns.len()];
    let mut start = None;
    for table in run.tables(&[columns, &["t_s".into()]].concat())? {
        let table = table?;
        for (changes, column) in changes.iter_mut().zip(columns) {
            for (&t, &value) in table.get("t_s").iter().zip(table.get(column)) {
                let code = value as u32;
                if changes.last().is_none_or(|(_, before)| *before != code) {
                    changes.push((t - *start.get_or_insert(t), code));
                }
            }
        }
    }
    Ok(changes)
}

/// Lines of several runs, each with its label.
type Labelled<'a> = [(String, &'a Signals)];

/// Colours of runs beside each other.
const RUNS: [u32; 6] = [palette::BLUE, palette::ORANGE, palette::GREEN, palette::PURPLE, palette::RED, palette::YELLOW];

fn overlay(runs: &Labelled<'_>, y_label: &str, height: u32, values: impl Fn(&Signals) -> Vec<f64>) -> Plot {
    let shown = runs.iter().map(|(_, s)| shown(s)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let line = |(i, (label, s)): (usize, &(String, &Signals))| Line::new(label, RUNS[i % RUNS.len()], &s.t, values(s));
    let lines = runs.iter().enumerate().map(line).collect();
    Plot { x_label: TIME.into(), y_label: y_label.into(), x_range: shown, height, lines, ..Plot::default() }
}

/// Angles of several runs, with the reference of the first (and of others that were asked something else).
pub fn responses(runs: &Labelled<'_>) -> Plot {
    let mut plot = overlay(runs, "angle [deg]", 380, |s| degrees(&s.angle));
    let mut references: Vec<Line> = Vec::new();
    for (_, s) in runs.iter().filter(|(_, s)| s.quantity == Quantity::Angle) {
        let asked: Vec<f64> = s.reference[s.window.clone()].to_vec();
        let line = Line::new("reference", palette::GREY, &s.t[s.window.clone()], degrees(&asked)).width(3);
        let same = |other: &Line| {
            let apart = |(t, y): (&f64, &f64)| (interpolate(&other.x, &other.y, *t) - y).abs() > 0.1;
            // A step is not at the very same record in every run.
            line.x.iter().zip(&line.y).filter(|&p| apart(p)).count() * 50 < line.x.len()
        };
        if !references.iter().any(same) {
            references.push(line);
        }
    }
    references.append(&mut plot.lines);
    plot.lines = references;
    plot
}

/// Tracking errors of several runs.
pub fn errors(runs: &Labelled<'_>) -> Plot {
    overlay(runs, "reference - angle [deg]", 260, |s| degrees(&s.error()))
}

/// Measured pressures of several runs.
pub fn pressures(runs: &Labelled<'_>) -> Plot {
    overlay(runs, "pressure [psi]", 260, |s| psi(&s.pressure))
}

/// Twist per length against pressure of several runs.
pub fn sweeps(runs: &Labelled<'_>) -> Plot {
    let line = |(i, (label, s)): (usize, &(String, &Signals))| {
        let length_mm = s.free.map_or(f64::NAN, |f| f.length * 1e3);
        let window = s.window.clone();
        let twist = s.angle[window.clone()].iter().map(|v| v.to_degrees() / length_mm).collect();
        Line::new(label, RUNS[i % RUNS.len()], &psi(&s.pressure[window]), twist)
    };
    Plot {
        x_label: "pressure [psi]".into(),
        y_label: "twist [deg/mm]".into(),
        height: 420,
        lines: runs.iter().enumerate().map(line).collect(),
        ..Plot::default()
    }
}

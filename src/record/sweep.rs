//! What a sweep of the pressure says of a FREE: how far it is from the model at rest, and the loop between the ways up
//! and down.
//!
//! The ways are told by the reference, which has no noise: a [`Way`] leads from one end of its range to the other, and
//! two ways one after the other are a cycle. What turns on the way, as the inner loops of a calibration, belongs to
//! none. The hysteresis of a cycle is the greatest difference between its ways at one pressure, that of a sweep the
//! mean over its cycles: it does not grow with their number, as the largest of noisy ones does.

use std::ops::Range;

use super::metrics::{SHORTEST_HOLD, range, rms};
use super::prediction;
use super::signals::{Signals, interpolate};

/// Fewest holds on each way that a sweep is judged by; with fewer it counts as a slow ramp.
const FEWEST_HOLDS: usize = 3;
/// Share of the reference's range within which it is at an end: a ramp turns between two records.
const AT_END: f64 = 0.01;
/// Share of the range that a way has to cover which begins or ends on the way.
const MOST: f64 = 0.5;
/// Pieces of the range over which the records of a ramp are averaged: the noise of single readings stays out.
const PIECES: usize = 50;

/// Points of a way: pressures that rise (Pa), and the angles there (rad).
type Points = [Vec<f64>; 2];

/// A stretch of a sweep on which the pressure goes from one end of its range to the other, both stays included.
#[derive(Clone, Debug, PartialEq)]
pub struct Way {
    /// Where it is.
    pub at: Range<usize>,
    /// Whether the pressure rises.
    pub up: bool,
}

/// Figures of a sweep.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loops {
    /// RMS of angle - model at rest, and the range of the angle, rad; none where the model says nothing.
    pub rest: Option<(f64, f64)>,
    /// Greatest difference between the ways up and down, mean over the cycles, rad; none without a cycle.
    pub hysteresis: Option<f64>,
    /// Whether both are of every record, as no cycle has three holds on each way: damping and delays are in them.
    pub on_the_way: bool,
}

impl Loops {
    /// Of `signals`: where the pressure was held step by step of the end of each hold alone, for on the way damping and
    /// delays look like hysteresis.
    pub fn of(signals: &Signals) -> Loops {
        let [reference, pressure, angle] = holds(signals);
        let hysteresis = mean_over_cycles(&reference, &pressure, &angle, |up, down| {
            if up[0].len() >= FEWEST_HOLDS && down[0].len() >= FEWEST_HOLDS { gap(up, down) } else { None }
        });
        if hysteresis.is_some() {
            return Loops { rest: rest_deviation(signals, &pressure, &angle), hysteresis, on_the_way: false };
        }
        let [reference, pressure, angle] = within(signals);
        let hysteresis = mean_over_cycles(reference, pressure, angle, width);
        Loops { rest: rest_deviation(signals, pressure, angle), hysteresis, on_the_way: true }
    }
}

/// All ways up and all ways down of the program, each with its points together.
pub fn ways_together(signals: &Signals) -> [Points; 2] {
    let [reference, pressure, angle] = within(signals);
    let ways = ways(reference);
    [true, false].map(|up| {
        let own = ways.iter().filter(|way| way.up == up).flat_map(|way| way.at.clone());
        points(pressure, angle, own)
    })
}

/// Reference, measured pressure and angle while the program ran.
fn within(signals: &Signals) -> [&[f64]; 3] {
    [&signals.reference_pressure, &signals.pressure, &signals.angle].map(|all| &all[signals.window.clone()])
}

/// The ways of a `reference`, in their order; up and down alternate.
fn ways(reference: &[f64]) -> Vec<Way> {
    let numbers = || reference.iter().copied().filter(|r| r.is_finite());
    let low = numbers().fold(f64::INFINITY, f64::min);
    let span = numbers().fold(f64::NEG_INFINITY, f64::max) - low;
    if span.is_nan() || span <= 0.0 {
        return Vec::new();
    }
    let share = |i: usize| (reference[i] - low) / span;
    let end = |i: usize| match share(i) {
        high if high >= 1.0 - AT_END => Some(true),
        low if low <= AT_END => Some(false),
        _ => None,
    };
    // Stays at an end: where, and whether it is the high one.
    let mut stays: Vec<(Range<usize>, bool)> = Vec::new();
    for (i, high) in (0..reference.len()).filter_map(|i| Some((i, end(i)?))) {
        match stays.last_mut() {
            Some((stay, before)) if stay.end == i && *before == high => stay.end = i + 1,
            _ => stays.push((i..i + 1, high)),
        }
    }
    let mut ways = Vec::new();
    let covers = |from: usize, to: usize| (share(from) - share(to)).abs() >= MOST;
    if let Some((stay, high)) = stays.first().filter(|(stay, _)| covers(0, stay.start)) {
        ways.push(Way { at: 0..stay.end, up: *high });
    }
    for pair in stays.windows(2).filter(|pair| pair[0].1 != pair[1].1) {
        ways.push(Way { at: pair[0].0.start..pair[1].0.end, up: pair[1].1 });
    }
    if let Some((stay, high)) = stays.last().filter(|(stay, _)| covers(stay.start, reference.len() - 1)) {
        ways.push(Way { at: stay.start..reference.len(), up: !high });
    }
    ways
}

/// Points of the records `at` that are known, by their pressure.
fn points(pressure: &[f64], angle: &[f64], at: impl Iterator<Item = usize>) -> Points {
    let known = at.map(|i| (pressure[i], angle[i])).filter(|(p, y)| p.is_finite() && y.is_finite());
    let mut points: Vec<(f64, f64)> = known.collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (p, y) = points.into_iter().unzip();
    [p, y]
}

/// Mean of `of` (way up, way down) over the cycles that have it; none where none has.
fn mean_over_cycles(
    reference: &[f64],
    pressure: &[f64],
    angle: &[f64],
    of: impl Fn(&Points, &Points) -> Option<f64>,
) -> Option<f64> {
    let of_cycle = |pair: &[Way]| {
        let [first, second] = [&pair[0], &pair[1]].map(|way| points(pressure, angle, way.at.clone()));
        if pair[0].up { of(&first, &second) } else { of(&second, &first) }
    };
    let found: Vec<f64> = ways(reference).chunks_exact(2).filter_map(of_cycle).collect();
    (!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64)
}

/// Greatest difference of the angle between two ways at the pressures of the second.
fn gap(up: &Points, down: &Points) -> Option<f64> {
    let (low, high) = (*up[0].first()?, *up[0].last()?);
    let common = down[0].iter().zip(&down[1]).filter(|(p, _)| (low..=high).contains(*p));
    common.map(|(&p, y)| (y - interpolate(&up[0], &up[1], p)).abs()).reduce(f64::max)
}

/// Greatest difference between the means of two ways over pieces of the range that they share.
fn width(up: &Points, down: &Points) -> Option<f64> {
    let low = f64::max(*up[0].first()?, *down[0].first()?);
    let high = f64::min(*up[0].last()?, *down[0].last()?);
    if high <= low {
        return None;
    }
    let mean = |way: &Points, from: f64, to: f64| {
        let inside = way[0].partition_point(|p| *p < from)..way[0].partition_point(|p| *p < to);
        (!inside.is_empty()).then(|| way[1][inside.clone()].iter().sum::<f64>() / inside.len() as f64)
    };
    let edge = |i: usize| low + (high - low) * i as f64 / PIECES as f64;
    let apart = |i| Some((mean(down, edge(i), edge(i + 1))? - mean(up, edge(i), edge(i + 1))?).abs());
    (0..PIECES).filter_map(apart).reduce(f64::max)
}

/// Of every hold of the pressure's reference: that reference, and mean pressure and angle over its last fifth.
fn holds(signals: &Signals) -> [Vec<f64>; 3] {
    let t = &signals.t[signals.window.clone()];
    let [reference, pressure, angle] = within(signals);
    let mut holds = [const { Vec::new() }; 3];
    let mut start = 0;
    for end in 1..=reference.len() {
        if end < reference.len() && reference[end] == reference[start] {
            continue;
        }
        let (begun, ended) = (t[start], t[end - 1]);
        if ended - begun >= SHORTEST_HOLD {
            let settled = |i: &usize| t[*i] >= ended - 0.2 * (ended - begun);
            let known = |i: &usize| pressure[*i].is_finite() && angle[*i].is_finite();
            let (n, p, y) = (start..end)
                .filter(settled)
                .filter(known)
                .fold((0.0, 0.0, 0.0), |(n, p, y), i| (n + 1.0, p + pressure[i], y + angle[i]));
            if n > 0.0 {
                holds.iter_mut().zip([reference[start], p / n, y / n]).for_each(|(all, value)| all.push(value));
            }
        }
        start = end;
    }
    holds
}

/// RMS of angle - model at rest at these pressures, and the range of the angle there, rad: the figure of the
/// paper's Fig. 7; `None` where the model says nothing.
fn rest_deviation(signals: &Signals, pressure: &[f64], angle: &[f64]) -> Option<(f64, f64)> {
    let highest = pressure.iter().copied().filter(|p| p.is_finite()).fold(0.0, f64::max);
    let (at, model) = prediction::quasi_static(signals, highest);
    let reached = *at.last()?;
    let points = || pressure.iter().zip(angle).filter(|(p, _)| (0.0..=reached).contains(*p));
    let deviation = rms(points().map(|(&p, &y)| y - interpolate(&at, &model, p)))?;
    let range = range(&points().map(|(_, &y)| y).collect::<Vec<_>>()).filter(|r| *r > 0.0)?;
    Some((deviation, range))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep at the references `stairs`, each held for 1 s of 100 records, and got to in `between` records; the angle
    /// is the pressure, lower on the way up and higher on the way down by the half width `lens` of it; every hold's
    /// pressure reads wrong by its own small part of `noise`.
    fn swept(stairs: &[f64], between: usize, lens: impl Fn(f64) -> f64, noise: f64) -> Signals {
        let mut signals = Signals::default();
        let mut before = stairs[0];
        for (k, &stair) in stairs.iter().enumerate() {
            // Where the next one lies tells the way that a turn belongs to; both have no width there.
            let way = if stair > before { -1.0 } else { 1.0 };
            let wrong = noise * (12.9898 * (k + 1) as f64).sin();
            let moving = (1..=between).map(|i| before + (stair - before) * i as f64 / (between + 1) as f64);
            for reference in moving.chain(std::iter::repeat_n(stair, if between == 0 || k == 0 { 100 } else { 1 })) {
                signals.t.push(0.01 * signals.t.len() as f64);
                signals.reference_pressure.push(reference);
                signals.pressure.push(reference + wrong);
                signals.angle.push(reference + way * lens(reference));
            }
            before = stair;
        }
        signals.window = 0..signals.t.len();
        signals
    }

    const STAIRS: [f64; 9] = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0];

    #[test]
    fn the_loop_of_many_cycles_is_that_of_one_whichever_top_reads_highest() {
        let lens = |p: f64| 0.4 * p * (1.0 - p);
        let one = Loops::of(&swept(&STAIRS, 0, lens, 0.0));
        assert!((one.hysteresis.unwrap() - 0.2).abs() < 1e-12 && !one.on_the_way, "{one:?}");
        // The noise of two holds' pressures, times the slope of 1.1 at most that the angle has between holds.
        for cycles in [1, 2, 7] {
            let stairs: Vec<f64> = [0.0].into_iter().chain((0..cycles).flat_map(|_| STAIRS[1..].to_vec())).collect();
            let many = Loops::of(&swept(&stairs, 0, lens, 1e-3)).hysteresis.unwrap();
            assert!((many - 0.2).abs() < 2.2e-3, "{cycles}: {many}");
        }
        // Of two cycles, one twice as wide, the mean.
        let narrow = swept(&STAIRS, 0, lens, 0.0);
        let mut both = swept(&STAIRS, 0, |p| 2.0 * lens(p), 0.0);
        let later = both.t.len() as f64 * 0.01;
        both.t.extend(narrow.t.iter().map(|t| t + later));
        both.reference_pressure.extend(&narrow.reference_pressure);
        both.pressure.extend(&narrow.pressure);
        both.angle.extend(&narrow.angle);
        both.window = 0..both.t.len();
        assert!((Loops::of(&both).hysteresis.unwrap() - 0.3).abs() < 1e-12);
    }

    #[test]
    fn ways_lead_from_end_to_end_and_inner_loops_belong_to_none() {
        let of = |reference: &[f64]| {
            ways(reference).into_iter().map(|way| (way.at.start, way.at.end, way.up)).collect::<Vec<_>>()
        };
        assert_eq!(of(&[0.0, 1.0, 2.0, 1.0, 0.0]), [(0, 3, true), (2, 5, false)]);
        assert_eq!(of(&[0.0, 2.0, 0.2, 1.0, 0.3, 2.0, 2.0, 0.0]), [(0, 2, true), (5, 8, false)]);
        // Up from what is not the lowest, and a little that comes before and after.
        assert_eq!(of(&[1.0, 2.0, 3.0, 2.0, 0.0]), [(0, 3, true), (2, 5, false)]);
        assert_eq!(of(&[1.0, 0.0, 2.0, 3.0, 0.0, 1.0]), [(1, 4, true), (3, 5, false)]);
        assert_eq!(of(&[3.0, 0.0, f64::NAN, 3.0]), [(0, 2, false), (1, 4, true)]);
        assert!(of(&[1.0, 1.0]).is_empty() && of(&[]).is_empty() && of(&[f64::NAN]).is_empty());
    }

    #[test]
    fn a_ramp_is_judged_on_its_way_and_that_is_said() {
        // A lens, 0.2 wide in the middle, over 1000 records a way, 20 in a piece of the range: whether the record on a
        // piece's edge belongs to it moves the mean of a way by a fortieth of the piece, times the slope of 1.4 at
        // most.
        let lens = |p: f64| 0.4 * p * (1.0 - p);
        let ramp = Loops::of(&swept(&[0.0, 1.0, 0.0, 1.0, 0.0], 999, lens, 0.0));
        assert!(ramp.on_the_way && (ramp.hysteresis.unwrap() - 0.2).abs() < 1.4e-3, "{ramp:?}");
        // Only the way up: no loop. Nothing at all: no figures.
        assert_eq!(Loops::of(&swept(&[0.0, 1.0], 99, lens, 0.0)).hysteresis, None);
        assert_eq!(Loops::of(&Signals::default()), Loops { on_the_way: true, ..Loops::default() });
    }
}

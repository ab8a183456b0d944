//! Where an end was let go, in a record of its angle.

use super::{PluckError, Reading};

/// What counts as turned, held and at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Least turn that is a pluck, rad.
    pub least: f64,
    /// Shortest time for which it must be held, s.
    pub held: f64,
    /// Farthest that the angle may stray while it is held, as a share of the turn.
    pub stray: f64,
    /// Shortest time alone after a release, s.
    pub alone: f64,
    /// Longest time alone that is looked at, s.
    pub longest: f64,
    /// Time that is looked at after the motion is gone, s.
    pub after: f64,
    /// Time for which the hand is taken to have been there before its turn is seen, s.
    pub touch: f64,
}

impl Default for Rules {
    /// 2 deg, held for 0.15 s within 10 %, alone for 0.5 to 4 s and 0.4 s after the motion is gone, the hand there 0.6
    /// s before the turn is seen.
    fn default() -> Self {
        Self { least: 2f64.to_radians(), held: 0.15, stray: 0.1, alone: 0.5, longest: 4.0, after: 0.4, touch: 0.6 }
    }
}

/// A stretch in which the end moves alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Release {
    /// Its first reading.
    pub first: usize,
    /// One past its last.
    pub end: usize,
    /// How far from rest it was held, rad.
    pub turn: f64,
}

/// A hold is at least this share of the farthest turn from rest: a slow return ends in stretches that are as quiet.
const HELD_SHARE: f64 = 0.4;
/// Farthest that readings may lie off an even grid, root mean square, as a share of its step.
const IRREGULAR: f64 = 0.25;
/// What is left of a motion that is gone, as a share of the turn.
const GONE: f64 = 0.02;
/// Within this share of the farthest turn the end may be at rest.
const REST_SHARE: f64 = 0.2;

/// The releases in `record`: each follows a stretch in which the angle stood far from rest, and ends where the motion
/// is gone or the end is turned again.
///
/// # Errors
/// Where nothing moved, or a reading is none.
pub fn releases(record: &[Reading], rules: &Rules) -> Result<Vec<Release>, PluckError> {
    let finite = |r: &Reading| r.time.is_finite() && r.angle.is_finite() && r.rate.is_finite();
    let good = |i: usize| finite(&record[i]) && (i == 0 || record[i].time > record[i - 1].time);
    if let Some(index) = (0..record.len()).find(|&i| !good(i)) {
        return Err(PluckError::Reading(index));
    }
    if record.len() < 2 {
        return Err(PluckError::TooFew { count: record.len(), least: 2 });
    }
    // The end is at rest for most of the time.
    let mut angles: Vec<f64> = record.iter().map(|r| r.angle).collect();
    angles.sort_by(f64::total_cmp);
    let rest = angles[angles.len() / 2];
    let off = |i: usize| (record[i].angle - rest).abs();
    let farthest = (0..record.len()).map(off).fold(0.0, f64::max);
    if farthest < rules.least {
        return Err(PluckError::NoExcitation { farthest, least: rules.least });
    }
    let holds = holds(record, rest, rules.least.max(HELD_SHARE * farthest), rules);
    let mut found = Vec::new();
    for (n, hold) in holds.iter().enumerate() {
        let turn = record[hold.1].angle - rest;
        // The reading of the release itself may belong to the hand.
        let first = hold.1 + 2;
        // The hand is back a little before the end leaves rest for the last time on its way to the next hold.
        let next = holds.get(n + 1).map_or(f64::INFINITY, |&(next, _)| {
            let near = REST_SHARE * (record[next].angle - rest).abs();
            (hold.1..next).rev().find(|&i| off(i) < near).map_or(0.0, |i| record[i].time - rules.touch)
        });
        let until = (record[hold.1].time + rules.longest).min(next);
        let end = record.partition_point(|r| r.time < until);
        if end <= first || record[end - 1].time - record[first].time < rules.alone {
            continue;
        }
        let end = still_from(record, (first, end), GONE * turn.abs(), rules.after);
        found.push(Release { first, end, turn });
    }
    Ok(found)
}

/// Stretches in which the angle stands at least `least` from `rest`: first and last reading.
fn holds(record: &[Reading], rest: f64, least: f64, rules: &Rules) -> Vec<(usize, usize)> {
    let mut holds: Vec<(usize, usize)> = Vec::new();
    for last in 0..record.len() {
        let first = record[..=last].partition_point(|r| r.time < record[last].time - rules.held);
        let held = &record[first..=last];
        let (low, high) = held.iter().fold((f64::MAX, f64::MIN), |(a, b), r| (a.min(r.angle), b.max(r.angle)));
        let turn = (record[last].angle - rest).abs();
        let long = record[last].time - record[first].time >= 0.8 * rules.held;
        if long && turn >= least && high - low <= rules.stray * turn {
            match holds.last_mut() {
                Some(hold) if first <= hold.1 => hold.1 = last,
                _ => holds.push((first, last)),
            }
        }
    }
    holds
}

/// One past the last reading that is at most `after` later than the last one that strays farther than `gone` from
/// where the end comes to rest.
fn still_from(record: &[Reading], (first, end): (usize, usize), gone: f64, after: f64) -> usize {
    let tail = &record[first + 3 * end.saturating_sub(first) / 4..end];
    let rest = tail.iter().map(|r| r.angle).sum::<f64>() / tail.len().max(1) as f64;
    let Some(last) = (first..end).rev().find(|&i| (record[i].angle - rest).abs() > gone) else { return end };
    record[..end].partition_point(|r| r.time <= record[last].time + after)
}

/// The times of `record` with the readings' own even steps: each is taken a little after its frame, and a millisecond
/// is half a degree of a fast motion. Left as they are where they are on no grid.
pub fn evened(record: &[Reading]) -> Vec<Reading> {
    let gap = |i: usize| record[i].time - record[i - 1].time;
    let mut gaps: Vec<f64> = (1..record.len()).map(gap).collect();
    gaps.sort_by(f64::total_cmp);
    let Some(&median) = gaps.get(gaps.len() / 2) else { return record.to_vec() };
    let mut count = 0.0;
    let mut counts = vec![0.0; record.len()];
    let (mut n, mut sn, mut st, mut snn, mut snt) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in 0..record.len() {
        if i > 0 {
            count += (gap(i) / median).round().max(1.0);
        }
        counts[i] = count;
        let t = record[i].time - record[0].time;
        (n, sn, st, snn, snt) = (n + 1.0, sn + count, st + t, snn + count * count, snt + count * t);
    }
    let step = (n * snt - sn * st) / (n * snn - sn * sn);
    let start = record[0].time + (st - step * sn) / n;
    let even = |i: usize| start + step * counts[i];
    let off = |i: usize| (record[i].time - even(i)).powi(2);
    let irregular = ((0..record.len()).map(off).sum::<f64>() / n).sqrt();
    if irregular.is_nan() || irregular > IRREGULAR * step {
        return record.to_vec();
    }
    record.iter().enumerate().map(|(i, r)| Reading { time: even(i), ..*r }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turned to `turn` at 1 s, held, let go at 2 s with a time constant of 60 ms or ringing at 8 Hz, twice.
    fn record(turn: f64, rings: bool) -> Vec<Reading> {
        let angle = |t: f64| {
            let t = t % 5.0;
            match t {
                _ if t < 1.0 => 0.0,
                _ if t < 1.5 => turn * (t - 1.0) / 0.5,
                _ if t < 2.0 => turn,
                _ if rings => turn * (-1.5 * (t - 2.0)).exp() * (50.0 * (t - 2.0)).cos(),
                _ => turn * (-(t - 2.0) / 0.06).exp(),
            }
        };
        let at = |i: u32| {
            let t = f64::from(i) * 0.01;
            let wobble = 1e-3 * f64::from(i % 3);
            Reading { time: t, angle: 0.3 + angle(t) + wobble, rate: (angle(t + 1e-4) - angle(t - 1e-4)) / 2e-4 }
        };
        (0..1000).map(at).collect()
    }

    #[test]
    fn a_release_begins_where_the_hold_ends_and_ends_before_the_next_turn() {
        for (turn, rings) in [(0.4, false), (-0.4, false), (0.4, true), (-0.2, true)] {
            let record = record(turn, rings);
            let found = releases(&record, &Rules::default()).unwrap();
            assert_eq!(found.len(), 2, "{found:?}");
            for (release, at) in found.iter().zip([2.0, 7.0]) {
                assert!((record[release.first].time - at - 0.02).abs() < 0.021, "{release:?}");
                assert!((release.turn / turn - 1.0).abs() < 0.1);
            }
            assert!(record[found[0].end - 1].time < 6.0);
        }
    }

    #[test]
    fn rest_is_no_release() {
        let quiet = record(0.01, false);
        assert!(matches!(releases(&quiet, &Rules::default()), Err(PluckError::NoExcitation { .. })));
        let mut broken = record(0.4, false);
        broken[7].angle = f64::NAN;
        assert_eq!(releases(&broken, &Rules::default()), Err(PluckError::Reading(7)));
    }
}

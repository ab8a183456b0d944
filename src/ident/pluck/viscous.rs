//! Spring, damper and slip elements from the motion after releases.

use nalgebra::{DMatrix, DVector};

use super::{PluckError, RELEASES_MIN, Reading, Release};
use crate::ident::Measured;
use crate::ident::ringdown::RingDownError;
use crate::ident::sweep::non_negative;

/// How many slip elements there may be: far more than are needed, so that some lie near those that the FREE has.
const ELEMENTS: usize = 24;
/// Their thresholds: from and to this share of the farthest turn. What slips later is a spring here.
const SHORTEST: f64 = 0.01;
const LONGEST: f64 = 0.5;

/// How the FREE comes to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Regime {
    /// It rings.
    Rings {
        /// ct / I, 1/s.
        damping: Measured,
        /// kt / I, 1/s2.
        stiffness: Measured,
        /// By the rates over the angles, Hz.
        frequency: f64,
    },
    /// It creeps back.
    Creeps {
        /// ct / kt, s.
        time: Measured,
    },
}

/// What the releases of one record say.
#[derive(Clone, Debug, PartialEq)]
pub struct PluckFit {
    /// How it comes to rest.
    pub regime: Regime,
    /// Moment of all slip elements when they slip, over kt, rad.
    pub slip: f64,
    /// Root mean square of what is left over, as an angle, rad.
    pub residual: f64,
    /// For each reading of each release its time (s), the moment of spring and elements over kt as the fit has it
    /// (rad), and what inertia and damper ask for (rad): the same but for what is left over.
    pub balance: Vec<(f64, f64, f64)>,
}

/// How well the elements stand for the FREE's friction: standard uncertainty of what it takes, as a share of that. On
/// the simulated FREEs, whose elements are others, 0.7 %.
const LOSS: f64 = 0.01;
/// Least overshoot of a FREE that rings, over the turn: a damping ratio of 0.6.
const OVERSHOOT: f64 = 0.1;

/// Fits `record` (times [`evened`](super::evened)) over its `releases`. `ratio` is I / kt, s2, as far as it is known;
/// the sensor is trusted up to `bandwidth` (Hz).
///
/// # Errors
/// Too few releases, a frequency beyond the sensor, or nothing that a FREE could be.
pub fn fit_plucks(
    record: &[Reading],
    releases: &[Release],
    ratio: f64,
    bandwidth: f64,
) -> Result<PluckFit, PluckError> {
    if releases.len() < RELEASES_MIN {
        return Err(PluckError::Releases { found: releases.len() });
    }
    let motions: Vec<Motion> = releases.iter().map(|r| Motion::of(&record[r.first..r.end], r.turn)).collect();
    let rings = 2 * motions.iter().filter(|m| m.overshoot > OVERSHOOT).count() > motions.len();
    let frequency = median(motions.iter().map(|m| m.frequency));
    // Who cannot see the motion cannot fit it, by whatever means.
    if rings && frequency > bandwidth {
        return Err(RingDownError::BeyondSensor { frequency, bandwidth }.into());
    }
    let motion = if rings { Law::Rings } else { Law::Creeps(ratio) };
    let rows = Rows::new(record, releases, motion);
    let all = rows.solve(None)?;
    let apart: Vec<Solution> =
        (0..releases.len()).map(|left_out| rows.solve(Some(left_out))).collect::<Result<_, _>>()?;
    let estimate = |pick: fn(&Solution) -> f64| jackknife(pick(&all), &apart.iter().map(pick).collect::<Vec<_>>());
    let (mut damping, mut stiffness) = (estimate(|s| s.damping), estimate(|s| s.stiffness));
    if !(damping.value > 0.0 && stiffness.value > 0.0) {
        return Err(PluckError::NoFree { damping: damping.value, stiffness: stiffness.value });
    }
    let slip = all.slip / stiffness.value;
    let widest = releases.iter().map(|r| r.turn.abs()).fold(0.0, f64::max);
    // Friction that begins to slip farther out than the turns reach is a spring to them: anything up to its share.
    let hidden = slip / widest / 12f64.sqrt();
    // The cubic between readings integrates a sinusoid to (w h)^4 / 720, and its rates are those of readings.
    let between = if rings { (std::f64::consts::TAU * frequency * rows.step).powi(4) / 300.0 } else { 0.0 };
    stiffness.uncertainty = stiffness.uncertainty.hypot(hidden.hypot(between) * stiffness.value);
    let model = (LOSS * rows.losses(&all)).hypot(if rings { 0.0 } else { hidden });
    damping.uncertainty = damping.uncertainty.hypot(model * damping.value);
    let regime = match rings {
        true => Regime::Rings { damping, stiffness, frequency },
        false => Regime::Creeps { time: damping },
    };
    let (balance, residual) = rows.balance(&all);
    Ok(PluckFit { regime, slip, residual, balance })
}

/// What can be told of a release at sight.
struct Motion {
    /// Farthest beyond where it comes to rest, over the turn.
    overshoot: f64,
    /// Root mean square of the rates over that of the angles, Hz: of a FREE that rings its frequency, however slowly
    /// it is sampled.
    frequency: f64,
}

impl Motion {
    fn of(alone: &[Reading], turn: f64) -> Self {
        let tail = &alone[3 * alone.len() / 4..];
        let rest = tail.iter().map(|r| r.angle).sum::<f64>() / tail.len().max(1) as f64;
        let beyond = alone.iter().map(|r| -(r.angle - rest) / turn).fold(0.0, f64::max);
        let square = |of: &dyn Fn(&Reading) -> f64| alone.iter().map(|r| of(r).powi(2)).sum::<f64>();
        let ratio = (square(&|r| r.rate) / square(&|r| r.angle - rest)).sqrt();
        Self { overshoot: beyond, frequency: ratio / std::f64::consts::TAU }
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Mean, and its standard uncertainty from the values with one release left out each.
fn jackknife(all: f64, without: &[f64]) -> Measured {
    let n = without.len() as f64;
    let mean = without.iter().sum::<f64>() / n;
    let square = without.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
    Measured { value: all, uncertainty: ((n - 1.0) / n * square).sqrt(), freedom: (without.len() - 1).max(1) }
}

/// How the equations are written.
#[derive(Clone, Copy)]
enum Law {
    /// Over each interval.
    Rings,
    /// At each reading, with I / kt in s2.
    Creeps(f64),
}

/// The equations, those of each release together.
struct Rows {
    /// Columns that may have either sign: of a FREE that rings 3, else 2.
    free: usize,
    rings: bool,
    /// The usual time between readings, s.
    step: f64,
    thresholds: [f64; ELEMENTS],
    /// By release: times, columns and right-hand sides.
    blocks: Vec<(Vec<f64>, DMatrix<f64>, DVector<f64>)>,
}

struct Solution {
    /// ct / I, or ct / kt.
    damping: f64,
    /// kt / I, or one.
    stiffness: f64,
    /// Moment of all elements when they slip, over I or kt.
    slip: f64,
    x: DVector<f64>,
}

impl Rows {
    fn new(record: &[Reading], releases: &[Release], law: Law) -> Self {
        let farthest = releases.iter().map(|r| r.turn.abs()).fold(0.0, f64::max);
        let share = |i: usize| SHORTEST * (LONGEST / SHORTEST).powf(i as f64 / (ELEMENTS - 1) as f64);
        let mut sliders = Sliders { thresholds: std::array::from_fn(|i| farthest * share(i)), at: [0.0; ELEMENTS] };
        let mut record = record.to_vec();
        releases.iter().for_each(|r| fuse(&mut record[r.first..r.end]));
        let record = &record[..];
        // The sliders follow through everything, the hand's part too.
        let steps: Vec<Interval> = record.windows(2).map(|w| Interval::of(w[0], w[1], &mut sliders)).collect();
        let mut gaps: Vec<f64> = steps.iter().map(|s| s.length).collect();
        gaps.sort_by(f64::total_cmp);
        let usual = gaps.get(gaps.len() / 2).copied().unwrap_or(f64::INFINITY);
        let block = |release: &Release| {
            let mut rows: Vec<Vec<f64>> = Vec::new();
            let mut times = Vec::new();
            for k in release.first + 1..release.end - 1 {
                let (before, after) = (&steps[k - 1], &steps[k]);
                // A reading that is missing leaves a gap that no rule bridges.
                if before.length.max(after.length) > 1.5 * usual {
                    continue;
                }
                let b = record[k];
                match law {
                    Law::Rings => {
                        let mut row = vec![after.turn, after.angle, after.length];
                        row.extend(after.strains);
                        row.push(-after.spin);
                        rows.push(row);
                    }
                    Law::Creeps(ratio) => {
                        let acceleration = (before.spin + after.spin) / (before.length + after.length);
                        let mut row = vec![b.rate, 1.0];
                        row.extend(before.last);
                        row.push(-(b.angle + ratio * acceleration));
                        rows.push(row);
                    }
                }
                times.push(b.time);
            }
            let width = rows.first().map_or(1, Vec::len) - 1;
            let columns = DMatrix::from_fn(rows.len(), width, |i, j| rows[i][j]);
            let right = DVector::from_fn(rows.len(), |i, _| rows[i][width]);
            (times, columns, right)
        };
        Self {
            free: if matches!(law, Law::Rings) { 3 } else { 2 },
            rings: matches!(law, Law::Rings),
            step: usual,
            thresholds: sliders.thresholds,
            blocks: releases.iter().map(block).collect(),
        }
    }

    /// All releases but `left_out`.
    fn solve(&self, left_out: Option<usize>) -> Result<Solution, PluckError> {
        let width = self.free + ELEMENTS;
        let (mut gram, mut right) = (DMatrix::zeros(width, width), DVector::zeros(width));
        for (index, (_, columns, values)) in self.blocks.iter().enumerate() {
            if Some(index) != left_out && columns.ncols() == width {
                gram += columns.transpose() * columns;
                right += columns.transpose() * values;
            }
        }
        let x = non_negative(&gram, &right, self.free).ok_or(PluckError::NotConverged)?;
        let weights = x.rows(self.free, ELEMENTS);
        let slip = self.thresholds.iter().zip(weights.iter()).map(|(t, w)| t * w).sum();
        Ok(Solution { damping: x[0], stiffness: if self.rings { x[1] } else { 1.0 }, slip, x })
    }

    /// Energy that friction takes over that which the damper takes.
    fn losses(&self, solution: &Solution) -> f64 {
        let (mut friction, mut viscous) = (0.0, 0.0);
        for (_, columns, _) in self.blocks.iter().filter(|(_, columns, _)| columns.ncols() == solution.x.len()) {
            for row in columns.row_iter() {
                let moment: f64 = (self.free..row.len()).map(|j| row[j] * solution.x[j]).sum();
                // Of a FREE that rings both are integrals over the interval.
                let per = if self.rings { 1.0 / row[2] } else { 1.0 };
                friction += per * moment * row[0];
                viscous += per * solution.damping * row[0] * row[0];
            }
        }
        (friction / viscous).abs()
    }

    /// Both sides of the equation as angles, and the root mean square of their difference.
    fn balance(&self, solution: &Solution) -> (Vec<(f64, f64, f64)>, f64) {
        let mut pairs = Vec::new();
        for (times, columns, values) in self.blocks.iter().filter(|(_, columns, _)| columns.ncols() == solution.x.len())
        {
            let fitted = columns * &solution.x;
            for row in 0..columns.nrows() {
                // Of a FREE that rings the equation is over an interval: the third column is its length.
                let per = if self.rings { 1.0 / (columns[(row, 2)] * solution.stiffness) } else { 1.0 };
                let viscous = columns[(row, 0)] * solution.damping;
                pairs.push((times[row], (fitted[row] - viscous) * per, (values[row] - viscous) * per));
            }
        }
        let square = pairs.iter().map(|(_, a, b)| (a - b).powi(2)).sum::<f64>();
        let residual = (square / pairs.len().max(1) as f64).sqrt();
        (pairs, residual)
    }
}

/// Readings to either side over which an angle is averaged.
const AROUND: usize = 6;

/// Takes the noise out of the angles of an end that moves alone: each becomes the mean of what its neighbours say,
/// carried to it by the rates, which are far less noisy. A slider that is strained by half a degree minds a twentieth.
fn fuse(alone: &mut [Reading]) {
    // Readings are even: the integral of the polynomial through six of them (error (w h)^6 / 300), of four near the
    // ends.
    let rate = |i: usize| alone[i].rate;
    let mut turned = vec![0.0; alone.len()];
    for i in 1..alone.len() {
        let pair = |k: usize| rate(i - 1 - k) + rate(i + k);
        let mean = match i {
            _ if i >= 3 && i + 2 < alone.len() => (802.0 * pair(0) - 93.0 * pair(1) + 11.0 * pair(2)) / 1440.0,
            _ if i >= 2 && i + 1 < alone.len() => (13.0 * pair(0) - pair(1)) / 24.0,
            _ => 0.5 * pair(0),
        };
        turned[i] = turned[i - 1] + mean * (alone[i].time - alone[i - 1].time);
    }
    let fused: Vec<f64> = (0..alone.len())
        .map(|i| {
            let around = i.saturating_sub(AROUND)..(i + AROUND + 1).min(alone.len());
            let count = around.len() as f64;
            around.map(|j| alone[j].angle + turned[i] - turned[j]).sum::<f64>() / count
        })
        .collect();
    alone.iter_mut().zip(fused).for_each(|(reading, angle)| reading.angle = angle);
}

/// Maxwell-slip elements of a weight of one.
struct Sliders {
    /// Strain at which each slips, rad.
    thresholds: [f64; ELEMENTS],
    /// Where each slider stands, rad.
    at: [f64; ELEMENTS],
}

impl Sliders {
    /// Moves the end to `angle` (rad); the strain of each, rad.
    fn follow(&mut self, angle: f64) -> [f64; ELEMENTS] {
        for (slider, x) in self.at.iter_mut().zip(self.thresholds) {
            *slider = slider.clamp(angle - x, angle + x);
        }
        self.at.map(|slider| angle - slider)
    }
}

/// Parts of an interval in which the sliders follow.
const PARTS: u32 = 8;

/// From one reading to the next: the angle is the cubic through both angles with both rates (error of its integral
/// `(w h)^4 / 720`), for at 8 Hz and 100 readings a second a turning point lies well between two readings.
struct Interval {
    /// s.
    length: f64,
    /// By how much the angle and the rate change, rad and rad/s.
    turn: f64,
    spin: f64,
    /// Integrals of the angle (rad s) and of the elements' strains.
    angle: f64,
    strains: [f64; ELEMENTS],
    /// The strains at the end.
    last: [f64; ELEMENTS],
}

impl Interval {
    fn of(a: Reading, b: Reading, sliders: &mut Sliders) -> Self {
        let h = b.time - a.time;
        let path = |u: f64| {
            let (v, w) = (1.0 - u, u * u * (3.0 - 2.0 * u));
            a.angle + (b.angle - a.angle) * w + h * u * v * (a.rate * v - b.rate * u)
        };
        let mut last = sliders.follow(a.angle);
        let mut strains = [0.0; ELEMENTS];
        for part in 1..=PARTS {
            let angle = path(f64::from(part) / f64::from(PARTS));
            let next = sliders.follow(angle);
            for (sum, (x, y)) in strains.iter_mut().zip(last.into_iter().zip(next)) {
                *sum += 0.5 * (x + y) * h / f64::from(PARTS);
            }
            last = next;
        }
        Self {
            length: h,
            turn: b.angle - a.angle,
            spin: b.rate - a.rate,
            angle: 0.5 * h * (a.angle + b.angle) + h * h / 12.0 * (a.rate - b.rate),
            strains,
            last,
        }
    }
}

//! Start values: a bank of damped matched filters.
//!
//! A damped sinusoid of decay d and frequency w, correlated with the samples, explains
//! |sum y exp(-d t - i w t)|^2 / sum exp(-2 d t) of their sum of squares, about twice over. For one d that is a Fourier
//! transform of the samples weighted by the decay; a few d from "hardly decays in the record" to "gone in a sample or
//! two" cover everything. The highest peaks, apart by more than their own width, are the start values: no peak has to
//! be recognised in the time series, and outliers are spread over all frequencies.

use std::f64::consts::TAU;

use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use super::record::Series;

/// From one decay to the next.
const STEP: f64 = 1.7;
/// Points of the transform by samples, at least.
const PADDING: usize = 4;

/// Decay (1/s) and angular frequency (rad/s) of the `count` strongest peaks in `values` (by channel, as long as the
/// series'), the strongest first.
pub(super) fn peaks(series: &[Series], values: &[Vec<f64>], span: f64, count: usize) -> Vec<[f64; 2]> {
    let interval = series.iter().map(|s| s.interval).fold(f64::INFINITY, f64::min);
    let slots = (span / interval).round() as usize + 1;
    let size = (PADDING * slots).next_power_of_two();
    let fft = FftPlanner::new().plan_fft_forward(size);
    let grids: Vec<_> = series.iter().zip(values).map(|(s, v)| grid(s, v, interval, slots)).collect();
    let mut found: Vec<(f64, [f64; 2])> = vec![];
    let mut decay = 0.2 / span;
    while decay * interval < 0.7 {
        let mut gain = vec![0.0; size / 2];
        for grid in &grids {
            let mut buffer = vec![Complex::default(); size];
            let mut energy = 0.0;
            let power = grid.iter().map(|x| x * x).sum::<f64>().max(f64::MIN_POSITIVE);
            for (k, x) in grid.iter().enumerate() {
                let envelope = (-decay * interval * k as f64).exp();
                energy += envelope * envelope;
                buffer[k].re = x * envelope;
            }
            fft.process(&mut buffer);
            gain.iter_mut().zip(&buffer).for_each(|(g, b)| *g += b.norm_sqr() / (energy * power));
        }
        // Below half a turn in the record, and what the offset leaks into, nothing can be told.
        let lowest = (size as f64 * interval / (2.0 * span)).ceil() as usize;
        for k in lowest.max(1)..gain.len() - 1 {
            if gain[k] >= gain[k - 1] && gain[k] > gain[k + 1] {
                found.push((gain[k], [decay, TAU * k as f64 / (size as f64 * interval)]));
            }
        }
        decay *= STEP;
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<[f64; 2]> = vec![];
    for (_, [decay, omega]) in found {
        let apart = |c: &[f64; 2]| (c[1] - omega).abs() > 1.5 * decay.max(c[0]).max(1.0 / span);
        if chosen.len() < count && chosen.iter().all(apart) {
            chosen.push([decay, omega]);
        }
    }
    chosen
}

/// Values in equal slots, the mean of their last third taken off; zero where there is none.
fn grid(series: &Series, values: &[f64], interval: f64, slots: usize) -> Vec<f64> {
    let tail = &values[2 * values.len() / 3..];
    let rest = tail.iter().sum::<f64>() / tail.len().max(1) as f64;
    let mut grid = vec![0.0; slots];
    for (t, v) in series.time.iter().zip(values) {
        if let Some(slot) = grid.get_mut((t / interval).round() as usize) {
            *slot = v - rest;
        }
    }
    grid
}

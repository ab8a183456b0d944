//! Robust spread, correlation of residuals.

/// Rounds of the fixed point of a colour: each leaves about a tenth of what was off.
const ROUNDS: usize = 5;
/// Largest correlation from sample to sample that is told from a drift.
const LAG_MAX: f64 = 0.995;

/// Median; zero of nothing.
pub(super) fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// Value below which the share `q` (0 to 1) lies; zero of nothing.
pub(super) fn quantile(values: &[f64], q: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let mut values = values.to_vec();
    let index = ((values.len() - 1) as f64 * q).round() as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

/// Correlation of a noise: a second-order autoregression, or none.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Colour {
    /// Autocorrelation by lag, from 1 at zero on to where it is gone.
    correlation: Vec<f64>,
    /// Variance of the noise over that which the residuals show, counted as if they were white.
    hidden: f64,
}

impl Colour {
    /// Of what a fit has left over, `basis` being the orthonormal directions that it has taken out of it. A fit takes
    /// more of a slow noise than of a white one: the autoregression is that whose noise, after the fit, would
    /// correlate as the residuals do (a fixed point of its expected second moments). White where no correlation is
    /// beyond chance (three standard deviations).
    pub fn of(residuals: &[f64], basis: &[Vec<f64>]) -> Self {
        let count = residuals.len() as f64;
        let power = lagged(residuals, residuals, 0);
        let white = Self { correlation: vec![1.0], hidden: 1.0 };
        if residuals.len() < 8 || power <= 0.0 {
            return white;
        }
        let seen = [1, 2].map(|k| lagged(residuals, residuals, k) / power);
        if seen[0].abs().max(seen[1].abs()) < 3.0 / count.sqrt() {
            return white;
        }
        let mut lags = seen;
        let mut colour = white;
        for _ in 0..ROUNDS {
            colour.correlation = correlation(lags, residuals.len());
            let left = colour.left(residuals.len(), basis);
            colour.hidden = (count - basis.len() as f64).max(1.0) / left[0];
            lags[0] = (lags[0] + seen[0] - left[1] / left[0]).clamp(-LAG_MAX, LAG_MAX);
            lags[1] = (lags[1] + seen[1] - left[2] / left[0]).clamp(2.0 * lags[0] * lags[0] - 1.0, LAG_MAX);
        }
        colour
    }

    /// Expected sums of products of the residuals at lags 0, 1 and 2, for a noise of variance one: the traces of
    /// S M R M, where R is the noise's correlation, M takes the basis out, S shifts.
    fn left(&self, count: usize, basis: &[Vec<f64>]) -> [f64; 3] {
        let coloured: Vec<Vec<f64>> = basis.iter().map(|q| self.convolve(q)).collect();
        [0, 1, 2].map(|k| {
            let own = (count - k) as f64 * self.correlation.get(k).copied().unwrap_or_default();
            let once: f64 = basis.iter().zip(&coloured).map(|(q, r)| lagged(q, r, k)).sum();
            let pairs = basis.iter().flat_map(|q| basis.iter().zip(&coloured).map(move |(p, r)| (q, p, r)));
            let twice: f64 = pairs.map(|(q, p, r)| lagged(q, p, k) * lagged(q, r, 0)).sum();
            own - 2.0 * once + twice
        })
    }

    fn convolve(&self, x: &[f64]) -> Vec<f64> {
        let at = |i: usize| {
            let lag = |(k, r): (usize, &f64)| {
                let before = if k > 0 { i.checked_sub(k).map_or(0.0, |j| x[j]) } else { 0.0 };
                r * (before + x.get(i + k).copied().unwrap_or_default())
            };
            self.correlation.iter().enumerate().map(lag).sum()
        };
        (0..x.len()).map(at).collect()
    }

    /// How much denser the noise is around the angular frequency `turn` (rad a sample) than a white one of the variance
    /// that the residuals show; at least 1.
    pub fn density(&self, turn: f64) -> f64 {
        let lags = self.correlation.iter().enumerate().skip(1);
        let sum: f64 = lags.map(|(k, r)| 2.0 * r * (k as f64 * turn).cos()).sum();
        (self.hidden * (1.0 + sum)).max(1.0)
    }

    /// How many samples say as much about the noise's variance as one of a white noise.
    pub fn samples(&self) -> f64 {
        1.0 + 2.0 * self.correlation.iter().skip(1).map(|r| r * r).sum::<f64>()
    }
}

/// Autocorrelation of the second-order autoregression with these `lags` 1 and 2 (Yule-Walker), up to `count`.
fn correlation(lags: [f64; 2], count: usize) -> Vec<f64> {
    let below = (1.0 - lags[0] * lags[0]).max(1e-6);
    let (a1, a2) = (lags[0] * (1.0 - lags[1]) / below, (lags[1] - lags[0] * lags[0]) / below);
    let mut all = vec![1.0, lags[0], lags[1]];
    while all.len() < count && all[all.len() - 2..].iter().any(|r| r.abs() > 1e-3) {
        all.push(a1 * all[all.len() - 1] + a2 * all[all.len() - 2]);
    }
    all
}

/// Mean of sum a(i) b(i+k) and sum a(i+k) b(i).
fn lagged(a: &[f64], b: &[f64], k: usize) -> f64 {
    let products = |a: &[f64], b: &[f64]| a.iter().zip(&b[k.min(b.len())..]).map(|(a, b)| a * b).sum::<f64>();
    0.5 * (products(a, b) + products(b, a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_and_colour() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[]), 0.0);
        assert_eq!(quantile(&[4.0, 1.0, 3.0, 2.0, 5.0], 1.0), 5.0);
        // First-order autoregression of 0.5 from a chaotic but fixed sequence: three times white at zero frequency,
        // a third of it at half the sampling rate (never counted as less than white).
        let (mut x, mut y, mut values) = (0.37_f64, 0.0, vec![]);
        for _ in 0..4000 {
            x = (x * 9301.0 + 0.492_97).fract();
            y = 0.5 * y + (x - 0.5);
            values.push(y);
        }
        let colour = Colour::of(&values, &[]);
        // The density at zero has 0.1 of statistical error from 4000 samples.
        assert!((colour.density(0.0) - 3.0).abs() < 0.4, "{colour:?}");
        assert_eq!(colour.density(std::f64::consts::PI), 1.0);
        assert!((colour.samples() - 5.0 / 3.0).abs() < 0.1, "{}", colour.samples());
    }
}

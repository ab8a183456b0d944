//! Robust spread, correlation of residuals, Student's factor.

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

/// How much denser the residuals' noise is around the angular frequency `turn` (rad a sample) than white noise of the
/// same variance: the spectrum of the second-order autoregression that fits them (Yule-Walker), at least 1; exactly 1
/// where no correlation is beyond chance (three standard deviations).
pub(super) fn colour(residuals: &[f64], turn: f64) -> f64 {
    let count = residuals.len() as f64;
    let mean = residuals.iter().sum::<f64>() / count;
    let lag = |k: usize| residuals.iter().zip(&residuals[k..]).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
    let power = lag(0);
    if residuals.len() < 8 || power <= 0.0 {
        return 1.0;
    }
    let (r1, r2) = (lag(1) / power, lag(2) / power);
    if r1.abs().max(r2.abs()) < 3.0 / count.sqrt() {
        return 1.0;
    }
    let below = (1.0 - r1 * r1).max(1e-6);
    let (a1, a2) = (r1 * (1.0 - r2) / below, (r2 - r1 * r1) / below);
    let innovation = (1.0 - a1 * r1 - a2 * r2).max(1e-6);
    let (s1, c1) = turn.sin_cos();
    let (s2, c2) = (2.0 * turn).sin_cos();
    let (re, im) = (1.0 - a1 * c1 - a2 * c2, a1 * s1 + a2 * s2);
    (innovation / (re * re + im * im).max(1e-6)).max(1.0)
}

/// Half-width of a 95 % interval in standard uncertainties: Student's t at 97.5 % for so many degrees of freedom, by
/// the expansion about the normal quantile (Abramowitz and Stegun 26.7.5; under 0.2 % off from five degrees on).
pub fn coverage_factor(freedom: usize) -> f64 {
    let (z, v) = (1.959_963_984_540_054_f64, freedom.max(3) as f64);
    let g1 = (z.powi(3) + z) / 4.0;
    let g2 = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let g3 = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + g1 / v + g2 / v.powi(2) + g3 / v.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_coverage_factor_is_students() {
        // Tables of Student's t, 97.5 %, to three digits; the expansion is 0.2 % low at five.
        for (freedom, t) in [(5, 2.571), (10, 2.228), (30, 2.042), (100, 1.984), (100_000, 1.960)] {
            assert!((coverage_factor(freedom) - t).abs() < 5e-3, "{freedom}");
        }
    }

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
        assert!((colour(&values, 0.0) - 3.0).abs() < 0.4, "{}", colour(&values, 0.0));
        assert_eq!(colour(&values, std::f64::consts::PI), 1.0);
    }
}

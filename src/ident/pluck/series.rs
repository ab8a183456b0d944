//! I, kt and ct from records of the same FREE with different inertias added to its end.

use thiserror::Error;

use crate::ident::Measured;
use crate::ident::ringdown::{SEPARATION_MIN, Torsion};

/// What one record says, with an inertia added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loaded {
    /// Added inertia, kg m2, taken as exact.
    pub added: f64,
    /// ct / I of the whole, 1/s.
    pub damping: Measured,
    /// kt / I of the whole, 1/s2.
    pub stiffness: Measured,
}

/// Why records do not give an inertia.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SeriesError {
    /// One record only.
    #[error("an inertia needs two records with different added inertias; there is one")]
    One,
    /// The added inertias make too little of a difference.
    #[error(
        "the added inertia changes the squared frequency by {0:.1} standard uncertainties only; at least {SEPARATION_MIN} are \
         needed: add more"
    )]
    TooClose(f64),
}

/// Fits I / (kt / I) = (I + a) / kt over the records, and ct from each: 1 / S is a line over the added inertia a, with
/// the slope 1 / kt and the intercept I / kt.
///
/// # Errors
/// Where the records do not tell the line's slope.
pub fn torsion_of_series(records: &[Loaded]) -> Result<Torsion, SeriesError> {
    if records.len() < 2 {
        return Err(SeriesError::One);
    }
    let freedom = records.iter().map(|r| r.stiffness.freedom.min(r.damping.freedom)).min().unwrap_or(1);
    let measured = |value: f64, uncertainty: f64| Measured { value, uncertainty, freedom };
    // y = 1 / S with its variance.
    let points: Vec<(f64, f64, f64)> = records
        .iter()
        .map(|r| {
            let s = r.stiffness;
            (r.added, 1.0 / s.value, (s.uncertainty / s.value.powi(2)).max(1e-9 / s.value))
        })
        .collect();
    let weight = |u: f64| 1.0 / (u * u);
    let (mut w, mut wa, mut wy, mut waa, mut way) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &(a, y, u) in &points {
        let k = weight(u);
        (w, wa, wy, waa, way) = (w + k, wa + k * a, wy + k * y, waa + k * a * a, way + k * a * y);
    }
    let spread = w * waa - wa * wa;
    let (slope, slope_variance) = ((w * way - wa * wy) / spread, w / spread);
    let separation = slope / slope_variance.sqrt();
    if separation.is_nan() || separation < SEPARATION_MIN {
        return Err(SeriesError::TooClose(separation));
    }
    let intercept = (wy - slope * wa) / w;
    let (intercept_variance, covariance) = (waa / spread, -wa / spread);
    // kt = 1 / slope, I = intercept / slope.
    let stiffness = measured(1.0 / slope, slope_variance.sqrt() / slope.powi(2));
    let inertia = intercept / slope;
    let by = (1.0 / slope, -intercept / slope.powi(2));
    let variance = by.0.powi(2) * intercept_variance + by.1.powi(2) * slope_variance + 2.0 * by.0 * by.1 * covariance;
    let inertia = measured(inertia, variance.max(0.0).sqrt());
    // ct = d (I + a) = d kt / S of each record; kt is common to all, so its own uncertainty does not average out.
    let relative =
        |r: &Loaded| (r.damping.uncertainty / r.damping.value).hypot(r.stiffness.uncertainty / r.stiffness.value);
    let of = |r: &Loaded| r.damping.value * stiffness.value / r.stiffness.value;
    let (sum, total) = records.iter().fold((0.0, 0.0), |(sum, total), r| {
        let k = weight((relative(r) * of(r)).max(f64::MIN_POSITIVE));
        (sum + k * of(r), total + k)
    });
    let damping = sum / total;
    // Records that disagree by more than they say.
    let chi = records.iter().map(|r| ((of(r) - damping) / (relative(r) * of(r))).powi(2)).sum::<f64>();
    let inflation = (chi / (records.len() - 1) as f64).max(1.0).sqrt();
    let own = inflation / total.sqrt();
    Ok(Torsion {
        damping: measured(damping, own.hypot(damping * stiffness.uncertainty / stiffness.value)),
        stiffness,
        inertia,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(added: f64, unsure: f64) -> Loaded {
        let (i, kt, ct) = (1.4e-6, 0.086, 4e-5);
        let whole = i + added;
        let about = |x: f64| Measured { value: x, uncertainty: unsure * x, freedom: 5 };
        Loaded { added, damping: about(ct / whole), stiffness: about(kt / whole) }
    }

    #[test]
    fn exact_records_give_the_exact_free() {
        let found = torsion_of_series(&[record(0.0, 1e-3), record(1e-5, 2e-3), record(3e-5, 1e-3)]).unwrap();
        assert!((found.inertia.value / 1.4e-6 - 1.0).abs() < 1e-9, "{found:?}");
        assert!((found.stiffness.value / 0.086 - 1.0).abs() < 1e-9);
        assert!((found.damping.value / 4e-5 - 1.0).abs() < 1e-9);
        assert!(found.stiffness.uncertainty > 0.0 && found.damping.uncertainty > 0.0);
    }

    #[test]
    fn too_little_of_a_difference_is_no_inertia() {
        assert_eq!(torsion_of_series(&[record(0.0, 1e-3)]), Err(SeriesError::One));
        let close = torsion_of_series(&[record(0.0, 1e-2), record(1e-8, 1e-2)]);
        assert!(matches!(close, Err(SeriesError::TooClose(_))), "{close:?}");
    }
}

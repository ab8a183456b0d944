//! kt and ct from a mode and an inertia, known or found with an added one.

use thiserror::Error;

use super::decay::Mode;
use crate::ident::Measured;

/// Fewest standard uncertainties by which an added inertia must lower the square of the frequency.
pub const SEPARATION_MIN: f64 = 5.0;

/// Spring, damper and inertia that ring like the mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torsion {
    /// kt, N m/rad.
    pub stiffness: Measured,
    /// ct, N m s/rad.
    pub damping: Measured,
    /// I, kg m2.
    pub inertia: Measured,
}

/// Why two ring-downs do not give an inertia.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TorsionError {
    /// The inertia that was added is not positive.
    #[error("the added inertia must be positive; it is {0} kg m2")]
    Added(f64),
    /// The frequencies are too close.
    #[error(
        "the added inertia lowers the squared frequency by {0} standard uncertainties only; at least {SEPARATION_MIN} \
         are needed: add more"
    )]
    TooClose(f64),
}

impl Mode {
    /// kt = I (d^2 + w^2) and ct = 2 I d, with the uncertainties of the mode and of `inertia` (kg m2).
    pub fn torsion(&self, inertia: Measured) -> Torsion {
        let square = self.square();
        let stiffness = inertia.value * square.value;
        let damping = 2.0 * inertia.value * self.decay.value;
        let freedom = self.decay.freedom.min(inertia.freedom);
        let measured = |value, uncertainty| Measured { value, uncertainty, freedom };
        Torsion {
            stiffness: measured(
                stiffness,
                (inertia.value * square.uncertainty).hypot(square.value * inertia.uncertainty),
            ),
            damping: measured(
                damping,
                (2.0 * inertia.value * self.decay.uncertainty).hypot(2.0 * self.decay.value * inertia.uncertainty),
            ),
            inertia,
        }
    }
}

/// Inertia, kt and ct from two ring-downs of the same FREE, `bare` and with `added` inertia (kg m2) at its end:
/// with S = d^2 + w^2 of each, kt = I S0 = (I + added) S1.
pub fn torsion_from_added(bare: &Mode, loaded: &Mode, added: Measured) -> Result<Torsion, TorsionError> {
    if added.value.is_nan() || added.value <= 0.0 {
        return Err(TorsionError::Added(added.value));
    }
    let (s0, s1) = (bare.square(), loaded.square());
    let apart = s0.value - s1.value;
    let separation = apart / s0.uncertainty.hypot(s1.uncertainty);
    if separation.is_nan() || separation <= SEPARATION_MIN {
        return Err(TorsionError::TooClose(separation));
    }
    let ratio = s1.value / apart;
    let inertia = added.value * ratio;
    // Derivatives of I by S0 and S1.
    let (by_0, by_1) = (-added.value * s1.value / apart.powi(2), added.value * s0.value / apart.powi(2));
    let variance = |a: f64, b: f64, c: f64| {
        ((a * s0.uncertainty).powi(2) + (b * s1.uncertainty).powi(2) + (c * added.uncertainty).powi(2)).sqrt()
    };
    let decay = bare.decay.value;
    // ct = 2 I d0, and I moves with d0 and w0 through S0.
    let by_decay = 2.0 * inertia + 2.0 * decay * by_0 * 2.0 * decay;
    let by_omega = 2.0 * decay * by_0 * 2.0 * bare.omega.value;
    let own = (by_decay * bare.decay.uncertainty).powi(2)
        + (by_omega * bare.omega.uncertainty).powi(2)
        + 2.0 * by_decay * by_omega * bare.covariance;
    let others = (2.0 * decay * by_1 * s1.uncertainty).powi(2) + (2.0 * decay * ratio * added.uncertainty).powi(2);
    let freedom = s0.freedom.min(s1.freedom).min(added.freedom);
    let measured = |value, uncertainty| Measured { value, uncertainty, freedom };
    Ok(Torsion {
        stiffness: measured(inertia * s0.value, variance(inertia + s0.value * by_0, s0.value * by_1, s0.value * ratio)),
        damping: measured(2.0 * inertia * decay, (own + others).max(0.0).sqrt()),
        inertia: measured(inertia, variance(by_0, by_1, ratio)),
    })
}

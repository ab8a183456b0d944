//! Physical quantities: SI inside, the user's units at the edges.
//!
//! A quantity is written as a number followed by its unit, `7psi`, `-40deg`, `130 mm`. A bare number is an
//! error that names the accepted units. Pressures are gauge.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// Pascals in one pound per square inch (exact to the digits of the international avoirdupois pound).
pub const PASCAL_PER_PSI: f64 = 6894.757293168;

/// A quantity that could not be read: what was written, and which units are accepted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ParseQuantityError {
    /// A number without a unit.
    #[error("{quantity} `{text}` has no unit; write one of: {accepted} (for example `{example}`)")]
    MissingUnit { quantity: &'static str, text: String, accepted: String, example: String },
    /// A unit that this quantity does not have.
    #[error("{quantity} `{text}` has the unknown unit `{unit}`; accepted: {accepted}")]
    UnknownUnit { quantity: &'static str, text: String, unit: String, accepted: String },
    /// Not a finite number.
    #[error("{quantity} `{text}` does not begin with a finite number; write for example `{example}`")]
    NotANumber { quantity: &'static str, text: String, example: String },
}

/// Splits `text` into its number and its unit.
fn split(text: &str) -> (&str, &str) {
    let text = text.trim();
    // The exponent's `e` belongs to the number only where a digit or a signed digit follows it.
    let bytes = text.as_bytes();
    let mut end = 0;
    while end < bytes.len() {
        let c = bytes[end];
        let exponent = matches!(c, b'e' | b'E')
            && end > 0
            && (bytes.get(end + 1).is_some_and(u8::is_ascii_digit)
                || (matches!(bytes.get(end + 1), Some(b'+' | b'-'))
                    && bytes.get(end + 2).is_some_and(u8::is_ascii_digit)));
        let sign = matches!(c, b'+' | b'-') && (end == 0 || matches!(bytes[end - 1], b'e' | b'E'));
        if c.is_ascii_digit() || c == b'.' || exponent || sign {
            end += 1;
        } else {
            break;
        }
    }
    (&text[..end], text[end..].trim())
}

fn parse(quantity: &'static str, units: &[(&str, f64)], text: &str) -> Result<f64, ParseQuantityError> {
    let accepted = || units.iter().map(|u| u.0).collect::<Vec<_>>().join(", ");
    let example = |number: &str| format!("{number}{}", units[0].0);
    let (number, unit) = split(text);
    let value = match number.parse::<f64>() {
        Ok(v) if v.is_finite() => v,
        _ => {
            return Err(ParseQuantityError::NotANumber { quantity, text: text.into(), example: example("1") });
        }
    };
    if unit.is_empty() {
        return Err(ParseQuantityError::MissingUnit {
            quantity,
            text: text.into(),
            accepted: accepted(),
            example: example(number),
        });
    }
    match units.iter().find(|u| u.0 == unit) {
        Some(&(_, factor)) => Ok(value * factor),
        None => Err(ParseQuantityError::UnknownUnit {
            quantity,
            text: text.into(),
            unit: unit.into(),
            accepted: accepted(),
        }),
    }
}

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident, $noun:literal, $si:ident, [$(($unit:literal, $factor:expr)),+ $(,)?]) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        pub struct $name(f64);

        impl $name {
            /// Unit names accepted in text, the one used for display first, each with its size in SI.
            pub const UNITS: &'static [(&'static str, f64)] = &[$(($unit, $factor)),+];

            /// The quantity of `value` SI units.
            pub const fn $si(value: f64) -> Self {
                Self(value)
            }

            /// The value in SI units.
            pub const fn si(self) -> f64 {
                self.0
            }

            /// The value in the unit used for display.
            pub fn display_value(self) -> f64 {
                self.0 / Self::UNITS[0].1
            }
        }

        impl FromStr for $name {
            type Err = ParseQuantityError;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                parse($noun, Self::UNITS, text).map(Self)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                let value = self.display_value();
                match f.precision() {
                    Some(p) => write!(f, "{value:.p$} {}", Self::UNITS[0].0),
                    None => write!(f, "{} {}", (value * 1e6).round() / 1e6, Self::UNITS[0].0),
                }
            }
        }
    };
}

quantity!(
    /// Gauge pressure. SI: Pa.
    Pressure, "pressure", pascals,
    [("psi", PASCAL_PER_PSI), ("Pa", 1.0), ("kPa", 1e3), ("MPa", 1e6), ("mbar", 100.0), ("bar", 1e5)]
);
quantity!(
    /// Rate of change of pressure. SI: Pa/s.
    PressureRate, "pressure rate", pascals_per_second,
    [("psi/s", PASCAL_PER_PSI), ("Pa/s", 1.0), ("kPa/s", 1e3), ("bar/s", 1e5)]
);
quantity!(
    /// Plane angle, right-handed about the axis it belongs to. SI: rad.
    Angle, "angle", radians,
    [("deg", std::f64::consts::PI / 180.0), ("rad", 1.0), ("mrad", 1e-3)]
);
quantity!(
    /// Length. SI: m.
    Length, "length", metres,
    [("mm", 1e-3), ("m", 1.0), ("cm", 1e-2), ("um", 1e-6), ("in", 0.0254)]
);
quantity!(
    /// Duration as a real number; may be negative in arithmetic, never where a duration is asked. SI: s.
    Seconds, "time", of,
    [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("h", 3600.0)]
);
quantity!(
    /// Frequency. SI: Hz.
    Frequency, "frequency", hertz,
    [("Hz", 1.0), ("kHz", 1e3), ("mHz", 1e-3)]
);
quantity!(
    /// Force. SI: N.
    Force, "force", newtons,
    [("N", 1.0), ("mN", 1e-3), ("kN", 1e3)]
);
quantity!(
    /// Moment of force. SI: N m.
    Moment, "moment", newton_metres,
    [("Nm", 1.0), ("mNm", 1e-3), ("Nmm", 1e-3)]
);
quantity!(
    /// Mass. SI: kg.
    Mass, "mass", kilograms,
    [("g", 1e-3), ("kg", 1.0)]
);
quantity!(
    /// Acceleration. SI: m/s2.
    Acceleration, "acceleration", metres_per_second_squared,
    [("m/s2", 1.0), ("mm/s2", 1e-3)]
);

quantity!(
    /// Temperature on the Celsius scale; the degree Celsius is a unit of the SI. SI: degC.
    Temperature, "temperature", celsius,
    [("degC", 1.0)]
);

quantity!(
    /// A share of a whole. SI: 1.
    Percent, "share", of_one,
    [("%", 0.01), ("ppm", 1e-6)]
);

impl Pressure {
    /// The pressure of `psi` pounds per square inch.
    pub const fn psi(psi: f64) -> Self {
        Self(psi * PASCAL_PER_PSI)
    }
}

impl Angle {
    /// The angle of `degrees`.
    pub const fn degrees(degrees: f64) -> Self {
        Self(degrees * (std::f64::consts::PI / 180.0))
    }
}

impl Length {
    /// The length of `mm` millimetres.
    pub const fn millimetres(mm: f64) -> Self {
        Self(mm * 1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantity_is_a_number_with_its_unit() {
        assert_eq!("7psi".parse::<Pressure>().unwrap().si(), 7.0 * PASCAL_PER_PSI);
        assert_eq!("-40deg".parse::<Angle>().unwrap().si(), (-40f64).to_radians());
        assert_eq!(" 130 mm".parse::<Length>().unwrap().si(), 0.13);
        assert_eq!("1.5e3Pa".parse::<Pressure>().unwrap().si(), 1500.0);
        assert_eq!("1e-3 rad".parse::<Angle>().unwrap().si(), 1e-3);
        assert_eq!("10ms".parse::<Seconds>().unwrap().si(), 0.01);
    }

    #[test]
    fn a_bare_number_is_refused_with_the_units_that_are_accepted() {
        let error = "7".parse::<Pressure>().unwrap_err().to_string();
        assert!(error.contains("no unit") && error.contains("psi, Pa, kPa") && error.contains("`7psi`"), "{error}");
        let error = "7furlong".parse::<Length>().unwrap_err().to_string();
        assert!(error.contains("furlong") && error.contains("mm"), "{error}");
        for text in ["", "psi", "nanpsi", "infpsi", "--3psi", "1e400psi"] {
            assert!(text.parse::<Pressure>().is_err(), "{text}");
        }
    }

    #[test]
    fn display_uses_the_users_unit() {
        assert_eq!(Pressure::psi(7.25).to_string(), "7.25 psi");
        assert_eq!(format!("{:.1}", Angle::degrees(-40.0)), "-40.0 deg");
    }
}

//! Keys carry their unit in their name: `max_pressure_psi`, `length_mm`. What the suffixes mean, and which key a
//! misspelt one was meant to be.

use std::f64::consts::PI;

use crate::units::PASCAL_PER_PSI;

/// A suffix, its dimension, and its size in SI.
type Suffix = (&'static str, &'static str, f64);

/// Suffixes of keys; a longer one comes before any that it ends with.
const SUFFIXES: &[Suffix] = &[
    // Gains and stiffnesses.
    ("_pa_per_rad_s", "integral gain", 1.0),
    ("_pa_s_per_rad", "derivative gain", 1.0),
    ("_pa_per_rad", "proportional gain", 1.0),
    ("_n_per_m", "stiffness", 1.0),
    ("_nm_per_rad", "torsional stiffness", 1.0),
    ("_ns_per_m", "damping", 1.0),
    ("_nms_per_rad", "torsional damping", 1.0),
    ("_kg_m2", "inertia", 1.0),
    ("_psi_per_s", "pressure rate", PASCAL_PER_PSI),
    ("_kpa_per_s", "pressure rate", 1e3),
    ("_pa_per_code", "pressure per code", 1.0),
    ("_deg_per_s", "angular rate", PI / 180.0),
    // Plain quantities.
    ("_mpa", "pressure", 1e6),
    ("_kpa", "pressure", 1e3),
    ("_mbar", "pressure", 100.0),
    ("_bar", "pressure", 1e5),
    ("_psi", "pressure", PASCAL_PER_PSI),
    ("_pa", "pressure", 1.0),
    ("_deg", "angle", PI / 180.0),
    ("_rad", "angle", 1.0),
    ("_degc", "temperature", 1.0),
    ("_mm2", "area", 1e-6),
    ("_mm", "length", 1e-3),
    ("_cm", "length", 1e-2),
    ("_mnm", "moment", 1e-3),
    ("_nm", "moment", 1.0),
    ("_kg", "mass", 1.0),
    ("_g", "mass", 1e-3),
    ("_hz", "frequency", 1.0),
    ("_ms", "time", 1e-3),
    ("_us", "time", 1e-6),
    ("_percent", "fraction", 1e-2),
    ("_mib", "memory", 1024.0 * 1024.0),
    ("_bd", "line rate", 1.0),
    ("_n", "force", 1.0),
    ("_m", "length", 1.0),
    ("_s", "time", 1.0),
];

/// Splits a key into its stem and its unit.
pub(super) fn split(key: &str) -> (&str, Option<&'static Suffix>) {
    match SUFFIXES.iter().find(|suffix| key.ends_with(suffix.0)) {
        Some(suffix) => (&key[..key.len() - suffix.0.len()], Some(suffix)),
        None => (key, None),
    }
}

/// The suffixes of a dimension.
pub(super) fn units(dimension: &str) -> impl Iterator<Item = &'static str> {
    SUFFIXES.iter().filter(move |suffix| suffix.1 == dimension).map(|suffix| suffix.0)
}

/// Size in SI of the unit that `key` carries; 1 where it carries none.
pub(super) fn scale(key: &str) -> f64 {
    split(key).1.map_or(1.0, |suffix| suffix.2)
}

/// What to write instead of the unknown key `written`, out of the `known` ones. `number` is its value, where it
/// is one, so that a value in another unit can be converted.
pub(super) fn suggestion(written: &str, number: Option<f64>, known: &[&str]) -> String {
    let (stem, unit) = split(written);
    let same_quantity = known.iter().find(|key| {
        let known_stem = split(key).0;
        split(key).1.is_some() && (known_stem == stem || known_stem == written)
    });
    if let Some(key) = same_quantity {
        let to = split(key).1;
        return match (unit, to, number) {
            (Some(from), Some(to), Some(number)) if from.1 == to.1 => {
                format!("write `{key} = {}`: the unit is part of the key's name", round(number * from.2 / to.2))
            }
            _ => format!("write `{key}`: the unit is part of the key's name"),
        };
    }
    let nearest = known.iter().map(|key| (distance(written, key), key)).min();
    match nearest {
        Some((edits, key)) if edits <= 1 + key.len() / 4 => format!("did you mean `{key}`?"),
        _ if known.is_empty() => "remove it".into(),
        _ => {
            let mut keys: Vec<_> = known.to_vec();
            keys.sort_unstable();
            format!("remove it; known here: {}", keys.join(", "))
        }
    }
}

/// Six significant digits are enough for a remedy.
fn round(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Edit distance (insertions, deletions, replacements) between two words.
pub(crate) fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_suffix_is_the_unit() {
        assert_eq!(scale("max_pressure_psi"), PASCAL_PER_PSI);
        assert_eq!(scale("slew_psi_per_s"), PASCAL_PER_PSI);
        assert_eq!(scale("length_mm"), 1e-3);
        assert_eq!(scale("integral_pa_per_rad_s"), 1.0);
        assert_eq!(scale("delay_ms"), 1e-3);
        assert_eq!(scale("address"), 1.0);
    }

    #[test]
    fn no_suffix_is_hidden_by_an_earlier_one() {
        for (suffix, ..) in SUFFIXES {
            let key = format!("key{suffix}");
            assert_eq!(split(&key).1.map(|s| s.0), Some(*suffix), "{key}");
        }
    }

    #[test]
    fn a_key_in_another_unit_is_converted() {
        let known = ["max_pressure_psi", "slew_psi_per_s"];
        assert!(suggestion("max_pressure_bar", Some(0.689_475_729_316_8), &known).contains("max_pressure_psi = 10`"));
        assert!(suggestion("max_pressure", Some(10.0), &known).starts_with("write `max_pressure_psi`"));
        assert!(suggestion("max_presure_psi", None, &known).contains("did you mean `max_pressure_psi`"));
        assert!(suggestion("colour", None, &known).contains("known here: max_pressure_psi, slew_psi_per_s"));
    }
}

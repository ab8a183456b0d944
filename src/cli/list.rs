//! Quantities of one kind in a row: a point, a force, four pressures.

use std::str::FromStr;

use crate::units::ParseQuantityError;

/// `N` quantities, written one after the other with commas between: `0mm,-5mm,130mm`. Each has its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct List<Q, const N: usize>(pub [Q; N]);

impl<Q, const N: usize> FromStr for List<Q, N>
where
    Q: FromStr<Err = ParseQuantityError>,
{
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found: Result<Vec<Q>, _> = text.split(',').map(str::parse).collect();
        let found = found.map_err(|error| error.to_string())?;
        let count = found.len();
        let list = found.try_into().map(List);
        list.map_err(|_| format!("`{text}` has {count} of {N} values: write {N}, each with its unit, commas between"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{Force, Length};

    #[test]
    fn a_list_has_its_number_of_values_each_with_its_unit() {
        let List([x, y, z]) = "-0.1N, 0N,20mN".parse::<List<Force, 3>>().unwrap();
        assert_eq!([x.si(), y.si(), z.si()], [-0.1, 0.0, 0.02]);
        let error = "1mm,2mm".parse::<List<Length, 3>>().unwrap_err();
        assert!(error.contains("2 of 3 values"), "{error}");
        let error = "1mm,2mm,3".parse::<List<Length, 3>>().unwrap_err();
        assert!(error.contains("`3` has no unit") && error.contains("mm, m"), "{error}");
    }
}

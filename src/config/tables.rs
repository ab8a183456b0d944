//! Tables that a model or a plan is asked for: rows of four pressures, points over time.
//!
//! CSV, as [`super::columns`] has it: names with units in the first line, other columns allowed, `#` before a comment.

use std::path::Path;

use super::columns::Columns;
use super::problem::{ConfigError, Problem};

/// The columns of the four pressures.
const PRESSURES: [&str; 4] = ["a", "b", "c", "d"];

/// Where a tip should be, and when.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Waypoints {
    /// s, rising.
    pub times: Vec<f64>,
    /// m.
    pub positions: Vec<[f64; 3]>,
}

/// The rows of `path`, gauge pressures of A, B, C, D, Pa: columns `a_psi`, `b_psi`, `c_psi`, `d_psi`, or in any other
/// unit of pressure (`a_pa`, `a_kpa`, ...).
///
/// # Errors
/// Everything that is wrong with the table.
pub fn pressure_rows(path: &Path) -> Result<Vec<[f64; 4]>, ConfigError> {
    let wanted = "column of pressures for each of A, B, C, D (`a_psi,b_psi,c_psi,d_psi`, or _pa, _kpa, _bar, ...)";
    let [a, b, c, d] = columns(&read(path)?, PRESSURES, "pressure", wanted)?;
    Ok((0..a.len()).map(|i| [a[i], b[i], c[i], d[i]]).collect())
}

/// The points of `path`: columns `t_s`, `x_mm`, `y_mm`, `z_mm`, or in other units of time and length.
///
/// # Errors
/// Everything that is wrong with the table.
pub fn waypoints(path: &Path) -> Result<Waypoints, ConfigError> {
    let table = read(path)?;
    let [times] = columns(&table, ["t"], "time", "column of times (`t_s`)")?;
    let wanted = "column of each coordinate (`x_mm,y_mm,z_mm`)";
    let [x, y, z] = columns(&table, ["x", "y", "z"], "length", wanted)?;
    if let Some(i) = (1..times.len()).find(|&i| times[i] <= times[i - 1]) {
        let rule = format!("must be later than the time of the row before, {} s", times[i - 1]);
        let remedy = "sort the rows by time, and keep one of each";
        return Err(ConfigError { problems: vec![table.row_problem(i, "t_s", times[i], &rule, remedy)] });
    }
    let positions = (0..times.len()).map(|i| [x[i], y[i], z[i]]).collect();
    Ok(Waypoints { times, positions })
}

fn read(path: &Path) -> Result<Columns, ConfigError> {
    Columns::read(path).map_err(|problems| ConfigError { problems })
}

/// The columns `stems` of `table`, SI, all of them or what is wrong.
fn columns<const N: usize>(
    table: &Columns,
    stems: [&str; N],
    dimension: &str,
    wanted: &str,
) -> Result<[Vec<f64>; N], ConfigError> {
    let mut problems: Vec<Problem> = Vec::new();
    let found = stems.map(|stem| table.quantity(stem, dimension, &mut problems));
    if problems.is_empty() && found.iter().any(Option::is_none) {
        table.lacks(wanted, &mut problems);
    }
    if problems.is_empty() { Ok(found.map(Option::unwrap_or_default)) } else { Err(ConfigError { problems }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::PASCAL_PER_PSI as PSI;

    fn with<T>(text: &str, read: fn(&Path) -> Result<T, ConfigError>) -> Result<T, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn rows_of_pressures_name_their_units() {
        let rows = with("t_s,a_psi,b_psi,c_pa,d_kpa\n0,1,2,3,4\n", pressure_rows);
        assert_eq!(rows, Ok(vec![[PSI, 2.0 * PSI, 3.0, 4000.0]]));
        for (text, words) in [
            ("a_psi,b_psi,c_psi\n1,2,3\n", &["A, B, C, D", "it has: a_psi, b_psi, c_psi"][..]),
            ("a,b,c,d\n1,2,3,4\n", &["unit of pressure", "`a_psi`"]),
            ("1,2,3,4\n", &["must name the columns"]),
            ("a_psi,b_psi,c_psi,d_psi\n1,2,3,x\n", &[":2:", "d_psi = x", "must be a number"]),
            ("a_psi,b_psi,c_psi,d_psi\n", &["no rows"]),
        ] {
            let error = with(text, pressure_rows).unwrap_err();
            assert!(words.iter().all(|word| error.contains(word)), "{text}: {error}");
        }
    }

    #[test]
    fn waypoints_rise_in_time() {
        let points = with("t_s,x_mm,y_mm,z_mm\n0,0,1,130\n0.5,2,1,130\n", waypoints).unwrap();
        assert_eq!((points.times, points.positions[1]), (vec![0.0, 0.5], [2e-3, 1e-3, 0.13]));
        let error = with("t_ms,x_mm,y_mm,z_mm\n0,0,1,130\n5,0,0,0\n5,2,1,130\n", waypoints).unwrap_err();
        assert!(error.contains(":4:") && error.contains("must be later"), "{error}");
        let error = with("t_s,x_mm,y_mm\n0,0,1\n", waypoints).unwrap_err();
        assert!(error.contains("x_mm,y_mm,z_mm"), "{error}");
    }
}

//! Tables of numbers: CSV files as a testing machine or a spreadsheet writes them.
//!
//! The first line that is neither empty nor begins with `#` names the columns, and every name ends in its unit:
//! `elongation_mm,force_n`. Columns that nobody asks for may be there. Cells are separated by commas, decimals by
//! points.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::key;
use super::problem::Problem;

/// Most problems of one file that are listed: a file in the wrong format has one in every cell.
const LISTED: usize = 20;

/// A table of numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Columns {
    path: PathBuf,
    names: Vec<String>,
    /// Line of the names.
    header: usize,
    /// Line and cells of every row.
    rows: Vec<(usize, Vec<f64>)>,
    /// SHA-256 of the file, hexadecimal.
    pub(super) sha256: String,
}

impl Columns {
    /// Reads the file `path`, or says everything that is wrong with it.
    pub(super) fn read(path: &Path) -> Result<Self, Vec<Problem>> {
        let bytes = std::fs::read(path).map_err(|error| {
            let remedy = "name a file that exists; the paths in a script are relative to its folder";
            vec![problem(path, None, "", "", &format!("cannot read the table: {error}"), remedy)]
        })?;
        let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let text = String::from_utf8_lossy(&bytes);
        // A spreadsheet's byte-order mark is no part of the first name.
        let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
        let mut lines = lines.by_ref().filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let Some((header, first)) = lines.next() else {
            return Err(vec![problem(path, None, "", "", "the table is empty", "name a file with a line of names")]);
        };
        let names: Vec<String> = cells(first).map(|name| name.trim_matches('"').to_owned()).collect();
        if names.iter().any(|name| name.parse::<f64>().is_ok()) {
            let rule = "the first line must name the columns, each with its unit";
            let remedy = "write for example `elongation_mm,force_n` above the numbers";
            return Err(vec![problem(path, Some(header), "", first, rule, remedy)]);
        }
        let mut table = Self { path: path.to_owned(), names, header, rows: Vec::new(), sha256 };
        let mut problems = Vec::new();
        for (line, text) in lines {
            table.row(line, text, &mut problems);
        }
        if table.rows.is_empty() && problems.is_empty() {
            let (rule, remedy) = ("the table has names, and no rows", "write values under the names, row by row");
            problems.push(problem(path, Some(header), "", first, rule, remedy));
        }
        problems.truncate(LISTED);
        if problems.is_empty() { Ok(table) } else { Err(problems) }
    }

    fn row(&mut self, line: usize, text: &str, problems: &mut Vec<Problem>) {
        let row: Vec<&str> = cells(text).collect();
        if row.len() != self.names.len() {
            let rule = format!("{} cells under {} names", row.len(), self.names.len());
            let remedy = "separate cells by commas and decimals by points, one cell under each name";
            problems.push(problem(&self.path, Some(line), "", text, &rule, remedy));
            return;
        }
        let mut numbers = Vec::with_capacity(row.len());
        for (cell, name) in row.into_iter().zip(&self.names) {
            match cell.parse::<f64>() {
                Ok(number) if number.is_finite() => numbers.push(number),
                _ => {
                    let remedy = "correct the cell, or remove the line (or put a # before it)";
                    problems.push(problem(&self.path, Some(line), name, cell, "must be a number", remedy));
                }
            }
        }
        self.rows.push((line, numbers));
    }

    /// The column of the quantity `stem`, in SI; `None` where there is none. `dimension` is what its unit must be of,
    /// empty for a quantity that has none (`percent` will do).
    pub(super) fn quantity(&self, stem: &str, dimension: &str, problems: &mut Vec<Problem>) -> Option<Vec<f64>> {
        let fits = |name: &str| {
            let found = key::split(name).1.map_or("", |unit| unit.1);
            found == dimension || (dimension.is_empty() && found == "fraction")
        };
        let called: Vec<_> = self.names.iter().enumerate().filter(|(_, name)| key::split(name).0 == stem).collect();
        let mut fitting = called.iter().filter(|(_, name)| fits(name));
        let &(index, name) = fitting.next().or(called.first())?;
        if let Some((_, other)) = fitting.next() {
            let rule = format!("says the same as the column `{name}`");
            let remedy = format!("remove one of the two, or rename it: `{stem}` is read from one column");
            problems.push(problem(&self.path, Some(self.header), other, "", &rule, &remedy));
            return None;
        }
        if !fits(name) {
            let (rule, remedy) = match dimension {
                "" => ("must be without a unit".to_owned(), format!("name the column `{stem}`")),
                _ => {
                    let known = key::units(dimension).map(|unit| format!("`{stem}{unit}`")).collect::<Vec<_>>();
                    (format!("must name a unit of {dimension}"), format!("name the column one of {}", known.join(", ")))
                }
            };
            problems.push(problem(&self.path, Some(self.header), name, "", &rule, &remedy));
            return None;
        }
        let scale = key::scale(name);
        Some(self.rows.iter().map(|(_, row)| row[index] * scale).collect())
    }

    /// Notes that the table has none of the columns that are `wanted`.
    pub(super) fn lacks(&self, wanted: &str, problems: &mut Vec<Problem>) {
        let rule = format!("the table has no {wanted}; it has: {}", self.names.join(", "));
        problems.push(problem(&self.path, Some(self.header), "", "", &rule, "name the columns so, with their units"));
    }

    /// Notes every value of the column `stem` that is not above `least`; `values` are in SI.
    pub(super) fn above(&self, stem: &str, values: &[f64], least: f64, problems: &mut Vec<Problem>) {
        for ((line, _), value) in self.rows.iter().zip(values).filter(|(_, value)| **value <= least).take(LISTED) {
            let rule = format!("must be above {least} (SI)");
            let remedy = "correct the value or its unit, or remove the line";
            problems.push(problem(&self.path, Some(*line), stem, &format!("{value}"), &rule, remedy));
        }
    }

    /// What is wrong with `value` (SI) under `name` in the row `index`.
    pub(super) fn row_problem(&self, index: usize, name: &str, value: f64, rule: &str, remedy: &str) -> Problem {
        problem(&self.path, self.rows.get(index).map(|row| row.0), name, &value.to_string(), rule, remedy)
    }

    /// The line of every row.
    pub(super) fn lines(&self) -> Vec<usize> {
        self.rows.iter().map(|row| row.0).collect()
    }
}

fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(str::trim)
}

fn problem(file: &Path, line: Option<usize>, key: &str, value: &str, rule: &str, remedy: &str) -> Problem {
    let value = value.chars().take(60).collect();
    Problem { file: file.to_owned(), line, key: key.into(), value, rule: rule.into(), remedy: remedy.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Columns, Vec<Problem>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        std::fs::write(&path, text).unwrap();
        Columns::read(&path)
    }

    #[test]
    fn names_carry_units_and_what_is_not_asked_for_may_be_there() {
        let table = read("# machine 3\n\n\"time_s\", elongation_mm ,force_n\r\n0,0,0\n1, 2.5 ,1e1\n").unwrap();
        let mut problems = Vec::new();
        assert_eq!(table.quantity("elongation", "length", &mut problems), Some(vec![0.0, 2.5e-3]));
        assert_eq!(table.quantity("force", "force", &mut problems), Some(vec![0.0, 10.0]));
        assert_eq!(table.quantity("stress", "pressure", &mut problems), None);
        assert_eq!((table.lines(), problems.len(), table.sha256.len()), (vec![4, 5], 0, 64));
    }

    #[test]
    fn whatever_is_wrong_is_named_with_its_line_and_column() {
        let problems = read("stretch,stress_mpa\n1,0\n1.1,x\n1,2,3\n1.2,nan\n").unwrap_err();
        let said: Vec<_> = problems.iter().map(ToString::to_string).collect();
        assert_eq!(problems.iter().map(|p| p.line).collect::<Vec<_>>(), [Some(3), Some(4), Some(5)]);
        assert!(said[0].contains("stress_mpa = x: must be a number"), "{said:?}");
        assert!(said[1].contains("3 cells under 2 names"), "{said:?}");
        assert!(read("1,2\n").unwrap_err()[0].rule.contains("must name the columns"));
        assert!(read("").unwrap_err()[0].rule.contains("empty"));
        let bare = &read("stretch,stress_mpa\n").unwrap_err()[0];
        assert!(bare.rule.contains("no rows") && bare.remedy.contains("under the names"), "{bare}");
        let table = read("stretch_mm,stress,force_mm\n1,2,3\n").unwrap();
        let mut problems = Vec::new();
        for (stem, dimension) in [("stretch", ""), ("stress", "pressure"), ("force", "force")] {
            assert_eq!(table.quantity(stem, dimension, &mut problems), None);
        }
        let said: Vec<_> = problems.iter().map(ToString::to_string).collect();
        assert!(said[0].contains("without a unit") && said[1].contains("`stress_mpa`"), "{said:?}");
        assert!(said[2].contains("`force_n`") && said[2].contains(":1:"), "{said:?}");
    }

    #[test]
    fn a_quantity_that_two_columns_have_is_refused_and_one_of_another_dimension_is_none_of_it() {
        let table = read("a_psi,t_degc,t_s,a_kpa\n1,20,2,3\n").unwrap();
        let mut problems = Vec::new();
        assert_eq!(table.quantity("t", "time", &mut problems), Some(vec![2.0]));
        assert_eq!((table.quantity("a", "pressure", &mut problems), problems.len()), (None, 1));
        let said = problems[0].to_string();
        assert!(said.contains("a_kpa") && said.contains("`a_psi`") && said.contains("remove one"), "{said}");
    }
}

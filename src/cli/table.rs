//! Tables as text: columns as wide as they need, two spaces between them, numbers to the right.

use std::fmt;

/// A table; the last column may be of any width.
#[derive(Clone, Debug, Default)]
pub struct Table {
    columns: Vec<(String, bool)>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these columns; a name that begins with `>` is aligned to the right.
    pub fn new(columns: &[&str]) -> Self {
        let column = |name: &&str| match name.strip_prefix('>') {
            Some(name) => (name.to_owned(), true),
            None => ((*name).to_owned(), false),
        };
        Self { columns: columns.iter().map(column).collect(), rows: Vec::new() }
    }

    /// Appends a row; a cell that is missing is empty.
    pub fn row(&mut self, cells: impl IntoIterator<Item = impl Into<String>>) {
        self.rows.push(cells.into_iter().map(|cell| one_line(&cell.into())).collect());
    }
}

/// A table keeps its lines, whatever a user writes into a note.
fn one_line(text: &str) -> String {
    text.split(char::is_control).map(str::trim).filter(|piece| !piece.is_empty()).collect::<Vec<_>>().join(" ")
}

/// `value` with that many digits; `-` where there is none, and no sign on a zero.
pub fn number(value: Option<f64>, digits: usize) -> String {
    let Some(value) = value else { return "-".into() };
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.chars().all(|c| c == '0' || c == '.') => zero.to_owned(),
        _ => text,
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cell = |row: &Vec<String>, i: usize| row.get(i).cloned().unwrap_or_default();
        let header: Vec<String> = self.columns.iter().map(|(name, _)| name.clone()).collect();
        let lines = || std::iter::once(&header).chain(&self.rows);
        let width = |i: usize| lines().map(|row| cell(row, i).chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        for (n, row) in lines().enumerate() {
            let mut line = String::new();
            for (i, (width, (_, right))) in widths.iter().zip(&self.columns).enumerate() {
                let text = cell(row, i);
                let text = if *right { format!("{text:>width$}") } else { format!("{text:<width$}") };
                line.push_str(&text);
                line.push_str("  ");
            }
            if n > 0 {
                writeln!(f)?;
            }
            f.write_str(line.trim_end())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_has_no_negative_zero() {
        assert_eq!(number(Some(-1e-9), 3), "0.000");
        assert_eq!(number(Some(-0.0012), 3), "-0.001");
        assert_eq!(number(None, 3), "-");
        assert_eq!(number(Some(f64::NAN), 1), "NaN");
    }

    #[test]
    fn columns_line_up_and_a_note_cannot_break_them() {
        let mut table = Table::new(&["run", ">RMS", "note"]);
        table.row(["a", "1.25 deg", "first\nline\tand \u{1b}[31mmore"]);
        table.row(["longer", "10.50 deg"]);
        let expected = "run           RMS  note\na        1.25 deg  first line and [31mmore\nlonger  10.50 deg";
        assert_eq!(table.to_string(), expected);
    }
}

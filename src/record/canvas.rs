//! What every plot draws upon: size, colours, legend, mesh, axes.

use std::ops::Range;

use plotters::chart::MeshStyle;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{RecordError, Result};

/// Width of every plot, pixels.
pub(super) const WIDTH: u32 = 960;
/// Space left of the axis, the same in all plots so that their times line up.
pub(super) const LEFT: u32 = 64;
pub(super) const LEGEND_ROW: u32 = 22;
pub(super) const FONT: &str = "system-ui, sans-serif";

const GRID: RGBColor = RGBColor(0xE3, 0xE6, 0xEA);
const AXIS: RGBColor = RGBColor(0xA0, 0xA7, 0xB0);
pub(super) const TEXT: RGBColor = RGBColor(0x3A, 0x42, 0x4C);

pub(super) fn color(rgb: u32) -> RGBColor {
    RGBColor((rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8)
}

pub(super) fn plot_error(error: impl std::fmt::Display) -> RecordError {
    RecordError::Plot(error.to_string())
}

/// Lets the drawing fill the width it is given, by its view box.
pub(super) fn fluid(svg: String) -> String {
    let Some(end) = svg.find('>') else { return svg };
    let tag = &svg[..end];
    let tag = match (tag.find("width=\""), tag.find("viewBox")) {
        (Some(from), Some(to)) if from < to => format!("{}{}", &tag[..from], &tag[to..]),
        _ => tag.to_owned(),
    };
    format!("{tag} role=\"img\"{}", &svg[end..])
}

/// How the legend shows an entry.
pub(super) enum Mark {
    Line(u32),
    Dashes,
    Band,
}

pub(super) fn legend<'a>(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    entries: impl Iterator<Item = (&'a str, u32, Mark)>,
) -> Result<()> {
    let style = (FONT, 13).into_font().color(&TEXT).pos(Pos::new(HPos::Left, VPos::Center));
    let (mut x, mut y) = (LEFT as i32, 14);
    for (label, rgb, mark) in entries.filter(|e| !e.0.is_empty()) {
        if x > LEFT as i32 && x + legend_width(label) > WIDTH as i32 {
            (x, y) = (LEFT as i32, y + LEGEND_ROW as i32);
        }
        let line = |from: i32, to: i32, width: u32| {
            PathElement::new([(x + from, y), (x + to, y)], color(rgb).stroke_width(width))
        };
        match mark {
            Mark::Line(width) => area.draw(&line(0, 22, width)).map_err(plot_error)?,
            Mark::Dashes => {
                for from in [0, 8, 16] {
                    area.draw(&line(from, from + 5, 2)).map_err(plot_error)?;
                }
            }
            Mark::Band => {
                let swatch = Rectangle::new([(x, y - 6), (x + 22, y + 6)], color(rgb).mix(0.45).filled());
                area.draw(&swatch).map_err(plot_error)?;
            }
        }
        area.draw(&Text::new(label.to_owned(), (x + 28, y), style.clone())).map_err(plot_error)?;
        x += legend_width(label);
    }
    Ok(())
}

/// Pixels that an entry of the legend takes, the distance to the next included; about 7 a letter.
fn legend_width(label: &str) -> i32 {
    28 + 7 * label.chars().count() as i32 + 20
}

/// Rows that the legend takes.
pub(super) fn legend_rows<'a>(labels: impl Iterator<Item = &'a String>) -> usize {
    let (mut rows, mut x) = (1, LEFT as i32);
    for label in labels.filter(|l| !l.is_empty()) {
        if x > LEFT as i32 && x + legend_width(label) > WIDTH as i32 {
            (rows, x) = (rows + 1, LEFT as i32);
        }
        x += legend_width(label);
    }
    rows
}

pub(super) type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

pub(super) fn mesh(chart: &mut Chart<'_, '_>, x: &str, y: &str) -> Result<()> {
    styled(&mut chart.configure_mesh()).x_desc(x).y_desc(y).draw().map_err(plot_error)
}

/// `mesh` with the lines and labels that every plot has.
pub(super) fn styled<'m, 'a, 'b, X: Ranged, Y: Ranged, D: DrawingBackend>(
    mesh: &'m mut MeshStyle<'a, 'b, X, Y, D>,
) -> &'m mut MeshStyle<'a, 'b, X, Y, D> {
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(AXIS)
        .label_style((FONT, 13).into_font().color(&TEXT))
}

/// An axis whose marks are written with as many digits as their distance needs.
pub(super) struct Axis(RangedCoordf64);

impl Axis {
    pub(super) fn new(range: Range<f64>) -> Self {
        Self(range.into())
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.0.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.0.key_points(hint)
    }

    fn range(&self) -> Range<f64> {
        self.0.range()
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        let range = self.range();
        let digits = (1.0 - (range.end - range.start).abs().log10()).ceil().clamp(0.0, 9.0) as usize;
        let text = format!("{value:.digits$}");
        // A rounded negative zero is a zero.
        if text.trim_start_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').into() } else { text }
    }
}

/// From the least to the greatest of `values`, with a share of `margin` at either end.
pub(super) fn span<'a>(values: impl Iterator<Item = &'a f64>, margin: f64) -> Range<f64> {
    let (low, high) =
        values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &v| (a.min(v), b.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let size = if high - low > 1e-12 * high.abs().max(1e-9) { high - low } else { high.abs().max(1.0) * 0.1 };
    let pad = if high - low > 0.0 { margin * size } else { 0.5 * size };
    low - pad..high + pad
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_have_the_digits_that_they_need() {
        let mark = |range: Range<f64>, v: f64| Axis::new(range).format_ext(&v);
        assert_eq!(mark(0.0..9.0, 2.0), "2.0");
        assert_eq!(mark(0.0..90.0, 20.0), "20");
        assert_eq!(mark(-0.02..0.02, -0.0), "0.000");
    }
}

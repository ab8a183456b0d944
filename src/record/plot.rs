//! Plots as SVG text: lines over a grid with a legend above it, bars, and lanes of states. Text stays text.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{RecordError, Result, palette};

/// Width of every plot, pixels.
pub(super) const WIDTH: u32 = 960;
/// Space left of the axis, the same in all plots so that their times line up.
pub(super) const LEFT: u32 = 64;
pub(super) const LEGEND_ROW: u32 = 22;
pub(super) const FONT: &str = "system-ui, sans-serif";

/// A line of a plot.
#[derive(Clone, Debug)]
pub struct Line {
    /// What the legend calls it; empty keeps it out.
    pub label: String,
    /// 0xRRGGBB.
    pub rgb: u32,
    /// Pixels.
    pub width: u32,
    /// Drawn in dashes.
    pub dashed: bool,
    /// Horizontal values, in the order they are to be joined.
    pub x: Vec<f64>,
    /// Vertical values; not a number leaves a gap.
    pub y: Vec<f64>,
}

impl Line {
    /// A solid line.
    pub fn new(label: &str, rgb: u32, x: &[f64], y: Vec<f64>) -> Self {
        Self { label: label.into(), rgb, width: 2, dashed: false, x: x.to_vec(), y }
    }

    /// The same, dashed.
    pub fn dashed(self) -> Self {
        Self { dashed: true, ..self }
    }

    /// The same, thinner or thicker.
    pub fn width(self, width: u32) -> Self {
        Self { width, ..self }
    }
}

/// A filled band between two curves over the same x.
#[derive(Clone, Debug)]
pub struct Band {
    /// What the legend calls it.
    pub label: String,
    /// 0xRRGGBB.
    pub rgb: u32,
    /// Increasing horizontal values.
    pub x: Vec<f64>,
    /// Lower edge.
    pub low: Vec<f64>,
    /// Upper edge.
    pub high: Vec<f64>,
}

/// A plot of lines.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// From, to; by default what the lines need.
    pub x_range: Option<(f64, f64)>,
    /// Height, pixels.
    pub height: u32,
    /// The same scale on both axes, as a map has it: the ranges are what the lines need, the one widened.
    pub square: bool,
    /// Behind the lines.
    pub bands: Vec<Band>,
    /// Drawn in this order.
    pub lines: Vec<Line>,
    /// Moments to be noticed: where, colour, text.
    pub marks: Vec<(f64, u32, String)>,
}

/// `x` and `y` widened about their middles until `x` is `aspect` times as long as `y`.
fn alike(x: Range<f64>, y: Range<f64>, aspect: f64) -> (Range<f64>, Range<f64>) {
    let widened = |range: Range<f64>, length: f64| {
        let middle = 0.5 * (range.start + range.end);
        middle - 0.5 * length..middle + 0.5 * length
    };
    let scale = ((x.end - x.start) / aspect).max(y.end - y.start);
    (widened(x, scale * aspect), widened(y, scale))
}

impl Plot {
    /// The plot as an `<svg>` element.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let lines: Vec<Line> = self.lines.iter().map(thinned).collect();
        let x = self.x_range.map_or_else(|| span(lines.iter().flat_map(|l| &l.x), 0.0), |(a, b)| a..b);
        let within = |l: &Line| {
            let x = x.clone();
            l.x.clone()
                .into_iter()
                .zip(l.y.clone())
                .filter(move |(at, _)| *at >= x.start && *at <= x.end)
                .map(|(_, y)| y)
        };
        let mut values: Vec<f64> = lines.iter().flat_map(within).collect();
        values.extend(self.bands.iter().flat_map(|b| b.low.iter().chain(&b.high)));
        let y = span(values.iter(), 0.06);
        let (x, y) =
            if self.square { alike(x, y, f64::from(WIDTH - LEFT - 16) / f64::from(self.height - 76)) } else { (x, y) };
        let mut svg = String::new();
        let names = self.bands.iter().map(|b| &b.label).chain(lines.iter().map(|l| &l.label));
        let legend_height = LEGEND_ROW * (legend_rows(names).max(1) as u32) + 8;
        // The legend's further rows are not taken from the drawing.
        let height = self.height + legend_height - LEGEND_ROW - 8;
        {
            let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
            let bands = self.bands.iter().map(|b| (b.label.as_str(), b.rgb, Mark::Band));
            let mark = |l: &Line| if l.dashed { Mark::Dashes } else { Mark::Line(l.width) };
            let entries = bands.chain(lines.iter().map(|l| (l.label.as_str(), l.rgb, mark(l))));
            legend(&area, entries)?;
            let mut chart = ChartBuilder::on(&area)
                .margin_top(legend_height)
                .margin_right(16)
                .x_label_area_size(38)
                .y_label_area_size(LEFT)
                .build_cartesian_2d(Axis::new(x.clone()), Axis::new(y.clone()))
                .map_err(plot_error)?;
            mesh(&mut chart, &self.x_label, &self.y_label)?;
            for band in &self.bands {
                let edge = band.x.iter().zip(&band.high).chain(band.x.iter().zip(&band.low).rev());
                let polygon = edge.map(|(&x, &y)| (x, y)).filter(|(_, y)| y.is_finite()).collect::<Vec<_>>();
                chart.draw_series([Polygon::new(polygon, color(band.rgb).mix(0.2).filled())]).map_err(plot_error)?;
            }
            for line in &lines {
                let style = color(line.rgb).stroke_width(line.width);
                for piece in pieces(line, &x) {
                    if line.dashed {
                        chart.draw_series(DashedLineSeries::new(piece, 7, 5, style)).map_err(plot_error)?;
                    } else {
                        chart.draw_series(LineSeries::new(piece, style)).map_err(plot_error)?;
                    }
                }
            }
            for (at, rgb, text) in self.marks.iter().filter(|m| x.contains(&m.0)) {
                let line = [(*at, y.start), (*at, y.end)];
                chart
                    .draw_series(DashedLineSeries::new(line, 3, 3, color(*rgb).stroke_width(1)))
                    .map_err(plot_error)?;
                // On the side where there is room.
                let (side, gap) = if *at > f64::midpoint(x.start, x.end) { (HPos::Right, -5) } else { (HPos::Left, 5) };
                let (left, top) = chart.backend_coord(&line[1]);
                let style = (FONT, 12).into_font().color(&color(*rgb)).pos(Pos::new(side, VPos::Top));
                area.draw(&Text::new(text.clone(), (left + gap, top + 3), style)).map_err(plot_error)?;
            }
            area.present().map_err(plot_error)?;
        }
        Ok(fluid(svg))
    }
}

/// One bar: from, to, count.
pub type Bar = (f64, f64, u64);

/// Bars from zero, one series before the other, both axes logarithmic.
#[derive(Clone, Debug, Default)]
pub struct Bars {
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// Height, pixels.
    pub height: u32,
    /// What each series is called, its colour, and its bars.
    pub series: Vec<(String, u32, Vec<Bar>)>,
}

impl Bars {
    /// The plot as an `<svg>` element.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let bars = || self.series.iter().flat_map(|s| &s.2);
        let edges: Vec<f64> = bars().flat_map(|b| [b.0, b.1]).collect();
        let x = if edges.is_empty() { 1.0..1000.0 } else { span(edges.iter(), 0.0) };
        let most = bars().map(|b| b.2).max().unwrap_or(1).max(1) as f64;
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, (WIDTH, self.height)).into_drawing_area();
            legend(&area, self.series.iter().map(|s| (s.0.as_str(), s.1, Mark::Band)))?;
            let mut chart = ChartBuilder::on(&area)
                .margin_top(LEGEND_ROW + 8)
                .margin_right(16)
                .x_label_area_size(38)
                .y_label_area_size(LEFT)
                .build_cartesian_2d(x.log_scale(), (0.7..most * 1.5).log_scale())
                .map_err(plot_error)?;
            chart
                .configure_mesh()
                .light_line_style(TRANSPARENT)
                .bold_line_style(GRID)
                .axis_style(AXIS)
                .label_style((FONT, 13).into_font().color(&TEXT))
                .x_label_formatter(&|v| format!("{v}"))
                .y_label_formatter(&|v| format!("{v}"))
                .x_desc(self.x_label.as_str())
                .y_desc("ticks")
                .draw()
                .map_err(plot_error)?;
            for (_, rgb, bars) in &self.series {
                let style = color(*rgb).mix(0.55).filled();
                chart
                    .draw_series(
                        bars.iter()
                            .filter(|b| b.2 > 0)
                            .map(|&(from, to, n)| Rectangle::new([(from, 0.7), (to, n as f64)], style)),
                    )
                    .map_err(plot_error)?;
            }
            area.present().map_err(plot_error)?;
        }
        Ok(fluid(svg))
    }
}

/// One lane: its name, and what held from when to when.
#[derive(Clone, Debug, Default)]
pub struct Lane {
    /// What the lane is about.
    pub name: String,
    /// From, to, colour, text.
    pub spans: Vec<(f64, f64, u32, String)>,
}

/// Lanes of states over time.
#[derive(Clone, Debug, Default)]
pub struct Lanes {
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// From, to.
    pub x_range: (f64, f64),
    /// From the top.
    pub lanes: Vec<Lane>,
}

impl Lanes {
    /// The plot as an `<svg>` element.
    ///
    /// # Errors
    /// Where it cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        const LANE: u32 = 26;
        let count = self.lanes.len();
        let height = 10 + LANE * count as u32 + 40;
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
            let names = 170;
            let mut chart = ChartBuilder::on(&area)
                .margin_top(10)
                .margin_right(16)
                .x_label_area_size(38)
                .y_label_area_size(names)
                .build_cartesian_2d(Axis::new(self.x_range.0..self.x_range.1), 0.0..count as f64)
                .map_err(plot_error)?;
            chart
                .configure_mesh()
                .disable_y_mesh()
                .y_labels(0)
                .light_line_style(TRANSPARENT)
                .bold_line_style(GRID)
                .axis_style(AXIS)
                .label_style((FONT, 13).into_font().color(&TEXT))
                .x_desc(self.x_label.as_str())
                .draw()
                .map_err(plot_error)?;
            let label = (FONT, 13).into_font().color(&TEXT);
            for (i, lane) in self.lanes.iter().enumerate() {
                let (top, bottom) = (count as f64 - i as f64 - 0.1, count as f64 - i as f64 - 0.9);
                for (from, to, rgb, text) in &lane.spans {
                    let (from, to) = (from.max(self.x_range.0), to.min(self.x_range.1));
                    if to <= from {
                        continue;
                    }
                    chart
                        .draw_series([Rectangle::new([(from, bottom), (to, top)], color(*rgb).mix(0.75).filled())])
                        .map_err(plot_error)?;
                    // Only where it has room; about 7 pixels a letter.
                    let pixels = (to - from) / (self.x_range.1 - self.x_range.0) * f64::from(WIDTH - names - 16);
                    if pixels > 7.0 * text.len() as f64 + 8.0 {
                        let (x, y) = chart.backend_coord(&(from, f64::midpoint(top, bottom)));
                        let style = (FONT, 12).into_font().color(&WHITE).pos(Pos::new(HPos::Left, VPos::Center));
                        area.draw(&Text::new(text.clone(), (x + 5, y), style)).map_err(plot_error)?;
                    }
                }
                let (_, y) = chart.backend_coord(&(self.x_range.0, f64::midpoint(top, bottom)));
                let style = label.pos(Pos::new(HPos::Right, VPos::Center));
                area.draw(&Text::new(lane.name.clone(), (names as i32 - 8, y), style)).map_err(plot_error)?;
            }
            area.present().map_err(plot_error)?;
        }
        Ok(fluid(svg))
    }
}

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
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(AXIS)
        .label_style((FONT, 13).into_font().color(&TEXT))
        .x_desc(x)
        .y_desc(y)
        .draw()
        .map_err(plot_error)
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
fn span<'a>(values: impl Iterator<Item = &'a f64>, margin: f64) -> Range<f64> {
    let (low, high) =
        values.filter(|v| v.is_finite()).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &v| (a.min(v), b.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let size = if high - low > 1e-12 * high.abs().max(1e-9) { high - low } else { high.abs().max(1.0) * 0.1 };
    let pad = if high - low > 0.0 { margin * size } else { 0.5 * size };
    low - pad..high + pad
}

/// The same curve with as many points as pixels can show: the extremes of every pixel's width.
fn thinned(line: &Line) -> Line {
    const BUCKETS: usize = WIDTH as usize;
    let n = line.x.len().min(line.y.len());
    if n <= 4 * BUCKETS {
        return line.clone();
    }
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for bucket in 0..BUCKETS {
        let (from, to) = (bucket * n / BUCKETS, (bucket + 1) * n / BUCKETS);
        let pick = |better: fn(f64, f64) -> bool| {
            (from..to)
                .filter(|&i| line.y[i].is_finite())
                .reduce(|a, b| if better(line.y[b], line.y[a]) { b } else { a })
        };
        let mut keep = vec![from];
        keep.extend(pick(|a, b| a < b));
        keep.extend(pick(|a, b| a > b));
        keep.push(to - 1);
        keep.sort_unstable();
        keep.dedup();
        x.extend(keep.iter().map(|&i| line.x[i]));
        y.extend(keep.iter().map(|&i| line.y[i]));
    }
    Line { x, y, ..line.clone() }
}

/// The unbroken parts of `line` within `x`.
fn pieces(line: &Line, x: &Range<f64>) -> Vec<Vec<(f64, f64)>> {
    let mut pieces = vec![Vec::new()];
    for (&at, &y) in line.x.iter().zip(&line.y) {
        let inside = at >= x.start && at <= x.end && y.is_finite();
        match (inside, pieces.last_mut()) {
            (true, Some(piece)) => piece.push((at, y)),
            (false, Some(piece)) if !piece.is_empty() => pieces.push(Vec::new()),
            _ => {}
        }
    }
    pieces.retain(|p| p.len() > 1);
    pieces
}

/// Colour of a state of the life cycle, by its stable number.
pub fn state_color(state: u8) -> u32 {
    [
        palette::GREY,
        palette::GREY,
        palette::YELLOW,
        palette::BLUE,
        palette::GREEN,
        palette::PURPLE,
        palette::YELLOW,
        palette::ORANGE,
        palette::RED,
    ]
    .get(usize::from(state))
    .copied()
    .unwrap_or(palette::GREY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_is_text_with_its_labels_and_keeps_the_extremes_of_long_curves() {
        let n = 100_000;
        let x: Vec<f64> = (0..n).map(f64::from).collect();
        let y: Vec<f64> = (0..n).map(|i| if i == 54_321 { 1000.0 } else { 0.0 }).collect();
        let line = Line::new("spike & more", palette::BLUE, &x, y);
        assert!(thinned(&line).y.contains(&1000.0) && thinned(&line).x.len() < 4 * WIDTH as usize);
        let plot = Plot {
            x_label: "time [s]".into(),
            y_label: "y [deg]".into(),
            height: 300,
            lines: vec![line],
            ..Plot::default()
        };
        let svg = plot.svg().unwrap();
        assert!(svg.starts_with("<svg") && svg.len() < 200_000);
        for text in ["time [s]", "y [deg]", "spike &amp; more", "viewBox"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn nothing_to_draw_is_an_empty_plot() {
        let line = Line::new("nothing", palette::BLUE, &[], Vec::new());
        assert!(Plot { height: 200, lines: vec![line], ..Plot::default() }.svg().is_ok());
        assert!(Bars { height: 200, ..Bars::default() }.svg().is_ok());
        assert!(Lanes { x_range: (0.0, 1.0), lanes: vec![Lane::default()], ..Lanes::default() }.svg().is_ok());
    }

    #[test]
    fn not_a_number_leaves_a_gap() {
        let line = Line::new("", 0, &[0.0, 1.0, 2.0, 3.0, 4.0], vec![1.0, 1.0, f64::NAN, 2.0, 2.0]);
        assert_eq!(pieces(&line, &(0.0..4.0)).len(), 2);
    }

    #[test]
    fn marks_have_the_digits_that_they_need() {
        let mark = |range: Range<f64>, v: f64| Axis::new(range).format_ext(&v);
        assert_eq!(mark(0.0..9.0, 2.0), "2.0");
        assert_eq!(mark(0.0..90.0, 20.0), "20");
        assert_eq!(mark(-0.02..0.02, -0.0), "0.000");
    }
}

//! Lines over a grid with a legend above it, as SVG text. Text stays text.

use std::ops::Range;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::Result;
use super::canvas::{
    Axis, FONT, LEFT, LEGEND_ROW, Mark, WIDTH, color, fluid, legend, legend_rows, mesh, plot_error, span,
};

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

#[cfg(test)]
mod tests {
    use super::super::bars::Bars;
    use super::super::lanes::{Lane, Lanes};
    use super::super::palette;
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
}

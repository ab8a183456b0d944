//! Curves in space, seen from above (x and y) and from the side (x and z), to one scale.
//!
//! At the end of a curve that belongs to pressurised FREEs stands their indicator: the four FREEs as they stand seen
//! from above, A at the upper right, those under pressure filled.

use std::ops::Range;

use plotters::prelude::*;

use super::canvas::{Axis, Chart, LEGEND_ROW, Mark, WIDTH, color, fluid, legend, legend_rows, mesh, plot_error};
use super::{Result, palette};

/// Space left of a view's axis and under it, right of it, pixels.
const SIDE: u32 = 56;
const BELOW: u32 = 38;
const RIGHT: u32 = 14;
/// Height of the views, at most and at least, pixels.
const HEIGHTS: (f64, f64) = (430.0, 220.0);
/// Share of the extent that is left free on every side: there indicators stand.
const MARGIN: f64 = 0.16;
/// Radius of an indicator's circle, distance of two of them, half the side of the square kept free, pixels.
const RADIUS: i32 = 3;
const PITCH: i32 = 8;
const HALF: i32 = 10;
/// Directions and distances at which an indicator may stand from its curve's end, pixels.
const DIRECTIONS: usize = 24;
const DISTANCES: [f64; 6] = [16.0, 24.0, 34.0, 46.0, 60.0, 76.0];

/// A curve in space.
#[derive(Clone, Debug, Default)]
pub struct Curve {
    /// What the legend calls it; empty keeps it out.
    pub label: String,
    /// 0xRRGGBB.
    pub rgb: u32,
    /// Drawn in dashes.
    pub dashed: bool,
    /// m.
    pub points: Vec<[f64; 3]>,
    /// Which of A, B, C, D it belongs to, for the indicator at its end.
    pub on: Option<[bool; 4]>,
    /// It ends before its time: a cross.
    pub ended: bool,
}

/// Two views of curves.
#[derive(Clone, Debug, Default)]
pub struct Views {
    /// Drawn in this order.
    pub curves: Vec<Curve>,
    /// What lies around them, and its outlines in x and y, and in x and z, m.
    pub outline: Option<(String, [Vec<[f64; 2]>; 2])>,
}

/// The coordinates of each view.
const PLANES: [([usize; 2], [&str; 2]); 2] = [([0, 1], ["x (mm)", "y (mm)"]), ([0, 2], ["x (mm)", "z (mm)"])];
const MM: f64 = 1e3;

impl Views {
    /// The views as an `<svg>` element.
    ///
    /// # Errors
    /// Where they cannot be drawn.
    pub fn svg(&self) -> Result<String> {
        let outline = self.outline.iter().map(|(label, _)| (label, palette::METAL));
        let mut entries: Vec<(&str, u32, Mark)> = outline.map(|(l, rgb)| (l.as_str(), rgb, Mark::Band)).collect();
        for curve in &self.curves {
            if !entries.iter().any(|(label, ..)| *label == curve.label) {
                entries.push((&curve.label, curve.rgb, if curve.dashed { Mark::Dashes } else { Mark::Line(2) }));
            }
        }
        let labels: Vec<String> = entries.iter().map(|(label, ..)| (*label).to_owned()).collect();
        let legend_height = LEGEND_ROW * legend_rows(labels.iter()).max(1) as u32 + 8;
        let panel = WIDTH / 2;
        let width = f64::from(panel - SIDE - RIGHT);
        // One scale, one height: x is the same in both, the rest fills the height.
        let ranges = PLANES.map(|(axes, _)| axes.map(|axis| self.range(axis)));
        let [wide, high] = [0, 1].map(|i| ranges.iter().map(|r| r[i].end - r[i].start).fold(0.0, f64::max));
        let height = (width * high / wide).clamp(HEIGHTS.1, HEIGHTS.0);
        let scale = (width / wide).min(height / high);
        let mut svg = String::new();
        {
            let whole = legend_height + height as u32 + BELOW;
            let area = SVGBackend::with_string(&mut svg, (WIDTH, whole)).into_drawing_area();
            legend(&area, entries.into_iter())?;
            let (_, below) = area.split_vertically(legend_height);
            let (left, right) = below.split_horizontally(panel);
            for (i, panel) in [left, right].iter().enumerate() {
                let (axes, names) = PLANES[i];
                let [x, y] = [(0, width), (1, height)].map(|(k, pixels)| {
                    let middle = f64::midpoint(ranges[i][k].start, ranges[i][k].end);
                    middle - 0.5 * pixels / scale..middle + 0.5 * pixels / scale
                });
                let mut chart = ChartBuilder::on(panel)
                    .margin_right(RIGHT)
                    .x_label_area_size(BELOW)
                    .y_label_area_size(SIDE)
                    .build_cartesian_2d(Axis::new(x), Axis::new(y))
                    .map_err(plot_error)?;
                mesh(&mut chart, names[0], names[1])?;
                if let Some((_, outlines)) = &self.outline {
                    let corners: Vec<(f64, f64)> = outlines[i].iter().map(|p| (MM * p[0], MM * p[1])).collect();
                    let metal = color(palette::METAL);
                    chart.draw_series([Polygon::new(corners.clone(), metal.mix(0.22).filled())]).map_err(plot_error)?;
                    let closed = corners.iter().chain(corners.first()).copied();
                    chart.draw_series(LineSeries::new(closed, metal.stroke_width(1))).map_err(plot_error)?;
                }
                let mut ends = Vec::new();
                for curve in &self.curves {
                    let points: Vec<(f64, f64)> =
                        curve.points.iter().map(|p| (MM * p[axes[0]], MM * p[axes[1]])).collect();
                    let style = color(curve.rgb).stroke_width(2);
                    if curve.dashed {
                        chart.draw_series(DashedLineSeries::new(points.clone(), 7, 5, style)).map_err(plot_error)?;
                    } else {
                        chart.draw_series(LineSeries::new(points.clone(), style)).map_err(plot_error)?;
                    }
                    if let Some(end) = points.last() {
                        ends.push((curve, chart.backend_coord(end)));
                    }
                }
                let middle = chart.backend_coord(&self.start(axes));
                indicators(&area, &chart, &ends, middle)?;
            }
            area.present().map_err(plot_error)?;
        }
        Ok(fluid(svg))
    }

    /// Where all curves come from, mm, in a view.
    fn start(&self, axes: [usize; 2]) -> (f64, f64) {
        let first = self.curves.iter().find_map(|curve| curve.points.first()).copied().unwrap_or_default();
        (MM * first[axes[0]], MM * first[axes[1]])
    }

    /// What is to be seen along an axis, mm, with a margin.
    fn range(&self, axis: usize) -> Range<f64> {
        let curves = self.curves.iter().flat_map(|c| &c.points).map(|p| p[axis]);
        let hulls = PLANES.iter().zip(self.outline.iter().flat_map(|(_, outlines)| outlines));
        let corners = hulls.flat_map(|((axes, _), corners)| {
            let place = axes.iter().position(|a| *a == axis);
            corners.iter().filter_map(move |corner| place.map(|k| corner[k]))
        });
        let all = curves.chain(corners).filter(|x| x.is_finite()).map(|x| MM * x);
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        if low > high {
            return -1.0..1.0;
        }
        let pad = (MARGIN * (high - low)).max(1.0);
        low - pad..high + pad
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Ends of the curves: a dot, or a cross; and the indicators, each as near to its end as the others let it, outwards
/// from `middle` where it can.
fn indicators(area: &Area<'_>, chart: &Chart<'_, '_>, ends: &[(&Curve, (i32, i32))], middle: (i32, i32)) -> Result<()> {
    let (across, down) = chart.plotting_area().get_pixel_range();
    let mut taken: Vec<(i32, i32)> = Vec::new();
    let dots: Vec<(i32, i32)> = ends.iter().map(|(_, at)| *at).collect();
    for (curve, at) in ends {
        let ink = color(curve.rgb);
        if curve.ended {
            let red = color(palette::RED).stroke_width(2);
            area.draw(&Cross::new(*at, 5, red)).map_err(plot_error)?;
        } else {
            area.draw(&Circle::new(*at, 3, ink.filled())).map_err(plot_error)?;
        }
        let Some(on) = curve.on else { continue };
        let outwards = (f64::from(at.1 - middle.1)).atan2(f64::from(at.0 - middle.0));
        let clear = |spot: &(i32, i32)| {
            let inside = across.contains(&(spot.0 - HALF))
                && across.contains(&(spot.0 + HALF))
                && down.contains(&(spot.1 - HALF))
                && down.contains(&(spot.1 + HALF));
            let apart = |other: &(i32, i32), by: i32| (other.0 - spot.0).abs() >= by || (other.1 - spot.1).abs() >= by;
            inside && taken.iter().all(|t| apart(t, 2 * HALF)) && dots.iter().all(|d| apart(d, HALF + 2))
        };
        let spots = DISTANCES.iter().flat_map(|distance| {
            (0..DIRECTIONS).map(move |k| {
                // Outwards first, then a little to either side.
                let step = k.div_ceil(2) as f64 * if k % 2 == 0 { 1.0 } else { -1.0 };
                let (sine, cosine) = (outwards + step * std::f64::consts::TAU / DIRECTIONS as f64).sin_cos();
                (at.0 + (distance * cosine).round() as i32, at.1 + (distance * sine).round() as i32)
            })
        });
        let Some(spot) = spots.into_iter().find(clear) else { continue };
        taken.push(spot);
        indicator(area, *at, spot, on, ink)?;
    }
    Ok(())
}

/// Four circles at `spot`, with a fine line to `at`.
fn indicator(area: &Area<'_>, at: (i32, i32), spot: (i32, i32), on: [bool; 4], ink: RGBColor) -> Result<()> {
    area.draw(&PathElement::new([at, spot], ink.mix(0.5).stroke_width(1))).map_err(plot_error)?;
    let corners = [(spot.0 - HALF + 1, spot.1 - HALF + 1), (spot.0 + HALF - 1, spot.1 + HALF - 1)];
    area.draw(&Rectangle::new(corners, WHITE.mix(0.85).filled())).map_err(plot_error)?;
    // Seen from above: A at (+, +), then counter-clockwise; pixels grow downwards.
    for ((x, y), on) in [(1, -1), (-1, -1), (-1, 1), (1, 1)].into_iter().zip(on) {
        let centre = (spot.0 + x * PITCH / 2, spot.1 + y * PITCH / 2);
        if on {
            area.draw(&Circle::new(centre, RADIUS, ink.filled())).map_err(plot_error)?;
        } else {
            area.draw(&Circle::new(centre, RADIUS, ink.stroke_width(1))).map_err(plot_error)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(end: [f64; 3], on: [bool; 4]) -> Curve {
        let points = vec![[0.0, 0.0, 0.13], end];
        Curve { label: "one".into(), rgb: palette::BLUE, points, on: Some(on), ..Curve::default() }
    }

    #[test]
    fn each_view_has_every_curve_with_its_four_circles_filled_or_empty() {
        let a = [true, false, false, false];
        let curves = vec![curve([0.01, 0.01, 0.128], a), curve([-0.01, 0.01, 0.128], [false, true, false, false])];
        let corners = vec![[-0.02, -0.02], [0.02, -0.02], [0.0, 0.02]];
        let side = corners.iter().map(|c| [c[0], 0.13 + 0.1 * c[1]]).collect();
        let svg = Views { curves, outline: Some(("hull & all".into(), [corners, side])) }.svg().unwrap();
        // Two views of two curves: a dot and four circles each.
        assert_eq!(svg.matches("<circle").count(), 2 * 2 * 5);
        for text in ["x (mm)", "y (mm)", "z (mm)", "hull &amp; all", "one"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches(">one<").count() + svg.matches("one\n").count(), 1, "the legend has it once");
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn indicators_do_not_cover_each_other() {
        // Five curves that end at the same place.
        let curves = vec![curve([0.01, 0.0, 0.13], [true; 4]); 5];
        let svg = Views { curves, outline: None }.svg().unwrap();
        assert_eq!(svg.matches("<circle").count(), 2 * 5 * 5, "none was left out");
    }

    #[test]
    fn nothing_is_an_empty_drawing() {
        assert!(Views::default().svg().is_ok());
    }
}

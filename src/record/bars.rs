//! Bars, both axes logarithmic: how often which duration was seen.

use plotters::prelude::*;

use super::Result;
use super::canvas::{LEFT, LEGEND_ROW, Mark, WIDTH, color, fluid, legend, plot_error, span, styled};

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
            styled(&mut chart.configure_mesh())
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

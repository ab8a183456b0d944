//! Lanes of states over time.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{Axis, FONT, TEXT, WIDTH, color, fluid, plot_error, styled};
use super::{Result, palette};

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
            styled(chart.configure_mesh().disable_y_mesh().y_labels(0))
                .x_desc(self.x_label.as_str())
                .draw()
                .map_err(plot_error)?;
            let label = (FONT, 13).into_font().color(&TEXT);
            let pixel = (self.x_range.1 - self.x_range.0) / f64::from(WIDTH - names - 16);
            for (i, lane) in self.lanes.iter().enumerate() {
                let (top, bottom) = (count as f64 - i as f64 - 0.1, count as f64 - i as f64 - 0.9);
                let mut painted = (f64::NEG_INFINITY, 0);
                for (from, to, rgb, text) in &lane.spans {
                    let (from, to) = (from.max(self.x_range.0), to.min(self.x_range.1));
                    // What falls into a pixel that has its colour already shows nothing: a limit may come and go a
                    // million times in a long run.
                    if to <= from || (to <= painted.0 && *rgb == painted.1) {
                        continue;
                    }
                    painted = (from + pixel, *rgb);
                    chart
                        .draw_series([Rectangle::new([(from, bottom), (to, top)], color(*rgb).mix(0.75).filled())])
                        .map_err(plot_error)?;
                    // Only where it has room; about 7 pixels a letter.
                    if (to - from) / pixel > 7.0 * text.len() as f64 + 8.0 {
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

//! Drawings of known loads: what was read over what the spring bears, and what the fit leaves over.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::ident::{LoadFit, LoadPoint};

/// What is drawn: names with units, and how many of the unit one SI unit is.
#[derive(Clone, Copy, Debug)]
pub struct LoadsDrawing<'a> {
    /// What it is.
    pub caption: &'a str,
    /// What the spring bears.
    pub load: (&'a str, f64),
    /// What was read.
    pub reading: (&'a str, f64),
}

/// Adds the drawings of `fit` to `points` to `sheet`.
pub fn draw_loads(sheet: &mut Sheet, drawing: &LoadsDrawing, points: &[LoadPoint], fit: &LoadFit) {
    let ((x_label, x), (y_label, y)) = (drawing.load, drawing.reading);
    let load: Vec<f64> = fit.fitted.iter().map(|f| x * f.0).collect();
    let read: Vec<f64> = points.iter().map(|p| y * p.deflection).collect();
    let line: Vec<f64> = fit.fitted.iter().map(|f| y * f.1).collect();
    let left = read.iter().zip(&line).map(|(r, l)| r - l).collect();
    let mut draw = |caption: String, height, lines| {
        let plot = Plot { x_label: x_label.into(), y_label: y_label.into(), height, lines, ..Plot::default() };
        sheet.figures.push((caption, plot));
    };
    let lines = vec![
        Line::new("read", palette::BLUE, &load, read.clone()),
        Line::new("stiffness and hysteresis", palette::ORANGE, &load, line.clone()).dashed(),
    ];
    draw(drawing.caption.into(), 340, lines);
    let lines = vec![Line::new("read - fit", palette::RED, &load, left)];
    draw(format!("{}: what the fit leaves over", drawing.caption), 220, lines);
}

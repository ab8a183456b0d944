//! The page of a stiffness calibration: the fit drawn over the points at rest, and what it leaves over.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::ident::SweepFit;

/// Milli-newton metres.
const MILLI: f64 = 1e3;

/// The page of `fit`, with `facts` above the drawings.
pub fn stiffness_sheet(title: &str, fit: &SweepFit, simulated: bool, facts: Vec<(String, String)>) -> Sheet {
    let points = &fit.points;
    let angle: Vec<f64> = points.iter().map(|p| p.angle.to_degrees()).collect();
    let line = |label: &str, rgb, y: Vec<f64>| Line::new(label, rgb, &angle, y);
    let of = |pick: fn(&crate::ident::MomentPoint) -> f64| points.iter().map(|p| MILLI * pick(p)).collect::<Vec<_>>();
    let plot = |y_label: &str, lines| Plot {
        x_label: "angle at rest (deg)".into(),
        y_label: y_label.into(),
        height: 340,
        lines,
        ..Plot::default()
    };
    // With the spring taken away, the loop is what is left: its width is seen.
    let loops = vec![
        line("moment of the pressure - kt angle", palette::BLUE, of(|p| p.moment - (p.fitted - p.hysteresis))),
        line("hysteresis that was fitted", palette::ORANGE, of(|p| p.hysteresis)).dashed(),
    ];
    let whole = vec![
        line("moment of the pressure", palette::BLUE, of(|p| p.moment)),
        line("kt angle + hysteresis", palette::ORANGE, of(|p| p.fitted)).dashed(),
    ];
    let left = vec![line("moment - fit", palette::RED, of(|p| p.moment - p.fitted))];
    Sheet {
        title: title.into(),
        simulated,
        facts,
        figures: vec![
            ("Moment at rest, up and down".into(), plot("moment (mN m)", whole)),
            ("The same without the spring".into(), plot("moment (mN m)", loops)),
            ("What the fit leaves over".into(), plot("moment (mN m)", left)),
        ],
        ..Sheet::default()
    }
}

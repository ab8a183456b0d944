//! A planned way of the plate on a page: where it should go, where it goes, and the pressures that take it there.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use super::views::{Curve, Views};
use crate::fem::module::NAMES;
use crate::plan::PathPlan;
use crate::units::PASCAL_PER_PSI;

/// Height of a drawing over the time, pixels.
const HEIGHT: u32 = 260;
/// Colours of the pressures of A, B, C, D.
const COLORS: [u32; 4] = [palette::BLUE, palette::GREEN, palette::ORANGE, palette::PURPLE];
const TIME: &str = "time (s)";

/// The page of `plan`, with `facts` and `remarks` above the drawings.
pub fn way_sheet(title: &str, plan: &PathPlan, facts: Vec<(String, String)>, remarks: Vec<String>) -> Sheet {
    let points = |poses: &[crate::plan::Pose]| poses.iter().map(|pose| pose.position).collect();
    let planned = Curve {
        label: "planned".into(),
        rgb: palette::GREY,
        dashed: true,
        points: points(&plan.planned),
        ..Curve::default()
    };
    let predicted = Curve {
        label: "predicted".into(),
        rgb: palette::BLUE,
        points: points(&plan.predicted),
        ended: !plan.valid(),
        ..Curve::default()
    };
    let curves = [planned, predicted].into_iter().filter(|curve| !curve.points.is_empty()).collect();
    let views = vec![("The plate's centre from above and from the side".into(), Views { curves, outline: None })];
    let valid = &plan.times[..plan.predicted.len()];
    let pressures = (0..4).map(|i| {
        let psi = plan.pressures.iter().map(|p| p[i] / PASCAL_PER_PSI).collect();
        Line::new(NAMES[i], COLORS[i], &plan.times, psi)
    });
    let margin = |label: &str, rgb: u32, of: &dyn Fn(&crate::plan::Margin) -> f64| {
        Line::new(label, rgb, valid, plan.margins.iter().map(of).collect())
    };
    let error = plan.planned.iter().zip(&plan.predicted).map(|(a, b)| {
        let d: [f64; 3] = std::array::from_fn(|i| b.position[i] - a.position[i]);
        1e3 * d.iter().map(|x| x * x).sum::<f64>().sqrt()
    });
    let plot = |label: &str, lines: Vec<Line>| Plot {
        x_label: TIME.into(),
        y_label: label.into(),
        height: HEIGHT,
        lines,
        ..Plot::default()
    };
    let error: Vec<f64> = error.collect();
    let mut figures = vec![("Pressures".into(), plot("pressure (psi)", pressures.collect()))];
    if !error.is_empty() {
        let line = Line::new("predicted from planned", palette::RED, valid, error);
        figures.push(("Distance from the planned path".into(), plot("distance (mm)", vec![line])));
    }
    let shares = vec![
        margin("stiffness", palette::BLUE, &|m| m.stiffness),
        margin("clearance between tubes", palette::GREEN, &|m| m.clearance.unwrap_or(f64::NAN)),
    ];
    figures.push(("Margin: shares of what there is at rest".into(), plot("share", shares)));
    Sheet { title: title.into(), facts, remarks, views, figures, ..Sheet::default() }
}

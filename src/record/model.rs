//! What a model says of a FREE, drawn over the pressure.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::fem::fidelity::{Answer, Hold, Rest, Scene};
use crate::units::PASCAL_PER_PSI;

/// Height of a drawing, pixels.
const HEIGHT: u32 = 300;

/// The page of `answer` to `scene`, with `facts` above the drawings.
pub fn model_sheet(title: &str, scene: &Scene, answer: &Answer, facts: Vec<(String, String)>) -> Sheet {
    let mut points = answer.points.clone();
    points.sort_by(|a, b| a.pressure.total_cmp(&b.pressure));
    let pressures: Vec<f64> = points.iter().map(|p| p.pressure / PASCAL_PER_PSI).collect();
    let plot = |label: &str, rgb: u32, of: &dyn Fn(&Rest) -> f64| {
        let values = points.iter().map(|p| p.rest.as_ref().map_or(f64::NAN, of)).collect();
        let marks = answer.limit.iter().map(|l| (l.pressure / PASCAL_PER_PSI, palette::RED, l.reason.clone()));
        Plot {
            x_label: "pressure (psi)".into(),
            y_label: label.into(),
            height: HEIGHT,
            lines: vec![Line::new(label, rgb, &pressures, values)],
            marks: marks.collect(),
            ..Plot::default()
        }
    };
    let figures = match scene.hold {
        Hold::Free => vec![
            ("Twist".into(), plot("twist (deg/mm)", palette::BLUE, &|r| 1e-3 * r.twist.to_degrees())),
            (
                "Rotation of the end".into(),
                plot("rotation (deg)", palette::BLUE, &|r| (r.twist * scene.length).to_degrees()),
            ),
            ("Elongation".into(), plot("elongation (mm)", palette::GREEN, &|r| 1e3 * (r.stretch - 1.0) * scene.length)),
            ("Outer radius".into(), plot("outer radius (mm)", palette::ORANGE, &|r| 1e3 * r.outer_radius_mean)),
        ],
        Hold::Blocked => vec![
            ("Force on the support".into(), plot("force (N)", palette::BLUE, &|r| r.force)),
            ("Moment on the support".into(), plot("moment (mN m)", palette::GREEN, &|r| 1e3 * r.moment)),
            ("Outer radius".into(), plot("outer radius (mm)", palette::ORANGE, &|r| 1e3 * r.outer_radius_mean)),
        ],
    };
    Sheet { title: title.into(), facts, figures, ..Sheet::default() }
}

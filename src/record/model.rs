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
    let mut figures = figures;
    figures.extend(ends(scene, answer));
    Sheet { title: title.into(), facts, figures, ..Sheet::default() }
}

/// How the tube twists and widens from base to tip, where the model knows ends.
fn ends(scene: &Scene, answer: &Answer) -> Vec<(String, Plot)> {
    let profile = &answer.profile;
    if profile.len() < 2 {
        return Vec::new();
    }
    // Between two sections stands the twist from the one to the other.
    let middles: Vec<f64> = profile.windows(2).map(|s| 5e2 * (s[0].reference + s[1].reference)).collect();
    let twists = profile.windows(2).map(|s| {
        let twist = (s[1].turn - s[0].turn) / (s[1].reference - s[0].reference);
        1e-3 * twist.to_degrees()
    });
    let whole = [0.0, 1e3 * scene.length];
    let last = &profile[profile.len() - 1];
    let mean = 1e-3 * ((last.turn - profile[0].turn) / (last.reference - profile[0].reference)).to_degrees();
    let places: Vec<f64> = profile.iter().map(|s| 1e3 * s.reference).collect();
    let radii = profile.iter().map(|s| 1e3 * s.outer_radius_mean).collect();
    let over_length = |y_label: &str, lines: Vec<Line>| Plot {
        x_label: "from the base, at rest (mm)".into(),
        y_label: y_label.into(),
        height: HEIGHT,
        lines,
        ..Plot::default()
    };
    let twist = vec![
        Line::new("local", palette::BLUE, &middles, twists.collect()),
        Line::new("mean of the FREE", palette::GREY, &whole, vec![mean; 2]).dashed(),
    ];
    let radius = vec![Line::new("outer radius", palette::ORANGE, &places, radii)];
    vec![
        ("End effects: twist along the FREE at the farthest pressure".into(), over_length("twist (deg/mm)", twist)),
        ("End effects: outer radius".into(), over_length("outer radius (mm)", radius)),
    ]
}

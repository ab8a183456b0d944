//! The page of a planned whisk.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::plan::{PathPlan, Pose};
use crate::units::PASCAL_PER_PSI;

/// The FREEs, in their order, with their colours.
const FREES: [(&str, u32); 4] =
    [("A", palette::BLUE), ("B", palette::GREEN), ("C", palette::ORANGE), ("D", palette::PURPLE)];

/// The page of `plan`: the way of the plate's centre, the pressures, the margin.
pub fn whisk_sheet(title: &str, plan: &PathPlan, facts: Vec<(String, String)>) -> Sheet {
    let mm = |poses: &[Pose], axis: usize| poses.iter().map(|p| 1e3 * p.position[axis]).collect::<Vec<f64>>();
    let way = |label: &str, rgb: u32, width: u32, poses: &[Pose], axes: [usize; 2]| {
        Line::new(label, rgb, &mm(poses, axes[0]), mm(poses, axes[1])).width(width)
    };
    let map = |axes: [usize; 2], labels: [&str; 2]| Plot {
        x_label: labels[0].into(),
        y_label: labels[1].into(),
        height: 440,
        square: true,
        lines: vec![
            way("planned", palette::GREY, 4, &plan.planned, axes),
            way("predicted", palette::BLUE, 2, &plan.predicted, axes),
        ],
        ..Plot::default()
    };
    let known = |n: usize| &plan.times[..n.min(plan.times.len())];
    let pressure = |(i, (name, rgb)): (usize, (&str, u32))| {
        Line::new(name, rgb, &plan.times, plan.pressures.iter().map(|p| p[i] / PASCAL_PER_PSI).collect())
    };
    let share = |label: &str, rgb: u32, values: Vec<f64>| Line::new(label, rgb, known(values.len()), values);
    let percent = |x: f64| 100.0 * x;
    let stiffness = plan.margins.iter().map(|m| percent(m.stiffness)).collect();
    let clearance = plan.margins.iter().map(|m| m.clearance.map_or(f64::NAN, percent)).collect();
    let over_time = |y_label: &str, lines: Vec<Line>| Plot {
        x_label: "time (s)".into(),
        y_label: y_label.into(),
        height: 280,
        lines,
        ..Plot::default()
    };
    Sheet {
        title: title.into(),
        facts,
        figures: vec![
            ("Way of the plate's centre, from above".into(), map([0, 1], ["x (mm)", "y (mm)"])),
            ("From the side".into(), map([0, 2], ["x (mm)", "z (mm)"])),
            ("Pressures".into(), over_time("pressure (psi)", FREES.into_iter().enumerate().map(pressure).collect())),
            (
                "What is left of the stiffness and the clearance at rest".into(),
                over_time(
                    "share (%)",
                    vec![
                        share("stiffness, softest direction", palette::BLUE, stiffness),
                        share("clearance between tubes", palette::GREEN, clearance),
                    ],
                ),
            ),
        ],
        ..Sheet::default()
    }
}

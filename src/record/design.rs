//! Many designs on a page: what each does at the highest pressure, and the curves over the pressure.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::fem::ends::Equilibrium;
use crate::plan::design::Design;
use crate::units::PASCAL_PER_PSI;

/// Height of a drawing, pixels.
const HEIGHT: u32 = 300;
/// Curves that are drawn over the pressure, at most.
const CURVES: usize = 8;
/// Their colours, in turn.
const COLORS: [u32; CURVES] = [
    palette::BLUE,
    palette::GREEN,
    palette::ORANGE,
    palette::PURPLE,
    palette::RED,
    palette::YELLOW,
    palette::METAL,
    palette::FIBER,
];

/// A quantity of an equilibrium of a FREE of this length, m, in the unit of its label.
type Quantity = (&'static str, bool, fn(&Equilibrium, f64) -> f64);

const QUANTITIES: [Quantity; 5] = [
    ("twist (deg/mm)", true, |e, _| 1e-3 * e.twist.to_degrees()),
    ("rotation (deg)", true, |e, length| (e.twist * length).to_degrees()),
    ("extension (mm)", true, |e, length| 1e3 * (e.stretch - 1.0) * length),
    ("blocked force (N)", false, |e, _| e.force),
    ("blocked moment (mN m)", false, |e, _| 1e3 * e.moment),
];

/// The page of `designs` at `pressures`, Pa; `values` are those of what was varied, on the axis called `axis`.
pub fn design_sheet(
    title: &str,
    axis: &str,
    values: &[f64],
    designs: &[Design],
    pressures: &[f64],
    length: f64,
    facts: Vec<(String, String)>,
) -> Sheet {
    let last = pressures.len().saturating_sub(1);
    let psi: Vec<f64> = pressures.iter().map(|p| p / PASCAL_PER_PSI).collect();
    let mut figures = Vec::new();
    for (label, free, of) in QUANTITIES {
        let at = |design: &Design, i: usize| {
            let points = if free { &design.free } else { &design.blocked };
            points.get(i).copied().flatten().map_or(f64::NAN, |e| of(&e, length))
        };
        let over = designs.iter().map(|d| at(d, last)).collect();
        figures.push((
            format!("{label} at {:.1} psi", psi.last().copied().unwrap_or(0.0)),
            Plot {
                x_label: axis.into(),
                y_label: label.into(),
                height: HEIGHT,
                lines: vec![Line::new(label, palette::BLUE, values, over)],
                ..Plot::default()
            },
        ));
        let stride = designs.len().div_ceil(CURVES).max(1);
        let chosen = designs.iter().zip(values).step_by(stride).zip(COLORS);
        let lines = chosen.map(|((design, value), rgb)| {
            Line::new(&format!("{value:.1}"), rgb, &psi, (0..psi.len()).map(|i| at(design, i)).collect())
        });
        figures.push((
            format!("{label} over the pressure, by {axis}"),
            Plot {
                x_label: "pressure (psi)".into(),
                y_label: label.into(),
                height: HEIGHT,
                lines: lines.collect(),
                ..Plot::default()
            },
        ));
    }
    Sheet { title: title.into(), facts, figures, ..Sheet::default() }
}

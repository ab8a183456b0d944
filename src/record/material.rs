//! The page of a material calibration: the laws drawn over what was measured, and what each leaves over.

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::config::Material;
use crate::ident::material::{FiberFit, InflationFit, LawFit, TensileFit};
use crate::units::PASCAL_PER_PSI;

const MEGA: f64 = 1e6;
const MILLI: f64 = 1e-3;

/// The page of the fits to what was tested, with `facts` above the drawings.
pub fn material_sheet(
    title: &str,
    material: &Material,
    fits: (Option<&TensileFit>, Option<&InflationFit>, Option<&FiberFit>),
    facts: Vec<(String, String)>,
) -> Sheet {
    let mut figures = Vec::new();
    let mut draw = |caption: &str, x_label: &str, y_label: &str, lines: Vec<Line>, height| {
        let plot = Plot { x_label: x_label.into(), y_label: y_label.into(), height, lines, ..Plot::default() };
        figures.push((caption.to_owned(), plot));
    };
    if let Some(fit) = fits.0 {
        let laws = laws(&fit.ogden, &fit.neo_hookean, &fit.linear);
        let (mut curves, mut left) = (Vec::new(), Vec::new());
        let longest = material.tensile.iter().flat_map(|t| &t.points).map(|p| p.stretch).fold(1.0, f64::max);
        let grid: Vec<f64> = (0..=100).map(|i| 1.0 + (longest - 1.0) * f64::from(i) / 100.0).collect();
        for test in &material.tensile {
            let stretch: Vec<f64> = test.points.iter().map(|p| p.stretch).collect();
            let stress = test.points.iter().map(|p| p.stress / MEGA).collect();
            curves.push(Line::new(
                &test.file.file_name().unwrap_or_default().to_string_lossy(),
                palette::BLUE,
                &stretch,
                stress,
            ));
            for (name, rgb, law) in &laws {
                let rest =
                    test.points.iter().map(|p| law.tension(p.stretch).map_or(f64::NAN, |s| (p.stress - s) / MEGA));
                left.push(Line::new(name, *rgb, &stretch, rest.collect()).width(1));
            }
        }
        for (name, rgb, law) in &laws {
            let stress = grid.iter().map(|&l| law.tension(l).map_or(f64::NAN, |s| s / MEGA)).collect();
            curves.push(Line::new(name, *rgb, &grid, stress).dashed());
        }
        draw("Tension", "stretch", "nominal stress (MPa)", curves, 360);
        draw("Tension: what the laws leave over", "stretch", "measured - law (MPa)", left, 240);
    }
    if let (Some(fit), Some((test, tube, _))) = (fits.1, &material.inflation) {
        let radius: Vec<f64> = test.points.iter().map(|p| p.outer_radius / MILLI).collect();
        let psi: Vec<f64> = test.points.iter().map(|p| p.pressure / PASCAL_PER_PSI).collect();
        let mut curves = vec![Line::new("measured", palette::BLUE, &radius, psi.clone())];
        let mut left = Vec::new();
        for (name, rgb, law) in laws(&fit.ogden, &fit.neo_hookean, &fit.linear) {
            let at = |r: &f64| tube.pressure(&law.law, r * MILLI, 1.0).map_or(f64::NAN, |(p, _)| p / PASCAL_PER_PSI);
            let model: Vec<f64> = radius.iter().map(at).collect();
            left.push(Line::new(name, rgb, &radius, psi.iter().zip(&model).map(|(p, m)| p - m).collect()));
            curves.push(Line::new(name, rgb, &radius, model).dashed());
        }
        draw("Inflation of the bare tube", "outer radius (mm)", "pressure (psi)", curves, 360);
        draw("Inflation: what the laws leave over", "outer radius (mm)", "measured - law (psi)", left, 240);
    }
    if let (Some(fit), Some(test)) = (fits.2, &material.fiber) {
        let strain: Vec<f64> = test.points.iter().map(|p| 100.0 * p.strain).collect();
        let line: Vec<f64> = test.points.iter().map(|p| fit.force(p.strain)).collect();
        let left = test.points.iter().zip(&line).map(|(p, f)| p.force - f).collect();
        let force = test.points.iter().map(|p| p.force).collect();
        let curves = vec![
            Line::new("measured", palette::BLUE, &strain, force),
            Line::new("EA", palette::ORANGE, &strain, line).dashed(),
        ];
        draw("One fibre", "strain (%)", "force (N)", curves, 320);
        let left = vec![Line::new("measured - line", palette::RED, &strain, left)];
        draw("Fibre: what the line leaves over", "strain (%)", "force (N)", left, 220);
    }
    Sheet { title: title.into(), facts, figures, ..Sheet::default() }
}

fn laws<'a>(ogden: &'a LawFit, neo: &'a LawFit, linear: &'a LawFit) -> [(&'static str, u32, &'a LawFit); 3] {
    [("Ogden", palette::ORANGE, ogden), ("neo-Hookean", palette::GREEN, neo), ("linear", palette::PURPLE, linear)]
}

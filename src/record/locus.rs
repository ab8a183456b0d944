//! The root locus on a page: the closed loop's poles in the s-plane while all gains grow together.

use nalgebra::Complex;

use super::palette;
use super::plot::{Line, Plot};
use super::sheet::Sheet;
use crate::control::root_locus::{LocusLoop, LocusPoint};
use crate::control::tune::{Target, Tuned};

/// Height of a drawing, pixels.
const HEIGHT: u32 = 460;
/// Gain factors from the first to the second, geometrically; the present gains are at one.
const FACTORS: (f64, f64) = (0.01, 20.0);
const POINTS: usize = 500;
/// Colours of the branches, in turn.
const BRANCHES: [u32; 6] =
    [palette::BLUE, palette::GREEN, palette::ORANGE, palette::PURPLE, palette::YELLOW, palette::METAL];

/// The page of `tuned` gains in `locus`, with `facts` above the drawings.
pub fn locus_sheet(
    title: &str,
    locus: &LocusLoop,
    tuned: &Tuned,
    target: &Target,
    facts: Vec<(String, String)>,
) -> Sheet {
    let growth = (FACTORS.1 / FACTORS.0).powf(1.0 / (POINTS - 1) as f64);
    let factors: Vec<f64> = (0..POINTS).map(|i| FACTORS.0 * growth.powf(i as f64)).collect();
    let points = locus.locus(&factors);
    // What the loop can move lies within the delay's own poles.
    let reach = 2.5 / locus.delay();
    let draw = |pick: fn(&LocusPoint) -> &Vec<Complex<f64>>| plane(&points, pick, pick(&tuned.poles), reach, target);
    Sheet {
        title: title.into(),
        facts,
        figures: vec![
            (
                "Root locus with the regulator's lag, the delays and the sampling (red: the closed loop with these gains)"
                    .into(),
                draw(|p| &p.extended),
            ),
            ("Root locus of Eq. 6: the ideal loop of the paper".into(), draw(|p| &p.ideal)),
        ],
        ..Sheet::default()
    }
}

fn plane(
    points: &[LocusPoint],
    pick: fn(&LocusPoint) -> &Vec<Complex<f64>>,
    here: &[Complex<f64>],
    reach: f64,
    target: &Target,
) -> Plot {
    let (left, right) = (-1.6 * reach, 0.5 * reach);
    let (dx, dy) = (0.006 * (right - left), 0.03 * reach);
    let inside = |z: &Complex<f64>| (left..right).contains(&z.re) && z.im.abs() <= reach;
    let mut lines = Vec::new();
    for (i, branch) in branches(points.iter().map(pick)).into_iter().enumerate() {
        let y = branch.iter().map(|z| if inside(z) { z.im } else { f64::NAN }).collect();
        let x: Vec<f64> = branch.iter().map(|z| z.re).collect();
        let color = BRANCHES[i % BRANCHES.len()];
        lines.push(Line::new("", color, &x, y));
        // A pole that a zero of the controller holds stays where it is, and its branch would not be seen.
        if let Some(first) = branch.first().filter(|first| branch.iter().all(|z| (*z - **first).norm() < dx)) {
            let y = if inside(first) { first.im } else { f64::NAN };
            lines.push(Line::new("", color, &[first.re - 2.0 * dx, first.re + 2.0 * dx], vec![y; 2]).width(4));
        }
    }
    let slope = (1.0 - target.damping * target.damping).sqrt() / target.damping.max(1e-6);
    let far = (reach / slope).min(-left);
    let wanted = format!("damping ratio {:.2}", target.damping);
    lines.push(Line::new(&wanted, palette::GREY, &[-far, 0.0, -far], vec![far * slope, 0.0, -far * slope]).dashed());
    lines.push(Line::new("edge of stability", palette::RED, &[0.0, 0.0], vec![-reach, reach]).width(1));
    for z in here.iter().filter(|z| inside(z)) {
        for sign in [1.0, -1.0] {
            let y = vec![z.im - sign * dy, z.im + sign * dy];
            lines.push(Line::new("", palette::RED, &[z.re - dx, z.re + dx], y));
        }
    }
    Plot {
        x_label: "real part (1/s)".into(),
        y_label: "imaginary part (1/s)".into(),
        x_range: Some((left, right)),
        height: HEIGHT,
        lines,
        ..Plot::default()
    }
}

/// The poles as curves: each continues in the nearest pole at the next gain. Where their number changes, new ones
/// begin.
fn branches<'a>(poles: impl Iterator<Item = &'a Vec<Complex<f64>>>) -> Vec<Vec<Complex<f64>>> {
    let mut done: Vec<Vec<Complex<f64>>> = Vec::new();
    let mut open: Vec<Vec<Complex<f64>>> = Vec::new();
    for at in poles {
        if open.len() != at.len() {
            done.append(&mut open);
            open = at.iter().map(|&z| vec![z]).collect();
            continue;
        }
        let mut left = at.clone();
        for branch in &mut open {
            let Some(&last) = branch.last() else { continue };
            let nearest = (0..left.len()).min_by(|&a, &b| (left[a] - last).norm().total_cmp(&(left[b] - last).norm()));
            if let Some(nearest) = nearest {
                branch.push(left.swap_remove(nearest));
            }
        }
    }
    done.append(&mut open);
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cross_on_a_pole_that_a_zero_holds_lies_on_a_line_that_is_seen() {
        // One pole stands at -17.2, the other goes to the left with the gain.
        let at = |factor: f64| vec![Complex::new(-17.2, 0.0), Complex::new(-1.0 - 10.0 * factor, 0.0)];
        let point = |factor: f64| LocusPoint { factor, ideal: at(factor), extended: Vec::new() };
        let points: Vec<_> = (1..100).map(|i| point(0.05 * f64::from(i))).collect();
        let plot = plane(&points, |p| &p.ideal, &at(1.0), 60.0, &Target::PID);
        let pixel = 2.1 * 60.0 / 850.0;
        for pole in at(1.0) {
            let seen = plot.lines.iter().filter(|l| l.rgb != palette::RED && l.rgb != palette::GREY).any(|line| {
                let there = |(x, y): (&f64, &f64)| (Complex::new(*x, *y) - pole).norm() < 15.0 * pixel;
                let near: Vec<f64> = line.x.iter().zip(&line.y).filter(|p| there(*p)).map(|(x, _)| *x).collect();
                let (low, high) =
                    (near.iter().fold(pole.re, |a, x| a.min(*x)), near.iter().fold(pole.re, |a, x| a.max(*x)));
                high - low > 3.0 * pixel
            });
            assert!(seen, "{pole}");
        }
    }

    #[test]
    fn branches_are_continuous_whatever_the_order_of_the_poles() {
        let at = |k: f64, turned: bool| {
            let mut poles = vec![Complex::new(-1.0 - k, 0.0), Complex::new(-5.0, k), Complex::new(-5.0, -k)];
            if turned {
                poles.rotate_left(1);
            }
            poles
        };
        let points: Vec<_> = (1..40).map(|i| at(0.05 * f64::from(i), i % 2 == 0)).collect();
        let found = branches(points.iter());
        assert_eq!(found.len(), 3);
        for branch in found {
            assert!(branch.windows(2).all(|w| (w[1] - w[0]).norm() < 0.06), "{branch:?}");
        }
    }
}

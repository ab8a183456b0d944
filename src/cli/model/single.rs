//! `freerig model single`: one FREE at pressures, by the tier asked for or by the cheapest that is good enough.

use std::time::Instant;

use anyhow::anyhow;
use clap::ValueEnum;
use serde::Serialize;

use crate::cli::table::{Table, number};
use crate::cli::tube::TubeArgs;
use crate::cli::{Context, Failure, Progress};
use crate::config::Rig;
use crate::fem::fidelity::{self, Answer, Considered, FidelityError, Hold, Scene};
use crate::fem::measure::difference;
use crate::fem::section::folds;
use crate::record::model_sheet;
use crate::units::{Force, Length, Percent, Pressure};

/// Pressures of a curve where none are given, psi.
const CURVE: std::ops::RangeInclusive<u32> = 0..=10;

const EXAMPLES: &str = "\
Without --pressure it computes 0, 1, ... 10 psi. Past a limit the values are missing and the limit is named: that is \
an answer, not a failure. Signs: z from base to tip, right-handed; force and moment are what the closed FREE does to \
its distal support, the thrust on its cap included.

Examples:
  freerig model single --gamma -40deg --pressure 1psi,2psi
  freerig model single --gamma 60deg --ends blocked --pressure 2psi,4psi --fidelity section
  freerig model single --length 130mm --pressure 5psi --fidelity auto --tolerance 1% --json
  freerig model single --gamma 30deg --fiber-model line --fidelity solid --pressure 3psi
  freerig model single --gamma 40deg --fidelity section --curve";

/// What `freerig model single` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    tube: TubeArgs,
    /// Gauge pressures, negative allowed
    #[arg(long, value_name = "P[,P...]", value_delimiter = ',', allow_hyphen_values = true)]
    pressure: Vec<Pressure>,
    /// How its end is held
    #[arg(long, default_value = "free")]
    ends: Ends,
    /// The model; `auto` is the cheapest whose estimated error is within the tolerance
    #[arg(long, default_value = "auto")]
    fidelity: Fidelity,
    /// Largest relative error, for `auto`
    #[arg(long, default_value = "1%")]
    tolerance: Percent,
    /// Fibres as strips of their width, or as trusses on a line (solid only, mesh-dependent)
    #[arg(long, default_value = "strip")]
    fiber_model: FiberModel,
    /// Draw it over the pressure, on a page
    #[arg(long)]
    curve: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Ends {
    Free,
    Blocked,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Fidelity {
    Linear,
    Nonlinear,
    Section,
    Solid,
    Auto,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum FiberModel {
    Strip,
    Line,
}

impl Fidelity {
    fn tier(self) -> Option<fidelity::Fidelity> {
        match self {
            Fidelity::Linear => Some(fidelity::Fidelity::Linear),
            Fidelity::Nonlinear => Some(fidelity::Fidelity::Nonlinear),
            Fidelity::Section => Some(fidelity::Fidelity::Section),
            Fidelity::Solid => Some(fidelity::Fidelity::Solid),
            Fidelity::Auto => None,
        }
    }
}

#[derive(Debug, Serialize)]
struct Point {
    pressure_pa: f64,
    twist_rad_per_m: Option<f64>,
    axial_stretch: Option<f64>,
    outer_radius_mean_m: Option<f64>,
    outer_radius_at_fiber_m: Option<f64>,
    force_n: Option<f64>,
    moment_nm: Option<f64>,
    converged: bool,
}

#[derive(Debug, Serialize)]
struct Estimate {
    fidelity: &'static str,
    error_estimate: Option<f64>,
    certified: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    fidelity: &'static str,
    points: Vec<Point>,
    limit_pressure_pa: Option<f64>,
    limit: Option<String>,
    wall_time_s: f64,
    discretisation_error_estimate: Option<f64>,
    model_error_estimate: Option<f64>,
    /// Why `auto` chose it; `null` where it was asked for.
    reason: Option<String>,
    /// What `auto` looked at.
    considered: Vec<Estimate>,
    remarks: Vec<String>,
    /// The page of `--curve`.
    report: Option<String>,
}

/// Asks the model and prints what it says.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let (mut tube, length) = args.tube.tube(context)?;
    let mut remarks = Vec::new();
    if args.fiber_model == FiberModel::Line {
        if args.fidelity != Fidelity::Solid {
            let error = anyhow!("--fiber-model line is for --fidelity solid alone: its answers depend on the mesh");
            return Err(Failure::usage(error).remedy("add `--fidelity solid`, or leave the fibres their width"));
        }
        tube.fiber_width = 0.0;
        remarks.push(
            "line fibres: the answers depend on the mesh, and no finer one converges; the error estimate does not say so"
                .to_owned(),
        );
    }
    let pressures = if args.pressure.is_empty() {
        CURVE.map(|psi| Pressure::psi(f64::from(psi)).si()).collect()
    } else {
        args.pressure.iter().map(|p| p.si()).collect()
    };
    let hold = match args.ends {
        Ends::Free => Hold::Free,
        Ends::Blocked => Hold::Blocked,
    };
    let scene = Scene { tube, length, hold, pressures };
    let begun = Instant::now();
    let (answer, model_error, reason, considered) = ask(&args, &scene)?;
    let wall_time = begun.elapsed().as_secs_f64();
    if hold == Hold::Blocked && answer.fidelity >= fidelity::Fidelity::Section {
        remarks.push(
            "a blocked FREE may buckle sideways before: this model keeps it straight (`freerig model module` does not)"
                .to_owned(),
        );
    }
    if hold == Hold::Blocked && answer.fidelity >= fidelity::Fidelity::Section && tube.fiber_width > 0.0 {
        remarks.extend(fold(&scene, &answer)?);
    }
    let mut report = Report {
        fidelity: answer.fidelity.name(),
        points: answer.points.iter().map(point).collect(),
        limit_pressure_pa: answer.limit.as_ref().map(|limit| limit.pressure),
        limit: answer.limit.as_ref().map(|limit| limit.reason.clone()),
        wall_time_s: wall_time,
        discretisation_error_estimate: Some(answer.discretisation_error),
        model_error_estimate: model_error,
        reason,
        considered: considered.iter().map(estimate).collect(),
        remarks,
        report: None,
    };
    if args.curve {
        report.report = Some(draw(&scene, &answer, &report, context)?);
    }
    if context.json { context.print_json(&report) } else { context.print(report.text(&scene)) }
}

/// Where the rubber folds at the strip's end on the way to the farthest pressure answered, which is one of the mesh,
/// and what it would bear then; none where no mesh folds.
fn fold(scene: &Scene, answer: &Answer) -> Result<Option<String>, Failure> {
    let reached = answer.points.iter().filter_map(|point| Some((point.pressure, point.rest?)));
    let Some((most, rest)) = reached.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs())) else { return Ok(None) };
    let found = folds(&scene.tube, scene.hold.ends(), most)?;
    if found.iter().all(|fold| fold.limit.is_none()) {
        return Ok(None);
    }
    let (mut told, mut loads) = (Vec::new(), Vec::new());
    for (name, fold) in ["blunt", "default", "fine", "sharp"].into_iter().zip(found) {
        told.push(match fold.limit {
            Some(limit) => format!("at {:.2} on the {name} one", Pressure::pascals(limit.pressure)),
            None => format!("not up to {:.2} on the {name} one", Pressure::pascals(most)),
        });
        if let Some(folded) = fold.folded {
            let apart = difference(&scene.tube, scene.hold.ends(), &[((&folded).into(), rest.into())]);
            loads.push(format!("{:.1} % ({name})", 100.0 * apart));
        }
    }
    let loads = if loads.is_empty() { "unknown".into() } else { loads.join(", ") };
    Ok(Some(format!(
        "the rubber folds at the edge of the fibre's strip, at a pressure that is a property of the mesh: {}. States beyond \
         are those of rubber that has not folded, and so is the error estimate; how far the load is from theirs at {:.2} \
         once it has folded, contact with itself left out: {loads}",
        told.join(", "),
        Pressure::pascals(most)
    )))
}

type Asked = (Answer, Option<f64>, Option<String>, Vec<Considered>);

fn ask(args: &Args, scene: &Scene) -> Result<Asked, Failure> {
    let tolerance = args.tolerance.si();
    let mut progress = Progress::new("solid", 100.0, "%");
    let mut show = |share: f64| progress.set(100.0 * share, "");
    let asked = match args.fidelity.tier() {
        Some(tier) => fidelity::ask(scene, tier, &mut show).and_then(|answer| {
            let error = fidelity::model_error(scene, &answer)?;
            Ok((answer, error, None, Vec::new()))
        }),
        None => fidelity::choose(scene, tolerance, &mut show).map(|choice| {
            let reason = choice.reason(tolerance);
            (choice.answer, choice.model_error, Some(reason), choice.considered)
        }),
    };
    asked.map_err(|error| match error {
        FidelityError::NotReached { .. } => {
            Failure::failed(error).remedy("ask for a larger --tolerance, or for --fidelity solid and its estimate")
        }
        FidelityError::Section(_) | FidelityError::Solid(_) => {
            Failure::failed(error).remedy("ask for another --fidelity, or for pressures nearer to zero")
        }
        error => Failure::usage(error).remedy("`freerig model single --help` lists the flags and their units"),
    })
}

fn point(point: &fidelity::Point) -> Point {
    let rest = point.rest;
    Point {
        pressure_pa: point.pressure,
        twist_rad_per_m: rest.map(|r| r.twist),
        axial_stretch: rest.map(|r| r.stretch),
        outer_radius_mean_m: rest.map(|r| r.outer_radius_mean),
        outer_radius_at_fiber_m: rest.and_then(|r| r.outer_radius_at_fiber),
        force_n: rest.map(|r| r.force),
        moment_nm: rest.map(|r| r.moment),
        converged: rest.is_some(),
    }
}

fn estimate(considered: &Considered) -> Estimate {
    let error_estimate = Some(considered.estimate).filter(|e| e.is_finite());
    Estimate { fidelity: considered.fidelity.name(), error_estimate, certified: considered.certified }
}

/// Draws the answer; answers the page's path.
fn draw(scene: &Scene, answer: &Answer, report: &Report, context: &Context) -> Result<String, Failure> {
    let rig = Rig::load(&context.rig)?;
    std::fs::create_dir_all(&rig.record.directory)?;
    let degrees = scene.tube.gamma.to_degrees();
    let ends = match scene.hold {
        Hold::Free => "free",
        Hold::Blocked => "blocked",
    };
    let title = format!("FREE of {degrees:.1} deg, {ends}: {}", report.fidelity);
    let mut sheet = model_sheet(&title, scene, answer, report.facts(scene));
    sheet.remarks.clone_from(&report.remarks);
    let name = format!("model-single-{degrees:+.1}deg-{ends}-{}.html", report.fidelity);
    Ok(sheet.write(&rig.record.directory.join(name))?.display().to_string())
}

impl Report {
    fn facts(&self, scene: &Scene) -> Vec<(String, String)> {
        let percent = |e: Option<f64>| match e {
            Some(e) if e.is_finite() => format!("{:.3} %", 100.0 * e),
            Some(_) => "no equilibrium to compare with".into(),
            None => "-".into(),
        };
        let tube = &scene.tube;
        let mut facts = vec![
            (
                "FREE".into(),
                format!(
                    "{:.2} deg, length {:.1}, inner diameter {:.2}, wall {:.2}, {} fibres of {:.2} and EA {:.0}",
                    tube.gamma.to_degrees(),
                    Length::metres(scene.length),
                    Length::metres(2.0 * tube.inner_radius),
                    Length::metres(tube.wall),
                    tube.fibers,
                    Length::metres(tube.fiber_width),
                    Force::newtons(tube.fiber_ea)
                ),
            ),
            (
                "rubber".into(),
                format!(
                    "{}, mu {:.3} MPa",
                    tube.law.exponent().map_or("linear".into(), |alpha| format!("Ogden, alpha {alpha}")),
                    tube.law.shear_modulus() / 1e6
                ),
            ),
            ("discretisation error, estimated".into(), percent(self.discretisation_error_estimate)),
            ("model error, estimated".into(), percent(self.model_error_estimate)),
        ];
        if let (Some(pressure), Some(limit)) = (self.limit_pressure_pa, &self.limit) {
            facts.push(("limit".into(), format!("{:.3}: {limit}", Pressure::pascals(pressure))));
        }
        if let Some(reason) = &self.reason {
            facts.push(("why this model".into(), reason.clone()));
        }
        facts.push(("time".into(), format!("{:.3} s", self.wall_time_s)));
        facts
    }

    fn text(&self, scene: &Scene) -> String {
        let mut table = Table::new(&[
            ">pressure",
            ">twist rad/m",
            ">rotation deg",
            ">stretch",
            ">radius mm",
            ">at fibre mm",
            ">force N",
            ">moment mN m",
        ]);
        for p in &self.points {
            table.row([
                format!("{:.2}", Pressure::pascals(p.pressure_pa)),
                number(p.twist_rad_per_m, 4),
                number(p.twist_rad_per_m.map(|t| (t * scene.length).to_degrees()), 2),
                number(p.axial_stretch, 5),
                number(p.outer_radius_mean_m.map(|r| 1e3 * r), 4),
                number(p.outer_radius_at_fiber_m.map(|r| 1e3 * r), 4),
                number(p.force_n, 4),
                number(p.moment_nm.map(|m| 1e3 * m), 3),
            ]);
        }
        let facts = self.facts(scene).into_iter().map(|(name, value)| format!("\n{name}: {value}")).collect::<String>();
        let remarks = self.remarks.iter().map(|remark| format!("\nnote: {remark}")).collect::<String>();
        let page = self.report.as_ref().map(|path| format!("\ncurve: {path}")).unwrap_or_default();
        format!("{} model\n\n{table}\n{facts}{remarks}{page}", self.fidelity)
    }
}

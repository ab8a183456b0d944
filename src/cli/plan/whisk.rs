//! `freerig plan whisk`: the pressures of a module over one period of its whisk, as a file for `freerig whisk`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::anyhow;
use clap::{Args as _, FromArgMatches, ValueEnum};
use nalgebra::Vector3;
use serde::Serialize;

use super::{LimitArgs, psi, refused};
use crate::cli::list::List;
use crate::cli::scene::build;
use crate::cli::{Context, Failure};
use crate::config::{Rig, Whisk, atomic};
use crate::fem::module::{Layout, ModuleScene};
use crate::plan::whisk::{Eight, Order, Pattern, Scaled, WhiskPlan, eight, pattern};
use crate::plan::{Limits, PathPlan, PlanError, Rest};
use crate::record::whisk_sheet;
use crate::units::{Frequency, Length, Pressure, PressureRate};

/// Distance of neighbouring axes of a module that no rig describes, m.
const SPACING: f64 = 0.02;
/// The share of the highest pressure in whose middle an eight crosses itself.
const MIDDLE: f64 = 0.4;
/// Periods that the file asks for.
const PERIODS: u32 = 3;
/// From zero to the first pressures, s.
const LEAD: f64 = 2.0;

const EXAMPLES: &str = "\
The module is the rig's; where it has none, four FREEs of the rig's first one, RLRL, 20 mm apart. `eight` is a figure \
of the plate's centre, whose pressures the inverse model finds; `paper` is the published pattern of pressures, between \
2 and 10 psi, and `round` the same in another order, which draws a circle and no eight. What lies past a limit of the \
module is said to, and the largest whisk of its kind that does not is written in its place.

Examples:
  freerig plan whisk                                     an eight of 8 mm by 3 mm, a quarter of it a second
  freerig plan whisk --width 6mm --height 2mm --frequency 0.5Hz --output small.toml
  freerig plan whisk --pattern paper --middle 5psi
  freerig plan whisk --pattern round --lowest 2psi --highest 6psi";

/// What `freerig plan whisk` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// What is whisked
    #[arg(long, default_value = "eight")]
    pattern: Kind,
    /// Extent of the eight along x
    #[arg(long, default_value = "8mm")]
    width: Length,
    /// Extent of the eight along y
    #[arg(long, default_value = "3mm")]
    height: Length,
    /// Where the eight crosses itself: from the middle of the bases; by default where the plate is with all pressures
    /// at 40 % of the highest
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    centre: Option<List<Length, 3>>,
    /// Eights a second
    #[arg(long, default_value = "0.25Hz")]
    frequency: Frequency,
    /// Lowest pressure of a pattern
    #[arg(long, default_value = "2psi")]
    lowest: Pressure,
    /// Highest pressure of a pattern
    #[arg(long, default_value = "10psi")]
    highest: Pressure,
    /// Pressure in between, of two FREEs whenever one is highest and one lowest; by default the mean: a sinusoid
    #[arg(long)]
    middle: Option<Pressure>,
    /// Pressures a second
    #[arg(long, default_value = "100Hz")]
    rate: Frequency,
    /// The file to write
    #[arg(long, value_name = "FILE", default_value = "whisk.toml")]
    output: PathBuf,
    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Kind {
    /// A figure eight of the plate's centre
    Eight,
    /// The published pattern, crossing the square: A, B, D, C
    Paper,
    /// The same round the square: A, B, C, D
    Round,
}

#[derive(Debug, Serialize)]
struct Report {
    pattern: &'static str,
    /// Whether all of what was asked is a stable motion within the limits.
    valid: bool,
    /// Why not.
    reason: Option<String>,
    /// What the file holds in its place: the scale of what was asked, 0 to 1.
    scale: Option<f64>,
    /// What was scaled.
    #[serde(skip)]
    scaled: Option<Scaled>,
    period_s: f64,
    samples: usize,
    /// Of what the file holds.
    length_m: Option<f64>,
    width_m: Option<f64>,
    twist_rad: Option<[f64; 2]>,
    enclosed_area_m2: Option<f64>,
    worst_error_m: Option<f64>,
    rms_error_m: Option<f64>,
    discretisation_error_m: Option<f64>,
    least_margin: Option<f64>,
    least_margin_s: Option<f64>,
    highest_pressure_pa: f64,
    fastest_pa_per_s: f64,
    /// The highest pressure that the rig's FREEs take.
    rig_pressure_max_pa: f64,
    clipped_samples: usize,
    planning_s: f64,
    file: Option<String>,
    report: String,
}

/// What came of the flags.
struct Made {
    planned: WhiskPlan,
    seconds: f64,
    /// The highest pressure that the rig's FREEs take, Pa.
    own: f64,
}

impl Made {
    /// What is run, which is what is valid: as asked, or in its place.
    fn plan(&self) -> &PathPlan {
        self.planned.instead.as_ref().map_or(&self.planned.plan, |instead| &instead.plan)
    }

    fn whisk(&self, name: &str) -> Whisk {
        let plan = self.plan();
        Whisk {
            name: name.into(),
            periods: PERIODS,
            lead: LEAD,
            times: plan.times.clone(),
            pressures: plan.pressures.clone(),
            planned: plan.planned.iter().map(|p| p.position).collect(),
            predicted: plan.predicted.iter().map(|p| p.position).collect(),
        }
    }
}

/// Plans a whisk and writes its file and its page.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let rig = Rig::load(&context.rig)?;
    let made = args.make(&rig, context)?;
    let (planned, plan) = (&made.planned, made.plan());
    let figure = planned.instead.as_ref().map_or(&planned.figure, |instead| &instead.figure);
    std::fs::create_dir_all(&rig.record.directory)?;
    let page = rig.record.directory.join(format!("plan-whisk-{}.html", args.pattern.name()));
    let asked_whole = planned.instead.is_none() && planned.plan.valid() && planned.plan.facts.missed == 0;
    let mut report = Report {
        pattern: args.pattern.name(),
        valid: asked_whole,
        reason: (!asked_whole).then(|| reason(planned)),
        scale: planned.instead.as_ref().map(|instead| instead.scale),
        scaled: planned.instead.as_ref().map(|instead| instead.scaled),
        period_s: planned.period,
        samples: plan.times.len(),
        length_m: figure.as_ref().map(|f| f.length),
        width_m: figure.as_ref().map(|f| f.width),
        twist_rad: figure.as_ref().map(|f| f.twist),
        enclosed_area_m2: figure.as_ref().map(|f| f.area),
        worst_error_m: plan.facts.worst_error,
        rms_error_m: plan.facts.rms_error,
        discretisation_error_m: plan.facts.discretisation,
        least_margin: plan.facts.least_margin.map(|m| m.0),
        least_margin_s: plan.facts.least_margin.map(|m| m.1),
        highest_pressure_pa: plan.pressures.iter().flatten().copied().fold(0.0, f64::max),
        fastest_pa_per_s: plan.facts.fastest,
        rig_pressure_max_pa: made.own,
        clipped_samples: plan.clipped.iter().filter(|c| c.iter().any(Option::is_some)).count(),
        planning_s: made.seconds,
        file: None,
        report: page.display().to_string(),
    };
    if plan.valid() {
        let text = made.whisk(args.pattern.name()).to_toml(&report.remarks());
        atomic::write(&args.output, text.as_bytes())?;
        report.file = Some(args.output.display().to_string());
    }
    whisk_sheet(&format!("Whisk: {}", args.pattern.name()), plan, report.facts()).write(&page)?;
    if context.json { context.print_json(&report) } else { context.print(report.text()) }
}

/// The eight of the flags' defaults for the module of `rig`.
pub fn example(rig: &Rig, context: &Context) -> Result<Whisk, Failure> {
    let args = Args::from_arg_matches(&Args::augment_args(clap::Command::new("whisk")).get_matches_from(["whisk"]));
    Ok(args.map_err(|error| Failure::usage(anyhow!("{error}")))?.make(rig, context)?.whisk("eight"))
}

/// The rig's module, or four of its first FREE.
fn scene(rig: &Rig) -> Result<ModuleScene, Failure> {
    if let Some(scene) = rig.module_scene() {
        return Ok(scene);
    }
    let first = rig.calibrations.first().ok_or_else(|| Failure::usage(anyhow!("the rig has no FREE")))?;
    Ok(ModuleScene::new(&first.tube().0, first.free().length, Layout::RLRL, SPACING))
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Eight => "eight",
            Kind::Paper => "paper",
            Kind::Round => "round",
        }
    }
}

impl Args {
    fn make(&self, rig: &Rig, context: &Context) -> Result<Made, Failure> {
        let scene = scene(rig)?;
        let of_module = |index: &usize| rig.module.as_ref().is_none_or(|module| module.frees.contains(index));
        let frees = || rig.control.frees.iter().enumerate().filter(|(i, _)| of_module(i)).map(|(_, free)| &free.limits);
        let slew = frees().map(|limits| limits.slew).fold(f64::INFINITY, f64::min);
        let own = frees().map(|limits| limits.pressure_max).fold(f64::INFINITY, f64::min);
        let mut limits = self.limits.limits(slew);
        match self.pattern {
            Kind::Eight => limits.high = limits.high.map(|high| high.min(own)),
            // A pattern is answered as it is asked, whatever the rig may do.
            Kind::Paper | Kind::Round => limits.high = [self.highest.si(); 4],
        }
        let top = limits.high.iter().copied().fold(0.0, f64::max);
        let built = build(&scene, top, context)?;
        let rest = Rest::new(&built.module, &scene.loads([0.0; 4])).map_err(refused)?;
        let begun = Instant::now();
        let planned = self.plan(&rest, &limits).map_err(refused)?;
        Ok(Made { planned, seconds: begun.elapsed().as_secs_f64(), own })
    }

    fn plan(&self, rest: &Rest<'_>, limits: &Limits) -> Result<WhiskPlan, PlanError> {
        let order = match self.pattern {
            Kind::Eight => {
                let centre = match self.centre {
                    Some(List(centre)) => Vector3::from(centre.map(Length::si)),
                    // With room to go either way.
                    None => middle(rest, limits)?,
                };
                let figure = Eight::level(centre, self.width.si(), self.height.si(), self.frequency.si());
                return eight(rest, &figure, limits, self.rate.si());
            }
            Kind::Paper => Order::Crossing,
            Kind::Round => Order::Round,
        };
        let (lowest, highest) = (self.lowest.si(), self.highest.si());
        let middle = self.middle.map_or(0.5 * (lowest + highest), Pressure::si);
        pattern(rest, &Pattern { lowest, highest, middle, period: 4.0, order }, limits, self.rate.si())
    }
}

/// Where the plate is with every pressure at the share [`MIDDLE`] of its highest.
fn middle(rest: &Rest<'_>, limits: &Limits) -> Result<Vector3<f64>, PlanError> {
    let state = rest.ramp(rest.state(), &limits.high.map(|p| MIDDLE * p));
    Ok(state.map_err(|ended| PlanError::NoStart(ended.end))?.position())
}

/// Why what was asked is not all there.
fn reason(planned: &WhiskPlan) -> String {
    let facts = &planned.plan.facts;
    match (&facts.ramp, &facts.ended, &facts.shortfall) {
        (Some(ramp), ..) if planned.plan.predicted.is_empty() => {
            format!(
                "on the way from rest to its first pressures the module {} (at {} psi)",
                ramp.end,
                psi(&ramp.pressures)
            )
        }
        (_, Some((t, ended)), _) => format!("at {t:.2} s the module {} (at {})", ended.end, psi(&ended.pressures)),
        (_, _, Some(shortfall)) => format!("{} samples fall short of the eight: {shortfall}", facts.missed),
        _ => "its margin is below the least one".into(),
    }
}

impl Report {
    fn facts(&self) -> Vec<(String, String)> {
        let mm = |m: Option<f64>, digits: usize| m.map_or("-".into(), |m| format!("{:.digits$} mm", 1e3 * m));
        let mut facts: Vec<(String, String)> = Vec::new();
        let mut fact = |name: &str, value: String| facts.push((name.into(), value));
        if let Some(reason) = &self.reason {
            fact("not possible as asked", reason.clone());
        }
        if let (Some(scaled), Some(scale)) = (self.scaled, self.scale) {
            let what = match scaled {
                Scaled::Swing => "the swing of the pressures",
                Scaled::Pressures => "all pressures",
                Scaled::Size => "width and height",
            };
            fact("in its place", format!("{what} times {scale:.3}"));
        }
        fact("figure", format!("{} long, {} wide", mm(self.length_m, 2), mm(self.width_m, 2)));
        if let Some([low, high]) = self.twist_rad {
            fact("plate turns", format!("from {:.1} to {:.1} deg", low.to_degrees(), high.to_degrees()));
        }
        if self.worst_error_m.is_some() {
            fact("off the figure", format!("RMS {}, worst {}", mm(self.rms_error_m, 3), mm(self.worst_error_m, 3)));
        }
        fact("discretisation error, estimated", mm(self.discretisation_error_m, 4));
        if let (Some(least), Some(at)) = (self.least_margin, self.least_margin_s) {
            fact("least margin", format!("{:.0} % of what there is at rest, at {at:.2} s", 100.0 * least));
        }
        let (highest, fastest) =
            (Pressure::pascals(self.highest_pressure_pa), PressureRate::pascals_per_second(self.fastest_pa_per_s));
        fact("pressures", format!("up to {highest:.2}, changing by up to {fastest:.2}"));
        if self.highest_pressure_pa > self.rig_pressure_max_pa * (1.0 + 1e-9) {
            let max = Pressure::pascals(self.rig_pressure_max_pa);
            fact("not for this rig", format!("its FREEs take {max:.2}: raise max_pressure_psi, or lower --highest"));
        }
        if self.clipped_samples > 0 {
            fact("clipped", format!("{} of {} samples", self.clipped_samples, self.samples));
        }
        fact("planned", format!("{} samples of {:.2} s in {:.2} s", self.samples, self.period_s, self.planning_s));
        facts
    }

    /// What stands at the head of the file.
    fn remarks(&self) -> Vec<String> {
        let facts = self.facts().into_iter().filter(|(name, _)| name != "planned");
        let mut remarks = vec!["Made by `freerig plan whisk`; run it with `freerig whisk`.".into()];
        remarks.extend(facts.map(|(name, value)| format!("{name}: {value}")));
        remarks
    }

    fn text(&self) -> String {
        let mut text = format!("whisk: {}\n", self.pattern);
        for (name, value) in self.facts() {
            text.push_str(&format!("\n{name}: {value}"));
        }
        match &self.file {
            Some(file) => text.push_str(&format!("\nplan: {file}")),
            None => text.push_str("\nno plan written: there is no stable one of its kind"),
        }
        text.push_str(&format!("\npage: {}", self.report));
        text
    }
}

//! `freerig plan design`: what FREEs of many designs do, and which is best at what (the paper's Fig. 8).

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::Instant;

use anyhow::{Context as _, anyhow};
use serde::Serialize;

use super::study::{self, Shard};
use super::sweep::{Parameter, Sweep, combinations};
use crate::cli::table::{Table, number};
use crate::cli::tube::TubeArgs;
use crate::cli::{Context, Failure, Progress};
use crate::config::Rig;
use crate::fem::ends::Equilibrium;
use crate::fem::tube::Tube;
use crate::plan::design::{Aim, Design, best, designs, neutral};
use crate::plan::study::{Candidate, Question};
use crate::record::design_sheet;
use crate::units::{Length, Percent, Pressure};

/// What the paper finds at 175 mm in its Fig. 8, in degrees of winding angle.
const PAPER: [(Aim, f64); 4] = [(Aim::Rotation, 50.0), (Aim::Extension, 80.0), (Aim::Force, 20.0), (Aim::Moment, 30.0)];

const EXAMPLES: &str = "\
Examples:
  freerig plan design                                  the paper's Fig. 8: 10 to 80 deg, 0 to 7 psi, 175 mm
  freerig plan design --sweep gamma=20deg..70deg --count 26 --csv design.csv
  freerig plan design --sweep wall=0.5mm..1.5mm --gamma -40deg --length 130mm
  freerig plan design --sweep mu=0.2MPa..0.8MPa --pressure 5psi
  freerig plan design --study study --sweep gamma=10deg..80deg:71 --sweep wall=0.5mm..1.5mm:11 --sweep fibers=4..12
  freerig plan design --study study ... --shard 2/16    one share of sixteen; without --shard: what is missing, and all
                                                        in one file (experiments/design/study.sbatch is a job array)";

/// What `freerig plan design` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    tube: TubeArgs,
    /// What is varied, from where to where: gamma, wall, inner-diameter, fibers, fiber-width, fiber-ea, mu, alpha, or,
    /// in a study, spacing; several in a study, which has every combination
    #[arg(
        long,
        value_name = "NAME=FROM..TO[:COUNT]",
        default_value = "gamma=10deg..80deg",
        allow_hyphen_values = true
    )]
    sweep: Vec<Sweep>,
    /// How many values of a sweep that does not say it
    #[arg(long, value_name = "N", default_value_t = 15, value_parser = clap::value_parser!(u16).range(2..=10_000))]
    count: u16,
    /// Highest pressure; the curves go there in steps of a seventh
    #[arg(long, default_value = "7psi")]
    pressure: Pressure,
    /// Relative discretisation error of every design
    #[arg(long, default_value = "0.5%")]
    tolerance: Percent,
    /// Write every design and pressure to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Compute a study in this folder: what is there of it stays, what is missing is computed, and when all is there it
    /// is merged into designs.parquet
    #[arg(long, value_name = "FOLDER", conflicts_with = "csv")]
    study: Option<PathBuf>,
    /// Compute only this share of the study, for example 2/16: for job arrays
    #[arg(long, value_name = "I/N", requires = "study")]
    shard: Option<Shard>,
}

/// Steps of a curve.
const STEPS: usize = 7;
/// Length of the paper's Fig. 8, m.
const PAPER_LENGTH: f64 = 0.175;

#[derive(Debug, Serialize)]
struct Row {
    value: f64,
    pressure_pa: f64,
    twist_rad_per_m: Option<f64>,
    axial_stretch: Option<f64>,
    force_n: Option<f64>,
    moment_nm: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Best {
    aim: &'static str,
    /// In the unit of the parameter, SI.
    value: Option<f64>,
    /// rad/m, strain, N or N m.
    reached: Option<f64>,
    /// The paper's answer, rad; only for the winding angle.
    paper: Option<f64>,
}

/// A design, SI, and a figure of it.
#[derive(Debug, Serialize)]
struct Noted {
    value: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    discretisation_error_estimate: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    beyond_pa: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    parameter: &'static str,
    length_m: f64,
    pressure_pa: f64,
    best: Vec<Best>,
    /// Designs without an equilibrium at that pressure, free and blocked, in the unit of the parameter, SI: they are
    /// not among the best.
    free_ended: Vec<f64>,
    blocked_ended: Vec<f64>,
    /// Where free extension changes its sign, SI.
    neutral: Option<f64>,
    paper_neutral: Option<f64>,
    tolerance: f64,
    discretisation_error_estimate: f64,
    /// Designs whose error the finest mesh leaves above the tolerance.
    missed: Vec<Noted>,
    /// Designs whose rubber may fold at the strip's end when they are blocked, and beyond which pressure.
    folds: Vec<Noted>,
    rows: Vec<Row>,
    wall_time_s: f64,
    report: String,
    csv: Option<PathBuf>,
}

/// Computes the designs and prints which is best at what.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let (tube, length) = args.tube.tube(context)?;
    let length = if args.tube.has_length() { length } else { PAPER_LENGTH };
    if args.pressure.si() <= 0.0 {
        return Err(Failure::usage(anyhow!("--pressure {:.3} must be positive", args.pressure)));
    }
    let pressures: Vec<f64> = (0..=STEPS).map(|i| args.pressure.si() * i as f64 / STEPS as f64).collect();
    let base = Candidate { tube, spacing: None };
    let told = |error: String| Failure::usage(anyhow!(error));
    let candidates = combinations(base, &args.sweep, args.count.into()).map_err(told)?;
    if let Some(folder) = &args.study {
        let question = Question { length, pressures, tolerance: args.tolerance.si() };
        return study::run(folder, args.shard, &args.sweep, &candidates, &question, context);
    }
    let &[Sweep { parameter, .. }] = args.sweep.as_slice() else {
        let error = anyhow!("{} sweeps at once are a study", args.sweep.len());
        return Err(Failure::usage(error).remedy("name its folder: `--study FOLDER`"));
    };
    if parameter == Parameter::Spacing {
        let error = anyhow!("the spacing belongs to a module, and one FREE is asked here");
        return Err(Failure::usage(error).remedy("ask a study: `--study FOLDER`"));
    }
    let tubes: Vec<Tube> = candidates.iter().map(|candidate| candidate.tube).collect();
    let begun = Instant::now();
    let progress = Mutex::new((0.0, Progress::new("designs", args.count as f64, "designs")));
    let computed = designs(&tubes, &pressures, args.tolerance.si(), || {
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.0 += 1.0;
        let done = progress.0;
        progress.1.set(done, "");
    });
    drop(progress);
    let computed =
        computed.map_err(|error| Failure::failed(error).remedy("narrow the sweep, or lower the pressure"))?;
    let last = STEPS;
    let in_paper = parameter == Parameter::Gamma;
    let best = PAPER.iter().map(|&(aim, paper)| {
        let found = best(&computed, aim, last);
        Best {
            aim: aim.name(),
            value: found.map(|d| value_of(parameter, d)),
            reached: found.and_then(|d| aim.of(d, last)),
            paper: in_paper.then_some(paper.to_radians()),
        }
    });
    let rig = Rig::load(&context.rig)?;
    std::fs::create_dir_all(&rig.record.directory)?;
    let page = rig.record.directory.join(format!("design-{}.html", parameter.name()));
    let values: Vec<f64> = computed.iter().map(|d| parameter.shown(value_of(parameter, d))).collect();
    let axis = parameter.label();
    let ended = |of: fn(&Design) -> &Vec<Option<Equilibrium>>| -> Vec<f64> {
        computed.iter().filter(|d| of(d)[last].is_none()).map(|d| value_of(parameter, d)).collect()
    };
    let noted = |design: &Design, discretisation_error_estimate, beyond_pa| Noted {
        value: value_of(parameter, design),
        discretisation_error_estimate,
        beyond_pa,
    };
    let mut report = Report {
        free_ended: ended(|d| &d.free),
        blocked_ended: ended(|d| &d.blocked),
        parameter: parameter.name(),
        length_m: length,
        pressure_pa: args.pressure.si(),
        best: best.collect(),
        neutral: neutral(&computed, last, |d| value_of(parameter, d)),
        paper_neutral: in_paper.then_some(54.7356f64.to_radians()),
        tolerance: args.tolerance.si(),
        missed: computed
            .iter()
            .filter(|d| d.error > args.tolerance.si())
            .map(|d| noted(d, Some(d.error), None))
            .collect(),
        folds: computed.iter().filter(|d| d.folds_beyond.is_some()).map(|d| noted(d, None, d.folds_beyond)).collect(),
        discretisation_error_estimate: computed.iter().map(|d| d.error).fold(0.0, f64::max),
        rows: rows(&computed, parameter, &pressures),
        wall_time_s: begun.elapsed().as_secs_f64(),
        report: page.display().to_string(),
        csv: args.csv.clone(),
    };
    let facts = report.facts(parameter);
    design_sheet(&format!("Designs by {axis}"), &axis, &values, &computed, &pressures, length, facts).write(&page)?;
    if let Some(path) = &args.csv {
        write_csv(path, &report, parameter).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if context.json {
        return context.print_json(&report);
    }
    report.rows.retain(|row| row.pressure_pa == args.pressure.si());
    context.print(report.text(parameter))
}

fn value_of(parameter: Parameter, design: &Design) -> f64 {
    parameter.get(&Candidate { tube: design.tube, spacing: None })
}

fn rows(designs: &[Design], parameter: Parameter, pressures: &[f64]) -> Vec<Row> {
    let of = |design: &Design, i: usize| Row {
        value: value_of(parameter, design),
        pressure_pa: pressures[i],
        twist_rad_per_m: design.free[i].map(|e| e.twist),
        axial_stretch: design.free[i].map(|e| e.stretch),
        force_n: design.blocked[i].map(|e| e.force),
        moment_nm: design.blocked[i].map(|e| e.moment),
    };
    designs.iter().flat_map(|design| (0..pressures.len()).map(move |i| of(design, i))).collect()
}

fn write_csv(path: &std::path::Path, report: &Report, parameter: Parameter) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    let (name, unit) = (parameter.name().replace('-', "_"), parameter.unit());
    let unit = if unit.is_empty() { String::new() } else { format!("_{}", unit.to_lowercase()) };
    writeln!(file, "{name}{unit},pressure_pa,twist_rad_per_m,axial_stretch,force_n,moment_nm")?;
    let cell = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:e}"));
    for row in &report.rows {
        let cells = [row.twist_rad_per_m, row.axial_stretch, row.force_n, row.moment_nm].map(cell);
        writeln!(file, "{},{},{}", parameter.shown(row.value), row.pressure_pa, cells.join(","))?;
    }
    file.flush()
}

impl Report {
    fn facts(&self, parameter: Parameter) -> Vec<(String, String)> {
        let unit = parameter.unit();
        let show = |value: f64| format!("{:.1} {unit}", parameter.shown(value));
        let mut facts: Vec<(String, String)> = Vec::new();
        for best in &self.best {
            let reached = match best.reached {
                Some(x) if best.aim == "rotation" => format!("{:.1} deg", (x * self.length_m).to_degrees()),
                Some(x) if best.aim == "extension" => format!("{:.2} mm", 1e3 * x * self.length_m),
                Some(x) if best.aim == "force" => format!("{x:.2} N"),
                Some(x) => format!("{:.1} mN m", 1e3 * x),
                None => "no equilibrium at this pressure".into(),
            };
            let paper = best.paper.map(|p| format!("; the paper: {}", show(p))).unwrap_or_default();
            let at = best.value.map_or("-".into(), show);
            facts.push((format!("most {}", best.aim), format!("{at} ({reached}){paper}")));
        }
        for (held, ended) in [("free", &self.free_ended), ("blocked", &self.blocked_ended)] {
            if !ended.is_empty() {
                let values: Vec<String> = ended.iter().map(|v| format!("{:.1}", parameter.shown(*v))).collect();
                let what = format!("{} {unit}: past their limit at this pressure, not compared", values.join(", "));
                facts.push((format!("{held} ones left out"), what));
            }
        }
        let neutral = self.neutral.map_or("not within the sweep".into(), show);
        let paper = self.paper_neutral.map(|p| format!("; at small pressure: {}", show(p))).unwrap_or_default();
        facts.push(("no extension".into(), format!("{neutral}{paper}")));
        facts.push((
            "at".into(),
            format!("{:.2}, length {:.0}", Pressure::pascals(self.pressure_pa), Length::metres(self.length_m)),
        ));
        let (most, wanted) = (100.0 * self.discretisation_error_estimate, 100.0 * self.tolerance);
        facts.push(("discretisation error, estimated".into(), format!("at most {most:.2} %")));
        if !self.missed.is_empty() {
            let each = self.missed.iter().map(|d| {
                format!("{} ({:.2} %)", show(d.value), 100.0 * d.discretisation_error_estimate.unwrap_or(f64::NAN))
            });
            let each = each.collect::<Vec<_>>().join(", ");
            facts.push((format!("tolerance of {wanted} % missed, on the finest mesh there is"), each));
        }
        if !self.folds.is_empty() {
            let each = self.folds.iter().map(|d| {
                let beyond = d.beyond_pa.unwrap_or(f64::NAN);
                format!("{} beyond {:.2}", show(d.value), Pressure::pascals(beyond))
            });
            let what = "; there the blocked values, and their error, are of rubber that has not folded at the edge of the \
                        fibre's strip: `freerig model single --ends blocked` says how much less it bears then";
            facts.push(("blocked ones fold".into(), each.collect::<Vec<_>>().join(", ") + what));
        }
        facts.push(("time".into(), format!("{:.2} s", self.wall_time_s)));
        facts
    }

    fn text(&self, parameter: Parameter) -> String {
        let head = format!(">{} {}", parameter.name(), parameter.unit());
        let mut table = Table::new(&[
            &head,
            ">rotation deg",
            ">deg/mm",
            ">extension mm",
            ">blocked force N",
            ">blocked moment mN m",
        ]);
        for row in &self.rows {
            let twist = row.twist_rad_per_m;
            table.row([
                format!("{:.2}", parameter.shown(row.value)),
                number(twist.map(|t| (t * self.length_m).to_degrees()), 1),
                number(twist.map(|t| 1e-3 * t.to_degrees()), 4),
                number(row.axial_stretch.map(|s| 1e3 * (s - 1.0) * self.length_m), 2),
                number(row.force_n, 3),
                number(row.moment_nm.map(|m| 1e3 * m), 2),
            ]);
        }
        let facts =
            self.facts(parameter).into_iter().map(|(name, value)| format!("\n{name}: {value}")).collect::<String>();
        let csv = self.csv.as_ref().map(|path| format!("\nall pressures: {}", path.display())).unwrap_or_default();
        format!("{table}\n{facts}\ncurves: {}{csv}", self.report)
    }
}

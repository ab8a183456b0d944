//! `freerig plan design`: what FREEs of many designs do, and which is best at what (the paper's Fig. 8).

use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::Instant;

use anyhow::{Context as _, anyhow};
use serde::Serialize;

use crate::cli::table::{Table, number};
use crate::cli::tube::TubeArgs;
use crate::cli::{Context, Failure, Progress};
use crate::config::Rig;
use crate::fem::ends::Equilibrium;
use crate::fem::tube::Tube;
use crate::plan::design::{Aim, Design, best, designs, neutral};
use crate::record::design_sheet;
use crate::units::{Angle, Length, Percent, Pressure};

/// What the paper finds at 175 mm in its Fig. 8, in degrees of winding angle.
const PAPER: [(Aim, f64); 4] = [(Aim::Rotation, 50.0), (Aim::Extension, 80.0), (Aim::Force, 20.0), (Aim::Moment, 30.0)];

const EXAMPLES: &str = "\
Examples:
  freerig plan design                                  the paper's Fig. 8: 10 to 80 deg, 0 to 7 psi, 175 mm
  freerig plan design --sweep gamma=20deg..70deg --count 26 --csv design.csv
  freerig plan design --sweep wall=0.5mm..1.5mm --gamma -40deg --length 130mm
  freerig plan design --sweep mu=0.2MPa..0.8MPa --pressure 5psi";

/// What `freerig plan design` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    tube: TubeArgs,
    /// What is varied, from where to where: gamma, wall, inner-diameter, fiber-width or mu
    #[arg(long, value_name = "NAME=FROM..TO", default_value = "gamma=10deg..80deg", allow_hyphen_values = true)]
    sweep: Sweep,
    /// How many designs
    #[arg(long, value_name = "N", default_value_t = 15)]
    count: usize,
    /// Highest pressure; the curves go there in steps of a seventh
    #[arg(long, default_value = "7psi")]
    pressure: Pressure,
    /// Relative discretisation error of every design
    #[arg(long, default_value = "0.5%")]
    tolerance: Percent,
    /// Write every design and pressure to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

/// Steps of a curve.
const STEPS: usize = 7;
/// Most designs of one call.
const COUNTS: std::ops::RangeInclusive<usize> = 2..=10_000;
/// Length of the paper's Fig. 8, m.
const PAPER_LENGTH: f64 = 0.175;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Parameter {
    Gamma,
    Wall,
    InnerDiameter,
    FiberWidth,
    Mu,
}

impl Parameter {
    const ALL: [(Parameter, &'static str, &'static str); 5] = [
        (Parameter::Gamma, "gamma", "deg"),
        (Parameter::Wall, "wall", "mm"),
        (Parameter::InnerDiameter, "inner-diameter", "mm"),
        (Parameter::FiberWidth, "fiber-width", "mm"),
        (Parameter::Mu, "mu", "MPa"),
    ];

    fn parse(self, text: &str) -> Result<f64, String> {
        match self {
            Parameter::Gamma => text.parse::<Angle>().map(Angle::si),
            Parameter::Mu => text.parse::<Pressure>().map(Pressure::si),
            Parameter::Wall | Parameter::InnerDiameter | Parameter::FiberWidth => {
                text.parse::<Length>().map(Length::si)
            }
        }
        .map_err(|error| error.to_string())
    }

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|p| p.0 == self).map_or("", |p| p.1)
    }

    fn unit(self) -> &'static str {
        Self::ALL.iter().find(|p| p.0 == self).map_or("", |p| p.2)
    }

    /// `value` (SI) in the unit that it is shown in.
    fn shown(self, value: f64) -> f64 {
        match self {
            Parameter::Gamma => value.to_degrees(),
            Parameter::Mu => 1e-6 * value,
            Parameter::Wall | Parameter::InnerDiameter | Parameter::FiberWidth => 1e3 * value,
        }
    }

    fn set(self, tube: &Tube, value: f64) -> Tube {
        match self {
            Parameter::Gamma => Tube { gamma: value, ..*tube },
            Parameter::Wall => Tube { wall: value, ..*tube },
            Parameter::InnerDiameter => Tube { inner_radius: 0.5 * value, ..*tube },
            Parameter::FiberWidth => Tube { fiber_width: value, ..*tube },
            Parameter::Mu => Tube { law: tube.law.with_shear_modulus(value), ..*tube },
        }
    }

    fn get(self, tube: &Tube) -> f64 {
        match self {
            Parameter::Gamma => tube.gamma,
            Parameter::Wall => tube.wall,
            Parameter::InnerDiameter => 2.0 * tube.inner_radius,
            Parameter::FiberWidth => tube.fiber_width,
            Parameter::Mu => tube.law.shear_modulus(),
        }
    }
}

/// `gamma=10deg..80deg`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sweep {
    parameter: Parameter,
    from: f64,
    to: f64,
}

impl std::str::FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let form = || format!("`{text}` is no sweep; write NAME=FROM..TO, for example gamma=10deg..80deg");
        let (name, range) = text.split_once('=').ok_or_else(form)?;
        let (from, to) = range.split_once("..").ok_or_else(form)?;
        let names = || Parameter::ALL.map(|p| p.1).join(", ");
        let known = Parameter::ALL.iter().find(|p| p.1 == name);
        let (parameter, ..) = *known.ok_or_else(|| format!("`{name}` cannot be swept; one of: {}", names()))?;
        let sweep = Sweep { parameter, from: parameter.parse(from)?, to: parameter.parse(to)? };
        if sweep.from == sweep.to { Err(format!("`{text}` goes nowhere: FROM and TO must differ")) } else { Ok(sweep) }
    }
}

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
    discretisation_error_estimate: f64,
    rows: Vec<Row>,
    wall_time_s: f64,
    report: String,
    csv: Option<PathBuf>,
}

/// Computes the designs and prints which is best at what.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let (tube, length) = args.tube.tube(context)?;
    let length = if args.tube.has_length() { length } else { PAPER_LENGTH };
    if !COUNTS.contains(&args.count) {
        let (least, most) = (COUNTS.start(), COUNTS.end());
        return Err(Failure::usage(anyhow!("--count {} must be between {least} and {most}", args.count)));
    }
    if args.pressure.si() <= 0.0 {
        return Err(Failure::usage(anyhow!("--pressure {:.3} must be positive", args.pressure)));
    }
    let Sweep { parameter, from, to } = args.sweep;
    let value = |i: usize| from + (to - from) * i as f64 / (args.count - 1) as f64;
    let tubes: Vec<Tube> = (0..args.count).map(|i| parameter.set(&tube, value(i))).collect();
    let pressures: Vec<f64> = (0..=STEPS).map(|i| args.pressure.si() * i as f64 / STEPS as f64).collect();
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
            value: found.map(|d| parameter.get(&d.tube)),
            reached: found.and_then(|d| aim.of(d, last)),
            paper: in_paper.then_some(paper.to_radians()),
        }
    });
    let rig = Rig::load(&context.rig)?;
    std::fs::create_dir_all(&rig.record.directory)?;
    let page = rig.record.directory.join(format!("design-{}.html", parameter.name()));
    let values: Vec<f64> = computed.iter().map(|d| parameter.shown(parameter.get(&d.tube))).collect();
    let axis = format!("{} ({})", parameter.name(), parameter.unit());
    let ended = |of: fn(&Design) -> &Vec<Option<Equilibrium>>| -> Vec<f64> {
        computed.iter().filter(|d| of(d)[last].is_none()).map(|d| parameter.get(&d.tube)).collect()
    };
    let mut report = Report {
        free_ended: ended(|d| &d.free),
        blocked_ended: ended(|d| &d.blocked),
        parameter: parameter.name(),
        length_m: length,
        pressure_pa: args.pressure.si(),
        best: best.collect(),
        neutral: neutral(&computed, last, |d| parameter.get(&d.tube)),
        paper_neutral: in_paper.then_some(54.7356f64.to_radians()),
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

fn rows(designs: &[Design], parameter: Parameter, pressures: &[f64]) -> Vec<Row> {
    let of = |design: &Design, i: usize| Row {
        value: parameter.get(&design.tube),
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
    writeln!(file, "{name}_{},pressure_pa,twist_rad_per_m,axial_stretch,force_n,moment_nm", unit.to_lowercase())?;
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
        facts.push((
            "discretisation error, estimated".into(),
            format!("{:.2} %", 100.0 * self.discretisation_error_estimate),
        ));
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

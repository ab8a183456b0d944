//! `freerig plan path`: the pressures over time that take the plate along a path.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use nalgebra::Vector3;
use serde::Serialize;

use super::{LimitArgs, Shares, Stop, bound_names, psi, refused};
use crate::cli::scene::{SceneArgs, build};
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure, Progress};
use crate::config::{Rig, waypoints};
use crate::fem::module::NAMES;
use crate::plan::{PathPlan, Rest, Target, path};
use crate::record::way_sheet;
use crate::units::{PASCAL_PER_PSI, PressureRate};

const EXAMPLES: &str = "\
FILE.csv has a row for each moment and the columns t_s, x_mm, y_mm, z_mm (or other units of time and length): where \
the plate's centre should be in the base's frame. The plan begins at its first point; how to get there from rest is \
the regulators' business, within the same slew rate. A point out of reach is projected, counted, and its reason is told. \
The file of --csv can be given to `freerig model module --pressures`; its clipped columns are 1 where the highest \
pressure or rate, -1 where the lowest holds a pressure that does not reach its point.

Examples:
  freerig plan path --gamma 60deg circle.csv
  freerig plan path --gamma 60deg circle.csv --slew 5psi/s --max-pressure 6psi --csv pressures.csv
  freerig plan path --gamma 30deg line.csv --dead C --json";

/// What `freerig plan path` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// The path: t_s, x_mm, y_mm, z_mm
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    limits: LimitArgs,
    /// Fastest change of every pressure [default: of the FREE of rig.toml]
    #[arg(long, value_name = "RATE")]
    slew: Option<PressureRate>,
    /// Write pressures and prediction to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

/// Rows of the text's table, at most.
const SHOWN: usize = 21;

#[derive(Debug, Serialize)]
struct Sample {
    t_s: f64,
    pressures_pa: [f64; 4],
    planned_m: [f64; 3],
    position_m: Option<[f64; 3]>,
    quaternion_wxyz: Option<[f64; 4]>,
    error_m: Option<f64>,
    margin: Option<Shares>,
    /// By FREE: the bound that holds its pressure where the point is not reached.
    clipped: [Option<&'static str>; 4],
}

#[derive(Debug, Serialize)]
struct Report {
    samples: Vec<Sample>,
    worst_error_m: Option<f64>,
    rms_error_m: Option<f64>,
    /// Points that are not reached.
    missed: usize,
    shortfall: Option<String>,
    least_margin: Option<f64>,
    least_margin_time_s: Option<f64>,
    slew_pa_per_s: f64,
    fastest_pa_per_s: f64,
    discretisation_error_m: Option<f64>,
    /// Where the straight ramp from rest to the first pressures ends before it gets there.
    ramp_ends: Option<Stop>,
    wall_time_s: f64,
    report: String,
    csv: Option<PathBuf>,
}

/// Plans the path and prints it.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let scene = args.scene.scene(context)?;
    let points = waypoints(&args.file)?;
    let slew = match args.slew {
        Some(slew) => slew.si(),
        None => args.scene.slew(context)?,
    };
    let limits = args.limits.limits(slew);
    limits.check().map_err(refused)?;
    let targets: Vec<Target> = points.positions.iter().map(|p| Target::point(Vector3::from(*p))).collect();
    let built = build(&scene, args.limits.max_pressure.si(), context)?;
    context.note(format!("planning {} points", targets.len()));
    let begun = Instant::now();
    let rest = Rest::new(&built.module, &scene.loads([0.0; 4])).map_err(refused)?;
    let mut progress = Progress::new("path", targets.len() as f64, "points");
    let planned = path::follow(&rest, &points.times, &targets, &limits, None, &mut |done| {
        progress.set(done as f64, "");
    });
    drop(progress);
    let plan = planned.map_err(refused)?;
    let rig = Rig::load(&context.rig)?;
    std::fs::create_dir_all(&rig.record.directory)?;
    let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
    let page = rig.record.directory.join(format!("path-{stem}.html"));
    let report = Report::of(&plan, slew, begun.elapsed().as_secs_f64(), &page, args.csv.clone());
    let gamma = scene.frees[0].tube.gamma.abs().to_degrees();
    let title = format!("Path {stem}, module of {gamma:.1} deg");
    way_sheet(&title, &plan, report.facts(), report.remarks()).write(&page)?;
    if let Some(path) = &args.csv {
        write_csv(path, &report.samples).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if context.json { context.print_json(&report) } else { context.print(report.text()) }
}

impl Report {
    fn of(plan: &PathPlan, slew: f64, wall_time_s: f64, page: &Path, csv: Option<PathBuf>) -> Report {
        let sample = |i: usize| {
            let planned = plan.planned[i].position;
            let pose = plan.predicted.get(i);
            let off = pose.map(|pose| (Vector3::from(pose.position) - Vector3::from(planned)).norm());
            Sample {
                t_s: plan.times[i],
                pressures_pa: plan.pressures[i],
                planned_m: planned,
                position_m: pose.map(|pose| pose.position),
                quaternion_wxyz: pose.map(|pose| pose.rotation),
                error_m: off,
                margin: plan.margins.get(i).map(Shares::from),
                clipped: plan.clipped.get(i).map_or([None; 4], bound_names),
            }
        };
        let facts = &plan.facts;
        Report {
            samples: (0..plan.times.len()).map(sample).collect(),
            worst_error_m: facts.worst_error,
            rms_error_m: facts.rms_error,
            missed: facts.missed,
            shortfall: facts.shortfall.as_ref().map(ToString::to_string),
            least_margin: facts.least_margin.map(|(margin, _)| margin),
            least_margin_time_s: facts.least_margin.map(|(_, t)| t),
            slew_pa_per_s: slew,
            fastest_pa_per_s: facts.fastest,
            discretisation_error_m: facts.discretisation,
            ramp_ends: facts.ramp.as_ref().map(Stop::from),
            wall_time_s,
            report: page.display().to_string(),
            csv,
        }
    }

    /// What nobody should overlook.
    fn remarks(&self) -> Vec<String> {
        let missed = (self.missed > 0).then(|| {
            let reason = self.shortfall.as_deref().unwrap_or_default();
            format!("{} of {} points are not reached, the first one because {reason}", self.missed, self.samples.len())
        });
        missed.into_iter().collect()
    }

    fn facts(&self) -> Vec<(String, String)> {
        let mm = |x: Option<f64>| x.map_or("-".to_owned(), |x| format!("{:.3} mm", 1e3 * x));
        let count = self.samples.len();
        let mut facts =
            vec![("error".to_owned(), format!("{} at most, {} RMS", mm(self.worst_error_m), mm(self.rms_error_m)))];
        let reached = match &self.shortfall {
            None => format!("all {count} points"),
            Some(reason) => format!("{} of {count} points; the first that is not: {reason}", count - self.missed),
        };
        facts.push(("reached".into(), reached));
        if let (Some(margin), Some(t)) = (self.least_margin, self.least_margin_time_s) {
            facts.push(("least margin".into(), format!("{margin:.3} of what there is at rest, at {t:.3} s")));
        }
        let rate = |x: f64| PressureRate::pascals_per_second(x).display_value();
        let fastest = format!("{:.2} psi/s of {:.2}", rate(self.fastest_pa_per_s), rate(self.slew_pa_per_s));
        facts.push(("fastest change of a pressure".into(), fastest));
        facts.push(("error by the rods' resolution, estimated".into(), mm(self.discretisation_error_m)));
        if let Some(stop) = &self.ramp_ends {
            let text = format!("not by a straight ramp: at {} {}", psi(&stop.pressures_pa), stop.reason);
            facts.push(("from rest to its beginning".into(), text));
        }
        facts.push(("time".into(), format!("{:.2} s", self.wall_time_s)));
        facts
    }

    fn text(&self) -> String {
        let head = ["A", "B", "C", "D"].map(|free| format!(">{free} psi"));
        let mut columns = vec![">t s"];
        columns.extend(head.iter().map(String::as_str));
        columns.extend([">x mm", ">y mm", ">z mm", ">error mm", ">margin", "clipped"]);
        let mut table = Table::new(&columns);
        let stride = self.samples.len().div_ceil(SHOWN).max(1);
        for sample in self.samples.iter().step_by(stride) {
            let margin = sample.margin.map(|m| m.stiffness.min(m.clearance.unwrap_or(f64::INFINITY)));
            let position = [0, 1, 2].map(|i| number(sample.position_m.map(|x| 1e3 * x[i]), 3));
            let last = [number(sample.error_m.map(|e| 1e3 * e), 3), number(margin, 3), sample.clips()];
            let pressures = sample.pressures_pa.map(|p| number(Some(p / PASCAL_PER_PSI), 3));
            table.row([number(Some(sample.t_s), 3)].into_iter().chain(pressures).chain(position).chain(last));
        }
        let facts = self.facts().into_iter().map(|(name, value)| format!("\n{name}: {value}")).collect::<String>();
        let csv = self.csv.as_ref().map(|path| format!("\nall points: {}", path.display())).unwrap_or_default();
        format!("{table}\n{facts}\npage: {}{csv}", self.report)
    }
}

impl Sample {
    /// "A high, C low".
    fn clips(&self) -> String {
        let each = NAMES.iter().zip(self.clipped).filter_map(|(name, bound)| Some(format!("{name} {}", bound?)));
        each.collect::<Vec<_>>().join(" ")
    }
}

fn write_csv(path: &Path, samples: &[Sample]) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    writeln!(
        file,
        "t_s,a_psi,b_psi,c_psi,d_psi,planned_x_mm,planned_y_mm,planned_z_mm,x_mm,y_mm,z_mm,qw,qx,qy,qz,error_mm,\
         stiffness_margin,clearance_margin,a_clipped,b_clipped,c_clipped,d_clipped"
    )?;
    let cell = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
    for sample in samples {
        let mut cells = vec![sample.t_s.to_string()];
        cells.extend(sample.pressures_pa.map(|p| (p / PASCAL_PER_PSI).to_string()));
        cells.extend(sample.planned_m.map(|x| (1e3 * x).to_string()));
        cells.extend([0, 1, 2].map(|i| cell(sample.position_m.map(|x| 1e3 * x[i]))));
        cells.extend([0, 1, 2, 3].map(|i| cell(sample.quaternion_wxyz.map(|q| q[i]))));
        cells.push(cell(sample.error_m.map(|e| 1e3 * e)));
        cells.push(cell(sample.margin.map(|m| m.stiffness)));
        cells.push(cell(sample.margin.and_then(|m| m.clearance)));
        // Numbers like all others, so that any program reads the file: -1 at a lower bound, 1 at an upper one.
        cells.extend(sample.clipped.map(|bound| match bound {
            Some("low" | "slew_down") => "-1".to_owned(),
            Some(_) => "1".to_owned(),
            None => "0".to_owned(),
        }));
        writeln!(file, "{}", cells.join(","))?;
    }
    file.flush()
}

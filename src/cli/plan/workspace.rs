//! `freerig plan workspace`: what a module reaches, beside what the paper's modules did.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, anyhow};
use nalgebra::{Vector2, Vector3};
use serde::Serialize;

use super::{Shares, Stop, refused};
use crate::cli::scene::{Built, SceneArgs, build};
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure, Progress};
use crate::config::Rig;
use crate::fem::module::{ModuleScene, square};
use crate::plan::workspace::{CasePath, Comparison, Outline, Reach, against_paper, cases, reach};
use crate::plan::{Limits, Rest, turn_and_tilt};
use crate::record::{ModuleDrawing, workspace_recording, workspace_sheet};
use crate::units::{PASCAL_PER_PSI, Pressure};

const EXAMPLES: &str = "\
Cases: 1 all four FREEs, 2 a diagonal pair, 3 one, 4 two neighbours, 5 three; fifteen paths. Beside the page stands a \
recording in space for rerun's viewer.

Examples:
  freerig plan workspace --gamma 30deg,60deg            the paper's two modules
  freerig plan workspace --gamma 60deg --spacing 25mm --pressure 5psi --csv workspace.csv
  freerig plan workspace --gamma 60deg --plate-mass 50g --json";

/// What `freerig plan workspace` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Highest pressure
    #[arg(long, default_value = "7psi")]
    pressure: Pressure,
    /// Write every pose of every path to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

/// Poses of a path.
const POINTS: usize = 29;
/// The paper's winding angles, deg, and how near one must be to be held against them.
const PAPER: [f64; 2] = [30.0, 60.0];
const NEAR: f64 = 0.05;

/// A pose of a path.
#[derive(Debug, Serialize)]
struct Point {
    pressure_pa: f64,
    position_m: [f64; 3],
    quaternion_wxyz: [f64; 4],
    margin: Shares,
}

/// A path of a case.
#[derive(Debug, Serialize)]
struct PathReport {
    case: u8,
    /// Under pressure.
    frees: String,
    points: Vec<Point>,
    /// At its last pose.
    sideways_m: f64,
    along_z_m: f64,
    turn_rad: f64,
    tilt_rad: f64,
    /// Largest distance of a pose from the straight line to the last one.
    off_chord_m: f64,
    ended: Option<Stop>,
}

/// A hull in one plane.
#[derive(Debug, Serialize)]
struct Hull {
    corners_m: Vec<[f64; 2]>,
    area_m2: f64,
    /// Share of points tried in it that are reached.
    filled: f64,
}

#[derive(Debug, Serialize)]
struct ModuleReport {
    gamma_rad: f64,
    length_m: f64,
    spacing_m: f64,
    rest_position_m: [f64; 3],
    paths: Vec<PathReport>,
    hull_xy: Hull,
    hull_xz: Hull,
    plates_found: usize,
    /// Combinations of five pressures each that no stable way with enough margin leads to, of how many.
    refused: [usize; 2],
    /// Least and greatest turn about the plate's own axis.
    turn_rad: [f64; 2],
    /// Greatest angle between the plate's axis and z.
    tilt_rad: f64,
    least_margin: f64,
}

/// A number of the paper's.
#[derive(Debug, Serialize)]
struct Against {
    what: &'static str,
    unit: &'static str,
    paper: f64,
    ours: Option<f64>,
    /// `ours / paper - 1`.
    misfit: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    pressure_pa: f64,
    modules: Vec<ModuleReport>,
    paper: Vec<Against>,
    remarks: Vec<String>,
    wall_time_s: f64,
    report: String,
    recording: String,
    csv: Option<PathBuf>,
}

/// A module with all that was found of it.
struct Found<'a> {
    scene: &'a ModuleScene,
    name: String,
    rest: Rest<'a>,
    paths: Vec<CasePath>,
    reach: Reach,
}

/// Computes the workspaces and prints them.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let highest = args.pressure.si();
    if highest <= 0.0 {
        return Err(Failure::usage(anyhow!("--pressure {:.3} must be positive", args.pressure)));
    }
    let scenes = args.scene.scenes(context)?;
    let begun = Instant::now();
    let built: Vec<Built> = scenes.iter().map(|scene| build(scene, highest, context)).collect::<Result<_, _>>()?;
    let mut progress = Progress::new("workspace", 2.0 * scenes.len() as f64, "parts");
    let mut found = Vec::new();
    for (i, (scene, built)) in scenes.iter().zip(&built).enumerate() {
        let gamma = scene.frees[0].tube.gamma.abs().to_degrees();
        let name = format!("{} deg", number(Some(gamma), 1).trim_end_matches(".0"));
        let rest = Rest::new(&built.module, &scene.loads([0.0; 4])).map_err(refused)?;
        progress.set(2.0 * i as f64, &format!("{name}: fifteen paths"));
        let paths = cases(&rest, highest, POINTS).map_err(refused)?;
        progress.set(2.0 * i as f64 + 1.0, &format!("{name}: hull"));
        let reach = reach(&rest, &Limits::up_to(highest), &paths).map_err(refused)?;
        found.push(Found { scene, name, rest, paths, reach });
    }
    drop(progress);
    let rig = Rig::load(&context.rig)?;
    std::fs::create_dir_all(&rig.record.directory)?;
    let names: Vec<&str> = found.iter().map(|f| f.name.trim_end_matches(" deg")).collect();
    let stem = format!("workspace-{}deg", names.join("-"));
    let (page, recording) = (format!("{stem}.html"), format!("{stem}.rrd"));
    let place = |name: &str| rig.record.directory.join(name);
    let report = Report {
        pressure_pa: highest,
        modules: found.iter().map(Found::report).collect(),
        paper: paper(&found, highest).iter().map(Against::from).collect(),
        remarks: remarks(&found, highest),
        wall_time_s: begun.elapsed().as_secs_f64(),
        report: place(&page).display().to_string(),
        recording: place(&recording).display().to_string(),
        csv: args.csv.clone(),
    };
    let drawings: Vec<ModuleDrawing<'_>> = found.iter().map(Found::drawing).collect();
    let title =
        format!("Workspace of modules of {}", found.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(", "));
    workspace_sheet(&title, &drawings, report.page_facts(), report.remarks.clone(), &recording).write(&place(&page))?;
    workspace_recording(&place(&recording), &title, &drawings)?;
    if let Some(path) = &args.csv {
        write_csv(path, &report).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if context.json { context.print_json(&report) } else { context.print(report.text()) }
}

/// The paper's figures and ours, as far as these are its modules at its pressure.
fn paper(found: &[Found<'_>], highest: f64) -> Vec<Comparison> {
    if (highest / PASCAL_PER_PSI - 7.0).abs() > 1e-6 {
        return Vec::new();
    }
    let of = |gamma: f64| found.iter().find(|f| (f.gamma().to_degrees() - gamma).abs() < NEAR);
    match PAPER.map(of) {
        [Some(thirty), Some(sixty)] => against_paper((&thirty.rest, &thirty.paths), (&sixty.rest, &sixty.paths)),
        // One of the two: its own rows.
        [Some(one), None] | [None, Some(one)] => {
            let both = against_paper((&one.rest, &one.paths), (&one.rest, &one.paths));
            let own = format!(", {}", one.name);
            both.into_iter().filter(|row| row.what.ends_with(&own)).collect()
        }
        [None, None] => Vec::new(),
    }
}

fn remarks(found: &[Found<'_>], highest: f64) -> Vec<String> {
    let mut remarks = Vec::new();
    let ours = |f: &Found<'_>| PAPER.iter().any(|gamma| (f.gamma().to_degrees() - gamma).abs() < NEAR);
    if (highest / PASCAL_PER_PSI - 7.0).abs() > 1e-6 || !found.iter().all(ours) {
        remarks.push(
            "the paper's figures are for modules of 30 and 60 deg at 7 psi: `freerig plan workspace --gamma 30deg,60deg` \
             holds both against them"
                .to_owned(),
        );
    } else {
        remarks.push(
            "the paper does not state how far apart its FREEs stand, and with one material no single spacing gives both \
             of its figures for Case 4: the misfits are stated, and nothing is fitted to them"
                .to_owned(),
        );
    }
    remarks
}

impl<'a> Found<'a> {
    fn gamma(&self) -> f64 {
        self.scene.frees[0].tube.gamma.abs()
    }

    fn drawing(&self) -> ModuleDrawing<'_> {
        ModuleDrawing {
            name: &self.name,
            paths: &self.paths,
            reach: &self.reach,
            spacing: self.scene.spacing,
            radius: self.scene.frees[0].tube.outer_radius(),
        }
    }

    fn report(&self) -> ModuleReport {
        let reach = &self.reach;
        let least = self.paths.iter().flat_map(|path| &path.margins).map(|margin| margin.least());
        ModuleReport {
            gamma_rad: self.gamma(),
            length_m: self.scene.frees[0].length,
            spacing_m: self.scene.spacing,
            rest_position_m: self.rest.state().position().into(),
            paths: self.paths.iter().map(|path| PathReport::of(path, &self.rest.state().position())).collect(),
            hull_xy: Hull::from(&reach.xy),
            hull_xz: Hull::from(&reach.xz),
            plates_found: reach.found.len(),
            refused: [reach.refused.0, reach.refused.1],
            turn_rad: reach.twist,
            tilt_rad: reach.tilt,
            least_margin: least.fold(f64::INFINITY, f64::min),
        }
    }
}

impl From<&Outline> for Hull {
    fn from(outline: &Outline) -> Hull {
        Hull { corners_m: outline.corners.clone(), area_m2: outline.area, filled: outline.filled }
    }
}

impl From<&Comparison> for Against {
    fn from(row: &Comparison) -> Against {
        Against { what: row.what, unit: row.unit, paper: row.paper, ours: row.ours, misfit: row.misfit() }
    }
}

impl PathReport {
    fn of(path: &CasePath, rest: &Vector3<f64>) -> PathReport {
        let points: Vec<Point> = (0..path.poses.len())
            .map(|i| Point {
                pressure_pa: path.pressures[i],
                position_m: path.poses[i].position,
                quaternion_wxyz: path.poses[i].rotation,
                margin: Shares::from(&path.margins[i]),
            })
            .collect();
        let shift = |point: &Point| Vector3::from(point.position_m) - rest;
        let last = points.last().map_or(Vector3::zeros(), shift);
        let along = last.try_normalize(0.0).unwrap_or_default();
        let off = points.iter().map(|p| (shift(p) - along * along.dot(&shift(p))).norm());
        let (turn_rad, tilt_rad) = points.last().map_or((0.0, 0.0), |p| turn_and_tilt(p.quaternion_wxyz));
        PathReport {
            case: path.case.number,
            frees: path.case.letters(),
            sideways_m: last.xy().norm(),
            along_z_m: last.z,
            turn_rad,
            tilt_rad,
            off_chord_m: off.fold(0.0, f64::max),
            ended: path.ended.as_ref().map(Stop::from),
            points,
        }
    }

    /// Whether it goes towards the FREEs under pressure; none where it does not go sideways.
    fn towards(&self) -> Option<bool> {
        let last = self.points.last()?;
        let bases = "ABCD".chars().zip(square(2.0)).filter(|(letter, _)| self.frees.contains(*letter));
        let middle: Vector2<f64> = bases.map(|(_, base)| base.xy()).sum();
        let along = middle.dot(&Vector2::new(last.position_m[0], last.position_m[1]));
        (self.sideways_m > 1e-4 && middle.norm() > 0.5).then_some(along > 0.0)
    }
}

fn write_csv(path: &Path, report: &Report) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    writeln!(file, "gamma_deg,case,frees,pressure_psi,x_mm,y_mm,z_mm,qw,qx,qy,qz,stiffness_margin,clearance_margin")?;
    for module in &report.modules {
        for path in &module.paths {
            for point in &path.points {
                let mut cells =
                    vec![module.gamma_rad.to_degrees().to_string(), path.case.to_string(), path.frees.clone()];
                cells.push((point.pressure_pa / PASCAL_PER_PSI).to_string());
                cells.extend(point.position_m.map(|x| (1e3 * x).to_string()));
                cells.extend(point.quaternion_wxyz.map(|q| q.to_string()));
                cells.push(point.margin.stiffness.to_string());
                cells.push(point.margin.clearance.map_or(String::new(), |c| c.to_string()));
                writeln!(file, "{}", cells.join(","))?;
            }
        }
    }
    file.flush()
}

impl Against {
    /// "36.0 mm", "2.00".
    fn shown(&self, value: Option<f64>) -> String {
        match (value, self.unit) {
            (None, _) => "the path ends before".into(),
            (Some(value), "m") => format!("{:.1} mm", 1e3 * value),
            (Some(value), unit) => format!("{value:.2} {unit}").trim_end().to_owned(),
        }
    }

    fn misfit(&self) -> String {
        self.misfit.map_or("-".into(), |misfit| format!("{:+.0} %", 100.0 * misfit))
    }
}

impl ModuleReport {
    fn name(&self) -> String {
        format!("{:.1} deg", self.gamma_rad.to_degrees())
    }

    fn facts(&self) -> Vec<(String, String)> {
        let name = self.name();
        let mut facts = Vec::new();
        let fours: Vec<&PathReport> = self.paths.iter().filter(|path| path.case == 4).collect();
        if let Some(path) = fours.first().filter(|path| path.ended.is_none()) {
            let way = match path.towards() {
                Some(true) => "towards the FREEs under pressure",
                Some(false) => "away from the FREEs under pressure",
                None => "nowhere",
            };
            let z = if path.along_z_m < 0.0 { "is lower" } else { "is higher" };
            facts.push((
                format!("{name}, Case 4"),
                format!(
                    "{way} by {:.1} mm, {z} by {:.2} mm, within {:.2} mm of a straight line",
                    1e3 * path.sideways_m,
                    1e3 * path.along_z_m.abs(),
                    1e3 * path.off_chord_m
                ),
            ));
        }
        facts.push((
            format!("{name}, orientation"),
            format!(
                "turn {:+.1} to {:+.1} deg, tilt up to {:.1} deg",
                self.turn_rad[0].to_degrees(),
                self.turn_rad[1].to_degrees(),
                self.tilt_rad.to_degrees()
            ),
        ));
        facts.push((
            format!("{name}, hull"),
            format!(
                "{:.0} mm2 from above ({:.0} % of points tried in it are reached), {:.0} mm2 from the side ({:.0} %); {} \
                 plates found, {} of {} combinations of pressures not to be reached stably",
                1e6 * self.hull_xy.area_m2,
                100.0 * self.hull_xy.filled,
                1e6 * self.hull_xz.area_m2,
                100.0 * self.hull_xz.filled,
                self.plates_found,
                self.refused[0],
                self.refused[1]
            ),
        ));
        facts.push((format!("{name}, least margin on a path"), format!("{:.3}", self.least_margin)));
        facts
    }

    /// Case, FREEs, pressure and reason of every path that ends before its highest pressure.
    fn ends(&self) -> impl Iterator<Item = [String; 4]> {
        self.paths.iter().filter_map(|path| path.ended.as_ref().map(|stop| (path, stop))).map(|(path, stop)| {
            let highest = stop.pressures_pa.iter().copied().fold(0.0, f64::max);
            let pressure = number(Some(highest / PASCAL_PER_PSI), 2);
            [path.case.to_string(), path.frees.clone(), pressure, stop.reason.clone()]
        })
    }

    fn table(&self) -> Table {
        let mut table = Table::new(&[
            ">case",
            "FREEs",
            ">to psi",
            ">x mm",
            ">y mm",
            ">z mm",
            ">sideways mm",
            ">turn deg",
            ">tilt deg",
            ">margin",
        ]);
        for path in &self.paths {
            let Some(last) = path.points.last() else { continue };
            let mm = last.position_m.map(|x| number(Some(1e3 * x), 2));
            let margin = last.margin.stiffness.min(last.margin.clearance.unwrap_or(f64::INFINITY));
            let after = [
                number(Some(1e3 * path.sideways_m), 2),
                number(Some(path.turn_rad.to_degrees()), 1),
                number(Some(path.tilt_rad.to_degrees()), 1),
                number(Some(margin), 3),
            ];
            let first = [path.case.to_string(), path.frees.clone(), number(Some(last.pressure_pa / PASCAL_PER_PSI), 2)];
            table.row(first.into_iter().chain(mm).chain(after));
        }
        table
    }
}

impl Report {
    fn facts(&self) -> Vec<(String, String)> {
        let mut facts = Vec::new();
        for row in &self.paper {
            let text =
                format!("{}; the paper: {}; misfit {}", row.shown(row.ours), row.shown(Some(row.paper)), row.misfit());
            facts.push((row.what.to_owned(), text));
        }
        for module in &self.modules {
            facts.extend(module.facts());
        }
        let all = &self.modules[0];
        facts.push((
            "at".into(),
            format!(
                "0 to {:.2}, FREEs {:.1} mm long, {:.1} mm apart",
                Pressure::pascals(self.pressure_pa),
                1e3 * all.length_m,
                1e3 * all.spacing_m
            ),
        ));
        facts.push(("time".into(), format!("{:.1} s", self.wall_time_s)));
        facts
    }

    /// The facts and, path by path, where it ends and why.
    fn page_facts(&self) -> Vec<(String, String)> {
        let ends = self.modules.iter().flat_map(|module| {
            module.ends().map(|[case, frees, psi, reason]| {
                (format!("{}, Case {case} ({frees}) ends", module.name()), format!("at {psi} psi: {reason}"))
            })
        });
        self.facts().into_iter().chain(ends).collect()
    }

    fn text(&self) -> String {
        let mut text = String::new();
        for module in &self.modules {
            text += &format!("{}\n\n{}\n\n", module.name(), module.table());
            let mut ends = module.ends().peekable();
            if ends.peek().is_some() {
                let mut table = Table::new(&[">case", "FREEs", ">ends at psi", "because"]);
                ends.for_each(|end| table.row(end));
                text += &format!("{table}\n\n");
            }
        }
        if !self.paper.is_empty() {
            let mut table = Table::new(&["against the paper", ">ours", ">paper", ">misfit"]);
            for row in &self.paper {
                table.row([row.what.to_owned(), row.shown(row.ours), row.shown(Some(row.paper)), row.misfit()]);
            }
            text += &format!("{table}\n\n");
        }
        let facts = self.facts().into_iter().skip(self.paper.len());
        text += &facts.map(|(name, value)| format!("{name}: {value}\n")).collect::<String>();
        text += &self.remarks.iter().map(|remark| format!("note: {remark}\n")).collect::<String>();
        let csv = self.csv.as_ref().map(|path| format!("\nall poses: {}", path.display())).unwrap_or_default();
        format!("{text}page: {}\nin space: {}{csv}", self.report, self.recording)
    }
}

//! `freerig model module`: where four FREEs put their plate.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::anyhow;
use clap::ValueEnum;
use serde::Serialize;

use crate::cli::list::List;
use crate::cli::scene::{SceneArgs, build};
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure, Progress};
use crate::config::pressure_rows;
use crate::fem::fidelity::{FidelityError, dead_length, rods_discretisation_error, rods_model_error, solid_answers};
use crate::fem::module::{self, Answer, ModuleScene, NAMES};
use crate::fem::section::SectionError;
use crate::fem::tube::Tube;
use crate::plan::turn_and_tilt;
use crate::units::{PASCAL_PER_PSI, Percent, Pressure};

const EXAMPLES: &str = "\
A stands at (+, +) of the square, B, C, D follow counter-clockwise about z, which runs from the bases to the plate. \
What a FREE does to the plate is told about its own tip, in the fixed frame. Past a limit the values are missing and \
the limit is named: that is an answer, not a failure.

A table of rows has the columns a_psi, b_psi, c_psi, d_psi, or in another unit of pressure (a_pa, a_kpa, a_bar, ...); \
other columns are passed over.

Examples:
  freerig model module --gamma 60deg --pressures 5psi,0psi,0psi,0psi --fidelity rod
  freerig model module --gamma 30deg --layout LRLR --spacing 25mm --pressures 4psi,4psi,0psi,0psi
  freerig model module --gamma 60deg --plate-mass 30g --gravity 0m/s2,9.81m/s2,0m/s2 --force -0.1N,0N,0N \\
      --pressures 3psi,0psi,3psi,0psi
  freerig model module --gamma 60deg --pressures rows.csv --json";

/// What `freerig model module` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Gauge pressures of A, B, C, D, or a table of rows
    #[arg(long, value_name = "A,B,C,D|FILE.csv", allow_hyphen_values = true)]
    pressures: Pressures,
    /// The model; `auto` is the cheapest whose estimated error is within the tolerance
    #[arg(long, default_value = "auto")]
    fidelity: Fidelity,
    /// Largest relative error, for `auto`
    #[arg(long, default_value = "5%")]
    tolerance: Percent,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Fidelity {
    Rod,
    Solid,
    Auto,
}

/// Where the pressures stand.
#[derive(Clone, Debug, PartialEq)]
enum Pressures {
    Row([f64; 4]),
    File(PathBuf),
}

impl FromStr for Pressures {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if Path::new(text).extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
            return Ok(Pressures::File(text.into()));
        }
        let List(row) = text.parse::<List<Pressure, 4>>().map_err(|e| format!("{e}; or name a table, FILE.csv"))?;
        Ok(Pressures::Row(row.map(Pressure::si)))
    }
}

/// What a FREE does to the plate.
#[derive(Clone, Debug, Serialize)]
struct Resultant {
    free: &'static str,
    force_n: [f64; 3],
    moment_nm: [f64; 3],
}

/// The answer to one row.
#[derive(Clone, Debug, Serialize)]
struct Row {
    fidelity: &'static str,
    pressures_pa: [f64; 4],
    position_m: Option<[f64; 3]>,
    quaternion_wxyz: Option<[f64; 4]>,
    resultants: Option<Vec<Resultant>>,
    stable: Option<bool>,
    negative_pivots: Option<i32>,
    least_clearance_m: Option<f64>,
    /// Between which FREEs.
    nearest: Option<String>,
    converged: bool,
    limit: Option<String>,
    /// Share of the row's loads, 0 to 1.
    limit_share: Option<f64>,
    /// Of the position, by the rods' resolution or the solid's coarser mesh alone.
    resolution_error_m: Option<f64>,
    discretisation_error_estimate: Option<f64>,
    model_error_estimate: Option<f64>,
    /// Why `auto` chose it; `null` where it was asked for.
    reason: Option<String>,
    wall_time_s: f64,
}

#[derive(Debug, Serialize)]
struct Rows {
    rows: Vec<Row>,
}

/// The answers and what holds for all of them.
struct Found {
    fidelity: &'static str,
    answers: Vec<Answer>,
    discretisation: f64,
    ends: Ends,
    /// More of the errors, a line each.
    notes: Vec<String>,
    reason: Option<String>,
}

/// What is known of the relative error that the FREEs' ends make.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ends {
    /// Nobody has asked, or the model has them.
    NotEstimated,
    /// Asked for, and not to be had.
    Unknown,
    Estimated(f64),
}

/// The most that rods with a dead length were off by, against the solid of the module, of the travel: the ends of a FREE
/// that is bent are not quite those of one that is stretched (six states at 30 and 60 deg, docs/models.md).
const BENT_ENDS: f64 = 0.007;

/// Asks the model and prints what it says.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let scene = args.scene.scene(context)?;
    let rows = match &args.pressures {
        Pressures::Row(row) => vec![*row],
        Pressures::File(path) => pressure_rows(path)?,
    };
    let highest = checked(&rows)?;
    let begun = Instant::now();
    let found = match args.fidelity {
        Fidelity::Rod => by_rods(&scene, &rows, highest, context)?,
        Fidelity::Solid => by_solid(&scene, &rows, context)?,
        Fidelity::Auto => by_either(&scene, &rows, highest, args.tolerance, context)?,
    };
    let each = begun.elapsed().as_secs_f64() / rows.len() as f64;
    let rows: Vec<Row> = found.answers.iter().map(|answer| found.row(answer, each)).collect();
    match (context.json, &args.pressures) {
        (true, Pressures::Row(_)) => context.print_json(&rows[0]),
        (true, Pressures::File(_)) => context.print_json(&Rows { rows }),
        (false, _) => context.print(text(&rows, &scene, &found)),
    }
}

fn by_rods(scene: &ModuleScene, rows: &[[f64; 4]], highest: f64, context: &Context) -> Result<Found, Failure> {
    let built = build(scene, highest, context)?;
    let answers = module::answer(scene, &built.module, rows);
    let law = &built.law_errors;
    Ok(Found {
        fidelity: "rod",
        discretisation: rods_discretisation_error(scene, &built.module.rest(), law, &answers),
        answers,
        ends: Ends::NotEstimated,
        notes: vec![
            format!("of it the section's mesh: {}", percent(law.mesh)),
            format!(
                "bending stiffness, interpolated over stretch, twist and pressure: up to {} off",
                percent(law.bending)
            ),
        ],
        reason: None,
    })
}

fn by_solid(scene: &ModuleScene, rows: &[[f64; 4]], context: &Context) -> Result<Found, Failure> {
    context.note("solid of the whole module, on two meshes: a minute or so a row, less where it is symmetric");
    let mut progress = Progress::new("solid", 100.0, "%");
    let found = solid_answers(scene, rows, &mut |share| progress.set(100.0 * share, ""));
    drop(progress);
    let found = found.map_err(|error| match error {
        FidelityError::Solid(_) | FidelityError::Section(_) => {
            Failure::failed(error).remedy("ask for lower pressures, or for `--fidelity rod`")
        }
        error => Failure::usage(error).remedy("ask for `--fidelity rod`, whose error estimates say what it is worth"),
    })?;
    Ok(Found {
        fidelity: "solid",
        answers: found.answers,
        discretisation: found.discretisation_error,
        ends: Ends::NotEstimated,
        notes: Vec::new(),
        reason: None,
    })
}

/// Rods; rods whose ends are corrected, where they are not good enough; or the solid.
fn by_either(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    tolerance: Percent,
    context: &Context,
) -> Result<Found, Failure> {
    let mut rods = by_rods(scene, rows, highest, context)?;
    if highest > 0.0 {
        context.note("estimating what the FREEs' ends are worth, by a coarse solid of one: some seconds");
        let remedy = "ask for `--fidelity rod`, which does not look at the ends";
        let ends = rods_model_error(scene, highest).map_err(|error| Failure::failed(error).remedy(remedy))?;
        rods.ends = Ends::of(ends);
    }
    let mut tried = rods.told("rod");
    if !rods.within(tolerance) && rods.discretisation <= tolerance.si() {
        context.note(format!("{tried}: above --tolerance {tolerance}; now with the ends corrected, some seconds"));
        if let Some(corrected) = by_corrected_rods(scene, rows, highest, context)? {
            rods = corrected;
            tried += &format!("; {}", rods.told("with a dead length"));
        }
    }
    if rods.within(tolerance) {
        rods.reason = Some(format!("the cheapest within {tolerance}; estimated error: {tried}"));
        return Ok(rods);
    }
    context.note(format!(
        "{tried}: above --tolerance {tolerance}. The solid is asked instead; a larger tolerance or `--fidelity rod` \
         answers at once"
    ));
    let mut solid = by_solid(scene, rows, context)?;
    if solid.discretisation.is_nan() || solid.discretisation > tolerance.si() {
        let solid = percent(solid.discretisation);
        let error = anyhow!("estimated error: {tried}; solid {solid}: none is within --tolerance {tolerance}");
        return Err(Failure::failed(error).remedy("give a larger --tolerance, or ask for one by --fidelity"));
    }
    solid.reason = Some(format!("the cheapest within {tolerance}; estimated error: {tried}"));
    Ok(solid)
}

/// Rods that are shorter by what the ends of a single FREE of their kind take of it at the highest pressure, by its solid:
/// exact there for a FREE that the others hold from turning. None where a single FREE has no equilibrium there, or no
/// dead length makes a rod of it.
///
/// What one length misses elsewhere: FREEs at other pressures have other dead lengths, of which the one at half of the
/// pressure shows how much they differ. A rod's tip goes with its length where it is stretched and with the square of it
/// where it is bent, so that a dead length wrong by d moves it by up to 2 d of its length. On top comes what ends do
/// otherwise when they bend, [`BENT_ENDS`].
fn by_corrected_rods(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    context: &Context,
) -> Result<Option<Found>, Failure> {
    let mut kinds: Vec<(Tube, f64, f64)> = Vec::new();
    let (mut corrected, mut worst) = (scene.clone(), 0.0);
    for free in &mut corrected.frees {
        let (tube, length) = (Tube { gamma: free.tube.gamma.abs(), ..free.tube }, free.length);
        let known = kinds.iter().find(|(other, of, _)| *other == tube && *of == length).map(|(.., dead)| *dead);
        free.dead_length = match known {
            Some(dead) => dead,
            None => {
                let Some([half, whole]) = dead_lengths(&tube, length, highest)? else { return Ok(None) };
                worst = f64::max(worst, 2.0 * (whole - half).abs() / length);
                kinds.push((tube, length, whole));
                whole
            }
        };
    }
    if corrected.validated().is_err() {
        return Ok(None);
    }
    let mut found = by_rods(&corrected, rows, highest, context)?;
    found.ends = Ends::Estimated(worst + BENT_ENDS);
    let told: Vec<String> = kinds.iter().map(|(.., dead)| format!("{:.2} mm", 1e3 * dead)).collect();
    found.notes.push(format!("the ends of a FREE are worth {} of it, by the solid of a single one", told.join(", ")));
    Ok(Some(found))
}

/// The dead lengths, m, of a FREE at half of `highest` (Pa) and at all of it; none where it has no equilibrium there.
fn dead_lengths(tube: &Tube, length: f64, highest: f64) -> Result<Option<[f64; 2]>, Failure> {
    let mut found = [0.0; 2];
    for (dead, share) in found.iter_mut().zip([0.5, 1.0]) {
        *dead = match dead_length(tube, length, share * highest) {
            Ok(dead) => dead,
            Err(FidelityError::Section(SectionError::BeyondLimit { .. } | SectionError::PathEnds { .. })) => {
                return Ok(None);
            }
            // The solid's path ended before.
            Err(FidelityError::Pressure(pressure)) if pressure.is_finite() => return Ok(None),
            Err(error) => {
                let remedy = "ask for `--fidelity rod`, which does not look at the ends, or for `--fidelity solid`";
                return Err(Failure::failed(error).remedy(remedy));
            }
        };
    }
    Ok(Some(found))
}

/// The highest of all pressures, Pa.
fn checked(rows: &[[f64; 4]]) -> Result<f64, Failure> {
    for (i, row) in rows.iter().enumerate() {
        if let Some((free, pressure)) = NAMES.iter().zip(row).find(|(_, p)| **p < 0.0) {
            let row = if rows.len() > 1 { format!("row {}: ", i + 1) } else { String::new() };
            let shown = Pressure::pascals(*pressure);
            let error = anyhow!("{row}pressure of {free} is {shown:.3}: a module's laws begin at 0");
            return Err(
                Failure::usage(error).remedy("give pressures from 0 up; `freerig model single` takes negative ones")
            );
        }
    }
    Ok(rows.iter().flatten().copied().fold(0.0, f64::max))
}

impl Ends {
    /// An estimate that was asked for.
    fn of(estimate: Option<f64>) -> Ends {
        estimate.filter(|share| share.is_finite()).map_or(Ends::Unknown, Ends::Estimated)
    }

    fn estimate(self) -> Option<f64> {
        match self {
            Ends::Estimated(share) => Some(share),
            Ends::NotEstimated | Ends::Unknown => None,
        }
    }
}

impl fmt::Display for Ends {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Ends::NotEstimated => f.write_str("not estimated"),
            Ends::Unknown => f.write_str("unknown"),
            Ends::Estimated(share) => f.write_str(&percent(*share)),
        }
    }
}

impl Found {
    /// All that is estimated of the error; none where the ends' is unknown.
    fn error(&self) -> Option<f64> {
        (self.ends != Ends::Unknown).then(|| self.discretisation + self.ends.estimate().unwrap_or(0.0))
    }

    /// Whether that is within `tolerance`: what is not known is no reason to believe the rods.
    fn within(&self, tolerance: Percent) -> bool {
        self.error().is_some_and(|error| error <= tolerance.si())
    }

    /// "rod 1.20 % (discretisation 0.50 %, ends 0.70 %)".
    fn told(&self, what: &str) -> String {
        let error = self.error().map_or("unknown".into(), percent);
        format!("{what} {error} (discretisation {}, ends {})", percent(self.discretisation), self.ends)
    }

    fn row(&self, answer: &Answer, wall_time_s: f64) -> Row {
        let pose = answer.pose.as_ref();
        let resultants = pose.map(|pose| {
            let of = |(free, wrench): (&&'static str, &module::Wrench)| Resultant {
                free,
                force_n: wrench.force.into(),
                moment_nm: wrench.moment.into(),
            };
            NAMES.iter().zip(&pose.on_plate).map(of).collect()
        });
        let clearance = pose.and_then(|pose| pose.least_clearance);
        Row {
            fidelity: self.fidelity,
            pressures_pa: answer.pressures,
            position_m: pose.map(|pose| pose.position.into()),
            quaternion_wxyz: pose.map(|pose| {
                let q = pose.rotation;
                [q.w, q.i, q.j, q.k]
            }),
            resultants,
            stable: pose.map(|pose| pose.negative_pivots == 0),
            negative_pivots: pose.map(|pose| pose.negative_pivots),
            least_clearance_m: clearance.map(|(_, distance)| distance),
            nearest: clearance.map(|(pair, _)| pair.map(|i| NAMES[i]).concat()),
            converged: pose.is_some(),
            limit: answer.limit.as_ref().map(ToString::to_string),
            limit_share: answer.limit.as_ref().map(|limit| limit.fraction),
            resolution_error_m: pose.map(|pose| pose.discretisation_error),
            discretisation_error_estimate: pose.map(|_| self.discretisation),
            model_error_estimate: self.ends.estimate(),
            reason: self.reason.clone(),
            wall_time_s,
        }
    }
}

fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:.2} %", 100.0 * share) } else { "unknown".into() }
}

fn text(rows: &[Row], scene: &ModuleScene, found: &Found) -> String {
    let mut table = Table::new(&[
        ">A psi",
        ">B psi",
        ">C psi",
        ">D psi",
        ">x mm",
        ">y mm",
        ">z mm",
        ">turn deg",
        ">tilt deg",
        "stable",
        ">clearance mm",
        "nearest",
    ]);
    for row in rows {
        let mm = |i: usize| number(row.position_m.map(|x| 1e3 * x[i]), 3);
        let turned = row.quaternion_wxyz.map(turn_and_tilt);
        let stable = match (row.stable, row.negative_pivots) {
            (Some(true), _) => "yes".to_owned(),
            (Some(false), Some(pivots)) => format!("no ({pivots})"),
            _ => "-".to_owned(),
        };
        let pressures = row.pressures_pa.map(|p| format!("{:.2}", p / PASCAL_PER_PSI));
        let rest = [
            mm(0),
            mm(1),
            mm(2),
            number(turned.map(|t| t.0.to_degrees()), 2),
            number(turned.map(|t| t.1.to_degrees()), 2),
            stable,
            number(row.least_clearance_m.map(|c| 1e3 * c), 2),
            row.nearest.clone().unwrap_or_default(),
        ];
        table.row(pressures.into_iter().chain(rest));
    }
    let mut text = format!("{} model\n\n{table}\n", found.fidelity);
    if let [Row { resultants: Some(resultants), .. }] = rows {
        let mut table = Table::new(&["on the plate", ">Fx N", ">Fy N", ">Fz N", ">Mx mN m", ">My mN m", ">Mz mN m"]);
        for Resultant { free, force_n, moment_nm } in resultants {
            let force = force_n.map(|f| number(Some(f), 4));
            let moment = moment_nm.map(|m| number(Some(1e3 * m), 3));
            table.row([(*free).to_owned()].into_iter().chain(force).chain(moment));
        }
        text += &format!("\n{table}\n");
    }
    for (i, row) in rows.iter().enumerate() {
        if let Some(limit) = &row.limit {
            let which = if rows.len() > 1 { format!(" of row {}", i + 1) } else { String::new() };
            text += &format!("\nlimit{which}: {limit}");
        }
    }
    let tube = &scene.frees[0].tube;
    text += &format!(
        "\nmodule: FREEs of {:.2} deg, {:.1} mm long, {:.1} mm apart, {}; plate {:.1} g",
        tube.gamma.abs().to_degrees(),
        1e3 * scene.frees[0].length,
        1e3 * scene.spacing,
        scene.frees.map(|free| if free.tube.gamma > 0.0 { "R" } else { "L" }).concat(),
        1e3 * scene.plate_mass,
    );
    text += &format!("\ndiscretisation error, estimated: {}", percent(found.discretisation));
    for note in &found.notes {
        text += &format!("\n{note}");
    }
    if found.fidelity == "rod" {
        text += &format!("\nmodel error, estimated: {} (the FREEs' ends)", found.ends);
    }
    if let Some(reason) = &found.reason {
        text += &format!("\nwhy this model: {reason}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_of_which_nothing_is_known_are_within_no_tolerance_and_said_to_be_unknown() {
        let found = |ends| Found {
            fidelity: "rod",
            answers: Vec::new(),
            discretisation: 0.004,
            ends,
            notes: Vec::new(),
            reason: None,
        };
        let tolerance: Percent = "50%".parse().unwrap();
        for estimate in [None, Some(f64::INFINITY), Some(f64::NAN)] {
            let rods = found(Ends::of(estimate));
            assert!(!rods.within(tolerance) && rods.ends.estimate().is_none());
            assert_eq!(rods.told("rod"), "rod unknown (discretisation 0.40 %, ends unknown)");
        }
        let rods = found(Ends::of(Some(0.012)));
        assert!(rods.within("1.6%".parse().unwrap()) && !rods.within("1.59%".parse().unwrap()));
        assert_eq!(rods.told("rod"), "rod 1.60 % (discretisation 0.40 %, ends 1.20 %)");
        assert_eq!(found(Ends::NotEstimated).told("rod"), "rod 0.40 % (discretisation 0.40 %, ends not estimated)");
    }

    #[test]
    fn pressures_are_four_with_units_or_a_table() {
        const PSI: f64 = PASCAL_PER_PSI;
        assert_eq!("1psi,2psi,0Pa,1psi".parse(), Ok(Pressures::Row([PSI, 2.0 * PSI, 0.0, PSI])));
        assert_eq!("rows.CSV".parse(), Ok(Pressures::File("rows.CSV".into())));
        for (wrong, word) in [("1psi,2psi", "2 of 4"), ("1,2,3,4", "no unit"), ("rows", "FILE.csv")] {
            let error = wrong.parse::<Pressures>().unwrap_err();
            assert!(error.contains(word), "{error}");
        }
    }
}

//! `freerig model module`: where four FREEs put their plate.

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
use crate::fem::module::{self, Answer, Free, ModuleScene, NAMES};
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
    model: Option<f64>,
    /// More of the errors, a line each.
    notes: Vec<String>,
    reason: Option<String>,
}

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
        model: None,
        notes: vec![
            format!("of it the section's mesh: {}", percent(Some(law.mesh))),
            format!(
                "bending stiffness, interpolated over stretch, twist and pressure: up to {} off",
                percent(Some(law.bending))
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
        model: None,
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
        // What is not known is no reason to believe the rods.
        rods.model = Some(ends.unwrap_or(f64::INFINITY));
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
        let solid = percent(Some(solid.discretisation));
        let error = anyhow!("estimated error: {tried}; solid {solid}: none is within --tolerance {tolerance}");
        return Err(Failure::failed(error).remedy("give a larger --tolerance, or ask for one by --fidelity"));
    }
    solid.reason = Some(format!("the cheapest within {tolerance}; estimated error: {tried}"));
    Ok(solid)
}

/// Rods that are shorter by what the ends of a single FREE take of it at the highest pressure, by its solid: exact, there
/// and for a FREE that the others hold from turning. What one length misses at other pressures is what it changes by down
/// to half of it; docs/models.md holds such rods against the solid of the module. None where the single FREE has no
/// equilibrium there.
fn by_corrected_rods(
    scene: &ModuleScene,
    rows: &[[f64; 4]],
    highest: f64,
    context: &Context,
) -> Result<Option<Found>, Failure> {
    // FREEs that are alike but for their hands.
    let Free { tube, length, .. } = scene.frees[0];
    let [Ok(half), Ok(whole)] = [0.5, 1.0].map(|share| dead_length(&tube, length, share * highest)) else {
        return Ok(None);
    };
    let corrected = ModuleScene { frees: scene.frees.map(|free| Free { dead_length: whole, ..free }), ..scene.clone() };
    let mut found = by_rods(&corrected, rows, highest, context)?;
    found.model = Some((whole - half).abs() / length);
    found.notes.push(format!("the ends of a FREE are worth {:.2} mm of it, by the solid of a single one", 1e3 * whole));
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

impl Found {
    /// Whether all that is estimated of the error is within `tolerance`.
    fn within(&self, tolerance: Percent) -> bool {
        self.discretisation + self.model.unwrap_or(0.0) <= tolerance.si()
    }

    /// "rod 1.20 % (discretisation 0.50 %, ends 0.70 %)".
    fn told(&self, what: &str) -> String {
        format!(
            "{what} {} (discretisation {}, ends {})",
            percent(Some(self.discretisation + self.model.unwrap_or(0.0))),
            percent(Some(self.discretisation)),
            percent(self.model)
        )
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
            model_error_estimate: self.model,
            reason: self.reason.clone(),
            wall_time_s,
        }
    }
}

fn percent(share: Option<f64>) -> String {
    match share {
        Some(share) if share.is_finite() => format!("{:.2} %", 100.0 * share),
        Some(_) => "not to be told".into(),
        None => "not estimated".into(),
    }
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
    text += &format!("\ndiscretisation error, estimated: {}", percent(Some(found.discretisation)));
    for note in &found.notes {
        text += &format!("\n{note}");
    }
    if found.fidelity == "rod" {
        text += &format!("\nmodel error, estimated: {} (the FREEs' ends)", percent(found.model));
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

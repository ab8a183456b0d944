//! `freerig model module`: where four FREEs put their plate.

mod choice;

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use anyhow::anyhow;
use clap::ValueEnum;
use serde::Serialize;

use self::choice::{Found, by_either, by_rods, by_solid, percent};
use crate::cli::list::List;
use crate::cli::scene::SceneArgs;
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure};
use crate::config::pressure_rows;
use crate::fem::module::{self, Answer, ModuleScene, NAMES};
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
    let rows: Vec<Row> = found.answers.iter().map(|answer| Row::new(&found, answer, each)).collect();
    match (context.json, &args.pressures) {
        (true, Pressures::Row(_)) => context.print_json(&rows[0]),
        (true, Pressures::File(_)) => context.print_json(&Rows { rows }),
        (false, _) => context.print(text(&rows, &scene, &found)),
    }
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

impl Row {
    fn new(found: &Found, answer: &Answer, wall_time_s: f64) -> Row {
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
            fidelity: found.fidelity,
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
            discretisation_error_estimate: pose.map(|_| found.discretisation),
            model_error_estimate: found.ends.estimate(),
            reason: found.reason.clone(),
            wall_time_s,
        }
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
    if rows.iter().any(|row| row.converged) {
        text += &format!("\ndiscretisation error, estimated: {}", percent(found.discretisation));
        for note in &found.notes {
            text += &format!("\n{note}");
        }
        if found.fidelity == "rod" {
            text += &format!("\nmodel error, estimated: {} (the FREEs' ends)", found.ends);
        }
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

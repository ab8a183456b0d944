//! `freerig plan inverse`: the pressures that put the plate where it should be.

use std::f64::consts::FRAC_1_SQRT_2;
use std::time::Instant;

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

use super::{LimitArgs, Shares, Stop, bound_names, psi, refused};
use crate::cli::list::List;
use crate::cli::scene::{SceneArgs, build};
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure};
use crate::fem::module::NAMES;
use crate::plan::{Inverse, Pose, Rest, Target, inverse};
use crate::units::{Angle, Length, PASCAL_PER_PSI};

const EXAMPLES: &str = "\
A point leaves one of the four pressures free: it goes to the largest margin. A target out of reach is projected to \
the nearest plate, and the reason is told: that is an answer, not a failure.

Examples:
  freerig plan inverse --gamma 60deg --length 130mm --position 4mm,-3mm,131mm
  freerig plan inverse --gamma 60deg --length 130mm --position 0mm,5mm,131mm --twist -20deg
  freerig plan inverse --gamma 30deg --length 130mm --position 5mm,5mm,128mm --max-pressure 5psi --dead C --json";

/// What `freerig plan inverse` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Where the plate's centre should be
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    position: List<Length, 3>,
    /// How it should be turned from rest: a rotation vector
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "twist")]
    rotation: Option<List<Angle, 3>>,
    /// How it should be turned about z; its tilt does not matter
    #[arg(long, value_name = "ANGLE")]
    twist: Option<Angle>,
    #[command(flatten)]
    limits: LimitArgs,
}

#[derive(Debug, Serialize)]
struct Report {
    pressures_pa: [f64; 4],
    position_m: [f64; 3],
    quaternion_wxyz: [f64; 4],
    position_error_m: [f64; 3],
    rotation_error_rad: [f64; 3],
    /// The weighted error; a radian of the rotation asked for counts like the FREEs' distance from the plate's centre.
    residual_m: f64,
    reached: bool,
    shortfall: Option<String>,
    /// Where the way to the target ends, if that is why.
    shortfall_at: Option<Stop>,
    /// By FREE: `low` or `high` where its pressure is at a bound.
    active_bounds: [Option<&'static str>; 4],
    margin: Shares,
    /// Where the straight ramp from rest to these pressures ends before it gets there.
    ramp_ends: Option<Stop>,
    discretisation_error_m: Option<f64>,
    equilibria: usize,
    wall_time_s: f64,
}

/// Finds the pressures and prints them.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let scene = args.scene.scene(context)?;
    let position = Vector3::from(args.position.0.map(Length::si));
    let lever = FRAC_1_SQRT_2 * scene.spacing;
    let target = match (args.rotation, args.twist) {
        (Some(List(rotation)), _) => {
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(rotation.map(Angle::si)));
            Target::pose(position, rotation, lever)
        }
        (None, Some(twist)) => Target {
            rotation: UnitQuaternion::from_scaled_axis(Vector3::z() * twist.si()),
            rotation_weight: Vector3::z() * lever,
            ..Target::point(position)
        },
        (None, None) => Target::point(position),
    };
    let limits = args.limits.limits(f64::INFINITY);
    limits.check().map_err(refused)?;
    let built = build(&scene, args.limits.max_pressure.si(), context)?;
    let begun = Instant::now();
    let rest = Rest::new(&built.module, &scene.loads([0.0; 4])).map_err(refused)?;
    let found = inverse::cold(&rest, &target, &limits).map_err(refused)?;
    let error = built.module.discretisation_error(&found.state).ok().map(|error| error * built.module.length());
    let report = Report::of(&found, error, begun.elapsed().as_secs_f64());
    if context.json { context.print_json(&report) } else { context.print(report.text(&target)) }
}

impl Report {
    fn of(found: &Inverse, discretisation_error_m: Option<f64>, wall_time_s: f64) -> Report {
        let pose = Pose::of(&found.state);
        let at = match &found.shortfall {
            Some(inverse::Shortfall::Ends(ended)) => Some(ended),
            _ => None,
        };
        Report {
            pressures_pa: found.pressures,
            position_m: pose.position,
            quaternion_wxyz: pose.rotation,
            position_error_m: found.position_error.into(),
            rotation_error_rad: found.rotation_error.into(),
            residual_m: found.residual,
            reached: found.shortfall.is_none(),
            shortfall: found.shortfall.as_ref().map(ToString::to_string),
            shortfall_at: at.map(Stop::from),
            active_bounds: bound_names(&found.active),
            margin: Shares::from(&found.margin),
            ramp_ends: found.ramp.as_ref().map(Stop::from),
            discretisation_error_m,
            equilibria: found.equilibria,
            wall_time_s,
        }
    }

    fn text(&self, target: &Target) -> String {
        let mut pressures = Table::new(&["FREE", ">psi", "at its bound"]);
        for ((name, bound), pressure) in NAMES.iter().zip(self.active_bounds).zip(self.pressures_pa) {
            let psi = number(Some(pressure / PASCAL_PER_PSI), 3);
            pressures.row([(*name).to_owned(), psi, bound.unwrap_or_default().to_owned()]);
        }
        let mut plate = Table::new(&["plate", ">x mm", ">y mm", ">z mm", ">turn x deg", ">turn y deg", ">turn z deg"]);
        let q = self.quaternion_wxyz;
        let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3])).scaled_axis();
        let matters = target.rotation_weight;
        let asked = target.rotation.scaled_axis();
        let asked: [Option<f64>; 3] = std::array::from_fn(|i| (matters[i] > 0.0).then_some(asked[i]));
        let off: [Option<f64>; 3] = std::array::from_fn(|i| (matters[i] > 0.0).then_some(self.rotation_error_rad[i]));
        let mut row = |name: &str, position: [f64; 3], turn: [Option<f64>; 3]| {
            let position = position.map(|x| number(Some(1e3 * x), 3));
            let turn = turn.map(|x| number(x.map(f64::to_degrees), 2));
            plate.row([name.to_owned()].into_iter().chain(position).chain(turn));
        };
        row("asked for", target.position.into(), asked);
        row("predicted", self.position_m, [Some(turn.x), Some(turn.y), Some(turn.z)]);
        row("off by", self.position_error_m, off);
        let mut text = format!("{pressures}\n\n{plate}\n");
        text += &match &self.shortfall {
            None => format!("\nreached: within {:.4} mm", 1e3 * self.residual_m),
            Some(reason) => format!("\nNOT reached, {:.3} mm short: {reason}", 1e3 * self.residual_m),
        };
        let clearance = number(self.margin.clearance, 3);
        text +=
            &format!("\nmargin: {:.3} of the stiffness at rest, {clearance} of the clearance", self.margin.stiffness);
        if let Some(stop) = &self.ramp_ends {
            text += &format!(
                "\nthe straight ramp from rest does not lead here: at {} {}; go there from a stable neighbour",
                psi(&stop.pressures_pa),
                stop.reason
            );
        }
        let error = self.discretisation_error_m.map_or("unknown".into(), |e| format!("{:.4} mm", 1e3 * e));
        text += &format!("\nprediction's error by the rods' resolution, estimated: {error}");
        text += &format!("\n{} equilibria in {:.2} s", self.equilibria, self.wall_time_s);
        text
    }
}

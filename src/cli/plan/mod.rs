//! `freerig plan`: what to command, what can be reached, and what to build.

mod design;
mod inverse;
mod path;
mod study;
mod sweep;
mod whisk;
mod workspace;

pub use whisk::example as example_whisk;

use std::str::FromStr;

use serde::Serialize;

use super::{Context, Failure};
use crate::fem::module::NAMES;
use crate::plan::{Bound, Ended, FREES, Limits, Margin, PlanError};
use crate::units::Pressure;

const EXAMPLES: &str = "\
Computed from rig.toml and the calibration files, or from what the flags say: no daemon, nothing moves. The pages go to \
the folder of the runs.

Examples:
  freerig plan workspace --gamma 60deg
  freerig plan inverse --gamma 60deg --length 130mm --position 4mm,-3mm,131mm
  freerig --rig experiments/module/rig.toml plan whisk --output whisk.toml
  freerig plan design --sweep gamma=20deg..70deg";

/// What `freerig plan` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// What a module reaches: the paper's five cases in fifteen paths, the hull of all plates found
    Workspace(workspace::Args),
    /// The pressures that put the plate on a point
    Inverse(inverse::Args),
    /// The pressures over time that take the plate along a path
    Path(path::Args),
    /// Which FREE to build: rotation, extension, force and moment of many designs
    Design(design::Args),
    /// The pressures of a module over one period of its whisk
    Whisk(whisk::Args),
}

/// Plans.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.what {
        What::Workspace(args) => workspace::run(args, context),
        What::Inverse(args) => inverse::run(args, context),
        What::Path(args) => path::run(args, context),
        What::Design(args) => design::run(args, context),
        What::Whisk(args) => whisk::run(args, context),
    }
}

/// Flags of what a plan may ask for.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Limits")]
struct LimitArgs {
    /// Highest pressure of every FREE
    #[arg(long, value_name = "PRESSURE", default_value = "7psi")]
    max_pressure: Pressure,
    /// Least share that is left of what the module has at rest, in stiffness and in clearance between tubes, 0 to 0.7
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    margin: f64,
    /// FREEs that stay without pressure
    #[arg(long, value_name = "A|B|C|D", value_delimiter = ',')]
    dead: Vec<Letter>,
}

/// A, B, C or D as an index.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Letter(usize);

impl FromStr for Letter {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = NAMES.iter().position(|name| *name == text).map(Letter);
        found.ok_or_else(|| format!("`{text}` is none of the module's FREEs: write A, B, C or D"))
    }
}

impl LimitArgs {
    fn limits(&self, slew: f64) -> Limits {
        let mut limits = Limits { margin: self.margin, slew, ..Limits::up_to(self.max_pressure.si()) };
        for Letter(free) in &self.dead {
            limits.high[*free] = 0.0;
        }
        limits
    }
}

/// How a plan's refusal ends the command.
fn refused(error: PlanError) -> Failure {
    match error {
        PlanError::Invalid { .. } | PlanError::BelowBase { .. } => {
            Failure::usage(error).remedy("the flags, their units and their ranges are in the command's --help")
        }
        PlanError::NoStart(_) | PlanError::Rest(_) | PlanError::Rods(_) => Failure::failed(error),
        PlanError::Module(_) => Failure::failed(error).remedy("ask for lower pressures, or for another module"),
    }
}

/// Shares of what the module has at rest.
#[derive(Clone, Copy, Debug, Serialize)]
struct Shares {
    stiffness: f64,
    clearance: Option<f64>,
    smooth: f64,
}

impl From<&Margin> for Shares {
    fn from(margin: &Margin) -> Shares {
        Shares { stiffness: margin.stiffness, clearance: margin.clearance, smooth: margin.smooth }
    }
}

/// Where a way in the pressures ends.
#[derive(Clone, Debug, Serialize)]
struct Stop {
    reason: String,
    pressures_pa: [f64; 4],
}

impl From<&Ended> for Stop {
    fn from(ended: &Ended) -> Stop {
        Stop { reason: format!("the module {}", ended.end), pressures_pa: ended.pressures }
    }
}

fn bound_names(bounds: &[Option<Bound>; FREES]) -> [Option<&'static str>; FREES] {
    bounds.map(|bound| {
        bound.map(|bound| match bound {
            Bound::Low => "low",
            Bound::High => "high",
            Bound::SlewDown => "slew_down",
            Bound::SlewUp => "slew_up",
        })
    })
}

/// Pressures for people: "A 1.20, B 0.00, C 0.00, D 3.40 psi".
fn psi(pressures: &[f64; 4]) -> String {
    let each =
        NAMES.iter().zip(pressures).map(|(name, p)| format!("{name} {:.2}", Pressure::pascals(*p).display_value()));
    format!("{} psi", each.collect::<Vec<_>>().join(", "))
}

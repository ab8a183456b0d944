//! `freerig model`: what geometry and material alone say of a FREE and of a module.

mod module;
mod single;

use super::{Context, Failure};

const EXAMPLES: &str = "\
Computed from rig.toml and the calibration files, or from what the flags say: no daemon, nothing moves.

Examples:
  freerig model single --pressure 1psi,2psi
  freerig model single --gamma 60deg --ends blocked --pressure 2psi
  freerig model module --gamma 60deg --pressures 5psi,0psi,0psi,0psi --fidelity rod";

/// What `freerig model` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// One FREE: twist, stretch and radius (free), or force and moment (blocked), at pressures
    Single(single::Args),
    /// Four FREEs under a plate: the plate's pose at four pressures, what each FREE bears, stability and clearance
    Module(module::Args),
}

/// Asks the model.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.what {
        What::Single(args) => single::run(args, context),
        What::Module(args) => module::run(args, context),
    }
}

//! `freerig model`: what geometry and material alone say of a FREE and of a module.

mod module;
mod single;

use super::{Context, Failure};

/// What `freerig model` takes.
#[derive(Debug, clap::Args)]
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

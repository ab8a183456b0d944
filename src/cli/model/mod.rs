//! `freerig model`: what geometry and material alone say of a FREE.

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
}

/// Asks the model.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.what {
        What::Single(args) => single::run(args, context),
    }
}

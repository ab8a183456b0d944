//! `freerig plan`: what to command, and what to build.

mod design;
mod whisk;

use super::{Context, Failure};

/// What `freerig plan` takes.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Which FREE to build: rotation, extension, force and moment of many designs
    Design(design::Args),
    /// The pressures of a module over one period of its whisk
    Whisk(whisk::Args),
}

/// Plans.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.what {
        What::Design(args) => design::run(args, context),
        What::Whisk(args) => whisk::run(args, context),
    }
}

//! `freerig config check`: every problem of the configuration at once.

use clap::Subcommand;

use super::{Context, Failure};

/// What `freerig config` takes.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List every problem of rig.toml and of the files it refers to
    Check,
}

/// Checks the configuration.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.action {
        Action::Check => Err(Failure::failed(anyhow::anyhow!("not read yet: {}", context.rig.display()))),
    }
}

//! `freerig disarm`: the pressures down, whatever is running.

use super::{Context, Failure, control};

/// What `freerig disarm` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Ends an experiment that is running.\n\nExamples:\n  freerig disarm")]
pub struct Args {}

/// Disarms the rig.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    let response = control::wait(client.disarm())?;
    control::tell(&response, context)
}

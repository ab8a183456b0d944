//! `freerig clear`: latched faults, if their causes are gone.

use super::{Context, Failure, control};

/// What `freerig clear` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  freerig clear")]
pub struct Args {}

/// Clears the latched faults.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    let response = control::wait(client.clear())?;
    control::tell(&response, context)
}

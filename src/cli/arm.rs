//! `freerig arm`: self-test, vent check, tare, margins.

use super::{Context, Failure, control};
use crate::daemon::api::Arm;

/// What `freerig arm` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Keep hands off while it arms: the angles are tared.\n\nExamples:\n  freerig arm\n  freerig arm --accept-margin"
)]
pub struct Args {
    /// Arm even where the stability margin of the gains is below the stated one
    #[arg(long)]
    accept_margin: bool,
}

/// Arms the rig.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    let response = control::wait(client.arm(Arm { accept_margin: args.accept_margin }))?;
    control::tell(&response, context)
}

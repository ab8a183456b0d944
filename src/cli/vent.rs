//! `freerig vent`: the pressures gone, without a daemon.

use std::time::Duration;

use anyhow::anyhow;
use serde_json::json;
use tracing::level_filters::LevelFilter;

use super::{Context, Failure, log};
use crate::config::Rig;
use crate::control::fault;
use crate::daemon::api::FreeStatus;
use crate::daemon::{DaemonError, RigLock, vent};
use crate::signal::FaultCode;
use crate::units::Pressure;

/// How long an owner that is just leaving is waited for.
const PATIENCE: Duration = Duration::from_secs(2);

/// What `freerig vent` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The service runs it whenever the daemon has ended. Where a daemon owns the rig, `freerig estop` is the way.\n\nExit status 3 where the vent could not be verified.\n\nExamples:\n  freerig vent\n  freerig vent --rig /etc/freerig/rig.toml"
)]
pub struct Args {}

/// Vents the rig and says what is seen of it.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    log::start(LevelFilter::WARN);
    let rig = Rig::load(&context.rig)?;
    let _lock = RigLock::take(&rig, PATIENCE).map_err(|error| match error {
        DaemonError::Owned(_) => Failure::rig(error).remedy("it is the daemon's to vent: `freerig estop`"),
        error => Failure::rig(error),
    })?;
    if !context.json {
        context.note(format!(
            "venting {}{}: zero on every path",
            rig.name,
            if rig.is_simulated() { " (SIMULATED)" } else { "" }
        ));
    }
    let (vented, status) = vent::vent(&rig).map_err(Failure::rig)?;
    if context.json {
        context.print_json(&json!({ "simulated": status.simulated, "vented": vented, "frees": status.frees }))?;
    } else {
        for free in &status.frees {
            context.print(describe(free))?;
        }
    }
    match vented {
        true => Ok(()),
        false => {
            Err(Failure::fault(anyhow!("the vent is not verified")).remedy(fault::row(FaultCode::VentFailed).remedy))
        }
    }
}

fn describe(free: &FreeStatus) -> String {
    let seen = match (free.vented, free.pressure_pa) {
        (None, _) => "commanded to zero; it measures no pressure".into(),
        (Some(true), Some(pressure)) => format!("vented, {:.2}", Pressure::pascals(pressure)),
        (Some(_), Some(pressure)) => format!("NOT vented, last seen at {:.2}", Pressure::pascals(pressure)),
        (Some(_), None) => match &free.regulator.last_error {
            Some(error) => format!("NOT verified: {error}"),
            None => "NOT verified: no reading".into(),
        },
    };
    format!("{}: {seen}", free.name)
}

//! `freerig estop`: vent at once.

use std::time::Duration;

use anyhow::anyhow;

use super::{Context, Failure, control};
use crate::daemon::api::Status;
use crate::signal::{FaultCode, State};
use crate::units::Pressure;

/// How long the vent is watched; it needs less, or it has failed.
const WATCH: Duration = Duration::from_secs(35);

/// What `freerig estop` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The rig stays faulted until `freerig clear`.\n\nExamples:\n  freerig estop\n  kill -USR1 PID      the same, by signal to the daemon"
)]
pub struct Args {}

/// Stops the rig, then says what became of the pressures.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    let response = client.estop().map_err(Failure::client)?;
    if !context.json {
        context.print(&response.message)?;
    }
    let failed = |status: &Status| status.faults.iter().any(|f| f.code == FaultCode::VentFailed as u8);
    let status = control::wait(control::until(&client, WATCH, |status| {
        failed(status) || (status.state == State::Faulted.name() && is_vented(status))
    }))?;
    if context.json {
        context.print_json(&status)?;
    }
    if failed(&status) || status.state != State::Faulted.name() {
        let error = anyhow!("the vent is not verified: {}", pressures(&status));
        return Err(Failure::fault(error).remedy(crate::control::fault::row(FaultCode::VentFailed).remedy));
    }
    if !context.json {
        context.print(format!("vented: {}\n`freerig clear` when the reason is gone", pressures(&status)))?;
    }
    Ok(())
}

fn is_vented(status: &Status) -> bool {
    status.frees.iter().all(|free| free.vented != Some(false))
}

fn pressures(status: &Status) -> String {
    let free = status.frees.iter().map(|free| match free.pressure_pa {
        Some(pressure) => format!("{} at {:.2}", free.name, Pressure::pascals(pressure)),
        None => format!("the pressure of {} is not known", free.name),
    });
    free.collect::<Vec<_>>().join(", ")
}

//! `freerig set`: one value by hand.

use std::time::Duration;

use anyhow::anyhow;
use clap::Subcommand;
use serde_json::json;

use super::{Context, Exit, Failure, Progress, control};
use crate::daemon::api::{Happening, Run, RunResult, Set, Status};
use crate::daemon::client::{Client, ClientError};
use crate::units::{Angle, Pressure, Temperature};

/// How often the progress is looked at.
const LOOK: Duration = Duration::from_millis(200);

/// What `freerig set` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The rig must be armed. The pressure stays when the value is reached, also that which held an angle; `freerig disarm` takes it down.\n\nExamples:\n  freerig set pressure 3psi --free paper\n  freerig set angle -20deg --free paper\n  freerig set temperature 180degC --free knob"
)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The pressure, within 0 and max_pressure
    Pressure {
        /// Its new value
        #[arg(value_name = "PRESSURE")]
        value: Pressure,
        #[command(flatten)]
        subject: Subject,
    },
    /// The angle, within the soft envelope
    Angle {
        /// Its new value
        #[arg(value_name = "ANGLE")]
        value: Angle,
        #[command(flatten)]
        subject: Subject,
    },
    /// What the FREE's knob sets, within its table in rig.toml
    Temperature {
        /// Its new value
        #[arg(value_name = "TEMPERATURE")]
        value: Temperature,
        #[command(flatten)]
        subject: Subject,
    },
}

#[derive(Debug, clap::Args)]
struct Subject {
    /// FREE; not needed where the rig has one
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
}

/// Sets the value and waits until the FREE has had its time to get there.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    let (subject, wanted) = match args.what {
        What::Pressure { value, subject } => (subject, Set { pressure_pa: Some(value.si()), ..Set::default() }),
        What::Angle { value, subject } => (subject, Set { angle_rad: Some(value.si()), ..Set::default() }),
        What::Temperature { value, subject } => (subject, Set { temperature_degc: Some(value.si()), ..Set::default() }),
    };
    let status = control::wait(client.status())?;
    let free = match (subject.free, status.frees.as_slice()) {
        (Some(name), _) => name,
        (None, [only]) => only.name.clone(),
        (None, several) => {
            let names: Vec<_> = several.iter().map(|free| free.name.as_str()).collect();
            let error = anyhow!("the rig has several FREEs: {}", names.join(", "));
            return Err(Failure::usage(error).remedy("name one with `--free NAME`"));
        }
    };
    let set = Set { free, ..wanted };
    let (run, result, status) = control::wait(follow(&client, &set))?;
    let reached = status.frees.iter().find(|free| free.name == set.free);
    let done = result.as_ref().is_none_or(|result| result.outcome == "done");
    if context.json {
        context.print_json(&json!({ "simulated": status.simulated, "run": run, "result": result, "free": reached }))?;
    } else if let Some(free) = reached.filter(|_| done) {
        let simulated = if status.simulated { "SIMULATED " } else { "" };
        let angle = free.angle_rad.map(|a| format!("angle {:.1}", Angle::radians(a)));
        let pressure = free.pressure_pa.map(|p| format!("pressure {:.2}", Pressure::pascals(p)));
        let command = Some(format!("commanded {:.2}", Pressure::pascals(free.command_pa)));
        let temperature = free.temperature_degc.map(|t| format!("set to {:.1}", Temperature::celsius(t)));
        let values: Vec<_> = [temperature, angle, pressure, command].into_iter().flatten().collect();
        context.print(format!("{simulated}{}: {}\nrun: {}", free.name, values.join(", "), run.folder))?;
    }
    match result.filter(|_| !done) {
        None => Ok(()),
        Some(result) => {
            let exit = if result.outcome == "fault" { Exit::Fault } else { Exit::Failed };
            let error = anyhow!("{}: {}", result.outcome, result.reason.unwrap_or_default());
            Err(Failure { exit, error, remedy: Some("`freerig status` shows where the rig stands".into()) })
        }
    }
}

/// Sets the value and watches until the run is over.
async fn follow(client: &Client, set: &Set) -> Result<(Run, Option<RunResult>, Status), ClientError> {
    let mut events = client.events().await?;
    let response = client.set(set).await?;
    let run = response.run.unwrap_or_default();
    let mut progress = Progress::new(format!("{}: {}", set.free, run.name), run.duration_s, "s");
    let mut look = tokio::time::interval(LOOK);
    loop {
        tokio::select! {
            event = events.next() => match event?.map(|event| event.what) {
                Some(Happening::RunFinished(result)) if result.id == run.id => {
                    return Ok((run, Some(result), client.status().await?));
                }
                Some(_) => {}
                None => return Err(ClientError::Lost("the daemon has ended".into())),
            },
            _ = look.tick() => match client.status().await?.run {
                Some(now) if now.id == run.id => progress.set(now.elapsed_s, &now.phase),
                _ => {}
            },
        }
    }
}

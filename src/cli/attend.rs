//! An experiment that the daemon runs: started, attended by a heartbeat, watched to its end.

use std::io;
use std::path::Path;
use std::time::Duration;

use anyhow::anyhow;
use tokio::runtime::Runtime;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::{MissedTickBehavior, interval};

use super::outcome::Outcome;
use super::{Context, Failure, Progress};
use crate::daemon::api::{Arm, Event, Happening, Run, RunResult, Start};
use crate::daemon::client::Client;
use crate::hardware::wiring::ImuProfile;
use crate::units::{Angle, Pressure};

/// How often the daemon is asked how far it is, and told that somebody is there. It gives up a client that it has
/// not heard of for 1.5 s.
const LOOK: Duration = Duration::from_millis(250);
/// Looks without a run, after which the experiment has ended.
const ABSENCES: u32 = 2;

/// Has the daemon at `socket` run what `start` says, and prints what came of it.
pub fn run(socket: &Path, start: Start, context: &Context) -> Result<(), Failure> {
    if start.detach {
        let response = runtime()?.block_on(Client::new(socket).start(&start)).map_err(Failure::client)?;
        return started(&response.message, response.run, context);
    }
    watch(socket, &start, context)?.tell(context)
}

/// Has the daemon at `socket` run what `start` says, and answers what came of it.
pub fn watch(socket: &Path, start: &Start, context: &Context) -> Result<Outcome, Failure> {
    cued(socket, start, &[], context)
}

/// The same, telling a person what to do at which time since the program's start (s).
pub fn cued(socket: &Path, start: &Start, cues: &[Cue], context: &Context) -> Result<Outcome, Failure> {
    Ok(Outcome::new(runtime()?.block_on(attend(&Client::new(socket), start, cues, context))?))
}

/// What a person is told, and when: s since the program's start.
pub type Cue = (f64, String);

/// Has the daemon at `socket` arm the rig. A loop that is not going to be closed has no margin.
pub fn arm(socket: &Path) -> Result<(), Failure> {
    runtime()?.block_on(Client::new(socket).arm(Arm { accept_margin: true })).map_err(Failure::client)?;
    Ok(())
}

/// The calibration profile of the IMU of `free`, from the daemon at `socket`, whose rig is disarmed.
pub fn profile(socket: &Path, free: &str) -> Result<ImuProfile, Failure> {
    let response = runtime()?.block_on(Client::new(socket).profile(free)).map_err(Failure::client)?;
    let none = || Failure::failed(anyhow!("the daemon's answer has no profile in it"));
    Ok(response.profile.ok_or_else(none)?.into())
}

/// Has the daemon at `socket` take the pressures down.
pub fn disarm(socket: &Path) -> Result<(), Failure> {
    runtime()?.block_on(Client::new(socket).disarm()).map_err(Failure::client)?;
    Ok(())
}

fn runtime() -> io::Result<Runtime> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()
}

fn started(message: &str, run: Option<Run>, context: &Context) -> Result<(), Failure> {
    match run {
        Some(run) if context.json => context.print_json(&run),
        Some(run) => context.print(format!("{message}\nrun: {}\n`freerig status --watch` follows it", run.folder)),
        None => context.print(message),
    }
}

async fn attend(
    client: &Client,
    start: &Start,
    mut cues: &[Cue],
    context: &Context,
) -> Result<Vec<RunResult>, Failure> {
    // One listener from before the start to the end: what is pressed while the daemon is being asked is heard
    // afterwards.
    let mut interrupts = signal(SignalKind::interrupt())?;
    let mut events = client.events().await.map_err(Failure::client)?;
    client.start(start).await.map_err(Failure::client)?;
    let mut look = interval(LOOK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut results = Vec::new();
    let mut shown: Option<(String, Progress)> = None;
    let mut absences = 0;
    let mut stopping = false;
    while absences < ABSENCES {
        tokio::select! {
            event = events.next() => match event.map_err(Failure::client)? {
                Some(event) => happened(event, &mut results, context),
                None => return Err(Failure::failed(anyhow!("the daemon has ended")).remedy("its log says why")),
            },
            _ = look.tick() => {
                let status = client.status().await.map_err(Failure::client)?;
                let Some(run) = &status.run else {
                    absences += 1;
                    continue;
                };
                absences = 0;
                // Between two repetitions a heartbeat may name the one that has just ended.
                if client.heartbeat(&run.id).await.is_err() {
                    continue;
                }
                if shown.as_ref().is_none_or(|(phase, _)| *phase != phase_of(run)) {
                    shown = Some((phase_of(run), Progress::new(phase_of(run), run.duration_s, "s")));
                }
                if let (Some((_, bar)), Some(free)) = (&mut shown, status.frees.first()) {
                    bar.set(run.elapsed_s, &state(free.angle_rad, free.pressure_pa));
                }
                while let Some((_, text)) = cues.first().filter(|(at, _)| *at <= run.elapsed_s) {
                    context.note(text);
                    cues = &cues[1..];
                }
            }
            _ = interrupts.recv(), if !stopping => {
                stopping = true;
                context.note("stopping: the pressures hold; `freerig disarm` takes them down, `freerig estop` vents");
                client.stop().await.map_err(Failure::client)?;
            }
        }
    }
    Ok(results)
}

fn phase_of(run: &Run) -> String {
    let times = if run.repeats > 1 { format!(", {} of {}", run.repeat, run.repeats) } else { String::new() };
    format!("{}{times}: {}", run.name, run.phase)
}

fn state(angle: Option<f64>, pressure: Option<f64>) -> String {
    let angle = angle.map(|a| format!("angle {:.1}", Angle::radians(a)));
    let pressure = pressure.map(|p| format!("pressure {:.2}", Pressure::pascals(p)));
    [angle, pressure].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn happened(event: Event, results: &mut Vec<RunResult>, context: &Context) {
    match event.what {
        Happening::RunFinished(result) => results.push(result),
        Happening::Fault(fault) if fault.latched => {
            let about = fault.free.map(|free| format!(" ({free})")).unwrap_or_default();
            // What to do about it is told with the run's result.
            context.note(format!("fault: {}{about}", fault.name));
        }
        Happening::Warning { text, remedy } => context.note(format!("warning: {text}. {remedy}")),
        Happening::Missed { events } => context.note(format!("{events} messages of the daemon were missed")),
        Happening::RunStarted(_) | Happening::State { .. } | Happening::Fault(_) => {}
    }
}

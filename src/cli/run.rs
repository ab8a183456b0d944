//! `freerig run`: the daemon, in the foreground.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde_json::json;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing::level_filters::LevelFilter;

use super::{Context, Failure, log};
use crate::config::Rig;
use crate::daemon::api::Status;
use crate::daemon::{Access, DaemonError, RigLock, Server, SocketError, Supervisor, desk, notify};
use crate::record::{LiveOptions, LiveView};

/// The control socket's runtime; the loop, the buses and the record have threads of their own.
const THREADS: usize = 2;
/// How long blocking work may hold up the end of the process.
const FAREWELL: Duration = Duration::from_secs(1);
/// How long an owner that is just leaving is waited for.
const PATIENCE: Duration = Duration::from_secs(1);

/// What `freerig run` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "It starts disarmed and vented. SIGTERM and Ctrl-C command zero, verify the vent, and exit with status 3 if it could not be verified; SIGUSR1 is the emergency stop.\n\nExamples:\n  freerig run\n  freerig run --rig /etc/freerig/rig.toml\n  RUST_LOG=debug freerig run"
)]
pub struct Args {}

/// Runs the daemon until it is told to stop.
pub fn run(_: Args, context: &Context) -> Result<(), Failure> {
    log::start(LevelFilter::INFO);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build()?;
    // Before anything is opened: whoever stops it from here on finds it stopped in order.
    let stop = {
        let _inside = runtime.enter();
        Stop::new()?
    };
    let rig = Rig::load(&context.rig)?;
    let _lock = RigLock::take(&rig, PATIENCE).map_err(Failure::rig)?;
    let ended = runtime.block_on(serve(rig, stop, context));
    runtime.shutdown_timeout(FAREWELL);
    ended
}

async fn serve(rig: Rig, stop: Stop, context: &Context) -> Result<(), Failure> {
    let access = Access::new(rig.socket.group.as_deref()).map_err(Failure::usage)?;
    let (desk, handle) = desk(Status {
        rig: rig.name.clone(),
        simulated: rig.is_simulated(),
        state: "boot".into(),
        ..Status::default()
    });
    estop_on_sigusr1(Arc::clone(&handle.estop))?;
    let path = rig.socket.path.clone();
    let server = Server::open(&path, access, handle).map_err(|error| match error {
        SocketError::InTheWay(_) => Failure::usage(error),
        error => Failure::failed(error),
    })?;
    let view = live_view(&rig);
    let url = view.as_ref().map(LiveView::url);
    let (name, simulated) = (rig.name.clone(), rig.is_simulated());
    // Buses are opened and threads promoted: nothing that the socket should wait for.
    let supervisor = tokio::task::spawn_blocking(move || Supervisor::start(rig, desk, view)).await?;
    let supervisor = supervisor.map_err(Failure::rig)?;
    let version = env!("CARGO_PKG_VERSION");
    if context.json {
        context.print_json(
            &json!({ "version": version, "rig": name, "simulated": simulated, "socket": path, "live_view": url, "pid": std::process::id() }),
        )?;
    } else {
        context.note(format!("freerig {version}: {name}{}", if simulated { ", SIMULATED" } else { "" }));
        context.note(format!("control socket: {}", path.display()));
        if let Some(url) = url {
            context.note(format!("live view: {url}"));
        }
    }
    notify::ready();
    let served = supervisor.serve(stop.asked()).await;
    server.stop().await;
    served.map_err(Failure::rig)?;
    context.note("stopped: vented and verified");
    Ok(())
}

/// The live view, where it is wanted and possible: without it the rig works just as well.
fn live_view(rig: &Rig) -> Option<LiveView> {
    let record = &rig.record;
    if !record.live_view {
        return None;
    }
    let (page_port, data_port, memory_limit) = (record.page_port, record.data_port, record.memory_limit);
    LiveView::start(&LiveOptions { page_port, data_port, memory_limit })
        .inspect_err(|error| tracing::warn!("no live view: {error}"))
        .ok()
}

/// The signals that end the daemon.
struct Stop([(&'static str, Signal); 3]);

impl Stop {
    fn new() -> std::io::Result<Self> {
        // A file that may not grow is an error of its writer; by itself this signal would end the daemon, unvented.
        drop(signal(SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw()))?);
        let on = |name, kind| signal(kind).map(|signal| (name, signal));
        Ok(Self([
            on("SIGTERM", SignalKind::terminate())?,
            on("SIGINT", SignalKind::interrupt())?,
            // The terminal is gone.
            on("SIGHUP", SignalKind::hangup())?,
        ]))
    }

    async fn asked(self) {
        let [(term, mut terminate), (int, mut interrupt), (hup, mut hangup)] = self.0;
        let name = tokio::select! {
            _ = terminate.recv() => term,
            _ = interrupt.recv() => int,
            _ = hangup.recv() => hup,
        };
        tracing::info!("{name}");
    }
}

/// SIGUSR1 sets `estop`. A thread and a runtime of its own: no work of the daemon's stands before it.
fn estop_on_sigusr1(estop: Arc<AtomicBool>) -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut pressed = {
        let _inside = runtime.enter();
        signal(SignalKind::user_defined1())?
    };
    let thread = std::thread::Builder::new().name("freerig-sigusr1".into());
    thread
        .spawn(move || {
            runtime.block_on(async {
                while pressed.recv().await.is_some() {
                    estop.store(true, Ordering::SeqCst);
                    tracing::warn!("emergency stop by SIGUSR1");
                }
            });
        })
        .map_err(|error| {
            Failure::rig(DaemonError::Io {
                what: "the thread of the emergency stop could not be started".into(),
                error,
            })
        })?;
    Ok(())
}

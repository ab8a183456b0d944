//! What systemd is told: ready, status, stopping, and that the loop lives. Silent where systemd does not listen.

use std::sync::Arc;
use std::time::Duration;

use sd_notify::NotifyState;
use tokio::task::JoinHandle;

use crate::rt;

fn tell(states: &[NotifyState<'_>]) {
    // Without NOTIFY_SOCKET this does nothing.
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!(%error, "systemd could not be notified");
    }
}

/// The daemon serves: the buses are open, the loop runs, the sockets answer.
pub fn ready() {
    tell(&[NotifyState::Ready]);
}

/// One line for `systemctl status`.
pub fn status(text: &str) {
    tell(&[NotifyState::Status(text)]);
}

/// The daemon has begun to vent and to end.
pub fn stopping() {
    tell(&[NotifyState::Stopping]);
}

/// The loop's heartbeat for systemd's watchdog; ends when this is dropped.
#[derive(Debug)]
pub struct Watchdog {
    task: Option<JoinHandle<()>>,
}

impl Watchdog {
    /// Feeds the watchdog, if the unit has one, as long as the loop behind `statistics` gets on: a loop that
    /// stands still, or a runtime that does, is killed and started again by systemd.
    pub fn start(statistics: Arc<rt::Statistics>) -> Self {
        Self { task: sd_notify::watchdog_enabled().map(|limit| tokio::spawn(feed(statistics, limit))) }
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        if let Some(task) = &self.task {
            task.abort();
        }
    }
}

async fn feed(statistics: Arc<rt::Statistics>, limit: Duration) {
    // Four chances within the limit.
    let mut interval = tokio::time::interval(limit / 4);
    let mut seen = None;
    loop {
        interval.tick().await;
        let ticks = statistics.ticks();
        if seen != Some(ticks) {
            seen = Some(ticks);
            tell(&[NotifyState::Watchdog]);
        }
    }
}

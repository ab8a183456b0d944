//! What joins the control socket to the supervisor.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use super::PoseDesk;
use super::api::{Event, Problem, Request, Response, Status};
use crate::clock::Time;

/// A request, and where its answer goes.
pub type Call = (Request, oneshot::Sender<Result<Response, Problem>>);

/// The socket's side of the supervisor. Emergency stop and heartbeat are atomics that the tick itself reads: they
/// wait for nobody.
#[derive(Clone, Debug)]
pub struct Handle {
    /// Latest status.
    pub status: watch::Receiver<Status>,
    /// Everything that happens from a subscription on; a slow subscriber loses the oldest.
    pub events: broadcast::Sender<Event>,
    /// Requests to the supervisor, in order.
    pub requests: mpsc::Sender<Call>,
    /// The emergency stop: set by the socket and by SIGUSR1, taken back by the supervisor on a clear.
    pub estop: Arc<AtomicBool>,
    /// Latest heartbeat of the client that runs an experiment.
    pub heartbeat: Arc<LastHeard>,
    /// Poses of a module's plate, for the run that follows a path.
    pub poses: Arc<PoseDesk>,
}

/// When something was last heard of, on the live clock.
#[derive(Debug, Default)]
pub struct LastHeard(AtomicU64);

impl LastHeard {
    /// It was heard of at `time`.
    pub fn set(&self, time: Time) {
        self.0.store(time.as_nanos(), Ordering::Relaxed);
    }

    /// When it was last heard of; the clock's epoch where never.
    pub fn get(&self) -> Time {
        Time::from_nanos(self.0.load(Ordering::Relaxed))
    }
}

/// The supervisor's side of a [`Handle`].
#[derive(Debug)]
pub struct Desk {
    /// Where the status is published.
    pub status: watch::Sender<Status>,
    /// Where events are published; nobody listening is no error.
    pub events: broadcast::Sender<Event>,
    /// Requests to answer.
    pub requests: mpsc::Receiver<Call>,
    /// The emergency stop.
    pub estop: Arc<AtomicBool>,
    /// Latest heartbeat of the client that runs an experiment.
    pub heartbeat: Arc<LastHeard>,
    /// Poses of a module's plate, for the run that follows a path.
    pub poses: Arc<PoseDesk>,
}

/// Requests that may wait for the supervisor, and events that may wait for a reader.
const REQUESTS: usize = 16;
const EVENTS: usize = 256;

/// Both sides, with `status` as the first status.
pub fn desk(status: Status) -> (Desk, Handle) {
    let (status_in, status) = watch::channel(status);
    let (events, _) = broadcast::channel(EVENTS);
    let (requests, requests_out) = mpsc::channel(REQUESTS);
    let estop = Arc::new(AtomicBool::new(false));
    let heartbeat = Arc::new(LastHeard::default());
    let poses = Arc::<PoseDesk>::default();
    let desk = Desk {
        status: status_in,
        events: events.clone(),
        requests: requests_out,
        estop: Arc::clone(&estop),
        heartbeat: Arc::clone(&heartbeat),
        poses: Arc::clone(&poses),
    };
    (desk, Handle { status, events, requests, estop, heartbeat, poses })
}

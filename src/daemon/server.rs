//! The control socket: HTTP and JSON on a Unix socket, for `freerig`'s own commands and for `curl --unix-socket`.
//!
//! The server does nothing by itself: it checks who asks and what, hands requests to the supervisor through a
//! [`Handle`] and answers with what comes back. Bodies, waiting times, connections and the patience with slow
//! readers are bounded. Emergency stop and heartbeat go straight to their atomics.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::{Body, to_bytes};
use axum::extract::{ConnectInfo, FromRequest, Request as HttpRequest, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response as HttpResponse};
use axum::routing::{get, post};
use axum::{Json, Router};
use futures_util::{Stream, StreamExt, stream};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::{broadcast, mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use super::api::{
    Arm, Event, Happening, Heartbeat, Problem, ProblemKind, ProfileOf, Request, Response, Set, Start, Status,
};
use super::connection::Door;
use super::estop::EstopDoor;
use super::handle::Handle;
use super::socket::{Access, Peer, SocketError, SocketFile, check_free, listen};
use crate::clock::Clock;

/// Largest body of a request.
const BODY_LIMIT: usize = 64 * 1024;
/// Longest time for a body to arrive.
const BODY_TIME: Duration = Duration::from_secs(5);
/// Longest time for the supervisor's answer: arming and its self-test included.
const ANSWER_TIME: Duration = Duration::from_secs(30);
/// Shortest time between two lines of the status stream.
const STATUS_INTERVAL: Duration = Duration::from_millis(50);
/// How long open connections may hold up the server's end.
const FAREWELL: Duration = Duration::from_millis(500);

/// The running server. Dropping it closes the sockets; [`Server::stop`] lets pending answers out first.
#[derive(Debug)]
pub struct Server {
    closing: watch::Sender<bool>,
    task: JoinHandle<()>,
    _estop: EstopDoor,
    _file: SocketFile,
}

impl Server {
    /// Opens the control socket at `path` and the emergency stop's beside it, and serves both. Needs a runtime.
    ///
    /// # Errors
    ///
    /// [`SocketError`]: another daemon, something else in the way, no permission.
    pub fn open(path: &Path, access: Access, handle: Handle) -> Result<Self, SocketError> {
        check_free(path)?;
        let estop = EstopDoor::open(path, &access, Arc::clone(&handle.estop))?;
        let (listener, file) = listen(path, &access)?;
        let listener = listener
            .set_nonblocking(true)
            .and_then(|()| tokio::net::UnixListener::from_std(listener))
            .map_err(|error| SocketError::Io { path: path.into(), error })?;
        let (closing, closed) = watch::channel(false);
        let office = Arc::new(Office { handle, access, closed: closed.clone() });
        let service = routes(office).into_make_service_with_connect_info::<Peer>();
        let task = tokio::spawn(async move {
            let serve = axum::serve(Door::new(listener), service).with_graceful_shutdown(over(closed));
            if let Err(error) = serve.await {
                tracing::error!(%error, "the control socket has ended");
            }
        });
        Ok(Self { closing, task, _estop: estop, _file: file })
    }

    /// Ends the streams, lets pending answers out, and closes the sockets.
    pub async fn stop(mut self) {
        self.closing.send_replace(true);
        if timeout(FAREWELL, &mut self.task).await.is_err() {
            tracing::warn!("a client of the control socket held up its end");
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Resolves when the server is to end.
async fn over(mut closed: watch::Receiver<bool>) {
    // An error means that the server is gone: that is an end, too.
    closed.wait_for(|&closed| closed).await.ok();
}

struct Office {
    handle: Handle,
    access: Access,
    closed: watch::Receiver<bool>,
}

type Shared = State<Arc<Office>>;
type Answer = Result<Json<Response>, Problem>;

fn routes(office: Arc<Office>) -> Router {
    Router::new()
        .route("/v1/status", get(status))
        .route("/v1/status/stream", get(status_stream))
        .route("/v1/events", get(events))
        .route("/v1/arm", post(async |State(office): Shared, Read(arm): Read<Arm>| office.ask(Request::Arm(arm)).await))
        .route("/v1/disarm", post(async |State(office): Shared| office.ask(Request::Disarm).await))
        .route("/v1/clear", post(async |State(office): Shared| office.ask(Request::Clear).await))
        .route("/v1/stop", post(async |State(office): Shared| office.ask(Request::Stop).await))
        .route("/v1/set", post(set))
        .route(
            "/v1/start",
            post(async |State(office): Shared, Read(start): Read<Start>| office.ask(Request::Start(start)).await),
        )
        .route(
            "/v1/profile",
            post(async |State(office): Shared, Read(of): Read<ProfileOf>| office.ask(Request::Profile(of)).await),
        )
        .route("/v1/heartbeat", post(heartbeat))
        .route("/v1/estop", post(estop))
        .fallback(async || Problem::new(ProblemKind::NotFound, "there is nothing at this address", ROUTES))
        .method_not_allowed_fallback(async || {
            Problem::new(ProblemKind::Usage, "this address takes another method", ROUTES)
        })
        .layer(from_fn_with_state(Arc::clone(&office), admit))
        .with_state(office)
}

const ROUTES: &str = "GET /v1/status, /v1/status/stream, /v1/events; POST /v1/arm, disarm, clear, set, start, stop, profile, heartbeat, estop";

/// Lets in whoever may control the rig, for one request.
async fn admit(
    State(office): Shared,
    ConnectInfo(peer): ConnectInfo<Peer>,
    request: HttpRequest,
    next: Next,
) -> HttpResponse {
    let known = tokio::task::spawn_blocking(move || office.access.allows(peer)).await;
    let mut answer = if known.unwrap_or(false) {
        next.run(request).await
    } else {
        tracing::warn!(uid = peer.uid, "a user without the right to control the rig was turned away");
        let error = format!("the user with the id {} may not control this rig", peer.uid);
        let remedy = "become a member of the group of [socket] in rig.toml, and log in again";
        Problem::new(ProblemKind::Denied, error, remedy).into_response()
    };
    // One request a connection: nobody keeps a seat for what may come later.
    answer.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    answer
}

impl Office {
    /// Puts `request` to the supervisor and waits for its answer.
    async fn ask(&self, request: Request) -> Answer {
        let busy =
            |error: &str| Problem::new(ProblemKind::Busy, error, "wait for it, or `freerig estop`, which never waits");
        let gone = || {
            Problem::new(
                ProblemKind::Failed,
                "the supervisor has ended",
                "look into the daemon's log and start it again",
            )
        };
        let (answer_to, answer) = oneshot::channel();
        match self.handle.requests.try_send((request, answer_to)) {
            Ok(()) => {}
            Err(mpsc::error::TrySendError::Full(_)) => return Err(busy("too many requests wait for the supervisor")),
            Err(mpsc::error::TrySendError::Closed(_)) => return Err(gone()),
        }
        match timeout(ANSWER_TIME, answer).await {
            Ok(Ok(answer)) => answer.map(Json),
            Ok(Err(_)) => Err(gone()),
            Err(_) => Err(busy("the supervisor has not answered within 30 s; the request may still be done")),
        }
    }
}

async fn status(State(office): Shared) -> Json<Status> {
    Json(office.handle.status.borrow().clone())
}

async fn set(State(office): Shared, Read(set): Read<Set>) -> Answer {
    if set.pressure_pa.is_some() == set.angle_rad.is_some() {
        let error = "exactly one of pressure_pa and angle_rad is to be set";
        return Err(Problem::new(ProblemKind::Usage, error, "give one of the two"));
    }
    office.ask(Request::Set(set)).await
}

async fn heartbeat(State(office): Shared, Read(heartbeat): Read<Heartbeat>) -> Answer {
    let running = office.handle.status.borrow().run.as_ref().is_some_and(|run| run.id == heartbeat.run);
    if !running {
        let error = format!("the run {} is not in progress", heartbeat.run);
        return Err(Problem::new(ProblemKind::NotFound, error, "`freerig runs` shows how it ended"));
    }
    office.handle.heartbeat.set(Clock::Live.now());
    Ok(Json(Response::default()))
}

async fn estop(State(office): Shared) -> Json<Response> {
    office.handle.estop.store(true, Ordering::SeqCst);
    tracing::warn!("emergency stop through the control socket");
    Json(Response::done("emergency stop is set"))
}

async fn status_stream(State(office): Shared) -> HttpResponse {
    let mut receiver = office.handle.status.clone();
    receiver.mark_changed();
    let changes = stream::unfold(receiver, async |mut receiver| {
        receiver.changed().await.ok()?;
        tokio::time::sleep(STATUS_INTERVAL).await;
        let status = receiver.borrow_and_update().clone();
        Some((status, receiver))
    });
    lines(&office, changes)
}

async fn events(State(office): Shared) -> HttpResponse {
    lines(
        &office,
        stream::unfold(office.handle.events.subscribe(), async |mut receiver| match receiver.recv().await {
            Ok(event) => Some((event, receiver)),
            Err(broadcast::error::RecvError::Lagged(events)) => {
                Some((Event::now(Happening::Missed { events }), receiver))
            }
            Err(broadcast::error::RecvError::Closed) => None,
        }),
    )
}

/// One line of JSON for each item, until the server ends.
fn lines<T: Serialize>(office: &Office, items: impl Stream<Item = T> + Send + 'static) -> HttpResponse {
    let text =
        items.map(|item| serde_json::to_string(&item).map(|line| line + "\n")).take_until(over(office.closed.clone()));
    ([(header::CONTENT_TYPE, "application/x-ndjson")], Body::from_stream(text)).into_response()
}

/// The body of a request: bounded in size and time, and of the right shape.
struct Read<T>(T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Read<T> {
    type Rejection = Problem;

    async fn from_request(request: HttpRequest, _: &S) -> Result<Self, Problem> {
        let usage = |error: String, remedy: &str| Problem::new(ProblemKind::Usage, error, remedy);
        let body = timeout(BODY_TIME, to_bytes(request.into_body(), BODY_LIMIT))
            .await
            .map_err(|_| usage("the request's body did not arrive within 5 s".into(), "send it at once"))?
            .map_err(|_| usage(format!("the request's body is larger than {} KiB", BODY_LIMIT / 1024), "send less"))?;
        let body: &[u8] = if body.is_empty() { b"{}" } else { &body };
        serde_json::from_slice(body).map(Read).map_err(|error| {
            usage(
                format!("the request's body is not what this address takes: {error}"),
                "send the JSON object that the README describes",
            )
        })
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> HttpResponse {
        let status = match self.kind {
            ProblemKind::Usage => StatusCode::BAD_REQUEST,
            ProblemKind::Denied => StatusCode::FORBIDDEN,
            ProblemKind::NotFound => StatusCode::NOT_FOUND,
            ProblemKind::Refused | ProblemKind::Fault => StatusCode::CONFLICT,
            ProblemKind::Busy => StatusCode::SERVICE_UNAVAILABLE,
            ProblemKind::Failed => StatusCode::INTERNAL_SERVER_ERROR,
        };
        (status, Json(self)).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::client::{Client, ClientError};
    use crate::daemon::desk;

    #[tokio::test(flavor = "multi_thread")]
    async fn who_may_open_the_file_but_not_control_the_rig_is_turned_away_but_may_stop_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control.sock");
        let (desk, handle) = desk(Status::default());
        let server = Server::open(&path, Access::nobody(), handle).unwrap();
        let client = Client::new(&path);
        match client.disarm().await {
            Err(ClientError::Problem(Problem { kind: ProblemKind::Denied, remedy, .. })) => {
                assert!(remedy.contains("group"), "{remedy}");
            }
            other => panic!("{other:?}"),
        }
        assert!(client.status().await.is_err());
        assert!(desk.requests.is_empty());
        tokio::task::spawn_blocking(move || client.estop()).await.unwrap().unwrap();
        assert!(desk.estop.load(Ordering::SeqCst));
        server.stop().await;
    }
}

//! The commands' side of the control socket.

use std::io::{self, Read, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::{Method, StatusCode};
use hyper_util::rt::TokioIo;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use tokio::net::UnixStream;
use tokio::time::timeout;

use super::api::{Arm, Event, Heartbeat, Pose, Problem, ProfileOf, Response, Set, Start, Status};
use super::socket::estop_path;

/// Longest time for an answer; longer than the server waits for the supervisor.
const ANSWER_TIME: Duration = Duration::from_secs(35);
/// Longest time for the emergency stop's answer.
const STOP_TIME: Duration = Duration::from_secs(2);
/// Largest answer, and longest line of a stream, that is believed.
const ANSWER_LIMIT: usize = 1 << 20;

/// Why the daemon did not do what was asked.
#[derive(Debug, Error)]
pub enum ClientError {
    /// Nobody listens at the socket.
    #[error("no freerig daemon runs here: nobody listens at {0}")]
    NoDaemon(PathBuf),
    /// The socket's file may not be opened.
    #[error("you may not open the control socket {0}")]
    Denied(PathBuf),
    /// The connection broke off.
    #[error("the connection to the daemon was lost: {0}")]
    Lost(String),
    /// The daemon did not answer.
    #[error("the daemon has not answered within {} s", .0.as_secs())]
    Silent(Duration),
    /// The answer is none of this version's.
    #[error("the daemon's answer is not understood: {0}")]
    NotUnderstood(String),
    /// The daemon said no, and why.
    #[error(transparent)]
    Problem(#[from] Problem),
}

impl ClientError {
    /// What to do about it.
    pub fn remedy(&self) -> &str {
        match self {
            ClientError::NoDaemon(_) => {
                "start it (`freerig run`, or `systemctl start freerig`); `freerig demo` needs none, and `freerig vent` vents without one"
            }
            ClientError::Denied(_) => "become a member of the group of [socket] in rig.toml, and log in again",
            ClientError::Lost(_) | ClientError::Silent(_) => {
                "`freerig status` shows whether it still runs; its log says why (`journalctl -u freerig`)"
            }
            ClientError::NotUnderstood(_) => "daemon and command are of different versions: restart the daemon",
            ClientError::Problem(problem) => &problem.remedy,
        }
    }
}

/// A daemon, by its control socket. Every request is a connection of its own.
#[derive(Clone, Debug)]
pub struct Client {
    path: PathBuf,
}

impl Client {
    /// The daemon whose control socket is at `path`.
    pub fn new(path: &Path) -> Self {
        Self { path: path.into() }
    }

    /// Where the rig stands.
    pub async fn status(&self) -> Result<Status, ClientError> {
        let answer = self.send(Method::GET, "/v1/status", None).await?;
        read(answer).await
    }

    /// The status, again whenever it changes.
    pub async fn watch(&self) -> Result<Lines<Status>, ClientError> {
        Ok(Lines::new(self.send(Method::GET, "/v1/status/stream", None).await?))
    }

    /// Everything that happens from now on.
    pub async fn events(&self) -> Result<Lines<Event>, ClientError> {
        Ok(Lines::new(self.send(Method::GET, "/v1/events", None).await?))
    }

    /// Arms the rig.
    pub async fn arm(&self, arm: Arm) -> Result<Response, ClientError> {
        self.post("/v1/arm", &arm).await
    }

    /// Takes the pressures down and disarms.
    pub async fn disarm(&self) -> Result<Response, ClientError> {
        self.post("/v1/disarm", &()).await
    }

    /// Clears latched faults.
    pub async fn clear(&self) -> Result<Response, ClientError> {
        self.post("/v1/clear", &()).await
    }

    /// Sets one value by hand.
    pub async fn set(&self, set: &Set) -> Result<Response, ClientError> {
        self.post("/v1/set", set).await
    }

    /// Starts an experiment.
    pub async fn start(&self, start: &Start) -> Result<Response, ClientError> {
        self.post("/v1/start", start).await
    }

    /// Stops the experiment.
    pub async fn stop(&self) -> Result<Response, ClientError> {
        self.post("/v1/stop", &()).await
    }

    /// Reads the calibration profile of the IMU of `free`.
    pub async fn profile(&self, free: &str) -> Result<Response, ClientError> {
        self.post("/v1/profile", &ProfileOf { free: free.into() }).await
    }

    /// Says that the client that runs `run` is still there.
    pub async fn heartbeat(&self, run: &str) -> Result<Response, ClientError> {
        self.post("/v1/heartbeat", &Heartbeat { run: run.into() }).await
    }

    /// Says where an external tracker sees the plate of the module that follows a path.
    pub async fn pose(&self, pose: &Pose) -> Result<Response, ClientError> {
        self.post("/v1/pose", pose).await
    }

    /// The emergency stop: needs no runtime and waits for nobody. Connecting is the stop, so it has been done even
    /// where the answer is lost.
    pub fn estop(&self) -> Result<Response, ClientError> {
        let path = estop_path(&self.path);
        let lost = |error: io::Error| ClientError::Lost(error.to_string());
        let mut stream = std::os::unix::net::UnixStream::connect(&path).map_err(|error| refused(&path, &error))?;
        stream.set_read_timeout(Some(STOP_TIME)).map_err(lost)?;
        stream.set_write_timeout(Some(STOP_TIME)).map_err(lost)?;
        stream.write_all(b"POST /v1/estop HTTP/1.1\r\nhost: freerig\r\n\r\n").map_err(lost)?;
        let mut answer = Vec::new();
        stream.take(ANSWER_LIMIT as u64).read_to_end(&mut answer).map_err(lost)?;
        let text = String::from_utf8_lossy(&answer);
        let body = text.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        serde_json::from_str(body).map_err(|error| ClientError::NotUnderstood(error.to_string()))
    }

    async fn post(&self, route: &str, body: &impl Serialize) -> Result<Response, ClientError> {
        let body = serde_json::to_vec(body).map_err(|error| ClientError::NotUnderstood(error.to_string()))?;
        read(self.send(Method::POST, route, Some(body)).await?).await
    }

    /// Sends one request; an answer that is not a success becomes its [`Problem`].
    async fn send(&self, method: Method, route: &str, body: Option<Vec<u8>>) -> Result<Incoming, ClientError> {
        let lost = |error: hyper::Error| ClientError::Lost(error.to_string());
        let stream = UnixStream::connect(&self.path).await.map_err(|error| refused(&self.path, &error))?;
        let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await.map_err(lost)?;
        // The connection ends with the answer's body; its errors appear there.
        tokio::spawn(connection);
        let request = hyper::Request::builder()
            .method(method)
            .uri(route)
            .header("host", "freerig")
            .header("content-type", "application/json")
            .body(Full::new(Bytes::from(body.unwrap_or_default())))
            .map_err(|error| ClientError::NotUnderstood(error.to_string()))?;
        let answer = timeout(ANSWER_TIME, sender.send_request(request)).await;
        let answer = answer.map_err(|_| ClientError::Silent(ANSWER_TIME))?.map_err(lost)?;
        match answer.status() {
            StatusCode::OK => Ok(answer.into_body()),
            _ => Err(ClientError::Problem(read(answer.into_body()).await?)),
        }
    }
}

fn refused(path: &Path, error: &io::Error) -> ClientError {
    match error.kind() {
        io::ErrorKind::PermissionDenied => ClientError::Denied(path.into()),
        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => ClientError::NoDaemon(path.into()),
        _ => ClientError::Lost(error.to_string()),
    }
}

/// A whole answer as JSON.
async fn read<T: DeserializeOwned>(answer: Incoming) -> Result<T, ClientError> {
    let body = timeout(ANSWER_TIME, Limited::new(answer, ANSWER_LIMIT).collect()).await;
    let body =
        body.map_err(|_| ClientError::Silent(ANSWER_TIME))?.map_err(|error| ClientError::Lost(error.to_string()))?;
    serde_json::from_slice(&body.to_bytes()).map_err(|error| ClientError::NotUnderstood(error.to_string()))
}

/// A stream of JSON objects, one a line.
#[derive(Debug)]
pub struct Lines<T> {
    body: Incoming,
    rest: Vec<u8>,
    kind: PhantomData<T>,
}

impl<T: DeserializeOwned> Lines<T> {
    fn new(body: Incoming) -> Self {
        Self { body, rest: Vec::new(), kind: PhantomData }
    }

    /// The next object; `None` when the daemon has ended the stream.
    ///
    /// # Errors
    ///
    /// [`ClientError::Lost`], [`ClientError::NotUnderstood`].
    pub async fn next(&mut self) -> Result<Option<T>, ClientError> {
        loop {
            if let Some(end) = self.rest.iter().position(|&b| b == b'\n') {
                let line: Vec<u8> = self.rest.drain(..=end).collect();
                let value = serde_json::from_slice(&line);
                return value.map(Some).map_err(|error| ClientError::NotUnderstood(error.to_string()));
            }
            if self.rest.len() > ANSWER_LIMIT {
                return Err(ClientError::NotUnderstood("a line without an end".into()));
            }
            match self.body.frame().await {
                None => return Ok(None),
                Some(Err(error)) => return Err(ClientError::Lost(error.to_string())),
                Some(Ok(frame)) => self.rest.extend(frame.data_ref().into_iter().flatten()),
            }
        }
    }
}

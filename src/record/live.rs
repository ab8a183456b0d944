//! The live view: the run as it happens, in rerun's viewer or in an ordinary browser, on loopback only.
//!
//! ```text
//! recorder --bounded queue, drops--> thread "live" -> rerun's server on a hidden port
//!                                                         ^
//!            browser, viewer --- data port: [relay](super::relay), cuts who takes nothing for 5 s
//!            browser ----------- page port: the viewer's page (super::page)
//! ```
//!
//! The recorder never waits for a viewer: what does not fit into the queue is dropped from the live view (never
//! from the file) and counted. There is no authentication: every user of this machine can watch; rig.toml
//! switches it off.

use std::fmt;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use arrow::array::RecordBatch;
use rerun::grpc_server::GrpcServerSink;
use rerun::log::LogMsg;
use rerun::sink::{LogSink, SinkFlushError};
use rerun::{MemoryLimit, RecordingStream, ServerOptions};
use tokio::sync::oneshot;

use super::document::StartDocument;
use super::rerun_sink::{RerunSink, builder};
use super::{RecordError, Result, page, relay};

/// Batches that wait for the live thread before they are dropped: 3 s.
const QUEUE: usize = 30;

/// Where the live view is served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveOptions {
    /// Port of the page for browsers; 0 takes any free one.
    pub page_port: u16,
    /// Port of the data, also for rerun's own viewer; 0 takes any free one.
    pub data_port: u16,
    /// What is kept for viewers that come late, bytes; the oldest goes first.
    pub memory_limit: u64,
}

impl Default for LiveOptions {
    fn default() -> Self {
        Self { page_port: 9090, data_port: 9876, memory_limit: 128 << 20 }
    }
}

/// The running live view; it ends when this is dropped.
pub struct LiveView {
    page_port: u16,
    data_port: u16,
    feed: LiveFeed,
    stop: Option<oneshot::Sender<()>>,
}

impl LiveView {
    /// Starts the servers and their threads.
    ///
    /// # Errors
    /// Where a port is taken or a thread cannot be started.
    pub fn start(options: &LiveOptions) -> Result<Self> {
        let (data, data_port) = listen(options.data_port)?;
        let (page, page_port) = listen(options.page_port)?;
        // rerun binds by itself and only logs a failure, so a free port is found for it.
        let (probe, hidden_port) = listen(0)?;
        drop(probe);
        let live = |port: u16| move |reason: String| RecordError::Live { port, reason };
        let server =
            ServerOptions { memory_limit: MemoryLimit::from_bytes(options.memory_limit), ..ServerOptions::default() };
        let sink =
            GrpcServerSink::new("127.0.0.1", hidden_port, server).map_err(|e| live(hidden_port)(e.to_string()))?;

        let (stop, stopped) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| live(data_port)(e.to_string()))?;
        thread::Builder::new()
            .name("live-serve".into())
            .spawn(move || {
                runtime.block_on(async move {
                    tokio::select! {
                        r = relay::serve(data, hidden_port) => log_end("data", r),
                        r = page::serve(page, data_port) => log_end("page", r),
                        _ = stopped => {}
                    }
                });
                // Every connection ends with the runtime, so that rerun's server has nobody left to wait for.
                drop(runtime);
            })
            .map_err(|e| live(data_port)(e.to_string()))?;

        let (sender, receiver) = sync_channel(QUEUE);
        thread::Builder::new()
            .name("live-send".into())
            .spawn(move || send(&receiver, &Arc::new(sink)))
            .map_err(|e| live(data_port)(e.to_string()))?;
        Ok(Self { page_port, data_port, feed: LiveFeed { sender, dropped: Arc::default() }, stop: Some(stop) })
    }

    /// What to open in a browser.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.page_port)
    }

    /// What to give to rerun's own viewer (`rerun URL`).
    pub fn data_url(&self) -> String {
        format!("rerun+http://127.0.0.1:{}/proxy", self.data_port)
    }

    /// Where recorders send their batches.
    pub fn feed(&self) -> LiveFeed {
        self.feed.clone()
    }

    /// Batches that the live view has dropped because it could not keep up.
    pub fn dropped(&self) -> u64 {
        self.feed.dropped.load(Ordering::Relaxed)
    }
}

impl Drop for LiveView {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            // The thread may have ended already, with its reason logged.
            let _ = stop.send(());
        }
    }
}

fn listen(port: u16) -> Result<(TcpListener, u16)> {
    let bind = || {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        Ok((listener, port))
    };
    bind().map_err(|e: std::io::Error| RecordError::Live { port, reason: e.to_string() })
}

fn log_end(what: &str, result: std::io::Result<()>) {
    if let Err(error) = result {
        tracing::error!(%error, "the live view's {what} port has failed; the record goes on");
    }
}

/// Where a recorder sends its batches for the live view.
#[derive(Clone)]
pub struct LiveFeed {
    sender: SyncSender<LiveBatch>,
    dropped: Arc<AtomicU64>,
}

impl fmt::Debug for LiveFeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LiveFeed").field("dropped", &self.dropped).finish_non_exhaustive()
    }
}

/// A batch and the run that it belongs to.
struct LiveBatch {
    start: Arc<StartDocument>,
    truth: bool,
    batch: RecordBatch,
}

impl LiveFeed {
    /// Offers `batch` of the run `start`; drops it where the live view is behind. Never waits.
    pub(super) fn offer(&self, start: &Arc<StartDocument>, truth: bool, batch: RecordBatch) {
        let offered = self.sender.try_send(LiveBatch { start: start.clone(), truth, batch });
        if matches!(offered, Err(TrySendError::Full(_))) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// One server for the streams of all runs, one after the other.
struct Shared(Arc<GrpcServerSink>);

impl LogSink for Shared {
    fn send(&self, message: LogMsg) {
        self.0.send(message);
    }

    fn flush_blocking(&self, timeout: Duration) -> std::result::Result<(), SinkFlushError> {
        self.0.flush_blocking(timeout)
    }

    fn default_batcher_config(&self) -> rerun::log::ChunkBatcherConfig {
        self.0.default_batcher_config()
    }
}

/// The thread "live-send": begins a stream at the first batch of a run and sends until every feed is gone.
fn send(batches: &Receiver<LiveBatch>, server: &Arc<GrpcServerSink>) {
    let mut current: Option<(Arc<StartDocument>, RerunSink)> = None;
    for LiveBatch { start, truth, batch } in batches {
        if current.as_ref().is_none_or(|(s, _)| s.id != start.id) {
            match begin(&start, truth, server) {
                Ok(sink) => current = Some((start, sink)),
                Err(error) => {
                    tracing::error!(%error, "the live view cannot show this run");
                    continue;
                }
            }
        }
        if let Some((_, sink)) = &mut current
            && let Err(error) = sink.send(&batch)
        {
            tracing::error!(%error, "the live view has lost a batch");
        }
    }
}

fn begin(start: &StartDocument, truth: bool, server: &Arc<GrpcServerSink>) -> Result<RerunSink> {
    let stream: RecordingStream = builder(start, truth).buffered()?;
    stream.set_sink(Box::new(Shared(server.clone())));
    RerunSink::new(stream, start, truth)
}

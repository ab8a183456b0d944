//! One connection of the control socket: who it is, and what happens to one that asks nothing or takes nothing.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::extract::connect_info::Connected;
use axum::serve::{IncomingStream, Listener};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Sleep, sleep};

use super::socket::Peer;

/// Connections at a time; the emergency stop has a door of its own.
const SEATS: usize = 64;
/// A client that has not asked for anything within this time is dropped: it keeps a seat.
const ASKING: Duration = Duration::from_secs(5);
/// A reader that takes nothing for this long is dropped.
const STALL: Duration = Duration::from_secs(2);

/// The control socket's listener.
pub(super) struct Door {
    listener: UnixListener,
    seats: Arc<Semaphore>,
}

impl Door {
    pub fn new(listener: UnixListener) -> Self {
        Self { listener, seats: Arc::new(Semaphore::new(SEATS)) }
    }
}

impl Listener for Door {
    type Io = Connection;
    type Addr = Peer;

    async fn accept(&mut self) -> (Connection, Peer) {
        loop {
            // The semaphore is never closed.
            let seat = Arc::clone(&self.seats).acquire_owned().await.ok();
            match self.listener.accept().await.and_then(|(stream, _)| Ok((stream.peer_cred()?, stream))) {
                Ok((peer, stream)) => {
                    let asking = Some(Asking { end: Box::pin(sleep(ASKING)), begun: false, line_ends: 0 });
                    let connection = Connection { stream, asking, stalled: None, _seat: seat };
                    return (connection, Peer { uid: peer.uid(), gid: peer.gid() });
                }
                Err(error) => {
                    tracing::warn!(%error, "a connection to the control socket could not be accepted");
                    sleep(Duration::from_millis(50)).await;
                }
            }
        }
    }

    fn local_addr(&self) -> io::Result<Peer> {
        Ok(Peer { uid: uzers::get_effective_uid(), gid: uzers::get_effective_gid() })
    }
}

impl Connected<IncomingStream<'_, Door>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Door>) -> Self {
        *stream.remote_addr()
    }
}

/// A stream whose reads fail when no request's head has come within [`ASKING`], and whose writes fail when the other
/// end takes nothing for [`STALL`].
pub(super) struct Connection {
    stream: UnixStream,
    /// Until the request's head is complete; what follows it has limits of its own.
    asking: Option<Asking>,
    stalled: Option<Pin<Box<Sleep>>>,
    _seat: Option<OwnedSemaphorePermit>,
}

/// Waits for the end of a request's head: an empty line after one that is not.
struct Asking {
    end: Pin<Box<Sleep>>,
    begun: bool,
    line_ends: u8,
}

impl Asking {
    /// Whether the head is complete with `bytes`.
    fn hears(&mut self, bytes: &[u8]) -> bool {
        bytes.iter().any(|byte| {
            match byte {
                b'\r' => {}
                b'\n' => self.line_ends += u8::from(self.begun),
                _ => (self.begun, self.line_ends) = (true, 0),
            }
            self.line_ends == 2
        })
    }
}

impl Connection {
    /// Lets a finished operation pass; times one that is not.
    fn within_patience<T>(&mut self, cx: &mut Context<'_>, poll: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if poll.is_ready() {
            self.stalled = None;
            return poll;
        }
        ready!(self.stalled.get_or_insert_with(|| Box::pin(sleep(STALL))).as_mut().poll(cx));
        tracing::warn!("a client of the control socket takes nothing: dropped");
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Connection {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let poll = Pin::new(&mut self.stream).poll_read(cx, buf);
        if let Some(asking) = &mut self.asking {
            if asking.hears(&buf.filled()[before..]) {
                self.asking = None;
            } else if poll.is_pending() {
                ready!(asking.end.as_mut().poll(cx));
                tracing::warn!("a client of the control socket asks for nothing: dropped");
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
        }
        poll
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, data: &[u8]) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.stream).poll_write(cx, data);
        self.within_patience(cx, poll)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        data: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.stream).poll_write_vectored(cx, data);
        self.within_patience(cx, poll)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

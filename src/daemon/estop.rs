//! The emergency stop's own door: a socket and a thread apart from everything else.
//!
//! *Connecting is the stop.* Nothing is parsed and nothing is waited for before the flag is set, so that no
//! request, no runtime and no malformed byte can stand before it. Who may open the socket file (mode 0660) may
//! stop the rig; a stop needs no further right. The answer is one HTTP response, so that `curl -X POST
//! --unix-socket control.sock.estop http://freerig/v1/estop` works as well as `freerig estop`.

use std::io::{self, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use super::socket::{Access, SocketError, SocketFile, estop_path, listen};

/// A peer that stops and then neither writes nor reads costs the next one this long at most, twice.
const COURTESY: Duration = Duration::from_millis(50);
const ANSWER: &str = concat!(
    "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\nconnection: close\r\ncontent-length: 46\r\n\r\n",
    r#"{"message":"emergency stop is set","run":null}"#
);

/// The listening thread; it ends when this is dropped.
#[derive(Debug)]
pub struct EstopDoor {
    file: SocketFile,
    closing: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl EstopDoor {
    /// Listens beside the control socket at `control`, and sets `stop` whenever somebody connects.
    ///
    /// # Errors
    ///
    /// [`SocketError::Io`].
    pub fn open(control: &Path, access: &Access, stop: Arc<AtomicBool>) -> Result<Self, SocketError> {
        let path = estop_path(control);
        let (listener, file) = listen(&path, access)?;
        let closing = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("freerig-estop".into()).spawn({
            let closing = Arc::clone(&closing);
            move || attend(&listener, &stop, &closing)
        });
        let thread = thread.map_err(|error| SocketError::Io { path, error })?;
        Ok(Self { file, closing, thread: Some(thread) })
    }
}

impl Drop for EstopDoor {
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Relaxed);
        // The thread waits for a connection: this one tells it to look at the flag.
        if UnixStream::connect(self.file.path()).is_ok()
            && let Some(thread) = self.thread.take()
        {
            thread.join().ok();
        }
    }
}

fn attend(listener: &UnixListener, stop: &AtomicBool, closing: &AtomicBool) {
    loop {
        let connection = listener.accept();
        if closing.load(Ordering::Relaxed) {
            return;
        }
        match connection {
            Ok((stream, _)) => {
                stop.store(true, Ordering::SeqCst);
                tracing::warn!("emergency stop through its socket");
                // The peer may well be gone already.
                answer(stream).ok();
            }
            Err(error) => {
                tracing::error!(%error, "the emergency stop's socket fails");
                std::thread::sleep(COURTESY);
            }
        }
    }
}

fn answer(mut stream: UnixStream) -> io::Result<()> {
    stream.set_read_timeout(Some(COURTESY))?;
    stream.set_write_timeout(Some(COURTESY))?;
    // Taking what was sent keeps the answer from being lost in a reset.
    match stream.read(&mut [0; 4096]) {
        Ok(_) => {}
        Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
        Err(error) => return Err(error),
    }
    stream.write_all(ANSWER.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_says_its_own_length() {
        let (head, body) = ANSWER.split_once("\r\n\r\n").unwrap();
        assert!(head.ends_with(&format!("content-length: {}", body.len())), "{head}");
        serde_json::from_str::<crate::daemon::api::Response>(body).unwrap();
    }
}

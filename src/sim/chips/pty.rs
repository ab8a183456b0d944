//! A simulated serial line behind a real pseudo-terminal: the driver opens it like any device.

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use futures_util::future::{Either, select};
use rustix::fs::OFlags;
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tokio::net::unix::pipe::Receiver;
use tokio::sync::oneshot;

use super::SerialLine;
use crate::clock::Clock;

/// How often it is tried whether somebody has opened the other end.
const CLOSED_POLL: Duration = Duration::from_millis(2);
/// How long to sleep when there is nothing to send.
const IDLE: Duration = Duration::from_secs(1);

/// What the serving thread does first.
pub type Promote = Arc<dyn Fn() + Send + Sync>;

/// The pseudo-terminal, served by a thread; unplugged when dropped.
pub struct Pty {
    line: Arc<Mutex<SerialLine>>,
    link: PathBuf,
    promote: Promote,
    serving: Option<(oneshot::Sender<()>, JoinHandle<()>)>,
}

impl Pty {
    /// Plugs the line in. The device's path is `link`, a symbolic link as in `/dev/serial/by-id`; an old link
    /// there is replaced. The serving thread calls `promote` first: a real unit does not wait for a busy computer.
    pub fn new(line: Arc<Mutex<SerialLine>>, link: &Path, promote: Promote) -> io::Result<Self> {
        let mut pty = Self { line, link: link.to_owned(), promote, serving: None };
        pty.plug()?;
        Ok(pty)
    }

    /// The device's path.
    pub fn path(&self) -> &Path {
        &self.link
    }

    /// Pulls the plug: the terminal is gone, and its path.
    pub fn unplug(&mut self) {
        if let Some((stop, thread)) = self.serving.take() {
            // A thread that has ended by itself has nobody to tell, and one that has panicked has said so.
            let _ = stop.send(());
            let _ = thread.join();
            let _ = std::fs::remove_file(&self.link);
        }
        self.line.lock().unwrap_or_else(PoisonError::into_inner).plug(false);
    }

    /// Plugs it in (again): a new terminal under the same path.
    pub fn plug(&mut self) -> io::Result<()> {
        self.unplug();
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let name = ptsname(&master, Vec::new())?;
        rustix::fs::fcntl_setfl(&master, OFlags::RDWR | OFlags::NONBLOCK)?;
        // Made beside it and moved over it, so that the path is never half there.
        let fresh = self.link.with_extension("new");
        let _ = std::fs::remove_file(&fresh);
        std::os::unix::fs::symlink(name.to_string_lossy().as_ref(), &fresh)?;
        std::fs::rename(&fresh, &self.link)?;
        self.line.lock().unwrap_or_else(PoisonError::into_inner).plug(true);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (stop, stopped) = oneshot::channel();
        let (line, promote) = (self.line.clone(), self.promote.clone());
        let thread = std::thread::Builder::new().name("sim-serial".to_owned()).spawn(move || {
            promote();
            runtime.block_on(async {
                if let Either::Left((Err(error), _)) = select(pin!(serve(master, &line)), stopped).await {
                    tracing::error!("the simulated serial line has failed: {error}");
                }
            });
        })?;
        self.serving = Some((stop, thread));
        Ok(())
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// Moves bytes between the terminal and the line for ever.
async fn serve(master: OwnedFd, line: &Mutex<SerialLine>) -> io::Result<()> {
    let clock = Clock::Live;
    let writer = master.try_clone()?;
    // The terminal's master end, non-blocking, does all that is asked of a pipe's reading end.
    let reader = Receiver::from_owned_fd_unchecked(master)?;
    let lock = || line.lock().unwrap_or_else(PoisonError::into_inner);
    let mut bytes = [0; 256];
    loop {
        let now = clock.now();
        let out = lock().take(now, bytes.len());
        let mut rest = &out[..];
        while !rest.is_empty() {
            match rustix::io::write(&writer, rest) {
                Ok(count) => rest = &rest[count..],
                // Nobody reads: a serial line does not wait, the bytes are lost.
                Err(Errno::AGAIN | Errno::IO) => break,
                Err(error) => return Err(error.into()),
            }
        }
        let next = lock().next_ready().unwrap_or(now + IDLE);
        match select(pin!(reader.readable()), pin!(clock.sleep_until(next))).await {
            Either::Left((ready, _)) => ready?,
            Either::Right(_) => continue,
        }
        match reader.try_read(&mut bytes) {
            Ok(count) if count > 0 => lock().receive(&bytes[..count], clock.now()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            // The other end is not open.
            Ok(_) => clock.sleep(CLOSED_POLL).await,
            Err(error) if Errno::from_io_error(&error) == Some(Errno::IO) => clock.sleep(CLOSED_POLL).await,
            Err(error) => return Err(error),
        }
    }
}

//! One freerig owns a rig at a time: the daemon, or a command that opens its buses.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::DaemonError;
use crate::clock::Clock;

/// How often a lock that somebody else holds is tried.
const RETRY: Duration = Duration::from_millis(50);

/// The ownership of a rig, until it is dropped or its process ends, however it ends. The file stays: taking it away
/// would let two owners lock two files of one name.
#[derive(Debug)]
pub struct RigLock {
    _file: File,
}

impl RigLock {
    /// Takes the rig whose control socket is, or would be, at `socket`; an owner that is just leaving is waited for
    /// as long as `patience`.
    ///
    /// # Errors
    /// [`DaemonError::Owned`] where somebody else owns it, [`DaemonError::Io`] where the file cannot be opened.
    pub fn take(socket: &Path, patience: Duration) -> Result<Self, DaemonError> {
        let path = lock_path(socket);
        let failed =
            |error| DaemonError::Io { what: format!("the rig's lock {} cannot be taken", path.display()), error };
        let file = open(&path).map_err(failed)?;
        let clock = Clock::Live;
        let end = clock.now() + patience;
        loop {
            match file.try_lock() {
                Ok(()) => return Ok(Self { _file: file }),
                Err(TryLockError::Error(error)) => return Err(failed(error)),
                Err(TryLockError::WouldBlock) if clock.now() >= end => return Err(DaemonError::Owned(path)),
                Err(TryLockError::WouldBlock) => clock.block_until(clock.now() + RETRY),
            }
        }
    }
}

/// The lock's file, beside the control socket.
fn lock_path(socket: &Path) -> PathBuf {
    let mut name = socket.as_os_str().to_owned();
    name.push(".lock");
    name.into()
}

/// Opens `path`, which somebody else may have made: to lock it, reading is enough.
fn open(path: &Path) -> io::Result<File> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    match OpenOptions::new().write(true).create(true).truncate(false).open(path) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied && path.exists() => File::open(path),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rig_has_one_owner_and_is_free_when_that_has_gone() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("deep/control.sock");
        let owner = RigLock::take(&socket, Duration::ZERO).unwrap();
        let refused = RigLock::take(&socket, Duration::from_millis(1)).unwrap_err();
        assert!(matches!(&refused, DaemonError::Owned(path) if path.ends_with("control.sock.lock")), "{refused}");
        drop(owner);
        RigLock::take(&socket, Duration::ZERO).unwrap();
    }
}

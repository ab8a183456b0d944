//! One freerig owns a rig at a time: the daemon, or a command that opens its buses.
//!
//! Two locks, of different kinds: a file beside the control socket is the rig's, by its rig.toml, simulated or not; a
//! socket in the abstract namespace is that of each device file, so that a second rig.toml with a control socket of its
//! own does not command the same bus. The latter needs no rights and keeps no device file open, which an adapter that
//! is pulled and plugged in again would not survive.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::DaemonError;
use crate::clock::Clock;
use crate::config::Rig;

/// Bytes of a device file's name, from its end, that fit into a lock's.
const NAME: usize = 90;
/// How often a lock that somebody else holds is tried.
const RETRY: Duration = Duration::from_millis(50);

/// The ownership of a rig, until it is dropped or its process ends, however it ends. The file stays: taking it away
/// would let two owners lock two files of one name.
#[derive(Debug)]
pub struct RigLock {
    _file: File,
    _devices: Vec<UnixListener>,
}

impl RigLock {
    /// Takes the rig whose control socket is, or would be, where `rig` says, and its devices; an owner that is just
    /// leaving is waited for as long as `patience`.
    ///
    /// # Errors
    /// [`DaemonError::Owned`] where somebody else owns it or one of its devices, [`DaemonError::Io`] where the file
    /// cannot be opened.
    pub fn take(rig: &Rig, patience: Duration) -> Result<Self, DaemonError> {
        let path = lock_path(&rig.socket.path);
        let file = open(&path).map_err(|error| failed(&path, error))?;
        let clock = Clock::Live;
        let end = clock.now() + patience;
        loop {
            let taken = match file.try_lock() {
                Ok(()) => Ok(()),
                Err(TryLockError::WouldBlock) => Err(DaemonError::Owned(path.clone())),
                Err(TryLockError::Error(error)) => Err(failed(&path, error)),
            };
            match taken.and_then(|()| devices(rig)) {
                Ok(devices) => return Ok(Self { _file: file, _devices: devices }),
                Err(DaemonError::Owned(_)) if clock.now() < end => clock.block_until(clock.now() + RETRY),
                Err(error) => return Err(error),
            }
        }
    }
}

fn failed(path: &Path, error: io::Error) -> DaemonError {
    DaemonError::Io { what: format!("the rig's lock {} cannot be taken", path.display()), error }
}

/// The locks of the device files of `rig`; a simulated one has none.
fn devices(rig: &Rig) -> Result<Vec<UnixListener>, DaemonError> {
    if rig.is_simulated() {
        return Ok(Vec::new());
    }
    let wiring = &rig.wiring;
    let buses = wiring.i2c.iter().map(|bus| &bus.device).chain(wiring.serial.iter().map(|line| &line.device));
    let lock = |device: &PathBuf| {
        // One device has many names in /dev, as long as it is there.
        let known = std::fs::canonicalize(device).unwrap_or_else(|_| device.clone());
        let bytes = known.as_os_str().as_bytes();
        let name = [b"freerig:", &bytes[bytes.len().saturating_sub(NAME)..]].concat();
        let listener = SocketAddr::from_abstract_name(name).and_then(|address| UnixListener::bind_addr(&address));
        listener.map_err(|error| match error.kind() {
            io::ErrorKind::AddrInUse => DaemonError::Owned(known),
            _ => failed(&known, error),
        })
    };
    buses.chain(wiring.gpio.iter().map(|gpio| &gpio.chip)).map(lock).collect()
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
    use crate::config::Backend;

    /// The example rig with its control socket at `socket`, simulated or on the devices of `folder`.
    fn rig(socket: &Path, backend: Backend, folder: &Path) -> Rig {
        let mut rig = Rig::load(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/rig.toml"))).unwrap();
        rig.socket.path = socket.into();
        rig.backend = backend;
        rig.wiring.i2c[0].device = folder.join("i2c");
        rig.wiring.serial[0].device = folder.join("by-id");
        rig
    }

    #[test]
    fn a_rig_has_one_owner_and_is_free_when_that_has_gone() {
        let folder = tempfile::tempdir().unwrap();
        let rig = rig(&folder.path().join("deep/control.sock"), Backend::Sim, folder.path());
        let owner = RigLock::take(&rig, Duration::ZERO).unwrap();
        let refused = RigLock::take(&rig, Duration::from_millis(1)).unwrap_err();
        assert!(matches!(&refused, DaemonError::Owned(path) if path.ends_with("control.sock.lock")), "{refused}");
        drop(owner);
        RigLock::take(&rig, Duration::ZERO).unwrap();
    }

    #[test]
    fn a_second_description_of_the_same_devices_is_refused_whatever_it_calls_them() {
        let folder = tempfile::tempdir().unwrap();
        let [first, second, simulated] = ["a", "b", "c"].map(|name| folder.path().join(name));
        std::fs::write(folder.path().join("tty"), "").unwrap();
        std::os::unix::fs::symlink("tty", folder.path().join("by-id")).unwrap();
        let owner = RigLock::take(&rig(&first, Backend::Linux, folder.path()), Duration::ZERO).unwrap();
        let mut other = rig(&second, Backend::Linux, folder.path());
        other.wiring.i2c[0].device = folder.path().join("another");
        other.wiring.serial[0].device = folder.path().join("tty");
        let refused = RigLock::take(&other, Duration::from_millis(1)).unwrap_err();
        assert!(matches!(&refused, DaemonError::Owned(path) if path.ends_with("tty")), "{refused}");
        RigLock::take(&rig(&simulated, Backend::Sim, folder.path()), Duration::ZERO).unwrap();
        drop(owner);
        RigLock::take(&other, Duration::ZERO).unwrap();
    }
}

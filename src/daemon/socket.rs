//! Socket files: who may open them, how they come and go.

use std::io;
use std::os::unix::fs::{FileTypeExt, PermissionsExt, chown};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a socket could not be opened.
#[derive(Debug, Error)]
pub enum SocketError {
    /// Another daemon answers there.
    #[error("another freerig daemon answers at {0}: stop it first (`freerig status` shows what it does)")]
    InUse(PathBuf),
    /// Something that is not a socket is in the way.
    #[error("{0} is in the way and is no socket: remove it, or write another `path` under [socket] in rig.toml")]
    InTheWay(PathBuf),
    /// There is no such group.
    #[error("there is no group `{0}`: create it (`groupadd {0}`), or write another `group` under [socket] in rig.toml")]
    NoGroup(String),
    /// The system refused.
    #[error("the socket {path} could not be opened: {error}")]
    Io {
        /// The socket.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
}

/// Who is at the other end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its user.
    pub uid: u32,
    /// Its primary group.
    pub gid: u32,
}

/// Who may control the rig: the daemon's own user, root, and the members of one group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    users: Vec<u32>,
    group: Option<u32>,
}

impl Access {
    /// Access for the user of this process, root, and the members of `group`.
    ///
    /// # Errors
    ///
    /// [`SocketError::NoGroup`].
    pub fn new(group: Option<&str>) -> Result<Self, SocketError> {
        let id = |name: &str| {
            uzers::get_group_by_name(name).map(|g| g.gid()).ok_or_else(|| SocketError::NoGroup(name.into()))
        };
        Ok(Self { users: vec![uzers::get_effective_uid(), 0], group: group.map(id).transpose()? })
    }

    /// Whether `peer` may control the rig. Looks into the user database, which may take its time.
    pub fn allows(&self, peer: Peer) -> bool {
        let member = |group: u32| {
            peer.gid == group
                || uzers::get_user_by_uid(peer.uid)
                    .and_then(|user| uzers::get_user_groups(user.name(), user.primary_group_id()))
                    .is_some_and(|groups| groups.iter().any(|g| g.gid() == group))
        };
        self.users.contains(&peer.uid) || self.group.is_some_and(member)
    }

    #[cfg(test)]
    pub(super) fn nobody() -> Self {
        Self { users: Vec::new(), group: None }
    }
}

/// A socket's file; it goes when this is dropped.
#[derive(Debug)]
pub struct SocketFile(PathBuf);

impl SocketFile {
    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // A file that stays behind is recognised as stale by the next daemon.
        std::fs::remove_file(&self.0).ok();
    }
}

/// Whether `path` is free: nothing there, or the socket of a daemon that is gone. Connects to find out.
///
/// # Errors
///
/// [`SocketError::InUse`], [`SocketError::InTheWay`].
pub fn check_free(path: &Path) -> Result<(), SocketError> {
    match std::fs::symlink_metadata(path) {
        Err(_) => Ok(()),
        Ok(file) if !file.file_type().is_socket() => Err(SocketError::InTheWay(path.into())),
        Ok(_) if UnixStream::connect(path).is_ok() => Err(SocketError::InUse(path.into())),
        Ok(_) => Ok(()),
    }
}

/// Listens at `path` with mode 0660 and the group of `access`, replacing a stale file. The file appears with its
/// final rights in one step: there is no moment in which somebody else could connect.
///
/// # Errors
///
/// [`SocketError::Io`].
pub fn listen(path: &Path, access: &Access) -> Result<(UnixListener, SocketFile), SocketError> {
    let open = || {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let new = with_suffix(path, ".new");
        match std::fs::remove_file(&new) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(&new)?;
        let file = SocketFile(new);
        chown(file.path(), None, access.group)?;
        std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(0o660))?;
        std::fs::rename(file.path(), path)?;
        Ok((listener, SocketFile(path.into())))
    };
    open().map_err(|error| SocketError::Io { path: path.into(), error })
}

/// Socket of the emergency stop beside the control socket at `path`.
pub fn estop_path(path: &Path) -> PathBuf {
    with_suffix(path, ".estop")
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_owner_root_and_the_group_have_access_and_nobody_else() {
        let access = Access { users: vec![4_000_000_001, 0], group: Some(4_000_000_002) };
        for (uid, gid, allowed) in [
            (4_000_000_001, 9, true),
            (0, 9, true),
            (4_000_000_003, 4_000_000_002, true),
            (4_000_000_003, 9, false),
            (4_000_000_002, 4_000_000_001, false),
        ] {
            assert_eq!(access.allows(Peer { uid, gid }), allowed, "uid {uid} gid {gid}");
        }
        assert!(matches!(Access::new(Some("no-such-group-here")), Err(SocketError::NoGroup(_))));
    }

    #[test]
    fn the_file_goes_with_its_owner_and_a_stale_one_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/control.sock");
        let access = Access::new(None).unwrap();
        let (listener, file) = listen(&path, &access).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
        assert!(matches!(check_free(&path), Err(SocketError::InUse(_))));
        drop(listener);
        // As after a kill: the file is there, and nobody listens.
        check_free(&path).unwrap();
        std::mem::forget(file);
        let (_listener, file) = listen(&path, &access).unwrap();
        drop(file);
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 0);

        std::fs::write(&path, "precious").unwrap();
        assert!(matches!(check_free(&path), Err(SocketError::InTheWay(_))));
    }
}

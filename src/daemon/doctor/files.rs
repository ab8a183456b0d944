//! Where the rig writes and is spoken to: runs, calibrations, the control socket.

use std::io;
use std::path::{Path, PathBuf};

use super::Finding;
use crate::config::Rig;
use crate::daemon::socket::{Access, SocketError, check_free};

/// Below it an afternoon of experiments may fill the disk, bytes.
const LITTLE_SPACE: u64 = 2 << 30;
/// Below it no run should begin, bytes.
const NO_SPACE: u64 = 100 << 20;

pub(super) fn look(rig: &Rig, tell: &mut dyn FnMut(Finding)) {
    let runs = absolute(&rig.record.directory);
    tell(writable("runs", &runs, "correct `directory` under [record] in rig.toml, or give this user the folder"));
    if let Some(finding) = space(&runs) {
        tell(finding);
    }
    tell(writable(
        "calibrations",
        &absolute(&rig.calibration_directory),
        "correct `calibration_directory` in rig.toml, or give this user the folder: the program writes what it measures there",
    ));
    tell(socket(rig));
}

fn socket(rig: &Rig) -> Finding {
    let path = &rig.socket.path;
    let shown = path.display();
    match check_free(path).and_then(|()| Access::new(rig.socket.group.as_deref())) {
        Err(SocketError::InUse(_)) => Finding::ok("socket", format!("{shown}: a daemon answers")),
        Err(error) => {
            // The message brings its remedy, behind the colon.
            let text = error.to_string();
            let (found, remedy) = text.rsplit_once(": ").unwrap_or((&text, "correct [socket] in rig.toml"));
            Finding::fail("socket", found, remedy)
        }
        Ok(_) => {
            let folder = path.parent().map_or_else(|| absolute(Path::new("")), absolute);
            Finding {
                found: format!("{shown}: no daemon answers"),
                ..writable("socket", &folder, "correct `path` under [socket] in rig.toml, or give this user the folder")
            }
        }
    }
}

/// Whether this user can write in `folder`, or make it.
fn writable(subject: &str, folder: &Path, remedy: &str) -> Finding {
    let existing = nearest(folder);
    let shown = folder.display();
    match tempfile::Builder::new().prefix(".freerig-doctor-").tempfile_in(&existing) {
        Ok(_) if existing == folder => Finding::ok(subject, format!("{shown} is writable")),
        Ok(_) => Finding::ok(subject, format!("{shown} can be made")),
        Err(error) => Finding::fail(subject, format!("{shown} is not writable: {}", error.kind()), remedy),
    }
}

fn space(folder: &Path) -> Option<Finding> {
    let existing = nearest(folder);
    let free = match rustix::fs::statvfs(&existing) {
        Ok(disk) => disk.f_bavail.saturating_mul(disk.f_frsize),
        Err(error) => {
            let found = format!("{}: {error}", existing.display());
            return Some(Finding::warn("disk", found, "look at the disk (`df`)"));
        }
    };
    let found = format!("{:.1} GiB free for runs", free as f64 / f64::from(1 << 30));
    let remedy = "delete old runs (`freerig runs` lists them), or write another `directory` under [record]";
    Some(match free {
        ..NO_SPACE => Finding::fail("disk", found, remedy),
        NO_SPACE..LITTLE_SPACE => Finding::warn("disk", found, remedy),
        _ => Finding::ok("disk", found),
    })
}

/// The folder, or the nearest above it that there is.
fn nearest(folder: &Path) -> PathBuf {
    folder.ancestors().find(|f| f.is_dir()).unwrap_or(Path::new("/")).to_owned()
}

fn absolute(path: &Path) -> PathBuf {
    let here = || -> io::Result<PathBuf> { Ok(std::env::current_dir()?.join(path)) };
    here().unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::super::Level;
    use super::*;

    #[test]
    fn a_folder_that_is_not_there_yet_is_fine_where_it_can_be_made() {
        let root = tempfile::tempdir().unwrap();
        assert_eq!(writable("runs", root.path(), "").level, Level::Ok);
        let finding = writable("runs", &root.path().join("a/b"), "");
        assert!(finding.level == Level::Ok && finding.found.ends_with("can be made"), "{finding}");
        assert!(!root.path().join("a").exists(), "looking leaves nothing behind");
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_in_which_nobody_can_write_fails_with_its_remedy() {
        let finding = writable("runs", Path::new("/proc/freerig"), "another folder");
        assert_eq!(
            (finding.level, finding.remedy.as_deref()),
            (Level::Fail, Some("another folder")),
            "{}",
            finding.found
        );
    }
}

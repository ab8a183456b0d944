//! How much room the runs may take: before a run begins, the oldest make way for it.

use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use super::run::Run;
use super::{RecordError, Result};

/// A run without a stop document that something was written to so lately may still be in progress.
const IN_PROGRESS: Duration = Duration::from_secs(600);

/// The room for runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quota {
    /// Most that the runs may take together, bytes; `None` where no run is ever removed.
    pub most: Option<u64>,
    /// Least that must be free on their disk, bytes.
    pub free: u64,
}

impl Quota {
    /// Makes room in `runs` for another run: removes the oldest until they take no more than [`Quota::most`] and
    /// [`Quota::free`] bytes are free. Never one that may be in progress, and nothing but whole runs. Answers the ids
    /// of those removed.
    ///
    /// # Errors
    /// [`RecordError::NoRoom`] where too little is free all the same; a folder that cannot be read or removed.
    pub fn make_room(self, runs: &Path) -> Result<Vec<String>> {
        fs::create_dir_all(runs).map_err(RecordError::io(runs))?;
        let mut removed = Vec::new();
        if let Some(most) = self.most {
            let mut kept = Vec::new();
            for run in Run::list(runs)?.into_iter().flatten() {
                let size = size(&run.folder).map_err(RecordError::io(&run.folder))?;
                kept.push((run, size));
            }
            let mut total: u64 = kept.iter().map(|(_, size)| size).sum();
            // They come oldest first.
            for (run, size) in &kept {
                if total <= most && free(runs)? >= self.free {
                    break;
                }
                if !may_be_in_progress(run) {
                    fs::remove_dir_all(&run.folder).map_err(RecordError::io(&run.folder))?;
                    total -= size;
                    removed.push(run.id().to_owned());
                }
            }
        }
        let free = free(runs)?;
        if free < self.free {
            return Err(RecordError::NoRoom { folder: runs.into(), free, floor: self.free });
        }
        Ok(removed)
    }
}

/// Bytes that this user may still write on the disk of `folder`.
fn free(folder: &Path) -> Result<u64> {
    let disk = rustix::fs::statvfs(folder).map_err(|error| RecordError::io(folder)(error.into()))?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Bytes of the files in a run's folder, which has no others below it.
fn size(folder: &Path) -> std::io::Result<u64> {
    fs::read_dir(folder)?.map(|entry| Ok(entry?.metadata()?.len())).sum()
}

fn may_be_in_progress(run: &Run) -> bool {
    let written = |entry: fs::DirEntry| entry.metadata().and_then(|file| file.modified()).ok();
    let latest = fs::read_dir(&run.folder).ok().and_then(|files| files.flatten().filter_map(written).max());
    // A clock that was set back makes it younger, never older.
    let quiet = latest.and_then(|latest| SystemTime::now().duration_since(latest).ok()).unwrap_or_default();
    !run.is_complete() && quiet < IN_PROGRESS
}

#[cfg(test)]
mod tests {
    use super::super::document::{StartDocument, StopDocument};
    use super::*;

    const SIZE: u64 = 100_000;

    /// A run of a little more than [`SIZE`] bytes.
    fn run(runs: &Path, complete: bool) -> Run {
        let mut run = Run::create(runs, StartDocument::default()).unwrap();
        fs::write(run.folder.join("samples"), vec![0; SIZE as usize]).unwrap();
        if complete {
            run.document.stop = Some(StopDocument::default());
            run.write_document().unwrap();
        }
        run
    }

    #[test]
    fn the_oldest_make_way_but_none_in_progress_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let runs = folder.path();
        let running = run(runs, false);
        let [first, second, third] = [(); 3].map(|()| run(runs, true));
        fs::write(runs.join("cycles.toml"), "").unwrap();
        fs::create_dir(runs.join("notes")).unwrap();

        assert_eq!(Quota { most: None, free: 0 }.make_room(runs).unwrap(), Vec::<String>::new());
        assert_eq!(Quota { most: Some(u64::MAX), free: 0 }.make_room(runs).unwrap(), Vec::<String>::new());
        // Room for three of the four, and for what their documents take.
        let removed = Quota { most: Some(3 * SIZE + SIZE / 2), free: 0 }.make_room(runs).unwrap();
        assert_eq!(removed, [first.id()]);
        let removed = Quota { most: Some(0), free: 0 }.make_room(runs).unwrap();
        assert_eq!(removed, [second.id(), third.id()]);
        assert!(running.folder.exists() && runs.join("cycles.toml").exists() && runs.join("notes").exists());

        // What was killed long ago is no longer in progress.
        let long_ago = SystemTime::now() - 2 * IN_PROGRESS;
        for file in fs::read_dir(&running.folder).unwrap() {
            fs::File::options().write(true).open(file.unwrap().path()).unwrap().set_modified(long_ago).unwrap();
        }
        assert_eq!(Quota { most: Some(0), free: 0 }.make_room(runs).unwrap(), [running.id()]);
    }

    #[test]
    fn a_disk_that_is_too_full_refuses_the_run_and_says_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let kept = run(folder.path(), true);
        let error = Quota { most: None, free: u64::MAX }.make_room(folder.path()).unwrap_err();
        assert!(matches!(error, RecordError::NoRoom { floor: u64::MAX, .. }), "{error}");
        assert!(error.to_string().contains("delete old runs"), "{error}");
        assert!(kept.folder.exists(), "nothing is removed that may not be");
        Quota { most: Some(u64::MAX), free: u64::MAX }.make_room(folder.path()).unwrap_err();
        assert!(!kept.folder.exists(), "with a quota the oldest make way first");
    }
}

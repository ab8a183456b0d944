//! The folder of a run, `runs/ID/`: made at once with its start document in it, found again by id or path.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use jiff::Zoned;

use super::document::{ErrorDocument, FORMAT, RunDocument, StartDocument, StopDocument};
use super::metrics;
use super::samples::{Records, Table, Tables};
use super::{RecordError, Result};
use crate::config::distance;

/// Name of the start and stop document.
pub const DOCUMENT_NAME: &str = "run.toml";
/// Name of rerun's file.
pub const RRD_NAME: &str = "run.rrd";
/// Name of the report.
pub const REPORT_NAME: &str = "report.html";

/// What stands for the latest run.
const LATEST: &str = "latest";
/// How many ids an error names.
const NAMED: usize = 5;

/// A recorded run: its folder and its documents.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Its folder.
    pub folder: PathBuf,
    /// What `run.toml` says.
    pub document: RunDocument,
}

impl Run {
    /// Makes the folder of a new run in `runs` (made if need be) with its start document in it; `start.id`,
    /// `start.started`, `start.kernel` and `start.host` are filled in where they are empty.
    ///
    /// A folder appears under its id only when it is complete, so a run is never without its start document.
    ///
    /// # Errors
    /// Where the folder cannot be made.
    pub fn create(runs: &Path, mut start: StartDocument) -> Result<Self> {
        fs::create_dir_all(runs).map_err(RecordError::io(runs))?;
        let mut now = Zoned::now();
        if start.started.is_empty() {
            start.started = rfc3339(&now);
        }
        if start.kernel.is_empty() {
            let uname = rustix::system::uname();
            start.kernel = format!(
                "{} {} {}",
                uname.sysname().to_string_lossy(),
                uname.release().to_string_lossy(),
                uname.version().to_string_lossy()
            );
            start.host = uname.nodename().to_string_lossy().into_owned();
        }
        let mut document = RunDocument { format: FORMAT, start, stop: None };
        loop {
            document.start.id = new_id(&now, &document.start);
            let folder = runs.join(&document.start.id);
            let hidden = tempfile::Builder::new().prefix(".new-").tempdir_in(runs).map_err(RecordError::io(runs))?;
            let run = Run { folder: hidden.path().to_owned(), document };
            run.write_document()?;
            // Readable by whoever may read runs/, as any other folder there.
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                let _ = fs::set_permissions(hidden.path(), fs::Permissions::from_mode(0o755));
            }
            match fs::rename(hidden.path(), &folder) {
                Ok(()) => {
                    let _ = hidden.keep();
                    return Ok(Run { folder, ..run });
                }
                // Somebody else has this very millisecond: take a later one.
                Err(e)
                    if matches!(
                        e.kind(),
                        std::io::ErrorKind::DirectoryNotEmpty | std::io::ErrorKind::AlreadyExists
                    ) =>
                {
                    document = run.document;
                    now = Zoned::now();
                }
                Err(e) => return Err(RecordError::Io { path: folder, source: e }),
            }
        }
    }

    /// Opens the run in `folder`.
    ///
    /// # Errors
    /// Where there is no `run.toml`, or none that this version understands.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(DOCUMENT_NAME);
        let text = fs::read_to_string(&path).map_err(RecordError::io(&path))?;
        let document: RunDocument =
            toml::from_str(&text).map_err(|e| RecordError::Document { path: path.clone(), reason: e.to_string() })?;
        if document.format > FORMAT {
            let reason = format!(
                "it has format {}, this version of freerig knows {FORMAT}; read it with the version that wrote it ({})",
                document.format, document.start.freerig_version
            );
            return Err(RecordError::Document { path, reason });
        }
        Ok(Run { folder: folder.to_owned(), document })
    }

    /// Finds the run `wanted`: a path, an id in `runs`, the beginning of an id, or `latest`.
    ///
    /// # Errors
    /// Where there is none (the nearest and the latest are named), or where several ids begin so.
    pub fn find(runs: &Path, wanted: &str) -> Result<Self> {
        let path = Path::new(wanted);
        if path.join(DOCUMENT_NAME).is_file() {
            return Self::open(path);
        }
        let ids = ids(runs)?;
        let none = || RecordError::NoSuchRun {
            wanted: wanted.into(),
            folder: runs.into(),
            nearest: nearest(wanted, &ids).cloned(),
            latest: ids.iter().rev().take(NAMED).cloned().collect(),
            count: ids.len(),
        };
        if wanted == LATEST {
            return Self::open(&runs.join(ids.last().ok_or_else(none)?));
        }
        let begin: Vec<&String> = ids.iter().filter(|id| id.starts_with(wanted)).collect();
        match begin.as_slice() {
            _ if wanted.is_empty() => Err(none()),
            [] => Err(none()),
            [id] => Self::open(&runs.join(id)),
            _ if begin.iter().any(|id| *id == wanted) => Self::open(&runs.join(wanted)),
            _ => {
                let (count, latest) = (begin.len(), begin.iter().rev().take(NAMED).map(|id| (*id).clone()).collect());
                Err(RecordError::Ambiguous { wanted: wanted.into(), latest, count })
            }
        }
    }

    /// Every run in `runs`, oldest first; those that cannot be read come with their error.
    ///
    /// # Errors
    /// Where the folder cannot be read; a folder that does not exist has no runs.
    pub fn list(runs: &Path) -> Result<Vec<Result<Self>>> {
        Ok(ids(runs)?.into_iter().map(|id| Self::open(&runs.join(id))).collect())
    }

    /// Its id.
    pub fn id(&self) -> &str {
        &self.document.start.id
    }

    /// The start document.
    pub fn start(&self) -> &StartDocument {
        &self.document.start
    }

    /// The stop document; `None` where the run was killed.
    pub fn stop(&self) -> Option<&StopDocument> {
        self.document.stop.as_ref()
    }

    /// Whether the run has its stop document.
    pub fn is_complete(&self) -> bool {
        self.document.stop.is_some()
    }

    /// `done`, `failed`, `aborted`, `fault` or `incomplete`.
    pub fn result_name(&self) -> &'static str {
        self.stop().map_or("incomplete", |s| s.result.name())
    }

    /// Names of the FREEs, in the order of rig.toml.
    pub fn names(&self) -> Vec<String> {
        self.start().frees.iter().map(|f| f.name.clone()).collect()
    }

    /// The records, bit for bit as they were recorded, up to the last whole batch.
    ///
    /// # Errors
    /// Where the samples cannot be read, or are of another version.
    pub fn records(&self) -> Result<Records> {
        Records::open(&self.folder, &self.names())
    }

    /// Some columns as numbers; those that the run lacks are left out.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn table(&self, names: &[String]) -> Result<Table> {
        self.tables(names)?.whole()
    }

    /// The same, piece by piece.
    ///
    /// # Errors
    /// Where the samples cannot be read at all.
    pub fn tables(&self, names: &[String]) -> Result<Tables> {
        Tables::open(&self.folder, names)
    }

    /// Tracking errors of the FREEs that were given an angle: from the stop document, of an incomplete run from what
    /// was recorded; none where that cannot be read.
    pub fn errors(&self) -> Vec<ErrorDocument> {
        match self.stop() {
            Some(stop) => stop.errors.clone(),
            None => metrics::errors(self).unwrap_or_default(),
        }
    }

    /// Writes `run.toml` so that either the old or the new one is there, whole.
    pub(super) fn write_document(&self) -> Result<()> {
        let path = self.folder.join(DOCUMENT_NAME);
        let text = toml::to_string(&self.document)
            .map_err(|e| RecordError::Document { path: path.clone(), reason: e.to_string() })?;
        write_atomically(&path, text.as_bytes())
    }
}

/// Replaces `path` by `bytes`: temporary file, fsync, rename, fsync of the folder.
pub(super) fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new()
        .prefix(".tmp-")
        .permissions(permissions())
        .tempfile_in(folder)
        .map_err(RecordError::io(folder))?;
    file.write_all(bytes).map_err(RecordError::io(path))?;
    file.as_file().sync_all().map_err(RecordError::io(path))?;
    file.persist(path).map_err(|e| RecordError::Io { path: path.into(), source: e.error })?;
    fs::File::open(folder).and_then(|f| f.sync_all()).map_err(RecordError::io(folder))
}

/// Readable by whoever may read the folder.
pub(super) fn permissions() -> fs::Permissions {
    use std::os::unix::fs::PermissionsExt;
    fs::Permissions::from_mode(0o644)
}

/// The present time, RFC 3339 with the zone's offset.
pub(super) fn now() -> String {
    rfc3339(&Zoned::now())
}

fn rfc3339(time: &Zoned) -> String {
    time.strftime("%Y-%m-%dT%H:%M:%S%.3f%:z").to_string()
}

/// `20260314-151500.123-step-paper`: sorts by time (UTC, to the millisecond), and says what it is.
fn new_id(now: &Zoned, start: &StartDocument) -> String {
    let time = now.with_time_zone(jiff::tz::TimeZone::UTC).strftime("%Y%m%d-%H%M%S%.3f").to_string();
    let subject: String =
        start.subject.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' }).collect();
    let subject = if subject.is_empty() { "all".into() } else { subject };
    format!("{time}-{}-{subject}", start.kind.name())
}

/// The id that `wanted` was most likely meant to be or to begin; `None` where nothing is near.
fn nearest<'a>(wanted: &str, ids: &'a [String]) -> Option<&'a String> {
    let length = wanted.chars().count();
    let edits = |id: &String| {
        let beginning: String = id.chars().take(length).collect();
        distance(wanted, id).min(distance(wanted, &beginning))
    };
    // Of equally near ones the latest.
    let (edits, id) = ids.iter().map(|id| (edits(id), id)).min_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(a.1)))?;
    (edits <= 1 + length / 3).then_some(id)
}

/// Ids of the runs in `runs`, sorted.
fn ids(runs: &Path) -> Result<Vec<String>> {
    let entries = match fs::read_dir(runs) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(e) => return Err(RecordError::Io { path: runs.into(), source: e }),
    };
    let mut ids: Vec<String> = entries
        .filter_map(|e| e.ok()?.file_name().into_string().ok())
        .filter(|name| !name.starts_with('.') && runs.join(name).join(DOCUMENT_NAME).is_file())
        .collect();
    ids.sort();
    Ok(ids)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_found_by_id_beginning_path_and_latest() {
        let runs = tempfile::tempdir().unwrap();
        let start = |subject: &str| StartDocument { subject: subject.into(), ..StartDocument::default() };
        let a = Run::create(runs.path(), start("a/../b")).unwrap();
        let b = Run::create(runs.path(), start("paper")).unwrap();
        assert_ne!(a.id(), b.id());
        assert!(!a.id().contains('/') && !a.id().contains(".."), "{}", a.id());
        assert_eq!(Run::find(runs.path(), a.id()).unwrap(), a);
        assert_eq!(Run::find(runs.path(), b.folder.to_str().unwrap()).unwrap(), b);
        assert!(matches!(Run::find(runs.path(), "20"), Err(RecordError::Ambiguous { .. })));
        assert!(matches!(Run::find(runs.path(), ""), Err(RecordError::NoSuchRun { .. })));
        assert!(matches!(Run::find(runs.path(), "1999"), Err(RecordError::NoSuchRun { .. })));
        assert_eq!(Run::list(runs.path()).unwrap().len(), 2);
        assert_eq!(Run::find(runs.path(), "latest").unwrap(), b);
        let typo = b.id().replace("paper", "paepr");
        let error = Run::find(runs.path(), &typo).unwrap_err().to_string();
        assert!(error.contains(&format!("did you mean `{}`?", b.id())), "{error}");
        assert!(error.contains(a.id()) && error.contains(runs.path().to_str().unwrap()), "{error}");
        let error = Run::find(runs.path(), "nonsense").unwrap_err().to_string();
        assert!(!error.contains("did you mean"), "{error}");
        assert!(!b.is_complete());
        assert_eq!(b.result_name(), "incomplete");
    }

    #[test]
    fn no_folder_has_no_runs() {
        assert!(Run::list(Path::new("/nonexistent/runs")).unwrap().is_empty());
    }
}

//! What can go wrong with a record, each with what to do about it.

use std::path::{Path, PathBuf};

use arrow::error::ArrowError;
use thiserror::Error;

/// Errors of the floor `record`.
#[derive(Debug, Error)]
pub enum RecordError {
    /// A file could not be read or written.
    #[error("{path}: {source}{remedy}", path = path.display(), remedy = remedy(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The samples could not be written or read.
    #[error("{path}: {source}{remedy}", path = path.display(), remedy = arrow_remedy(source))]
    Samples {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: ArrowError,
    },
    /// The recording could not be carried on.
    #[error("{path}: the recording ended before its time; what was written until then can be read", path = path.display())]
    Broken {
        /// The run's folder.
        path: PathBuf,
    },
    /// The file of samples ends before the first one.
    #[error("{path}: the run was cut off before its first sample ({reason})", path = path.display())]
    NoSamples {
        /// The file.
        path: PathBuf,
        /// What the reader said.
        reason: String,
    },
    /// The columns are not those of this version.
    #[error(
        "{path}: its columns are those of another version of freerig; `freerig export` and `report` read what \
         they know, a replay needs the version that recorded it", path = path.display()
    )]
    OtherColumns {
        /// The file.
        path: PathBuf,
    },
    /// run.toml could not be understood.
    #[error("{path}: {reason}", path = path.display())]
    Document {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The disk is too full for another run.
    #[error(
        "{}: {} MiB are free, {} must be ([record] free_mib): delete old runs (`freerig runs` lists them), or have \
         `runs_mib` under [record] remove the oldest", .folder.display(), .free >> 20, .floor >> 20
    )]
    NoRoom {
        /// Folder of the runs.
        folder: PathBuf,
        /// Bytes that are free.
        free: u64,
        /// Bytes that must be.
        floor: u64,
    },
    /// There is no such run.
    #[error("no run `{wanted}` in {folder}{}", there(.nearest.as_deref(), .latest, *.count), folder = folder.display())]
    NoSuchRun {
        /// What was asked for.
        wanted: String,
        /// Where it was looked for.
        folder: PathBuf,
        /// Which one may have been meant.
        nearest: Option<String>,
        /// Ids of the latest there.
        latest: Vec<String>,
        /// How many are there.
        count: usize,
    },
    /// Several runs begin so.
    #[error("`{wanted}` begins the ids of {count} runs, among them {}; write more of it", .latest.join(", "))]
    Ambiguous {
        /// What was asked for.
        wanted: String,
        /// The latest ids that begin so.
        latest: Vec<String>,
        /// How many begin so.
        count: usize,
    },
    /// The loop's statistics could not be set up.
    #[error("histogram: {0}")]
    Histogram(#[from] hdrhistogram::CreationError),
    /// rerun refused.
    #[error("run.rrd: {0}")]
    Rerun(String),
    /// The live view could not be started.
    #[error("live view on 127.0.0.1:{port}: {reason}; choose another port in rig.toml, or 0 for any free one")]
    Live {
        /// The port.
        port: u16,
        /// Why not.
        reason: String,
    },
    /// A plot could not be drawn.
    #[error("plot: {0}")]
    Plot(String),
    /// Two runs that have nothing to compare.
    #[error("these runs cannot be compared: {0}")]
    Incomparable(String),
    /// An export failed.
    #[error("{path}: {reason}", path = path.display())]
    Export {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The folder belongs to another study.
    #[error(
        "{path}: the study in this folder asks something else ({differs}); ask the same, or choose another folder",
        path = path.display()
    )]
    OtherStudy {
        /// Its study.toml.
        path: PathBuf,
        /// What differs.
        differs: String,
    },
    /// A piece of a study is not one.
    #[error("{path}: {reason}; delete this file and run the study again: it computes what is missing", path = path.display())]
    Piece {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// Result of the floor `record`.
pub type Result<T> = std::result::Result<T, RecordError>;

impl RecordError {
    /// Wraps an error of the operating system about `path`.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        |source| RecordError::Io { path: path.to_owned(), source }
    }

    /// Wraps an error of arrow about `path`.
    pub(super) fn samples(path: &Path) -> impl FnOnce(ArrowError) -> Self + '_ {
        |source| RecordError::Samples { path: path.to_owned(), source }
    }
}

/// What there is instead of the run that was asked for.
fn there(nearest: Option<&str>, latest: &[String], count: usize) -> String {
    let meant = nearest.map_or(String::new(), |id| format!("; did you mean `{id}`?"));
    match count {
        0 => "; it holds no runs".into(),
        1 => format!("{meant} (the only one there is {})", latest.join(", ")),
        _ => format!("{meant} (it holds {count}, the latest: {})", latest.join(", ")),
    }
}

fn remedy(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "; the disk is full: delete old runs, or start freerig in a folder on another disk"
        }
        std::io::ErrorKind::FileTooLarge => {
            "; files may not grow any further here: raise the limit (LimitFSIZE= of the unit, `ulimit -f`), or make shorter runs"
        }
        std::io::ErrorKind::PermissionDenied => "; this user may not write here",
        std::io::ErrorKind::ReadOnlyFilesystem => "; the file system is read-only",
        _ => "",
    }
}

fn arrow_remedy(error: &ArrowError) -> &'static str {
    match error {
        ArrowError::IoError(_, source) => remedy(source),
        _ => "",
    }
}

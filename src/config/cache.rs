//! Laws of sections kept in files, so that a tube is tabulated once.
//!
//! A cache is a convenience: whatever is wrong with it is a warning, and the law is computed.

use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::atomic;
use crate::fem::section_law::{Request, SectionLaw, SectionLawError};

/// A directory of laws, or none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cache {
    directory: Option<PathBuf>,
}

impl Cache {
    /// The usual directory: of a service, its state directory ($STATE_DIRECTORY); otherwise $XDG_CACHE_HOME/freerig, or
    /// ~/.cache/freerig. None of these: nothing is kept.
    pub fn usual() -> Cache {
        let absolute = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        // systemd separates several directories by colons; the unit has one.
        let state = absolute("STATE_DIRECTORY").map(|directory| directory.join("cache"));
        let user = || absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")));
        Cache { directory: state.or_else(|| Some(user()?.join("freerig"))) }
    }

    /// The laws in `directory`, which is made where it does not exist.
    pub fn at(directory: impl Into<PathBuf>) -> Cache {
        Cache { directory: Some(directory.into()) }
    }

    /// The law of `request`: read, or else computed and kept.
    ///
    /// # Errors
    /// Where there is no such law; never because of the cache.
    pub fn section_law(&self, request: &Request) -> Result<SectionLaw, SectionLawError> {
        let fingerprint = request.fingerprint()?;
        let name: String = fingerprint[..16].iter().map(|byte| format!("{byte:02x}")).collect();
        let path = self.directory.as_ref().map(|directory| directory.join(format!("law-{name}.bin")));
        if let Some(law) = path.as_deref().and_then(|path| read(path, request)) {
            return Ok(law);
        }
        let law = SectionLaw::build(request)?;
        if let Some(path) = &path
            && let Err(error) = keep(path, &law.to_bytes()?)
        {
            tracing::warn!(
                "{}: the law of this FREE cannot be kept ({error}); it is computed every time",
                path.display()
            );
        }
        Ok(law)
    }
}

fn read(path: &Path, request: &Request) -> Option<SectionLaw> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
        Err(error) => {
            tracing::warn!("{}: unreadable ({error}); the law is computed again", path.display());
            return None;
        }
    };
    match SectionLaw::from_bytes(request, &bytes) {
        Ok(law) => Some(law),
        Err(error) => {
            tracing::warn!("{}: {error}; the law is computed again", path.display());
            None
        }
    }
}

fn keep(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(directory) = path.parent() {
        fs::create_dir_all(directory)?;
    }
    atomic::write(path, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::section::Mesh;
    use crate::fem::tube::Tube;
    use crate::units::PASCAL_PER_PSI;

    /// A law that is quick to compute.
    fn request() -> Request {
        let mesh = Mesh::Counted { radial: 1, strip: 1, gap: 1, growth: 1.0 };
        Request { tube: Tube::reference(1.0), mesh, pressure: PASCAL_PER_PSI, twist: 5.0 }
    }

    fn only_file(directory: &Path) -> PathBuf {
        let files: Vec<_> = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(files.len(), 1, "{files:?}");
        files[0].clone()
    }

    #[test]
    fn a_law_is_kept_and_read_and_a_damaged_file_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let place = directory.path().join("new");
        let cache = Cache::at(&place);
        let built = cache.section_law(&request()).unwrap().to_bytes().unwrap();
        let file = only_file(&place);
        assert_eq!(fs::read(&file).unwrap(), built);
        // What stands in the file is what is used: the mirror image finds it, too.
        let mut other = request();
        other.tube.gamma = -other.tube.gamma;
        assert_eq!(cache.section_law(&other).unwrap().to_bytes().unwrap(), built);
        for damaged in [&built[..built.len() - 1], b"", b"something else"] {
            fs::write(&file, damaged).unwrap();
            assert_eq!(cache.section_law(&request()).unwrap().to_bytes().unwrap(), built);
            assert_eq!(fs::read(&file).unwrap(), built);
        }
    }

    #[test]
    fn a_cache_that_cannot_be_read_or_written_does_no_harm() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("file");
        fs::write(&file, "no directory").unwrap();
        for cache in [Cache::at(file.join("below")), Cache { directory: None }] {
            assert!(cache.section_law(&request()).is_ok());
        }
        let tube = Tube { gamma: 0.0, ..Tube::reference(1.0) };
        assert!(Cache { directory: None }.section_law(&Request { tube, ..request() }).is_err());
    }
}

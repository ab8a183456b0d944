//! Finding the files, reading all of them, and the rig that comes out.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::build::build;
use super::calibration::Calibration;
use super::problem::{ConfigError, Problem};
use super::reader::{Section, Source};
use super::rig::Rig;
use super::sections::{read_rig, read_socket};

/// A file as it was when the rig was built from it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceFile {
    /// Where it is.
    pub path: PathBuf,
    /// What it said.
    pub text: String,
}

impl SourceFile {
    fn read(path: &Path) -> io::Result<Self> {
        Ok(Self { path: path.to_owned(), text: std::fs::read_to_string(path)? })
    }

    /// SHA-256 of the text, hexadecimal.
    pub fn sha256(&self) -> String {
        Sha256::digest(&self.text).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Whether the file now says something else, or cannot be read any more.
    pub fn has_changed(&self) -> bool {
        std::fs::read(&self.path).map_or(true, |now| now != self.text.as_bytes())
    }
}

/// The files read so far and what is wrong with them.
#[derive(Debug, Default)]
pub(super) struct Files {
    read: Vec<SourceFile>,
    problems: Vec<Problem>,
}

impl Files {
    /// The files, and what is wrong with them.
    pub(super) fn into_parts(self) -> (Vec<SourceFile>, Vec<Problem>) {
        (self.read, self.problems)
    }
}

/// The calibrations of a directory, each read once.
#[derive(Debug)]
pub(super) struct Library<'f> {
    directory: &'f Path,
    files: &'f mut Files,
    known: BTreeMap<String, Calibration>,
}

/// Why a calibration could not be read.
#[derive(Debug)]
pub(super) struct Missing {
    pub(super) path: PathBuf,
    pub(super) reason: io::Error,
    /// Calibrations that the directory does hold.
    pub(super) known: Vec<String>,
}

impl<'f> Library<'f> {
    pub(super) fn new(directory: &'f Path, files: &'f mut Files) -> Self {
        Self { directory, files, known: BTreeMap::new() }
    }

    /// The calibration `name`. What is wrong inside its file is noted, and a stand-in answered.
    pub(super) fn calibration(&mut self, name: &str) -> Result<Calibration, Missing> {
        if let Some(calibration) = self.known.get(name) {
            return Ok(calibration.clone());
        }
        let path = self.directory.join(format!("{name}.toml"));
        let file = SourceFile::read(&path).map_err(|reason| Missing { path, reason, known: names(self.directory) })?;
        let calibration = Calibration::parse(&file.path, &file.text).unwrap_or_else(|problems| {
            self.files.problems.extend(problems);
            Calibration::default()
        });
        self.files.read.push(file);
        self.known.insert(name.to_owned(), calibration.clone());
        Ok(calibration)
    }
}

/// Names of the calibrations in `directory`; none where it cannot be read.
fn names(directory: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let toml = entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|e| e == "toml"));
    let mut names: Vec<String> = toml.filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned())).collect();
    names.sort_unstable();
    names
}

pub(super) fn read_description(path: &Path) -> Result<SourceFile, ConfigError> {
    SourceFile::read(path).map_err(|error| ConfigError {
        problems: vec![Problem {
            file: path.to_owned(),
            line: None,
            key: String::new(),
            value: String::new(),
            rule: format!("cannot read the rig's description: {error}"),
            remedy: "name it with `--rig FILE`, or run where a rig.toml is".into(),
        }],
    })
}

/// The folder that relative paths of the rig's description start from.
pub(super) fn base(path: &Path) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).to_owned()
}

impl Rig {
    /// Reads `path` and everything that it refers to, or says everything that is wrong with them.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let file = read_description(path)?;
        let base = base(path);
        let mut files = Files::default();
        let source = Source::new(&file.path, &file.text);
        let raw = source.parse().map(|table| read_rig(Section::root(&source, &table), &base, &mut files));
        let mut problems = source.into_problems();
        problems.append(&mut files.problems);
        match raw {
            Some(raw) if problems.is_empty() => {
                files.read.insert(0, file);
                Ok(build(raw, files.read))
            }
            _ => Err(ConfigError { problems }),
        }
    }

    /// Where the control socket of the rig described in `path` is, whatever else is wrong with the file: who wants
    /// to stop a running rig is not to be kept from it by a mistake in a file.
    ///
    /// # Errors
    /// Where the file cannot be read, or is no TOML.
    pub fn socket_path(path: &Path) -> Result<PathBuf, ConfigError> {
        let file = read_description(path)?;
        let source = Source::new(&file.path, &file.text);
        let socket = source.parse().map(|table| {
            let mut root = Section::root(&source, &table);
            read_socket(root.section("socket"), &base(path)).path
        });
        socket.ok_or_else(|| ConfigError { problems: source.into_problems() })
    }

    /// Files that now say something else than when the rig was built from them.
    pub fn changed_files(&self) -> Vec<&Path> {
        self.files.iter().filter(|file| file.has_changed()).map(|file| file.path.as_path()).collect()
    }
}

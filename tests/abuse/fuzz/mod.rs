//! Everything that reads what comes from outside, fed with mutations of what it usually gets.
//!
//! Each target has its seeds: the repository's own files, and those of `tests/abuse/corpus`, where what has once been
//! found stays. Nothing may panic or take long; what is accepted keeps the rules of what it is, and reads back as it
//! was written. The same seed gives the same cases; `FREERIG_FUZZ=50` makes fifty times as many.

mod calibrations;
mod configs;
mod frames;
mod mutator;
mod plans;
mod requests;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use mutator::Mutator;

/// Longest time for one case, far beyond what a busy machine needs: whatever takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(60);

/// The repository's folder.
fn here() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Every file of these folders and files, by its path in the repository.
fn files(paths: &[&str]) -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for path in paths.iter().map(|path| here().join(path)) {
        let mut files: Vec<PathBuf> = match fs::read_dir(&path) {
            Ok(entries) => entries.map(|entry| entry.unwrap().path()).filter(|path| path.is_file()).collect(),
            Err(_) => vec![path],
        };
        files.sort();
        seeds.extend(files.iter().map(|file| fs::read(file).unwrap()));
    }
    seeds
}

/// Since when a case has been running, and its bytes.
type Running = Option<(Instant, Vec<u8>)>;

/// Feeds `target` with the seeds themselves and `count` mutations of them; how many were accepted.
fn feed(seeds: Vec<Vec<u8>>, words: &[&str], count: usize, mut target: impl FnMut(&[u8]) -> bool) -> usize {
    let times = std::env::var("FREERIG_FUZZ").ok().and_then(|text| text.parse().ok()).unwrap_or(1);
    let now: Arc<Mutex<Running>> = Arc::default();
    let watched = Arc::downgrade(&now);
    std::thread::spawn(move || {
        while let Some(now) = watched.upgrade() {
            if let Some((begun, bytes)) = &*now.lock().unwrap()
                && begun.elapsed() > PATIENCE
            {
                eprintln!("hangs: {}", Printed(bytes));
                std::process::abort();
            }
            drop(now);
            std::thread::sleep(Duration::from_secs(1));
        }
    });
    let mut accepted = 0;
    let mut mutator = Mutator::new(seeds.clone(), words);
    let mutations = (0..count * times).map(|_| mutator.next());
    for case in seeds.into_iter().chain(mutations) {
        *now.lock().unwrap() = Some((Instant::now(), case.clone()));
        match catch_unwind(AssertUnwindSafe(|| target(&case))) {
            Ok(was) => accepted += usize::from(was),
            Err(panic) => {
                eprintln!("fails: {}", Printed(&case));
                resume_unwind(panic);
            }
        }
    }
    accepted
}

struct Printed<'a>(&'a [u8]);

impl std::fmt::Display for Printed<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match std::str::from_utf8(self.0) {
            Ok(text) => write!(f, "\n{text}\n-----"),
            Err(_) => write!(f, "{}", self.0.escape_ascii()),
        }
    }
}

/// Every problem of a refused file says where, against which rule, and what to do.
fn explained(error: &freerig::config::ConfigError) {
    assert!(!error.problems.is_empty());
    for problem in &error.problems {
        assert!(!problem.rule.is_empty() && !problem.remedy.is_empty(), "{problem:?}");
    }
}

/// A folder with one file in it, written anew for every case.
struct Written {
    folder: tempfile::TempDir,
    path: PathBuf,
}

impl Written {
    fn new(name: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        Self { folder, path }
    }

    fn with(&self, bytes: &[u8]) -> &Path {
        fs::write(&self.path, bytes).unwrap();
        &self.path
    }
}

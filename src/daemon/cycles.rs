//! How often each FREE has been under pressure: rubber tires.
//!
//! **Rule.** A cycle is counted when the pressure (measured; commanded where nothing measures it) rises above [`RISE`]
//! of `max_pressure_psi`, after it has been below [`FALL`] of it. Small loops near the top are none.
//!
//! The counts belong to the FREE, by the name of its calibration, and outlive runs: they stand in `cycles.toml` beside
//! the runs, which is replaced as a whole and under a lock on their folder, so that two processes lose nothing to each
//! other. It is written at most once a second while the pressures move, and at the end of every program: a kill costs a
//! second of counting. What a simulated FREE goes through is counted apart.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::clock::Time;
use crate::config::{Rig, atomic};
use crate::signal::TickRecord;

/// Share of the highest pressure above which a cycle is counted.
pub const RISE: f64 = 0.5;
/// Share of the highest pressure below which the next one can begin.
pub const FALL: f64 = 0.25;

/// Name of the file.
const NAME: &str = "cycles.toml";
/// Shortest time between two writes.
const PERIOD: Duration = Duration::from_secs(1);

/// The file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Counts {
    /// Cycles of FREEs, by the name of their calibration.
    pub hardware: BTreeMap<String, u64>,
    /// The same of simulated ones.
    pub simulated: BTreeMap<String, u64>,
}

impl Counts {
    /// Reads those of the runs in `directory`; none where nothing has been counted.
    ///
    /// # Errors
    /// Where the file cannot be read.
    pub fn read(directory: &Path) -> io::Result<Self> {
        match std::fs::read_to_string(directory.join(NAME)) {
            Ok(text) => toml::from_str(&text).map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error),
        }
    }

    /// By FREE of `rig`.
    pub fn of(&self, rig: &Rig) -> Vec<u64> {
        let counts = if rig.is_simulated() { &self.simulated } else { &self.hardware };
        rig.calibrations.iter().map(|known| counts.get(&known.name).copied().unwrap_or_default()).collect()
    }
}

/// By FREE of `rig`: its cycles so far; zeros where they cannot be read.
pub fn counted(rig: &Rig) -> Vec<u64> {
    let counts = Counts::read(&rig.record.directory).unwrap_or_else(|error| {
        tracing::warn!(%error, "the pressure cycles cannot be read: {}", rig.record.directory.join(NAME).display());
        Counts::default()
    });
    counts.of(rig)
}

/// Counts while programs run.
#[derive(Debug)]
pub struct Counter {
    directory: PathBuf,
    simulated: bool,
    frees: Vec<One>,
    written: Time,
    failed: bool,
}

#[derive(Debug)]
struct One {
    name: String,
    highest: f64,
    /// Whether it is above; not known before the first look.
    above: Option<bool>,
    /// Counted and not yet written.
    fresh: u64,
}

impl Counter {
    /// Of the FREEs of `rig`.
    pub fn new(rig: &Rig) -> Self {
        let one = |(free, known): (&crate::control::FreeControl, &crate::config::Calibration)| One {
            name: known.name.clone(),
            highest: free.limits.pressure_max,
            above: None,
            fresh: 0,
        };
        Self {
            directory: rig.record.directory.clone(),
            simulated: rig.is_simulated(),
            frees: rig.control.frees.iter().zip(&rig.calibrations).map(one).collect(),
            written: Time::ZERO,
            failed: false,
        }
    }

    /// Looks at `record`, and writes what has been counted if it is time.
    pub fn see(&mut self, record: &TickRecord) {
        for (one, free) in self.frees.iter_mut().zip(record.frees()) {
            let measured = free.pressure.pressure;
            one.see(if measured.is_finite() { measured } else { free.command });
        }
        if record.time.since(self.written) >= PERIOD {
            self.written = record.time;
            self.flush();
        }
    }

    /// Writes what has been counted. What cannot be written is kept for the next time, and told once.
    pub fn flush(&mut self) {
        if self.frees.iter().all(|one| one.fresh == 0) {
            return;
        }
        match self.add() {
            Ok(()) => self.frees.iter_mut().for_each(|one| one.fresh = 0),
            Err(error) if !self.failed => {
                self.failed = true;
                let path = self.directory.join(NAME);
                tracing::warn!(%error, "the pressure cycles cannot be kept in {}: correct or remove it", path.display());
            }
            Err(_) => {}
        }
    }

    fn add(&self) -> io::Result<()> {
        std::fs::create_dir_all(&self.directory)?;
        let lock = File::open(&self.directory)?;
        lock.lock()?;
        let mut counts = Counts::read(&self.directory)?;
        let these = if self.simulated { &mut counts.simulated } else { &mut counts.hardware };
        for one in &self.frees {
            *these.entry(one.name.clone()).or_default() += one.fresh;
        }
        let text = toml::to_string(&counts).map_err(io::Error::other)?;
        let head =
            "# Pressure cycles by calibration, counted by freerig: above 50 % of max_pressure after below 25 %.\n";
        atomic::write(&self.directory.join(NAME), format!("{head}{text}").as_bytes())
    }
}

impl One {
    fn see(&mut self, pressure: f64) {
        let above = match self.above {
            // Whatever it is at first was counted by whoever brought it there.
            None => pressure > FALL * self.highest,
            Some(true) => pressure >= FALL * self.highest,
            Some(false) => pressure > RISE * self.highest,
        };
        if self.above == Some(false) && above {
            self.fresh += 1;
        }
        self.above = Some(above);
    }
}

impl Drop for Counter {
    fn drop(&mut self) {
        self.flush();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_goes_over_one_half_and_comes_from_below_a_quarter() {
        let mut one = One { name: "a".into(), highest: 100.0, above: None, fresh: 0 };
        // Held at 60 when it is first seen; one whole cycle; a loop near the top; up to 45 only; one more.
        let course = [60.0, 60.0, 0.0, 30.0, 49.0, 51.0, 80.0, 30.0, 90.0, 24.0, 45.0, 10.0, 55.0, f64::NAN];
        let counted: Vec<u64> = course
            .iter()
            .map(|p| {
                one.see(*p);
                one.fresh
            })
            .collect();
        assert_eq!(counted, [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 2, 2]);
    }

    #[test]
    fn two_counters_lose_nothing_to_each_other_and_a_spoilt_file_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let counter = |simulated, fresh| Counter {
            directory: folder.path().join("runs"),
            simulated,
            frees: vec![One { name: "a".into(), highest: 1.0, above: None, fresh }],
            written: Time::ZERO,
            failed: false,
        };
        let threads: Vec<_> = (0..4)
            .map(|i| {
                let mut counter = counter(i == 0, 1);
                std::thread::spawn(move || {
                    for _ in 0..5 {
                        counter.flush();
                        counter.frees[0].fresh = 1;
                    }
                    counter.frees[0].fresh = 0;
                })
            })
            .collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        let counts = Counts::read(&folder.path().join("runs")).unwrap();
        assert_eq!((counts.hardware["a"], counts.simulated["a"]), (15, 5));
        let path = folder.path().join("runs").join(NAME);
        std::fs::write(&path, "spoilt").unwrap();
        let mut kept = counter(false, 3);
        kept.flush();
        assert_eq!((std::fs::read_to_string(&path).unwrap().as_str(), kept.frees[0].fresh), ("spoilt", 3));
    }
}

//! Progress of something that takes a while, on stderr.

use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Nothing is shown of what is done within this time.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest silence between two plain lines.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// A bar where stderr is a terminal, plain lines where it is not; both only for what takes over a second.
#[derive(Debug)]
pub struct Progress {
    label: String,
    total: f64,
    unit: &'static str,
    begun: Instant,
    said: Option<Instant>,
    bar: Option<ProgressBar>,
    terminal: bool,
}

/// Steps of the bar: it is drawn in permille, whatever the unit.
const STEPS: u64 = 1000;

impl Progress {
    /// Progress of `label` towards `total` (in `unit`, for example "s").
    pub fn new(label: impl Into<String>, total: f64, unit: &'static str) -> Self {
        let terminal = io::stderr().is_terminal();
        Self { label: label.into(), total, unit, begun: Instant::now(), said: None, bar: None, terminal }
    }

    /// `done` of the total is done; `state` says in a few words what is going on.
    pub fn set(&mut self, done: f64, state: &str) {
        if self.begun.elapsed() < PATIENCE {
            return;
        }
        let fraction = if self.total > 0.0 { (done / self.total).clamp(0.0, 1.0) } else { 1.0 };
        if self.terminal {
            let bar = self.bar.get_or_insert_with(|| bar(&self.label));
            bar.set_position((fraction * STEPS as f64) as u64);
            bar.set_message(format!("{done:.1} of {:.1} {} {state}", self.total, self.unit));
        } else if self.said.is_none_or(|at| at.elapsed() >= LINE_INTERVAL) {
            self.said = Some(Instant::now());
            let (label, total, unit) = (&self.label, self.total, self.unit);
            say(&format!("{label}: {done:.1} of {total:.1} {unit} ({:.0} %) {state}", 100.0 * fraction));
        }
    }

    /// Prints a line of its own without disturbing the bar.
    pub fn note(&self, line: &str) {
        match &self.bar {
            Some(bar) => bar.println(line),
            None => say(line),
        }
    }
}

/// The bar disappears; what remains to be said, the command says.
impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// A closed stderr is no reason to stop the work.
fn say(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

fn bar(label: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix} [{bar:32}] {percent:>3} % {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ");
    ProgressBar::new(STEPS).with_style(style).with_prefix(label.to_owned())
}

//! What a benchmark has found: rows as CSV, a drawing as SVG, both on a page.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::plot::{Line, Plot};
use super::run::write_atomically;
use super::sheet::Sheet;
use super::{Result, palette};

/// Height of the drawing, pixels.
const HEIGHT: u32 = 460;
/// Colours of the curves, in turn.
const COLORS: [u32; 6] =
    [palette::BLUE, palette::ORANGE, palette::GREEN, palette::PURPLE, palette::RED, palette::YELLOW];

/// One method on one case.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// Which benchmark.
    pub suite: &'static str,
    /// Who computes.
    pub method: String,
    /// What.
    pub case: String,
    /// Error over the size of what is computed; `None` where there is no answer.
    pub relative_error: Option<f64>,
    /// Time that it took, s.
    pub time_s: Option<f64>,
    /// Whether there is no answer, or one that must not be.
    pub failed: bool,
}

/// How one side of a comparison did.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed {
    /// Program, version, method and resolution.
    pub who: String,
    /// Its relative error.
    pub error: f64,
    /// Processor time, s.
    pub time_s: f64,
}

impl Timed {
    /// The curve `label` of `runs`: decimal logarithms of time in ms and of error.
    pub fn curve(label: String, runs: &[Timed]) -> Curve {
        let log = |x: f64| x.max(f64::MIN_POSITIVE).log10();
        (label, runs.iter().map(|r| log(1e3 * r.time_s)).collect(), runs.iter().map(|r| log(r.error)).collect())
    }
}

/// A comparison at equal error: the cheapest of either side whose error is at most `error`.
#[derive(Clone, Debug, PartialEq)]
pub struct Claim {
    /// What both solved.
    pub task: String,
    /// The error that both keep.
    pub error: f64,
    /// freerig.
    pub own: Timed,
    /// The other one.
    pub peer: Timed,
}

impl Claim {
    /// How many times as long the peer takes.
    pub fn ratio(&self) -> f64 {
        self.peer.time_s / self.own.time_s
    }
}

/// A curve of the drawing: what the legend calls it, x and y.
pub type Curve = (String, Vec<f64>, Vec<f64>);

/// What a benchmark has found.
#[derive(Clone, Debug, Default)]
pub struct BenchSuite {
    /// Its name, as on the command line.
    pub name: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// What it says beside the rows: names and values.
    pub facts: Vec<(String, String)>,
    /// Every method on every case.
    pub rows: Vec<BenchRow>,
    /// What takes how much longer elsewhere.
    pub claims: Vec<Claim>,
    /// A table of its own instead of the rows', Markdown.
    pub table: Option<String>,
    /// Caption of the drawing.
    pub caption: &'static str,
    /// Quantity and unit of the horizontal axis.
    pub x_label: &'static str,
    /// Quantity and unit of the vertical axis.
    pub y_label: &'static str,
    /// What is drawn.
    pub curves: Vec<Curve>,
}

impl BenchSuite {
    /// Writes `bench-NAME.csv`, `.svg` and `.html` into `directory`; returns the page's path.
    ///
    /// # Errors
    /// Where one of them cannot be drawn or written.
    pub fn write(&self, directory: &Path) -> Result<PathBuf> {
        fs::create_dir_all(directory)
            .map_err(|source| super::RecordError::Io { path: directory.to_owned(), source })?;
        let file = |ending: &str| directory.join(format!("bench-{}.{ending}", self.name));
        let plot = self.plot();
        write_atomically(&file("csv"), self.csv().as_bytes())?;
        write_atomically(&file("svg"), plot.svg()?.as_bytes())?;
        let facts = self.rows.iter().map(fact);
        let sheet = Sheet {
            title: self.title.into(),
            simulated: true,
            facts: self.said().into_iter().chain(facts).collect(),
            figures: vec![(self.caption.into(), plot)],
            ..Sheet::default()
        };
        sheet.write(&file("html"))
    }

    /// The facts and the comparisons at equal error: names and values.
    pub fn said(&self) -> Vec<(String, String)> {
        self.facts.iter().cloned().chain(self.claims.iter().map(super::bench_page::fact)).collect()
    }

    pub(super) fn plot(&self) -> Plot {
        let line = |(i, (label, x, y)): (usize, &Curve)| Line {
            // Once the colours have been through.
            dashed: i / COLORS.len() % 2 == 1,
            ..Line::new(label, COLORS[i % COLORS.len()], x, y.clone())
        };
        Plot {
            x_label: self.x_label.into(),
            y_label: self.y_label.into(),
            height: HEIGHT,
            lines: self.curves.iter().enumerate().map(line).collect(),
            ..Plot::default()
        }
    }

    fn csv(&self) -> String {
        let number = |x: Option<f64>| x.map_or(String::new(), |x| format!("{x:e}"));
        let line = |r: &BenchRow| {
            let (error, time) = (number(r.relative_error), number(r.time_s));
            format!("{},\"{}\",\"{}\",{error},{time},{}\n", r.suite, r.method, r.case, r.failed)
        };
        let head = String::from("suite,method,case,relative_error,time_s,failed\n");
        self.rows.iter().map(line).fold(head, |all, line| all + &line)
    }
}

fn fact(row: &BenchRow) -> (String, String) {
    let error = row.relative_error.map_or("no answer".into(), |e| format!("relative error {e:.2e}"));
    let time = row.time_s.map_or(String::new(), |t| format!(", {:.3} ms", 1e3 * t));
    (format!("{}: {}", row.method, row.case), error + &time + if row.failed { ", FAILED" } else { "" })
}

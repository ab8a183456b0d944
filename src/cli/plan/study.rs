//! `freerig plan design --study FOLDER`: thousands of designs, in pieces, on every core and on as many machines as
//! there are.

use std::path::Path;
use std::str::FromStr;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use super::sweep::{Parameter, Sweep};
use crate::cli::table::{Table, number};
use crate::cli::{Context, Failure, Progress};
use crate::plan::study::{Candidate, Question, Row, rows};
use crate::record::{Labelled, RecordError, Study, StudyDocument, study_sheet};
use crate::units::Pressure;

/// One of several who share a study: `2/16`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shard {
    index: usize,
    count: usize,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Shard { index, count }),
            _ => Err(format!("`{text}` is no share; write I/N with I from 1 to N, for example 2/16")),
        }
    }
}

impl Shard {
    /// Every so many pieces one is its own, so that easy and hard designs are shared alike.
    fn has(self, piece: usize) -> bool {
        piece % self.count == self.index - 1
    }
}

/// What is best at something.
#[derive(Debug, Serialize)]
struct Best {
    aim: &'static str,
    unit: &'static str,
    /// In that unit; none where no design has an answer.
    reached: Option<f64>,
    /// Values of what was swept, SI, in the order of the sweeps.
    values: Vec<f64>,
}

#[derive(Debug, Serialize)]
struct Report {
    study: String,
    designs: usize,
    pieces: usize,
    computed_now: usize,
    /// Pieces that others are to compute; what follows is there when none is missing.
    missing: usize,
    pressure_pa: f64,
    swept: Vec<&'static str>,
    /// Designs without a free or a blocked equilibrium at the highest pressure.
    ended: Option<usize>,
    tolerance: f64,
    /// Largest of any design.
    discretisation_error_estimate: Option<f64>,
    /// Designs whose error the finest mesh leaves above the tolerance.
    missed: Option<usize>,
    /// Designs whose rubber may fold when they are blocked.
    folds: Option<usize>,
    best: Vec<Best>,
    parquet: Option<String>,
    report: Option<String>,
    wall_time_s: f64,
}

type Aim = (&'static str, &'static str, fn(&Row, f64) -> Option<f64>);

/// Name, unit, and how far a row gets with FREEs of that length, m.
const AIMS: [Aim; 6] = [
    ("rotation", "deg", |row, length| row.twist.map(|twist| (twist * length).to_degrees().abs())),
    ("extension", "mm", |row, length| row.stretch.map(|stretch| 1e3 * (stretch - 1.0) * length)),
    ("force", "N", |row, _| row.force.map(f64::abs)),
    ("moment", "mN m", |row, _| row.moment.map(|moment| 1e3 * moment.abs())),
    ("sideways", "mm", |row, _| row.sideways.map(|way| 1e3 * way)),
    ("lift", "mm", |row, _| row.lift.map(|way| 1e3 * way.abs())),
];

/// Computes what is missing of this share of the study in `folder`; when nothing is missing any more, merges.
pub fn run(
    folder: &Path,
    shard: Option<Shard>,
    sweeps: &[Sweep],
    candidates: &[Candidate],
    question: &Question,
    context: &Context,
) -> Result<(), Failure> {
    let begun = Instant::now();
    let document = StudyDocument {
        version: env!("CARGO_PKG_VERSION").into(),
        sweeps: sweeps.iter().map(Sweep::to_string).collect(),
        designs: candidates.len(),
        length_m: question.length,
        pressures_pa: question.pressures.clone(),
        tolerance: question.tolerance,
        tube: (&candidates[0].tube).into(),
    };
    let study = Study::open(folder, document).map_err(refused)?;
    let mine = |piece: &usize| shard.is_none_or(|shard| shard.has(*piece));
    let missing: Vec<usize> = (0..study.pieces()).filter(mine).filter(|piece| !study.done(*piece)).collect();
    let total: usize = missing.iter().map(|piece| study.designs(*piece).len()).sum();
    let progress = Mutex::new((0usize, Progress::new("study", total as f64, "designs")));
    let one = |candidate: &Candidate| {
        let rows = rows(candidate, question);
        let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.0 += 1;
        let done = progress.0;
        progress.1.set(done as f64, "");
        rows
    };
    missing.par_iter().try_for_each(|&piece| {
        // Somebody else may have come first.
        if study.done(piece) {
            return Ok(());
        }
        let rows: Vec<Vec<Row>> = candidates[study.designs(piece)].par_iter().map(one).collect();
        study.keep(piece, &rows.concat())
    })?;
    let (computed_now, _) = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
    let left = (0..study.pieces()).filter(|piece| !study.done(*piece)).count();
    let mut report = Report {
        study: folder.display().to_string(),
        designs: candidates.len(),
        pieces: study.pieces(),
        computed_now,
        missing: left,
        pressure_pa: question.pressures.last().copied().unwrap_or(0.0),
        swept: sweeps.iter().map(|sweep| sweep.parameter.name()).collect(),
        ended: None,
        tolerance: question.tolerance,
        discretisation_error_estimate: None,
        missed: None,
        folds: None,
        best: Vec::new(),
        parquet: None,
        report: None,
        wall_time_s: 0.0,
    };
    if left == 0 {
        merge(&study, folder, sweeps, question, &mut report)?;
    }
    report.wall_time_s = begun.elapsed().as_secs_f64();
    if context.json { context.print_json(&report) } else { context.print(report.text(sweeps)) }
}

fn refused(error: RecordError) -> Failure {
    match error {
        RecordError::OtherStudy { .. } => Failure::usage(error),
        other => other.into(),
    }
}

fn merge(
    study: &Study,
    folder: &Path,
    sweeps: &[Sweep],
    question: &Question,
    report: &mut Report,
) -> Result<(), Failure> {
    let (parquet, all) = study.merge()?;
    let last: Vec<&Row> = all.iter().filter(|row| row.pressure == report.pressure_pa).collect();
    report.ended = Some(last.iter().filter(|row| row.twist.is_none() || row.force.is_none()).count());
    let errors = || last.iter().filter_map(|row| row.error);
    report.discretisation_error_estimate = errors().reduce(f64::max);
    report.missed = Some(errors().filter(|error| *error > question.tolerance).count());
    let designs = all.chunk_by(|a, b| a.candidate == b.candidate);
    report.folds = Some(designs.filter(|rows| rows.iter().any(Row::folds)).count());
    let asked = |(name, ..): &&Aim| {
        let of_module = matches!(*name, "sideways" | "lift");
        !of_module || sweeps.iter().any(|sweep| sweep.parameter == Parameter::Spacing)
    };
    for (aim, unit, of) in AIMS.iter().filter(asked) {
        let reach = |row: &&&Row| of(row, question.length);
        let best = last.iter().filter(|row| reach(row).is_some_and(f64::is_finite)).max_by(|a, b| {
            let at = |row| reach(row).unwrap_or(f64::NEG_INFINITY);
            at(a).total_cmp(&at(b))
        });
        report.best.push(Best {
            aim,
            unit,
            reached: best.and_then(|row| of(row, question.length)),
            values: best.map(|r| sweeps.iter().map(|s| s.parameter.get(&r.candidate)).collect()).unwrap_or_default(),
        });
    }
    let values: Vec<_> = sweeps
        .iter()
        .map(|s| (s.parameter.label(), move |row: &Row| s.parameter.shown(s.parameter.get(&row.candidate))))
        .collect();
    let parameters: Vec<Labelled<'_, f64>> =
        values.iter().map(|(label, of)| (label.clone(), of as &dyn Fn(&Row) -> f64)).collect();
    let reaches: Vec<_> = AIMS
        .iter()
        .filter(asked)
        .map(|(aim, unit, of)| (format!("{aim} ({unit})"), |row: &Row| of(row, question.length)))
        .collect();
    let aims: Vec<Labelled<'_, Option<f64>>> =
        reaches.iter().map(|(label, of)| (label.clone(), of as &dyn Fn(&Row) -> Option<f64>)).collect();
    let title = format!("{} designs at {:.1}", report.designs, Pressure::pascals(report.pressure_pa));
    let page =
        study_sheet(&title, report.facts(sweeps), &last, &parameters, &aims).write(&folder.join("report.html"))?;
    (report.parquet, report.report) = (Some(parquet.display().to_string()), Some(page.display().to_string()));
    Ok(())
}

impl Report {
    fn facts(&self, sweeps: &[Sweep]) -> Vec<(String, String)> {
        let swept = sweeps.iter().map(Sweep::to_string).collect::<Vec<_>>().join(", ");
        let mut facts = vec![("swept".into(), swept), ("designs".into(), self.designs.to_string())];
        facts.extend(self.ended.map(|n| ("past a limit at the highest pressure".into(), n.to_string())));
        for best in &self.best {
            let at = best.values.iter().zip(sweeps).map(|(value, sweep)| {
                let parameter = sweep.parameter;
                format!("{} {:.4} {}", parameter.name(), parameter.shown(*value), parameter.unit()).trim().to_owned()
            });
            let at = at.collect::<Vec<_>>().join(", ");
            let what = match best.reached {
                Some(reached) => format!("{reached:.2} {} at {at}", best.unit),
                None => "no design has an answer".into(),
            };
            facts.push((format!("most {}", best.aim), what));
        }
        facts.extend(self.doubts());
        facts
    }

    /// What to think of the figures of all designs.
    fn doubts(&self) -> Vec<(String, String)> {
        let error = self.discretisation_error_estimate.map(|most| {
            let (most, wanted, missed) = (100.0 * most, 100.0 * self.tolerance, self.missed.unwrap_or(0));
            let missed = match missed {
                0 => String::new(),
                n => format!(
                    "; {n} of {} designs miss the tolerance of {wanted} %, on the finest mesh there is",
                    self.designs
                ),
            };
            ("discretisation error, estimated".into(), format!("at most {most:.2} %{missed}"))
        });
        let folds = self.folds.filter(|n| *n > 0).map(|n| {
            let what = "designs: their blocked values, and the error of these, are of rubber that has not folded at the \
                        edge of the fibre's strip; column `remark` says from which pressure on";
            ("blocked ones fold".into(), format!("{n} of {} {what}", self.designs))
        });
        error.into_iter().chain(folds).collect()
    }

    fn text(&self, sweeps: &[Sweep]) -> String {
        let computed = format!("{} of {} designs computed now", self.computed_now, self.designs);
        let (Some(parquet), Some(report)) = (&self.parquet, &self.report) else {
            return format!(
                "{computed}; {} of {} pieces are still missing in {}: other shares compute them, or this command \
                 without --shard",
                self.missing, self.pieces, self.study
            );
        };
        let mut columns = vec!["most".to_owned(), ">reached".into(), "unit".into()];
        columns.extend(sweeps.iter().map(|sweep| format!(">{}", sweep.parameter.label())));
        let mut table = Table::new(&columns.iter().map(String::as_str).collect::<Vec<_>>());
        for best in &self.best {
            let mut cells = vec![best.aim.to_owned(), number(best.reached, 2), best.unit.into()];
            let values = best.values.iter().zip(sweeps);
            cells.extend(values.map(|(value, sweep)| number(Some(sweep.parameter.shown(*value)), 3)));
            table.row(cells);
        }
        let at = Pressure::pascals(self.pressure_pa);
        let ended = self.ended.unwrap_or(0);
        let doubts: String = self.doubts().into_iter().map(|(name, value)| format!("\n{name}: {value}")).collect();
        format!(
            "{table}\n\nat {at:.1}; {ended} of {} designs are past a limit there{doubts}\n{computed}\nall designs: \
             {parquet}\ncurves: {report}",
            self.designs
        )
    }
}

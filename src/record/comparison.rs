//! Runs beside each other: their errors, the ratio of these, how far their angles are apart, and a page of overlays.
//!
//! Angles are compared at the same time since the start of the program, on a grid as fine as the finer of both, over
//! the time that both have: the deviation of A from B is that of B from A, and the ratios are each other's inverse.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::document::RunKind;
use super::html::{Page, degrees, escape};
use super::metrics::{ErrorMetrics, FreeMetrics, Metrics, range, rms};
use super::recorded::Recorded;
use super::run::{Run, write_atomically};
use super::signals::{Signals, interpolate};
use super::{RecordError, Result, figures, prediction};
use crate::signal::Quantity;
use crate::units::PASCAL_PER_PSI;

/// Shortest time in common that says anything, s.
const SHORTEST_OVERLAP: f64 = 0.1;

/// One run of a comparison, about the FREE that it is about.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The run.
    pub id: String,
    /// Its folder.
    pub folder: PathBuf,
    /// What a person calls it.
    pub title: String,
    /// Kind of experiment.
    pub kind: RunKind,
    /// The FREE.
    pub free: String,
    /// Name or values of its gains; `open loop` where a pressure was asked.
    pub gains: String,
    /// Whether devices and plant were simulated.
    pub simulated: bool,
    /// On the stepped clock.
    pub stepped: bool,
    /// `done`, `failed`, `aborted`, `fault` or `incomplete`.
    pub result: &'static str,
    /// Tracking errors; `None` where no angle was asked.
    pub error: Option<ErrorMetrics>,
    /// RMS error over that of the first run of the same program; of a pair, over that of the first.
    pub rms_ratio: Option<f64>,
    /// RMS of angle - model, rad.
    pub model_rmsd_rad: Option<f64>,
    /// Width of the loop of a sweep, rad.
    pub hysteresis_rad: Option<f64>,
    /// Highest measured pressure, Pa.
    pub highest_pressure_pa: Option<f64>,
    /// Periods skipped because of overruns.
    pub deadline_misses: u64,
}

/// How far the angle of a run is from that of another.
#[derive(Clone, Debug, Serialize)]
pub struct Deviation {
    /// The run that is compared with.
    pub run_a: String,
    /// Its FREE.
    pub free_a: String,
    /// The run that is compared.
    pub run_b: String,
    /// Its FREE.
    pub free_b: String,
    /// Root of the mean square of the difference of the angles, rad.
    pub rms_rad: f64,
    /// Its greatest magnitude, rad.
    pub peak_rad: f64,
    /// RMS over the range of both angles together, per cent.
    pub percent_of_range: f64,
    /// Time that both have, s.
    pub overlap_s: f64,
}

/// Runs that are drawn over each other.
struct Group {
    heading: String,
    /// Index of the row, and the signals.
    members: Vec<(usize, Signals)>,
    /// Of each member after the first from the first.
    deviations: Vec<Deviation>,
}

/// Runs beside each other.
pub struct Comparison {
    /// What the page is called.
    pub title: String,
    /// The runs, in the order they were given.
    pub rows: Vec<Row>,
    /// What should be borne in mind.
    pub remarks: Vec<String>,
    /// Other pages: what they are, and their paths from this one.
    pub links: Vec<(String, String)>,
    groups: Vec<Group>,
}

impl Comparison {
    /// `runs` beside each other, overlaid where they ran the same program; ratios are to the first of each program.
    ///
    /// # Errors
    /// Where samples cannot be read.
    pub fn of(runs: &[Run]) -> Result<Self> {
        let mut rows: Vec<Row> = Vec::new();
        let mut groups: Vec<(&Run, Group)> = Vec::new();
        let mut remarks = Vec::new();
        for run in runs {
            let all = match Recorded::of(run, &mut |_| {}) {
                Err(error @ RecordError::NoSamples { .. }) => {
                    remarks.push(error.to_string());
                    continue;
                }
                all => all?,
            };
            remarks.extend(all.remark().map(|remark| format!("{}: {remark}", run.id())));
            let Some(signals) = primary(run, &all).cloned() else { continue };
            let index = rows.len();
            rows.push(row(run, &all, &signals));
            let same = |other: &&mut (&Run, Group)| {
                let (first, group) = (other.0.start(), &other.1);
                let same_free = group.members.first().is_some_and(|m| m.1.name == signals.name);
                first.kind == run.start().kind && first.program == run.start().program && same_free
            };
            match groups.iter_mut().find(same) {
                Some((_, group)) => group.members.push((index, signals)),
                None => {
                    let heading = format!("{} - {}", run.start().name(), signals.name);
                    groups.push((run, Group { heading, members: vec![(index, signals)], deviations: Vec::new() }));
                }
            }
        }
        let title = format!("{} runs", rows.len());
        let mut comparison =
            Self { title, rows, remarks, links: Vec::new(), groups: groups.into_iter().map(|(_, g)| g).collect() };
        comparison.relate();
        Ok(comparison)
    }

    /// `b` beside `a`: FREE by FREE where they have some in common, else the one that each is about.
    ///
    /// # Errors
    /// Where samples cannot be read, or the runs have no time in common.
    pub fn pair(a: &Run, b: &Run) -> Result<Self> {
        let (all_a, all_b) = (Recorded::of(a, &mut |_| {})?, Recorded::of(b, &mut |_| {})?);
        let nothing = |run: &Run| RecordError::Incomparable(format!("{} holds no record of a FREE", run.id()));
        let own_a = primary(a, &all_a).ok_or_else(|| nothing(a))?;
        let own_b = primary(b, &all_b).ok_or_else(|| nothing(b))?;
        let mut pairs: Vec<(&Signals, &Signals)> =
            all_a.frees.iter().filter_map(|x| Some((x, all_b.frees.iter().find(|y| y.name == x.name)?))).collect();
        let mut remarks = Vec::new();
        if pairs.is_empty() {
            pairs.push((own_a, own_b));
            remarks.push(format!("different FREEs: {} against {}", own_a.name, own_b.name));
        }
        if a.start().program != b.start().program {
            remarks.push("different programs: the angles are compared at the same time since their starts".into());
        }
        if a.start().simulated() != b.start().simulated() {
            remarks.push("one of the runs is SIMULATED, the other is not".into());
        }
        for (run, all) in [(a, &all_a), (b, &all_b)] {
            remarks.extend(all.remark().map(|remark| format!("{}: {remark}", run.id())));
        }
        for run in [a, b].into_iter().filter(|run| !run.is_complete()) {
            remarks.push(format!("{} is incomplete: it is compared as far as it goes", run.id()));
        }
        // The rows are about the same FREE where there is one.
        let (row_a, row_b) = pairs.iter().find(|(x, _)| x.name == own_a.name).unwrap_or(&pairs[0]);
        let rows = vec![row(a, &all_a, row_a), row(b, &all_b, row_b)];
        let groups = pairs.into_iter().map(|(x, y)| Group {
            heading: if x.name == y.name { x.name.clone() } else { format!("{} and {}", x.name, y.name) },
            members: vec![(0, x.clone()), (1, y.clone())],
            deviations: Vec::new(),
        });
        let groups: Vec<Group> = groups.collect();
        let title = "Two runs beside each other".into();
        let mut comparison = Self { title, rows, remarks, links: Vec::new(), groups };
        comparison.relate();
        if comparison.deviations().next().is_none() {
            let reason = "they have no angle at the same time since the start of their programs";
            return Err(RecordError::Incomparable(format!("{} and {}: {reason}", a.id(), b.id())));
        }
        Ok(comparison)
    }

    /// Fills in the ratios and the deviations.
    fn relate(&mut self) {
        for group in &mut self.groups {
            let Some(((first, a), others)) = group.members.split_first() else { continue };
            let rms = |rows: &[Row], i: usize| rows.get(i)?.error.map(|e| e.rms_rad);
            let reference = rms(&self.rows, *first).filter(|r| *r > 0.0);
            for (i, _) in &group.members {
                if self.rows[*i].rms_ratio.is_none() {
                    self.rows[*i].rms_ratio = rms(&self.rows, *i).zip(reference).map(|(own, first)| own / first);
                }
            }
            for (i, b) in others {
                group.deviations.extend(deviation((&self.rows[*first].id, a), (&self.rows[*i].id, b)));
            }
        }
    }

    /// How far the runs are from the first that they are overlaid with.
    pub fn deviations(&self) -> impl Iterator<Item = &Deviation> {
        self.groups.iter().flat_map(|g| &g.deviations)
    }

    /// Writes the page of tables and overlays to `path`; returns it.
    ///
    /// # Errors
    /// Where it cannot be drawn or written.
    pub fn write(&self, path: &Path) -> Result<PathBuf> {
        write_atomically(path, self.html(path.parent())?.as_bytes())?;
        Ok(path.to_owned())
    }

    /// The page, with links to the runs' reports as seen from the folder `from`.
    fn html(&self, from: Option<&Path>) -> Result<String> {
        let mut page = Page::new(&self.title);
        page.raw(&format!("<header><h1>{}</h1><p class=\"badges\">", escape(&self.title)));
        if self.rows.iter().any(|r| r.simulated) {
            page.badge("simulated", "SIMULATED");
        }
        page.raw("</p>");
        for remark in &self.remarks {
            page.raw(&format!("<p class=\"warning\">{}</p>", escape(remark)));
        }
        page.raw("</header><main><section><h2>Runs</h2>");
        self.table(&mut page, from);
        page.links(&self.links);
        page.raw("</section>");
        for group in &self.groups {
            self.section(&mut page, group)?;
        }
        page.raw(
            "</main><footer><p>Errors are reference - angle while the program ran. Ratio: RMS error over that of ",
        );
        page.raw("the first run of the same program. Deviation: difference of the angles at the same time since the ");
        page.raw("program's start.</p></footer>");
        Ok(page.end())
    }

    fn table(&self, page: &mut Page, from: Option<&Path>) {
        page.raw("<table><thead><tr><th class=\"text\">run</th><th class=\"text\">experiment</th>");
        page.raw(
            "<th class=\"text\">FREE, gains</th><th class=\"text\">result</th><th>RMS error</th><th>peak error</th>",
        );
        page.raw("<th>final error</th><th>ratio</th><th>highest pressure</th></tr></thead><tbody>");
        for row in &self.rows {
            let clock = if row.stepped { "stepped clock" } else { "real time" };
            let simulated = if row.simulated { "SIMULATED, " } else { "" };
            page.raw(&format!(
                "<tr><td class=\"text id\"><a href=\"{}\">{}</a></td><td class=\"text\">{} <small>{simulated}{clock}</small></td>\
                 <td class=\"text\">{}, {}</td><td class=\"text\">{}</td>",
                escape(&link(from, row)),
                escape(&row.id),
                escape(&row.title),
                escape(&row.free),
                escape(&row.gains),
                row.result,
            ));
            let error = |pick: fn(&ErrorMetrics) -> f64| row.error.as_ref().map(pick).map_or("&ndash;".into(), degrees);
            page.raw(&format!(
                "<td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                error(|e| e.rms_rad),
                error(|e| e.peak_rad),
                error(|e| e.final_rad),
                row.rms_ratio.map_or("&ndash;".into(), |r| format!("{r:.3}")),
                row.highest_pressure_pa.map_or("&ndash;".into(), |p| format!("{:.2} psi", p / PASCAL_PER_PSI)),
            ));
        }
        page.raw("</tbody></table>");
    }

    fn section(&self, page: &mut Page, group: &Group) -> Result<()> {
        page.raw(&format!("<section><h2>{}</h2>", escape(&group.heading)));
        if !group.deviations.is_empty() {
            page.raw("<div class=\"cards\">");
            for d in &group.deviations {
                let of = group.members.iter().find(|(i, _)| self.rows[*i].id == d.run_b);
                let name = match (group.deviations.len(), of) {
                    (2.., Some((i, _))) => format!("RMS deviation of {}", self.label(group, *i)),
                    _ => "RMS deviation".into(),
                };
                let (rms, peak) = (degrees(d.rms_rad), degrees(d.peak_rad));
                page.card(&name, &format!("{rms} <small>{:.2} %, at most {peak}</small>", d.percent_of_range));
            }
            page.raw("</div>");
        }
        let labelled: Vec<(String, &Signals)> = group.members.iter().map(|(i, s)| (self.label(group, *i), s)).collect();
        let angular = labelled.iter().any(|(_, s)| s.quantity == Quantity::Angle);
        if !angular {
            page.figure("Twist against pressure", &figures::sweeps(&labelled).svg()?);
        }
        page.figure("Response", &figures::responses(&labelled).svg()?);
        if angular {
            page.figure("Error", &figures::errors(&labelled).svg()?);
        }
        page.figure("Measured pressure", &figures::pressures(&labelled).svg()?);
        page.raw("</section>");
        Ok(())
    }

    /// What tells the runs of a group apart, shortest first: the gains, the experiment's name, the time.
    fn label(&self, group: &Group, index: usize) -> String {
        let own = &self.rows[index];
        let unique = |of: &dyn Fn(&Row) -> String| {
            let same = group.members.iter().filter(|(i, _)| of(&self.rows[*i]) == of(own)).count();
            (same == 1).then(|| of(own))
        };
        let clock = |row: &Row| if row.stepped { "stepped clock" } else { "real time" };
        unique(&|row| row.gains.clone())
            .or_else(|| unique(&|row| format!("{}, {}", row.gains, clock(row))))
            .or_else(|| unique(&|row| row.title.clone()))
            .unwrap_or_else(|| own.id.split('-').take(2).collect::<Vec<_>>().join("-"))
    }
}

/// The FREE that `run` is about; the first that was asked something where it is about all.
fn primary<'a>(run: &Run, all: &'a Recorded) -> Option<&'a Signals> {
    all.frees.iter().find(|s| s.name == run.start().subject).or(all.frees.first())
}

fn row(run: &Run, all: &Recorded, signals: &Signals) -> Row {
    let predictions: Vec<_> = all.frees.iter().map(prediction::dynamic).collect();
    let metrics = Metrics::from(run, all, &predictions, None);
    let free: Option<&FreeMetrics> = metrics.frees.iter().find(|f| f.free == signals.name);
    let start = run.start();
    Row {
        id: run.id().into(),
        folder: run.folder.clone(),
        title: start.name().into(),
        kind: start.kind,
        free: signals.name.clone(),
        gains: start.gains_name(&signals.name),
        simulated: start.simulated(),
        stepped: start.stepped,
        result: run.result_name(),
        error: free.and_then(|f| f.error),
        rms_ratio: None,
        model_rmsd_rad: free.and_then(|f| f.model_rmsd_rad),
        hysteresis_rad: free.and_then(|f| f.hysteresis_rad),
        highest_pressure_pa: free.and_then(|f| f.highest_pressure_pa),
        deadline_misses: metrics.deadline_misses,
    }
}

/// Deviation of the angle of `b` from that of `a`; `None` where they have no time in common.
fn deviation((run_a, a): (&str, &Signals), (run_b, b): (&str, &Signals)) -> Option<Deviation> {
    let part = |s: &Signals| {
        let (t, y) = (&s.t[s.window.clone()], &s.angle[s.window.clone()]);
        // Without the records that hold no angle, so that none of them spoils its neighbours.
        t.iter().zip(y).filter(|(_, y)| y.is_finite()).map(|(&t, &y)| (t, y)).unzip::<f64, f64, Vec<_>, Vec<_>>()
    };
    let ((ta, ya), (tb, yb)) = (part(a), part(b));
    let from = f64::max(*ta.first()?, *tb.first()?);
    let to = f64::min(*ta.last()?, *tb.last()?);
    let overlap_s = to - from;
    if overlap_s < SHORTEST_OVERLAP {
        return None;
    }
    let step = |t: &[f64]| (t[t.len() - 1] - t[0]) / (t.len() as f64 - 1.0).max(1.0);
    let points = (overlap_s / f64::min(step(&ta), step(&tb))).round().max(1.0) as usize;
    let grid = |i: usize| from + overlap_s * i as f64 / points as f64;
    let both: Vec<(f64, f64)> =
        (0..=points).map(|i| (interpolate(&ta, &ya, grid(i)), interpolate(&tb, &yb, grid(i)))).collect();
    let rms_rad = rms(both.iter().map(|(x, y)| y - x))?;
    let range = range(&both.iter().flat_map(|(x, y)| [*x, *y]).collect::<Vec<_>>())?;
    Some(Deviation {
        run_a: run_a.into(),
        free_a: a.name.clone(),
        run_b: run_b.into(),
        free_b: b.name.clone(),
        rms_rad,
        peak_rad: both.iter().fold(0.0, |peak, (x, y)| f64::max(peak, (y - x).abs())),
        percent_of_range: if range > 0.0 { 100.0 * rms_rad / range } else { 0.0 },
        overlap_s,
    })
}

/// Where the report of `row` is, seen from `from`: runs lie side by side.
fn link(from: Option<&Path>, row: &Row) -> String {
    let report = |folder: String| format!("{folder}/{}", super::run::REPORT_NAME);
    match (from, row.folder.parent()) {
        (Some(from), _) if from == row.folder => super::run::REPORT_NAME.into(),
        (Some(from), Some(runs)) if from == runs => report(row.id.clone()),
        (Some(from), Some(runs)) if from.parent() == Some(runs) => report(format!("../{}", row.id)),
        _ => report(std::path::absolute(&row.folder).unwrap_or_else(|_| row.folder.clone()).display().to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signals(step: f64, n: usize, shift: f64) -> Signals {
        let t: Vec<f64> = (0..n).map(|i| step * i as f64).collect();
        Signals { angle: t.iter().map(|t| 2.0 * t + shift).collect(), window: 0..n, t, ..Signals::default() }
    }

    #[test]
    fn two_histories_are_compared_on_a_common_time_base_either_way() {
        let (a, b) = (signals(0.01, 100, 0.0), signals(0.02, 45, 0.3));
        for (a, b) in [(&a, &b), (&b, &a)] {
            let d = deviation(("a", a), ("b", b)).unwrap();
            assert!((d.rms_rad - 0.3).abs() < 1e-12 && (d.peak_rad - 0.3).abs() < 1e-12);
            assert!((d.overlap_s - 0.88).abs() < 1e-12);
            assert!((d.percent_of_range - 100.0 * 0.3 / (1.76 + 0.3)).abs() < 1e-9);
        }
    }

    #[test]
    fn histories_without_a_time_in_common_are_not_compared() {
        let mut late = signals(0.01, 100, 0.0);
        late.t.iter_mut().for_each(|t| *t += 5.0);
        assert!(deviation(("a", &signals(0.01, 100, 0.0)), ("b", &late)).is_none());
        assert!(deviation(("a", &Signals::default()), ("b", &late)).is_none());
    }
}

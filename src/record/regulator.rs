//! Commands and readings of a regulator in a run, and the page of their fit.

use super::plot::{Line, Plot};
use super::sheet::Sheet;
use super::{Result, Run, palette};
use crate::ident::regulator::{Command, Reading, StairPoint, StaircaseFit, StepsFit};
use crate::units::PASCAL_PER_PSI;

/// What a regulator was told and what it did, over the time since the program's start.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RegulatorRecord {
    /// Every change of the command.
    pub commands: Vec<Command>,
    /// Every reading.
    pub readings: Vec<Reading>,
    /// From, to (s) and reference (Pa) of every hold.
    pub holds: Vec<(f64, f64, f64)>,
}

impl Run {
    /// What the regulator of the FREE `subject` was told and what it did while the program ran.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn regulator_record(&self, subject: usize) -> Result<RegulatorRecord> {
        let mut out = RegulatorRecord::default();
        let mut sequence = None;
        for (record, _) in self.records()? {
            let Some(free) = record.frees().get(subject).filter(|_| record.program_time.is_finite()) else { continue };
            let now = record.program_time;
            if out.commands.last().is_none_or(|last| last.pressure != free.command) {
                out.commands.push(Command { time: now, pressure: free.command });
            }
            let sample = &free.pressure;
            if sequence != Some(sample.sequence) && sample.pressure.is_finite() {
                // The first one seen may have come before the program.
                if sequence.is_some() {
                    let age = record.time.since(sample.time).as_secs_f64();
                    out.readings.push(Reading { time: now - age, pressure: sample.pressure });
                }
                sequence = Some(sample.sequence);
            }
            match out.holds.last_mut() {
                Some(hold) if hold.2 == free.reference.position => hold.1 = now,
                _ => out.holds.push((now, now, free.reference.position)),
            }
        }
        Ok(out)
    }
}

/// The page of `fit`, with `facts` above the drawings.
pub fn regulator_sheet(
    title: &str,
    record: &RegulatorRecord,
    fit: &StepsFit,
    simulated: bool,
    facts: Vec<(String, String)>,
) -> Sheet {
    let time: Vec<f64> = record.readings.iter().map(|r| r.time).collect();
    let fitted = &fit.fitted;
    let psi = |pa: f64| pa / PASCAL_PER_PSI;
    let read: Vec<f64> = record.readings.iter().map(|r| psi(r.pressure)).collect();
    let steps = record.commands.windows(2).flat_map(|w| [w[0], Command { time: w[1].time, ..w[0] }]);
    let (at, commanded): (Vec<f64>, Vec<f64>) = steps.map(|c| (c.time, psi(c.pressure))).unzip();
    let left = read.iter().zip(fitted).map(|(p, f)| p - psi(*f)).collect();
    let plot = |y_label: &str, height, lines| Plot {
        x_label: "time (s)".into(),
        y_label: y_label.into(),
        height,
        lines,
        ..Plot::default()
    };
    let lines = vec![
        Line::new("command", palette::GREY, &at, commanded).width(1),
        Line::new("reading", palette::BLUE, &time, read),
        Line::new("dead time, lag and slew limit", palette::ORANGE, &time, fitted.iter().map(|p| psi(*p)).collect())
            .dashed(),
    ];
    Sheet {
        title: title.into(),
        simulated,
        facts,
        figures: vec![
            ("Steps of the pressure".into(), plot("pressure (psi)", 380, lines)),
            (
                "What the fit leaves over".into(),
                plot("pressure (psi)", 240, vec![Line::new("reading - fit", palette::RED, &time, left)]),
            ),
        ],
        ..Sheet::default()
    }
}

/// The page of the staircase `fit` to readings of a gauge over codes, with `facts` above the drawings.
pub fn gauge_sheet(
    title: &str,
    points: &[StairPoint],
    fit: &StaircaseFit,
    simulated: bool,
    facts: Vec<(String, String)>,
) -> Sheet {
    let code: Vec<f64> = points.iter().map(|p| p.command).collect();
    let psi = |pa: f64| pa / PASCAL_PER_PSI;
    let floor = fit.floor.map_or(f64::NEG_INFINITY, |floor| floor.value);
    let line: Vec<f64> = code.iter().map(|c| psi((fit.zero.value + fit.span.value * c).max(floor))).collect();
    let read: Vec<f64> = points.iter().map(|p| psi(p.pressure)).collect();
    let left = read.iter().zip(&line).map(|(r, l)| r - l).collect();
    let plot = |y_label: &str, height, lines| Plot {
        x_label: "code".into(),
        y_label: y_label.into(),
        height,
        lines,
        ..Plot::default()
    };
    let lines = vec![
        Line::new("gauge, up and down", palette::BLUE, &code, read),
        Line::new("zero and span", palette::ORANGE, &code, line).dashed(),
    ];
    let rest = vec![Line::new("gauge - line", palette::RED, &code, left)];
    Sheet {
        title: title.into(),
        simulated,
        facts,
        figures: vec![
            ("Pressure over the DAC's code".into(), plot("pressure (psi)", 340, lines)),
            ("What the line leaves over".into(), plot("pressure (psi)", 240, rest)),
        ],
        ..Sheet::default()
    }
}

//! Experiment files: what `freerig step`, `trajectory`, `sweep` and `whisk` ask of the FREEs.
//!
//! ```toml
//! kind = "trajectory"            # step, trajectory, sweep or whisk
//! name = "three angles"          # for the record; by default the file's name
//! note = ""
//! repeat = 1
//! gains = "paper-pi"             # other gains than rig.toml's, while it runs
//! free = "paper"                 # by default the one of `--free`, or the rig's only FREE
//! angles_deg = [40, 10, 70]      # or pressures_psi, or temperatures_degc, which a FREE's knob sets
//! shape = "cubic"                # step, linear, cubic, quintic
//! move_s = 1.5                   # to get there ...
//! hold_s = 1.5                   # ... and to stay there
//! and_back = false               # the same values again in reverse: a sweep's default is true
//! ```
//!
//! Several FREEs: one `[[axis]]` each, with `free` and the last six keys. In place of the last five, `segments`
//! says piece by piece what happens, from zero on:
//!
//! ```toml
//! segments = [
//!     { to_deg = 40, shape = "quintic", duration_s = 1.5 },
//!     { hold_s = 2 },
//!     { amplitude_deg = 10, frequency_hz = 0.5, phase_deg = 0, duration_s = 4 },
//! ]
//! ```
//!
//! A whisk has keys of its own ([`super::Whisk`]); what FREEs beside the module do meanwhile is an `[[axis]]` each.
//!
//! An experiment is checked against the rig that is to run it: its FREEs, their limits, their gains.

use std::fmt::Write;
use std::path::Path;

use super::axis::read_axis;
use super::calibration::quoted;
use super::problem::{ConfigError, Problem};
use super::reader::{Section, Source};
use super::rig::Rig;
use super::whisk::{Whisk, read_whisk};
use crate::control::Gains;
use crate::signal::MAX_FREES;
use crate::trajectory::{Axis, Program};
use crate::units::{Angle, Pressure};

/// What kind of experiment it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Steps of the angle.
    Step,
    /// The angle along a trajectory.
    Trajectory,
    /// Quasi-static pressure, up and down.
    Sweep,
    /// The pressures of a module's plan.
    Whisk,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Kind; 4] = [Kind::Step, Kind::Trajectory, Kind::Sweep, Kind::Whisk];

    /// Name in files and of the command.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Step => "step",
            Kind::Trajectory => "trajectory",
            Kind::Sweep => "sweep",
            Kind::Whisk => "whisk",
        }
    }

    /// The kind called `name`.
    pub fn named(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// File name and text of the experiment that is run where none is named: the paper's; a whisk has none, since its
    /// plan belongs to its module.
    pub const fn default_file(self) -> Option<(&'static str, &'static str)> {
        match self {
            Kind::Step => Some(("paper-step.toml", include_str!("../../experiments/paper-step.toml"))),
            Kind::Trajectory => {
                Some(("paper-trajectory.toml", include_str!("../../experiments/paper-trajectory.toml")))
            }
            Kind::Sweep => Some(("sweep.toml", include_str!("../../experiments/sweep.toml"))),
            Kind::Whisk => None,
        }
    }
}

/// An experiment, checked against its rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Experiment {
    /// What kind it is.
    pub kind: Kind,
    /// What a person calls it.
    pub name: String,
    /// A note for the record.
    pub note: String,
    /// How often, at least once.
    pub repeat: u32,
    /// Index of the FREE it is about: that of the first axis.
    pub subject: usize,
    /// Other gains for the subject than the rig's, with their name.
    pub gains: Option<(String, Gains)>,
    /// What is asked of every FREE.
    pub program: Program,
    /// The plan of a whisk.
    pub whisk: Option<Whisk>,
}

impl Experiment {
    /// Reads an experiment for `rig` from `text`, which comes from `path`; `free` is the FREE where the text names
    /// none.
    pub fn parse(path: &Path, text: &str, rig: &Rig, free: Option<&str>) -> Result<Self, ConfigError> {
        let source = Source::new(path, text);
        let experiment = source.parse().and_then(|table| read(Section::root(&source, &table), path, rig, free));
        match (experiment, source.into_problems()) {
            (Some(experiment), problems) if problems.is_empty() => Ok(experiment),
            (_, problems) => Err(ConfigError { problems }),
        }
    }
}

/// Reads the text of the experiment file `path`.
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|error| ConfigError {
        problems: vec![Problem {
            file: path.to_owned(),
            line: None,
            key: String::new(),
            value: String::new(),
            rule: format!("cannot read the experiment: {error}"),
            remedy: "name a file that exists, or leave it out to run the paper's experiment".into(),
        }],
    })
}

/// An experiment as flags give it: values with holds. [`Course::to_toml`] makes a file of it, so that the record of
/// an experiment is always a file that can be run again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Angles to visit, in their order.
    pub angles: Vec<Angle>,
    /// Pressures to visit, in their order, where there are no angles.
    pub pressures: Vec<Pressure>,
    /// Time to get there, s; the kind's default where `None`.
    pub moving: Option<f64>,
    /// Time to stay there, s; the kind's default where `None`.
    pub hold: Option<f64>,
    /// `step`, `linear`, `cubic` or `quintic`; the kind's default where `None`.
    pub shape: Option<String>,
    /// Gains by name.
    pub gains: Option<String>,
}

impl Course {
    /// Whether no flag was given: the default file is meant.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The experiment file that says the same. What was not given is as in the kind's default file.
    pub fn to_toml(&self, kind: Kind) -> String {
        let list = |values: &mut dyn Iterator<Item = f64>| values.map(round).collect::<Vec<_>>().join(", ");
        let (angles, moving, hold) = match kind {
            Kind::Step => ("50, 20, 80", 0.0, 3.0),
            Kind::Trajectory => ("40, 10, 70", 1.5, 1.5),
            Kind::Sweep | Kind::Whisk => ("", 1.0, 2.0),
        };
        let mut text = format!("# From the command line.\nkind = \"{}\"\n", kind.name());
        let mut line = |line: String| {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{line}");
        };
        match (kind, self.angles.is_empty(), self.pressures.is_empty()) {
            (_, false, _) => {
                line(format!("angles_deg = [{}]", list(&mut self.angles.iter().map(|a| a.display_value()))))
            }
            (_, true, false) => {
                line(format!("pressures_psi = [{}]", list(&mut self.pressures.iter().map(|p| p.display_value()))));
            }
            (Kind::Sweep, true, true) => line("pressures_psi = [0, 1, 2, 3, 4, 5]".into()),
            (_, true, true) => line(format!("angles_deg = [{angles}]")),
        }
        line(format!("move_s = {}", self.moving.unwrap_or(moving)));
        line(format!("hold_s = {}", self.hold.unwrap_or(hold)));
        for (key, value) in [("shape", &self.shape), ("gains", &self.gains)] {
            if let Some(value) = value {
                line(format!("{key} = {}", quoted(value)));
            }
        }
        text
    }
}

/// A number as a person would have typed it: the conversion from and to SI leaves some noise at the end.
fn round(value: f64) -> String {
    format!("{}", (value * 1e9).round() / 1e9)
}

fn read(mut root: Section<'_>, path: &Path, rig: &Rig, free: Option<&str>) -> Option<Experiment> {
    let kinds = Kind::ALL.map(|kind| (kind.name(), kind));
    // Without its kind the defaults of the other keys are not known.
    let Some(kind) = root.choice("kind", None, &kinds) else {
        root.accept_rest();
        return None;
    };
    let stem = path.file_stem().map_or_else(|| kind.name().into(), |stem| stem.to_string_lossy().into_owned());
    let name = root.optional_text("name").unwrap_or(stem);
    let note = root.optional_lines("note").unwrap_or_default();
    let repeat = root.integer("repeat", 1, 1..=1000) as u32;
    let (axes, whisk) = match kind {
        Kind::Whisk => {
            let (whisk, mut axes) = read_whisk(&mut root, rig)?;
            match root.has("axis") {
                true => axes.extend(read_axes(&mut root, kind, rig, None)),
                false => root.expect("axis"),
            }
            (axes, Some(Whisk { name: name.clone(), ..whisk }))
        }
        _ => (read_axes(&mut root, kind, rig, free), None),
    };
    let gains = read_gains(&mut root, &axes, rig);
    let subject = axes.first()?.0;
    match Program::new(axes) {
        Ok(program) => Some(Experiment { kind, name, note, repeat, subject, gains, program, whisk }),
        Err(error) => {
            root.reject("axis", error.to_string(), "correct the axis: every FREE at most once");
            None
        }
    }
}

fn read_axes(root: &mut Section<'_>, kind: Kind, rig: &Rig, free: Option<&str>) -> Vec<(usize, Axis)> {
    if !root.has("axis") {
        root.expect("axis");
        return read_axis(root, kind, rig, free).into_iter().collect();
    }
    let sections = root.sections("axis");
    if sections.len() > MAX_FREES {
        root.reject("axis", format!("a rig has at most {MAX_FREES} FREEs"), "remove the others");
    }
    let only = sections.len() == 1;
    sections.into_iter().filter_map(|mut section| read_axis(&mut section, kind, rig, free.filter(|_| only))).collect()
}

fn read_gains(root: &mut Section<'_>, axes: &[(usize, Axis)], rig: &Rig) -> Option<(String, Gains)> {
    let name = root.optional_text("gains")?;
    let &[(free, _)] = axes else {
        if !axes.is_empty() {
            root.reject(
                "gains",
                "is possible with one FREE only",
                "remove it, and set `gains` of each FREE in rig.toml",
            );
        }
        return None;
    };
    let calibration = rig.calibrations.get(free)?;
    let gains = calibration.gains(&name);
    if gains.is_none() {
        let known = calibration.gain_names().collect::<Vec<_>>().join(", ");
        root.reject("gains", format!("there are no gains `{name}`"), format!("write one of: {known}"));
    }
    Some((name, gains?))
}

//! `freerig step`, `trajectory`, `sweep` and `whisk`: an experiment, run by the daemon or, with `--stepped`, here on
//! the simulated rig as fast as the machine can.

use std::path::{Path, PathBuf};

use super::attend;
use super::outcome::{Outcome, Watch};
use super::{Context, Failure};
use crate::config::Rig;
use crate::config::experiment::{Course, Experiment, Kind, read_text};
use crate::daemon::api::{RunResult, Start};
use crate::daemon::experiment::{self, Attendance, Job};
use crate::daemon::{Stepped, procedure};
use crate::signal::Quantity;
use crate::units::{Angle, Pressure, Seconds};

const EXAMPLES: &str = "\
The rig must be armed (`freerig arm`). With --stepped no daemon is needed: the simulated rig runs here, as fast as the \
machine can, the same bits for the same seed.

Examples:
  freerig step                                       the paper's steps: 50, 20, 80 deg
  freerig step --angles 30deg,10deg --hold 4s
  freerig trajectory experiments/paper-trajectory.toml --repeat 5 --note \"after gluing\"
  freerig trajectory --stepped                       at once, on the simulated rig
  freerig sweep --pressures 0psi,2psi,4psi --stepped --seed 7";

const WHISK_EXAMPLES: &str = "\
`freerig plan whisk` writes the plan. The rig must be armed (`freerig arm`). With --stepped no daemon is needed: the \
simulated rig runs here, as fast as the machine can, the same bits for the same seed.

Examples:
  freerig --rig experiments/module/rig.toml plan whisk --output whisk.toml
  freerig --rig experiments/module/rig.toml whisk whisk.toml --stepped
  freerig --rig experiments/module/rig.toml whisk whisk.toml --stepped --open-loop";

/// An angle, rad, that nobody asks for: what shapes and units leave of zero.
const NOISE: f64 = 1e-6;

/// What an experiment takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Experiment file; without it, the paper's experiment or what the flags say
    #[arg(value_name = "FILE.toml", conflicts_with = "Flags")]
    file: Option<PathBuf>,
    #[command(flatten)]
    flags: Flags,
    /// FREE it is about, where the file names none; not needed where the rig has one
    #[arg(long, value_name = "NAME")]
    free: Option<String>,
    /// How often [default: the file's, or 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: Option<u32>,
    /// A note for the record
    #[arg(long, value_name = "TEXT")]
    note: Option<String>,
    /// Run even where the stability margin of the gains is below the stated one
    #[arg(long)]
    accept_margin: bool,
    /// Start it and come back at once: it outlives this terminal
    #[arg(long, conflicts_with = "stepped")]
    detach: bool,
    /// On the simulated rig and the stepped clock, in this process
    #[arg(long)]
    stepped: bool,
    /// Seed of the simulated rig [default: rig.toml's]
    #[arg(long, value_name = "N", requires = "stepped")]
    seed: Option<u64>,
}

/// What a whisk takes.
#[derive(Debug, clap::Args)]
#[command(after_help = WHISK_EXAMPLES, mut_args(of_a_whisk))]
pub struct WhiskArgs {
    #[command(flatten)]
    pub plan: Args,
    /// Run the plan's pressures as they stand; without it the plate is led along the plan's path, where the plan has
    /// one and the plate an IMU
    #[arg(long)]
    pub open_loop: bool,
}

/// In the help of a whisk: its file is a plan, and the flags of a course are not for it.
fn of_a_whisk(arg: clap::Arg) -> clap::Arg {
    match arg.get_id().as_str() {
        "file" => arg.help("The plan, as `freerig plan whisk` writes it"),
        "angles" | "pressures" | "moving" | "hold" | "shape" | "gains" => arg.hide(true),
        _ => arg,
    }
}

/// A course of values in place of a file.
#[derive(Debug, clap::Args)]
struct Flags {
    /// Angles to visit, in their order
    #[arg(long, value_name = "ANGLE,...", value_delimiter = ',', conflicts_with = "pressures")]
    angles: Vec<Angle>,
    /// Pressures to visit, in their order
    #[arg(long, value_name = "PRESSURE,...", value_delimiter = ',')]
    pressures: Vec<Pressure>,
    /// Time to get to each
    #[arg(long = "move", value_name = "TIME")]
    moving: Option<Seconds>,
    /// Time to stay at each
    #[arg(long, value_name = "TIME")]
    hold: Option<Seconds>,
    /// How to get there
    #[arg(long, value_parser = ["step", "linear", "cubic", "quintic"])]
    shape: Option<String>,
    /// Gains by name, while it runs
    #[arg(long, value_name = "NAME")]
    gains: Option<String>,
}

/// Runs the experiment; `open_loop` is about a whisk.
pub fn run(kind: Kind, args: Args, open_loop: bool, context: &Context) -> Result<(), Failure> {
    let mut rig = Rig::load(&context.rig)?;
    let (path, text) = args.text(kind)?;
    let free = args.free.as_deref();
    // Checked here as well, so that every problem is told with its line, whoever runs it.
    let experiment = Experiment::parse(&path, &text, &rig, free)?;
    if experiment.kind != kind {
        let error = anyhow::anyhow!("{} is a {}, not a {}", path.display(), experiment.kind.name(), kind.name());
        return Err(Failure::usage(error).remedy(format!(
            "run `freerig {} {}`",
            experiment.kind.name(),
            path.display()
        )));
    }
    for warning in beyond_pressure(&experiment, &rig) {
        context.note(warning);
    }
    if !args.stepped {
        let start = Start {
            kind: kind.name().into(),
            experiment: text,
            source: Some(path.display().to_string()),
            free: args.free,
            repeat: args.repeat,
            note: args.note,
            hand: None,
            detach: args.detach,
            open_loop,
            accept_margin: args.accept_margin,
        };
        return attend::run(&rig.socket.path, start, context);
    }
    if !rig.is_simulated() {
        let error = anyhow::anyhow!("--stepped runs on simulated devices, and {} has real ones", context.rig.display());
        return Err(
            Failure::usage(error).remedy("set `backend = \"sim\"`, or start the daemon and leave --stepped out")
        );
    }
    if let Some(seed) = args.seed {
        rig.bench.seed = seed;
    }
    let mut job =
        Job { accept_margin: args.accept_margin, stepped: true, open_loop, ..Job::new(experiment, Attendance::Here) };
    job.repeats = args.repeat.unwrap_or(job.repeats);
    job.note = args.note.unwrap_or(job.note);
    stepped(&rig, &job)?.tell(context)
}

/// What is asked of a FREE on the side that its pressure does not turn it to; a load may do it all the same.
fn beyond_pressure(experiment: &Experiment, rig: &Rig) -> Vec<String> {
    let angles = experiment.program.axes.iter().zip(&rig.control.frees).filter_map(|(axis, free)| {
        let axis = axis.as_ref().filter(|axis| axis.quantity == Quantity::Angle)?;
        let (low, high) = axis.sequence.range();
        let (farthest, side) =
            if free.free.direction() > 0.0 { (low.min(0.0), "positive") } else { (high.max(0.0), "negative") };
        (farthest.abs() > NOISE).then(|| {
            format!(
                "warning: {:.1} is asked of `{}`, which pressure turns to {side} angles only: without a load it stays \
                 at 0 deg. Ask for {side} angles, or for 0 deg",
                Angle::radians(farthest),
                free.name
            )
        })
    });
    angles.collect()
}

/// Runs `job` on a simulated rig of its own.
pub fn stepped(rig: &Rig, job: &Job) -> Result<Outcome, Failure> {
    let mut bench = Stepped::new(rig).map_err(Failure::rig)?;
    // Other gains are the job's to check.
    procedure::arm(&mut bench, rig, job.accept_margin || job.gains.is_some()).map_err(Failure::rig)?;
    let mut watch = Watch::new(&job.title, job.subject);
    let runs = experiment::run(&mut bench, rig, job, &mut |progress| watch.show(progress)).map_err(Failure::rig)?;
    drop(watch);
    let results = runs.iter().map(RunResult::of).collect::<Result<_, _>>()?;
    Ok(Outcome::new(results))
}

impl Args {
    /// The experiment's file, or the one that says the same as the flags, and its name for messages.
    fn text(&self, kind: Kind) -> Result<(PathBuf, String), Failure> {
        if let Some(path) = &self.file {
            return Ok((path.clone(), read_text(path)?));
        }
        let course = self.flags.course();
        if course.is_empty() {
            let (name, text) = kind.default_file().ok_or_else(|| {
                Failure::usage(anyhow::anyhow!("a {} needs its plan", kind.name())).remedy(
                    "make one: `freerig plan whisk --output whisk.toml`, and name it: `freerig whisk whisk.toml`",
                )
            })?;
            return Ok((Path::new(name).to_owned(), text.to_owned()));
        }
        Ok((PathBuf::from("command-line.toml"), course.to_toml(kind)))
    }
}

impl Flags {
    fn course(&self) -> Course {
        Course {
            angles: self.angles.clone(),
            pressures: self.pressures.clone(),
            moving: self.moving.map(|t| t.si()),
            hold: self.hold.map(|t| t.si()),
            shape: self.shape.clone(),
            gains: self.gains.clone(),
        }
    }
}

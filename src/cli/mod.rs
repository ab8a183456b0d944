//! The command line: one file per command, each with its `Args` and its `run`; no physics, no device code.
//!
//! # How a command is added
//!
//! One `mod` line and one variant of `Command` below. The command's file holds
//!
//! ```ignore
//! /// What `freerig clear` takes.
//! #[derive(Debug, clap::Args)]
//! #[command(after_long_help = "Examples:\n  freerig clear")]
//! pub struct Args {}
//!
//! pub fn run(args: Args, context: &Context) -> Result<(), Failure> { ... }
//! ```
//!
//! # Rules that hold for all of them
//!
//! - Answers go to stdout ([`Context::print`], [`Context::print_json`]), what the program is doing goes to stderr
//!   ([`Context::note`], [`Progress`]).
//! - With `--json`, stdout is exactly one JSON object: SI units, units in the key names, `null` for no value.
//! - Quantities are typed (`Pressure`, `Angle`, ... of [`crate::units`]): they are parsed with their unit, and may
//!   begin with a minus sign, without any further attribute. A `String` that may begin with one needs
//!   `allow_hyphen_values = true`.
//! - Exit status: 0 done, 1 failed, 2 bad usage or configuration, 3 a fault of the rig ([`Exit`]).

mod arm;
mod attend;
mod bench;
mod calibrate;
mod clear;
mod compare;
mod config;
mod control;
mod demo;
mod demo_whisk;
mod disarm;
mod doctor;
mod estop;
mod experiment;
mod export;
mod failure;
mod free;
mod latency;
mod list;
mod log;
mod model;
mod outcome;
mod plan;
mod progress;
mod report;
mod run;
mod runs;
mod scene;
mod set;
mod simulate;
mod status;
mod table;
mod tube;
mod tune;
mod vent;

use std::fmt::Display;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

pub use failure::{Exit, Failure};
pub use progress::Progress;

use crate::config::experiment::Kind;

const LONG_ABOUT: &str = "\
Controller of a soft-robotics bench: drives FREEs (fiber-reinforced elastomeric enclosures) along trajectories from a \
real-time thread, identifies and models them, and records every experiment.

The rig is described by rig.toml; with `backend = \"sim\"`, the default, everything runs on simulated devices behind \
the real drivers, and says SIMULATED.";

/// The commands as the help groups them.
const GROUPS: [(&str, &[&str]); 6] = [
    ("Start here", &["demo", "config", "doctor"]),
    ("The rig and its daemon", &["run", "status", "arm", "set", "disarm", "estop", "clear", "vent"]),
    (
        "Experiments, on the armed rig, or without a daemon with --stepped",
        &["step", "trajectory", "sweep", "whisk", "calibrate"],
    ),
    ("What has been recorded", &["runs", "report", "compare", "export"]),
    ("Models, plans and gains, without a rig", &["model", "plan", "simulate", "tune"]),
    ("What this machine and freerig are worth", &["latency", "bench"]),
];

const EXAMPLES: &str = "\
The first hour, without any hardware:
  freerig demo                              ends with the path of its report
  freerig step --angles 30deg,10deg --stepped
  freerig run                               the daemon: leave it there, and in another terminal
  freerig arm && freerig trajectory && freerig disarm
  freerig report latest

`freerig COMMAND --help` has the examples of a command. Quantities carry their unit: `7psi`, `-40deg`, `130mm`, `10ms`.

Exit status: 0 done, 1 failed, 2 bad usage or configuration, 3 a fault of the rig.";

#[derive(Debug, Parser)]
#[command(name = "freerig", version, about, long_about = LONG_ABOUT, after_help = EXAMPLES)]
#[command(propagate_version = true, subcommand_required = true, arg_required_else_help = true)]
struct Cli {
    #[command(flatten)]
    context: Context,
    #[command(subcommand)]
    command: Command,
}

/// Every command; the help has them by [`GROUPS`].
#[derive(Debug, Subcommand)]
enum Command {
    /// The whole job on the simulated rig, no daemon needed
    Demo(demo::Args),
    /// The daemon, in the foreground
    Run(run::Args),
    /// Where the rig stands; --watch follows it
    Status(status::Args),
    /// Self-test, vent check, tare; the pressures may then be anything within the limits
    Arm(arm::Args),
    /// Take the pressures down and disarm
    Disarm(disarm::Args),
    /// Emergency stop: vent at once
    Estop(estop::Args),
    /// Check the causes of latched faults again and clear them
    Clear(clear::Args),
    /// Without a daemon: command zero on every path and verify
    Vent(vent::Args),
    /// One pressure, angle or knob's temperature by hand, within the limits
    Set(set::Args),
    /// Steps of the angle; by default the paper's: 50, 20, 80 deg
    Step(experiment::Args),
    /// The angle along a course; by default the paper's: 40, 10, 70 deg
    Trajectory(experiment::Args),
    /// Quasi-static pressure up and down: twist against pressure with its hysteresis
    Sweep(experiment::Args),
    /// A module's whisk, as `freerig plan whisk` has written it
    Whisk(experiment::WhiskArgs),
    /// Measure what is not known of a FREE, and put it into its calibration
    Calibrate(calibrate::Args),
    /// Root locus; gains with the damping and the margins asked for
    Tune(tune::Args),
    /// List what has been run
    Runs(runs::Args),
    /// Make a run's report again and print its figures
    Report(report::Args),
    /// Run the lumped model of a FREE, alone or in a loop with its controller
    Simulate(simulate::Args),
    /// What geometry and material alone say of a FREE, or of a module of four
    Model(model::Args),
    /// What to command, what can be reached, and what to build
    Plan(plan::Args),
    /// Compare two runs: RMS deviation, ratio of the tracking errors, overlay plot
    Compare(compare::Args),
    /// Write a run's records as CSV or Parquet
    Export(export::Args),
    /// Wake-up latency and jitter of this machine
    Latency(latency::Args),
    /// Speed against error of what freerig computes: table, CSV and plot
    Bench(bench::Args),
    /// Real-time rights, kernel, buses, serial ports, sensors, disk: each with its remedy
    Doctor(doctor::Args),
    /// Check rig.toml and everything it refers to
    Config(config::Args),
}

impl Command {
    fn run(self, context: &Context) -> Result<(), Failure> {
        match self {
            Command::Demo(args) => demo::run(args, context),
            Command::Run(args) => run::run(args, context),
            Command::Status(args) => status::run(args, context),
            Command::Arm(args) => arm::run(args, context),
            Command::Disarm(args) => disarm::run(args, context),
            Command::Estop(args) => estop::run(args, context),
            Command::Clear(args) => clear::run(args, context),
            Command::Vent(args) => vent::run(args, context),
            Command::Set(args) => set::run(args, context),
            Command::Step(args) => experiment::run(Kind::Step, args, false, context),
            Command::Trajectory(args) => experiment::run(Kind::Trajectory, args, false, context),
            Command::Sweep(args) => experiment::run(Kind::Sweep, args, false, context),
            Command::Whisk(args) => experiment::run(Kind::Whisk, args.plan, args.open_loop, context),
            Command::Calibrate(args) => calibrate::run(args, context),
            Command::Tune(args) => tune::run(args, context),
            Command::Runs(args) => runs::run(args, context),
            Command::Report(args) => report::run(args, context),
            Command::Simulate(args) => simulate::run(args, context),
            Command::Model(args) => model::run(args, context),
            Command::Plan(args) => plan::run(args, context),
            Command::Compare(args) => compare::run(args, context),
            Command::Export(args) => export::run(args, context),
            Command::Latency(args) => latency::run(args, context),
            Command::Bench(args) => bench::run(args, context),
            Command::Doctor(args) => doctor::run(args, context),
            Command::Config(args) => config::run(args, context),
        }
    }
}

/// What every command is given.
#[derive(Clone, Debug, clap::Args)]
pub struct Context {
    /// The rig's description
    #[arg(long, global = true, value_name = "FILE", default_value = "rig.toml", display_order = 900)]
    pub rig: PathBuf,
    /// Print one JSON object (SI units, units in the key names) instead of text
    #[arg(long, global = true, display_order = 901)]
    pub json: bool,
}

impl Context {
    /// Prints the answer on stdout. A reader that has gone (`| head`) is no error.
    pub fn print(&self, text: impl Display) -> Result<(), Failure> {
        match writeln!(io::stdout().lock(), "{text}") {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
            other => Ok(other?),
        }
    }

    /// Prints `value` on stdout as one JSON object. Numbers that are not finite become `null`.
    pub fn print_json(&self, value: &impl serde::Serialize) -> Result<(), Failure> {
        self.print(serde_json::to_string_pretty(value)?)
    }

    /// Says on stderr what the program is doing.
    pub fn note(&self, text: impl Display) {
        // Nothing sensible is left to do when even stderr is gone.
        let _ = writeln!(io::stderr().lock(), "{text}");
    }
}

/// The program: parse, dispatch, print the final error with its remedy.
pub fn main() -> ExitCode {
    let outcome = command()
        .try_get_matches()
        .and_then(|matches| Cli::from_arg_matches(&matches))
        .map_err(|error| error.format(&mut command()));
    let cli = match outcome {
        Ok(cli) => cli,
        // Help and version go to stdout with status 0, bad usage to stderr with status 2.
        Err(error) => error.exit(),
    };
    match cli.command.run(&cli.context) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            cli.context.note(&failure);
            failure.exit.into()
        }
    }
}

/// The clap command, its commands grouped in the help, with the rule that a quantity may begin with a minus sign
/// applied throughout.
pub fn command() -> clap::Command {
    grouped(signed_quantities(Cli::command()))
}

/// With the commands of [`GROUPS`] in place of clap's one list.
fn grouped(command: clap::Command) -> clap::Command {
    let mut help = String::from("{about-with-newline}\n{usage-heading} {usage}\n");
    for (heading, names) in GROUPS {
        help += &format!("\n{heading}:\n");
        for name in names {
            let about = command.find_subcommand(name).and_then(clap::Command::get_about);
            help += &format!("  {name:<12}{}\n", about.map(ToString::to_string).unwrap_or_default());
        }
    }
    command.help_template(help + "\nOptions:\n{options}{after-help}")
}

fn signed_quantities(command: clap::Command) -> clap::Command {
    command
        .mut_args(|arg| if takes_a_quantity(&arg) { arg.allow_hyphen_values(true) } else { arg })
        .mut_subcommands(signed_quantities)
}

fn takes_a_quantity(arg: &clap::Arg) -> bool {
    use std::any::TypeId;

    use crate::units::{Angle, Force, Frequency, Length, Mass, Moment, Percent, Pressure, PressureRate, Seconds};

    let kind = arg.get_value_parser().type_id();
    [
        TypeId::of::<f64>(),
        TypeId::of::<Angle>(),
        TypeId::of::<Force>(),
        TypeId::of::<Frequency>(),
        TypeId::of::<Length>(),
        TypeId::of::<Mass>(),
        TypeId::of::<Moment>(),
        TypeId::of::<Percent>(),
        TypeId::of::<Pressure>(),
        TypeId::of::<PressureRate>(),
        TypeId::of::<Seconds>(),
    ]
    .iter()
    .any(|quantity| kind == *quantity)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_well_formed() {
        command().debug_assert();
    }

    #[test]
    fn the_help_has_every_command_in_one_group() {
        let mut grouped: Vec<_> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        let command = command();
        let mut all: Vec<_> = command.get_subcommands().map(clap::Command::get_name).collect();
        grouped.sort_unstable();
        all.sort_unstable();
        assert_eq!(grouped, all);
    }
}

//! `freerig config check`: every problem of the configuration at once.

use std::fmt::Write;

use clap::Subcommand;
use serde_json::json;

use super::{Context, Failure};
use crate::config::Rig;
use crate::units::{Angle, Pressure};

/// What `freerig config` takes.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List every problem of rig.toml and of the files it refers to, or say what the rig is
    ///
    /// Nothing is opened but the files, and nothing is changed. Exit status 2 if there is a problem.
    #[command(
        after_help = "Examples:\n  freerig config check\n  freerig config check --rig /etc/freerig/rig.toml --json"
    )]
    Check,
}

/// Checks the configuration.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    match args.action {
        Action::Check => check(context),
    }
}

fn check(context: &Context) -> Result<(), Failure> {
    match (Rig::load(&context.rig), context.json) {
        (Ok(rig), true) => context.print_json(&summary(&rig)),
        (Ok(rig), false) => context.print(describe(&rig)),
        (Err(error), true) => {
            context.print_json(&json!({ "valid": false, "problems": error.problems }))?;
            Err(error.into())
        }
        (Err(error), false) => Err(error.into()),
    }
}

fn summary(rig: &Rig) -> serde_json::Value {
    let frees: Vec<_> = rig
        .control
        .frees
        .iter()
        .zip(&rig.calibrations)
        .map(|(free, calibration)| {
            json!({
                "name": free.name,
                "calibration": calibration.name,
                "imu": free.imu.is_some(),
                "measures_pressure": free.regulator.measures,
                "pressure_max_pa": free.limits.pressure_max,
                "pressure_warn_pa": free.limits.pressure_warn,
                "pressure_hard_pa": free.limits.pressure_hard,
                "angle_soft_rad": free.limits.angle_soft,
                "angle_hard_rad": free.limits.angle_hard,
                "proportional_pa_per_rad": free.gains.proportional,
                "integral_pa_per_rad_s": free.gains.integral,
                "derivative_pa_s_per_rad": free.gains.derivative,
            })
        })
        .collect();
    let files: Vec<_> = rig.files.iter().map(|file| json!({ "path": file.path, "sha256": file.sha256() })).collect();
    json!({
        "valid": true,
        "problems": [],
        "name": rig.name,
        "backend": rig.backend.name(),
        "simulated": rig.is_simulated(),
        "period_s": rig.realtime.period.as_secs_f64(),
        "frees": frees,
        "files": files,
    })
}

fn describe(rig: &Rig) -> String {
    let mut text = format!(
        "{}: no problem\n{}, backend {}, {:.0} Hz",
        rig.files.first().map_or_else(String::new, |file| file.path.display().to_string()),
        rig.name,
        if rig.is_simulated() { "sim (SIMULATED)" } else { rig.backend.name() },
        1.0 / rig.realtime.period.as_secs_f64(),
    );
    for (free, calibration) in rig.control.frees.iter().zip(&rig.calibrations) {
        let limits = &free.limits;
        let (low, high) = limits.angle_soft;
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\nFREE {}: calibration {}, at most {:.1} (warn {:.1}, vent {:.1}), {:.0} to {:.0}, {}",
            free.name,
            calibration.name,
            Pressure::pascals(limits.pressure_max),
            Pressure::pascals(limits.pressure_warn),
            Pressure::pascals(limits.pressure_hard),
            Angle::radians(low),
            Angle::radians(high),
            if free.imu.is_some() { "with an IMU" } else { "without an IMU (open loop only)" },
        );
    }
    text
}

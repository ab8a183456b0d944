//! `freerig status`: where the rig stands.

use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write as _};
use std::time::Duration;

use anyhow::anyhow;

use super::{Context, Failure, control};
use crate::daemon::api::{DeviceStatus, FreeStatus, Run, Status};
use crate::daemon::client::Client;
use crate::signal::FaultCode;
use crate::units::{Angle, Pressure, Temperature};

/// Shortest time between two screens, or two lines.
const REFRESH: Duration = Duration::from_millis(200);
const LINES: Duration = Duration::from_secs(1);

/// What `freerig status` takes.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "With --watch and --json, every change is one JSON object on a line of its own.\n\nExamples:\n  freerig status\n  freerig status --watch\n  freerig status --json | jq .state"
)]
pub struct Args {
    /// Follow it until interrupted
    #[arg(long)]
    watch: bool,
}

/// Prints the status, once or again and again.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let client = control::client(context)?;
    if args.watch {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        return runtime.block_on(watch(&client, context));
    }
    let status = control::wait(client.status())?;
    if context.json { context.print_json(&status) } else { context.print(describe(&status)) }
}

async fn watch(client: &Client, context: &Context) -> Result<(), Failure> {
    let mut changes = client.watch().await.map_err(Failure::client)?;
    let terminal = io::stdout().is_terminal();
    let mut shown: Option<(tokio::time::Instant, String)> = None;
    if terminal && !context.json {
        write!(io::stdout().lock(), "\x1b[2J")?;
    }
    while let Some(status) = changes.next().await.map_err(Failure::client)? {
        if context.json {
            context.print(serde_json::to_string(&status)?)?;
            continue;
        }
        let period = if terminal { REFRESH } else { LINES };
        let happening = happening(&status);
        if shown.as_ref().is_some_and(|(at, before)| *before == happening && at.elapsed() < period) {
            continue;
        }
        shown = Some((tokio::time::Instant::now(), happening));
        if terminal {
            // Home, every line to its end, then the rest of the screen: without a flicker.
            let text = describe(&status).replace('\n', "\x1b[K\n");
            write!(io::stdout().lock(), "\x1b[H{text}\x1b[K\n\x1b[J")?;
        } else {
            context.print(in_a_line(&status))?;
        }
    }
    Err(Failure::failed(anyhow!("the daemon has ended")).remedy("its log says why; `freerig run` starts it again"))
}

/// What is worth a line at once when it changes.
fn happening(status: &Status) -> String {
    let faults: Vec<_> = status.faults.iter().map(|fault| fault.name.as_str()).collect();
    let run = status.run.as_ref().map(|run| format!("{} {}", run.id, run.phase));
    format!("{} {} {}", status.state, faults.join(" "), run.unwrap_or_default())
}

fn in_a_line(status: &Status) -> String {
    let mut line = status.state.clone();
    for free in &status.frees {
        let _ = write!(line, "; {}: {}, {}", free.name, angle(free.angle_rad), pressure(free.pressure_pa));
    }
    for fault in &status.faults {
        let _ = write!(line, "; {}", fault.name);
    }
    if let Some(run) = &status.run {
        let _ = write!(line, "; {}: {}", run.id, progress(run));
    }
    if status.simulated { format!("SIMULATED {line}") } else { line }
}

fn describe(status: &Status) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let mut line = |line: String| {
        let _ = writeln!(text, "{}", line.trim_end());
    };
    let simulated = if status.simulated { ", SIMULATED" } else { "" };
    line(format!(
        "{}: {}{simulated}; freerig {}, up {}",
        status.rig,
        status.state.replace('_', " "),
        status.version,
        duration(status.uptime_s)
    ));
    for fault in &status.faults {
        let about = fault.free.as_ref().map(|free| format!(" ({free})")).unwrap_or_default();
        let kind = match (fault.latched, fault.active) {
            (true, true) if fault.code != FaultCode::EmergencyStop as u8 => "fault, its cause is still there",
            (true, _) => "fault, latched",
            (false, _) => "warning",
        };
        line(format!("{kind}: {}{about}\n  {}", fault.name, fault.remedy));
    }
    if let Some(run) = &status.run {
        let times = if run.repeats > 1 { format!(", {} of {}", run.repeat, run.repeats) } else { String::new() };
        let attended = if run.attended { "" } else { ", detached" };
        line(format!("\nrun {}: {} \"{}\"{times}{attended}", run.id, run.kind, run.name));
        line(format!("  {}", progress(run)));
    }
    line(format!(
        "\n{:<12} {:>11} {:>11} {:>12} {:>10} {:>10}  limits in force",
        "FREE", "angle", "reference", "rate", "pressure", "command"
    ));
    for free in &status.frees {
        line(row(free));
    }
    line(String::new());
    for free in &status.frees {
        for device in free.devices() {
            line(format!("{:<12} {}", free.name, describe_device(device)));
        }
    }
    for (free, temperature) in status.frees.iter().filter_map(|free| Some((free, free.temperature_degc?))) {
        line(format!("{:<12} its knob sets {:.1}", free.name, Temperature::celsius(temperature)));
    }
    for (free, cycles) in status.frees.iter().filter_map(|free| Some((free, free.pressure_cycles?))) {
        line(format!("{:<12} {cycles} pressure cycles", free.name));
    }
    line(format!("{:<12} {}", "loop", describe_loop(status)));
    for refused in &status.tick.refused {
        line(format!("{:<12} {refused}", ""));
    }
    if let Some(url) = &status.live_view {
        line(format!("{:<12} {url}", "live view"));
    }
    text.truncate(text.trim_end().len());
    text
}

fn progress(run: &Run) -> String {
    match run.duration_s {
        duration if duration > 0.0 => format!("{}: {:.1} of {duration:.1} s", run.phase, run.elapsed_s),
        _ => run.phase.clone(),
    }
}

fn row(free: &FreeStatus) -> String {
    let reference = match (free.reference_rad, free.reference_pa) {
        (Some(reference), _) => angle(Some(reference)),
        (None, reference) => pressure(reference),
    };
    let rate = free.rate_rad_s.map_or_else(|| "-".into(), |rate| format!("{:.1}/s", Angle::radians(rate)));
    let command = pressure(Some(free.command_pa));
    let (angle, pressure) = (angle(free.angle_rad), pressure(free.pressure_pa));
    let limits = free.limits.join(", ");
    format!("{:<12} {angle:>11} {reference:>11} {rate:>12} {pressure:>10} {command:>10}  {limits}", free.name)
}

fn describe_device(device: &DeviceStatus) -> String {
    let age = device.age_s.map(|age| format!(", {:.0} ms old", 1e3 * age)).unwrap_or_default();
    let mut text = format!("{}: {}{age}, {} readings", device.device, device.health, device.reads);
    let counts = [
        ("retries", device.retries),
        ("errors", device.errors),
        ("implausible", device.implausible),
        ("resets", device.resets),
        ("reset line pulled", device.pulls),
        ("reopened", device.reopens),
        ("losses", device.losses),
    ];
    let line = device.line.as_ref().map(|line| {
        [
            ("timeouts", line.timeouts),
            ("late frames", line.late_frames),
            ("malformed", line.malformed),
            ("rejected", line.rejected),
            ("echo mismatches", line.echo_mismatches),
            ("unknown tokens", line.unknown_tokens),
        ]
    });
    for (name, count) in counts.into_iter().chain(line.into_iter().flatten()).filter(|(_, count)| *count > 0) {
        let _ = write!(text, ", {count} {name}");
    }
    if let Some(error) = &device.last_error {
        let _ = write!(text, "; last error: {error}");
    }
    text
}

fn describe_loop(status: &Status) -> String {
    let tick = &status.tick;
    let micros = |value: Option<f64>| value.map_or_else(|| "-".into(), |v| format!("{:.0} us", 1e6 * v));
    format!(
        "{:.0} Hz, wake-up p50 {}, p99 {}, max {}; tick p99 {}; {} of {} periods skipped; {}",
        tick.rate_hz,
        micros(tick.latency.p50_s),
        micros(tick.latency.p99_s),
        micros(tick.latency.max_s),
        micros(tick.execution.p99_s),
        tick.skipped,
        tick.ticks + tick.skipped,
        if tick.realtime { "real-time" } else { "NOT REAL-TIME" },
    )
}

fn angle(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{:.1}", Angle::radians(value)))
}

fn pressure(value: Option<f64>) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{:.2}", Pressure::pascals(value)))
}

fn duration(seconds: f64) -> String {
    let total = seconds as u64;
    let (hours, minutes, seconds) = (total / 3600, total / 60 % 60, total % 60);
    match (hours, minutes) {
        (0, 0) => format!("{seconds} s"),
        (0, _) => format!("{minutes} min {seconds} s"),
        _ => format!("{hours} h {minutes} min"),
    }
}

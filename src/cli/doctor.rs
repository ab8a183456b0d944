//! `freerig doctor`: what keeps this machine from running the rig.

use anyhow::anyhow;
use serde_json::{Value, json};

use super::{Context, Failure};
use crate::config::Rig;
use crate::daemon::doctor::{Finding, Level, Treatment, examine};

const EXAMPLES: &str = "\
Examples:
  freerig doctor
  freerig doctor --rig /etc/freerig/rig.toml --json
  freerig doctor --program-dac              with the supply air cut: see to it that the DAC starts at zero

Exit status: 0 if nothing failed (there may be warnings), 1 if something did.";

/// What `freerig doctor` takes.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Program the EEPROM of every DAC that would start with pressure; cut the supply air first
    #[arg(long)]
    program_dac: bool,
}

/// Looks and prints, each finding as soon as it is there.
pub fn run(args: Args, context: &Context) -> Result<(), Failure> {
    let rig = Rig::load(&context.rig);
    let mut findings: Vec<Finding> = Vec::new();
    let mut printed = Ok(());
    examine(&rig, Treatment { program_dac: args.program_dac }, &mut |finding| {
        if !context.json && printed.is_ok() {
            printed = context.print(&finding);
        }
        findings.push(finding);
    });
    printed?;
    let count = |level| findings.iter().filter(|finding| finding.level == level).count();
    let (failed, warned) = (count(Level::Fail), count(Level::Warn));
    if context.json {
        let simulated = rig.as_ref().ok().map(Rig::is_simulated);
        context.print_json(&summary(&findings, simulated))?;
    } else {
        context.print(format!("\n{} ok, {warned} to improve, {failed} failed", count(Level::Ok)))?;
    }
    match failed {
        0 => Ok(()),
        1 => Err(Failure::failed(anyhow!("this machine cannot run the rig as it is: 1 check failed"))),
        _ => Err(Failure::failed(anyhow!("this machine cannot run the rig as it is: {failed} checks failed"))),
    }
}

fn summary(findings: &[Finding], simulated: Option<bool>) -> Value {
    let rows: Vec<_> = findings
        .iter()
        .map(|finding| {
            json!({
                "subject": finding.subject,
                "level": finding.level.name(),
                "found": finding.found,
                "remedy": finding.remedy,
            })
        })
        .collect();
    let worst = findings.iter().map(|finding| finding.level).max().unwrap_or(Level::Ok);
    json!({ "level": worst.name(), "simulated": simulated, "findings": rows })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_finding_is_the_verdict() {
        let findings = [Finding::ok("a", "b"), Finding::fail("c", "d", "e"), Finding::warn("f", "g", "h")];
        let value = summary(&findings, Some(true));
        assert_eq!((&value["level"], &value["findings"][0]["remedy"]), (&json!("fail"), &Value::Null));
        assert_eq!(value["findings"][1]["remedy"], json!("e"));
    }
}

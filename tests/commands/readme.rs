//! The README says what the program does: its tables are held to the code.

use freerig::config::calibration::SCHEMA;
use freerig::config::gains::PRESETS;
use freerig::control::{MATRIX, Reaction};

const README: &str = include_str!("../../README.md");

#[track_caller]
fn contains(table: &str) {
    assert!(README.contains(table), "the README must contain this table:\n\n{table}");
}

fn reaction(reaction: Reaction) -> &'static str {
    match reaction {
        Reaction::None => "none",
        Reaction::Warn => "warn",
        Reaction::Hold => "hold",
        Reaction::Ramp => "ramp down",
        Reaction::Vent => "vent",
    }
}

#[test]
fn the_fault_table_is_the_programs_matrix() {
    let mut table = String::from(
        "| code | name | condition | debounce | reaction | remedy |\n| --: | --- | --- | --- | --- | --- |\n",
    );
    for row in &MATRIX {
        let (first, then) = (reaction(row.reaction), reaction(row.then));
        let both = if first == then { first.to_owned() } else { format!("{first}, then {then}") };
        let (code, name) = (row.code as u8, row.code.name());
        table += &format!("| {code} | `{name}` | {} | {} | {both} | {} |\n", row.condition, row.debounce, row.remedy);
    }
    contains(&table);
}

#[test]
fn the_calibration_table_is_the_programs_schema() {
    let mut table = String::from("| section | key | range | meaning |\n| --- | --- | --- | --- |\n");
    for key in SCHEMA {
        let required = if key.required { "" } else { " (optional)" };
        let (low, high) = key.range;
        table += &format!("| {} | `{}` | {low} to {high} | {}{required} |\n", key.section, key.name, key.meaning);
    }
    contains(&table);
}

#[test]
fn the_gain_table_is_the_programs_presets() {
    let mut table = String::from(
        "| name | Kp, Pa/rad | Ki, Pa/(rad s) | Kd, Pa s/rad | what it is |\n| --- | --: | --: | --: | --- |\n",
    );
    for (name, gains, meaning) in PRESETS {
        let (p, i, d) = (gains.proportional, gains.integral, gains.derivative);
        table += &format!("| `{name}` | {p} | {i} | {d} | {meaning} |\n");
    }
    contains(&table);
}

#[test]
fn every_command_is_in_the_command_table() {
    for command in freerig::cli::command().get_subcommands() {
        let name = command.get_name();
        assert!(
            README.lines().any(|line| line.starts_with(&format!("| `freerig {name}"))),
            "`freerig {name}` is missing in the README's command table"
        );
    }
}

//! Experiments and whisks: what is accepted stays within the limits of its FREEs.

use std::path::Path;

use freerig::config::Rig;
use freerig::config::experiment::Experiment;
use freerig::signal::Quantity;

use super::{explained, feed, files, here};

const WORDS: [&str; 16] = [
    "kind = \"sweep\"\n",
    "kind = \"step\"\n",
    "kind = \"whisk\"\n",
    "angles_deg = [10]\n",
    "pressures_psi = [1]\n",
    "hold_s = 1\n",
    "move_s = 0\n",
    "and_back = true\n",
    "[[axis]]\n",
    "{ to_deg = 1 }, ",
    "{ hold_s = 1 }, ",
    "repeat = 1000\n",
    "gains = \"paper-pi\"\n",
    ", 1",
    "shape = \"step\"\n",
    "periods = 10000\n",
];

#[test]
fn whatever_a_plan_says_is_refused_with_its_rules_or_keeps_within_the_limits() {
    let load = |path: &str| Rig::load(&here().join(path)).unwrap();
    let rigs = [load("rig.toml"), load("experiments/module/rig.toml")];
    let accepted = feed(files(&["experiments", "tests/abuse/corpus/plans"]), &WORDS, 4000, |bytes| {
        let Ok(text) = std::str::from_utf8(bytes) else { return false };
        let mut accepted = false;
        for rig in &rigs {
            let free = rig.free_names().next();
            match Experiment::parse(Path::new("plan.toml"), text, rig, free) {
                Err(error) => explained(&error),
                Ok(experiment) => {
                    accepted = true;
                    within_the_limits(&experiment, rig);
                }
            }
        }
        accepted
    });
    assert!(accepted > 300, "only {accepted} are accepted: the mutations are too wild to say anything");
}

fn within_the_limits(experiment: &Experiment, rig: &Rig) {
    let program = &experiment.program;
    assert!(program.duration.is_finite() && program.duration > 0.0, "{}", program.duration);
    assert!((1..=1000).contains(&experiment.repeat) && experiment.subject < rig.control.frees.len());
    for (index, free) in rig.control.frees.iter().enumerate() {
        for step in 0..=100 {
            let reference = program.reference(index, program.duration * f64::from(step) / 100.0);
            let value = reference.position;
            let (low, high) = match reference.quantity {
                Quantity::Angle => free.limits.angle_soft,
                Quantity::Pressure => (0.0, free.limits.pressure_max),
                _ => continue,
            };
            let room = 1e-9 * (high - low);
            assert!((low - room..=high + room).contains(&value), "{value} is outside {low} to {high}");
        }
    }
}

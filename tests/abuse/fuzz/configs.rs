//! rig.toml: what is accepted starts.

use std::time::Duration;

use freerig::config::Rig;
use freerig::daemon::{Bench, Stepped};

use super::{Written, explained, feed, files, here};

const WORDS: [&str; 14] = [
    "true",
    "false",
    "\"sim\"",
    "\"linux\"",
    "[[free]]\n",
    "[module]\n",
    "[gpio]\n",
    "\"\"",
    "[]",
    "{}",
    "\"pid\"",
    "\"mcp4728\"",
    "= -1\n",
    "\u{1b}[2J",
];

#[test]
fn whatever_rig_toml_says_is_refused_with_its_rules_or_starts() {
    let file = Written::new("rig.toml");
    let folder = file.folder.path();
    std::fs::create_dir(folder.join("calibration")).unwrap();
    for name in ["paper", "published-code"] {
        let from = here().join(format!("calibration/{name}.toml"));
        std::fs::copy(from, folder.join(format!("calibration/{name}.toml"))).unwrap();
    }
    let seeds = files(&["rig.toml", "tests/abuse/corpus/rig"]);
    let accepted = feed(seeds, &WORDS, 1500, |bytes| match Rig::load(file.with(bytes)) {
        Err(error) => {
            explained(&error);
            false
        }
        Ok(rig) => {
            within_its_rules(&rig);
            if rig.is_simulated() && rig.module.is_none() {
                let mut bench =
                    Stepped::new(&rig).unwrap_or_else(|error| panic!("accepted, but does not start: {error}"));
                bench.pass(Duration::from_millis(20)).unwrap();
                assert!(bench.latest().frees().iter().all(|free| free.command == 0.0));
            }
            true
        }
    });
    assert!(accepted > 100, "only {accepted} are accepted: the mutations are too wild to say anything");
}

fn within_its_rules(rig: &Rig) {
    let control = &rig.control;
    assert!((Duration::from_micros(250)..=Duration::from_millis(20)).contains(&control.period), "{:?}", control.period);
    assert!(!control.frees.is_empty() && control.frees.len() <= freerig::signal::MAX_FREES);
    for free in &control.frees {
        let limits = &free.limits;
        let rising = [0.0, limits.pressure_zero, limits.pressure_max, limits.pressure_warn, limits.pressure_hard];
        assert!(rising.windows(2).all(|pair| pair[0] < pair[1] && pair[1].is_finite()), "{rising:?}");
        assert!(limits.slew > 0.0 && limits.angle_soft.0 < limits.angle_soft.1);
        // A ramp down must be able to keep to its time.
        assert!(limits.slew * control.ramp_time.as_secs_f64() >= limits.pressure_max * (1.0 - 1e-9));
    }
    let names: std::collections::BTreeSet<_> = rig.free_names().collect();
    assert_eq!(names.len(), control.frees.len());
    assert!(rig.free_names().all(|name| !name.is_empty() && !name.contains(['/', '\0', '\n'])), "{names:?}");
}

//! The example module, and plans for it.

use std::fs;
use std::path::Path;

use freerig::config::experiment::Experiment;
use freerig::config::{Cache, Rig, Whisk};
use freerig::fem::rod::Resolution;
use freerig::fem::section::Mesh;
use freerig::plan::whisk::{Eight, eight};
use freerig::plan::{Limits, Rest};
use freerig::units::PASCAL_PER_PSI as PSI;
use tempfile::TempDir;

/// The example module with other values: each a text of its rig.toml and what takes its place.
pub fn rig(changes: &[(&str, &str)]) -> (TempDir, Rig) {
    let folder = TempDir::new().unwrap();
    let calibrations = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration");
    let mut text = fs::read_to_string("experiments/module/rig.toml").unwrap();
    let runs = folder.path().join("runs");
    text = text.replace("\"../../calibration\"", &format!("{calibrations:?}"));
    text = text.replacen("[loop]", &format!("[record]\ndirectory = {runs:?}\nlive_view = false\n\n[loop]"), 1);
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let path = folder.path().join("rig.toml");
    fs::write(&path, text).unwrap();
    let rig = Rig::load(&path).unwrap_or_else(|error| panic!("{error}"));
    (folder, rig)
}

pub fn parse(text: &str, rig: &Rig) -> Result<Experiment, String> {
    Experiment::parse(Path::new("whisk.toml"), text, rig, None).map_err(|error| error.to_string())
}

/// Width of the eight, m.
pub const WIDTH: f64 = 8e-3;

/// The eight of `freerig plan whisk`, a quarter of it a second, in fewer samples.
pub fn plan(rig: &Rig, periods: u32) -> Whisk {
    let (scene, cache) = (rig.module_scene().unwrap(), Cache::usual());
    let law = |request: &_| cache.section_law(request);
    let module = scene.module(Mesh::default(), rig.highest_pressure(), Resolution::DEFAULT, law).unwrap();
    let rest = Rest::new(&module, &scene.loads([0.0; 4])).unwrap();
    let limits = Limits { slew: 30.0 * PSI, ..Limits::up_to(7.0 * PSI) };
    let centre = rest.ramp(rest.state(), &[2.8 * PSI; 4]).unwrap().position();
    let planned = eight(&rest, &Eight::level(centre, WIDTH, 3e-3, 0.25), &limits, 25.0).unwrap();
    assert!(planned.instead.is_none());
    let position = |poses: &[freerig::plan::Pose]| poses.iter().map(|pose| pose.position).collect();
    Whisk {
        name: "eight".into(),
        periods,
        lead: 2.0,
        times: planned.plan.times.clone(),
        pressures: planned.plan.pressures.clone(),
        planned: position(&planned.plan.planned),
        predicted: position(&planned.plan.predicted),
    }
}

//! CalculiX beside the solid: the same FREE, the same pressures, one thread each, errors against one reference.
//!
//! The FREE is the reference tube of 40 deg, 40 mm long, free, at 1 to 3 psi: CalculiX turns in a frame that stands
//! still, and its steps are so short that a longer tube or 10 psi would take it the better part of an hour. The
//! reference is the solid on a mesh finer than any that is compared; both know the strip, the ends and the cap. Times
//! are processor times, which a busy machine does not lengthen; the ratio is that to the cheapest solid that is at
//! least as good.

use std::io;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context as _, anyhow};

use super::claim::claim;
use super::deck::{self, DeckMesh};
use super::{patience, row};
use crate::cli::{Failure, Progress};
use crate::fem::fidelity::{Hold, Scene};
use crate::fem::measure::{Outcome, difference};
use crate::fem::solid::{Mesh, Solid, Tip};
use crate::fem::tube::Tube;
use crate::record::{BenchRow, Claim, Curve, Timed};
use crate::units::PASCAL_PER_PSI as PSI;

const SUITE: &str = "fem";
const DEGREES: f64 = 40.0;
/// m.
const LENGTH: f64 = 0.04;
/// psi.
const PRESSURES: [f64; 3] = [1.0, 2.0, 3.0];
/// CalculiX's meshes: about 1 200 and 4 800 unknowns. One of 10 900 takes more than four minutes.
const DECKS: [DeckMesh; 2] = [DeckMesh { radial: 1, side: 2, along: 8 }, DeckMesh { radial: 2, side: 3, along: 16 }];
/// Longest time that one of its runs gets.
const PATIENCE: Duration = Duration::from_secs(240);
/// Ticks of /proc a second: 100 on every Linux that Rust runs on.
const TICKS: f64 = 100.0;

/// What a program answers at the pressures, its unknowns, and the processor time, s.
struct Run {
    name: &'static str,
    unknowns: usize,
    outcomes: Vec<Outcome>,
    time: f64,
}

/// Rows, curves and facts of the comparison; where CalculiX is not installed, its row says so.
pub(super) fn beside(
    rows: &mut Vec<BenchRow>,
    curves: &mut Vec<Curve>,
    facts: &mut Vec<(String, String)>,
) -> Result<Vec<Claim>, Failure> {
    let tube = Tube::reference(DEGREES.to_radians());
    let pressures = PRESSURES.map(|psi| psi * PSI).to_vec();
    let scene = Scene { tube, length: LENGTH, hold: Hold::Free, pressures };
    let case = format!("free, {DEGREES} deg, {:.0} mm, 1 to 3 psi", 1e3 * LENGTH);
    let mut progress = Progress::new("CalculiX beside the solid", (DECKS.len() + 1) as f64, "runs");
    let usual = Mesh::sector(&tube);
    // The divisions of the usual mesh, so many times finer.
    let times = |n: f64| Mesh {
        wall: (usual.wall as f64 * n) as usize,
        wall_growth: usual.wall_growth.powf(1.0 / n),
        around: (usual.around as f64 * n) as usize,
        around_growth: usual.around_growth.powf(1.0 / n),
        first: usual.first / n,
        along_growth: usual.along_growth.powf(1.0 / n),
        largest: usual.largest / n,
        ..usual
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("a pool of one thread")?;
    let (reference, own) = pool.install(|| -> Result<_, Failure> {
        let own = [0.5, 1.0].into_iter().map(|n| solid(&scene, &times(n))).collect::<Result<Vec<_>, _>>()?;
        Ok((solid(&scene, &times(1.5))?, own))
    })?;
    progress.set(1.0, "");
    let error = |run: &Run| {
        let pairs: Vec<_> = run.outcomes.iter().copied().zip(reference.outcomes.iter().copied()).collect();
        difference(&tube, scene.hold.ends(), &pairs)
    };
    let mut theirs = Vec::new();
    for (n, mesh) in DECKS.into_iter().enumerate() {
        let mut told = |share: f64| progress.set(1.0 + n as f64 + share, "ccx");
        match ccx(&scene, mesh, &mut told)? {
            Asked::Answer(run) => theirs.push(run),
            Asked::Missing => {
                let name = format!("{case}: not run: ccx not found; apt install calculix-ccx");
                rows.push(BenchRow { failed: false, ..row(SUITE, "CalculiX", name, None, None) });
                break;
            }
            Asked::None { unknowns, why } => {
                rows.push(row(SUITE, "CalculiX", format!("{case}, {unknowns} unknowns: {why}"), None, None));
            }
        }
    }
    let timed = |run: &Run| {
        let who = format!("{} with {} unknowns", run.name, run.unknowns);
        Timed { who, error: error(run), time_s: run.time }
    };
    let against = own.last().map_or(0.0, error);
    let (own, theirs): (Vec<_>, Vec<_>) = (own.iter().map(timed).collect(), theirs.iter().map(timed).collect());
    for (name, runs) in [("solid", &own), ("CalculiX", &theirs)] {
        for Timed { who, error, time_s } in runs {
            let unknowns = who.trim_start_matches(name).trim_start_matches(" with ");
            rows.push(row(SUITE, name, format!("{case}, {unknowns}, one thread"), Some(*error), Some(*time_s)));
        }
        if !runs.is_empty() {
            curves.push(Timed::curve(format!("{name}, {case}"), runs));
        }
    }
    let claims = theirs.iter().filter_map(|run| claim(&case, run.error, &own, std::slice::from_ref(run)));
    let claims = claims.collect();
    facts.push((
        "reference beside CalculiX".into(),
        format!("the solid with {} unknowns, {:.2} % from the usual mesh", reference.unknowns, 100.0 * against),
    ));
    Ok(claims)
}

fn solid(scene: &Scene, mesh: &Mesh) -> Result<Run, Failure> {
    let before = processor_time()?;
    let mut solid = Solid::new(&scene.tube, scene.length, mesh, None)?;
    let path = solid.follow(&Tip::straight(scene.hold.ends()), &scene.pressures, &mut |_| {})?;
    if path.states.len() != scene.pressures.len() {
        return Err(Failure::failed(anyhow!("the solid ends before {} Pa", scene.pressures[path.states.len()])));
    }
    let outcome = |s: &crate::fem::solid::SolidEquilibrium| Outcome {
        stretch: s.stretch,
        twist: s.rotation / scene.length,
        force: s.force,
        moment: s.moment,
    };
    let outcomes = path.states.iter().map(outcome).collect();
    Ok(Run { name: "solid", unknowns: solid.unknowns(), outcomes, time: processor_time()? - before })
}

/// What became of a run of CalculiX.
enum Asked {
    Answer(Run),
    Missing,
    None { unknowns: usize, why: String },
}

fn ccx(scene: &Scene, mesh: DeckMesh, progress: &mut dyn FnMut(f64)) -> Result<Asked, Failure> {
    let (text, unknowns) = deck::write(scene, mesh).context("the reference tube has an Ogden law")?;
    let folder = tempfile::tempdir().context("a folder for CalculiX")?;
    std::fs::write(folder.path().join("free.inp"), text).context("the deck")?;
    let before = processor_time()?;
    let mut command = Command::new("ccx");
    command.arg("free").current_dir(folder.path()).env("OMP_NUM_THREADS", "1");
    let mut child = match command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn() {
        Ok(child) => child,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Asked::Missing),
        Err(error) => return Err(anyhow::Error::new(error).context("ccx").into()),
    };
    let status = folder.path().join("free.sta");
    let ended = patience::wait(&mut child, PATIENCE, &mut || progress(done(&status))).context("ccx")?;
    let time = processor_time()? - before;
    if !ended {
        return Ok(Asked::None { unknowns, why: format!("not finished in {} s", PATIENCE.as_secs()) });
    }
    let found = std::fs::read_to_string(folder.path().join("free.dat")).context("what ccx has found")?;
    match read(&found, scene) {
        Some(outcomes) => Ok(Asked::Answer(Run { name: "CalculiX", unknowns, outcomes, time })),
        None => Ok(Asked::None { unknowns, why: "it ended before the last pressure".into() }),
    }
}

/// The share of the steps that `status`, the file in which it tells them, says are done.
fn done(status: &Path) -> f64 {
    let told = std::fs::read_to_string(status).unwrap_or_default();
    told.lines().last().and_then(|line| line.split_whitespace().nth(4)?.parse().ok()).unwrap_or(0.0)
}

/// Motion of the cap at every pressure, from the printed displacements of REF (along the axis) and ROT (its turn).
fn read(printed: &str, scene: &Scene) -> Option<Vec<Outcome>> {
    let of = |set: &str| -> Vec<f64> {
        let mut lines = printed.lines();
        let mut found = Vec::new();
        while let Some(line) = lines.next() {
            if line.contains(&format!("for set {set} ")) {
                let values = lines.by_ref().find(|line| !line.trim().is_empty());
                found.extend(values.and_then(|v| v.split_whitespace().next_back()?.parse::<f64>().ok()));
            }
        }
        found
    };
    let (moved, turned) = (of("REF"), of("ROT"));
    let count = scene.pressures.len();
    let outcome = |(moved, turned): (&f64, &f64)| Outcome {
        stretch: 1.0 + 1e-3 * moved / scene.length,
        twist: turned / scene.length,
        force: 0.0,
        moment: 0.0,
    };
    (moved.len() == count && turned.len() == count).then(|| moved.iter().zip(&turned).map(outcome).collect())
}

/// Processor time of this process and of the children that it has waited for, s.
fn processor_time() -> Result<f64, Failure> {
    let stat = std::fs::read_to_string("/proc/self/stat").context("/proc/self/stat")?;
    // The name in brackets may hold blanks; utime, stime, cutime and cstime are fields 14 to 17.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    Ok(fields.skip(11).take(4).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / TICKS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Scene {
        let tube = Tube::reference(0.7);
        Scene { tube, length: LENGTH, hold: Hold::Free, pressures: vec![PSI, 2.0 * PSI] }
    }

    #[test]
    fn the_caps_motion_is_read_from_what_is_printed() {
        let block = |set: &str, time: &str, last: &str| {
            format!(
                "\n displacements (vx,vy,vz) for set {set} and time  {time}\n\n       410  0.0E+00  0.0E+00 {last}\n"
            )
        };
        let printed = block("REF", "0.5", "-4.0E-02")
            + &block("ROT", "0.5", "-1.0E-01")
            + &block("REF", "1.0", "-8.0E-02")
            + &block("ROT", "1.0", "-2.5E-01");
        let found = read(&printed, &scene()).unwrap();
        assert!((found[0].stretch - 0.999).abs() < 1e-12 && (found[1].twist + 0.25 / LENGTH).abs() < 1e-12);
        assert!(read(&block("REF", "1.0", "-8.0E-02"), &scene()).is_none());
    }

    #[test]
    fn a_deck_ties_its_faces_and_shares_the_fibres_stiffness() {
        let (text, unknowns) = deck::write(&scene(), DECKS[0]).unwrap();
        assert_eq!(unknowns, 1227);
        // Every chord of the three lines carries its part of EA / length.
        let springs: Vec<f64> = text
            .lines()
            .zip(text.lines().skip(2))
            .filter(|(keyword, _)| keyword.starts_with("*SPRING"))
            .map(|(_, stiffness)| stiffness.parse().unwrap())
            .collect();
        assert_eq!(springs.len(), 3 * 16);
        // Their flexibility in series is the fibre's: length / (cos G EA), but for the chords' shortening.
        let line = |n: usize| 1.0 / springs[16 * n..][..16].iter().map(|k| 1.0 / k).sum::<f64>();
        let stiffness = line(0) + line(1) + line(2);
        let exact = 644.0 * 0.7_f64.cos() / (1e3 * LENGTH);
        assert!((stiffness / exact - 1.0).abs() < 0.01, "{stiffness} {exact}");
        assert_eq!(text.matches("*EQUATION").count() % 3, 0);
    }
}

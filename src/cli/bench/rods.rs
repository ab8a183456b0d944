//! Rods with known answers: error against time over the resolution, beside Exudyn on the same tasks.
//!
//! R1 is one cantilever under a dead force and a dead moment, R2 four rods with spontaneous extension and twist under
//! one plate, R3 the way of R2 under compression past two turning points of the load, which no load control can go. The
//! answers were found by two independent codes. Errors of R1 and R2 are the tip's or the plate's distance from the
//! known place over the rods' length, of R3 the larger one of the two turning loads.

use nalgebra::Vector3;
use serde_json::json;

use super::claim::claim;
use super::peer::{self, Peer};
use super::{Size, row, stopwatch};
use crate::cli::{Failure, Progress};
use crate::fem::module::{Loads, Module, Mount, Path};
use crate::fem::rod::{Law, Profile, Resolution, Rod, Straight};
use crate::record::{BenchRow, BenchSuite, Timed};

const SUITE: &str = "rods";
const MM: f64 = 1e-3;
/// m.
const LENGTH: f64 = 130.0 * MM;
/// EA, N; EI and GJ, N mm2; GA, N.
const STIFFNESS: [f64; 4] = [30.606, 409.895, 273.264, 5.4070];
/// Degrees of the strains' polynomials and Magnus steps.
const RESOLUTIONS: [(usize, usize); 7] = [(1, 2), (2, 2), (2, 3), (3, 4), (4, 4), (5, 8), (7, 16)];
/// Exudyn's elements a rod, and the load steps it may take: the fewest that converge count.
const ELEMENTS: [usize; 5] = [2, 4, 8, 16, 32];
const LOAD_STEPS: [usize; 5] = [1, 2, 3, 5, 10];
/// Errors at which times are compared.
const LEVELS: [f64; 3] = [1e-2, 1e-3, 1e-4];
/// R1: N, N mm, and where the tip then is, mm.
const R1: Task = Task {
    name: "R1",
    rods: &[[0.0, 0.0, 0.0, 0.0]],
    force: [0.015, 0.008, -0.010],
    moment: [-0.6, 2.2, 0.4],
    place: [65.88336991, 28.14646053, 100.65456905],
};
/// R2, likewise.
const R2: Task = Task {
    name: "R2",
    rods: &[
        [-10.0, 10.0, 0.06, 0.008],
        [-10.0, -10.0, 0.03, -0.004],
        [10.0, -10.0, 0.0, 0.0],
        [10.0, 10.0, 0.015, -0.002],
    ],
    force: [0.0, 0.0, -0.2],
    moment: [0.0; 3],
    place: [19.68336597, -11.19964926, 130.75976188],
};
/// R3: the force at which the branch turns, first down, then up again, N.
const TURNS: [f64; 2] = [-0.41063, -0.36130];
/// Longest arc-length step, and where load control is asked to go, N.
const STEP: f64 = 0.2;
const BEYOND: f64 = -0.5;

/// Rods (place, mm, spontaneous extension, spontaneous twist, rad/mm) under a plate; a single one has none.
struct Task {
    name: &'static str,
    rods: &'static [[f64; 4]],
    force: [f64; 3],
    moment: [f64; 3],
    place: [f64; 3],
}

impl Task {
    fn module(&self, (degree, steps): (usize, usize)) -> Result<Module, Failure> {
        let [ea, ei, gj, ga] = STIFFNESS;
        let mount = |[x, y, extension, twist]: &[f64; 4]| {
            let law = Law {
                straight: Straight::spontaneous(ea, gj * MM * MM, *extension, twist / MM),
                bending: Profile::constant(ei * MM * MM),
                shear: Profile::constant(ga),
                coupling: Profile::constant(0.0),
                mirrored: false,
            };
            Mount { base: Vector3::new(*x, *y, 0.0) * MM, rod: Rod::straight(LENGTH, law) }
        };
        Ok(Module::new(self.rods.iter().map(mount).collect(), 0.0, Resolution { degree, steps })?)
    }

    /// Dead loads, the force times `share`; "pressure" 1 is what makes the spontaneous strains.
    fn loads(&self, share: f64) -> Loads {
        let force = Vector3::from(self.force) * share;
        Loads { force, moment: Vector3::from(self.moment) * MM, ..Loads::pressures(vec![1.0; self.rods.len()]) }
    }

    /// Distance of `place` (mm) from the known one, in lengths.
    fn error(&self, place: Vector3<f64>) -> f64 {
        (place - Vector3::from(self.place)).norm() * MM / LENGTH
    }

    fn for_peers(&self) -> serde_json::Value {
        let Task { name, rods, force, moment, .. } = self;
        json!({ "name": name, "rods": rods, "force": force, "moment": moment, "elements": ELEMENTS, "load_steps": LOAD_STEPS })
    }
}

/// Every resolution on every task, then the peer.
pub(super) fn run(_: &Size<'_>) -> Result<BenchSuite, Failure> {
    let (mut rows, mut curves, mut own) = (Vec::new(), Vec::new(), Vec::new());
    let mut progress = Progress::new("rods", 4.0, "tasks");
    for (n, (task, warm)) in [(&R1, false), (&R2, false), (&R2, true)].into_iter().enumerate() {
        let found = equilibria(task, warm, &mut rows)?;
        let start = if warm { "warm" } else { "cold" };
        curves.push(Timed::curve(format!("freerig, {}, {start}", task.name), &found));
        // The peer has no warm start.
        if !warm {
            own.push((task, found));
        }
        progress.set(n as f64 + 1.0, task.name);
    }
    turning_points(&mut rows)?;
    let mut compression = R2.for_peers();
    compression["name"] = json!(format!("R3 by load control to {BEYOND} N"));
    compression["force"] = json!([0.0, 0.0, BEYOND]);
    compression["elements"] = json!([8]);
    compression["load_steps"] = json!([1, 10, 40]);
    let length = LENGTH / MM;
    let task =
        json!({ "length": length, "stiffness": STIFFNESS, "cases": [R1.for_peers(), R2.for_peers(), compression] });
    let mut claims = Vec::new();
    match peer::ask(SUITE, ("exudyn", "Exudyn"), include_str!("peers/exudyn.py"), &task)? {
        Peer::None(row) => rows.push(row),
        Peer::Answers { name, answers } => {
            for (task, own) in &own {
                let mut theirs = Vec::new();
                for answer in answers.iter().filter(|answer| answer.task == task.name) {
                    let error = <[f64; 3]>::try_from(answer.values.clone()).ok().map(|p| task.error(p.into()));
                    rows.push(answer.row(SUITE, &name, error));
                    theirs.extend(answer.timed(&name, error));
                }
                curves.push(Timed::curve(format!("{name}, {}", task.name), &theirs));
                claims.extend(LEVELS.iter().filter_map(|level| claim(task.name, *level, own, &theirs)));
            }
            rows.extend(answers.iter().filter(|a| a.task.starts_with("R3")).map(|a| a.row(SUITE, &name, None)));
        }
    }
    Ok(BenchSuite {
        name: SUITE,
        title: "Rods with known answers",
        facts: vec![
            ("tasks".into(), "R1 a cantilever bent by 63 deg, R2 four rods under a plate, R3 its path through two turning points".into()),
            ("error".into(), "distance from the known place over the rods' length; R3: of the two turning loads".into()),
            ("time".into(), "processor time of the solve, least of several; freerig's includes stability, stiffness and sensitivities".into()),
        ],
        rows,
        claims,
        caption: "Error against time over the resolution",
        x_label: "log10 of the time in ms",
        y_label: "log10 of the relative error",
        curves,
        ..BenchSuite::default()
    })
}

/// `task` at every resolution, from rest or from the equilibrium at a force half a per cent less.
fn equilibria(task: &Task, warm: bool, rows: &mut Vec<BenchRow>) -> Result<Vec<Timed>, Failure> {
    let mut found = Vec::new();
    for at in RESOLUTIONS {
        let module = task.module(at)?;
        let (near, loads) = (module.equilibrium(&task.loads(0.995))?, task.loads(1.0));
        let solve = || -> Result<_, Failure> {
            Ok(if warm { module.equilibrium_from(&near, &loads)? } else { module.equilibrium(&loads)? })
        };
        let (state, time_s) = stopwatch::best(solve)?;
        let error = task.error(state.position() / MM);
        let how = format!("degree {}, {} steps", at.0, at.1);
        let start = if warm { "warm" } else { "cold" };
        rows.push(row(SUITE, "freerig", format!("{}, {start}, {how}", task.name), Some(error), Some(time_s)));
        found.push(Timed { who: format!("freerig, {how}"), error, time_s });
    }
    Ok(found)
}

/// R3: both turning points by arc length, from the equilibrium without force.
fn turning_points(rows: &mut Vec<BenchRow>) -> Result<(), Failure> {
    for at in RESOLUTIONS.into_iter().skip(2) {
        let module = R2.module(at)?;
        let (begin, end) = (R2.loads(0.0), R2.loads(-1.0 / R2.force[2]));
        let solve = || -> Result<_, Failure> {
            let mut path = Path::new(&module, &module.equilibrium(&begin)?, &end, STEP)?;
            let mut turn = || Ok::<_, Failure>(path.next_critical((-0.1, 4.0))?.map(|critical| -critical.mu));
            Ok([turn()?, turn()?])
        };
        let (found, time_s) = stopwatch::best(solve)?;
        let off = |(found, known): (Option<f64>, f64)| found.map(|found| (found / known - 1.0).abs());
        let errors: Option<Vec<f64>> = found.into_iter().zip(TURNS).map(off).collect();
        let error = errors.map(|errors| errors.into_iter().fold(0.0, f64::max));
        let case = format!("R3, both turning points, degree {}, {} steps", at.0, at.1);
        rows.push(row(SUITE, "freerig", case, error, Some(time_s)));
    }
    Ok(())
}

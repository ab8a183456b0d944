//! The module and the whisk in a run's start document, and the way of the plate in a run: wanted, predicted, estimated
//! and, simulated, true.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::Result;
use super::columns::column_name;
use super::run::Run;
use super::signals::interpolate;
use super::tip::{self, TipLine};
use super::tube::TubeDocument;
use crate::config::{Cache, Rig, Whisk};
use crate::fem::module::{Free, Module, ModuleScene, State};
use crate::fem::rod::Resolution;
use crate::fem::section::Mesh;
use crate::plan::Rest;
use crate::plan::observer::{Unknown, tip, turned};

/// Columns of the first FREE that tell the plate's orientation, and what it really is.
const TARE: [&str; 4] = ["tare_qw", "tare_qx", "tare_qy", "tare_qz"];
const NOW: [&str; 4] = ["imu_qw", "imu_qx", "imu_qy", "imu_qz"];
const TRUTH: [&str; 3] = ["true_x_m", "true_y_m", "true_z_m"];
/// Time between two points of the way, s.
const STEP: f64 = 0.02;
/// Most points of a way: those of a longer one are further apart.
const MOST: usize = 1 << 14;

/// Four FREEs under one plate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModuleDocument {
    /// Which of the run's FREEs are A, B, C, D.
    pub frees: [usize; 4],
    pub lengths_m: [f64; 4],
    pub tubes: Vec<TubeDocument>,
    pub spacing_m: f64,
    pub plate_mass_kg: f64,
    pub gravity_m_s2: [f64; 3],
    /// The plate's normal in its sensor's frame.
    pub imu_axis: [f64; 3],
    /// Highest pressure that its laws are to reach.
    pub highest_pressure_pa: f64,
}

impl ModuleDocument {
    /// The document of the module of `rig`; none where it has none, or rubber that is not Ogden's.
    pub fn of(rig: &Rig) -> Option<ModuleDocument> {
        let (scene, frees) = (rig.module_scene()?, rig.module.as_ref()?.frees);
        let imu = rig.control.frees.get(frees[0]).and_then(|free| free.imu);
        Some(ModuleDocument {
            frees,
            imu_axis: imu.map_or([0.0, 0.0, 1.0], |imu| imu.axis),
            lengths_m: scene.frees.map(|free| free.length),
            tubes: scene.frees.iter().map(|free| TubeDocument::of(&free.tube)).collect::<Option<_>>()?,
            spacing_m: scene.spacing,
            plate_mass_kg: scene.plate_mass,
            gravity_m_s2: scene.gravity.into(),
            highest_pressure_pa: rig.highest_pressure(),
        })
    }

    /// The module; none where the document has lost a tube.
    pub fn scene(&self) -> Option<ModuleScene> {
        let tubes: [TubeDocument; 4] = self.tubes.clone().try_into().ok()?;
        let free = |i: usize| Free {
            tube: tubes[i].tube(),
            length: self.lengths_m[i],
            dead_length: 0.0,
            rest_curvature: Vector2::zeros(),
        };
        Some(ModuleScene {
            frees: std::array::from_fn(free),
            spacing: self.spacing_m,
            plate_mass: self.plate_mass_kg,
            force: Vector3::zeros(),
            moment: Vector3::zeros(),
            gravity: self.gravity_m_s2.into(),
        })
    }
}

impl ModuleDocument {
    /// The module with the laws of its FREEs, and its scene; none where it has none.
    fn module(&self) -> Option<(Module, ModuleScene)> {
        let (scene, cache) = (self.scene()?, Cache::usual());
        let law = |request: &_| cache.section_law(request);
        let module = scene.module(Mesh::default(), self.highest_pressure_pa, Resolution::DEFAULT, law).ok()?;
        Some((module, scene))
    }
}

/// The plate's centre at these pressures, Pa, and, where it is known, this rotation. `state` follows the pressures, as
/// far as the module's branch goes.
fn estimate(
    rest: &Rest<'_>,
    state: &mut State,
    pressures: &[f64; 4],
    rotation: Option<UnitQuaternion<f64>>,
) -> Option<Vector3<f64>> {
    *state = rest.onward(state, pressures).ok()?;
    match rotation {
        Some(rotation) => Some(tip(state, &rotation, &Unknown::default())?.position),
        None => Some(state.position()),
    }
}

/// A plan that was run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WhiskDocument {
    /// Followed in closed loop.
    #[serde(default)]
    pub closed_loop: bool,
    pub periods: u32,
    pub lead_s: f64,
    pub times_s: Vec<f64>,
    #[serde(default)]
    pub planned_m: Vec<[f64; 3]>,
    #[serde(default)]
    pub predicted_m: Vec<[f64; 3]>,
}

impl WhiskDocument {
    /// The document of `whisk`, followed in closed loop or run as it stands.
    pub fn of(whisk: &Whisk, closed_loop: bool) -> WhiskDocument {
        WhiskDocument {
            closed_loop,
            periods: whisk.periods,
            lead_s: whisk.lead,
            times_s: whisk.times.clone(),
            planned_m: whisk.planned.clone(),
            predicted_m: whisk.predicted.clone(),
        }
    }

    /// Where `points` are at the program's time `t`; none outside of the periods, and where there are no points.
    fn at(&self, points: &[[f64; 3]], t: f64) -> Option<Vector3<f64>> {
        let period = *self.times_s.last()?;
        let since = t - self.lead_s;
        if points.len() != self.times_s.len() || !(0.0..=period * f64::from(self.periods)).contains(&since) {
            return None;
        }
        let phase = since.rem_euclid(period);
        let along = |axis: usize| {
            let column: Vec<f64> = points.iter().map(|p| p[axis]).collect();
            interpolate(&self.times_s, &column, phase)
        };
        Some(Vector3::new(along(0), along(1), along(2)))
    }
}

/// The plate's centre over a run's program, m; a point that is not known is none.
#[derive(Clone, Debug, Default)]
pub struct TipPath {
    /// How far its points are apart, s.
    pub step: f64,
    /// Time of the program, s.
    pub t: Vec<f64>,
    /// Where it was wanted.
    pub planned: Vec<Option<Vector3<f64>>>,
    /// Where the plan's model put it.
    pub predicted: Vec<Option<Vector3<f64>>>,
    /// What the run itself held it to be, where it followed a path; else from the measured pressures and the plate's
    /// rotation.
    pub estimated: Vec<Option<Vector3<f64>>>,
    /// Of the simulated rig.
    pub truth: Vec<Option<Vector3<f64>>>,
}

/// How far one way is from another, m, over the times at which both are known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Apart {
    /// Root mean square.
    pub rms: f64,
    /// Largest.
    pub peak: f64,
}

impl Apart {
    /// Of `a` and `b`; none where they have no time in common.
    pub fn between(a: &[Option<Vector3<f64>>], b: &[Option<Vector3<f64>>]) -> Option<Apart> {
        let apart: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some(((*a)? - (*b)?).norm())).collect();
        let mean = apart.iter().map(|x| x * x).sum::<f64>() / apart.len() as f64;
        (!apart.is_empty()).then(|| Apart { rms: mean.sqrt(), peak: apart.iter().copied().fold(0.0, f64::max) })
    }
}

impl TipPath {
    /// What was to be followed: the plan, or what the model made of the pressures where nothing was planned.
    pub fn wanted(&self) -> &[Option<Vector3<f64>>] {
        if self.planned.iter().any(Option::is_some) { &self.planned } else { &self.predicted }
    }

    /// The way of the plate in `run`; none where it is no module's.
    ///
    /// # Errors
    /// Where the samples cannot be read.
    pub fn of(run: &Run) -> Result<Option<TipPath>> {
        let start = run.start();
        let Some(module) = &start.module else { return Ok(None) };
        let names: Vec<&str> = module.frees.iter().filter_map(|i| Some(start.frees.get(*i)?.name.as_str())).collect();
        let [a, ..] = names[..] else { return Ok(None) };
        let mut columns = vec!["program_time_s".to_owned()];
        columns
            .extend(names.iter().flat_map(|name| [column_name(name, "pressure_pa"), column_name(name, "command_pa")]));
        for own in TARE.into_iter().chain(NOW).chain(TRUTH) {
            columns.push(column_name(a, own));
        }
        let mut path = TipPath { step: STEP, ..TipPath::default() };
        let held = tip::read(&run.folder)?.map(HeldPath::of);
        // Without its law the module has no estimate, and the rest of the way stands.
        let built = if held.is_none() { module.module() } else { None };
        let rest = built.as_ref().and_then(|(module, scene)| Rest::new(module, &scene.loads([0.0; 4])).ok());
        let mut state = rest.as_ref().map(|rest| rest.state().clone());
        let mut next = f64::NEG_INFINITY;
        for table in run.tables(&columns)? {
            let table = table?;
            for (row, &t) in table.get("program_time_s").iter().enumerate() {
                if t.is_nan() || t < next {
                    continue;
                }
                if path.t.len() == MOST {
                    path.halve();
                }
                next = t + path.step - 1e-6;
                let value = |name: &str, column: &str| {
                    table.get(&column_name(name, column)).get(row).copied().unwrap_or(f64::NAN)
                };
                let known = |x: [f64; 3]| Some(Vector3::from(x)).filter(|x| x.iter().all(|x| x.is_finite()));
                let pressure = |name: &&str| {
                    let measured = value(name, "pressure_pa");
                    if measured.is_finite() { measured } else { value(name, "command_pa") }
                };
                path.t.push(t);
                path.planned.push(start.whisk.as_ref().and_then(|w| w.at(&w.planned_m, t)));
                path.predicted.push(start.whisk.as_ref().and_then(|w| w.at(&w.predicted_m, t)));
                path.estimated.push(match &held {
                    Some(held) => held.at(t),
                    None => rest.as_ref().zip(state.as_mut()).and_then(|(rest, state)| {
                        let pressures: Vec<f64> = names.iter().map(pressure).collect();
                        let quaternion = |of: [&str; 4]| of.map(|column| value(a, column));
                        let rotation = turned(module.imu_axis, quaternion(TARE), quaternion(NOW));
                        estimate(rest, state, &pressures.try_into().ok()?, rotation)
                    }),
                });
                path.truth.push(known(TRUTH.map(|column| value(a, column))));
            }
        }
        Ok(Some(path))
    }

    /// Whether its points are further apart than those of a short run.
    pub fn is_thinned(&self) -> bool {
        self.step > STEP
    }

    /// Leaves every second point, and takes half as many from here on.
    fn halve(&mut self) {
        fn every_second<T>(all: &mut Vec<T>) {
            let mut keep = false;
            all.retain(|_| {
                keep = !keep;
                keep
            });
        }
        every_second(&mut self.t);
        [&mut self.planned, &mut self.predicted, &mut self.estimated, &mut self.truth]
            .into_iter()
            .for_each(every_second);
        self.step *= 2.0;
    }
}

/// Where a run held the plate to be.
struct HeldPath {
    times: Vec<f64>,
    axes: [Vec<f64>; 3],
}

impl HeldPath {
    fn of(lines: Vec<TipLine>) -> HeldPath {
        let axis = |i: usize| lines.iter().map(|line| line.position[i]).collect();
        HeldPath { times: lines.iter().map(|line| line.time).collect(), axes: [axis(0), axis(1), axis(2)] }
    }

    /// At the program's time `t`; none before its beginning and after its end.
    fn at(&self, t: f64) -> Option<Vector3<f64>> {
        let known = *self.times.first()? <= t && t <= *self.times.last()?;
        known.then(|| Vector3::from_fn(|i, _| interpolate(&self.times, &self.axes[i], t)))
    }
}

//! Weights and torques of `freerig calibrate stiffness`: read from the script, hung by a person at the terminal, or
//! hung by the simulated one.

use std::sync::PoisonError;
use std::time::Duration;

use anyhow::{Context as _, anyhow};

use super::{How, ask, failure};
use crate::cli::outcome::Watch;
use crate::cli::{Context, Failure, attend, control};
use crate::config::experiment::Experiment;
use crate::config::{KnownLoad, Rig, Script};
use crate::daemon::api::{FreeStatus, Set};
use crate::daemon::calibration::Finding;
use crate::daemon::calibration::loads::{NAME, Readings, Session, Sort, Step, evaluate};
use crate::daemon::client::Client;
use crate::daemon::experiment::{self, Attendance, Job};
use crate::daemon::{Stepped, procedure};
use crate::record::{Run, RunResult};
use crate::sim::{Person, PlantFault};
use crate::units::{PASCAL_PER_PSI, Pressure};

/// Readings of the IMU and of the pressure that a point is the mean of, and the time between two.
const LOOKS: u32 = 20;
const LOOK: Duration = Duration::from_millis(50);
/// Longest time for a pressure to be set.
const SETTING: Duration = Duration::from_secs(30);

/// The known loads, and the order of those that are still to be read.
#[derive(Debug, Default)]
pub(super) struct Known {
    weights: Vec<KnownLoad>,
    torques: Vec<KnownLoad>,
    plan: Option<Session>,
}

/// The loads, where they are still to be read: all of them or none.
fn to_read(loads: &[KnownLoad]) -> &[KnownLoad] {
    if loads.iter().any(|load| load.reading.is_none()) { loads } else { &[] }
}

impl Known {
    /// The script's; at a terminal, what a person says. A load that the FREE cannot bear is told before anything moves.
    pub(super) fn of(how: &How, rig: &Rig, index: usize, context: &Context) -> Result<Self, Failure> {
        let (weights, torques) = match &how.script {
            Some(path) => {
                let script = Script::read(path)?;
                (script.weights, script.torques)
            }
            None if rig.is_simulated() || !ask::somebody() => return Ok(Self::default()),
            None => (ask_for_weights(context)?, Vec::new()),
        };
        let (open_weights, open_torques) = (to_read(&weights), to_read(&torques));
        let plan = match open_weights.is_empty() && open_torques.is_empty() {
            true => None,
            false => Some(Session::plan(rig, index, open_weights, open_torques).map_err(failure)?),
        };
        Ok(Self { weights, torques, plan })
    }

    /// Reads them and adds what they say to `finding`, that of the staircase `run`.
    pub(super) fn add_to(
        &self,
        finding: &mut Finding,
        rig: &Rig,
        index: usize,
        run: &Run,
        date: &str,
        context: &Context,
    ) -> Result<(), Failure> {
        let mut readings = Readings::written(&self.weights, &self.torques);
        let mut own_run = None;
        if let Some(session) = &self.plan {
            let taken = if rig.is_simulated() {
                let note = "SIMULATED: a simulated person hangs the loads and reads the ruler, with an error of 0.2 mm";
                context.note(note);
                let (run, taken) = simulated(rig, index, session)?;
                own_run = Some(run);
                taken
            } else {
                by_hand(rig, index, session, context)?
            };
            let read = session.readings(to_read(&self.weights), to_read(&self.torques), &taken);
            if !read.weights.is_empty() {
                readings.weights = read.weights;
            }
            if !read.torques.is_empty() {
                (readings.torques, readings.path) = (read.torques, read.path);
            }
        }
        evaluate(finding, &readings, rig, index, own_run.as_ref().unwrap_or(run), date).map_err(failure)
    }
}

fn ask_for_weights(context: &Context) -> Result<Vec<KnownLoad>, Failure> {
    let masses = ask::numbers("Known weights for ke, in g, in their order, up and down (none: Enter):", context)?;
    if masses.is_empty() {
        return Ok(Vec::new());
    }
    let pressures = ask::numbers("At which pressures, in psi (0 psi alone: Enter):", context)?;
    let pressures = if pressures.is_empty() { vec![0.0] } else { pressures };
    let at = |&psi: &f64| {
        masses.iter().map(move |g| KnownLoad { amount: 1e-3 * g, pressure: psi * PASCAL_PER_PSI, reading: None })
    };
    Ok(pressures.iter().flat_map(at).collect())
}

/// What was read, the angle and the pressure at every step.
type Taken = Vec<(f64, f64, f64)>;

/// On the simulated rig and the stepped clock: the same seed is the same FREE, whoever runs it.
fn simulated(rig: &Rig, index: usize, session: &Session) -> Result<(Run, Taken), Failure> {
    let name = &rig.control.frees[index].name;
    let experiment = Experiment::parse("loads.toml".as_ref(), &session.experiment(), rig, Some(name))?;
    let job = Job { accept_margin: true, stepped: true, ..Job::new(experiment, Attendance::Here) };
    let mut bench = Stepped::new(rig).map_err(Failure::rig)?;
    procedure::arm(&mut bench, rig, true).map_err(Failure::rig)?;
    let plant = bench.sim().plant();
    let constant = rig.bench.plants.get(index).map_or(0.0, |plant| plant.load_moment);
    let length = plant.lock().unwrap_or_else(PoisonError::into_inner).true_free(index).map_or(0.0, |free| free.length);
    let mut hung = (0.0, 0.0);
    let mut watch = Watch::new(NAME, index);
    let runs = experiment::run(&mut bench, rig, &job, &mut |progress| {
        watch.show(progress);
        let step = session.at(progress.elapsed).filter(|_| progress.record.program_time.is_finite());
        if let Some(step) = step.filter(|step| (step.force, step.moment) != hung) {
            hung = (step.force, step.moment);
            let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
            plant.inject(PlantFault::Pull(index, step.force), progress.record.time);
            plant.inject(PlantFault::Load(index, constant + step.moment), progress.record.time);
        }
    })
    .map_err(Failure::rig)?;
    drop(watch);
    let run = runs.into_iter().next_back().ok_or_else(|| anyhow!("nothing was run"))?;
    if let Some(stop) = run.stop().filter(|stop| stop.result != RunResult::Done) {
        let error = anyhow!("{}: {}", run.id(), stop.message);
        return Err(if stop.result == RunResult::Fault { Failure::fault(error) } else { Failure::failed(error) });
    }
    let spans: Vec<_> = session.steps.iter().map(Step::rest).collect();
    let mut person = Person::new(rig.bench.seed);
    let taken = run.rests(index, &spans)?.into_iter().map(|rest| {
        let rest = rest?;
        let read = rest.truth.map_or(f64::NAN, |truth| person.length(length + truth.extension));
        Some((read, rest.angle, rest.pressure))
    });
    let taken: Option<Taken> = taken.collect();
    let taken = taken.with_context(|| format!("the run {} lacks records", run.id()))?;
    Ok((run, taken))
}

/// On the rig that the daemon runs: pressures are set by hand, a person hangs and reads. However it ends, the pressures
/// go down.
fn by_hand(rig: &Rig, index: usize, session: &Session, context: &Context) -> Result<Taken, Failure> {
    if !ask::somebody() {
        let error = anyhow!("somebody must hang the loads and read, and there is no terminal");
        return Err(Failure::usage(error)
            .remedy("run it in a terminal, or write every `length_mm` or `angle_deg` into the script"));
    }
    let taken = read_by_hand(rig, index, session, context);
    let down = attend::disarm(&rig.socket.path);
    let taken = taken?;
    down.map(|()| taken)
}

fn read_by_hand(rig: &Rig, index: usize, session: &Session, context: &Context) -> Result<Taken, Failure> {
    let client = control::client(context)?;
    let free = &rig.control.frees[index];
    let mut taken = Taken::new();
    let (mut pressure, mut hung) = (f64::NAN, (0.0, 0.0));
    for step in &session.steps {
        if step.pressure != pressure {
            pressure = step.pressure;
            set(&client, &free.name, pressure)?;
        }
        let load = format!("{:.1} g and {:.2} mN m", 1e3 * step.force / crate::model::GRAVITY, 1e3 * step.moment);
        let read = match step.reads {
            Some((Sort::Weight, _)) => {
                1e-3 * ask::number(&format!("Hang {load} on it, wait for rest. Length in mm:"), context)?
            }
            Some((Sort::Torque, _)) if free.imu.is_none() => {
                ask::number(&format!("Put {load} on it, wait for rest. Angle in deg:"), context)?.to_radians()
            }
            Some((Sort::Torque, _)) => {
                ask::line(&format!("Put {load} on it, wait for rest. Then Enter:"))?;
                f64::NAN
            }
            None if (step.force, step.moment) != hung => {
                ask::line(&format!("Put {load} on it, wait for rest. Then Enter:"))?;
                f64::NAN
            }
            None => f64::NAN,
        };
        hung = (step.force, step.moment);
        let (angle, measured) = look(&client, index)?;
        taken.push((read, angle, measured));
    }
    Ok(taken)
}

/// Sets a pressure and waits until it is there.
pub(super) fn set(client: &Client, free: &str, pressure: f64) -> Result<(), Failure> {
    let set = Set { free: free.into(), pressure_pa: Some(pressure), ..Set::default() };
    control::wait(client.set(&set))?;
    let status = control::wait(control::until(client, SETTING, |status| status.run.is_none()))?;
    if status.run.is_none() && !status.is_faulted() {
        return Ok(());
    }
    let error = anyhow!("{free} did not get to {:.2}", Pressure::pascals(pressure));
    Err(Failure::failed(error).remedy("`freerig status` shows what the rig does"))
}

/// Mean angle and pressure of a second; not numbers where they are not measured.
fn look(client: &Client, index: usize) -> Result<(f64, f64), Failure> {
    let mut sums = (0.0, 0.0);
    for _ in 0..LOOKS {
        let status = control::wait(client.status())?;
        if status.is_faulted() {
            return Err(Failure::fault(anyhow!("the rig has a fault")).remedy("`freerig status` names it"));
        }
        let free = status.frees.get(index).map_or_else(FreeStatus::default, Clone::clone);
        sums.0 += free.angle_rad.unwrap_or(f64::NAN);
        sums.1 += free.pressure_pa.unwrap_or(f64::NAN);
        std::thread::sleep(LOOK);
    }
    Ok((sums.0 / f64::from(LOOKS), sums.1 / f64::from(LOOKS)))
}

//! The model thread of a run that follows a path with a module's plate.
//!
//! It is the procedure's own thread: at every look at the rig ([`super::procedure::LOOK`], 50 Hz) the [`Follower`]
//! takes the latest record's orientation and pressures, and a tracker's pose if there is one, learns what of the module
//! is not as its model says ([`crate::plan::pursuit`]), and answers with the pressures to add to the plan's, which the
//! tick takes from a latest-value slot. They are for a moment ahead: a regulator's dead time and lag, and the plate's
//! own lag.
//!
//! Whatever stops it (an IMU that is silent, a state without an equilibrium, a thread that hangs) ends its trims, which
//! fade within half a second (`control::trim`); what is then left is the plan, and the fault matrix.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector3;

use super::DaemonError;
use super::experiment::Job;
use super::pose::{PoseDesk, Sighting};
use crate::clock::Time;
use crate::config::{Cache, Rig, Whisk};
use crate::control::trim;
use crate::plan::Rest;
use crate::plan::observer::turned;
use crate::plan::pursuit::{Ahead, Held, Pursuit, Seen};
use crate::plan::scatter::{Course, Family, Way};
use crate::record::{TipLine, TipWriter};
use crate::signal::{ImuHealth, MAX_FREES, RegulatorHealth, State, TickRecord, Trim};
use crate::trajectory::Program;

/// A reading that is older is none to go by.
const OLD: Duration = Duration::from_millis(150);
/// How far back the pressures are remembered: a pose may be so old and a little more.
const MEMORY: Duration = Duration::from_millis(400);
/// Half the time that a trim stands.
const HALF: f64 = 0.01;
/// The least smooth margin that a trim may leave; less where the plan itself leaves less.
const MARGIN: f64 = 0.2;
/// Longest lag of a plate that is believed, s.
const SLOWEST: f64 = 0.1;

/// The family of the module that `job` leads along a path; none where it runs its plan as it stands.
///
/// # Errors
/// Where the module's laws are refused.
pub(super) fn family(rig: &Rig, job: &Job) -> Result<Option<Family>, DaemonError> {
    let (Some(_), Some(scene)) = (path(rig, job), rig.module_scene()) else { return Ok(None) };
    let cache = Cache::usual();
    let family = Family::new(&scene, rig.highest_pressure(), |request| cache.section_law(request));
    family.map(Some).map_err(|error| unfit(&error))
}

/// The plan that `job` follows in closed loop: one that has a path, on a rig whose plate has an IMU.
pub(super) fn path<'j>(rig: &Rig, job: &'j Job) -> Option<&'j Whisk> {
    let whisk = job.whisk.as_ref().filter(|whisk| !job.open_loop && !whisk.path().is_empty())?;
    let plate = rig.module.as_ref()?.frees[0];
    rig.control.frees.get(plate)?.imu.map(|_| whisk)
}

fn unfit(error: &dyn std::fmt::Display) -> DaemonError {
    DaemonError::Unfit(format!(
        "the plan cannot be followed in closed loop: {error}; `--open-loop` runs it as it stands"
    ))
}

/// A module on its path.
#[derive(Debug)]
pub(super) struct Guide<'f> {
    family: &'f Family,
    rest: Rest<'f>,
    course: Course,
}

impl<'f> Guide<'f> {
    /// The path of `job` for the module of `family`.
    ///
    /// # Errors
    /// Where the model cannot follow the plan.
    pub fn new(rig: &Rig, job: &Job, family: &'f Family) -> Result<Guide<'f>, DaemonError> {
        let (Some(whisk), Some(scene)) = (path(rig, job), rig.module_scene()) else {
            return Err(unfit(&"it has no path, or the plate has no IMU"));
        };
        let rest = Rest::new(family.module(), &scene.loads([0.0; 4])).map_err(|error| unfit(&error))?;
        let way = Way {
            lead: whisk.lead,
            periods: whisk.periods,
            times: &whisk.times,
            pressures: &whisk.pressures,
            targets: whisk.path(),
        };
        let course = Course::new(&rest, &way).map_err(|error| unfit(&error))?;
        Ok(Guide { family, rest, course })
    }
}

/// One FREE of the module.
#[derive(Debug)]
struct Channel {
    /// Its index in the rig.
    free: usize,
    /// s.
    lag: f64,
    /// s, with half of the time in which its line serves it once.
    dead_time: f64,
    /// A reading's way back.
    reply: Duration,
    /// Pa.
    highest: f64,
    /// The latest pressures, Pa, and when they were read.
    memory: VecDeque<(Time, f64)>,
}

/// Leads the plate.
#[derive(Debug)]
pub(super) struct Follower<'g> {
    guide: &'g Guide<'g>,
    pursuit: Pursuit<'g>,
    program: Arc<Program>,
    channels: [Channel; 4],
    /// From the motion to its reading.
    delay: Duration,
    /// The plate's normal in its sensor's frame.
    axis: [f64; 3],
    poses: Arc<PoseDesk>,
    file: Option<TipWriter>,
    /// When rotation and position were last seen.
    rotation: Option<Time>,
    position: Option<Time>,
}

impl<'g> Follower<'g> {
    /// Of `job` on its way with `guide`, whose record goes to `folder`; from now on poses are wanted.
    ///
    /// # Errors
    /// Where the record cannot be begun.
    pub fn new(rig: &Rig, job: &Job, guide: &'g Guide<'g>, folder: &Path) -> Result<Follower<'g>, DaemonError> {
        let frees = rig.module.as_ref().map_or([0; 4], |module| module.frees);
        let imu = rig.control.frees.get(frees[0]).and_then(|free| free.imu);
        let channels = frees.map(|free| {
            let known = rig.control.frees.get(free);
            Channel {
                free,
                lag: known.map_or(0.0, |free| free.regulator.lag.as_secs_f64()),
                dead_time: known
                    .map_or(0.0, |free| (free.regulator.dead_time + free.regulator.period / 2).as_secs_f64()),
                reply: Duration::try_from_secs_f64(rig.reply(free)).unwrap_or_default(),
                highest: known.map_or(0.0, |free| free.limits.pressure_max),
                memory: VecDeque::new(),
            }
        });
        let file = TipWriter::create(folder)?;
        job.poses.want(true);
        Ok(Follower {
            guide,
            pursuit: Pursuit::new(&guide.rest, guide.family),
            program: Arc::clone(&job.program),
            channels,
            delay: imu.map_or(Duration::ZERO, |imu| imu.delay),
            axis: imu.map_or([0.0, 0.0, 1.0], |imu| imu.axis),
            poses: Arc::clone(&job.poses),
            file: Some(file),
            rotation: None,
            position: None,
        })
    }

    /// One look at the rig: what is to be added to the plan's pressures; none where there is nothing to go by.
    pub fn turn(&mut self, record: &TickRecord) -> Option<Trim> {
        let t = record.program_time;
        if record.state != State::Track || !t.is_finite() {
            return None;
        }
        for channel in &mut self.channels {
            channel.remember(record);
        }
        self.look(record, t)?;
        self.trim(record.time, t)
    }

    /// Learns from the plate's IMU and from a tracker; none where the IMU has nothing to say.
    fn look(&mut self, record: &TickRecord, t: f64) -> Option<()> {
        let plate = record.frees().get(self.channels[0].free)?;
        let imu = &plate.imu;
        if imu.health != ImuHealth::Good || record.time.since(imu.time) > OLD {
            return None;
        }
        let seen = imu.time - self.delay;
        let since = |before: Option<Time>| before.map_or(f64::INFINITY, |before| seen.seconds_since(before));
        let mut held = None;
        let program_time = t - record.time.seconds_since(seen);
        if since(self.rotation) > 0.0 {
            let rotation = turned(self.axis, plate.estimate.tare, imu.quaternion)?;
            let sight = Seen { rotation: Some(rotation), ..self.sight(seen, program_time, since(self.rotation)) };
            held = self.pursuit.see(&sight);
            self.rotation = Some(seen);
        }
        let tracker = self.poses.take(record.time).filter(|pose| self.position.is_none_or(|last| pose.time > last));
        let tracker = tracker.and_then(|pose| self.track(&pose, t - record.time.seconds_since(pose.time)));
        if let Some(held) = held {
            self.write(program_time, &held, tracker);
        }
        Some(())
    }

    /// Learns from a tracker's `pose` at the program's time `t`; whether it was believed.
    fn track(&mut self, pose: &Sighting, t: f64) -> Option<(Vector3<f64>, bool)> {
        let dt = self.position.map_or(f64::INFINITY, |last| pose.time.seconds_since(last));
        self.position = Some(pose.time);
        let sight = Seen {
            rotation: pose.rotation,
            position: Some((pose.position, pose.deviation)),
            ..self.sight(pose.time, t, dt)
        };
        let held = self.pursuit.see(&sight)?;
        Some((pose.position, held.believed.unwrap_or(false)))
    }

    /// The pressures at `time`, which is `t` of the program.
    fn sight(&self, time: Time, t: f64, dt: f64) -> Seen {
        // A reading about zero may lie below it: there the model ends.
        let pressures = std::array::from_fn(|i| self.channels[i].pressure(time).max(0.0));
        let rates = std::array::from_fn(|i| {
            let channel = &self.channels[i];
            self.program.reference(channel.free, t - channel.lag - channel.dead_time).rate
        });
        Seen { dt, pressures, rates, rotation: None, position: None }
    }

    /// The trim that was made at `now`, the program's time `t`.
    fn trim(&mut self, now: Time, t: f64) -> Option<Trim> {
        let plan = |free: usize, t: f64| self.program.reference(free, t);
        let lag = self.pursuit.belief().lag().clamp(0.0, SLOWEST);
        let reach = |channel: &Channel| channel.lag + channel.dead_time;
        // When the pressures asked for now will have come to the plate.
        let then = t + HALF + lag + self.channels.iter().map(reach).sum::<f64>() / 4.0;
        let ahead = Ahead {
            pressures: std::array::from_fn(|i| plan(self.channels[i].free, then).position),
            highest: std::array::from_fn(|i| self.channels[i].highest),
            most: trim::MOST,
            margin: MARGIN.min(0.9 * self.guide.course.least_margin()),
        };
        let target = self.guide.course.at(then);
        // The plan itself, led by what the regulator does to it.
        let led: [f64; 4] = std::array::from_fn(|i| {
            let channel = &self.channels[i];
            let reference = plan(channel.free, t + HALF + lag + channel.dead_time);
            reference.position + channel.lag * reference.rate - plan(channel.free, t + HALF).position
        });
        let wanted = self.pursuit.correct(&target, &ahead)?;
        let mut pressure = [0.0; MAX_FREES];
        for ((channel, wanted), led) in self.channels.iter().zip(wanted).zip(led) {
            if let Some(to) = pressure.get_mut(channel.free) {
                *to = wanted + led;
            }
        }
        Some(Trim { time: now, pressure })
    }

    /// A record that cannot be kept is told once; the run goes on.
    fn write(&mut self, time: f64, held: &Held, tracker: Option<(Vector3<f64>, bool)>) {
        let unknowns = self.pursuit.belief().unknowns();
        let line = TipLine {
            time,
            position: held.position,
            deviation: held.deviation,
            tracker,
            unknowns: std::array::from_fn(|i| unknowns[i].0),
        };
        if let Some(Err(error)) = self.file.as_mut().map(|file| file.write(&line)) {
            tracing::warn!(%error, "where the plate was held to be is no longer recorded");
            self.file = None;
        }
    }
}

impl Drop for Follower<'_> {
    fn drop(&mut self) {
        self.poses.want(false);
    }
}

impl Channel {
    /// Takes up the reading of `record`, or the command where nothing is measured.
    fn remember(&mut self, record: &TickRecord) {
        let Some(tick) = record.frees().get(self.free) else { return };
        let reading = &tick.pressure;
        let known = match reading.health {
            RegulatorHealth::Good if reading.pressure.is_finite() => (reading.time - self.reply, reading.pressure),
            _ => (record.time, tick.command),
        };
        if self.memory.back().is_none_or(|last| known.0 > last.0) {
            self.memory.push_back(known);
        }
        while self.memory.front().is_some_and(|first| record.time.since(first.0) > MEMORY) && self.memory.len() > 1 {
            self.memory.pop_front();
        }
    }

    /// The pressure at `time`, between the readings around it; the nearest where there are not two.
    fn pressure(&self, time: Time) -> f64 {
        let after = self.memory.iter().position(|(t, _)| *t >= time);
        match after.map(|k| (k.checked_sub(1).map(|k| self.memory[k]), self.memory[k])) {
            Some((Some(before), after)) => {
                let share = time.seconds_since(before.0) / after.0.seconds_since(before.0);
                before.1 + share * (after.1 - before.1)
            }
            Some((None, only)) => only.1,
            None => self.memory.back().map_or(0.0, |last| last.1),
        }
    }
}

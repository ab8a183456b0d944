//! Fault drill: every fault of the matrix is brought about on the simulated rig, again and again at random phases of
//! tick, bus and sensor, and it is measured how long until the rig sees it, and how long until the pressure is gone.
//!
//! The whole rig is there, chips under the real drivers included; only time is stepped. A time counts from the instant
//! at which the *truth* (the plant, the chip, the cable) is wrong, which nobody on the rig can know; where a sensor has
//! a delay of its own (`imu_delay_ms`) from the instant at which its registers can show it.
//!
//! The limits are those of the matrix:
//!
//! | what | limit |
//! | --- | --- |
//! | detection | debounce + one period of the device + one tick; a debounce of n samples is n periods |
//! | vent | `vent_time_s` after detection, for the last FREE to come below `zero_pressure_psi` |
//! | ramp | `ramp_time_s` + `vent_time_s` after detection |

mod cases;
mod scene;

use rand::{Rng as _, SeedableRng};
use rand_pcg::Pcg64;

pub use cases::{Case, cases};
use scene::Scene;

use super::DaemonError;
use crate::config::Rig;
use crate::control::Reaction;

/// Random phases are drawn from this, s: a few periods of every device, and no multiple of any.
const PHASE: f64 = 0.0731;
/// Beyond its limit a time is waited for so many times as long before it counts as never.
const PATIENCE: f64 = 2.0;

/// What one repetition has found; s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// From the cause to the fault in the record; infinite where it was not seen.
    pub detection: f64,
    /// From detection to the last true pressure below p_zero; infinite where it stayed; none where the reaction takes
    /// no pressure away.
    pub fall: Option<f64>,
    /// Another fault than the one provoked was latched before it.
    pub other: bool,
}

/// What all repetitions of a case have found.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Longest detection, s.
    pub detection: f64,
    /// Its limit, s.
    pub detection_limit: f64,
    /// Longest fall of the pressure and its limit, s; none where the reaction takes no pressure away.
    pub fall: Option<(f64, f64)>,
    /// Something was outside its limit, or another fault came first.
    pub failed: bool,
}

/// One repetition of `case` on the rig of `rig`; `seed` draws phases, noise and the scatter of the plant.
///
/// # Errors
/// If the rig cannot be built, or does not arm.
pub fn trial(rig: &Rig, case: &Case, seed: u64) -> Result<Trial, DaemonError> {
    let mut rig = rig.clone();
    rig.bench.seed = rig.bench.seed.wrapping_add(seed.wrapping_mul(7919));
    (case.prepare)(&mut rig);
    let mut rng = Pcg64::seed_from_u64(seed ^ (case.code as u64) << 32);
    let mut scene = Scene::new(rig)?;
    scene.begin(case.start)?;
    scene.pass(rng.random_range(0.0..PHASE))?;
    for _ in 0..case.stalls {
        scene.stall()?;
    }
    (case.provoke)(&mut scene);
    let begun = scene.when(case.begun)?;
    let longest = PATIENCE * case.detection_limit(&scene.rig);
    let Some((seen, other)) = scene.detect(case, begun, longest)? else {
        let fall = case.fall_limit(&scene.rig).map(|_| f64::INFINITY);
        return Ok(Trial { detection: f64::INFINITY, fall, other: false });
    };
    (case.repair)(&mut scene);
    let fall = match case.fall_limit(&scene.rig) {
        Some(limit) => Some(scene.fall(seen, PATIENCE * limit)?),
        None => None,
    };
    Ok(Trial { detection: seen.seconds_since(begun), fall, other })
}

impl Outcome {
    /// The worst of `trials` against the limits of `case` on `rig`.
    pub fn of(rig: &Rig, case: &Case, trials: &[Trial]) -> Self {
        let worst = |pick: &dyn Fn(&Trial) -> Option<f64>| trials.iter().filter_map(pick).fold(0.0, f64::max);
        let detection = worst(&|t| Some(t.detection));
        let detection_limit = case.detection_limit(rig);
        let fall = case.fall_limit(rig).map(|limit| (worst(&|t| t.fall), limit));
        let late = detection > detection_limit || fall.is_some_and(|(worst, limit)| worst > limit);
        Self { detection, detection_limit, fall, failed: late || trials.iter().any(|t| t.other) }
    }
}

impl Case {
    /// Longest time to detection, s.
    pub fn detection_limit(&self, rig: &Rig) -> f64 {
        (self.debounce)(rig) + (self.period)(rig) + rig.control.period.as_secs_f64()
    }

    /// Longest time from detection to the last pressure below p_zero, s; none where nothing has to fall.
    pub fn fall_limit(&self, rig: &Rig) -> Option<f64> {
        let (ramp, vent) = (rig.control.ramp_time.as_secs_f64(), rig.control.vent_time.as_secs_f64());
        match self.reaction {
            _ if !self.falls => None,
            Reaction::Ramp => Some(ramp + vent),
            Reaction::Vent => Some(vent),
            Reaction::None | Reaction::Warn | Reaction::Hold => None,
        }
    }
}

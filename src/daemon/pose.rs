//! What an external tracker sees of a module's plate, on its way from the control socket to the model thread: the
//! latest pose only, refused where it cannot be one, and of no use once it is old.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::api;
use super::stepped::lock;
use crate::clock::Time;

/// A pose that is older than this when it comes, or when it is to be used, is not used.
pub const STALE: Duration = Duration::from_millis(200);
/// A plate is not farther from its bases than this, m.
const FARTHEST: f64 = 2.0;
/// Standard deviations of a position that make sense, m.
const DEVIATION: std::ops::RangeInclusive<f64> = 1e-6..=0.1;

/// The plate as something outside saw it, in the module's frame: from the middle of the bases, z towards the plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// When it was seen.
    pub time: Time,
    /// Its centre, m.
    pub position: Vector3<f64>,
    /// Standard deviation of each coordinate, m.
    pub deviation: f64,
    /// Its rotation from rest, where it was seen.
    pub rotation: Option<UnitQuaternion<f64>>,
}

impl Sighting {
    /// What `pose` says that came at `now`.
    ///
    /// # Errors
    /// What of it cannot be, with the rule.
    pub fn of(pose: &api::Pose, now: Time) -> Result<Sighting, String> {
        let [x, y, z] = pose.position_m;
        let position = Vector3::new(x, y, z);
        // A comparison with what is not a number is false: nothing of the kind passes.
        if !pose.position_m.iter().all(|x| x.abs() <= FARTHEST) {
            return Err(format!("position_m is {x}, {y}, {z}: each must be within {FARTHEST} m of the bases"));
        }
        if !DEVIATION.contains(&pose.deviation_m) {
            return Err(format!("deviation_m is {}: must be 1e-6 to 0.1", pose.deviation_m));
        }
        if !(0.0..=STALE.as_secs_f64()).contains(&pose.age_s) {
            let longest = STALE.as_secs_f64();
            return Err(format!(
                "age_s is {}: a pose is of use for {longest} s, and none is from the future",
                pose.age_s
            ));
        }
        let rotation = match pose.quaternion_wxyz {
            None => None,
            Some([w, x, y, z]) => {
                let q = Quaternion::new(w, x, y, z);
                if !(0.99..=1.01).contains(&q.norm()) {
                    return Err(format!("quaternion_wxyz has the norm {}: must be 1 within 1 %", q.norm()));
                }
                Some(UnitQuaternion::from_quaternion(q))
            }
        };
        let time = now - Duration::from_secs_f64(pose.age_s);
        Ok(Sighting { time, position, deviation: pose.deviation_m, rotation })
    }
}

/// The latest sighting, and whether anybody wants one.
#[derive(Debug, Default)]
pub struct PoseDesk {
    wanted: AtomicBool,
    latest: Mutex<Option<Sighting>>,
}

impl PoseDesk {
    /// Whether a run follows a path.
    pub fn is_wanted(&self) -> bool {
        self.wanted.load(Ordering::Acquire)
    }

    /// A run begins to follow a path, or ends: nothing from before it counts.
    pub fn want(&self, wanted: bool) {
        *lock(&self.latest) = None;
        self.wanted.store(wanted, Ordering::Release);
    }

    /// The plate has been seen.
    pub fn put(&self, sighting: Sighting) {
        *lock(&self.latest) = Some(sighting);
    }

    /// The latest sighting, once, if it is not stale at `now`.
    pub fn take(&self, now: Time) -> Option<Sighting> {
        lock(&self.latest).take().filter(|sighting| now.since(sighting.time) <= STALE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose() -> api::Pose {
        api::Pose { position_m: [1e-3, -2e-3, 0.13], quaternion_wxyz: None, age_s: 0.02, deviation_m: 5e-4 }
    }

    #[test]
    fn a_pose_that_cannot_be_is_refused_with_its_rule() {
        let now = Time::ZERO + Duration::from_secs(9);
        let told = |change: &dyn Fn(&mut api::Pose), word: &str| {
            let mut pose = pose();
            change(&mut pose);
            let error = Sighting::of(&pose, now).unwrap_err();
            assert!(error.contains(word), "{error}");
        };
        for wrong in [f64::NAN, f64::INFINITY, -3.0] {
            told(&|p| p.position_m[1] = wrong, "position_m");
            told(&|p| p.age_s = wrong, "age_s");
            told(&|p| p.deviation_m = wrong, "deviation_m");
            told(&|p| p.quaternion_wxyz = Some([wrong, 0.0, 0.0, 0.0]), "quaternion_wxyz");
        }
        told(&|p| p.quaternion_wxyz = Some([0.0; 4]), "norm");
        told(&|p| p.age_s = 0.21, "age_s");
        told(&|p| p.deviation_m = 0.0, "deviation_m");
        let good = Sighting::of(&pose(), now).unwrap();
        assert_eq!((good.time, good.rotation), (now - Duration::from_millis(20), None));
    }

    #[test]
    fn a_sighting_is_taken_once_and_not_when_it_is_old_or_from_an_earlier_run() {
        let (desk, seen) = (PoseDesk::default(), Time::ZERO + Duration::from_secs(1));
        let sighting = Sighting::of(&api::Pose { age_s: 0.0, ..pose() }, seen).unwrap();
        assert!(!desk.is_wanted());
        desk.want(true);
        assert!(desk.is_wanted());
        for (age, found) in [(0, true), (200, true), (201, false)] {
            desk.put(sighting);
            assert_eq!(desk.take(seen + Duration::from_millis(age)).is_some(), found, "{age} ms");
            assert_eq!(desk.take(seen), None);
        }
        desk.put(sighting);
        desk.want(true);
        assert_eq!(desk.take(seen), None);
    }
}

//! Real-time rights of the calling thread: what was asked, what was granted, and what to do about a refusal.

use std::fmt;
use std::fs::File;
use std::io::Write;
use std::num::NonZeroU64;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_setaffinity, set_current_timer_slack};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};

/// A right that was not granted: which, why, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The right, as a noun: `SCHED_FIFO at priority 80`.
    pub right: String,
    /// What the system said.
    pub reason: String,
    /// What to do.
    pub remedy: &'static str,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "no {}: {}; {}", self.right, self.reason, self.remedy)
    }
}

/// What the periodic thread was granted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rights {
    /// SCHED_FIFO, with its priority.
    pub fifo: Result<u8, Refusal>,
    /// Memory locked, present and future, as far as it has been touched.
    pub locked: Result<(), Refusal>,
    /// Bound to one CPU; `Ok(None)` where that was not asked.
    pub pinned: Result<Option<usize>, Refusal>,
    /// Deep idle states of the processor, which cost wake-up time, are switched off while the thread runs. A
    /// convenience, not a condition: see [`Rights::realtime`].
    pub awake: Result<(), Refusal>,
}

impl Rights {
    /// Whether the thread is a real-time thread: SCHED_FIFO and locked memory.
    pub fn realtime(&self) -> bool {
        self.fifo.is_ok() && self.locked.is_ok()
    }

    /// The rights whose absence a caller must say loudly; empty for a real-time thread on its CPU.
    pub fn refusals(&self) -> impl Iterator<Item = &Refusal> {
        [self.fifo.as_ref().err(), self.locked.as_ref().err(), self.pinned.as_ref().err()].into_iter().flatten()
    }
}

const FIFO_REMEDY: &str = "run freerig as the service (LimitRTPRIO in its unit), or give your user `rtprio 95` in /etc/security/limits.d and log in again";
const LOCK_REMEDY: &str = "run freerig as the service (LimitMEMLOCK=infinity in its unit), or give your user `memlock unlimited` in /etc/security/limits.d and log in again";
const NOT_ASKED: &str = "not asked for";
const ASK: &str = "ask for it where the loop is configured";

/// SCHED_FIFO for the calling thread. Without it at least the timer slack of the ordinary scheduler (50 us) goes.
///
/// # Errors
///
/// The system's refusal, with its remedy; the thread goes on with the ordinary scheduler.
pub fn fifo(priority: Option<u8>) -> Result<u8, Refusal> {
    let refused = |right: String, reason: String, remedy| {
        // Fails only where /proc is mounted oddly, and then nothing is lost but those 50 us.
        set_current_timer_slack(NonZeroU64::new(1)).ok();
        Refusal { right, reason, remedy }
    };
    let Some(priority) = priority else {
        return Err(refused("SCHED_FIFO".into(), NOT_ASKED.into(), ASK));
    };
    let right = || format!("SCHED_FIFO at priority {priority}");
    let value = thread_priority::ThreadPriorityValue::try_from(priority)
        .map_err(|e| refused(right(), e, "choose a priority of 1..=99"))?;
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(value),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .map_err(|e| match e {
        thread_priority::Error::OS(code) => {
            refused(right(), std::io::Error::from_raw_os_error(code).to_string(), FIFO_REMEDY)
        }
        other => refused(right(), format!("{other:?}"), "choose a priority of 1..=99"),
    })?;
    Ok(priority)
}

/// Locks the whole process, future mappings included, each page from its first use on.
pub(super) fn lock(asked: bool) -> Result<(), Refusal> {
    let refused = |reason: String, remedy| Refusal { right: "locked memory".into(), reason, remedy };
    if !asked {
        return Err(refused(NOT_ASKED.into(), ASK));
    }
    // Below a limit the lock may succeed now and make every later allocation beyond the limit fail.
    let unlimited = getrlimit(Resource::Memlock).current.is_none();
    let capable = capabilities(None).is_ok_and(|c| c.effective.contains(CapabilitySet::IPC_LOCK));
    if !unlimited && !capable {
        let limit = getrlimit(Resource::Memlock).current.unwrap_or(0) / 1024;
        return Err(refused(format!("the limit of locked memory is {limit} KiB, not unlimited"), LOCK_REMEDY));
    }
    mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT)
        .map_err(|e| refused(e.to_string(), LOCK_REMEDY))
}

/// Binds the calling thread to one CPU.
pub(super) fn pin(cpu: Option<usize>) -> Result<Option<usize>, Refusal> {
    let Some(cpu) = cpu else { return Ok(None) };
    let refused = |reason: String| Refusal {
        right: format!("CPU {cpu}"),
        reason,
        remedy: "choose a CPU that this process may use (`taskset -cp $$` lists them)",
    };
    if cpu >= CpuSet::MAX_CPU {
        return Err(refused("there is no such CPU".into()));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    sched_setaffinity(None, &set).map_err(|e| refused(e.to_string()))?;
    Ok(Some(cpu))
}

/// Asks the kernel for no wake-up latency from idle states; it holds while the file is open.
pub(super) fn stay_awake() -> Result<File, Refusal> {
    let open = || {
        let mut file = File::options().write(true).open("/dev/cpu_dma_latency")?;
        file.write_all(&0i32.to_ne_bytes())?;
        Ok(file)
    };
    open().map_err(|e: std::io::Error| Refusal {
        right: "shallow idle states".into(),
        reason: format!("/dev/cpu_dma_latency: {e}"),
        remedy: "give the service's user write access to /dev/cpu_dma_latency (udev rule), or boot with cpuidle.off=1",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_asked_is_not_granted_and_what_cannot_be_is_refused_with_a_remedy() {
        assert_eq!(fifo(None).unwrap_err().reason, NOT_ASKED);
        assert_eq!(lock(false).unwrap_err().reason, NOT_ASKED);
        assert_eq!(pin(None), Ok(None));
        for refusal in [fifo(Some(100)).unwrap_err(), fifo(Some(0)).unwrap_err(), pin(Some(1 << 20)).unwrap_err()] {
            assert!(!refusal.reason.is_empty() && refusal.remedy.contains("choose"), "{refusal}");
        }
    }

    #[test]
    fn a_thread_is_real_time_only_with_both_rights() {
        let refusal = || Refusal { right: "x".into(), reason: "y".into(), remedy: "z" };
        let rights = |fifo, locked| Rights { fifo, locked, pinned: Ok(None), awake: Err(refusal()) };
        assert!(rights(Ok(80), Ok(())).realtime());
        assert!(!rights(Err(refusal()), Ok(())).realtime());
        assert!(!rights(Ok(80), Err(refusal())).realtime());
        assert_eq!(rights(Err(refusal()), Err(refusal())).refusals().count(), 2);
        assert_eq!(rights(Ok(80), Ok(())).refusals().count(), 0);
    }
}

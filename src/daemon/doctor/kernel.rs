//! The machine: real-time rights, kernel, processors, clocks.

use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustix::thread::ClockId;
use rustix::time::clock_getres;

use super::{Finding, Level};
use crate::config::LoopConfig;
use crate::rt::{self, Realtime, Refusal};

/// Clock sources that are read in nanoseconds, without leaving the processor.
const FAST_CLOCKS: [&str; 4] = ["tsc", "kvm-clock", "hyperv_clocksource_tsc_page", "arch_sys_counter"];
/// 2026-01-01: before it, the clock has not been set.
const CLOCK_IS_SET: u64 = 1_767_225_600;

pub(super) fn look(config: Option<&LoopConfig>, tell: &mut dyn FnMut(Finding)) {
    rights(config, tell);
    tell(preemption());
    tell(isolation(config.and_then(|c| c.cpu), &read("/sys/devices/system/cpu/isolated")));
    tell(governor(&governors()));
    if read("/proc/cpuinfo").lines().any(|line| line.starts_with("flags") && line.contains(" hypervisor")) {
        tell(Finding::warn(
            "virtual machine",
            "the hypervisor may stop it for milliseconds at any time",
            "fine for the simulated rig; drive a real one from a machine of its own",
        ));
    }
    tell(monotonic(&read("/sys/devices/system/clocksource/clocksource0/current_clocksource")));
    tell(wall(SystemTime::now()));
}

/// Starts the very loop that the daemon runs, for a moment, and looks at what it was granted.
fn rights(config: Option<&LoopConfig>, tell: &mut dyn FnMut(Finding)) {
    let realtime = Realtime {
        period: Duration::from_millis(2),
        priority: Some(config.map_or(80, |c| c.priority)),
        cpu: config.and_then(|c| c.cpu),
        lock_memory: true,
    };
    let handle = match rt::spawn(realtime, |_| ()) {
        Ok(handle) => handle,
        Err(error) => return tell(Finding::fail("real-time thread", error.to_string(), "free memory or threads")),
    };
    let granted = handle.rights();
    let refused_is = if config.is_some_and(|c| c.require_realtime) { Level::Fail } else { Level::Warn };
    let mut right = |subject: &str, outcome: Result<String, &Refusal>, refused_is: Level| match outcome {
        Ok(found) => tell(Finding::ok(subject, found)),
        Err(refusal) => {
            tell(Finding {
                level: refused_is,
                ..Finding::warn(subject, format!("no {}: {}", refusal.right, refusal.reason), refusal.remedy)
            });
        }
    };
    right("scheduling", granted.fifo.as_ref().map(|priority| format!("SCHED_FIFO at priority {priority}")), refused_is);
    right("memory", granted.locked.as_ref().map(|()| "locked".into()), refused_is);
    if let Some(cpu) = realtime.cpu {
        right("CPU of the loop", granted.pinned.as_ref().map(|_| format!("bound to CPU {cpu}")), Level::Fail);
    }
    right("idle states", granted.awake.as_ref().map(|()| "kept shallow while the loop runs".into()), Level::Warn);
}

fn preemption() -> Finding {
    let release = rustix::system::uname().release().to_string_lossy().into_owned();
    if read("/sys/kernel/realtime").trim() == "1" {
        return Finding::ok("kernel", format!("{release}, PREEMPT_RT"));
    }
    Finding::warn(
        "kernel",
        format!("{release}, not PREEMPT_RT"),
        "install a real-time kernel (on Debian: apt-get install linux-image-rt-amd64, or -rt-arm64), and compare with \
         `freerig latency`",
    )
}

fn isolation(cpu: Option<usize>, isolated: &str) -> Finding {
    let isolated = isolated.trim();
    match cpu {
        Some(cpu) if !ranges(isolated).any(|(low, high)| (low..=high).contains(&cpu)) => Finding::warn(
            "isolated CPUs",
            format!("CPU {cpu}, which rig.toml binds the loop to, is not one of them ({})", or_none(isolated)),
            format!("boot with `isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu}`"),
        ),
        Some(_) => Finding::ok("isolated CPUs", isolated),
        None => Finding::ok("isolated CPUs", format!("{}; the loop is not bound to a CPU", or_none(isolated))),
    }
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

/// The kernel's lists: `1,3-5`.
fn ranges(list: &str) -> impl Iterator<Item = (usize, usize)> {
    list.split(',').filter_map(|part| {
        let (low, high) = part.split_once('-').unwrap_or((part, part));
        Some((low.trim().parse().ok()?, high.trim().parse().ok()?))
    })
}

fn governors() -> Vec<String> {
    let cpus = fs::read_dir("/sys/devices/system/cpu").into_iter().flatten().flatten();
    let mut names: Vec<String> = cpus
        .map(|cpu| read(cpu.path().join("cpufreq/scaling_governor")).trim().to_owned())
        .filter(|name| !name.is_empty())
        .collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn governor(names: &[String]) -> Finding {
    match names {
        [] => Finding::ok("governor", "none: the processors' frequency is not the kernel's to change"),
        [name] if name == "performance" => Finding::ok("governor", name),
        names => Finding::warn(
            "governor",
            names.join(", "),
            "`cpupower frequency-set --governor performance`: a processor that speeds up first is late",
        ),
    }
}

fn monotonic(source: &str) -> Finding {
    let (resolution, source) = (clock_getres(ClockId::Monotonic), source.trim());
    let nanoseconds = resolution.tv_sec.saturating_mul(1_000_000_000).saturating_add(resolution.tv_nsec);
    let found = format!("CLOCK_MONOTONIC from {}, resolution {nanoseconds} ns", or_none(source));
    if nanoseconds > 1000 {
        Finding::fail("clock", found, "boot a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)")
    } else if source.is_empty() || FAST_CLOCKS.contains(&source) {
        Finding::ok("clock", found)
    } else {
        Finding::warn(
            "clock",
            found,
            "reading this clock is slow: boot with `clocksource=tsc` where the machine has one",
        )
    }
}

fn wall(now: SystemTime) -> Finding {
    let seconds = now.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let date = jiff::Timestamp::from_second(seconds.try_into().unwrap_or(i64::MAX))
        .map_or_else(|_| "beyond the calendar".into(), |t| t.strftime("%Y-%m-%d %H:%M UTC").to_string());
    if seconds >= CLOCK_IS_SET {
        Finding::ok("date", date)
    } else {
        Finding::warn("date", format!("{date}: not set"), "`timedatectl set-ntp true`: runs are named by date and time")
    }
}

/// The file's text; empty where there is none.
fn read(path: impl AsRef<Path>) -> String {
    fs::read_to_string(path).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_bound_to_a_cpu_that_is_not_isolated_is_warned_of() {
        assert_eq!(isolation(Some(3), "1,3-5\n").level, Level::Ok);
        assert_eq!(isolation(Some(5), "1,3-5").level, Level::Ok);
        assert_eq!(isolation(None, "\n").level, Level::Ok);
        for (cpu, list) in [(2, "1,3-5"), (0, ""), (6, "3-5")] {
            let finding = isolation(Some(cpu), list);
            assert_eq!(finding.level, Level::Warn, "{finding}");
            assert!(finding.remedy.is_some_and(|r| r.contains(&format!("isolcpus={cpu} "))));
        }
    }

    #[test]
    fn only_a_machine_that_is_always_fast_is_fine() {
        let names = |names: &[&str]| names.iter().map(|&n| n.to_owned()).collect::<Vec<_>>();
        assert_eq!(governor(&names(&[])).level, Level::Ok);
        assert_eq!(governor(&names(&["performance"])).level, Level::Ok);
        assert_eq!(governor(&names(&["performance", "powersave"])).level, Level::Warn);
        assert_eq!(governor(&names(&["schedutil"])).level, Level::Warn);
    }

    #[test]
    fn a_clock_that_was_never_set_and_one_that_is_slow_are_warned_of() {
        assert_eq!(wall(UNIX_EPOCH + Duration::from_secs(100)).level, Level::Warn);
        assert_eq!(wall(UNIX_EPOCH + Duration::from_secs(CLOCK_IS_SET)).level, Level::Ok);
        assert_eq!(monotonic("hpet\n").level, Level::Warn);
    }
}

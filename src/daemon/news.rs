//! What happens on the rig, as a person wants to hear it: changes of state, faults with their FREE and remedy.

use super::api::{Fault, Happening};
use super::{Bench, Change, LiveBench};
use crate::config::Rig;
use crate::control::fault;
use crate::signal::{FaultCode, TickRecord};

/// A fault, and the FREE it is about.
type About = (FaultCode, Option<usize>);

/// Listens to the loop's changes and remembers which FREE a latched fault was about.
#[derive(Debug)]
pub(super) struct News {
    heard: u64,
    latched: Vec<About>,
    conditions: Vec<About>,
}

impl News {
    /// From the loop's start on.
    pub fn new() -> Self {
        Self { heard: 0, latched: Vec::new(), conditions: Vec::new() }
    }

    /// What has happened since the last time.
    pub fn turn(&mut self, bench: &mut LiveBench, rig: &Rig) -> Vec<Happening> {
        let heard = &mut self.heard;
        let (changes, latest) = bench.with_pump(|p| (p.changes(heard).collect::<Vec<_>>(), *p.latest()));
        let mut happenings = Vec::new();
        for (record, change) in changes {
            match change {
                Change::State { from, to } => {
                    happenings.push(Happening::State { from: from.name().into(), to: to.name().into() });
                }
                Change::Latched(faults) => {
                    for code in faults.iter() {
                        let about = (code, culprit(&record, code));
                        self.latched.push(about);
                        happenings.push(Happening::Fault(describe(about, true, true, rig)));
                    }
                }
                // Whoever asked is answered.
                Change::Refused(_) => {}
            }
        }
        self.latched.retain(|(code, _)| latest.latched.contains(*code));
        let now: Vec<About> = conditions(&latest).collect();
        let latched = |about: &&About| latest.latched.contains(about.0);
        for about in now.iter().filter(|a| !self.conditions.contains(a) && !latched(a)) {
            happenings.push(Happening::Fault(describe(*about, false, true, rig)));
        }
        for about in self.conditions.iter().filter(|a| !now.contains(a) && !latched(a)) {
            happenings.push(Happening::Fault(describe(*about, false, false, rig)));
        }
        self.conditions = now;
        happenings
    }

    /// The faults that are latched or whose condition holds, by their numbers.
    pub fn faults(&self, rig: &Rig) -> Vec<Fault> {
        let mut all: Vec<About> = self.latched.iter().chain(&self.conditions).copied().collect();
        all.sort_unstable();
        all.dedup();
        all.into_iter()
            .map(|about| describe(about, self.latched.contains(&about), self.conditions.contains(&about), rig))
            .collect()
    }
}

/// Every fault whose condition holds.
fn conditions(record: &TickRecord) -> impl Iterator<Item = About> {
    let frees = record.frees().iter().enumerate();
    let of_frees = frees.flat_map(|(free, tick)| tick.faults.iter().map(move |code| (code, Some(free))));
    record.faults.iter().map(|code| (code, None)).chain(of_frees)
}

/// The FREE that a fault is about.
fn culprit(record: &TickRecord, code: FaultCode) -> Option<usize> {
    record.frees().iter().position(|free| free.faults.contains(code))
}

fn describe((code, free): About, latched: bool, active: bool, rig: &Rig) -> Fault {
    let name = free.and_then(|free| rig.control.frees.get(free)).map(|free| free.name.as_str());
    Fault::new(code, name, latched, active, fault::row(code).remedy)
}

//! Times at equal error.

use crate::record::{Claim, Timed};

/// The cheapest of either side whose error is at most `error`; none where one of the sides does not come so far.
pub(super) fn claim(task: &str, error: f64, own: &[Timed], peers: &[Timed]) -> Option<Claim> {
    let cheapest = |runs: &[Timed]| {
        let good = runs.iter().filter(|run| run.error <= error);
        good.min_by(|a, b| a.time_s.total_cmp(&b.time_s)).cloned()
    };
    Some(Claim { task: task.into(), error, own: cheapest(own)?, peer: cheapest(peers)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cheapest_that_are_good_enough_are_compared() {
        let run = |who: &str, error, time_s| Timed { who: who.into(), error, time_s };
        let own = [run("a", 1e-2, 1.0), run("b", 1e-4, 2.0), run("c", 1e-5, 3.0)];
        let peers = [run("d", 1e-3, 8.0), run("e", 2e-3, 1.0)];
        let found = claim("x", 1e-3, &own, &peers).unwrap();
        assert_eq!((found.own.who.as_str(), found.peer.who.as_str(), found.ratio()), ("b", "d", 4.0));
        assert_eq!(claim("x", 1e-4, &own, &peers), None);
    }
}

//! The certified range: where the cheap tiers' errors are known without asking a dearer one.
//!
//! The range is divided into [buckets](Bucket) by hold, winding angle and relative pressure `P Ri / (mu wall)`. A
//! table, made by `freerig bench --fidelity` and stored beside this file, has for each the largest errors that seeded
//! scenes of it have really had ([`super::suite`]). That the next scene's error is larger than the largest of n alike
//! has the probability 1 / (n + 1), whatever the errors' distribution: a bucket of at least 19 scenes holds with the 95
//! % that are wanted, and no factor of safety is needed.
//!
//! What the ends take goes with one over the length, and is stored times the length over the outer radius. The linear
//! law's error is stored as what it has more than the section, to which the section's is added. The lumped equations
//! with inextensible fibres are not certified: with ke and kt from the material they are farther off than the linear
//! law nearly everywhere.
//!
//! What is not certified is estimated: the ends by a coarse solid, the solid's mesh by others. An estimate aims at the
//! error, a bound lies above it: the table has, too, the [`Factor`] between them, so large that with 95 % confidence at
//! least 95 % of the seeded scenes have no larger error than it says.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::ops::Range;
use std::sync::LazyLock;

use super::suite::RANGES;
use super::{Hold, Scene};
use crate::fem::material::Law;

/// Scenes of a bucket below which it is not certified: 1 / (19 + 1) is 5 %.
const LEAST: usize = 19;
/// Edges of the buckets: winding angle, deg, and relative pressure.
const WINDINGS: [f64; 6] = [10.0, 20.0, 30.0, 45.0, 60.0, 80.0];
const PRESSURES: [f64; 4] = [0.0, 0.1, 0.3, 0.6];
/// Number of buckets.
pub const BUCKETS: usize = 2 * (WINDINGS.len() - 1) * (PRESSURES.len() - 1);

/// Share of the scenes that a factor may leave out, and the probability that it leaves out more.
const LEFT_OUT: f64 = 0.05;
const DOUBT: f64 = 0.05;
/// What has a factor: the ends' part as a coarse solid sees it, and the solid's mesh.
pub const ESTIMATES: [&str; 2] = ["ends", "solid"];
/// Of [`ESTIMATES`].
pub(super) const ENDS: usize = 0;
pub(super) const SOLID: usize = 1;

const FACTOR_NAMES: &str = "estimate,scenes,factor,factor_seed";
const NAMES: &str =
    "hold,winding_from_deg,winding_to_deg,pressure_from,pressure_to,scenes,linear,linear_seed,ends,ends_seed";

/// What is stored: the factors, an empty line, the buckets' rows.
struct Stored {
    factors: Vec<Option<Factor>>,
    rows: Vec<Option<Row>>,
}

static STORED: LazyLock<Stored> = LazyLock::new(|| {
    let (factors, rows) = include_str!("certified.csv").split_once("\n\n").unwrap_or_default();
    let lines = |part: &'static str| part.lines().filter(|line| !line.starts_with('#')).skip(1);
    Stored { factors: lines(factors).map(Factor::parse).collect(), rows: lines(rows).map(Row::parse).collect() }
});

/// By what an estimate is multiplied to be a bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Factor {
    /// Scenes that it is of.
    pub scenes: usize,
    /// The ratio of true to estimated error of one of them, which is above those of nearly all others.
    pub factor: f64,
    /// Its seed.
    pub seed: u64,
}

impl Factor {
    /// Of the ratios (true over estimated error, seed) of scenes: the largest but so few that with 95 % confidence at
    /// least 95 % of all alike lie below it, whatever the ratios' distribution (Wilks 1941: the number of n scenes that
    /// lie above the 95 % quantile is binomial). None of fewer than 59.
    pub fn of(ratios: &[(f64, u64)]) -> Option<Factor> {
        let mut sorted = ratios.to_vec();
        sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let n = ratios.len() as f64;
        let mut exactly = (1.0 - LEFT_OUT).powf(n);
        let (mut at_most, mut above) = (exactly, 0_usize);
        while at_most <= DOUBT {
            above += 1;
            exactly *= (n - above as f64 + 1.0) / above as f64 * LEFT_OUT / (1.0 - LEFT_OUT);
            at_most += exactly;
        }
        let (factor, seed) = *sorted.get(above.checked_sub(1)?)?;
        Some(Factor { scenes: ratios.len(), factor, seed })
    }

    /// The stored one of [`ESTIMATES`]' `index`; none where its scenes were too few.
    pub fn stored(index: usize) -> Option<Factor> {
        *STORED.factors.get(index)?
    }

    fn parse(line: &str) -> Option<Factor> {
        let fields: Vec<&str> = line.split(',').collect();
        let [scenes, factor, seed] = [1, 2, 3].map(|k| fields.get(k).copied());
        Some(Factor { scenes: scenes?.parse().ok()?, factor: factor?.parse().ok()?, seed: seed?.parse().ok()? })
    }
}

/// By what the estimate `index` of [`ESTIMATES`] is multiplied; without limit where no factor is known.
pub(super) fn factor(index: usize) -> f64 {
    Factor::stored(index).map_or(f64::INFINITY, |stored| stored.factor)
}

/// A part of the certified range.
#[derive(Clone, Debug, PartialEq)]
pub struct Bucket {
    /// How the end is held.
    pub hold: Hold,
    /// Magnitude of the winding angle, deg.
    pub winding: Range<f64>,
    /// Largest pressure over mu wall / Ri.
    pub pressure: Range<f64>,
}

/// A bucket's largest errors, and the seeds of the scenes that had them.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Scenes that have an equilibrium at all their pressures.
    pub scenes: usize,
    /// Of the linear law, more than of the section.
    pub linear: (f64, u64),
    /// Of the section, times the length over the outer radius.
    pub ends: (f64, u64),
}

/// Errors that a scene's tiers may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) linear: f64,
    pub(super) section: f64,
}

impl Bucket {
    /// The bucket `index`, modulo [`BUCKETS`].
    pub fn of_seed(index: u64) -> Bucket {
        let index = (index % BUCKETS as u64) as usize;
        let (rest, pressure) = (index / (PRESSURES.len() - 1), index % (PRESSURES.len() - 1));
        let (hold, winding) = (rest / (WINDINGS.len() - 1), rest % (WINDINGS.len() - 1));
        Bucket {
            hold: if hold == 0 { Hold::Free } else { Hold::Blocked },
            winding: WINDINGS[winding]..WINDINGS[winding + 1],
            pressure: PRESSURES[pressure]..PRESSURES[pressure + 1],
        }
    }

    fn holds(&self, hold: Hold, winding: f64, pressure: f64) -> bool {
        self.hold == hold && self.winding.contains(&winding) && self.pressure.contains(&pressure)
    }
}

impl Row {
    /// The stored row of the bucket `index`; none where its scenes are too few, or one of them had no equilibrium.
    pub fn stored(index: usize) -> Option<&'static Row> {
        STORED.rows.get(index)?.as_ref()
    }

    /// The row of the errors (linear, ends, seed) of a bucket's scenes; none where one of them has none.
    pub fn of(errors: &[(Option<(f64, f64)>, u64)]) -> Option<Row> {
        let known: Vec<(f64, f64, u64)> =
            errors.iter().map(|(e, seed)| e.map(|(l, s)| (l, s, *seed))).collect::<Option<_>>()?;
        let most = |of: fn(&(f64, f64, u64)) -> f64| {
            known.iter().map(|e| (of(e), e.2)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0))
        };
        Some(Row { scenes: known.len(), linear: most(|e| e.0), ends: most(|e| e.1) })
    }

    /// Takes the largest errors for what `fine` computes of their scenes, where it is more.
    ///
    /// # Errors
    /// As `fine`.
    pub fn refine<E>(&mut self, fine: impl Fn(u64) -> Result<Option<(f64, f64)>, E>) -> Result<(), E> {
        if let Some((linear, _)) = fine(self.linear.1)? {
            self.linear.0 = self.linear.0.max(linear);
        }
        if let Some((_, ends)) = fine(self.ends.1)? {
            self.ends.0 = self.ends.0.max(ends);
        }
        Ok(())
    }

    fn parse(line: &str) -> Option<Row> {
        let fields: Vec<&str> = line.split(',').collect();
        let row = Row {
            scenes: fields.get(5)?.parse().ok()?,
            linear: (fields.get(6)?.parse().ok()?, fields.get(7)?.parse().ok()?),
            ends: (fields.get(8)?.parse().ok()?, fields.get(9)?.parse().ok()?),
        };
        (row.scenes >= LEAST).then_some(row)
    }
}

/// The table of `factors`, one for each of [`ESTIMATES`], and `rows`, one for each bucket, as it is stored; `origin`
/// says in a line where it comes from.
pub fn table(origin: &str, factors: &[Option<Factor>], rows: &[Option<Row>]) -> String {
    let mut text = format!("# {origin}\n{FACTOR_NAMES}\n");
    for (name, factor) in ESTIMATES.iter().zip(factors) {
        let _ = match factor {
            Some(Factor { scenes, factor, seed }) => writeln!(text, "{name},{scenes},{factor:.6},{seed}"),
            None => writeln!(text, "{name},,,"),
        };
    }
    let _ = writeln!(text, "\n{NAMES}");
    for (index, row) in rows.iter().enumerate() {
        let Bucket { hold, winding, pressure } = Bucket::of_seed(index as u64);
        let hold = if hold == Hold::Free { "free" } else { "blocked" };
        let _ = write!(text, "{hold},{},{},{},{}", winding.start, winding.end, pressure.start, pressure.end);
        let _ = match row {
            Some(Row { scenes, linear, ends }) => {
                writeln!(text, ",{scenes},{:.6},{},{:.6},{}", linear.0, linear.1, ends.0, ends.1)
            }
            None => writeln!(text, ",,,,,"),
        };
    }
    text
}

/// What `scene` can rely on; none outside of the certified range.
pub(super) fn bounds(scene: &Scene) -> Option<Bounds> {
    let tube = &scene.tube;
    let radius = tube.outer_radius();
    let (mu, alpha) = match tube.law {
        Law::Ogden { mu, alpha } => (mu, alpha),
        Law::NeoHookean { mu } => (mu, 2.0),
        Law::Linear { .. } => return None,
    };
    let cover = tube.fiber_width * tube.fibers as f64 / (2.0 * PI * radius);
    let inside = RANGES.wall.contains(&(tube.wall / tube.inner_radius))
        && RANGES.fibers.contains(&tube.fibers)
        && RANGES.cover.contains(&cover)
        && RANGES.stiffness.contains(&(tube.fiber_ea / (mu * radius * radius)))
        && RANGES.alpha.contains(&alpha)
        && RANGES.length.contains(&(scene.length / radius))
        && scene.pressures.iter().all(|p| *p >= 0.0);
    let most = scene.pressures.iter().copied().fold(0.0, f64::max) * tube.inner_radius / (mu * tube.wall);
    let winding = tube.gamma.to_degrees().abs();
    let index = (0..BUCKETS).find(|&k| Bucket::of_seed(k as u64).holds(scene.hold, winding, most))?;
    let row = Row::stored(index).filter(|_| inside)?;
    let section = row.ends.0 * radius / scene.length;
    Some(Bounds { linear: row.linear.0.max(0.0) + section, section })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_leaves_out_as_many_as_tables_of_tolerance_limits_say() {
        // Of fewer than 59 not even the largest is one; the second largest from 93, the third from 124 on
        // (one-sided distribution-free limits of 95 % at 95 % confidence).
        let of = |n: u64| Factor::of(&(0..n).map(|k| (k as f64, k)).collect::<Vec<_>>());
        assert_eq!(of(58), None);
        for (n, above) in [(59, 1), (92, 1), (93, 2), (123, 2), (124, 3), (152, 3), (153, 4)] {
            assert_eq!(of(n), Some(Factor { scenes: n as usize, factor: (n - above) as f64, seed: n - above }), "{n}");
        }
        assert_eq!(of(0), None);
    }

    #[test]
    fn the_stored_table_is_read_as_it_is_written() {
        let Stored { factors, rows } = &*STORED;
        assert_eq!((factors.len(), rows.len()), (ESTIMATES.len(), BUCKETS));
        let stored = include_str!("certified.csv");
        let origin = stored.lines().next().unwrap().trim_start_matches("# ");
        assert_eq!(table(origin, factors, rows), stored);
    }
}

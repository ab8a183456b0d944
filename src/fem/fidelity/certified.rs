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

const NAMES: &str =
    "hold,winding_from_deg,winding_to_deg,pressure_from,pressure_to,scenes,linear,linear_seed,ends,ends_seed";

static STORED: LazyLock<Vec<Option<Row>>> = LazyLock::new(|| {
    let lines = include_str!("certified.csv").lines().filter(|line| !line.starts_with('#'));
    lines.skip(1).map(Row::parse).collect()
});

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
        STORED.get(index)?.as_ref()
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

/// The table of `rows`, one for each bucket, as it is stored; `origin` says in a line where it comes from.
pub fn table(origin: &str, rows: &[Option<Row>]) -> String {
    let mut text = format!("# {origin}\n{NAMES}\n");
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

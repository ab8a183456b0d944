//! What a module can reach.
//!
//! [`cases`] follows the paper's five cases of actuation, fifteen paths in the pressure. [`reach`] samples all four
//! pressures: those paths, a grid over their box, each of whose points is come to from a neighbour along a stable way,
//! then the farthest plates in directions all round, by bounded searches that begin at the farthest sample.
//!
//! What is called a hull is the convex hull of the plates *found*: each of its corners is an equilibrium, nothing
//! outside it was found, and what lies inside need not be reachable: [`Outline::filled`] says how much of it is.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::end::pressures as pressures_of;
use super::figure::{tilt, twist};
use super::{End, Ended, FREES, Limits, Margin, PlanError, Pose, Rest, Target, inverse};
use crate::fem::module::State;

/// Points of the grid along each pressure.
const GRID: usize = 5;
/// Directions of each plane in which the farthest plate is sought: a multiple of four, symmetric to both axes.
const DIRECTIONS: usize = 24;
/// Raster of each outline whose points are tried.
const RASTER: usize = 10;

/// One of the fifteen ways to pressurise one or more FREEs equally.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Case {
    /// The paper's number: 1 all four, 2 a diagonal pair, 3 one, 4 two neighbours, 5 three.
    pub number: u8,
    /// Which of A, B, C, D.
    pub on: [bool; 4],
}

/// A path of one case.
#[derive(Clone, Debug, PartialEq)]
pub struct CasePath {
    /// Which.
    pub case: Case,
    /// Pa, rising from 0; as far as the path goes.
    pub pressures: Vec<f64>,
    /// The plate at each.
    pub poses: Vec<Pose>,
    /// The margin at each.
    pub margins: Vec<Margin>,
    /// Where it ends before the highest pressure.
    pub ended: Option<Ended>,
}

/// The plates found.
#[derive(Clone, Debug, PartialEq)]
pub struct Reach {
    /// Pressures (Pa) and the plate.
    pub found: Vec<([f64; 4], Pose)>,
    /// Points of the grid that no stable way with enough margin leads to, of how many.
    pub refused: (usize, usize),
    /// Seen along z: x and y.
    pub xy: Outline,
    /// Seen along y: x and z.
    pub xz: Outline,
    /// Least and greatest turn about the plate's own axis, rad.
    pub twist: [f64; 2],
    /// Greatest angle between the plate's normal and z, rad.
    pub tilt: f64,
}

/// The convex hull of the plates found, in one plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    /// Corners, counter-clockwise, m.
    pub corners: Vec<[f64; 2]>,
    /// m2.
    pub area: f64,
    /// Share of a raster's points in it that the inverse reaches, whatever the third coordinate and the rotation.
    pub filled: f64,
}

/// A number of the paper's and ours. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// What.
    pub what: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// The paper's, read off its figures.
    pub paper: f64,
    /// Ours; none where the path ends before.
    pub ours: Option<f64>,
}

impl Comparison {
    /// `ours / paper - 1`.
    pub fn misfit(&self) -> Option<f64> {
        self.ours.map(|ours| ours / self.paper - 1.0)
    }
}

impl Case {
    /// All fifteen, by number.
    pub fn all() -> Vec<Case> {
        let mut cases: Vec<Case> = (1..16u8)
            .map(|bits| {
                let on: [bool; FREES] = std::array::from_fn(|i| bits >> i & 1 == 1);
                let number = match bits.count_ones() {
                    4 => 1,
                    2 if on[0] == on[2] => 2,
                    1 => 3,
                    2 => 4,
                    _ => 5,
                };
                Case { number, on }
            })
            .collect();
        cases.sort_by_key(|case| case.number);
        cases
    }

    /// Pa, with `pressure` in those that are on.
    pub fn pressures(&self, pressure: f64) -> [f64; 4] {
        self.on.map(|on| if on { pressure } else { 0.0 })
    }

    /// Their letters, as in "AC".
    pub fn letters(&self) -> String {
        "ABCD".chars().zip(self.on).filter(|(_, on)| *on).map(|(letter, _)| letter).collect()
    }
}

/// The fifteen paths from 0 to `highest` Pa in `points` pressures (at least 2).
///
/// # Errors
/// A pressure or a number of points that is none.
pub fn cases(rest: &Rest<'_>, highest: f64, points: usize) -> Result<Vec<CasePath>, PlanError> {
    if !(highest > 0.0 && highest.is_finite()) {
        return Err(PlanError::invalid("the highest pressure (Pa)", highest, "must be positive"));
    }
    if points < 2 {
        return Err(PlanError::invalid("the number of pressures", points as f64, "must be at least 2"));
    }
    let one = |case: Case| {
        let (pressures, poses, margins) = (Vec::new(), Vec::new(), Vec::new());
        let mut path = CasePath { case, pressures, poses, margins, ended: None };
        let mut state = rest.state().clone();
        for k in 0..points {
            let pressure = highest * k as f64 / (points - 1) as f64;
            match rest.onward(&state, &case.pressures(pressure)) {
                Ok(next) => state = next,
                Err(ended) => {
                    path.ended = Some(*ended);
                    break;
                }
            }
            path.pressures.push(pressure);
            path.poses.push(Pose::of(&state));
            path.margins.push(rest.margin(&state));
        }
        path
    };
    Ok(Case::all().into_par_iter().map(one).collect())
}

impl CasePath {
    /// How far the plate is from rest at the last pressure, sideways and along z, m; none where the path ends before.
    fn travel(&self, rest: &Rest<'_>) -> Option<(f64, f64)> {
        let last = self.poses.last().filter(|_| self.ended.is_none())?;
        let shift = Vector3::from(last.position) - rest.state().position();
        Some((shift.xy().norm(), shift.z))
    }

    /// Pressures and plates.
    fn plates(&self) -> impl Iterator<Item = ([f64; 4], Pose)> {
        self.pressures.iter().zip(&self.poses).map(|(pressure, pose)| (self.case.pressures(*pressure), *pose))
    }
}

/// The paths of a module of 30 deg and of one of 60 deg up to 7 psi against the paper's figures.
pub fn against_paper(thirty: (&Rest<'_>, &[CasePath]), sixty: (&Rest<'_>, &[CasePath])) -> Vec<Comparison> {
    let sideways = |of: (&Rest<'_>, &[CasePath]), number: u8| -> Option<f64> {
        let all: Option<Vec<f64>> =
            of.1.iter().filter(|p| p.case.number == number).map(|p| p.travel(of.0).map(|t| t.0)).collect();
        all.map(|all| all.iter().sum::<f64>() / all.len() as f64)
    };
    let range = |of: (&Rest<'_>, &[CasePath])| {
        let z = of.1.iter().flat_map(|p| &p.poses).map(|p| p.position[2]);
        let (low, high) = z.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)));
        (high > low).then_some(high - low)
    };
    let row = |what, unit, paper, ours| Comparison { what, unit, paper, ours };
    let ratio = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a / b);
    let fours = [sideways(thirty, 4), sideways(sixty, 4)];
    vec![
        row("Case 4 sideways, 30 deg", "m", 0.036, fours[0]),
        row("Case 4 sideways, 60 deg", "m", 0.020, fours[1]),
        row("Case 3 sideways, 60 deg", "m", 0.010, sideways(sixty, 3)),
        row("Case 5 sideways, 60 deg", "m", 0.010, sideways(sixty, 5)),
        row("Case 4 sideways, 30 deg to 60 deg", "", 2.0, ratio(fours[0], fours[1])),
        row("travel along z, 30 deg to 60 deg", "", 3.0, ratio(range(thirty), range(sixty))),
    ]
}

/// What the module reaches within `limits`, whose slew rate does not count; the plates of `paths`, up to their ends,
/// are among those found.
///
/// # Errors
/// Limits that are none, the lowest pressures out of reach.
pub fn reach(rest: &Rest<'_>, limits: &Limits, paths: &[CasePath]) -> Result<Reach, PlanError> {
    limits.check()?;
    let (mut states, refused) = grid(rest, limits)?;
    let planes = [[0, 1], [0, 2]];
    let ways: Vec<_> = planes.iter().flat_map(|plane| (0..DIRECTIONS).map(move |k| direction(plane, k))).collect();
    let farthest: Result<Vec<_>, _> = ways.par_iter().map(|way| farthest(rest, limits, &states, way)).collect();
    states.extend(farthest?);
    let searched = states.iter().map(|s| (pressures_of(s), Pose::of(s)));
    let found: Vec<_> = searched.chain(paths.iter().flat_map(CasePath::plates)).collect();
    let [xy, xz] = planes.map(|plane| outline(rest, limits, &states, &found, plane));
    let twists = found.iter().map(|(_, pose)| twist(pose));
    let twist = twists.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
    let tilt = found.iter().map(|(_, pose)| tilt(pose)).fold(0.0, f64::max);
    Ok(Reach { found, refused, xy: xy?, xz: xz?, twist, tilt })
}

/// The states of the grid's points that a stable way with enough margin leads to, neighbour by neighbour from the
/// lowest pressures, and how many it leads nowhere to.
fn grid(rest: &Rest<'_>, limits: &Limits) -> Result<(Vec<State>, (usize, usize)), PlanError> {
    // A channel that cannot move has one point.
    let sizes: [usize; FREES] = std::array::from_fn(|i| if limits.high[i] > limits.low[i] { GRID } else { 1 });
    let at = |index: &[usize; FREES]| -> [f64; FREES] {
        std::array::from_fn(|i| {
            let share = if sizes[i] > 1 { index[i] as f64 / (sizes[i] - 1) as f64 } else { 0.0 };
            limits.low[i] + share * (limits.high[i] - limits.low[i])
        })
    };
    let place = |index: &[usize; FREES]| index.iter().zip(sizes).fold(0, |sum, (i, size)| sum * size + i);
    let total: usize = sizes.iter().product();
    let start = rest.ramp(rest.state(), &limits.low).map_err(|ended| PlanError::NoStart(ended.end))?;
    let mut states: Vec<Option<State>> = vec![None; total];
    states[0] = Some(start);
    let mut front = vec![[0usize; FREES]];
    while !front.is_empty() {
        // From this front to the next, each of whose points is tried from every neighbour until one leads there.
        let mut ways: Vec<([usize; FREES], Vec<usize>)> = Vec::new();
        for index in &front {
            for i in 0..FREES {
                for up in [true, false] {
                    let mut next = *index;
                    match (up, index[i]) {
                        (true, k) if k + 1 < sizes[i] => next[i] = k + 1,
                        (false, k) if k > 0 => next[i] = k - 1,
                        _ => continue,
                    }
                    if states[place(&next)].is_some() {
                        continue;
                    }
                    match ways.iter_mut().find(|(to, _)| *to == next) {
                        Some((_, from)) => from.push(place(index)),
                        None => ways.push((next, vec![place(index)])),
                    }
                }
            }
        }
        let come = |(to, from): &([usize; FREES], Vec<usize>)| {
            let enough = |state: &State| rest.margin(state).smooth >= limits.margin;
            from.iter().find_map(|k| rest.ramp(states[*k].as_ref()?, &at(to)).ok().filter(enough))
        };
        let come: Vec<_> = ways.par_iter().map(come).collect();
        front.clear();
        for ((to, _), state) in ways.into_iter().zip(come) {
            if state.is_some() {
                states[place(&to)] = state;
                front.push(to);
            }
        }
    }
    let states: Vec<State> = states.into_iter().flatten().collect();
    let refused = total - states.len();
    Ok((states, (refused, total)))
}

fn direction(plane: &[usize; 2], k: usize) -> Vector3<f64> {
    // Half a step off the axes, so that the set is symmetric to them and meets none twice.
    let (sine, cosine) = (TAU * (k as f64 + 0.5) / DIRECTIONS as f64).sin_cos();
    let mut way = Vector3::zeros();
    (way[plane[0]], way[plane[1]]) = (cosine, sine);
    way
}

/// The plate that comes farthest along `way`, from the sample that does: the projection of a far point.
fn farthest(rest: &Rest<'_>, limits: &Limits, states: &[State], way: &Vector3<f64>) -> Result<State, PlanError> {
    let along = |state: &State| state.position().dot(way);
    let Some(start) = states.iter().max_by(|a, b| along(a).total_cmp(&along(b))) else {
        return Err(PlanError::NoStart(End::Limit));
    };
    let far = Target::point(start.position() + way * (3.0 * rest.module().length()));
    let found = inverse::towards(rest, &far, limits, start)?;
    Ok(if along(&found) > along(start) { found } else { start.clone() })
}

fn outline(
    rest: &Rest<'_>,
    limits: &Limits,
    states: &[State],
    found: &[([f64; 4], Pose)],
    plane: [usize; 2],
) -> Result<Outline, PlanError> {
    let corners = hull(found.iter().map(|(_, pose)| plane.map(|axis| pose.position[axis])).collect());
    let next = corners.iter().cycle().skip(1);
    let area = 0.5 * corners.iter().zip(next).map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum::<f64>();
    let extent = |i: usize| {
        let x = corners.iter().map(|c| c[i]);
        x.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)))
    };
    let extents = [extent(0), extent(1)];
    let raster: Vec<[f64; 2]> = (0..RASTER * RASTER)
        .map(|k| {
            let share = [k % RASTER, k / RASTER].map(|i| (i as f64 + 0.5) / RASTER as f64);
            std::array::from_fn(|i| extents[i].0 + share[i] * (extents[i].1 - extents[i].0))
        })
        .filter(|point| inside(&corners, point))
        .collect();
    let reached = |point: &[f64; 2]| -> Result<bool, PlanError> {
        let apart = |state: &State| {
            let tip = state.position();
            (tip[plane[0]] - point[0]).hypot(tip[plane[1]] - point[1])
        };
        let nearest = states.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        let Some(start) = nearest else { return Ok(false) };
        let mut target = Target::point(start.position());
        target.position_weight = Vector3::zeros();
        for (axis, x) in plane.into_iter().zip(point) {
            target.position[axis] = *x;
            target.position_weight[axis] = 1.0;
        }
        Ok(inverse::warm(rest, &target, limits, start, f64::INFINITY)?.shortfall.is_none())
    };
    let reached: Result<Vec<bool>, PlanError> = raster.par_iter().map(reached).collect();
    let filled = reached?.iter().filter(|r| **r).count() as f64 / raster.len().max(1) as f64;
    Ok(Outline { corners, area, filled })
}

/// The convex hull of `points`, counter-clockwise (Andrew's monotone chain).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while chain.len() >= 2 && turn(&chain[chain.len() - 2], &chain[chain.len() - 1], &p) <= 0.0 {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut below = chain(&mut points.iter().copied());
    below.extend(chain(&mut points.iter().rev().copied()));
    below
}

/// Twice the area of the triangle, positive counter-clockwise.
fn turn(a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn inside(corners: &[[f64; 2]], point: &[f64; 2]) -> bool {
    let next = corners.iter().cycle().skip(1);
    corners.len() > 2 && corners.iter().zip(next).all(|(a, b)| turn(a, b, point) >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_a_grid_is_its_square() {
        let points = (0..25).map(|k| [f64::from(k % 5), f64::from(k / 5)]);
        let corners = hull(points.collect());
        assert_eq!(corners, [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]);
        assert!(inside(&corners, &[4.0, 2.0]) && !inside(&corners, &[4.01, 2.0]));
        assert_eq!(hull(vec![[1.0, 2.0]; 3]), [[1.0, 2.0]]);
    }

    #[test]
    fn fifteen_cases_are_the_papers() {
        let all = Case::all();
        let of = |number| all.iter().filter(|c| c.number == number).map(Case::letters).collect::<Vec<_>>();
        assert_eq!(of(1), ["ABCD"]);
        assert_eq!(of(2), ["AC", "BD"]);
        assert_eq!(of(3), ["A", "B", "C", "D"]);
        assert_eq!(of(4), ["AB", "BC", "AD", "CD"]);
        assert_eq!(of(5), ["ABC", "ABD", "ACD", "BCD"]);
    }
}

//! Paths of stable equilibria: steps in pressure and ends, and limits by steps in volume.
//!
//! A step is predicted along the tangent (and the parabola through the state before) and accepted only where Newton's
//! method ends near the prediction on an equilibrium whose second variation is positive definite; otherwise it is
//! halved. Where pressure steps end, the volume leads: `dP/dV` passes through zero smoothly at a limit point of the
//! pressure.

use super::error::{Limit, LimitKind};
use super::fields::{Fields, Sector};
use super::newton::{Condition, Solution, Workspace, global_step};

/// Shortest step along a path whose ends move, as a part of it.
const SHORTEST: f64 = 1.0 / 256.0;
/// Largest change of the correction over that of the prediction.
const TRUST: f64 = 0.5;
/// Largest part of a step's way by which the tangents at its two ends may disagree: a jump of more than half of it is
/// seen. Measured on the paths of 60 seeded tubes, free and blocked, up to `mu wall / Ri`, on levels 1 and 2 and a
/// sharp mesh: with 0.03 the same 123 of 360 end at a limit, all but 12 to 0.1 % at the same pressure (those are folds
/// of which one follows another, 7 % on at most); with 0.3 one path differs, without the check two step over their
/// fold.
const JUMP: f64 = 0.1;
/// Positions over Ro that are the same.
const ROUND_OFF: f64 = 1e-6;
/// Largest predicted change of the stretch or of twist times radius in one step.
const LARGEST: f64 = 0.3;

/// How a path has ended.
#[derive(Clone, Copy, Debug)]
pub(super) enum End {
    Reached,
    /// After this part of the way.
    Stopped(f64),
}

/// Whether stretch and twist are free to move.
pub(super) fn free(conditions: &[Condition; 3]) -> [bool; 2] {
    [0, 1].map(|k| matches!(conditions[k], Condition::Conjugate(_)))
}

/// One predicted and corrected step. None where it cannot be trusted.
fn step(sector: &Sector, workspace: &mut Workspace, from: &Solution, conditions: [Condition; 3]) -> Option<Solution> {
    let change = global_step(&from.hessian, &from.conjugate, &from.fields.globals, conditions)?;
    if change.x.abs().max(change.y.abs()) > LARGEST {
        return None;
    }
    let tangent = from.predicted(&change);
    let mut start = tangent.clone();
    from.bend(&mut start, &conditions);
    let predicted = start.position.clone();
    let solution = workspace.solve(sector, start, conditions)?;
    let distance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let gone = distance(&predicted, &from.fields.position) + 1e-3;
    let near = distance(&solution.fields.position, &predicted) < TRUST * gone;
    (near && smooth(from, &tangent, &solution, conditions)).then_some(solution)
}

/// Whether two equilibria lie on one smooth path: with the steps h between them, the tangent at the first one misses
/// the second by `h^2 u''/2` and the tangent at the second one misses the first by as much, but for the third order. A
/// state that has snapped to another branch, by a fold at the strip's end, say, that the step went across, is missed by
/// the two with opposite signs. The largest node counts: such a fold is local.
fn smooth(from: &Solution, tangent: &Fields, to: &Solution, conditions: [Condition; 3]) -> bool {
    let met = std::array::from_fn(|k| match conditions[k] {
        Condition::Held(_) => Condition::Held(from.fields.globals[k]),
        Condition::Conjugate(_) => Condition::Conjugate(from.conjugate[k]),
    });
    let Some(change) = global_step(&to.hessian, &to.conjugate, &to.fields.globals, met) else { return false };
    let back = to.predicted(&change);
    let (here, there) = (&from.fields.position, &to.fields.position);
    let (mut gone, mut missed) = (0.0_f64, 0.0_f64);
    for (k, (a, b)) in here.iter().zip(there).enumerate() {
        gone = gone.max((b - a).abs());
        missed = missed.max((b - tangent.position[k] - a + back.position[k]).abs());
    }
    missed <= JUMP * gone + ROUND_OFF
}

/// Follows the straight path from the conditions that `solution` meets to `goal`, as far as it is stable.
pub(super) fn follow(
    sector: &Sector,
    workspace: &mut Workspace,
    solution: &mut Solution,
    goal: [Condition; 3],
    attempts_at_limit: bool,
) -> End {
    let origin = solution.clone();
    let at = |part: f64| -> [Condition; 3] {
        std::array::from_fn(|k| match goal[k] {
            Condition::Held(value) => {
                let start = origin.fields.globals[k];
                Condition::Held(if part == 1.0 { value } else { start + part * (value - start) })
            }
            Condition::Conjugate(value) => {
                let start = origin.conjugate[k];
                Condition::Conjugate(if part == 1.0 { value } else { start + part * (value - start) })
            }
        })
    };
    let (mut part, mut length) = (0.0_f64, 1.0_f64);
    while part < 1.0 {
        let next = if part + 1.0001 * length >= 1.0 { 1.0 } else { part + length };
        match step(sector, workspace, solution, at(next)).filter(|found| found.stable(free(&goal))) {
            Some(found) => {
                let before = std::mem::replace(solution, found);
                solution.before = Some(Box::new(Solution { before: None, ..before }));
                part = next;
                length *= 2.0;
            }
            None => {
                length *= 0.5;
                if length < if attempts_at_limit { SHORTEST } else { 0.25 } {
                    return End::Stopped(part);
                }
            }
        }
    }
    End::Reached
}

/// dP/dV along the path with the ends' conditions unchanged; positive while the tube is stable under pressure.
fn slope(solution: &Solution, free: [bool; 2]) -> Option<f64> {
    let h = &solution.hessian;
    // Unit volume: the conjugate of the pressure is minus the volume.
    let conditions = [
        if free[0] { Condition::Conjugate(0.0) } else { Condition::Held(0.0) },
        if free[1] { Condition::Conjugate(0.0) } else { Condition::Held(0.0) },
        Condition::Conjugate(-1.0),
    ];
    Some(global_step(h, &nalgebra::Vector3::zeros(), &[0.0; 3], conditions)?.z)
}

/// Whether the mode that turns unstable between two states moves some of the rubber more than the cavity's wall: a fold
/// at the strip's end does (the wall by 0.11 to 0.67 of it in the folds of 60 seeded blocked tubes on three meshes),
/// the swelling of the whole tube does not (1 or more). Both states' responses to pressure are regular but for that
/// mode, which their difference leaves.
fn local(sector: &Sector, stable: &Solution, unstable: &Solution) -> bool {
    let mode = |node: usize| {
        let at = |solution: &Solution, k: usize| solution.responses[2].position[3 * node + k];
        (0..3).map(|k| (at(unstable, k) - at(stable, k)).powi(2)).sum::<f64>().sqrt()
    };
    let largest = (0..sector.nodes()).map(mode).fold(0.0, f64::max);
    let lines = 2 * sector.columns() + 1;
    let wall = (0..lines).map(|line| mode(sector.node(line, 0))).sum::<f64>() / lines as f64;
    wall < 0.9 * largest
}

/// Follows the path of growing (or, for a goal below, falling) pressure by steps in volume from the stable
/// `solution`, the ends as in `conditions`, until the pressure reaches its goal (None; the last state before it is
/// left in `solution`) or its extremum.
pub(super) fn search(
    sector: &Sector,
    workspace: &mut Workspace,
    solution: &mut Solution,
    conditions: [Condition; 3],
    goal: f64,
) -> Option<Limit> {
    let free = free(&conditions);
    let volume_of = |solution: &Solution| -solution.conjugate.z;
    let start = solution.fields.globals[2];
    let sign = (goal - start).signum();
    let with_volume = |volume: f64| [conditions[0], conditions[1], Condition::Conjugate(-volume)];
    let stuck = |solution: &Solution| Some(Limit { pressure: solution.fields.globals[2], kind: LimitKind::Folding });
    let Some(first) = slope(solution, free) else { return stuck(solution) };
    let mut size = ((goal - start) / first).abs().min(0.05 * volume_of(solution));
    let shortest = 1e-5 * volume_of(solution);
    let mut beyond: Option<Solution> = None;
    let mut failed = false;
    // Steps out to the first state that is not stable.
    while beyond.is_none() {
        let target = volume_of(solution) + sign * size;
        match step(sector, workspace, solution, with_volume(target)) {
            Some(found) if found.stable(free) && slope(&found, free).is_some_and(|s| s > 0.0) => {
                if (found.fields.globals[2] - goal) * sign >= 0.0 {
                    return None;
                }
                let (old, new) = (slope(solution, free)?, slope(&found, free)?);
                *solution = found;
                // The slope's own secant says where it will vanish: go there, and a little beyond.
                // Twice the size has just failed from farther away: it is not tried at once.
                let most = if failed { size } else { 2.0 * size };
                size = if new < old { (1.2 * size * new / (old - new)).clamp(0.1 * size, most) } else { most };
                failed = false;
            }
            Some(found) => beyond = Some(found),
            None => {
                failed = true;
                size *= 0.5;
                if size < shortest {
                    return stuck(solution);
                }
            }
        }
    }
    let mut beyond = beyond?;
    let kind =
        if beyond.negative > 0 && local(sector, solution, &beyond) { LimitKind::Folding } else { LimitKind::Pressure };
    let mut pressure = solution.fields.globals[2];
    for _ in 0..8 {
        let (a, b) = (slope(solution, free)?, slope(&beyond, free)?);
        let (va, vb) = (volume_of(solution), volume_of(&beyond));
        let root = if b < 0.0 { va + (vb - va) * (a / (a - b)).clamp(0.05, 0.95) } else { 0.5 * (va + vb) };
        let estimate = solution.fields.globals[2] + 0.5 * a * (root - va);
        let settled = (estimate - pressure).abs() <= 2e-5 * estimate.abs();
        pressure = estimate;
        if settled {
            break;
        }
        match step(sector, workspace, solution, with_volume(root)) {
            Some(found) if found.stable(free) && slope(&found, free)? > 0.0 => *solution = found,
            Some(found) => beyond = found,
            None => break,
        }
    }
    Some(Limit { pressure, kind })
}

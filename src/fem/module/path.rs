//! A branch of equilibria followed by arc length, through limit points and past critical ones.
//!
//! The loads are `from + mu (to - from)`; the branch is followed in (plate's pose, mu), where a limit point of mu is a
//! point like any other. Each step goes along the tangent and comes back in the plane across it; the 7 x 7 system with
//! that plane as its last row stays regular at limit points, and the rods' elimination is the same as ever.
//!
//! A [`Critical`] point is where the count of negative pivots changes, or where mu turns, found by bisection of the
//! step. At a bifurcation [`Path::branch`] leaves along a mode.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector6};

use super::newton::{Solver, modes};
use super::state::Unknowns;
use super::{Loads, Module, ModuleError, State};
use crate::fem::rod::{blocks, skew};

/// (twist of the plate about its centre with translations per length, mu).
type Direction = SVector<f64, 7>;

/// Corrections after a step; each must be below half of the one before.
const CORRECTIONS: usize = 10;
/// A correction below this ends them.
const CONVERGED: f64 = 1e-9;
/// Steps are cut down to this share of the longest before the branch counts as ended.
const SHORTEST: f64 = 1e-6;
/// Steps of one search: a branch may close upon itself without anything happening on it.
const STEPS: usize = 10_000;
/// Cosine of the largest angle between successive tangents: a sharper bend asks for a shorter step.
const BEND: f64 = 0.9;
/// Bisections of a step: to rounding of mu at a limit point, where mu is flat.
const BISECTIONS: usize = 40;

/// A point of a branch.
#[derive(Clone, Debug)]
pub struct Point {
    /// Load factor: loads are `from + mu (to - from)`.
    pub mu: f64,
    /// The equilibrium there.
    pub state: State,
    /// Unit tangent of the branch.
    tangent: Direction,
}

impl Point {
    /// dmu/ds: the load's share of the tangent, -1 to 1; it changes sign at a limit point.
    pub fn rate(&self) -> f64 {
        self.tangent[6]
    }
}

/// What happens at a critical point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The load turns: no equilibrium of this branch beyond it.
    Limit,
    /// Other branches cross: the rods buckle.
    Bifurcation,
}

/// Where stability changes or the load turns.
#[derive(Clone, Debug)]
pub struct Critical {
    /// The load factor.
    pub mu: f64,
    /// What it is.
    pub kind: Kind,
    /// The point just before it.
    pub point: Point,
    /// Negative pivots gained (lost, if negative).
    pub gained: i32,
    /// The modes: the plate's twist (rotation, translation m of its centre), one for each pivot, of unit size with
    /// translations measured in the module's length. Fewer where rods buckle without moving the plate.
    pub modes: Vec<Vector6<f64>>,
}

/// Follows one branch of a module.
pub struct Path<'a> {
    solver: Solver<'a>,
    module: &'a Module,
    from: Loads,
    to: Loads,
    point: Point,
    longest: f64,
    step: f64,
}

impl<'a> Path<'a> {
    /// From the equilibrium `start` under `from` towards `to` (mu from 0 to 1 and on), in steps of at most `longest`
    /// (radians, lengths or load factors).
    pub fn new(module: &'a Module, start: &State, to: &Loads, longest: f64) -> Result<Path<'a>, ModuleError> {
        let rods = module.mounts().len();
        if to.pressures.len() != rods {
            return Err(ModuleError::Pressures { pressures: to.pressures.len(), rods });
        }
        if !(longest > 0.0 && longest.is_finite()) {
            return Err(ModuleError::Invalid { what: "the longest step", value: longest, rule: "must be positive" });
        }
        let mut up = Direction::zeros();
        up[6] = 1.0;
        let point = Point { mu: 0.0, state: start.clone(), tangent: up };
        let from = start.loads.clone();
        let mut path =
            Path { solver: Solver::new(module), module, from, to: to.clone(), point, longest, step: longest };
        let unknowns = start.unknowns.clone();
        path.point = path.corrected(unknowns, 0.0, &up, &up)?.ok_or_else(|| path.ended(None))?.0;
        Ok(path)
    }

    /// Where it is.
    pub fn point(&self) -> &Point {
        &self.point
    }

    /// Turns round.
    pub fn reverse(&mut self) {
        self.point.tangent = -self.point.tangent;
    }

    /// Goes one step on. An error where the branch ends: the law's domain, contact.
    pub fn advance(&mut self) -> Result<&Point, ModuleError> {
        loop {
            match self.stepped(self.step) {
                Ok(Some((next, corrections))) => {
                    // Three corrections are what a step of the right size takes.
                    let factor = if corrections <= 3 { 1.5 } else { 0.8 };
                    self.step = f64::min(self.step * factor, self.longest);
                    self.point = next;
                    return Ok(&self.point);
                }
                failed if self.step < SHORTEST * self.longest => return Err(self.ended(failed.err())),
                _ => self.step *= 0.5,
            }
        }
    }

    /// Goes on to the next change of stability or turn of the load, or until mu leaves `bounds`: then none. The path
    /// stands just past it. An error where the branch ends, or goes on for ten thousand steps without either.
    pub fn next_critical(&mut self, bounds: (f64, f64)) -> Result<Option<Critical>, ModuleError> {
        for _ in 0..STEPS {
            let before = self.point.clone();
            let length = self.step;
            self.advance()?;
            if differs(&before, &self.point) {
                return self.bisect(before, length).map(Some);
            }
            if !(bounds.0..=bounds.1).contains(&self.point.mu) {
                return Ok(None);
            }
        }
        Err(self.ended(None))
    }

    /// The path leaving `critical` along its mode `index` by `amplitude` (radians or lengths; its sign chooses the
    /// side). An error where there is no such branch.
    pub fn branch(mut self, critical: &Critical, index: usize, amplitude: f64) -> Result<Path<'a>, ModuleError> {
        let Some(mode) = critical.modes.get(index) else {
            return Err(ModuleError::Invalid { what: "the mode", value: index as f64, rule: "there is no such mode" });
        };
        let length = self.module.length();
        let mut direction = Direction::zeros();
        for i in 0..6 {
            direction[i] = if i < 3 { mode[i] } else { mode[i] / length };
        }
        direction = direction.normalize() * amplitude.signum();
        self.point = critical.point.clone();
        self.point.tangent = direction;
        self.step = amplitude.abs();
        match self.stepped(amplitude.abs())? {
            Some((next, _)) => {
                self.point = next;
                self.step = self.longest;
                Ok(self)
            }
            None => Err(self.ended(None)),
        }
    }

    fn ended(&self, cause: Option<ModuleError>) -> ModuleError {
        ModuleError::Ends { fraction: self.point.mu, cause: cause.map(Box::new) }
    }

    fn bisect(&mut self, before: Point, length: f64) -> Result<Critical, ModuleError> {
        let past = std::mem::replace(&mut self.point, before);
        let (mut low, mut high) = (0.0, 1.0);
        let (mut under, mut over) = (self.point.clone(), past.clone());
        // The step may have been cut: its true length is that of its own projection.
        let length = self.projection(&past).unwrap_or(length);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            let Some((point, _)) = self.stepped(middle * length)? else { break };
            if differs(&self.point, &point) {
                (high, over) = (middle, point);
            } else {
                (low, under) = (middle, point);
            }
            if (over.mu - under.mu).abs() < 1e-12 && (high - low) * length < 1e-7 {
                break;
            }
        }
        self.point = past;
        let gained = over.state.negative_pivots() - under.state.negative_pivots();
        let kind = if under.rate() * over.rate() < 0.0 { Kind::Limit } else { Kind::Bifurcation };
        let mut near: Vec<_> = modes(&under.state.stiffness, self.module.length()).collect();
        near.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        let plate = (over.state.unstable_plate - under.state.unstable_plate).unsigned_abs() as usize;
        let modes = near.into_iter().take(plate).map(|(_, mode)| mode).collect();
        Ok(Critical { mu: 0.5 * (under.mu + over.mu), kind, point: under, gained, modes })
    }

    /// How far `to` lies along the tangent of the path's point.
    fn projection(&self, to: &Point) -> Option<f64> {
        let (a, b) = (&self.point.state, &to.state);
        let rotation = (b.rotation() * a.rotation().inverse()).scaled_axis();
        let shift = (b.position() - a.position()) / self.module.length();
        let mut way = Direction::zeros();
        way.fixed_rows_mut::<3>(0).copy_from(&rotation);
        way.fixed_rows_mut::<3>(3).copy_from(&shift);
        way[6] = to.mu - self.point.mu;
        let length = way.dot(&self.point.tangent);
        (length > 0.0).then_some(length)
    }

    /// One step of `length` along the tangent, corrected; none where the corrections do not contract or the branch
    /// bends too sharply.
    fn stepped(&mut self, length: f64) -> Result<Option<(Point, usize)>, ModuleError> {
        let Point { mu, state, tangent } = self.point.clone();
        let mut unknowns = state.unknowns;
        let loads = self.from.towards(&self.to, mu);
        self.solver.linearise(&unknowns, &loads)?;
        let along = tangent * length;
        let dp = self.pressures(along[6]);
        let eta = self.shift(&unknowns) * along.fixed_rows::<6>(0);
        self.solver.advance(&mut unknowns, &eta, Some(&dp), 0.0);
        let Some((point, corrections)) = self.corrected(unknowns, mu + along[6], &tangent, &tangent)? else {
            return Ok(None);
        };
        Ok((point.tangent.dot(&tangent) > BEND || length < 1e-3 * self.longest).then_some((point, corrections)))
    }

    /// Newton's method in the plane across `plane`; the new tangent runs the way of `sense`.
    fn corrected(
        &mut self,
        mut at: Unknowns,
        mut mu: f64,
        plane: &Direction,
        sense: &Direction,
    ) -> Result<Option<(Point, usize)>, ModuleError> {
        let mut before = f64::INFINITY;
        for corrections in 0..CORRECTIONS {
            let loads = self.from.towards(&self.to, mu);
            let (matrix, residual) = self.bordered(&at, &loads, plane)?;
            let lu = matrix.lu();
            let Some(change) = lu.solve(&residual) else { return Ok(None) };
            let dp = self.pressures(change[6]);
            let eta = self.shift(&at) * change.fixed_rows::<6>(0);
            let mut step = self.solver.advance(&mut at, &eta, Some(&dp), 1.0);
            step.size = step.size.max(change[6].abs());
            mu += change[6];
            if step.within(CONVERGED) {
                let mut unit = Direction::zeros();
                unit[6] = 1.0;
                let Some(tangent) = lu.solve(&unit) else { return Ok(None) };
                let tangent = tangent.normalize();
                let tangent = if tangent.dot(sense) < 0.0 { -tangent } else { tangent };
                let clearance = self.solver.clearance(&at)?;
                let loads = self.from.towards(&self.to, mu);
                let state = self.solver.state(at, loads, clearance, corrections + 1);
                return Ok(Some((Point { mu, state, tangent }, corrections)));
            }
            if step.size > f64::max(0.5 * before, CONVERGED) {
                return Ok(None);
            }
            before = step.size;
        }
        Ok(None)
    }

    /// The equations in (plate's scaled twist, mu), with `plane` as the last row.
    fn bordered(
        &mut self,
        at: &Unknowns,
        loads: &Loads,
        plane: &Direction,
    ) -> Result<(SMatrix<f64, 7, 7>, Direction), ModuleError> {
        let linear = self.solver.linearise(at, loads)?;
        let by_load = self.solver.by_load(at, &self.from, &self.to);
        let shift = self.shift(at);
        let mut matrix = SMatrix::<f64, 7, 7>::zeros();
        matrix.fixed_view_mut::<6, 6>(0, 0).copy_from(&shift.tr_mul(&(linear.stiffness * shift)));
        matrix.fixed_view_mut::<6, 1>(0, 6).copy_from(&-shift.tr_mul(&by_load));
        matrix.set_row(6, &plane.transpose());
        let mut residual = Direction::zeros();
        residual.fixed_rows_mut::<6>(0).copy_from(&shift.tr_mul(&linear.residual));
        Ok((matrix, residual))
    }

    fn pressures(&self, dmu: f64) -> Vec<f64> {
        self.from.pressures.iter().zip(&self.to.pressures).map(|(a, b)| (b - a) * dmu).collect()
    }

    /// Makes the twist about the origin of a scaled one about the plate's centre.
    fn shift(&self, at: &Unknowns) -> Matrix6<f64> {
        let identity = Matrix3::identity();
        blocks(identity, Matrix3::zeros(), skew(&at.plate.position()), identity * self.module.length())
    }
}

/// Stability changes or the load turns between two points.
fn differs(a: &Point, b: &Point) -> bool {
    a.state.negative_pivots() != b.state.negative_pivots() || a.rate() * b.rate() < 0.0
}

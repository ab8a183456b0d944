//! A finite tube under pressure and loads: adaptive steps, arc length, limit points.

use nalgebra::Vector3;

use super::answer::{PathEnd, SolidEquilibrium, SolidPath};
use super::body::{State, Support};
use super::cap::{AXIAL, COORDINATES, Coordinates, LATERAL, TILT, TURN, Tilt};
use super::error::SolidError;
use super::mesh::{self, Mesh, Part};
use super::system::{Control, Direction, System, SystemError};
use super::tip::Tip;
use crate::fem::ends::End;
use crate::fem::tube::Tube;

/// Most tangents of one step.
const MOST_TANGENTS: usize = 12;
/// Smallest part of a step that is tried.
const SMALLEST: f64 = 1.0 / 64.0;
/// Largest step in pressure that is tried, in units of the shear modulus: about 4 psi for the reference FREE.
const LARGEST_STEP: f64 = 0.072;

/// What a step goes to, in the body's units.
#[derive(Clone, Copy)]
struct Target {
    gas: f64,
    loads: [f64; COORDINATES],
    cap: Coordinates,
}

/// A finite tube, meshed, at its last equilibrium.
pub struct Solid {
    pub(super) system: System,
    pub(super) planes: Vec<f64>,
    pub(super) outer: Vec<Vec<(usize, f64)>>,
    pub(super) fiber: Vec<usize>,
    pub(super) copies: f64,
    pub(super) part: Part,
    pub(super) radius: f64,
    pub(super) modulus: f64,
    pub(super) state: State,
    /// The equilibrium before the last one, under the same tip.
    before: Option<State>,
    iterations: usize,
}

impl Solid {
    /// Meshes `tube` of `length` m. `bulk` is the bulk over the shear modulus; without it the rubber is
    /// incompressible.
    pub fn new(tube: &Tube, length: f64, mesh: &Mesh, bulk: Option<f64>) -> Result<Solid, SolidError> {
        let tube = tube.validated()?;
        if let Some(bulk) = bulk.filter(|b| !(10.0..=1e9).contains(b)) {
            return Err(SolidError::Bulk(bulk));
        }
        let meshed = mesh::tube(&tube, length, mesh, bulk)?;
        let state = meshed.body.rest();
        let system = System::new(meshed.body, [true; COORDINATES]).map_err(SystemError::from)?;
        Ok(Solid {
            system,
            planes: meshed.planes,
            outer: meshed.outer,
            fiber: meshed.fiber,
            copies: meshed.copies,
            part: mesh.part,
            radius: tube.outer_radius(),
            modulus: tube.law.shear_modulus(),
            state,
            before: None,
            iterations: 0,
        })
    }

    /// Unknowns: displacements, pressures in the rubber, the cap.
    pub fn unknowns(&self) -> usize {
        self.system.size() + self.system.body.pressures() + COORDINATES
    }

    /// The state of the last equilibrium, in units of the outer radius and the shear modulus.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Equilibria from rest, under `tip`, at the gauge pressures `pressures`, Pa, one after the other; `progress` is
    /// told the share of the way, 0 to 1, at each equilibrium. A path that ends early says why; a tip that cannot be
    /// reached is an error.
    pub fn follow(
        &mut self,
        tip: &Tip,
        pressures: &[f64],
        progress: &mut dyn FnMut(f64),
    ) -> Result<SolidPath, SolidError> {
        let target = self.hold(tip)?;
        self.state = self.system.body.rest();
        self.before = None;
        self.iterations = 0;
        self.system.loads = [0.0; COORDINATES];
        let still: &mut dyn FnMut(f64) = &mut |_| {};
        if let Err(error) = self.go(&Target { gas: 0.0, ..target }, still) {
            // What is held may be out of reach without the pressure that goes with it: then both come together.
            let first = pressures.first().filter(|p| p.is_finite()).ok_or(error)?;
            self.state = self.system.body.rest();
            self.before = None;
            self.iterations = 0;
            self.system.loads = [0.0; COORDINATES];
            self.go(&Target { gas: first / self.modulus, ..target }, still)?;
        }
        let mut path = SolidPath { states: Vec::new(), end: PathEnd::Reached, iterations: 0 };
        if let Some(&value) = pressures.iter().find(|p| !p.is_finite()) {
            return Err(SolidError::NotFinite { what: "pressure", value });
        }
        let mut last = 0.0;
        let ways: Vec<f64> = pressures.iter().map(|&p| (p - std::mem::replace(&mut last, p)).abs()).collect();
        let total = ways.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let mut passed = 0.0;
        for (&pressure, way) in pressures.iter().zip(ways) {
            let goal = pressure / self.modulus;
            let steps = ((goal - self.state.gas).abs() / LARGEST_STEP).ceil().max(1.0);
            let start = self.state.gas;
            for step in 1..=steps as usize {
                let gas = start + (goal - start) * step as f64 / steps;
                let piece = way / steps;
                let mut told = |part: f64| progress(((passed + part * piece) / total).min(1.0));
                if self.go(&Target { gas, ..target }, &mut told).is_err() {
                    let reached = self.state.gas * self.modulus;
                    path.end = self.limit(goal)?.map_or(PathEnd::Stuck(reached), PathEnd::Limit);
                    path.iterations = self.iterations;
                    return Ok(path);
                }
                passed += piece;
            }
            path.states.push(self.answer());
        }
        path.iterations = self.iterations;
        Ok(path)
    }

    /// Follows the branch from the last equilibrium by pseudo-arclength in pressure and volume, through limit
    /// points: `count` states, each `share` of the volume at rest (or a comparable pressure) further.
    pub fn arc(&mut self, count: usize, share: f64) -> Result<Vec<SolidEquilibrium>, SolidError> {
        let mut states = Vec::with_capacity(count);
        let rest = self.rest_volume();
        let mut forward: Option<Direction> = None;
        for _ in 0..count {
            let direction = self.tangent(forward.as_ref(), rest)?;
            self.arc_step(&direction, share * rest, rest)?;
            forward = Some(direction);
            states.push(self.answer());
        }
        Ok(states)
    }

    /// Checks the tip and holds what is to be held.
    fn hold(&mut self, tip: &Tip) -> Result<Target, SolidError> {
        let length = self.system.body.length;
        let (force, moment) = self.units();
        let mut target = Target { gas: 0.0, loads: [0.0; COORDINATES], cap: [0.0; COORDINATES] };
        // Value at rest, unit of the coordinate, unit of the load.
        let [lx, ly] = LATERAL;
        let [tx, ty] = TILT;
        let ends = [
            (AXIAL, tip.ends.axial, 1.0, length, force),
            (TURN, tip.ends.torsion, 0.0, length * self.radius, moment),
            (lx, tip.lateral[0], 0.0, 1.0 / self.radius, force),
            (ly, tip.lateral[1], 0.0, 1.0 / self.radius, force),
            (tx, tip.tilt[0], 0.0, 1.0, moment),
            (ty, tip.tilt[1], 0.0, 1.0, moment),
        ];
        for (q, end, rest, unit, load) in ends {
            let (End::Loaded(value) | End::Held(value)) = end;
            if !value.is_finite() {
                return Err(SolidError::NotFinite { what: "end condition", value });
            }
            let lateral = q != AXIAL && q != TURN;
            match end {
                _ if lateral && self.part == Part::Sector => {
                    if end != End::Held(0.0) {
                        return Err(SolidError::Lateral);
                    }
                    self.system.held[q] = true;
                }
                End::Loaded(value) => {
                    self.system.held[q] = false;
                    target.loads[q] = value / load;
                }
                End::Held(value) => {
                    self.system.held[q] = true;
                    target.cap[q] = (value - rest) * unit;
                }
            }
        }
        Ok(target)
    }

    /// Units of force and moment of the body.
    pub(super) fn units(&self) -> (f64, f64) {
        let force = self.modulus * self.radius * self.radius * self.copies;
        (force, force * self.radius)
    }

    fn rest_volume(&self) -> f64 {
        self.system.body.cap_area() * self.system.body.length
    }

    /// Goes to `target` in as many steps as it takes; `told` hears the share of them.
    fn go(&mut self, target: &Target, told: &mut dyn FnMut(f64)) -> Result<(), SolidError> {
        let start = Target { gas: self.state.gas, loads: self.system.loads, cap: self.state.cap };
        let mut predictor = (self.system.negative() == 0 && self.iterations > 0).then(|| self.predictor()).flatten();
        let still = start.loads == target.loads
            && (0..COORDINATES).all(|q| start.cap[q] == target.cap[q] || !self.system.held[q]);
        let (mut done, mut step) = (0.0, 1.0_f64);
        while done < 1.0 {
            let part = (done + step).min(1.0);
            let between = |a: f64, b: f64| a + (b - a) * part;
            let mut state = self.state.clone();
            let gas = between(start.gas, target.gas);
            if let Some(direction) = &predictor {
                self.predict(&mut state, direction, gas - self.state.gas);
            }
            state.gas = gas;
            for q in 0..COORDINATES {
                self.system.loads[q] = between(start.loads[q], target.loads[q]);
                if self.system.held[q] {
                    state.cap[q] = between(start.cap[q], target.cap[q]);
                }
            }
            self.blend(&mut state);
            // Rest is stable, whatever the system was used for before.
            let before = if self.iterations == 0 { 0 } else { self.system.negative() };
            let outcome = self.system.solve(&mut state, &Control::pressure(gas), MOST_TANGENTS);
            let found = outcome.and_then(|iterations| {
                self.iterations += iterations;
                let next = self.predictor_at(&state);
                // A step must not jump over a pressure maximum.
                match next {
                    Some(next) if self.system.negative() <= before || next.volume > 0.0 => Ok(Some(next)),
                    _ => Err(SystemError::Diverged { iterations, residual: f64::NAN }),
                }
            });
            match found {
                Ok(next) => {
                    let before = std::mem::replace(&mut self.state, state);
                    self.before = still.then_some(before);
                    predictor = next;
                    done = part;
                    told(done);
                    step *= 2.0;
                }
                Err(error) => {
                    step *= 0.5;
                    if step < SMALLEST {
                        self.restore()?;
                        return Err(error.into());
                    }
                }
            }
        }
        Ok(())
    }

    /// Lets the nodes follow where a held tip has moved from the last equilibrium, in proportion to their height.
    fn blend(&self, state: &mut State) {
        let held = self.system.held;
        let moved = |cap: Coordinates| -> Coordinates {
            std::array::from_fn(|q| if held[q] { cap[q] } else { self.state.cap[q] })
        };
        let (from, to) = (self.state.cap, moved(state.cap));
        if (1..COORDINATES).all(|q| from[q] == to[q]) {
            return;
        }
        let body = &self.system.body;
        let (a, b) = (Tilt::of(&from), Tilt::of(&to));
        let shift = Tilt::displacement(&to) - Tilt::displacement(&from);
        for (n, support) in body.supports.iter().enumerate() {
            let Support::Held(held) = support else { continue };
            let rest = body.reference[n];
            let arm = Vector3::new(rest.x, rest.y, 0.0);
            let change = (shift + (b.rotation - a.rotation) * arm) * (rest.z / body.length);
            for i in (0..3).filter(|&i| !held[i]) {
                state.positions[n][i] += change[i];
            }
        }
    }

    /// Makes the system that of the last equilibrium again.
    fn restore(&mut self) -> Result<(), SolidError> {
        self.system.evaluate(&self.state, true)?;
        Ok(self.system.factorize()?)
    }

    /// Moves `state` on by `step` in pressure along the parabola through the last two equilibria that has the tangent
    /// `direction` at the last one.
    fn predict(&self, state: &mut State, direction: &Direction, step: f64) {
        self.system.advance(state, direction, step);
        let Some(before) = &self.before else { return };
        let back = before.gas - self.state.gas;
        // Two equilibria at one pressure are on no parabola.
        if back == 0.0 || step.abs() > 2.0 * back.abs() {
            return;
        }
        let mut line = self.state.clone();
        self.system.advance(&mut line, direction, back);
        state.add_difference(before, &line, (step / back).powi(2));
    }

    fn predictor(&self) -> Option<Direction> {
        self.predictor_at(&self.state)
    }

    /// d(state)/dP with the last factorisation.
    fn predictor_at(&self, state: &State) -> Option<Direction> {
        let mut direction = self.system.direction(false, &Control::pressure(1.0))?;
        self.system.recover(state, false, &mut direction);
        Some(direction)
    }

    /// The unit tangent of the branch in (pressure, volume / `rest`), along `forward` or towards larger volume.
    fn tangent(&self, forward: Option<&Direction>, rest: f64) -> Result<Direction, SolidError> {
        let (p, v) = forward.map_or((0.0, 1.0 / rest), |f| (f.gas, f.volume / (rest * rest)));
        let control = Control { by_pressure: p, by_volume: v, value: 1.0 };
        let singular = SolidError::System(SystemError::Diverged { iterations: 0, residual: f64::NAN });
        let direction = self.system.direction(false, &control).ok_or(singular)?;
        let norm = direction.gas.hypot(direction.volume / rest);
        let control = Control { value: 1.0 / norm, ..control };
        let mut direction = self.system.direction(false, &control).ok_or(singular)?;
        self.system.recover(&self.state, false, &mut direction);
        Ok(direction)
    }

    /// One step of at most `length` (volume) along `direction`, halved where it does not converge.
    fn arc_step(&mut self, direction: &Direction, length: f64, rest: f64) -> Result<(), SolidError> {
        let (p, v) = (direction.gas, direction.volume / (rest * rest));
        let volume = self.system.volume();
        let mut step = length / rest;
        loop {
            let mut state = self.state.clone();
            let control = Control { by_pressure: p, by_volume: v, value: p * self.state.gas + v * volume + step };
            self.system.advance(&mut state, direction, step);
            match self.system.solve(&mut state, &control, MOST_TANGENTS) {
                Ok(iterations) => {
                    self.iterations += iterations;
                    self.state = state;
                    self.before = None;
                    return Ok(());
                }
                Err(error) => {
                    step *= 0.5;
                    if step * rest < length * SMALLEST {
                        self.restore()?;
                        return Err(error.into());
                    }
                }
            }
        }
    }

    /// The pressure maximum beyond the last equilibrium and before `goal`, Pa, or `None` if there is none nearby.
    /// The last equilibrium becomes that of the maximum.
    fn limit(&mut self, goal: f64) -> Result<Option<f64>, SolidError> {
        let rest = self.rest_volume();
        if goal < self.state.gas {
            return Ok(None);
        }
        let mut before: Option<(f64, f64)> = None;
        let mut forward: Option<Direction> = None;
        let mut share = 0.02;
        for _ in 0..60 {
            let direction = self.tangent(forward.as_ref(), rest)?;
            // dP/dV here, and the volume.
            let (slope, volume) = (direction.gas / direction.volume, self.system.volume());
            if let Some((v0, s0)) = before.filter(|&(_, s0)| s0 * slope <= 0.0) {
                return self.maximum((v0, s0), (volume, slope), rest).map(Some);
            }
            if slope <= 0.0 {
                return Ok(None);
            }
            before = Some((volume, slope));
            if self.arc_step(&direction, share * rest, rest).is_err() {
                return Ok(None);
            }
            if self.state.gas > goal * (1.0 + 1e-9) {
                return Ok(None);
            }
            share = (share * 1.5_f64).min(0.1);
            forward = Some(direction);
        }
        Ok(None)
    }

    /// The zero of dP/dV between two volumes, by false position.
    fn maximum(&mut self, mut a: (f64, f64), mut b: (f64, f64), rest: f64) -> Result<f64, SolidError> {
        for _ in 0..20 {
            let volume = (a.0 * b.1 - b.0 * a.1) / (b.1 - a.1);
            let direction = self.system.direction(false, &Control::volume(1.0));
            let singular = SolidError::System(SystemError::Diverged { iterations: 0, residual: f64::NAN });
            let mut direction = direction.ok_or(singular)?;
            self.system.recover(&self.state, false, &mut direction);
            let change = volume - self.system.volume();
            let mut state = self.state.clone();
            self.system.advance(&mut state, &direction, change);
            self.iterations += self.system.solve(&mut state, &Control::volume(volume), MOST_TANGENTS)?;
            self.state = state;
            self.before = None;
            let slope = self.system.direction(false, &Control::volume(1.0)).ok_or(singular)?.gas;
            // P is flat here: its error is slope times the distance to the maximum.
            let close = (slope * (b.0 - a.0)).abs() < 1e-7 * self.state.gas || (b.0 - a.0).abs() < 1e-9 * rest;
            if slope > 0.0 {
                a = (volume, slope);
                b.1 *= 0.5;
            } else {
                b = (volume, slope);
                a.1 *= 0.5;
            }
            if close {
                break;
            }
        }
        Ok(self.state.gas * self.modulus)
    }
}

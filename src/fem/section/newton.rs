//! Equilibrium of half a sector under conditions on (stretch, twist, pressure), by Newton's method.

use nalgebra::{Matrix3, Vector3};

use super::assembly::Assembly;
use super::fields::{Fields, Sector};
use super::saddle::{Increment, Saddle};

/// Iterations of one Newton solve; a start that needs more is too far away.
const ITERATIONS: usize = 9;
/// Growth of the residual at which a start is given up at once.
const LOST: f64 = 10.0;
/// Residual at which the equilibrium counts as found, in the sector's own units, and its part for the round-off of the
/// fibres' stretch.
const TOLERANCE: f64 = 1e-10;
const FIBER_TOLERANCE: f64 = 1e-14;

/// One of (stretch, twist, pressure) is held, or its conjugate (force, moment, minus the volume) is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Condition {
    Held(f64),
    Conjugate(f64),
}

/// An equilibrium of half a sector, with its linearisation.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) fields: Fields,
    /// Derivative of the potential by (stretch, twist, pressure) along equilibria.
    pub(super) conjugate: Vector3<f64>,
    /// Its derivative in turn, symmetric.
    pub(super) hessian: Matrix3<f64>,
    /// Change of the fields with (stretch, twist, pressure).
    pub(super) responses: [Increment; 3],
    /// Negative pivots of the fields' second variation at held (stretch, twist, pressure).
    pub(super) negative: usize,
    pub(super) energy: f64,
    /// The equilibrium before this one, where pressure steps lead from it.
    pub(super) before: Option<Box<Solution>>,
}

/// Storage that every solve reuses.
#[derive(Clone, Debug)]
pub(super) struct Workspace {
    pub(super) assembly: Assembly,
    pub(super) saddle: Saddle,
}

impl Workspace {
    pub(super) fn new(sector: &Sector) -> Workspace {
        Workspace { assembly: Assembly::new(sector), saddle: Saddle::new(sector, 3) }
    }

    /// The equilibrium nearest to `start`. None where there is none within Newton's reach.
    pub(super) fn solve(&mut self, sector: &Sector, start: Fields, conditions: [Condition; 3]) -> Option<Solution> {
        let mut fields = start;
        let tolerance = TOLERANCE + FIBER_TOLERANCE * sector.fiber;
        let mut best = f64::INFINITY;
        for iteration in 0..=ITERATIONS {
            self.assembly.fill(sector, &fields).ok()?;
            let norm = self.residual(sector, &fields, conditions);
            if !norm.is_finite() || norm > LOST * best || (iteration > 3 && norm > best) {
                return None;
            }
            best = best.min(norm);
            let negative = self.saddle.factorise(&self.assembly.stiffness, &sector.even)?;
            let found = norm < tolerance;
            // Where everything is held and in place, only the answer needs the derivatives by it.
            let held = (0..3).all(|k| conditions[k] == Condition::Held(fields.globals[k]));
            if held && !found {
                fields.advance(&self.saddle.correction(sector, &self.assembly), &Vector3::zeros());
                continue;
            }
            let (responses, hessian) = self.saddle.condense(sector, &self.assembly, found);
            if found {
                let (conjugate, energy) = (self.assembly.conjugate, self.assembly.energy);
                return Some(Solution { fields, conjugate, hessian, responses, negative, energy, before: None });
            }
            let mut step = self.saddle.correction(sector, &self.assembly);
            let conjugate = self.assembly.conjugate + self.assembly.conjugate_change(&step);
            let change = global_step(&hessian, &conjugate, &fields.globals, conditions)?;
            for (response, factor) in responses.iter().zip(change.iter()) {
                step.add(response, *factor);
            }
            fields.advance(&step, &change);
        }
        None
    }

    fn residual(&self, sector: &Sector, fields: &Fields, conditions: [Condition; 3]) -> f64 {
        let forces = self.assembly.residual.iter().zip(&sector.even).filter(|(_, fixed)| !**fixed);
        let mut norm: f64 = forces.map(|(r, _)| r * r).sum();
        for (constraint, mass) in self.assembly.constraint.iter().zip(&sector.mass) {
            norm += constraint.iter().map(|c| (c / mass[0]).powi(2)).sum::<f64>() * mass[0];
        }
        for (k, condition) in conditions.into_iter().enumerate() {
            norm += match condition {
                Condition::Held(value) => fields.globals[k] - value,
                Condition::Conjugate(value) => self.assembly.conjugate[k] - value,
            }
            .powi(2);
        }
        norm.sqrt()
    }
}

/// Change of (stretch, twist, pressure) that meets the conditions, from the condensed derivatives.
pub(super) fn global_step(
    hessian: &Matrix3<f64>,
    conjugate: &Vector3<f64>,
    globals: &[f64; 3],
    conditions: [Condition; 3],
) -> Option<Vector3<f64>> {
    let mut matrix = Matrix3::identity();
    let mut right = Vector3::zeros();
    for (k, condition) in conditions.into_iter().enumerate() {
        match condition {
            Condition::Held(value) => right[k] = value - globals[k],
            Condition::Conjugate(value) => {
                matrix.set_row(k, &hessian.row(k));
                right[k] = value - conjugate[k];
            }
        }
    }
    matrix.lu().solve(&right).filter(|step| step.iter().all(|x| x.is_finite()))
}

impl Fields {
    pub(super) fn advance(&mut self, step: &Increment, change: &Vector3<f64>) {
        for (x, dx) in self.position.iter_mut().zip(&step.position) {
            *x += dx;
        }
        for (q, dq) in self.multiplier.iter_mut().flatten().zip(step.multiplier.iter().flatten()) {
            *q += dq;
        }
        for (global, change) in self.globals.iter_mut().zip(change.iter()) {
            *global += change;
        }
    }
}

impl Solution {
    /// Fields predicted to first order for a change of (stretch, twist, pressure).
    pub(super) fn predicted(&self, change: &Vector3<f64>) -> Fields {
        let mut fields = self.fields.clone();
        for (response, factor) in self.responses.iter().zip(change.iter()) {
            for (x, dx) in fields.position.iter_mut().zip(&response.position) {
                *x += factor * dx;
            }
            for (q, dq) in fields.multiplier.iter_mut().flatten().zip(response.multiplier.iter().flatten()) {
                *q += factor * dq;
            }
        }
        for (global, change) in fields.globals.iter_mut().zip(change.iter()) {
            *global += change;
        }
        fields
    }

    /// Bends a prediction along the tangent onto the parabola through the equilibrium before, where all three lie on
    /// one path of pressure: then `x + a h + b h^2` with the part of b from `x_before = x - a h0 + b h0^2`.
    pub(super) fn bend(&self, start: &mut Fields, conditions: &[Condition; 3]) {
        let Some(before) = &self.before else { return };
        let Condition::Held(goal) = conditions[2] else { return };
        let gone = self.fields.globals[2] - before.fields.globals[2];
        let ratio = (goal - self.fields.globals[2]) / gone;
        let same = (0..2).all(|k| {
            let (a, b, c) = match conditions[k] {
                Condition::Held(value) => (before.fields.globals[k], self.fields.globals[k], value),
                Condition::Conjugate(value) => (before.conjugate[k], self.conjugate[k], value),
            };
            (a - c).abs() < 1e-8 && (b - c).abs() < 1e-8
        });
        if !same || !(0.0..=2.0).contains(&ratio) || ratio == 0.0 {
            return;
        }
        let bent = |old: f64, here: f64, ahead: &mut f64| {
            let along = *ahead - here;
            *ahead += ratio * ratio * (old - here + along / ratio);
        };
        let (old, here) = (&before.fields, &self.fields);
        for ((a, b), c) in old.position.iter().zip(&here.position).zip(&mut start.position) {
            bent(*a, *b, c);
        }
        let flat = |fields: &Fields| fields.multiplier.clone().into_iter().flatten();
        for ((a, b), c) in flat(old).zip(flat(here)).zip(start.multiplier.iter_mut().flatten()) {
            bent(a, b, c);
        }
        for k in 0..3 {
            bent(old.globals[k], here.globals[k], &mut start.globals[k]);
        }
    }

    /// Whether the equilibrium is a minimum under dead loads on the globals that are not held, pressure given.
    pub(super) fn stable(&self, free: [bool; 2]) -> bool {
        let h = &self.hessian;
        let block = match free {
            [true, true] => h[(0, 0)] > 0.0 && h[(0, 0)] * h[(1, 1)] > h[(0, 1)] * h[(1, 0)],
            [true, false] => h[(0, 0)] > 0.0,
            [false, true] => h[(1, 1)] > 0.0,
            [false, false] => true,
        };
        self.negative == 0 && block
    }
}

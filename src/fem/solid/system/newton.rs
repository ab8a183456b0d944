//! Newton's iteration.

use thiserror::Error;

use super::System;
use crate::fem::material::MaterialError;
use crate::fem::solid::body::State;
use crate::fem::solid::cap::COORDINATES;
use crate::fem::sparse::SparseError;

/// Largest force on a node, in the body's units, at which a state counts as an equilibrium.
pub(in crate::fem::solid) const FORCE_TOLERANCE: f64 = 1e-9;
/// Largest misfit of an element's volume, relative to that volume.
const VOLUME_TOLERANCE: f64 = 1e-9;
/// Largest difference of a thread's tension from what its stretch says.
const TENSION_TOLERANCE: f64 = 1e-8;
/// How far a state may be, in units of the body's length, from the one whose tangent still corrects it.
const NEAR: f64 = 0.05;
/// How far it may be from the one whose inertia is taken for its own.
pub(in crate::fem::solid) const SAME: f64 = 1e-3;

/// Why a Newton iteration has not ended in an equilibrium.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SystemError {
    /// An element is turned inside out.
    #[error("element {cell}: {source}")]
    Material {
        /// Its number.
        cell: usize,
        /// What the law says.
        source: MaterialError,
    },
    /// The tangent cannot be factorised.
    #[error(transparent)]
    Sparse(#[from] SparseError),
    /// No convergence.
    #[error("no equilibrium within {iterations} iterations (residual {residual:.1e})")]
    Diverged {
        /// Newton iterations done.
        iterations: usize,
        /// Largest force on a node, in units of shear modulus times radius squared.
        residual: f64,
    },
}

/// What is prescribed of the gas: `by_pressure P + by_volume V = value`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Control {
    /// Factor of the pressure.
    pub by_pressure: f64,
    /// Factor of the cavity's volume.
    pub by_volume: f64,
    /// What the sum is to be.
    pub value: f64,
}

impl Control {
    /// The pressure is prescribed.
    pub fn pressure(value: f64) -> Control {
        Control { by_pressure: 1.0, by_volume: 0.0, value }
    }

    /// The volume is prescribed.
    pub fn volume(value: f64) -> Control {
        Control { by_pressure: 0.0, by_volume: 1.0, value }
    }
}

impl System {
    /// Largest residual, forces of the loaded coordinates included.
    fn imbalance(&self) -> f64 {
        let cap = (0..COORDINATES).filter(|&q| !self.held[q]).map(|q| self.cap_residual[q].abs());
        self.residual.iter().map(|r| r.abs()).chain(cap).fold(0.0, f64::max)
    }

    /// Whether all but the cap is in equilibrium.
    pub(in crate::fem::solid) fn balanced_inside(&self) -> bool {
        self.residual.iter().all(|r| r.abs() < FORCE_TOLERANCE)
            && self.misfit < VOLUME_TOLERANCE
            && self.slack < TENSION_TOLERANCE
    }

    fn balanced(&self, state: &State, control: &Control) -> bool {
        let gas = control.by_pressure * state.gas + control.by_volume * self.volume - control.value;
        self.balanced_inside() && self.imbalance() < FORCE_TOLERANCE && gas.abs() < VOLUME_TOLERANCE
    }

    /// Newton's iteration from `state` to an equilibrium under `control`. A tangent is used again while it gains a
    /// digit at a time. On success the last factorisation is that of a state within `SAME`, and the number of
    /// corrections is returned.
    pub fn solve(&mut self, state: &mut State, control: &Control, most: usize) -> Result<usize, SystemError> {
        self.body.carry(state);
        let (mut pace, mut iterations) = (Pace::default(), 0);
        self.evaluate(state, true)?;
        let first = self.imbalance();
        self.factorize()?;
        loop {
            let value = control.value - control.by_pressure * state.gas - control.by_volume * self.volume;
            let mut direction = self
                .direction(true, &Control { value, ..*control })
                .ok_or(SystemError::Sparse(SparseError::Singular(self.matrix.size())))?;
            self.recover(state, true, &mut direction);
            let last = self.advance(state, &direction, 1.0);
            iterations += 1;
            self.evaluate(state, false)?;
            let residual = self.imbalance();
            if !(last + residual).is_finite() || (iterations > 2 && residual > 1e3 * first.max(1.0)) {
                return Err(SystemError::Diverged { iterations, residual });
            }
            let again = pace.again(last);
            if last < SAME && self.balanced(state, control) {
                if pace.moved > SAME {
                    self.evaluate(state, true)?;
                    self.factorize()?;
                }
                return Ok(iterations);
            }
            if again {
                self.resolve();
            } else if pace.tangents < most {
                self.evaluate(state, true)?;
                self.factorize()?;
                pace.renew();
            } else {
                return Err(SystemError::Diverged { iterations, residual });
            }
        }
    }
}

/// How a tangent gets on.
pub(in crate::fem::solid) struct Pace {
    /// How far the state has moved since it was made.
    pub moved: f64,
    /// Tangents so far.
    pub tangents: usize,
    last: f64,
}

impl Default for Pace {
    fn default() -> Pace {
        Pace { moved: 0.0, tangents: 1, last: f64::INFINITY }
    }
}

impl Pace {
    /// Whether the tangent should be used again after a correction of `size`.
    pub fn again(&mut self, size: f64) -> bool {
        self.moved += size;
        let good = size < 0.25 * self.last && self.moved < NEAR;
        self.last = size;
        good
    }

    /// There is a new tangent.
    pub fn renew(&mut self) {
        *self = Pace { tangents: self.tangents + 1, ..Pace::default() };
    }
}

//! One FREE in the controller: from what is wanted of it to its command.

use super::Limits;
use super::estimator::Estimator;
use super::forward::Forward;
use super::interlocks::FreeInterlocks;
use super::pid::{Band, Pid};
use crate::signal::{Estimate, LimitSet, Quantity, Reference};

/// One FREE: its part of the controller.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub(super) limits: Limits,
    pub(super) pid: Pid,
    pub(super) forward: Forward,
    pub(super) estimator: Option<Estimator>,
    pub(super) interlocks: FreeInterlocks,
    pub(super) command: f64,
}

/// What is wanted of a FREE in a tick.
pub(super) enum Wish {
    /// Zero at once: a vent, or a state in which nothing else is ever commanded.
    Zero,
    /// The pressure stands.
    Keep,
    /// The pressure and the controller's terms stand.
    Freeze,
    /// On the way down, Pa.
    Pressure(f64),
    /// A program: its reference now, and as far ahead as the model looks.
    Follow(Reference, Reference),
}

impl Channel {
    /// Engages the controller for a program whose reference before its start is `reference`.
    pub(super) fn engage(&mut self, reference: &Reference, estimate: &Estimate) {
        self.pid.reset();
        if reference.quantity == Quantity::Angle {
            let feedforward = self.forward.engage(reference, estimate);
            self.pid.engage(reference, estimate, feedforward, self.command, self.limits.pressure_max);
        }
    }

    /// Sets the command; returns what was wanted before the limits (Pa) and the limits in force.
    pub(super) fn drive(&mut self, wish: Wish, estimate: &Estimate, dt: f64) -> (f64, LimitSet) {
        let band = Band::new(self.command, self.limits.pressure_max, self.limits.slew, dt);
        let angle = matches!(wish, Wish::Follow(Reference { quantity: Quantity::Angle, .. }, _));
        if !angle && !matches!(wish, Wish::Freeze) {
            self.pid.reset();
        }
        let (wanted, command, limits) = match wish {
            Wish::Zero => (0.0, 0.0, LimitSet::default()),
            Wish::Keep => (self.command, self.command, LimitSet::default()),
            Wish::Freeze => (self.command, self.command, LimitSet::INTEGRATOR_HELD),
            Wish::Follow(reference, ahead) if angle && estimate.valid => {
                let (reference, feedforward) = self.forward.step(&reference, &ahead, estimate, dt);
                self.pid.step(&reference, estimate, feedforward, &band, dt)
            }
            // The first reading after the tare is not here yet.
            Wish::Follow(..) if angle => (self.command, self.command, LimitSet::INTEGRATOR_HELD),
            Wish::Follow(Reference { position, .. }, _) | Wish::Pressure(position) => {
                let (command, limits) = band.limit(position);
                (position, command, limits)
            }
        };
        self.command = command;
        (wanted, limits)
    }
}

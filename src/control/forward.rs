//! What is sent ahead of the PID, by the configured kind of controller.

use crate::signal::{Estimate, Reference};

use super::feedforward::Feedforward;
use super::model_following::ModelFollowing;
use super::{ControlError, ControllerKind, DerivativeOn, FreeControl};

/// What is sent ahead of the PID.
#[derive(Clone, Debug)]
pub enum Forward {
    /// The linear inverse model, or nothing.
    Linear(Feedforward),
    /// The whole inverse model.
    Model(Box<ModelFollowing>),
}

impl Forward {
    /// What the FREE's configuration asks for, in a loop of `tick` seconds.
    pub fn new(free: &FreeControl, tick: f64) -> Result<Self, ControlError> {
        match &free.controller {
            ControllerKind::Pid | ControllerKind::Nothing => {
                Ok(Self::Linear(Feedforward::new(free.free, &free.regulator, free.feedforward)))
            }
            ControllerKind::Model(spec) => ModelFollowing::new(free, spec, tick)
                .map(|model| Self::Model(Box::new(model)))
                .map_err(|problem| ControlError::Model { free: free.name.clone(), problem }),
        }
    }

    /// What the feedback compares the estimate with, where the program's reference is `reference`.
    pub fn compared_with(&self, reference: Reference) -> Reference {
        match self {
            Self::Linear(_) => reference,
            Self::Model(model) => model.compared_with(),
        }
    }

    /// Starts anew for a program that stands at `first` before it begins; returns the feedforward for that, Pa.
    pub fn engage(&mut self, first: &Reference, estimate: &Estimate) -> f64 {
        match self {
            Self::Linear(feedforward) => feedforward.pressure(first),
            Self::Model(model) => model.engage(first, estimate),
        }
    }

    /// One tick of `dt` seconds: what the feedback is to be compared with, and the feedforward, Pa. `ahead` is the
    /// program's reference at now + [`Forward::lead`].
    pub fn step(&mut self, reference: &Reference, ahead: &Reference, estimate: &Estimate, dt: f64) -> (Reference, f64) {
        match self {
            Self::Linear(feedforward) => (*reference, feedforward.pressure(reference)),
            Self::Model(model) => model.step(ahead, estimate, dt),
        }
    }

    /// How far ahead it looks, s.
    pub fn lead(&self) -> Option<f64> {
        match self {
            Self::Linear(_) => None,
            Self::Model(model) => Some(model.lead()),
        }
    }
}

/// What the derivative term looks at.
pub fn derivative_on(free: &FreeControl) -> DerivativeOn {
    match free.controller {
        ControllerKind::Pid | ControllerKind::Nothing => free.derivative_on,
        // The model moves, and so does what the derivative compares with.
        ControllerKind::Model(_) => DerivativeOn::Error,
    }
}

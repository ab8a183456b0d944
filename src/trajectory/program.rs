//! What an experiment asks of every FREE.

use super::Sequence;
use crate::signal::{MAX_FREES, Quantity};

/// The reference of one FREE.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Angle (rad, closed loop) or pressure (Pa, open loop).
    pub quantity: Quantity,
    /// Course over time.
    pub sequence: Sequence,
}

/// The references of all FREEs of the rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Program {
    /// By FREE, in the order of rig.toml; `None` holds the FREE at zero pressure.
    pub axes: [Option<Axis>; MAX_FREES],
    /// Total duration, s.
    pub duration: f64,
}

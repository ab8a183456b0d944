//! What a pressure regulator does: from records of steps, of a staircase, and of channels tried one after another.
//!
//! | noun | from | gives |
//! | --- | --- | --- |
//! | [`steps`] | steps of the command, up and down | dead time, lag, slew limits |
//! | [`staircase`] | settled pressures, up and down | zero, span, hysteresis, linearity |
//! | [`channels`] | commands to every DAC channel | which channel drives which pressure |

pub mod channels;
pub mod staircase;
pub mod steps;

pub use channels::{ChannelError, ChannelMap, Trial, map_channels};
pub use staircase::{Direction, StairPoint, StaircaseError, StaircaseFit, StaircaseRules, fit_staircase};
pub use steps::{Command, Reading, StepsError, StepsFit, fit_steps};

//! Time-parameterised references.
//!
//! A [`Segment`] goes from one value to another in a given time, with a [`Shape`]; a [`Sequence`] is segments one
//! after the other; a [`Program`] is a sequence for every FREE that takes part. Values, rates and accelerations
//! are exact (no differencing) and evaluating them allocates nothing, so the tick may do it.
//!
//! A segment need not begin where the one before it ended: the value then jumps, and its rate and acceleration
//! are those of the pieces, without the jump. At a boundary the later segment holds.

mod paper;
mod program;
mod segment;
mod sequence;

pub use paper::{paper_steps, paper_trajectory};
pub use program::{Axis, Program, ProgramError};
pub use segment::{Segment, Shape};
pub use sequence::{Sequence, SequenceBuilder, SequenceError};

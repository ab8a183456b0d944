//! Time-parameterised references.

mod program;
mod sequence;

pub use program::{Axis, Program};
pub use sequence::{Segment, Sequence, Shape};

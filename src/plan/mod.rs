//! What to command, and what to build.

pub mod design;
pub mod observer;

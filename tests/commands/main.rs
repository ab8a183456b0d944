//! The commands, as a user runs them.

mod bench;
mod cli;
mod model;
mod module;
mod package;
mod readme;
mod runs;

//! What to command: inverse, paths, whisks, and what can be reached.

mod harness;
mod inverse;
mod path;
mod section;
mod whisk;
mod workspace;

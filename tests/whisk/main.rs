//! The whisk of a module: planned, written, read, run on the simulated module in open and in closed loop, and told.

mod follow;
mod harness;
mod run;

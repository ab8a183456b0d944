//! `freerig calibrate`, as a user runs it.

mod all;
mod by_hand;
mod harness;
mod material;
mod regulator;
mod stiffness;

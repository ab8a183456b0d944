//! Fits: from recorded samples to parameters and their uncertainty.

mod dump;
mod imu;
mod material;
mod pluck;
mod regulator;
mod ringdown;
mod study;

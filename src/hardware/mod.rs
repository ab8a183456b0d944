//! Devices: traits, drivers and the owners of their buses.

pub mod wiring;

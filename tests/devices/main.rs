//! Drivers and bus owners over simulated chips, at the level of registers and bytes.

mod ads1115;
mod alicat;
mod bno055;
mod i2c_owner;
mod mcp4728;
mod plant;
mod pwm;

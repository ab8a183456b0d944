//! The daemon: supervisor, control socket, procedures; joins the real-time loop, control and hardware or sim.

pub mod api;
mod handle;

pub use handle::{Call, Desk, Handle, LastHeard, desk};

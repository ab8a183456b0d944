//! The daemon: life cycle, control socket, procedures; joins the real-time loop, control and hardware or sim.
//!
//! [`Live`] is the rig in real time, [`Stepped`] the simulated rig on the stepped clock; both run the same tick,
//! owners, drivers and chips, and a procedure sees either as a [`Bench`].
//!
//! ```text
//!   commands, curl                     systemd                SIGTERM       connecting is the stop, SIGUSR1
//!        | control socket (Server)        ^ notify               |                  | (estop)
//!        v                                |                      v                  v
//!   Handle === requests, status, events === Desk ---> Supervisor ------ owns ---> Live: tick, bus owners, pump
//!        +------------- heartbeat, emergency stop: atomics that the tick reads -------^
//! ```
//!
//! One process owns a rig ([`RigLock`]). The supervisor answers at once; arming, clearing and experiments are work in
//! threads of their own, written once against [`Bench`] ([`procedure`], [`experiment`]).

pub mod api;
mod bench;
mod byhand;
pub mod calibration;
pub mod client;
mod connection;
pub mod cycles;
pub mod doctor;
pub mod drill;
mod error;
mod estop;
pub mod experiment;
mod follow;
mod handle;
mod join;
mod live;
mod lock;
mod margin;
mod news;
pub mod notify;
mod outcome;
mod pose;
pub mod procedure;
mod pump;
mod server;
mod socket;
mod status;
mod stepped;
mod supervisor;
mod tick;
pub mod validity;
pub mod vent;
mod work;

pub use bench::Bench;
pub use error::{DaemonError, names};
pub use handle::{Call, Desk, Handle, LastHeard, desk};
pub use live::{FreeDevices, Live, LiveBench, is_free_vented, is_vented};
pub use lock::RigLock;
pub use pose::{PoseDesk, STALE as STALE_POSE, Sighting};
pub use pump::{Change, Pump};
pub use server::Server;
pub use socket::{Access, Peer, SocketError, estop_path};
pub use stepped::Stepped;
pub use supervisor::Supervisor;
pub use tick::Switches;

//! The periodic thread: scheduling, sleep policy, deadline accounting. It knows no device and no model: it runs
//! a closure at absolute, phase-keeping deadlines and keeps the books.
//!
//! # Time
//!
//! The deadlines are `start + n period` on `CLOCK_MONOTONIC`, slept for with an absolute `clock_nanosleep`, so
//! that neither the closure's execution time nor a late wake-up shifts the phase. A deadline that passes while
//! the closure runs, or while the thread is kept from running, is *skipped*: it is counted in
//! [`Timing::skipped`], and the next tick belongs to the latest deadline that has passed, never to a backlog.
//! Wake-up latency is measured from the deadline that was slept for, so a stall shows in full.
//!
//! # Rights
//!
//! The thread asks for its real-time rights itself, after everything else of the process is up: `SCHED_FIFO`,
//! locked memory, and, where they are available, one CPU of its own and no deep idle states. What was refused,
//! why, and the remedy stands in [`Rights`]; whether that is a warning or a refusal to arm is the caller's
//! decision, never a silent one.
//!
//! # Books
//!
//! [`Statistics`] can be read from every thread at any time; the periodic thread writes it without a lock and
//! without an allocation. [`measure`] runs the loop for nothing but its books, beside cyclictest.

mod histogram;
mod periodic;
mod rights;
mod schedule;
mod wakeup;

pub use histogram::{Histogram, Snapshot};
pub use periodic::{Error, Handle, Realtime, Statistics, Timing, run, spawn};
pub use rights::{Refusal, Rights, fifo};
pub use schedule::{Schedule, Wake};
pub use wakeup::{Comparison, CyclictestError, Pair, Wakeups, compare, measure, median_ratio};

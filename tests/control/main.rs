//! The controller as a whole: life cycle, interlocks, limits, replay, without any device.

mod bench;
mod faults;
mod harness;
mod ideal;
mod invariants;
mod lifecycle;
mod model;
mod no_alloc;
mod tracking;

/// Allocates as usual but inside `assert_no_alloc`.
#[global_allocator]
static GUARD: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

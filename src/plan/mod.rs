//! What to command, and what to build.
//!
//! A module of four FREEs moves its plate with four pressures. [`Rest`] is the module and what margins are measured
//! against; [`inverse`] finds the pressures of one [`Target`], [`path`] those of a sequence of them, [`whisk`] a figure
//! eight, and [`workspace`] what can be reached at all. Everything is quasi-static: equilibria at the pressures of
//! each moment, of the branch that comes from rest.
//!
//! **Margin.** Let k be the least eigenvalue of the plate's stiffness with the rods condensed, rotations in radians and
//! translations in the module's length, k0 the same at rest, and c and c0 the least clearance between tubes. [`Margin`]
//! has `k / k0` and `c / c0`: either is 1 at rest, the first is 0 where the module buckles or turns over, the second
//! where tubes touch. What limits and optimises is `(sum (k_i/k0)^-8 + (c/c0)^-8)^(-1/8)` of all six eigenvalues: a
//! smooth function, never above either. (Shares of K against K0 in every direction would say nothing of stability:
//! a rod that bends loses most of its stiffness along its chord, which is far from the softest.)
//!
//! The end of a law's domain has no such measure: it is met and named, not foreseen.
//!
//! **Redundancy.** A point takes three of the four pressures' freedoms (to first order the fourth turns the plate). It
//! goes to the largest smooth margin among the pressures that put the plate on the target.

pub mod belief;
pub mod design;
pub mod end;
mod error;
mod figure;
mod freedom;
pub mod inverse;
mod limits;
mod margin;
pub mod observer;
pub mod path;
pub mod pursuit;
mod quadratic;
mod rest;
pub mod scatter;
mod search;
pub mod study;
mod target;
pub mod whisk;
pub mod workspace;

pub use end::{End, Ended};
pub use error::PlanError;
pub use figure::{Figure, turn_and_tilt};
pub use inverse::{Inverse, Shortfall};
pub use limits::{Bound, Limits};
pub use margin::Margin;
pub use path::{PathPlan, Pose};
pub use rest::Rest;
pub use target::Target;

/// FREEs of a module.
pub const FREES: usize = 4;

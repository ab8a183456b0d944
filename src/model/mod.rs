//! What a FREE is: geometry, fibre kinematics, lumped dynamics.
//!
//! **Signs.** z runs from base to tip; rotations, twists and moments are positive by the right-hand rule about
//! z. The winding angle gamma is signed: an R FREE (gamma > 0, fibres whose theta grows with z) turns
//! *negative* under pressure, an L FREE (gamma < 0) turns positive. Handedness is never multiplied in a second
//! time. Controller gains are positive in the FREE's own direction, [`Free::direction`]. Pressures are gauge.
//!
//! **The lumped model** (Eqs 1-4 of the paper; s extension, m, phi rotation of the end, rad, g winding angle and
//! r fibre radius as they are now):
//!
//! ```text
//! m s''   = F - ke s   - ce s'   + pi r^2 P (1 - 2 cot^2 g)        F = m g0 + external force
//! I phi'' = M - kt phi - ct phi' - 2 pi r^3 P cot g                M = external moment
//! ```
//!
//! The tip hangs, so gravity pulls along +z. [`Kinematics`] says how g and r follow from s and phi; with
//! [`Kinematics::Exact`] the pressure terms are exactly P dV/dq of the enclosed volume. [`Lumped`] holds the
//! equations, their tangent, a fixed-step integrator for stiff and saturating cases and the static solutions.

mod domain;
mod equilibrium;
mod free;
mod hysteresis;
mod integrator;
mod kinematics;
mod lumped;
mod radau;
mod response;

pub use domain::DomainError;
pub use equilibrium::{Equilibrium, EquilibriumError};
pub use free::{Free, FreeError, FreeProblem};
pub use hysteresis::{ELEMENTS, Hysteresis, HysteresisError, HysteresisState};
pub use integrator::{Effort, Feedback, IntegrationError};
pub use kinematics::{Actuation, Kinematics};
pub use lumped::{GRAVITY, Law, Linearised, Load, LoopCoefficients, Lumped, LumpedState, Tangent};
pub use response::{ResponseError, response};

//! What a FREE is.
//!
//! **Signs.** z runs from base to tip; rotations, twists and moments are positive by the right-hand rule about
//! z. The winding angle gamma is signed: an R FREE (gamma > 0, fibres whose theta grows with z) turns
//! *negative* under pressure, an L FREE (gamma < 0) turns positive. Handedness is never multiplied in a second
//! time. Controller gains are positive in the FREE's own direction, [`Free::direction`].

mod free;

pub use free::Free;

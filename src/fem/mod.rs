//! Finite elements of a FREE: what the material and the geometry alone predict.
//!
//! Tiers, from cheap to dear:
//!
//! | module | what it is | exact for |
//! | --- | --- | --- |
//! | [`linear`] | closed form, fibres smeared | small pressure |
//! | [`section`] | elements of one fibre's sector, helical symmetry | a long straight FREE at any strain |
//!
//! All answer in the same terms: a [`tube::Tube`], its [`ends::Ends`], an [`ends::Equilibrium`]. Signs: z from base to
//! tip, twist and moment right-handed about z, `force` and `moment` are what the closed tube does to its distal
//! support, and they contain the thrust on the cap, because the pressure enters through `-P V` only.

pub mod ends;
pub mod linear;
pub mod material;
pub mod section;
pub mod tube;

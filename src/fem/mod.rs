//! Finite elements of a FREE: what the material and the geometry alone predict.
//!
//! Tiers, from cheap to dear:
//!
//! | module | what it is | exact for |
//! | --- | --- | --- |
//! | [`linear`] | closed form, fibres smeared | small pressure |
//! | [`section`] | generalised plane strain of one fibre's sector | any finite strain of a long straight FREE |
//! | [`solid`] | finite tube with its ends, mixed hexahedra | any finite strain; end effects, bending, buckling |
//! | [`rod`], [`module`] | geometrically exact rods under a rigid plate | any bend, payload, buckling |
//!
//! [`fidelity`] asks any of them the same question, and chooses the cheapest that a scene needs; [`measure`] says how
//! far two of their answers are apart.
//!
//! [`lumped`] are the springs that they give the lumped model. A rod's law is tabulated from the section by
//! [`section_law`].
//!
//! All answer in the same terms: a [`tube::Tube`], its [`ends::Ends`], an [`ends::Equilibrium`]. Signs: z from base to
//! tip, twist and moment right-handed about z, `force` and `moment` are what the closed tube does to its distal
//! support, and they contain the thrust on the cap, because the pressure enters through `-P V` only.

pub mod ends;
pub mod fidelity;
pub mod linear;
pub mod lumped;
pub mod material;
pub mod measure;
pub mod module;
pub mod rod;
pub mod section;
pub mod section_law;
pub mod solid;
pub mod sparse;
mod spectral;
pub mod tube;

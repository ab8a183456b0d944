//! The finite elements: section, solid, rods, modules, and the choice among them.

mod fidelity;
mod module;
mod module_reference;
mod rods;
mod section;
mod section_bending;
mod section_exact;
mod section_hard;
mod section_law;
mod solid;
mod solid_elements;
mod solid_hard;
mod solid_module;
mod solid_tangents;

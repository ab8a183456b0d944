//! The reference module with the law of its section.

use freerig::fem::module::{Module, ModuleScene};
use freerig::fem::rod::Resolution;
use freerig::fem::section::Mesh;
use freerig::fem::section_law::SectionLaw;
use freerig::units::PASCAL_PER_PSI as PSI;

/// Up to 10 psi.
pub fn module(gamma_deg: f64, resolution: Resolution) -> Module {
    let scene = ModuleScene::reference(gamma_deg.to_radians());
    scene.module(Mesh::level(1), 10.0 * PSI, resolution, SectionLaw::build).unwrap()
}

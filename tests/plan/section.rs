//! The reference module with the law of its section.

use freerig::fem::module::{Module, ModuleScene};
use freerig::fem::rod::{Law, Profile, Resolution};
use freerig::fem::section::Mesh;
use freerig::fem::section_law::SectionLaw;
use freerig::units::PASCAL_PER_PSI as PSI;

/// Up to 10 psi.
pub fn module(gamma_deg: f64, resolution: Resolution) -> Module {
    let scene = ModuleScene::reference(gamma_deg.to_radians());
    scene.module(Mesh::level(1), 10.0 * PSI, resolution, SectionLaw::build).unwrap()
}

/// The same of 60 deg with the bending of the independent model: EI by the pressure alone, as of a FREE that may turn, and
/// no shear. A section that is held from turning bends more easily, as the solid confirms.
pub fn module_as_the_references(resolution: Resolution) -> Module {
    let scene = ModuleScene::reference(60f64.to_radians());
    let section = SectionLaw::build(&scene.request(0, Mesh::level(1), 10.0 * PSI)).unwrap();
    let ei = [416.0, 476.0, 551.0].map(|ei| ei * 1e-6);
    let bending = Profile::through([(0.0, ei[0]), (3.5 * PSI, ei[1]), (7.0 * PSI, ei[2])]);
    let laws = scene.frees.map(|free| Law {
        bending,
        shear: Profile::constant(1e4),
        coupling: Profile::constant(0.0),
        ..section.law(free.tube.gamma)
    });
    scene.with_laws(laws, resolution).unwrap()
}

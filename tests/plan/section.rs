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

/// What is taken from the independent model in place of the section's own.
#[derive(Clone, Copy, PartialEq)]
pub enum Bending {
    /// Nothing.
    Own,
    /// EI by the pressure alone, as of a FREE that may turn: a section that is held from turning bends more easily, as
    /// the solid confirms.
    Theirs,
    /// The same without its pressure: that of 3.5 psi.
    Constant,
}

/// The same of 60 deg with that bending, and no shear where it is `unsheared`.
pub fn module_with(bending: Bending, unsheared: bool, resolution: Resolution) -> Module {
    let scene = ModuleScene::reference(60f64.to_radians());
    let section = SectionLaw::build(&scene.request(0, Mesh::level(1), 10.0 * PSI)).unwrap();
    let ei = [416.0, 476.0, 551.0].map(|ei| ei * 1e-6);
    let laws = scene.frees.map(|free| {
        let own = section.law(free.tube.gamma);
        let bending = match bending {
            Bending::Own => own.bending,
            Bending::Theirs => Profile::through([(0.0, ei[0]), (3.5 * PSI, ei[1]), (7.0 * PSI, ei[2])]),
            Bending::Constant => Profile::constant(ei[1]),
        };
        match unsheared {
            true => Law { bending, shear: Profile::constant(1e4), coupling: Profile::constant(0.0), ..own },
            false => Law { bending, ..own },
        }
    });
    scene.with_laws(laws, resolution).unwrap()
}

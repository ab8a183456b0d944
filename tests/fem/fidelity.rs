//! What the tiers of the ladder leave out, each against the one that has it, and whether `auto` says so.

use freerig::fem::ends::Ends;
use freerig::fem::fidelity::{Hold, Scene, choose};
use freerig::fem::linear::LinearSection;
use freerig::fem::measure;
use freerig::fem::section::{Mesh, Section};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;

#[test]
fn the_linear_law_is_the_smeared_section_to_first_order_in_the_pressure() {
    // Both smear the fibres into a layer, so all that is between them is of second order in the pressure: the relative
    // difference halves with it, and vanishes at rest.
    for degrees in [20.0_f64, 40.0, 60.0, 80.0] {
        let tube = Tube::reference(degrees.to_radians());
        let (law, section) = (LinearSection::new(&tube).unwrap(), Section::smeared(&tube, 4).unwrap());
        for ends in [Ends::FREE, Ends::BLOCKED] {
            let at = |psi: f64| {
                let (linear, exact) = (law.solve(psi * PSI, ends), section.solve(psi * PSI, ends).unwrap());
                measure::difference(&tube, ends, &[((&linear).into(), (&exact).into())])
            };
            let [whole, half] = [0.1, 0.05].map(at);
            println!("{degrees} deg: {half:.2e} at 0.05 psi, {whole:.2e} at 0.1 psi");
            // The third order is to the second what that is to the first.
            assert!((whole / half - 2.0).abs() < 2.0 * whole + 0.02, "{degrees}: {whole} {half}");
            assert!((2.0 * half - whole).abs() < 2.0 * whole * whole + 1e-5, "{degrees}: {whole} {half}");
        }
    }
}

#[test]
fn smeared_fibres_turn_too_far_by_what_physics_says_of_them() {
    // Twist at 5 psi, free, against fibres of 0.4 mm: percentages computed with independent codes, to their last digit.
    for (degrees, percent) in [(20.0_f64, 0.4), (30.0, 1.3), (40.0, 2.5), (60.0, 4.5)] {
        let tube = Tube::reference(degrees.to_radians());
        let twist = |section: Section| section.solve(5.0 * PSI, Ends::FREE).unwrap().twist;
        let strips = twist(Section::new(&tube, Mesh::level(2)).unwrap());
        let more = 100.0 * (twist(Section::smeared(&tube, 4).unwrap()) / strips - 1.0);
        assert!((more - percent).abs() < 0.06, "{degrees}: {more} %");
    }
}

#[test]
fn outside_of_the_certified_range_the_choice_says_so() {
    // Suction is.
    let tube = Tube::reference(40f64.to_radians());
    let scene = Scene { tube, length: 0.13, hold: Hold::Free, pressures: vec![-0.1 * PSI] };
    let choice = choose(&scene, 0.2, &mut |_| {}).unwrap();
    assert!(!choice.inside && choice.considered.iter().all(|tier| !tier.certified));
    assert!(choice.reason(0.2).ends_with("outside of the certified range"), "{}", choice.reason(0.2));
}

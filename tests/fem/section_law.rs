//! A rod's law taken from the section: it is the section's, knows its domain, and comes back from bytes.

use freerig::fem::ends::{End, Ends};
use freerig::fem::rod::LawError;
use freerig::fem::section::{Mesh, Section};
use freerig::fem::section_law::{BytesError, Request, SectionLaw, SectionLawError};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;
use nalgebra::Vector2;

fn request(degrees: f64) -> Request {
    Request { tube: Tube::reference(degrees.to_radians()), mesh: Mesh::level(1), pressure: 10.0 * PSI, twist: 20.0 }
}

/// A law that is quick to compute.
fn small() -> Request {
    let mesh = Mesh::Counted { radial: 1, strip: 1, gap: 1, growth: 1.0 };
    Request { mesh, pressure: PSI, twist: 5.0, ..request(60.0) }
}

#[test]
fn the_law_is_the_sections_between_the_points_too() {
    for degrees in [30.0, 60.0] {
        let built = SectionLaw::build(&request(degrees)).unwrap();
        let errors = built.errors();
        assert!(errors.states >= 10, "{errors:?}");
        // Position errors of a rod of 130 mm: its length times the stretch's, a plate's radius of 20 mm times the
        // turn's.
        assert!(errors.stretch < 3e-4 && 0.13 * errors.twist < 4e-3, "{errors:?}");
        // Mesh level 1 leaves about 0.4 % of blocked loads.
        assert!(errors.mesh < 6e-3, "{errors:?}");
        assert!(built.table().coverage() > 0.85, "{}", built.table().coverage());
        let section = Section::new(&request(degrees).tube, Mesh::level(1)).unwrap();
        let law = built.law(1.0);
        // Free, held from turning, and loaded: the law's gradient is what the section's ends bear.
        for (psi, ends) in [
            (1.3, Ends::FREE),
            (2.9, Ends::FREE),
            (6.3, Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) }),
            (4.1, Ends { axial: End::Loaded(0.3), torsion: End::Held(7.0) }),
            (0.4, Ends { axial: End::Loaded(-0.2), torsion: End::Held(-12.0) }),
        ] {
            let want = section.solve(psi * PSI, ends).unwrap();
            let jet = law.jet(want.stretch, want.twist, want.pressure).unwrap();
            let off = jet.gradient.xy() + Vector2::new(want.force, want.moment);
            let moved = want.tangent.fixed_view::<2, 2>(0, 0).into_owned().lu().solve(&off).unwrap().abs();
            // Below the 0.3 % that the mesh leaves of motions of up to 0.05 and 12 rad/m.
            assert!(moved.x < 1e-4 && moved.y < 0.03, "{degrees} deg, {psi} psi: {moved}");
            let volume = -jet.gradient.z / want.volume - 1.0;
            assert!(volume.abs() < 3e-4, "{degrees} deg, {psi} psi: {volume}");
        }
        // The mirror image turns the other way.
        let (right, left) = (law.jet(1.01, 3.0, PSI).unwrap(), built.law(-1.0).jet(1.01, -3.0, PSI).unwrap());
        assert_eq!((right.gradient.x, right.gradient.y), (left.gradient.x, -left.gradient.y));
        // Lateral stiffness is the section's, whatever holds it: pure bending to what is told, with some for the states
        // between the few looked at; shear, which counts less, to 10 %.
        let held = |twist: f64| Ends { axial: End::Loaded(0.0), torsion: End::Held(twist) };
        for (psi, ends) in [(0.5, Ends::FREE), (3.7, Ends::FREE), (3.1, held(0.0)), (6.4, held(0.0)), (4.4, held(-6.0))]
        {
            let state = section.solve(psi * PSI, ends).unwrap();
            let mut at = section.rest().unwrap();
            section.advance(&mut at, psi * PSI, ends).unwrap();
            let want = section.bending(&at).unwrap();
            let at = [state.stretch, state.twist, psi * PSI];
            let off = law.bending.at(at) / want.pure_bending() - 1.0;
            assert!(
                off.abs() < 1.5 * errors.bending && errors.bending < 0.06,
                "{degrees} deg, {at:?}: {off} {errors:?}"
            );
            let off = law.shear.at(at) / want.shear - 1.0;
            assert!(off.abs() < 0.1, "{degrees} deg, {at:?}: {off}");
            let off = law.coupling.at(at) - want.coupling / want.shear;
            assert!(off.abs() < 0.1 * 5.56e-3, "{degrees} deg, {at:?}: {off}");
        }
    }
}

#[test]
fn steep_fibres_sink_into_a_tube_that_is_pulled_and_its_law_has_the_states_before() {
    // Pulled by 3 %, the fibres of 20 deg sink in: with cells of that length the tube at rest stood in none of them.
    for inner_radius in [4.76e-3, 6.2e-3] {
        let tube = Tube { inner_radius, ..request(20.0).tube };
        let (section, law) = (Section::new(&tube, Mesh::level(1)).unwrap(), Request { tube, ..request(20.0) });
        let law = SectionLaw::build(&law).unwrap();
        for k in 0..=24 {
            let psi = 0.25 * f64::from(k);
            let ends = Ends { axial: End::Loaded(0.0), torsion: End::Held(0.0) };
            let state = section.solve(psi * PSI, ends).unwrap();
            let jet = law.table().jet(state.stretch, 0.0, psi * PSI).unwrap_or_else(|e| panic!("{psi} psi: {e}"));
            let moved = jet.gradient.x / state.tangent[(0, 0)];
            // As of the other angles: below the 0.3 % that the mesh leaves of motions of up to 0.05.
            assert!(moved.abs() < 1e-4, "{psi} psi: {moved}");
        }
    }
}

#[test]
fn the_meshs_error_is_known_of_tubes_that_fold_when_they_are_blocked_too() {
    // Blocked at 5 psi the finer mesh of this tube has folded.
    let tube = Tube { inner_radius: 6.2e-3, ..request(60.0).tube };
    let law = SectionLaw::build(&Request { tube, ..request(60.0) }).unwrap();
    assert!((1e-5..1e-2).contains(&law.errors().mesh), "{:?}", law.errors());
    // Its own mesh folds before 7 psi; the blunt one does not, and is farther off: in what it says of the states that
    // both have, too.
    let blunt = SectionLaw::build(&Request { mesh: Mesh::blunt(&tube), tube, ..request(60.0) }).unwrap();
    assert!(law.reaches(3.5 * PSI) && !law.reaches(7.0 * PSI) && blunt.reaches(7.0 * PSI));
    let of = |psi: f64| {
        let asked = Request { tube, ..request(60.0) };
        SectionLaw::reaching(&asked, psi * PSI, |r| {
            Ok::<_, ()>(if law.serves(r) { law.clone() } else { blunt.clone() })
        })
    };
    assert_eq!([3.5, 7.0].map(|psi| of(psi).unwrap().errors()), [law.errors(), blunt.errors()]);
    let free = Section::new(&tube, Mesh::level(1)).unwrap().solve(3.5 * PSI, Ends::FREE).unwrap();
    let off = blunt.table().jet(free.stretch, free.twist, 3.5 * PSI).unwrap().gradient.xy();
    let moved = free.tangent.fixed_view::<2, 2>(0, 0).into_owned().lu().solve(&off).unwrap();
    let share = moved.y.abs() / free.twist.abs();
    assert!(share < 1.5 * blunt.errors().mesh && blunt.errors().mesh > 5e-3, "{share} {:?}", blunt.errors());
}

#[test]
fn outside_its_domain_it_refuses_by_name() {
    let law = SectionLaw::build(&request(60.0)).unwrap().law(1.0);
    for (stretch, twist, psi) in
        [(1.0, 0.0, 10.1), (1.0, 0.0, -0.1), (1.0, 20.5, 1.0), (1.3, 0.0, 1.0), (0.8, 0.0, 1.0)]
    {
        let refused = law.jet(stretch, twist, psi * PSI);
        assert!(matches!(refused, Err(LawError::OutsideTable { .. })), "{stretch} {twist} {psi}");
    }
    // Blocked, the rubber folds at the strip's end near 10 psi: no accepted state, no answer.
    assert!(law.jet(1.0, 0.0, 8.0 * PSI).is_ok());
    assert!(matches!(law.jet(1.0, 0.0, 9.99 * PSI), Err(LawError::OutsideTable { .. })));
    for (pressure, twist) in [(0.0, 20.0), (f64::NAN, 20.0), (PSI, 0.0), (PSI, f64::INFINITY)] {
        let refused = SectionLaw::build(&Request { pressure, twist, ..small() });
        assert!(matches!(refused, Err(SectionLawError::Range { .. })));
    }
    let tube = Tube { wall: -1.0, ..small().tube };
    assert!(matches!(SectionLaw::build(&Request { tube, ..small() }), Err(SectionLawError::Tube(_))));
}

#[test]
fn bytes_come_back_to_the_last_bit_and_others_are_refused() {
    let law = SectionLaw::build(&small()).unwrap();
    let bytes = law.to_bytes().unwrap();
    let back = SectionLaw::from_bytes(&small(), &bytes).unwrap();
    assert_eq!(back.to_bytes().unwrap(), bytes);
    assert_eq!(back.errors(), law.errors());
    assert_eq!((back.law(1.0).bending, back.law(1.0).coupling), (law.law(1.0).bending, law.law(1.0).coupling));
    let at = [1.003, -1.234, 0.77 * PSI];
    let jets = [&law, &back].map(|law| law.law(-1.0).jet(at[0], at[1], at[2]).unwrap());
    assert_eq!(jets[0], jets[1]);
    // The mirror image shares it.
    let mirrored = Request { tube: Tube { gamma: -small().tube.gamma, ..small().tube }, ..small() };
    assert!(back.serves(&mirrored) && SectionLaw::from_bytes(&mirrored, &bytes).is_ok());
    // Every input counts.
    let tube = small().tube;
    let others = [
        Request { twist: 5.1, ..small() },
        Request { pressure: 1.1 * PSI, ..small() },
        Request { mesh: Mesh::level(1), ..small() },
        Request { tube: Tube { fiber_width: 0.3e-3, ..tube }, ..small() },
        Request { tube: Tube { fibers: 7, ..tube }, ..small() },
        Request { tube: Tube { law: freerig::fem::material::Law::NeoHookean { mu: 0.393e6 }, ..tube }, ..small() },
    ];
    for other in others {
        assert_eq!(SectionLaw::from_bytes(&other, &bytes).unwrap_err(), BytesError::Other, "{other:?}");
        assert!(!back.serves(&other));
    }
    // Cut off anywhere, longer, or one bit turned: not whole.
    for end in [0, 15, 16, 48, 80, 200, bytes.len() / 2, bytes.len() - 1] {
        assert_eq!(SectionLaw::from_bytes(&small(), &bytes[..end]).unwrap_err(), BytesError::Damaged, "{end}");
    }
    assert_eq!(SectionLaw::from_bytes(&small(), &[&bytes[..], &[0]].concat()).unwrap_err(), BytesError::Damaged);
    for place in (0..bytes.len()).step_by(97) {
        let mut turned = bytes.clone();
        turned[place] ^= 4;
        assert_eq!(SectionLaw::from_bytes(&small(), &turned).unwrap_err(), BytesError::Damaged, "{place}");
    }
}

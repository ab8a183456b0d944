//! Bending stiffness under pressure against the reference, a bare tube's closed form, and its dependence on the
//! fibres' width.

use std::f64::consts::PI;

use freerig::fem::ends::{End, Ends};
use freerig::fem::material::Law;
use freerig::fem::section::{Bending, LimitKind, Mesh, Section};
use freerig::fem::tube::Tube;
use freerig::units::PASCAL_PER_PSI as PSI;

fn at_pressures(tube: &Tube, mesh: Mesh, pressures: &[f64]) -> Vec<Bending> {
    let section = Section::new(tube, mesh).unwrap();
    let mut state = section.rest().unwrap();
    let mut bend = |&psi: &f64| {
        section.advance(&mut state, psi * PSI, Ends::FREE).unwrap();
        section.bending(&state).unwrap()
    };
    pressures.iter().map(&mut bend).collect()
}

/// 2 through the wall, 6 a sector, all alike: the mesh of the reference.
const TWO_BY_SIX: Mesh = Mesh::Counted { radial: 2, strip: 1, gap: 3, growth: 1.0 };

#[test]
fn line_fibres_on_two_by_six_agree_with_the_reference() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/reference/bending.csv");
    let text = std::fs::read_to_string(path).unwrap();
    assert_eq!(text.lines().count(), 4, "three rows below their names");
    for line in text.lines().skip(1) {
        let row: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        let tube = Tube { fiber_width: 0.0, ..Tube::reference(row[0].to_radians()) };
        let found = at_pressures(&tube, TWO_BY_SIX, &[row[1]])[0].pure_bending() * 1e6;
        // The reference's own accuracy at rest.
        assert!((found / row[2] - 1.0).abs() < 8e-3, "{line}: {found}");
    }
    // The published 30 deg figures, N mm2, printed to a unit.
    let tube = Tube { fiber_width: 0.0, ..Tube::reference(30f64.to_radians()) };
    for (found, want) in at_pressures(&tube, TWO_BY_SIX, &[0.0, 3.5, 7.0]).iter().zip([673.0, 909.0, 1854.0]) {
        assert!((found.pure_bending() * 1e6 / want - 1.0).abs() < 8e-3, "{found:?} for {want}");
    }
}

#[test]
fn a_bare_tube_bends_as_a_beam_at_rest_and_stretched() {
    let tube = Tube { fiber_ea: 0.0, law: Law::NeoHookean { mu: 0.393e6 }, ..Tube::reference(0.7) };
    let (mu, ri, ro) = (0.393e6, tube.inner_radius, tube.outer_radius());
    let inertia = PI / 4.0 * (ro.powi(4) - ri.powi(4));
    let area = PI * (ro * ro - ri * ri);
    let section = Section::new(&tube, Mesh::Counted { radial: 3, strip: 1, gap: 4, growth: 1.0 }).unwrap();
    let mut state = section.rest().unwrap();
    for stretch in [1.0_f64, 1.2, 0.9] {
        let ends = Ends { axial: End::Held(stretch), torsion: End::Loaded(0.0) };
        section.advance(&mut state, 0.0, ends).unwrap();
        let bend = section.bending(&state).unwrap();
        // A fibre of the stretched tube at the distance X / sqrt(lam) is in uniaxial tension: W'' = mu (1 + 2 / lam^3).
        let exact = mu * (1.0 + 2.0 / stretch.powi(3)) * inertia / stretch;
        assert!((bend.bending / exact - 1.0).abs() < 2e-3, "{stretch}: {} for {exact}", bend.bending);
        assert!(bend.coupling.abs() < 1e-6 * (bend.bending * bend.shear).sqrt(), "no chirality, no coupling");
        if stretch == 1.0 {
            // A thin tube's warping is held by the mean turn: half of its area carries shear.
            assert!((bend.shear / (mu * area) - 0.5).abs() < 0.02, "{}", bend.shear / (mu * area));
        }
    }
}

#[test]
fn the_fibres_width_moves_ei_by_a_few_per_cent() {
    // EI of pure bending at 0 and 3.5 psi, N mm2, width 0.1 to 0.8 mm; wider fibres leave less rubber free.
    for degrees in [30.0_f64, 60.0] {
        let found = [0.1, 0.2, 0.4, 0.8].map(|width| {
            let tube = Tube { fiber_width: width * 1e-3, ..Tube::reference(degrees.to_radians()) };
            at_pressures(&tube, Mesh::level(2), &[0.0, 3.5]).iter().map(|b| b.pure_bending() * 1e6).collect::<Vec<_>>()
        });
        println!("{degrees} deg: {found:?}");
        for pair in found.windows(2) {
            for (narrow, wide) in pair[0].iter().zip(&pair[1]) {
                let change = wide / narrow - 1.0;
                assert!((-0.01..0.06).contains(&change), "{degrees}: {found:?}");
            }
        }
    }
}

#[test]
fn a_bare_ring_collapses_at_the_classical_pressure() {
    // Levy: 3 E I / R^3 per length in plane strain is mu (wall / R)^3 for an incompressible ring; thin to first order.
    let tube =
        Tube { fiber_ea: 0.0, wall: 0.03 * 4.76e-3, law: Law::NeoHookean { mu: 0.393e6 }, ..Tube::reference(0.7) };
    let radius = tube.inner_radius + 0.5 * tube.wall;
    let classical = 0.393e6 * (tube.wall / radius).powi(3);
    let section = Section::new(&tube, Mesh::Counted { radial: 1, strip: 1, gap: 4, growth: 1.0 }).unwrap();
    let limit = section.limit_pressure(Ends::BLOCKED, -2.0 * classical).unwrap().unwrap();
    assert_eq!(limit.kind, LimitKind::Waves(2));
    // Suction acts on the inner surface: the ring's radius is uncertain by half a wall, 1.5 %, three times over.
    assert!((-limit.pressure / classical - 1.0).abs() < 0.045, "{} for {classical}", limit.pressure);
}

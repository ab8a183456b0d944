//! A scene's answer put together from the two models that are exact where they are fine enough: the long tube by the
//! section, and what the ends add by a solid.
//!
//! Of a free tube that is the whole's mean motion less the motion at mid-length, in which the error that the solid's
//! elements make across the tube cancels. Of a blocked one, the middle stretches and turns a little between ends that
//! do not: the force is that of the section held at the stretch and twist of the solid's middle.

use super::{FidelityError, Hold, Point, Rest, Scene};
use crate::fem::ends::{End, Ends, Equilibrium};
use crate::fem::section::{Mesh, Section, SectionError};
use crate::fem::solid::SolidEquilibrium;

/// A scene's answer without and with its ends.
pub(super) struct Joined {
    pub(super) far: Vec<Point>,
    pub(super) whole: Vec<Point>,
}

/// At the pressures of `solids`, a path from rest, by the first of the section's mesh `levels` that has not folded;
/// none where all have.
pub(super) fn joined(
    scene: &Scene,
    solids: &[SolidEquilibrium],
    levels: &[usize],
) -> Result<Option<Joined>, FidelityError> {
    for &level in levels {
        if let Some(found) = on(scene, solids, &Section::new(&scene.tube, Mesh::level(level))?)? {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

fn on(scene: &Scene, solids: &[SolidEquilibrium], section: &Section) -> Result<Option<Joined>, FidelityError> {
    let stable = |found: Result<Equilibrium, SectionError>| match found {
        Ok(found) => Ok(Some(found)),
        Err(SectionError::BeyondLimit { .. } | SectionError::PathEnds { .. }) => Ok(None),
        Err(error) => Err(FidelityError::from(error)),
    };
    let mut state = section.rest()?;
    let mut parts = Joined { far: Vec::new(), whole: Vec::new() };
    for solid in solids {
        let pressure = solid.pressure;
        let Some(far) = stable(section.advance(&mut state, pressure, scene.hold.ends()))? else { return Ok(None) };
        let far = Rest::from(&far);
        let whole = match scene.hold {
            Hold::Free => Rest {
                twist: far.twist + solid.rotation / scene.length - solid.middle_twist,
                stretch: far.stretch + solid.stretch - solid.middle_stretch,
                ..far
            },
            Hold::Blocked => {
                let middle = Ends { axial: End::Held(solid.middle_stretch), torsion: End::Held(solid.middle_twist) };
                let Some(held) = stable(section.advance(&mut state.clone(), pressure, middle))? else {
                    return Ok(None);
                };
                Rest { stretch: 1.0, twist: 0.0, ..Rest::from(&held) }
            }
        };
        parts.far.push(Point { pressure, rest: Some(far) });
        parts.whole.push(Point { pressure, rest: Some(whole) });
    }
    Ok(Some(parts))
}

//! The section's states at a grid's points, row by row.

use super::BESIDE;
use crate::fem::ends::{End, Ends, Equilibrium};
use crate::fem::rod::{Grid, Jet};
use crate::fem::section::{Section, SectionError, State};

/// One in so many of the cells about the free states is looked into.
const EVERY: usize = 4;
/// Twists (of nine) and pressures (of nine) at which the tube is bent, at the three stretches about the free state that
/// are as far apart as the points of a grid that was not refined.
const BENT: [[usize; 5]; 2] = [[1, 2, 4, 6, 7], [0, 2, 4, 6, 8]];

/// A state between the grid's points, to hold the interpolant against.
pub(super) struct Probe {
    /// (stretch, twist, pressure).
    pub at: [f64; 3],
    pub jet: Jet,
    /// EI of bending by a moment alone, N m2.
    pub bending: f64,
}

/// The states of one twist.
#[derive(Default)]
pub(super) struct Row {
    /// (stretch's index, pressure's index, state) of those accepted.
    pub states: Vec<(usize, usize, Jet)>,
    /// (stretch, twist, pressure) and EI of bending by a moment alone, GA, and q = C / GA, of some of them.
    pub lateral: Vec<([f64; 3], [f64; 3])>,
    pub probes: Vec<Probe>,
}

fn held(stretch: f64, twist: f64) -> Ends {
    Ends { axial: End::Held(stretch), torsion: End::Held(twist) }
}

/// psi0 and its derivatives at an equilibrium.
fn jet(section: &Section, state: &State, found: &Equilibrium) -> Jet {
    Jet {
        value: section.potential(state),
        gradient: -nalgebra::Vector3::new(found.force, found.moment, found.volume),
        hessian: found.tangent,
    }
}

impl Row {
    /// Goes up in pressure along the states that are free to stretch, and from each of them along the stretch to both
    /// sides, as far as the section is stable.
    pub fn sample(section: &Section, grid: &Grid, twist: usize) -> Result<Row, SectionError> {
        let mut row = Row::default();
        let mut spine = section.rest()?;
        let mut found = section.equilibrium(&spine);
        for k in 0..grid.pressure.points {
            let [_, tau, pressure] = grid.at([0, twist, k]);
            let free = Ends { axial: End::Loaded(0.0), torsion: End::Held(tau) };
            let mut next = spine.clone();
            let mut reached = section.reach(&mut next, pressure, free)?;
            if reached.is_none() {
                // Free, it would give way.
                next = spine;
                reached = section.reach(&mut next, pressure, held(found.stretch, tau))?;
            }
            let Some(reached) = reached else { break };
            (spine, found) = (next, reached);
            row.along(section, grid, [twist, k], &spine, found.stretch)?;
        }
        Ok(row)
    }

    fn along(
        &mut self,
        section: &Section,
        grid: &Grid,
        [twist, pressure]: [usize; 2],
        spine: &State,
        stretch: f64,
    ) -> Result<(), SectionError> {
        let points = grid.stretch.points;
        let stride = (points - 1) / (2 * BESIDE);
        let at = |i: usize| grid.at([i, twist, pressure]);
        let nearest = (0..points).min_by(|a, b| (at(*a)[0] - stretch).abs().total_cmp(&(at(*b)[0] - stretch).abs()));
        let nearest = nearest.unwrap_or(0);
        let mut middle = spine.clone();
        if !self.accept(section, grid, [nearest, twist, pressure], &mut middle)? {
            return Ok(());
        }
        self.probe(section, grid, [nearest, twist, pressure], &middle)?;
        let bent = BENT[0].contains(&twist) && BENT[1].contains(&pressure);
        if bent {
            self.bend(section, at(nearest), &middle)?;
        }
        let mut state = middle.clone();
        for i in nearest + 1..points {
            if !self.accept(section, grid, [i, twist, pressure], &mut state)? {
                break;
            }
            if bent && i == nearest + stride {
                self.bend(section, at(i), &state)?;
            }
        }
        for i in (0..nearest).rev() {
            if !self.accept(section, grid, [i, twist, pressure], &mut middle)? {
                break;
            }
            if bent && i + stride == nearest {
                self.bend(section, at(i), &middle)?;
            }
        }
        Ok(())
    }

    fn bend(&mut self, section: &Section, at: [f64; 3], state: &State) -> Result<(), SectionError> {
        let b = section.bending(state)?;
        // Far from the free states a tube may give way sideways: that is for the rods to find, and no stiffness.
        if b.pure_bending() > 0.0 && b.shear > 0.0 {
            self.lateral.push((at, [b.pure_bending(), b.shear, b.coupling / b.shear]));
        }
        Ok(())
    }

    /// Looks at the middle of the cell above `at`, once in a few cells.
    fn probe(&mut self, section: &Section, grid: &Grid, at: [usize; 3], from: &State) -> Result<(), SectionError> {
        let [stretch, twist, pressure] = grid.middle(at);
        let inside = (0..3).all(|d| at[d] + 1 < grid.axes()[d].points);
        if inside && (at[1] + at[2]).is_multiple_of(EVERY) {
            let mut state = from.clone();
            if let Some(found) = section.reach(&mut state, pressure, held(stretch, twist))? {
                let bending = section.bending(&state)?.pure_bending();
                self.probes.push(Probe { at: [stretch, twist, pressure], jet: jet(section, &state, &found), bending });
            }
        }
        Ok(())
    }

    fn accept(
        &mut self,
        section: &Section,
        grid: &Grid,
        at: [usize; 3],
        state: &mut State,
    ) -> Result<bool, SectionError> {
        let [stretch, twist, pressure] = grid.at(at);
        let found = section.reach(state, pressure, held(stretch, twist))?;
        if let Some(found) = &found {
            self.states.push((at[0], at[2], jet(section, state, found)));
        }
        Ok(found.is_some())
    }
}

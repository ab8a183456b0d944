//! A body of elements: nodes, what holds them, rubber, fibres, frame.

use nalgebra::Vector3;

use super::cap::{COORDINATES, Coordinates, Tilt};
use super::element::{Place, Positions, Rubber, across};
use super::fiber::{Fiber, THREADS};
use super::shapes::{NODES, PRESSURES};

/// What holds a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Support {
    /// Held in the components that are true (of y, in the frame), else free.
    Held([bool; 3]),
    /// Carried by the rigid cap.
    Cap,
}

impl Support {
    /// Not held.
    pub const FREE: Support = Support::Held([false; 3]);
    /// Held in all components.
    pub const FIXED: Support = Support::Held([true; 3]);
}

/// One element of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Its nodes; node `i + 3 j + 9 k` as in [`super::shapes`].
    pub nodes: [usize; NODES],
    /// Phase of the frame at each, rad. One node may have different phases in two elements: then one of them sees
    /// an image of it, turned about z by the difference (cyclic symmetry).
    pub phases: [f64; NODES],
    /// Whether the gas presses on its face i = 0.
    pub inner: bool,
    /// Fibre on its face i = 2.
    pub fiber: Fiber,
    /// Where it is in the mesh, in units of elements.
    pub center: [f64; 3],
}

/// A body. Units are the caller's: lengths, and moduli in which pressures and `fiber_ea` / length^2 are given too.
#[derive(Clone, Debug)]
pub struct Body {
    /// Reference positions Y of the nodes, in the frame.
    pub reference: Vec<Vector3<f64>>,
    /// What holds them.
    pub supports: Vec<Support>,
    /// Elements.
    pub cells: Vec<Cell>,
    /// The rubber.
    pub rubber: Rubber,
    /// Stiffness of a fibre.
    pub fiber_ea: f64,
    /// Turn of the frame per length in the reference state, rad.
    pub reference_rate: f64,
    /// Length over which the cap's turn is spread: omega = reference_rate + turn / length.
    pub length: f64,
    /// Centre of the cap.
    pub cap_center: Vector3<f64>,
}

/// Where a body is.
#[derive(Clone, Debug)]
pub struct State {
    /// Positions y of the nodes, in the frame.
    pub positions: Vec<Vector3<f64>>,
    /// Pressures in the rubber, four for each element.
    pub pressures: Vec<[f64; PRESSURES]>,
    /// Tensions of the threads of each element's fibre.
    pub tensions: Vec<[f64; THREADS]>,
    /// The cap.
    pub cap: Coordinates,
    /// Gauge pressure of the gas.
    pub gas: f64,
}

impl State {
    /// Adds `factor` times the difference of two states, the gas apart.
    pub(super) fn add_difference(&mut self, a: &State, b: &State, factor: f64) {
        for (y, (a, b)) in self.positions.iter_mut().zip(a.positions.iter().zip(&b.positions)) {
            *y += (a - b) * factor;
        }
        let inner = |own: &mut f64, (a, b): (&f64, &f64)| *own += (a - b) * factor;
        let others = a.pressures.iter().flatten().zip(b.pressures.iter().flatten());
        self.pressures.iter_mut().flatten().zip(others).for_each(|(own, pair)| inner(own, pair));
        let others = a.tensions.iter().flatten().zip(b.tensions.iter().flatten());
        self.tensions.iter_mut().flatten().zip(others).for_each(|(own, pair)| inner(own, pair));
        for (q, (a, b)) in self.cap.iter_mut().zip(a.cap.iter().zip(&b.cap)) {
            *q += (a - b) * factor;
        }
    }
}

impl Body {
    /// At rest.
    pub fn rest(&self) -> State {
        State {
            positions: self.reference.clone(),
            pressures: vec![[0.0; PRESSURES]; self.cells.len()],
            tensions: vec![[0.0; THREADS]; self.cells.len()],
            cap: [0.0; COORDINATES],
            gas: 0.0,
        }
    }

    /// Number of pressures in the rubber: the negative pivots that a stable state has.
    pub fn pressures(&self) -> usize {
        PRESSURES * self.cells.len()
    }

    /// Rate of turn of the frame.
    pub fn rate(&self, state: &State) -> f64 {
        self.reference_rate + state.cap[0] / self.length
    }

    /// Puts the nodes of the cap where its coordinates say.
    pub fn carry(&self, state: &mut State) {
        let tilt = Tilt::of(&state.cap);
        let center = self.cap_center + Tilt::displacement(&state.cap);
        for (n, _) in self.supports.iter().enumerate().filter(|(_, s)| **s == Support::Cap) {
            state.positions[n] = center + tilt.rotation * (self.reference[n] - self.cap_center);
        }
    }

    /// Reference and current positions of an element's nodes.
    pub(super) fn gather(&self, cell: &Cell, state: &State) -> (Positions, Positions) {
        let of = |from: &[Vector3<f64>]| std::array::from_fn(|n| from[cell.nodes[n]]);
        (of(&self.reference), of(&state.positions))
    }

    /// The frame of gathered positions.
    pub(super) fn place<'a>(&self, cell: &'a Cell, gathered: &'a (Positions, Positions), state: &State) -> Place<'a> {
        Place {
            reference: &gathered.0,
            current: &gathered.1,
            phases: &cell.phases,
            reference_rate: self.reference_rate,
            rate: self.rate(state),
        }
    }

    /// Area that the inner edge of the cap encloses, positive (all elements together; the share of one sector).
    pub(super) fn cap_area(&self) -> f64 {
        let rest = self.rest();
        let mut area = 0.0;
        for cell in self.cells.iter().filter(|c| c.inner && self.supports[c.nodes[18]] == Support::Cap) {
            let (reference, _) = self.gather(cell, &rest);
            for (s, weight) in super::shapes::GAUSS {
                let (a, da) = super::shapes::line(s);
                let (mut y, mut slope, mut turn) = (Vector3::zeros(), Vector3::zeros(), 0.0);
                for j in 0..3 {
                    let arm = reference[18 + 3 * j] - self.cap_center;
                    y += arm * a[j];
                    slope += arm * da[j];
                    turn += cell.phases[18 + 3 * j] * da[j];
                }
                slope += across(&y) * turn;
                area += 0.5 * weight * y.cross(&slope).z;
            }
        }
        area
    }
}
